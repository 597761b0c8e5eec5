"""The loop in the time domain: exact at its samples and between them.

Between two events (a sample, the arrival of a delayed force) the force is constant, so the plant's
transition is exact there. This route shares the plant with p(z), but neither z nor polynomials.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.typing import ArrayLike
from jaxtyping import Float64

from jaxstab.model import HapticLoop, checked_gain, plant_transition, require_x64


class Response(NamedTuple):
    """A motion of the loop: time in s, position in m, velocity in m/s, the wall's force in N.

    The force is the one that acts on the device from this time on, after hold and delay. The
    arrays but ``time`` have the shape of the walls and the initial values, then one axis of time.
    """

    time: Float64[Array, " time"]
    position: Float64[Array, "*grid time"]
    velocity: Float64[Array, "*grid time"]
    force: Float64[Array, "*grid time"]


class Motion(NamedTuple):
    """The state of a loop just before a sample, with T = m = 1."""

    position: Float64[Array, ""]
    velocity: Float64[Array, ""]
    previous: Float64[Array, ""]  # the position at the last sample
    acting: Float64[Array, ""]  # the wall's force at the end of the last hold
    line: Float64[Array, " whole_delay"]  # the forces on their way, the next one to arrive last


def simulate(
    loop: HapticLoop,
    stiffness: ArrayLike,
    damping: ArrayLike,
    *,
    samples: int = 200,
    force: ArrayLike = 0.0,
    velocity: ArrayLike = 0.0,
    position: ArrayLike = 0.0,
    between: int = 0,
    unilateral: bool = False,
) -> Response:
    """Simulate a device, held by a hand, against a virtual wall at position 0.

    Mass, damper and the hand's spring move in continuous time. At every sample the wall computes
    -K x - B (x - previous x)/T; this force acts after the delay and is held for one sample. Before
    time 0 the device stood where it starts, and no force was on its way.

    Args:
        loop: device, hand, sample time and delay (any real number).
        stiffness: K of the wall in N/m, any shape; broadcasts with the four other arrays.
        damping: B of the wall in N s/m.
        samples: how many samples to simulate, from time 0 on.
        force: a step in N, from time 0 on: the hand begins to push.
        velocity: in m/s at time 0: an impact on the wall, or a blow of this times the mass.
        position: in m at time 0, the penetration if positive.
        between: how many equidistant points to return between two samples.
        unilateral: the wall pushes or pulls only while the sampled position is positive (Remark 1);
            otherwise it holds the device from both sides, as in the rest of the paper.

    Returns:
        Response at samples * (between + 1) times; exact up to rounding at each of them, and
        differentiable in all arrays.

    Raises:
        ValueError: a gain is infinite or NaN, nothing moves the device, or a count is too small.
        RuntimeError: JAX's x64 mode is off.

    Source: eqs. (1)-(5) and Fig. 2 of Hulin, Preusche, Hirzinger (2008); Remark 1.
    """
    require_x64()
    _check_counts(samples, between)
    alpha = loop.alpha(jnp.asarray(checked_gain("stiffness", stiffness), jnp.float64))
    beta = loop.beta(jnp.asarray(checked_gain("damping", damping), jnp.float64))
    period = loop.sample_time
    push = jnp.asarray(force, jnp.float64) * (period**2 / loop.mass)
    start = jnp.asarray(position, jnp.float64)
    speed = jnp.asarray(velocity, jnp.float64) * period
    _check_excitation(push, start, speed)
    whole, fraction = divmod(loop.delay_samples, 1.0)
    offsets = np.arange(between + 2) / (between + 1)
    grid = jnp.broadcast_shapes(*(x.shape for x in (alpha, beta, push, start, speed)))
    lanes = [jnp.ravel(jnp.broadcast_to(x, grid)) for x in (alpha, beta, push, start, speed)]
    arrays = _march_all(
        tuple(lanes),
        propagator(loop.gamma, loop.delta, fraction, offsets),
        jnp.asarray(offsets[:-1] < fraction),
        samples=samples,
        whole_delay=int(whole),
        unilateral=unilateral,
    )
    x, v, f = (array.reshape((*grid, -1)) for array in arrays)
    time = jnp.arange(x.shape[-1]) * (period / (between + 1))
    return Response(time, x, v / period, f * (loop.mass / period**2))


def propagator(
    gamma: ArrayLike, delta: ArrayLike, fraction: ArrayLike, offsets: ArrayLike
) -> Float64[Array, "*grid offset 2 5"]:
    """Return position and velocity (rows) at times in [0, 1] after a sample.

    The columns: position and velocity at the sample, the force that acts up to ``fraction``, the
    force that acts from then on, and a force that acts all the time.
    """
    offsets = jnp.asarray(offsets, jnp.float64)
    gamma, delta, fraction = (
        jnp.asarray(x, jnp.float64)[..., None] for x in (gamma, delta, fraction)
    )
    whole = plant_transition(gamma, delta, offsets)
    pushed = whole[..., 2:]
    late = plant_transition(gamma, delta, jnp.maximum(offsets - fraction, 0.0))[..., 2:]
    late = jnp.broadcast_to(late, jnp.broadcast_shapes(late.shape, pushed.shape))
    whole = jnp.broadcast_to(whole, (*late.shape[:-1], 3))
    return jnp.concatenate([whole[..., :2], pushed - late, late, whole[..., 2:]], axis=-1)


def wall_acts(
    motion: Motion, alpha: Array, beta: Array, place: Array | int, *, unilateral: bool = False
) -> tuple[Array, Array]:
    """Sample the wall's force: the force that leaves the line of delay, and the line behind it.

    ``place`` is where a force enters the line: at its beginning, 0, if the line is as long as the
    delay, further on if it is longer.
    """
    force = -(alpha * motion.position + beta * (motion.position - motion.previous))
    if unilateral:
        force = jnp.where(motion.position > 0.0, force, 0.0)
    line = jnp.concatenate([jnp.zeros(1), motion.line]).at[place].add(force)
    return line[-1], line[:-1]


@partial(jax.jit, static_argnames=("samples", "whole_delay", "unilateral"))
def _march_all(
    lanes: tuple[Array, ...],
    propagate: Array,
    early: Array,
    *,
    samples: int,
    whole_delay: int,
    unilateral: bool,
) -> tuple[Array, Array, Array]:
    def march(
        alpha: Array, beta: Array, push: Array, position: Array, velocity: Array
    ) -> tuple[Array, Array, Array]:
        def step(motion: Motion, _: None) -> tuple[Motion, tuple[Array, Array, Array]]:
            arriving, line = wall_acts(motion, alpha, beta, 0, unilateral=unilateral)
            causes = (motion.position, motion.velocity, motion.acting, arriving, push)
            path = propagate @ jnp.stack(causes)
            following = Motion(path[-1, 0], path[-1, 1], motion.position, arriving, line)
            return following, (
                path[:-1, 0],
                path[:-1, 1],
                jnp.where(early, motion.acting, arriving),
            )

        rest = jnp.zeros(())
        start = Motion(position, velocity, position, rest, jnp.zeros(whole_delay))
        _, paths = lax.scan(step, start, length=samples)
        x, v, force = (jnp.ravel(path) for path in paths)
        return x, v, force

    arrays: tuple[Array, Array, Array] = jax.vmap(march)(*lanes)
    return arrays


def _check_counts(samples: int, between: int) -> None:
    if samples < 1:
        raise ValueError(f"samples is {samples}; give at least 1.")
    if between < 0:
        raise ValueError(f"between is {between}; give 0 or more points between two samples.")


def _check_excitation(*causes: Array) -> None:
    if any(isinstance(cause, jax.core.Tracer) for cause in causes):
        return
    if not all(np.all(np.isfinite(cause)) for cause in causes):
        raise ValueError("force, velocity or position is infinite or NaN; give finite numbers.")
    if not any(np.any(cause) for cause in causes):
        raise ValueError(
            "force, velocity and position are all 0, so nothing moves: give at least one of them."
        )
