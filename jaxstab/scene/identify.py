"""Mass, damping, friction and delay of a device from a log of forces and positions.

The model is one mass behind a zero-order hold and a delay,

    m x'' + b x' + f_c sign(x') + c [+ k x] = u(t - t_d),

with a constant force c (gravity, an offset of the amplifier), read by an encoder. Between arrivals
of forces its motion is exact, sticking included (``jaxstab.motion.contact``), and differentiable
with respect to all of these. Where the delay is w + f samples, f is the length of the first of the
two pieces of a sample, so positions are differentiable with respect to the delay, too.

The fit compares positions, simulated with measured (output error). The log is cut into segments,
each with an initial position and velocity of its own, so that what the model lacks does not add up
over the log. The start is a linear regression: the equation of motion is multiplied by bumps of 40
ms and integrated by parts, so that only the sign of the velocity needs a derivative of the
positions; of all whole delays below 100 samples the one with the smallest residual is taken. Then
``scipy.optimize.least_squares`` refines the values. For each of them the initial states follow by
steps of Gauss and Newton, segment by segment, and the derivatives are less what these states can
explain (Kaufman 1975).

Rounding and friction leave residuals that are not white and depend on the motion. The covariance is
therefore the jackknife's over segments (Efron, Stein 1981), from the Jacobian: with J_s the rows of
segment s, A_s = J_s' J_s, A their sum and g_s = J_s' r_s, leaving the segment out moves the
estimate by (A - A_s)^-1 g_s. Nothing is assumed of the residuals within a segment. Intervals are
Student's, with one degree of freedom fewer than there are segments.
"""

from functools import cache, lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float64
from scipy.optimize import least_squares
from scipy.special import stdtrit

from jaxstab.arrays import Array, Numbers
from jaxstab.batches import in_float64
from jaxstab.motion.contact import Flow, Plant, Runs, Seen, series, series_at
from jaxstab.numbers import checked, checked_number
from jaxstab.scene.identified import Estimate, Identified, Rows, Segments, doubt_of
from jaxstab.scene.log import estimator_of, resolution_of

FEWEST, MOST = 2000, 64_000  # rows
HISTORY = 100  # samples before the first segment: longer delays are not tried
_EXCITE = "excite the device more strongly, or with more changes of the force"


def identify(
    *,
    force: Numbers,
    position: Numbers,
    sample_time: float,
    velocity: Numbers = None,
    spring: bool = False,
) -> Identified:
    """Fit mass, damping, Coulomb friction and delay to a log, with 95 % confidence intervals.

    docs/identify.md says how to record such a log. The intervals hold if the model does: one mass
    that no hand touches, and constant quantities.

    Args:
        force: the force commanded at each sample, in N or N m; 2,000 to 64,000 samples.
        position: the encoder reading at each sample, in m or rad; as many samples.
        sample_time: in s.
        velocity: the velocity that the software computed, in m/s or rad/s; identifies its
            estimator.
        spring: fit a spring of the device too; one that the software renders is in the force.

    Returns: Identified.

    Raises: see ``jaxstab.conventions``; ValueError also if the log is too short or too long, its
    columns differ in length, nothing moves, or it does not determine the mass.

    Source: output error (Ljung 1999), jackknife of Efron and Stein (1981).

    Example: ``jaxstab.results.Identified`` has one of a good log.
        >>> jaxstab.identify(force=[0.0], position=[0.0], sample_time=1e-3)
        Traceback (most recent call last):
        ValueError: rows of the log: 1; give 2000 to 64000, such as those of ten seconds.
    """
    period = checked_number("sample_time", sample_time, 0.0, is_open=True, unit="s")
    given = {"force": force, "position": position}
    given |= {} if velocity is None else {"velocity": velocity}
    columns = {name: np.ravel(checked(name, values)) for name, values in given.items()}
    forces, positions = columns["force"], columns["position"]
    for name, column in columns.items():
        if len(column) != len(positions):
            raise ValueError(
                f"{name} has {len(column)} rows but position has {len(positions)}; give columns of "
                "one length."
            )
    if not FEWEST <= len(positions) <= MOST:
        raise ValueError(
            f"rows of the log: {len(positions)}; give {FEWEST} to {MOST}, such as those of ten "
            "seconds."
        )
    resolution, extent = resolution_of(positions), float(np.ptp(positions))
    unit = resolution or 1e-4 * extent
    if not extent >= 20.0 * unit or not np.ptp(forces):
        raise ValueError(
            f"position spans {extent:g} and force spans {np.ptp(forces):g}; give a log in which "
            f"the force moves the device by at least 20 encoder steps."
        )
    middle = float(positions.mean())
    estimates, measured, fitted = _fit(forces, (positions - middle) / unit, period, spring)
    residual = unit * float(np.sqrt(np.mean((measured - fitted) ** 2)))
    misfit = 0.1  # of the motion: a log with a larger residual is refused
    if not residual < misfit * np.std(positions):
        raise ValueError(
            f"a mass with friction does not fit this log: the residual is {residual:g} rms, the "
            f"motion {np.std(positions):g} rms; let go of the handle, and log force and position "
            "of the same sample in one row."
        )
    factors = (period**2 / unit, period / unit, 1.0, 1.0, 1.0 / unit, period)
    mass, damping, friction, offset, stiffness, delay = map(Estimate.times, estimates, factors)
    loose = 0.5  # of the mass: a larger half-width of its interval is refused
    if not mass.high - mass.low < 2.0 * loose * mass.value:
        raise ValueError(
            f"the log does not separate the mass from damping and friction: it is {mass.low:.3g} "
            f"to {mass.high:.3g}; {_EXCITE}."
        )
    estimator, unexplained = estimator_of(positions, columns.get("velocity"), period)
    return Identified(
        mass,
        damping.times(1.0, 0.0),
        friction.times(1.0, 0.0),
        offset,
        stiffness,
        delay,
        period,
        resolution,
        residual,
        doubt_of(measured - fitted, resolution is not None, residual, extent, period),
        estimator,
        unexplained,
        middle + unit * measured,
        middle + unit * fitted,
    )


