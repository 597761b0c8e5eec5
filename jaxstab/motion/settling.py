"""How long the sampled loop rings: settling in the time domain, with the tail proved.

The deviation from rest follows s -> A s. While a loop is simulated, the largest entry of its state
bounds all that is to come: with g_i the row-sum norm of A^(2^i) and g_I < 1, no power of A has a
norm above g_0 g_1 ... g_(I-1), factors below 1 left out. Once this bound lies within the level, the
loop has settled. No eigenvalue is needed, and multiple roots do no harm.
"""

from collections.abc import Callable
from enum import IntEnum
from functools import partial
from math import ceil, log2, prod
from typing import Any, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.typing import ArrayLike
from jaxtyping import Float64, Int8

from jaxstab.conventions import Verdict
from jaxstab.model import HapticLoop, checked_delay, checked_gain, require_x64
from jaxstab.motion.response import Motion, propagator, wall_acts
from jaxstab.point.verdict.door import verdict

Excitation = Literal["force", "impact"]

HORIZON = 4096
_LEAST_STIFFNESS = 1e-12  # keeps the scales of a loop without any stiffness finite
_STRIDE = 8  # samples between two looks at the bound
_BATCH = 512  # lanes that run until the last of them has settled


class SettlingStatus(IntEnum):
    """What is known about the settling of a loop; small integers, so that arrays store int8."""

    NOT_COMPUTED = 0
    SETTLED = 1
    UNSTABLE = 2
    NOT_SETTLED = 3

    @property
    def words(self) -> str:
        """The status in words."""
        return {
            SettlingStatus.NOT_COMPUTED: "not computed",
            SettlingStatus.SETTLED: "settled, and proved to stay so",
            SettlingStatus.UNSTABLE: "the loop is unstable and never settles",
            SettlingStatus.NOT_SETTLED: "not proved to settle within the horizon",
        }[self]


class Settling(NamedTuple):
    """A settling time and what is known about it: infinite unless the status is SETTLED."""

    value: Float64[Array, "*grid"]
    status: Int8[Array, "*grid"]


def settling_samples(
    alpha: ArrayLike,
    beta: ArrayLike,
    gamma: ArrayLike,
    delta: ArrayLike,
    delay: ArrayLike,
    level: float = 0.02,
    *,
    excitation: Excitation = "force",
    horizon: int = HORIZON,
) -> Settling:
    """Count the samples until the position stays within a band around its final value.

    The answer is the first sample from which on every sampled position is within the band: a whole
    number, and true of the time domain, unlike an estimate from the spectral radius. The device
    moves between samples too, but is not looked at there. Two excitations are known:

    - "force": the hand begins to push with a constant force at sample 0, on a device at rest. The
      band is +-level times the final displacement F/(K + k): the settling time of a step response.
    - "impact": the device hits the wall with some velocity at sample 0, and nothing else pushes it.
      The band is +-level times the largest sampled excursion, around 0.

    Args:
        alpha: wall stiffness K T^2/m, any shape; like the next four arguments it broadcasts.
        beta: wall damping B T/m.
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, concrete.
        level: half width of the band, between 0 and 1; 0.02 is the usual one.
        excitation: "force" or "impact".
        horizon: samples after which a loop that is not proved to have settled is given up.

    Returns:
        Settling with ``value`` in samples and ``status``, a SettlingStatus.

    Raises:
        ValueError: an argument is outside its range, infinite or NaN, or the excitation is unknown.
        TypeError: the delay is traced.
        RuntimeError: JAX's x64 mode is off.

    Source: the loop of eqs. (1)-(5); 2 % settling is what later papers of the same authors use.
    """
    require_x64()
    check_options(level, excitation, horizon)
    lanes, shape = lanes_of(alpha, beta, gamma, delta, delay)
    first = _settle(
        lanes,
        float(level),
        float(horizon),
        impact=excitation == "impact",
        squarings=ceil(log2(horizon)) + 1,
    ).reshape(shape)
    unstable = verdict(alpha, beta, gamma, delta, delay) == Verdict.UNSTABLE
    unsettled = jnp.where(unstable, SettlingStatus.UNSTABLE, SettlingStatus.NOT_SETTLED)
    status = jnp.where(jnp.isfinite(first), SettlingStatus.SETTLED, unsettled)
    return Settling(first, status.astype(jnp.int8))


