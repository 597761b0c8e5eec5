"""Mass, damping, friction and delay of a device from a log of forces and positions.

The model is one mass behind a zero-order hold and a delay,

    m x'' + b x' + f_c sign(x') + c [+ k x] = u(t - t_d),

with a constant force c (gravity, an offset of the amplifier), read by an encoder. Between arrivals
of forces its motion is exact, sticking included (``jaxstab.motion.contact``). The fit compares
positions, simulated with measured (output error), in segments, each with an initial position and
velocity of its own, so that what the model lacks does not add up over the log.

The start is a linear regression: the equation of motion is multiplied by bumps of 40 ms and
integrated by parts, so that only the sign of the velocity needs a derivative of the positions. Of
all whole delays below 100 samples the best is taken, and the slope of the delayed force tells the
rest of the delay. It matters: where a loop diverges, steps of Gauss and Newton from a delay that
is wrong by a quarter of a sample follow a long bent valley. Derivatives are differences of
simulations that run side by side. By a QR decomposition each segment's derivatives and residual
become as many rows as columns, which is all that a sum of squares depends on, and its initial
state is eliminated.

Rounding and friction leave residuals that are not white and depend on the motion: intervals of
white noise, or of noise with the correlations of the residual, contain the truth in 60 to 95 of 100
logs. The covariance is therefore the jackknife's over segments (Efron, Stein 1981), from the
Jacobian: with J_s the rows of segment s, A_s = J_s' J_s, A their sum and g_s = J_s' r_s, leaving
the segment out moves the estimate by (A - A_s)^-1 g_s. Intervals are Student's, with one degree of
freedom fewer than there are segments; none is narrower than that of white noise.

An encoder reads multiples of a step, which the smallest difference of two readings tells. The
velocity that software logs beside it follows from the readings, by a window or a low pass: each
window is tried, and a low pass is fitted by a linear regression for its factor.

Where positions are not multiples of a step, the test of Ljung and Box (1978) tells whether what is
left is white: with the correlations r_h of the residual over h samples, n (n + 2) sum r_h^2/(n - h)
of white noise is chi-squared. What an encoder rounds is not white, so there it is the size that
tells: that of rounding, or more.

Of a servo with known gains a step of the set point is enough: y = x less the set point is the free
motion of a wall (kp, kd) from -step, which ``HapticLoop.simulate`` has. Mass, damping and delay
follow by least squares from the best of some tries. A reading that lasts for n samples has one
rounding error, not n: its rows weigh 1/n each. Where the servo acts upon the readings, an error of
one sample moves later ones by the response of S = p_0/p, the polynomials without and with gains.
Intervals are those of errors of the log alone, or those of the servo's, where these are larger.
"""

import os
import warnings
from contextlib import suppress
from dataclasses import dataclass
from math import floor, inf, isnan, log, log10, nan, pi, sqrt
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64
from scipy.optimize import least_squares
from scipy.signal import lfilter
from scipy.special import chdtrc, stdtrit

from jaxstab.answers import Quantity, Units
from jaxstab.arrays import Numbers
from jaxstab.loop import HapticLoop
from jaxstab.model import Velocity
from jaxstab.model.linear_loop import loop_polynomial
from jaxstab.motion.contact import Flow, Runs, Summary, SwitchedMass, series, series_at
from jaxstab.numbers import checked, checked_number
from jaxstab.shown import printable, rounded_text
from jaxstab.tables import INERTIAS, MASSES, PERIODS, columns_of

Rows = Float64[np.ndarray, " row"]
Values = Float64[np.ndarray, " value"]
Segments = Float64[np.ndarray, "segment sample"]
Pushes = Float64[np.ndarray, "segment push"]  # from HISTORY before a segment to AHEAD behind it
Unknowns = Float64[np.ndarray, "segment unknown"]  # initial position and velocity, and the values

HISTORY = 100  # samples before the first segment: longer delays are not tried
AHEAD = 8  # samples: shorter delays than -8, of columns shifted in time, are not tried
_PERIODS = 1e-9, 1e6  # s: those of logs
_ODD = 1.5  # times what noise leaves: a larger residual has a reason
_EXCITE = "excite the device more strongly, or with more changes of the force"


class Estimate(NamedTuple):
    """A value and the ends of its 95 % confidence interval, which holds if the model does.

    Example:
        >>> print(jaxstab.results.Estimate(0.25012, 0.2493, 0.2509))
        0.25012 (0.24930 to 0.25090)
        >>> print(jaxstab.results.Estimate(0.25012, 0.2493, 0.2509).times(1e3))
        250.12 (249.30 to 250.90)
    """

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        half = 0.5 * (self.high - self.low)
        places = max(0, 1 - floor(log10(half))) if half > 0.0 else 6
        value, low, high = (f"{end:.{places}f}" for end in self)
        return f"{value} ({low} to {high})"

    def times(self, factor: float, least: float = -inf) -> "Estimate":
        """Return the estimate in another unit, all three values at least ``least``."""
        return Estimate(*(max(factor * end, least) for end in self))