def _start(
    forces: Rows, positions: Rows, period: float, spring: bool
) -> tuple[Float64[np.ndarray, " 6"], Rows]:
    """Return mass, damping, friction, offset, stiffness and delay in samples, and velocities."""
    half = int(np.clip(0.04 / period, 16, 200)) // 2  # of 40 ms, in samples
    bump = (1.0 - (np.arange(1 - half, half) / half) ** 2) ** 3
    slope, bend = np.convolve(bump, [0.5, 0.0, -0.5]), np.convolve(bump, [1.0, -2.0, 1.0])
    speeds = np.convolve(positions, slope, "same") / bump.sum()
    terms = [
        np.convolve(positions, bend, "same"),
        np.convolve(positions, slope, "same"),
        np.convolve(np.sign(speeds), bump, "same"),
        np.full(len(positions), bump.sum()),
        *([np.convolve(positions, bump, "same")] if spring else []),
    ]
    pushes = np.convolve(forces, bump, "same")
    inside = slice(HISTORY + 2 * half, len(positions) - 2 * half)
    rows = np.stack(terms, axis=1)[inside]
    delayed = np.stack([np.roll(pushes, lag)[inside] for lag in range(HISTORY)], axis=1)
    guesses = np.linalg.lstsq(rows, delayed)[0]
    best = int(np.argmin(np.sum((rows @ guesses - delayed) ** 2, axis=0)))
    values = np.append(guesses[:, best], [0.0] * (not spring))
    if not abs(values[0]) * np.std(rows[:, 0]) > 0.01 * np.std(delayed[:, best]):
        raise ValueError(
            f"less than 1 % of the force accelerates the device, so the log "
            f"does not determine the mass; {_EXCITE}."
        )
    if not values[0] > 0.0:
        raise ValueError(
            "the device accelerates against the force; give force and position of the same axis, "
            "with the same sign."
        )
    values[0] = max(values[0], abs(values[1]), abs(values[4]))  # nothing is faster than a sample
    return np.append(values, max(best - 0.5, 0.5)), speeds  # a held force is half a sample late