def settling_time(
    loop: HapticLoop,
    stiffness: ArrayLike,
    damping: ArrayLike,
    level: float = 0.02,
    *,
    excitation: Excitation = "force",
    horizon: int = HORIZON,
) -> Settling:
    """Return the time in s until the position stays within a band around its final value.

    It is ``settling_samples`` times the sample time; see there for the band and the excitations.
    Goes through vmap. A count of samples jumps between constants, so its derivative means nothing:
    that of ``spectral_radius`` tells how the decay changes.

    Args:
        loop: device, hand, sample time and delay.
        stiffness: K of the wall in N/m, any shape; broadcasts with the damping.
        damping: B of the wall in N s/m.
        level: half width of the band, between 0 and 1; 0.02 is the usual one.
        excitation: "force", a constant push, or "impact", a velocity at the wall.
        horizon: samples after which a loop that is not proved to have settled is given up.

    Returns:
        Settling with ``value`` in s and ``status``, a SettlingStatus.

    Raises:
        ValueError: an argument is outside its range, infinite or NaN, or the excitation is unknown.
        RuntimeError: JAX's x64 mode is off.

    Source: the loop of eqs. (1)-(5), Table I.
    """
    require_x64()
    alpha = loop.alpha(jnp.asarray(checked_gain("stiffness", stiffness), jnp.float64))
    beta = loop.beta(jnp.asarray(checked_gain("damping", damping), jnp.float64))
    scene = (alpha, beta, loop.gamma, loop.delta, loop.delay_samples)
    samples = settling_samples(*scene, level, excitation=excitation, horizon=horizon)
    return Settling(samples.value * loop.sample_time, samples.status)


class Lanes(NamedTuple):
    """Loops side by side, each with the transition of its plant over one sample."""

    alpha: Float64[Array, " lane"]
    beta: Float64[Array, " lane"]
    propagate: Float64[Array, "lane 2 4"]
    line: Float64[Array, "lane whole_delay"]  # 1 where forces wait for a delay, as in Motion


def lanes_of(
    alpha: ArrayLike, beta: ArrayLike, gamma: ArrayLike, delta: ArrayLike, delay: ArrayLike
) -> tuple[Lanes, tuple[int, ...]]:
    """Return the loops of a broadcast grid, in C order, and its shape."""
    delay = checked_delay(delay)
    alpha = jnp.asarray(checked_gain("alpha", alpha), jnp.float64)
    beta = jnp.asarray(checked_gain("beta", beta), jnp.float64)
    whole = np.floor(delay)
    propagate = propagator(gamma, delta, delay - whole, np.ones(1))[..., 0, :, :4]
    longest = int(np.max(whole, initial=0))
    line = jnp.asarray(np.arange(longest) >= (longest - whole)[..., None], jnp.float64)
    shape = jnp.broadcast_shapes(alpha.shape, beta.shape, propagate.shape[:-2], delay.shape)

    def spread(array: Array, own: int) -> Array:
        inner = array.shape[array.ndim - own :]
        return jnp.broadcast_to(array, (*shape, *inner)).reshape((prod(shape), *inner))

    return Lanes(spread(alpha, 0), spread(beta, 0), spread(propagate, 2), spread(line, 1)), shape


def excited(lane: Lanes, *, impact: bool) -> Motion:
    """Return the deviation from the final state at sample 0, per final displacement or velocity."""
    zero, one = jnp.zeros(()), jnp.ones(())
    if impact:
        return Motion(zero, one, zero, zero, jnp.zeros_like(lane.line))
    return Motion(-one, zero, -one, lane.alpha, lane.alpha * lane.line)


def advanced(lane: Lanes, motion: Motion) -> Motion:
    """Return a deviation one sample later."""
    place = lane.line.shape[0] - jnp.sum(lane.line).astype(jnp.int32)
    arriving, line = wall_acts(motion, lane.alpha, lane.beta, place)
    causes = jnp.stack([motion.position, motion.velocity, motion.acting, arriving])
    position, velocity = jnp.sum(lane.propagate * causes, axis=-1)
    return Motion(position, velocity, motion.position, arriving, line)


class _Run(NamedTuple):
    motion: Motion
    time: Array
    peak: Array  # what the band is relative to
    first: Array  # the first sample since when all were inside the band