_NONE = Estimate(0.0, 0.0, 0.0)  # of what is not fitted


@dataclass(frozen=True, repr=False)
class Identified:
    """A device as identified from a log, in SI units: ``jaxstab.identify``, ``identify_servo``.

    Attributes:
        mass, damping, friction, offset, stiffness, delay: estimates in kg, N s/m, N, N, N/m and s
            (kg m^2, N m s/rad, N m, N m, N m/rad and s if it turns). The offset is a constant
            force against the command, at the mean position. The stiffness of the device's spring is
            0 unless one was fitted.
        sample_time: in s.
        resolution: the step of the encoder in m or rad; None where positions are not multiples of
            one.
        residual: the rms of measured minus fitted positions in m or rad.
        warning: a sentence if the residual contradicts the model; empty otherwise.
        velocity: the estimator that fits the logged velocity best; None without one.
        unexplained: the rms of the logged minus the estimated velocity, over that of the velocity;
            NaN for the estimator of a servo, which was given.
        measured, fitted: positions in m or rad, (segment, sample), from row 100 of the log on; of a
            servo one segment, from at most 100 rows before the step on.

    Example:
        >>> push = np.repeat(np.random.default_rng(1).choice([-1.0, 1.0], 200), 10)
        >>> speed = np.cumsum(push) * 1e-3 / 0.25  # of 0.25 kg, without friction and delay
        >>> place = np.cumsum(speed - push * 0.5e-3 / 0.25) * 1e-3
        >>> found = jaxstab.identify(
        ...     force=push, position=np.append(0.0, place[:-1]), sample_time=1e-3
        ... )
        >>> print(f"{found.mass.value:.4f} kg")
        0.2500 kg
    """

    mass: Estimate
    damping: Estimate
    friction: Estimate
    offset: Estimate
    stiffness: Estimate
    delay: Estimate
    sample_time: float
    resolution: float | None
    residual: float
    warning: str
    velocity: Velocity | None
    unexplained: float
    measured: Segments
    fitted: Segments

    def __repr__(self) -> str:
        return f"Identified(mass={self.mass}, damping={self.damping}, delay={self.delay})"


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
    fewest, most = 2000, 64_000  # rows
    period = checked_number("sample_time", sample_time, *_PERIODS, unit="s")
    given = {"force": force, "position": position}
    given |= {} if velocity is None else {"velocity": velocity}
    columns = {name: np.ravel(checked(name, x)) for name, x in given.items()}
    forces, positions = columns["force"], columns["position"]
    for name, column in columns.items():
        if len(column) != len(positions):
            raise ValueError(
                f"{name} has {len(column)} rows but position has {len(positions)}; give columns of "
                "one length."
            )
    if not fewest <= len(positions) <= most:
        raise ValueError(
            f"rows of the log: {len(positions)}; give {fewest} to {most}, such as those of ten "
            "seconds."
        )
    resolution, extent = _resolution(positions), float(np.ptp(positions))
    unit = resolution or 1e-4 * extent
    if not extent >= 20.0 * unit > 0.0 or not np.ptp(forces):
        raise ValueError(
            f"position spans {extent:g} and force spans {np.ptp(forces):g}; give a log in which "
            f"the force moves the device by at least 20 encoder steps."
        )
    if "velocity" in columns and not np.ptp(columns["velocity"]):
        raise ValueError(
            f"velocity is {columns['velocity'][0]:g} throughout; give the one that the software "
            "estimates, or none."
        )
    middle = float(positions.mean())
    estimates, measured, fitted, doubt = _fit(forces, (positions - middle) / unit, period, spring)
    measured, fitted = middle + unit * measured, middle + unit * fitted
    residual, spread = _rms(measured - fitted), float(np.std(positions))
    misfit = 0.1  # of the motion: a log with a larger residual is refused
    if not residual < misfit * spread:
        raise ValueError(
            f"a mass with friction does not fit this log: the residual is {residual:g} rms, the "
            f"motion {spread:g} rms; let go of the handle, and log force and position of the same "
            "sample in one row."
        )
    factors = (period**2 / unit, period / unit, 1.0, 1.0, period, 1.0 / unit)
    mass, *others = map(Estimate.times, estimates, factors)
    loose = 0.5  # of the mass: a larger half-width of its interval is refused
    if not mass.high - mass.low < 2.0 * loose * mass.value:
        raise ValueError(
            f"the log does not separate the mass from damping and friction: it is {mass.low:.3g} "
            f"to {mass.high:.3g}; {_EXCITE}."
        )
    told = _estimator(positions, columns.get("velocity"), period), doubt
    noise = _explained(resolution, extent)
    return _identified([mass, *others], period, resolution, noise, *told, measured, fitted)


