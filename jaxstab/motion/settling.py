"""How long the sampled loop rings: settling in the time domain, with the tail proved.

The deviation from rest follows s -> A s, in coordinates in which no sample lengthens s (lemma M3 of
docs/proofs.md). Stretches of samples are computed, twice as many each time, until the state is so
short that no later position leaves the tolerance (lemmas M1 and M2). One product of matrices
doubles the states, one squares the power; no eigenvalue is needed, and multiple roots do no harm.
"""

from collections.abc import Callable
from math import ceil, log2
from typing import Any, NamedTuple, get_args

import numpy as np
from jaxtyping import Float64, Int, Int8

from jaxstab.arrays import Array, Numbers, float_arrays, named, namespace, take
from jaxstab.batches import on_host
from jaxstab.conventions import HORIZON, Excitation, Status, Verdict
from jaxstab.model import checked_delay, checked_gain, require_x64
from jaxstab.model.balls import linear_loop
from jaxstab.model.device import SampledDevice
from jaxstab.model.device.mechanics import mechanics
from jaxstab.model.filters import Filter, Filters, Velocity, given_filters
from jaxstab.motion.contraction import (
    Contraction,
    Matrices,
    PerLoop,
    contraction,
    decay,
    error_of_square,
    norm,
    rounding_in,
)
from jaxstab.motion.response import (
    OF_MASS,
    Column,
    Lanes,
    Loops,
    answer_text,
    bank_for,
    groups,
    loops_of,
    propagator,
)
from jaxstab.numbers import checked_count, checked_number, checked_word
from jaxstab.point.verdicts import linear_verdict, verdict
from jaxstab.rounding import RAISED_MANY

# Sampled positions of many loops side by side, in stretches that are doubled by powers of A.

STRETCH = 32  # samples, a power of two
_BLOCK = 64  # stretches of one product, a power of two


def positions(loops: Loops, samples: int) -> Float64[np.ndarray, "loop sample"]:
    """Return the sampled deviations of loops, at least as many as requested."""
    outputs = np.zeros((len(loops.start), 1, loops.start.shape[1]))
    outputs[:, 0, 0] = 1.0
    motion = Motion.begun(outputs, *loops)
    stretches = [motion.latest()]
    computed = motion.samples
    while computed < samples:
        blocks = ceil((samples - computed) / (STRETCH * _BLOCK))
        motion = motion._replace(states=motion.states[:, : blocks * _BLOCK]).doubled()
        stretches.append(motion.latest())
        computed += stretches[-1].shape[1]
    return np.concatenate(stretches, axis=1)