@partial(jax.jit, static_argnames=("impact", "squarings"))
def _settle(
    lanes: Lanes, level: Array, horizon: Array, *, impact: bool, squarings: int
) -> Float64[Array, " lane"]:
    def settle(lane: Lanes, growth: Array) -> Array:
        def is_proved(run: _Run) -> Array:
            return growth * jnp.max(jnp.abs(_scaled(lane, run.motion))) <= level * run.peak

        def runs(run: _Run) -> Array:
            return jnp.isfinite(growth) & ~is_proved(run) & (run.time < horizon)

        def look(_: Array, run: _Run) -> _Run:
            excursion = jnp.abs(run.motion.position)
            peak = jnp.maximum(run.peak, excursion) if impact else run.peak
            first = jnp.where(excursion > level * peak, run.time + 1.0, run.first)
            return _Run(advanced(lane, run.motion), run.time + 1.0, peak, first)

        zero, one = jnp.zeros(()), jnp.ones(())
        start = _Run(excited(lane, impact=impact), zero, zero if impact else one, zero)
        run = lax.while_loop(runs, lambda run: lax.fori_loop(0, _STRIDE, look, run), start)
        return jnp.where(is_proved(run), run.first, jnp.inf)

    growth, slowness = _in_batches(partial(_growth, squarings), lanes)
    order = jnp.argsort(slowness)  # a batch runs as long as its slowest lane
    sorted_lanes, growth = jax.tree.map(lambda x: x[order], (lanes, growth))
    return jnp.zeros_like(growth).at[order].set(_in_batches(settle, sorted_lanes, growth))


def _growth(squarings: int, lane: Lanes) -> tuple[Array, Array]:
    """Bound the row-sum norm of every power of the loop's transition; infinite if none is < 1.

    The second value is how often the transition was squared before the norm fell below 1.
    """
    size = 4 + lane.line.shape[0]
    step = jax.jacfwd(lambda state: _scaled(lane, advanced(lane, _unscaled(lane, state))))

    def square(
        _: Array, state: tuple[Array, Array, Array, Array]
    ) -> tuple[Array, Array, Array, Array]:
        power, growth, contracts, slowness = state
        norm = jnp.max(jnp.sum(jnp.abs(power), axis=-1))
        contracts = contracts | (norm < 1.0)
        growth = jnp.where(contracts, growth, growth * jnp.maximum(norm, 1.0))
        return power @ power, growth, contracts, slowness + ~contracts

    start = (step(jnp.zeros(size)), jnp.ones(()), jnp.asarray(False), jnp.asarray(0))
    _, growth, contracts, slowness = lax.fori_loop(0, squarings, square, start)
    return jnp.where(contracts, growth, jnp.inf), slowness


def _scaled(lane: Lanes, motion: Motion) -> Array:
    """Return the state in units in which an undamped oscillation is nearly a rotation."""
    rate = _natural_rate(lane)
    difference = motion.position - motion.previous
    small = jnp.stack([motion.velocity, difference, motion.acting])
    return jnp.concatenate([motion.position[None], small / rate, motion.line / rate])


def _unscaled(lane: Lanes, state: Array) -> Motion:
    position, small = state[0], state[1:] * _natural_rate(lane)
    return Motion(position, small[0], position - small[1], small[2], small[3:])


def _natural_rate(lane: Lanes) -> Array:
    """Return about sqrt(alpha + gamma), whatever their signs."""
    return jnp.sqrt(jnp.abs(lane.alpha) + jnp.abs(lane.propagate[1, 0]) + _LEAST_STIFFNESS)


def _in_batches(function: Callable[..., Any], *lanes: Any) -> Any:
    """Apply a function of one lane to all, so many at once that each batch ends by itself."""
    count = jax.tree.leaves(lanes)[0].shape[0]
    if count <= _BATCH:
        return jax.vmap(function)(*lanes)
    places = jnp.arange(-(-count // _BATCH) * _BATCH).reshape((-1, _BATCH)) % count
    batches = jax.tree.map(lambda x: x[places], lanes)
    results = lax.map(lambda batch: jax.vmap(function)(*batch), batches)
    return jax.tree.map(lambda x: x.reshape((-1, *x.shape[2:]))[:count], results)


def check_options(level: float, excitation: str, horizon: int = HORIZON) -> None:
    """Refuse what is no level, excitation or horizon."""
    if not 0.0 < level < 1.0:
        raise ValueError(f"level is {level}; give a number between 0 and 1, such as 0.02.")
    if excitation not in get_args(Excitation):
        raise ValueError(f'excitation is {excitation!r}; give "force" or "impact".')
    if not horizon >= 1:
        raise ValueError(f"horizon is {horizon}; give at least 1 sample.")