def identify_servo(
    *,
    setpoint: Numbers,
    position: Numbers,
    kp: float,
    kd: float,
    sample_time: float,
    velocity: Velocity | None = None,
) -> Identified:
    """Fit inertia, damping and delay of a closed servo to a step of its set point.

    The force is kp (setpoint - position) - kd v with the estimated velocity v of the position. The
    servo rests before the step; all up to the next one is fitted, 5,000 samples at most.

    Args:
        setpoint: in m or rad at each sample, with a step.
        position: the encoder reading at each sample, in m or rad; as many samples.
        kp: the servo's stiffness in N/m or N m/rad.
        kd: the servo's damping in N s/m or N m s/rad.
        sample_time: in s.
        velocity: how the servo estimates the velocity; None for the difference over one sample.

    Returns: Identified, without friction, constant force and spring, which are not fitted.

    Raises: see ``jaxstab.conventions``; ValueError also if columns differ in length, nothing steps,
    or a mass behind a delay does not fit.

    Source: output error (Ljung 1999).

    Example:
        >>> truth = jaxstab.HapticLoop(
        ...     device_mass=0.01, device_damping=0.05, sample_time=2e-3, delay=3e-3
        ... )
        >>> moved = 0.1 + truth.simulate(20.0, 0.6, samples=100, initial_position=-0.1).position
        >>> found = jaxstab.identify_servo(
        ...     setpoint=np.repeat([0.0, 0.1], [10, 100]), position=np.append(np.zeros(10), moved),
        ...     kp=20.0, kd=0.6, sample_time=2e-3,
        ... )
        >>> print(f"{found.mass.value:.6f} kg m^2, {1e3 * found.delay.value:.4f} ms")
        0.010000 kg m^2, 3.0000 ms
    """
    period = checked_number("sample_time", sample_time, *_PERIODS, unit="s")
    gains = checked_number("kp", kp, 0.0, is_open=True), checked_number("kd", kd, 0.0)
    measured, still, step = _stepped(setpoint, position)
    count, rest = len(measured) - still, float(measured[:still].mean())

    def servo(values: Any) -> HapticLoop:
        mass, damping, late, _ = values
        return HapticLoop(
            device_mass=mass, device_damping=damping, sample_time=period, delay=late * period,
            velocity=velocity,
        )  # fmt: skip

    def moved(values: Any) -> Rows:
        loop = servo(values)
        with np.errstate(all="ignore"):  # a try may grow beyond all numbers
            path = 1.0 + loop.simulate(*gains, samples=count, initial_position=-1.0).position
        path = np.clip(np.nan_to_num(path, nan=1e3), -1e3, 1e3)
        return values[-1] + step * np.append(np.zeros(still), path)

    rise = (measured[still:] - rest) / step
    risen, latest = (int(np.argmax(rise > share)) for share in (0.5, 0.05))
    risen = risen or count
    heaviest = gains[0] * (risen * period) ** 2
    delays = latest * np.linspace(0.1, 0.7, 4)
    tries = [(m, 0.0, d, rest) for m in heaviest * np.geomspace(0.01, 3.0, 10) for d in delays]
    start = np.array(min(tries, key=lambda x: float(np.sum((moved(x) - measured) ** 2))))
    sizes = np.array([heaviest, heaviest / (risen * period), 1.0, step])
    bounds = [0.01 / risen, 0.0, 0.0, -np.inf], [10.0, 10.0, HISTORY, np.inf]
    lasting = np.diff(np.flatnonzero(np.diff(measured, prepend=nan, append=nan)))
    weights = np.repeat(1.0 / np.sqrt(lasting), lasting)
    found = least_squares(
        lambda x: weights * (moved(x * sizes) - measured) / step,
        start / sizes,
        bounds=bounds,
        xtol=1e-10,
        ftol=1e-12,
        gtol=None,
    )
    errors, resolution = found.fun / weights, _resolution(measured)
    fitted = measured + step * errors
    if not _rms(errors) < 0.1:
        raise ValueError(
            "a mass behind a delay does not fit this step: the residual is "
            f"{_rms(fitted - measured):g} rms of a step of {abs(step):g}; give the servo's own "
            "gains, and set point and position in one row."
        )
    if len(lasting) <= len(sizes) or not _is_determined(found, *bounds):
        raise ValueError(
            f"position moves by {np.ptp(measured):g} after a step of {abs(step):g}, and does not "
            "determine inertia, damping and delay; give the rows until the servo rests again."
        )
    response = _of_one_error(servo(found.x * sizes), gains, len(measured))
    half = _half_widths(found, weights, len(lasting), response) * abs(sizes)
    values = found.x * sizes
    mass, damping, late, _ = map(Estimate, values, values - half, values + half)
    noise = _explained(resolution, abs(step)) * float(np.linalg.norm(response))
    if not resolution and still:
        noise = max(noise, _ODD * _shaking(measured[:still], step * errors[:still]))
    return _identified(
        [mass, damping, _NONE, _NONE, late.times(period, 0.0)], period, resolution, noise,
        (velocity, nan), "", measured[None], fitted[None],
    )  # fmt: skip