class Motion(NamedTuple):
    """The motion of loops over M stretches of W samples."""

    rows: Float64[np.ndarray, "loop sample state"]  # of the position, times A^i, i < W
    power: Matrices  # A^(MW)
    states: Float64[np.ndarray, "loop stretch state"]  # at the beginning of each stretch

    @classmethod
    def begun(cls, outputs: Matrices, power: Matrices, start: Matrices) -> "Motion":
        """Return the first stretch."""
        rows = outputs
        for _ in range(int(log2(STRETCH))):
            rows = np.concatenate([rows, rows @ power], axis=1)
            power = power @ power
        return cls(rows, power, np.swapaxes(start, 1, 2))

    @property
    def samples(self) -> int:
        """The number of computed samples of each loop."""
        return self.states.shape[1] * STRETCH

    def latest(self) -> Float64[np.ndarray, "loop sample"]:
        """Return the positions in the second half of the stretches; all, if there is but one."""
        states = self.states[:, self.states.shape[1] // 2 :]
        return _mapped(self.rows, states).reshape(len(self.power), -1)

    def doubled(self) -> "Motion":
        """Return twice as many stretches."""
        states = np.concatenate([self.states, _mapped(self.power, self.states)], axis=1)
        return self._replace(power=self.power @ self.power, states=states)


def _mapped(matrices: Matrices, states: np.ndarray) -> Float64[np.ndarray, "loop stretch row"]:
    """Return the products of each loop's matrix and its states."""
    # They are taken in blocks that BLAS does not share out to threads, which for matrices as small
    # as these wait for each other longer than they work.
    loops, stretches, size = states.shape
    blocks = states.reshape(loops, -1, min(stretches, _BLOCK), size)
    return (blocks @ np.swapaxes(matrices, 1, 2)[:, None]).reshape(loops, stretches, -1)


_NUMBERS = 1 << 20  # of an array that loops side by side fill, about


class SettlingStatus(Status):
    """The status of the settling of a loop; small integers, so that arrays store int8.

    Example:
        >>> jaxstab.results.SettlingStatus(1).words
        'settled, and proved to stay so'
    """

    NOT_COMPUTED = 0, "not computed"
    SETTLED = 1, "settled, and proved to stay so"
    UNSTABLE = 2, "the loop is unstable and never settles"
    NOT_SETTLED = 3, "not proved to settle within the horizon"


class Settling(NamedTuple):
    """A settling time and its status.

    It is finite for SETTLED, infinite for UNSTABLE, and NaN where neither could be proved.

    Example:
        >>> jaxstab.settling_samples(0.1, 0.5, gamma=0.0, delta=0.015, delay=0.0)
        Settling: 15 samples (settled)
    """

    value: Float64[Array, "*grid"]
    status: Int8[Array, "*grid"]

    def __repr__(self) -> str:
        columns = [Column("", "samples")]
        return answer_text("Settling", self[:1], columns, self.status, SettlingStatus)


class SettlingTime(Settling):
    """A settling time in s.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> loop.settling_time([1000.0, 1e6], 20.0).status.tolist()
        [1, 2]
    """

    def __repr__(self) -> str:
        columns = [Column("", "ms", 1000)]
        return answer_text("Settling", self[:1], columns, self.status, SettlingStatus)


def settling_samples(
    alpha: Numbers,
    beta: Numbers,
    *,
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    level: float = 0.02,
    excitation: Excitation = "force",
    horizon: int = HORIZON,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> Settling:
    """Count the samples until the position stays within a tolerance of its final value.

    The answer is the first sample from which on every sampled position is within the tolerance. It
    is a whole number taken from the motion itself, unlike an estimate from the spectral radius. The
    motion between samples is not considered. There are two excitations:

    - "force": the hand begins to push with a constant force at sample 0, on a device at rest. The
      tolerance is level times the final displacement F/(K + k), with K P(1) for K if a position
      filter has a gain other than 1. This is the settling time of a step response.
    - "impact": the device hits the wall with some velocity at sample 0, and nothing else pushes it.
      The tolerance is level times the largest sampled excursion, around 0. A general device is at
      rest until a blow at sample 0; if its compliance has one degree more in the denominator, the
      blow moves it at once, and the estimator sees that jump.

    Args:
        alpha, beta, gamma, delta, delay, velocity, position: see ``jaxstab.conventions``.
        level: the tolerance, between 0 and 1; 0.02 is the usual one.
        excitation: "force" or "impact".
        horizon: samples, rounded up to a power of two, after which a loop that is not proved to
            have settled is given up.

    Returns:
        Settling with ``value`` in samples and ``status``, a SettlingStatus. That the loop stays
        settled is proved for the transition of one sample as float64 holds it; positions within
        about 1e-12 of the tolerance may be counted as inside or outside.

    Raises: see ``jaxstab.conventions``; filters and the horizon must be concrete.

    Source: the loop of eqs. (1)-(5); 2 % settling is what later papers of the same authors use;
    lemmas M1 to M3 of docs/proofs.md.

    Example:
        >>> int(jaxstab.settling_samples(0.1, 0.5, gamma=0.0, delta=0.015, delay=0.0).value)
        15
    """
    require_x64(alpha, beta, gamma, delta)
    level = checked_level(level, excitation)
    checked_count("horizon", horizon, 1)
    delay = checked_delay(delay)
    filters = given_filters(velocity, position)
    gains = float_arrays(checked_gain("alpha", alpha), checked_gain("beta", beta))
    propagate = propagator(gamma, delta, delay % 1.0, np.ones(1))[..., 0, :, :4]
    xp, bank = namespace(gains, propagate), bank_for(filters)
    grid = xp.broadcast_shapes(*map(np.shape, gains), propagate.shape[:-2], delay.shape)
    entries = [propagate[..., row, column] for row in (0, 1) for column in range(4)]

    def loops_at(whole: int, alpha: Lanes, beta: Lanes, *entries: Lanes) -> Loops:
        rows = np.moveaxis(np.array(entries).reshape(2, 4, -1), -1, 0)
        return loops_of(alpha, beta, rows, OF_MASS, whole, excitation, bank)

    search = _Settle(loops_at, len(bank.steps), level, horizon, excitation == "impact")
    codes = verdict(
        alpha, beta, gamma=gamma, delta=delta, delay=delay, velocity=velocity, position=position
    )
    is_unstable = xp.asarray(codes == Verdict.UNSTABLE)
    lanes = *gains, *entries, np.floor(delay), ~is_unstable
    return _settled(on_host(search.samples, *lanes, shape=grid, like=np.float64), is_unstable)


def device_settling_samples(
    device: SampledDevice,
    filters: Filters | None,
    stiffness: Numbers,
    damping: Numbers,
    *,
    level: float = 0.02,
    excitation: Excitation = "force",
    horizon: int = HORIZON,
) -> Settling:
    """Count the samples until a general device stays within a tolerance; ``settling_samples``.

    All is in SI units. The hand's force and the blow of an impact act at the handle, behind the
    actuators. ValueError also if the device has zero DC gain.
    """
    require_x64(stiffness, damping)
    level = checked_level(level, excitation)
    checked_count("horizon", horizon, 1)
    gains = float_arrays(checked_gain("stiffness", stiffness), checked_gain("damping", damping))
    bank = bank_for(filters, device.sample_time)
    scales = device.stiffness_unit, device.damping_unit
    alpha, beta = (gain * scale for gain, scale in zip(gains, scales, strict=True))
    codes = linear_verdict(alpha, beta, linear_loop(device, filters))
    xp = namespace(gains)
    is_unstable = xp.asarray(codes == Verdict.UNSTABLE)
    moves = mechanics(device.device, device.sample_time, device.delay % 1.0, (1.0,))

    def loops_at(whole: int, stiffness: Lanes, damping: Lanes) -> Loops:
        rows = moves.rows[-1, :, :-1]
        return loops_of(stiffness, damping, rows, moves.starts, whole, excitation, bank)

    memory = len(moves.rows[-1]) - 2 + len(bank.steps)
    search = _Settle(loops_at, memory, level, horizon, excitation == "impact")
    lanes = gains[0], gains[1] / device.sample_time, np.floor(device.delay), ~is_unstable
    shape = xp.broadcast_shapes(*map(np.shape, gains))
    return _settled(on_host(search.samples, *lanes, shape=shape, like=np.float64), is_unstable)


def _settled(samples: Array, is_unstable: Array) -> Settling:
    """The settling of loops by the proved numbers of samples, NaN where none is proved."""
    xp = namespace(samples, is_unstable)
    unsettled = xp.where(is_unstable, SettlingStatus.UNSTABLE, SettlingStatus.NOT_SETTLED)
    status = xp.where(xp.isfinite(samples), SettlingStatus.SETTLED, unsettled)
    codes = named(status.astype(np.int8), SettlingStatus)
    return Settling(xp.where(is_unstable, np.inf, samples), codes)


def checked_level(level: Any, excitation: str) -> float:
    """The level; ValueError for a bad level or excitation."""
    checked_word("excitation", excitation, get_args(Excitation))
    level = checked_number("level", level, 0.0, 1.0, is_open=True)
    if level == 1.0:
        raise ValueError("level is 1.0; give a number below 1, such as 0.02.")
    return level


class _Search(NamedTuple):
    """A search of several loops, in coordinates in which no sample lengthens their states."""

    loops: Int[np.ndarray, " loop"]
    motion: Motion
    gain: PerLoop  # no less than a position for a state of length 1
    power_error: PerLoop  # of the motion's power
    state_error: PerLoop  # of the last state
    peak: PerLoop  # of the positions: the reference of the tolerance
    since: PerLoop  # the sample from which on all were inside the tolerance

    @classmethod
    def begun(cls, loops: Int[np.ndarray, " loop"], new: Contraction) -> "_Search":
        power, error, zero = new.transition, new.transition_error, np.zeros(len(loops))
        for _ in range(int(log2(STRETCH))):
            power, error = power @ power, error_of_square(power, error)
        motion = Motion.begun(new.outputs, new.transition, new.inputs)
        gain = RAISED_MANY * (norm(new.outputs) + new.outputs_error[:, 0])
        return cls(loops, motion, gain, error, new.inputs_error[:, 0], zero, zero)

    def doubled(self) -> "_Search":
        """The search with twice as many stretches, but for the positions."""
        power, last = self.motion.power, norm(self.motion.states[:, -1:])
        added = (self.power_error + rounding_in(power) * norm(power)) * (last + self.state_error)
        return self._replace(
            motion=self.motion.doubled(),
            power_error=error_of_square(power, self.power_error),
            state_error=RAISED_MANY * (decay(power, self.power_error) * self.state_error + added),
        )

    def searched(self, level: float, is_impact: bool) -> "_Search":
        """The search after the positions in the second half were examined."""
        # A position outside the tolerance may turn out to be inside after a larger one is found.
        # That larger position is itself outside and comes later, so the last position outside stays
        # right.
        size = np.abs(self.motion.latest())
        peak = np.maximum(self.peak, np.max(size, axis=1)) if is_impact else np.ones(len(size))
        outside = size[:, ::-1] > level * peak[:, None]
        last = self.motion.samples - np.argmax(outside, axis=1)
        since = np.where(np.any(outside, axis=1), last, self.since)
        return self._replace(peak=peak, since=since)

    def bound(self) -> PerLoop:
        """Return a bound of all positions from the last stretch on (lemma M1)."""
        return RAISED_MANY * self.gain * (norm(self.motion.states[:, -1:]) + self.state_error)


class _Settle(NamedTuple):
    """The first samples since when loops of any delays are inside the tolerance; NaN for none.

    loops_at: the loops of one whole delay, from their numbers.
    memory: the number of their states beside those of a mass without filters.
    """

    loops_at: Callable[..., Loops]
    memory: int
    level: float
    horizon: int
    is_impact: bool

    def samples(self, *lanes: Array) -> Float64[np.ndarray, "*grid"]:
        """The samples for the numbers of the loops, their whole delays, and whether to search."""
        *numbers, whole_delay, is_hopeful = (np.ravel(lane) for lane in lanes)
        samples = np.full(whole_delay.shape, np.nan)
        for whole, members in groups(whole_delay, is_hopeful, self.memory, _NUMBERS // STRETCH):
            loops = self.loops_at(whole, *(number[members] for number in numbers))
            samples[members] = _first_samples(loops, self.level, self.horizon, self.is_impact)
        return samples.reshape(lanes[0].shape)


def _first_samples(
    loops: Loops, level: float, horizon: int, is_impact: bool
) -> Float64[np.ndarray, " loop"]:
    samples = np.full(len(loops.start), np.nan)
    new = contraction(loops.systems())
    stable = np.flatnonzero(new.doublings >= 0)
    searches = [_Search.begun(stable, take(new, stable))] if stable.size else []
    while searches:
        search = searches.pop().searched(level, is_impact)
        proved = search.bound() <= level * search.peak
        samples[search.loops[proved]] = search.since[proved]
        if search.motion.samples >= horizon or np.all(proved):
            continue
        search = take(search, ~proved)
        blocks = ceil(len(search.loops) * search.motion.samples / _NUMBERS)
        lanes = np.array_split(np.arange(len(search.loops)), blocks)
        searches += [take(search, block).doubled() for block in lanes if block.size]
    return samples