def _fit(
    forces: Rows, positions: Rows, period: float, spring: bool
) -> tuple[list[Estimate], Segments, Segments]:
    """Return estimates for a sampling period of 1; positions in segments, measured and fitted."""
    start, speeds = _start(forces, positions, period, spring)
    count = int(np.clip((len(positions) - HISTORY - 1) // 500, 16, 64))  # of about 500 rows
    length = (len(positions) - HISTORY - 1) // count
    begins = HISTORY + length * np.arange(count)
    measured = positions[begins[:, None] + np.arange(length)]
    pushes = forces[begins[:, None] + np.arange(-HISTORY, length + 1)]
    sizes = start * [1e-3, 1e-2, 1e-2, 0.0, 1e-2, 0.0] + [0.0, 0.0, 0.0, 0.01, 0.0, 0.05]
    free = np.flatnonzero(sizes)
    states, shape = np.stack([measured[:, 0], speeds[begins]], axis=1), measured.shape
    scale = np.array([1.0, 1.0 / length])

    @lru_cache(maxsize=2)  # residuals and derivatives are asked for one after the other
    def fitted(moves: tuple[float, ...]) -> tuple[Segments, np.ndarray]:
        values, trial = start.copy(), states.copy()  # the states of values asked for before
        values[free] += sizes[free] * moves
        best = states, np.full(count, np.inf), np.empty_like(measured), np.empty((*shape, 8))
        settled = 1e-6  # encoder steps: a smaller move ends the search for initial states
        held = 1e-6  # of the largest singular value: what a segment tells less of stays as it is
        for _ in range(8):
            both = np.hstack([np.tile(values, (count, 1)), trial])
            path, slopes = in_float64(_program(), both, pushes)
            squares = np.sum((measured - path) ** 2, axis=1)
            is_better = (squares < best[1])[:, None]
            for kept, new in zip(best, (trial, squares, path, slopes), strict=True):
                kept[is_better[:, 0]] = new[is_better[:, 0]]
            to_states = best[3][:, :, 6:] * scale
            inverse = np.linalg.pinv(to_states, held)  # a velocity that friction stops is lost
            step = scale * (inverse @ (measured - best[2])[..., None])[..., 0]
            trial = np.where(is_better, states + step, 0.5 * (states + trial))
            if np.all(np.abs(trial - states) <= settled * scale):
                break
        rows = best[3][:, :, free] * sizes[free]
        return best[2], rows - to_states @ (inverse @ rows)

    lightest = 1e-3  # of the first guess of the mass
    found = least_squares(
        lambda moves: (fitted(tuple(moves))[0] - measured).ravel(),
        np.zeros(free.size),
        lambda moves: fitted(tuple(moves))[1].reshape(-1, free.size),
        bounds=(np.where(free == 0, (lightest - 1.0) * start[0] / sizes[0], -np.inf), np.inf),
        max_nfev=40,
        ftol=1e-12,
        xtol=1e-9,
        gtol=None,
    )
    rows, residuals = found.jac.reshape(count, length, -1), found.fun.reshape(count, length)
    squares = rows.transpose(0, 2, 1) @ rows
    gradients = np.einsum("srp,sr->sp", rows, residuals)
    try:
        moves = np.linalg.solve(squares.sum(0) - squares, gradients[..., None])[..., 0]
    except np.linalg.LinAlgError:  # the log does not separate them
        moves = np.full((count, free.size), np.inf)
    values, errors = start.copy(), np.zeros(6)
    values[free] += sizes[free] * found.x
    errors[free] = np.abs(sizes[free]) * np.sqrt((count - 1.0) / count * np.sum(moves**2, axis=0))
    half = stdtrit(count - 1, 0.975) * errors
    return list(map(Estimate, values, values - half, values + half)), measured, residuals + measured


@cache
def _program() -> Any:
    """Return the compiled simulation of segments: positions, and derivatives.

    These are the derivatives with respect to the values of ``_start`` and the initial state, in
    one row for each segment.
    """

    def path(both: Array, forces: Array) -> Array:
        mass, damping, friction, offset, stiffness, delay, x, v = both
        gamma, delta = stiffness / mass, damping / mass
        impulse, step = series(gamma, delta, 1.0)
        whole = jnp.floor(jax.lax.stop_gradient(delay))
        length = len(forces) - HISTORY - 1
        lengths = jnp.tile(jnp.stack([delay - whole, 1.0 - (delay - whole)]), length)
        newest = jnp.arange(length) + HISTORY - whole.astype(int)
        acting = jnp.stack([forces[newest - 1], forces[newest]], axis=1).ravel()
        pushed = lengths * series_at(impulse, lengths)
        moved = lengths**2 * series_at(step, lengths)
        flows = Flow(lengths, pushed, 1.0 - delta * pushed - gamma * moved, moved)
        plant = Plant(gamma, 0.5 * delta, gamma - 0.25 * delta**2, impulse, step, [[0]], [[]], 0)
        nothing = 0.0 * x
        runs, seen = Runs(*[nothing] * 12), Seen(*[nothing] * 6)
        runs = runs._replace(friction=friction / mass, static_friction=friction / mass)

        def piece(state: Any, of_piece: Any) -> Any:
            force, flow = of_piece
            own = plant._replace(flows=[[flow]])
            return own.moved(runs, state, seen, [(force - offset) / mass], 0)[0], state[0]

        return jax.lax.scan(piece, (x, v), (acting, flows))[1][::2]

    def with_slopes(both: Array, forces: Array) -> tuple[Array, Array]:
        twice = lambda both: (path(both, forces),) * 2  # noqa: E731
        slopes, positions = jax.jacfwd(twice, has_aux=True)(both)
        return positions, slopes

    return jax.jit(jax.vmap(with_slopes))