def _shaking(still: Rows, errors: Rows) -> float:
    """The noise of readings before the step: neither motion there, nor a rest that is off."""
    most = 3.0  # times the spread of the first three quarters of these rows
    return min(_rms(errors), most * float(np.std(still[: len(still) - len(still) // 4])))


def _of_one_error(loop: HapticLoop, gains: tuple[float, float], count: int) -> Rows:
    """The readings that follow an error of 1 in one of them, by p_0/p."""
    alpha, beta = (np.array([0.0, float(x)]) for x in (loop.alpha(gains[0]), loop.beta(gains[1])))
    opened, closed = loop_polynomial(alpha, beta, loop.in_floats().linear)
    response: Rows = lfilter(opened, closed, np.eye(1, count)[0])
    return response


def _half_widths(found: Any, weights: Rows, count: int, response: Rows) -> Values:
    """Of 95 % intervals, from how errors of samples move a fit: alone, and with what follows."""
    solved, free = np.linalg.pinv(found.jac), count - found.x.size
    behind = np.array([np.convolve(row[::-1], response)[: len(row)] for row in solved * weights])
    # Of the encoder's errors, counted twice: neighbouring ones are alike.
    pushed = 2.0 * np.mean((found.fun / weights) ** 2) / np.sum(response**2)
    alone = 2.0 * found.cost / free * np.sum(solved**2, axis=1)
    half: Values = stdtrit(free, 0.975) * np.sqrt(
        np.maximum(alone, pushed * np.sum(behind**2, axis=1))
    )
    return half


def _is_determined(found: Any, lowest: list[Any], highest: list[Any]) -> bool:
    """True where all values change the path, and the fit is at no end of what is tried.

    But no damping and no delay may be true.
    """
    least = 1e-6  # of the step: a smaller change is none
    weakest = np.linalg.svd(found.jac, compute_uv=False)[-1]
    is_inside = found.x[0] > 1.01 * lowest[0] and np.all(found.x < np.multiply(0.99, highest))
    return bool(is_inside and weakest > least * sqrt(found.fun.size))


def _identified(
    estimates: list[Estimate],
    period: float,
    resolution: float | None,
    noise: float,
    estimator: tuple[Velocity | None, float],
    doubt: str,
    measured: Segments,
    fitted: Segments,
) -> Identified:
    """The answer, with what the residual says of it; ``noise`` is what needs no reason."""
    mass, damping, friction, offset, delay, stiffness = [*estimates, _NONE][:6]
    damping, friction = damping.times(1.0, 0.0), friction.times(1.0, 0.0)
    _warn_of_units(mass.value, period)
    doubts = [_doubt(measured - fitted, resolution, noise, period), doubt]
    if delay.high < 0.0:
        doubts.append(
            f"positions are {-1e3 * delay.value:.3g} ms ahead of the forces that cause them: "
            "columns are shifted in time; log force and position of the same sample in one row"
        )
    values = mass, damping, friction, offset, stiffness, delay, period, resolution
    told = _rms(measured - fitted), "; ".join(filter(None, doubts)), *estimator
    return Identified(*values, *told, measured, fitted)


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _stepped(setpoint: Numbers, position: Numbers) -> tuple[Rows, int, float]:
    """Positions around a step of the set point, how many are before it, and its size."""
    fewest, most = 20, 5000  # samples of a step
    goals, places = (
        np.ravel(checked(*x)) for x in (("setpoint", setpoint), ("position", position))
    )
    begin, end = [*(np.flatnonzero(np.diff(goals)) + 1).tolist(), len(goals), len(goals)][:2]
    count, still = min(end - begin, most), min(begin, HISTORY)
    if len(goals) != len(places) or count < fewest:
        raise ValueError(
            f"setpoint has {len(goals)} rows, {count} of them after a step, and position "
            f"{len(places)}; give a step and at least {fewest} rows of both behind it."
        )
    return places[begin - still : begin + count], still, float(goals[begin] - goals[begin - 1])


def _warn_of_units(mass: float, period: float) -> None:
    """Warn of a sample time or a mass that no device has: a slip of units."""
    given = (
        ("sample_time", period, "s", PERIODS.low, PERIODS.high),
        ("mass", mass, "kg or kg m^2", INERTIAS.low, MASSES.high),
    )
    odd = [
        f"{name} is {value:g} {unit}, usual are {low:g} to {high:g}"
        for name, value, unit, low, high in given
        if not low <= value <= high
    ]
    if odd:
        warnings.warn(f"{'; '.join(odd)}; give s, N or N m, and m or rad.", stacklevel=4)


# The fit: a start by a regression, and least squares from there.


def _start(
    forces: Rows, positions: Rows, period: float, spring: bool
) -> tuple[Float64[np.ndarray, " value"], Rows]:
    """Mass, damping, friction, offset, delay in samples, and of a spring stiffness; velocities."""
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
    pushes, lags = np.convolve(forces, bump, "same"), range(-AHEAD, HISTORY)
    inside = slice(HISTORY + 2 * half, len(positions) - 2 * half)
    rows = np.stack(terms, axis=1)[inside]
    delayed = np.stack([np.roll(pushes, lag)[inside] for lag in lags], axis=1)
    guesses = np.linalg.lstsq(rows, delayed)[0]
    best = int(np.argmin(np.sum((rows @ guesses - delayed) ** 2, axis=0)[1:-1])) + 1
    slower = 0.5 * (delayed[:, best + 1] - delayed[:, best - 1])  # for a longer delay
    every = np.column_stack([rows, -slower])
    mass, damping, friction, offset, *stiffness, more = np.linalg.lstsq(every, delayed[:, best])[0]
    if not abs(mass) * np.std(rows[:, 0]) > 0.01 * np.std(delayed[:, best]):
        raise ValueError(
            f"less than 1 % of the force accelerates the device, so the log "
            f"does not determine the mass; {_EXCITE}."
        )
    if not mass > 0.0:
        raise ValueError(
            "the device accelerates against the force; give force and position of the same axis, "
            "with the same sign."
        )
    damping, *stiffness = (max(value, 0.0) for value in (damping, *stiffness))  # nothing grows
    mass = max(mass, damping, *stiffness)  # and nothing is faster than a sample
    late = lags[best] - 0.5 + np.clip(more, -0.5, 0.5)  # a held force is half a sample late
    return np.array([mass, damping, friction, offset, late, *stiffness]), speeds


def _fit(
    forces: Rows, positions: Rows, period: float, spring: bool
) -> tuple[list[Estimate], Segments, Segments, str]:
    """Estimates in the order of ``_start``, for a sampling period of 1, measured and fitted paths.

    And a warning, if the search did not end.
    """
    start, speeds = _start(forces, positions, period, spring)
    inside = len(positions) - HISTORY
    count = int(np.clip(inside // 500, 16, 64))  # of about 500 rows
    length = inside // count
    begins = HISTORY + length * np.arange(count)[:, None]
    measured = positions[begins + np.arange(length)]
    pushes = np.pad(forces, (0, AHEAD), "edge")[begins + np.arange(-HISTORY, length + AHEAD)]
    begin = np.hstack([measured[:, :1], speeds[begins], np.tile(start, (count, 1))])
    # Sizes that move the path by about as much as it is long.
    way, push, mass = 1.0 + np.ptp(measured, axis=1), np.std(forces), start[0]
    sizes = [mass, mass / length, push, push, 1.0, mass / length**2][: len(start)]
    every = np.hstack([np.outer(way, [1.0, 1.0 / length]), np.tile(sizes, (count, 1))])
    unknowns, fitted, rows, doubt = _refined(begin, every, measured, pushes)
    values = unknowns[0, 2:]
    half = stdtrit(count - 1, 0.975) * np.sqrt(_variances(rows, measured.size)) * sizes
    return list(map(Estimate, values, values - half, values + half)), measured, fitted, doubt


@np.errstate(all="ignore")  # a try may grow beyond all numbers
def _refined(
    begin: Unknowns, sizes: Unknowns, measured: Segments, pushes: Pushes
) -> tuple[Unknowns, Segments, Float64[np.ndarray, "segment row column"], str]:
    """Unknowns with the least sum of squares, their paths, derivatives and residuals; a warning.

    By steps of Gauss and Newton, halved where the sum grows. The initial states are eliminated
    segment by segment: their columns are the first.
    """
    number, nudge = begin.shape[1], 1e-6  # of a size: the differences for derivatives
    nudges = nudge * np.vstack([np.zeros(number), np.eye(number), -np.eye(number)])[:, None]
    best = trial = begin / sizes
    least, step, shortest, most = inf, np.zeros_like(trial), 1e-9, 100
    for _ in range(most):
        trial[:, 6] = np.clip(trial[:, 6], 2.0 * nudge - AHEAD, HISTORY - 1.0)  # the delay
        path, *moved = _paths((trial + nudges) * sizes, pushes)
        slopes = np.subtract(moved[:number], moved[number:]) / (2.0 * nudge)
        columns = [*slopes, path - measured]
        squares = float(np.sum(columns[-1] ** 2))
        if squares < least:
            gain, least, best, fitted = least - squares, squares, trial, path
            # An array: to the types of NumPy before 2.5 it is Q and R.
            rows = np.asarray(np.linalg.qr(np.stack(columns, axis=-1), mode="r"))
            own, left = rows[:, :2], rows[:, 2:].reshape(-1, number + 1)
            values = np.linalg.lstsq(left[:, 2:-1], -left[:, -1])[0]
            inverse = np.linalg.pinv(own[..., :2], 1e-6)  # a velocity that friction stops is lost
            states = -(inverse @ (own[..., 2:-1] @ values + own[..., -1])[..., None])[..., 0]
            # What friction stops nearly at once tells little: no state moves by more than its size.
            step = np.hstack([np.clip(states, -1.0, 1.0), np.tile(values, (len(begin), 1))])
            if gain < 1e-9 * least:
                break
        else:
            step *= 0.5
        if np.max(abs(step)) < shortest:
            break
        trial = best + step
    if not least < inf:
        raise ValueError(
            "the motion of this log is beyond the range of float64; give force in N, and position "
            "in m or rad."
        )
    is_near = gain < 1e-4 * least or np.max(abs(step)) < shortest  # by less than its error
    doubt = "" if is_near else f"the best fit was not found in {most} steps: no interval holds"
    return best * sizes, fitted, rows, doubt


def _variances(
    rows: Float64[np.ndarray, "segment row column"], count: int
) -> Float64[np.ndarray, " value"]:
    """Variances of the values: those of the jackknife, or of white noise where these are larger."""
    slopes, residuals = rows[:, 2:, 2:-1], rows[:, 2:, -1]  # less what initial states explain
    squares = slopes.transpose(0, 2, 1) @ slopes
    gradients = np.einsum("srp,sr->sp", slopes, residuals)
    segments, number = gradients.shape
    every = slopes.reshape(-1, number)
    shares = np.linalg.svd(every / np.linalg.norm(every, axis=0), compute_uv=False)
    if not shares[-1] > 1e-7 * shares[0]:  # the log does not separate them
        return np.full(number, inf)
    try:
        moves = np.linalg.solve(squares.sum(0) - squares, gradients[..., None])[..., 0]
        white = np.diag(np.linalg.inv(squares.sum(0)))
    except np.linalg.LinAlgError:  # one segment tells all
        return np.full(number, inf)
    noise = np.sum(residuals**2) / (count - 2 * segments - number)
    return np.maximum((segments - 1.0) / segments * np.sum(moves**2, axis=0), noise * white)


def _paths(
    tries: Float64[np.ndarray, "try segment unknown"], pushes: Pushes
) -> Float64[np.ndarray, "try segment sample"]:
    """Positions of tries, side by side: their motion is exact from force to force."""
    x, v, mass, damping, friction, offset, delay, *spring = np.moveaxis(tries, -1, 0)
    gamma, delta = (spring[0] if spring else 0.0) / mass, damping / mass
    impulse, step = series(gamma, delta, 1.0)
    whole = np.floor(delay).astype(int)
    flows = []
    for time in (delay - whole, 1.0 - (delay - whole)):
        pushed, moved = time * series_at(impulse, time), time**2 * series_at(step, time)
        flows.append(Flow(time, pushed, 1.0 - delta * pushed - gamma * moved, moved))
    turn = [[1, 0]], [flows]  # the force before the newest acts first
    plant = SwitchedMass(
        gamma, 0.5 * delta, gamma - 0.25 * delta**2, impulse, step, *turn, oldest=1
    )
    nothing = np.zeros_like(x)
    runs, seen = Runs(*[nothing] * 12), Summary(*[nothing] * 13)
    runs = runs._replace(friction=friction / mass, static_friction=friction / mass)
    length = pushes.shape[1] - HISTORY - AHEAD
    segment, newest = np.arange(len(pushes)), HISTORY - whole
    paths, state = np.empty((length, *x.shape)), (x, v)
    for sample in range(length):
        paths[sample] = state[0]
        ages = sample + newest, sample + newest - 1
        forces = [(pushes[segment, row] - offset) / mass for row in ages]
        state, _ = plant.moved(runs, state, seen, forces, 0)
    return np.moveaxis(paths, 0, -1)


# Logs: their columns, the step of the encoder, and what the residual and the velocity tell.


def read_log(
    file: str, names: dict[str, str], sample_time: float | None, optional: list[str]
) -> tuple[dict[str, Any], str]:
    """The sampling period and columns of a log, by their names in ``identify``, and a warning.

    ValueError: the file is bad, or its time steps differ.
    """
    time, own = names["time"], {key: name for key, name in names.items() if key != "time"}
    needed = [name for name in own.values() if name not in optional]
    table = columns_of(file, [*needed, *[time] * (sample_time is None)], optional)
    columns = {key: np.array(table[name]) for key, name in own.items() if name in table}
    if sample_time is not None:
        return {"sample_time": sample_time, **columns}, _clash(file, time, sample_time)
    times, unequal = np.array(table[time]), 0.1  # of a sample: the most that a step may differ
    if len(times) < 2:
        raise ValueError(f"{file} has {len(times)} rows of numbers; give all.")
    with np.errstate(all="ignore"):  # steps may overflow
        steps = np.diff(times)
        step = np.median(steps)  # unlike the mean, a gap does not change it
        odd = np.flatnonzero(~((abs(steps - step) <= unequal * step) & (steps > 0.0)))
    if len(odd):
        row = int(odd[0])
        raise ValueError(
            f"{file}: from {times[row]:.9g} s to {times[row + 1]:.9g} s (rows {row + 1} and "
            f"{row + 2}) the time does not grow by the usual step of {step:.6g} s; give a log with "
            "equal steps, or --sample-time if no row is missing."
        )
    return {"sample_time": float(np.mean(steps)), **columns}, ""


def _clash(file: str, time: str, sample_time: float) -> str:
    """A warning if the file has a time column with another mean step than the sampling period."""
    if not os.path.isfile(file):  # stdin or a pipe, which is read once
        return ""
    with suppress(ValueError):  # there is none, or it has no numbers
        times = columns_of(file, [time])[time]
        step = (times[-1] - times[0]) / max(len(times) - 1, 1)
        if not abs(step - sample_time) <= 0.01 * sample_time:
            return (
                f"column {time} grows by {step:.6g} a row, and --sample-time is {sample_time:g} s, "
                "which was taken"
            )
    return ""


def _resolution(positions: Rows) -> float | None:
    """Return the step of which positions are multiples, up to a constant offset."""
    places = np.unique(positions)
    if len(places) < 2:
        return None
    step = float(np.diff(places).min())
    most = float(np.rint((places[-1] - places[0]) / step))
    if most > 2.0**31:  # counts of no encoder: such steps are rounding of float64
        return None
    step = float(places[-1] - places[0]) / most
    counts = (places - places[0]) / step
    return step if np.all(abs(counts - np.rint(counts)) < 0.1) else None


def _estimator(
    positions: Rows, velocity: Rows | None, period: float
) -> tuple[Velocity | None, float]:
    """Return the window or the low pass that fits velocities best, and its relative error."""
    if velocity is None:
        return None, 0.0
    longest_window = 200  # samples
    late, tiny = slice(longest_window, None), np.finfo(float).tiny
    wanted, now = velocity[late], positions[late]

    def error(values: Rows) -> float:
        return float(np.mean((values - wanted) ** 2))

    guesses = [
        (error((now - positions[longest_window - n : -n]) / (n * period)), Velocity.difference(n))
        for n in range(1, longest_window + 1)
    ]
    # v_k - d_k = q (v_(k-1) - d_k) of a low pass is linear in q.
    speeds = np.diff(positions) / period
    before, after = velocity[:-1] - speeds, velocity[1:] - speeds
    share = float(before @ after) / max(float(before @ before), tiny)
    if 0.0 < share < 1.0:
        low, _ = lfilter([1.0 - share], [1.0, -share], speeds, zi=[share * velocity[0]])
        estimator = Velocity.low_pass(-log(share) / (2.0 * pi * period))
        guesses.append((error(low[longest_window - 1 :]), estimator))
    least, best = min(guesses, key=lambda guess: guess[0])
    return best, float(np.sqrt(least / max(np.mean(wanted**2), tiny)))


def _explained(resolution: float | None, extent: float) -> float:
    """The largest residual that rounding explains: the encoder's, or that of a computed path."""
    return _ODD * resolution / sqrt(12.0) if resolution else 1e-6 * extent


def _doubt(residual: Segments, resolution: float | None, noise: float, period: float) -> str:
    """Return a warning, with its main frequency, if the residual is not what noise leaves."""
    window, size = np.hanning(residual.shape[1]), _rms(residual)
    power = np.mean(abs(np.fft.rfft(window * residual, axis=1)) ** 2, axis=0)[2:]
    peak = (int(np.argmax(power)) + 2) / (residual.shape[1] * period)
    times = sqrt(12.0) * (size / resolution if resolution else 0.0)
    unlikely, chance = 1e-3, chance_of_white(residual)
    if size <= noise or (not resolution and chance > unlikely):
        return ""
    of_rounding = f", {times:.3g} times that of the encoder's rounding" if resolution else ""
    colour = f", not white (p = {chance:.1g})" if chance <= unlikely else ""
    return (
        f"the residual is {size:.3g} rms{of_rounding}{colour}, with its largest peak at "
        f"{peak:.3g} Hz: the model lacks something, such as a vibration mode, a hand on the handle "
        "or a varying delay"
    )


def chance_of_white(residual: Segments) -> float:
    """The chance that white noise is as correlated over 20 samples: the test of Ljung and Box."""
    lags, (segments, length) = 20, residual.shape
    lags, count, power = min(lags, length // 4), residual.size, np.sum(residual**2)
    shares = [
        float(np.sum(residual[:, lag:] * residual[:, :-lag]) / power) ** 2
        / (count - lag * segments)
        for lag in range(1, lags + 1)
    ]
    return float(chdtrc(lags, count * (count + 2.0) * sum(shares)))


# What is identified, as text and as a scene.


def identified_text(device: Identified, units: Units) -> str:
    """Return the identified quantities, one on each line, with units."""
    period, length = device.sample_time, Quantity("m", digits=3)
    rounding = length.words((device.resolution or 0.0) / sqrt(12.0), units)
    explained = f" (encoder rounding alone: {rounding})" if device.resolution else ""
    lines = {
        units.moved: f"{device.mass} {units.kilogram}",
        "damping": f"{device.damping} {units.damping}",
        "friction": f"{device.friction} {units.force}" if device.friction.high else "",
        "constant force": f"{device.offset} {units.force}" if device.offset.high else "",
        "spring": f"{device.stiffness} {units.stiffness}" if device.stiffness.value else "",
        "delay": f"{device.delay.times(1e3)} ms; in samples {device.delay.times(1.0 / period)}",
        "residual": f"{length.words(device.residual, units)} rms{explained}",
        "velocity": f"{device.velocity}; {_unexplained(device)}" if device.velocity else "",
    }
    shown = [f"{name:16}{words}" for name, words in lines.items() if words]
    doubt = "; by the warning it does not" if device.warning else ""
    return "\n".join([*shown, f"in brackets: 95 % confidence intervals, if the model holds{doubt}"])


def _unexplained(device: Identified) -> str:
    percent = 100.0 * device.unexplained
    if isnan(percent):
        return "as given"
    return f"{rounded_text(percent, 2) if percent >= 1e-3 else '< 0.001'} % rms unexplained"


def identified_scene(device: Identified, units: Units, source: str) -> str:
    """Return the text of a scene: intervals as ranges where it takes them, else as comments.

    The delay becomes a range in which it may vary, because those proofs cover ranges of mass, too.
    With a warning there is no range: what the model lacks moves estimates out of their intervals.
    """
    period, resolution, remarks = device.sample_time, device.resolution, list[str]()
    ranges = "" if device.warning else " and as ranges"
    if device.warning:
        remarks.append(f"Warning: {device.warning}. So mass and delay have no range here.")

    def taken(estimate: Estimate) -> str:
        value, low, high = (f"{max(end, 0.0):.7g}" for end in estimate)
        return f"[{low}, {high}]" if ranges else value

    if device.stiffness.value:
        remarks.append(
            f"The device has a spring of {device.stiffness} {units.stiffness}: add it to the "
            "stiffness of the hand."
        )
    friction = f"friction = {device.friction.value:.6g}  # {units.force}; {device.friction}"
    velocity = list[str]()
    if device.velocity is not None:
        key = next(iter(device.velocity.filter.sections[0].toml.items()))
        explained = 0.05  # of a velocity: an estimator with a larger error is only a comment
        mark = "# not explained: " if device.unexplained > explained else ""
        number = f"{key[1]:.6g}" if isinstance(key[1], float) else key[1]
        velocity = [f"{mark}velocity.{key[0]} = {number}  # {_unexplained(device)}"]
    lines = [
        f"# From {printable(source)} by jaxstab identify. In brackets{ranges}: 95 %",
        "# confidence intervals, if the model holds.",
        *(f"# {remark}" for remark in remarks),
        "",
        "[device]",
        f"{units.moved} = {taken(device.mass)}  # {units.kilogram}; {device.mass}",
        f"damping = {device.damping.value:.6g}  # {units.damping}; {device.damping}",
        *([friction] if device.friction.high else []),
        *([f"encoder.resolution = {resolution:.6g}  # {units.length}"] if resolution else []),
        "",
        "[controller]",
        f"sample_time = {period:.9g}  # s",
        f"delay = {taken(device.delay)}  # s; in samples {device.delay.times(1.0 / period)}",
        *velocity,
    ]
    if device.friction.value:
        speed = float(np.std(np.diff(device.fitted, axis=1))) / period
        words = f"{units.speed}, of simulated contacts; that of the log"
        lines += ["", "[contact]", f"speed = {speed:.2g}  # {words}"]
    return "\n".join([*lines, ""])
