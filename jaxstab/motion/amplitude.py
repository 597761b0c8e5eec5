"""Proved amplitudes: how far an encoder, an amplifier and friction can drive the loop.

The encoder's rounding e makes the loop see x + e, the amplifier's rounding adds to the force, and
friction pushes the device. Only the size of the three is known. The response of a linear loop to
any such disturbance is at most the sum of the moduli of its impulse response, and some disturbance
comes as close to that bound as one likes (lemma M6).
"""

from collections.abc import Callable, Sequence
from decimal import ROUND_CEILING
from functools import partial
from math import ceil
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float64, Int8

from jaxstab.arrays import Array, Numbers, float_arrays, is_traced, named, namespace, take
from jaxstab.batches import alike, on_host
from jaxstab.conventions import Status
from jaxstab.model import checked_delay, checked_gain, require_x64
from jaxstab.model.device import Device, SampledDevice
from jaxstab.model.device.mechanics import Between, between_samples, mechanics
from jaxstab.model.filters import Filter, Filters, Velocity, given_filters
from jaxstab.model.parameters import checked_delta, checked_gamma
from jaxstab.motion.contraction import (
    Contraction,
    Matrices,
    PerLoop,
    Systems,
    columns,
    contraction,
    decay,
    error_of_square,
    norm,
    rounding_in,
    rows,
    transposed,
)
from jaxstab.motion.response import (
    DIFFERENCE,
    POSITION,
    Bank,
    Column,
    answer_text,
    bank_for,
    groups,
    steps_of,
)
from jaxstab.numbers import checked
from jaxstab.rounding import RAISED, RAISED_MANY, TRANSITION, UNIT

# Sums of moduli of impulse responses, |C b| + |C A b| + |C A^2 b| + ..., proved from above.
#
# In coordinates in which every sample is a contraction the errors of products do not grow, so sums,
# their rounding and their tails can be bounded even next to the boundary of stability (lemmas M3 to
# M5 of docs/proofs.md).


_TAIL = 1e-11  # the norm of a power behind which a sum ends
_FURTHER = 6  # doublings until then, at most
_SUMMED = 22  # doublings, beyond which the tail is bounded as it is
_STEEP = 0.5  # the norm of a power above which squaring does not improve the bound of the tail
_TRIED = 20  # such squares
_MATRIX_NUMBERS = 1 << 21  # of an array that is filled at once, about


def impulse_sums(systems: Systems) -> Float64[np.ndarray, "loop output input"]:
    """Return upper bounds of the sums of |C A^k b| over k >= 0; infinite where none is proved."""
    new = contraction(systems)
    sums = np.full((len(new.doublings), new.outputs.shape[1], new.inputs.shape[2]), np.inf)
    with np.errstate(all="ignore"):
        for doublings in np.unique(new.doublings[new.doublings >= 0]).tolist():
            for loops in _blocks(new, doublings):
                sums[loops] = _sums(take(new, loops), doublings)
    return sums


def _blocks(new: Contraction, doublings: int) -> list[np.ndarray]:
    """The loops, cut into blocks whose vectors fill no more memory than they may."""
    alike = np.flatnonzero(new.doublings == doublings)
    longest = 2.0 ** (0.5 * min(doublings + _FURTHER, _SUMMED))
    width = longest * (new.inputs.shape[2] + new.outputs.shape[1])
    count = ceil(len(alike) * new.inputs.shape[1] * width / _MATRIX_NUMBERS)
    return np.array_split(alike, min(count, len(alike)))


def _sums(new: Contraction, doublings: int) -> Float64[np.ndarray, "loop output input"]:
    """Return the bounds of systems whose A was squared equally often."""
    power, error, rounding = new.transition, new.transition_error, rounding_in(new.transition)
    levels: list[tuple[Matrices, PerLoop]] = []
    most = min(doublings + _FURTHER, _SUMMED)
    while len(levels) < most and not (levels and np.all(norm(power) <= _TAIL)):
        levels.append((power, error))
        power, error = power @ power, error_of_square(power, error)
    half = len(levels) // 2
    late = _Family.begun(transposed(new.outputs), new.outputs_error)
    early = _Family.begun(new.inputs, new.inputs_error)
    for level in levels[:half]:
        late = late.doubled(transposed(level[0]), level[1])
    for level in levels[half:]:
        early = early.doubled(*level)
    sums = _sum_of_moduli(late.vectors, early.vectors, new.outputs.shape[1], new.inputs.shape[2])
    sums *= 1.0 + 2.0 ** (len(levels) + 1) * UNIT
    late_size, early_size = late.size[:, :, None], early.size[:, None, :]
    late_error, early_error = late.error[:, :, None], early.error[:, None, :]
    wrong = late_error * (early_size + early_error) + late_size * early_error
    wrong = wrong + rounding[:, None, None] * late_size * early_size
    behind = np.minimum(new.norms, _sum_of_norms(power, error, 2.0 ** len(levels)))
    return sums + RAISED_MANY * (wrong + _tail(new, *levels[-1]) * behind[:, None, None])


def _tail(new: Contraction, power: Matrices, error: PerLoop) -> Float64[np.ndarray, "_ _ _"]:
    """Return bounds of |c A^h| |A^h b| for a power A^h."""
    # Applied from either side, the power leaves only the slow modes of rows and columns.
    norms, error = decay(power, error)[:, None], error[:, None]
    late = rows(new.outputs @ power) + norms * new.outputs_error
    late += error * (rows(new.outputs) + new.outputs_error)
    early = columns(power @ new.inputs) + norms * new.inputs_error
    early += error * (columns(new.inputs) + new.inputs_error)
    return late[:, :, None] * early[:, None, :]


def _sum_of_norms(power: Matrices, error: PerLoop, length: float) -> PerLoop:
    """Return bounds of |1| + |A| + |A^2| + ... by A^length (M4); infinite where none is proved."""
    total = np.full(len(power), np.inf)
    for _ in range(_TRIED):
        size = decay(power, error)
        total = np.where(size < 1.0, np.minimum(total, length / (1.0 - size)), total)
        if np.all(size <= _STEEP):
            break
        power, error, length = power @ power, error_of_square(power, error), 2.0 * length
    return total


class _Family(NamedTuple):
    """Vectors v, A v, A^2 v, ... of several v, the sums of their norms, and of their errors."""

    vectors: Matrices  # side by side, those of one power together
    size: Float64[np.ndarray, "loop vector"]
    error: Float64[np.ndarray, "loop vector"]

    @classmethod
    def begun(cls, vectors: Matrices, error: np.ndarray) -> "_Family":
        return cls(vectors, columns(vectors), error)

    def doubled(self, power: Matrices, error: PerLoop) -> "_Family":
        """The family with twice as many vectors, by a power and a bound of its error (lemma M5)."""
        further = power @ self.vectors
        shape = (*further.shape[:2], -1, self.size.shape[1])
        size = self.size + np.sum(columns(further).reshape(shape[0], *shape[2:]), axis=1)
        added = (error + rounding_in(power) * norm(power))[:, None]
        wrong = self.error * (1.0 + decay(power, error)[:, None]) + added * (self.size + self.error)
        return _Family(np.concatenate([self.vectors, further], axis=2), size, RAISED_MANY * wrong)


def _sum_of_moduli(
    late: Matrices, states: Matrices, outputs: int, inputs: int
) -> Float64[np.ndarray, "loop output input"]:
    """Return the sums of the moduli of all products of an output and of an input."""
    loops, _, width = late.shape
    late = transposed(late)
    total = np.zeros((loops, outputs, inputs))
    length = inputs * max(1, _MATRIX_NUMBERS // (loops * width * inputs))
    for start in range(0, states.shape[2], length):
        terms = np.abs(late @ states[:, :, start : start + length])
        total += terms.reshape(loops, width // outputs, outputs, -1, inputs).sum(axis=(1, 3))
    return total


# Disturbed loops: the effects of errors of encoder and force, and of friction, at all times.
#
# What a unit of each does at the samples is a sum of moduli of an impulse response (lemma M6).
# Position and velocity between samples are bounded from the ends of pieces of the sample, with
# their second derivatives (lemma M9 of docs/proofs.md).

_NUMBERS = 1 << 18  # of the matrices of all loops in one batch
_SMALLEST = 2.0**-100  # of the largest entry: more than the error of entries next to 0


class Bounds(NamedTuple):
    """Bounds of what a disturbance of size 1 does; infinite where none is proved."""

    position: Array
    velocity: Array
    force: Array


Causes = tuple[bool, bool, bool]  # errors of the position, of the computed force, and friction

_LIKE = (Bounds(*[np.float64] * 3),) * 3


class _Plant(NamedTuple):
    """A device with its whole delay, and what the controller runs.

    rows: of the states at the next sample, of states and of two forces.
    """

    rows: Float64[np.ndarray, "state column"]
    between: Between
    whole_delay: int
    bank: Bank

    @classmethod
    def from_device(cls, device: Device, sample_time: float, delay: float, bank: Bank) -> "_Plant":
        """Return a device behind a delay in samples."""
        fraction = delay % 1.0
        rows = mechanics(device, sample_time, fraction, (1.0,)).rows[-1, :, :-1]
        return cls(rows, between_samples(device, sample_time, fraction), int(delay), bank)

    @property
    def places(self) -> np.ndarray:
        """The indices of the device's states in a loop's state, then that of the acting force."""
        states = len(self.rows)
        return np.array([POSITION, *range(DIFFERENCE + 1, states + 1), states + 1])

    def bounds(
        self, stiffness: PerLoop, damping: PerLoop, causes: Causes
    ) -> Float64[np.ndarray, "3 3 loop"]:
        """Return bounds of position, velocity (per sample) and force for each cause of size 1."""
        bounds = np.zeros((3, 3, stiffness.size))
        wholes, is_any = np.full(stiffness.size, self.whole_delay), np.ones(stiffness.size, bool)
        memory = len(self.rows) - 2 + len(self.bank.steps)
        for _, walls in groups(wholes, is_any, memory, _NUMBERS):
            bounds[..., walls] = _bounds(stiffness[walls], damping[walls], self, causes)
        return bounds


Kind = TypeVar("Kind", bound="Amplitude")


class AmplitudeStatus(Status):
    """The status of amplitudes; small integers, so that arrays store int8.

    Example:
        >>> jaxstab.results.AmplitudeStatus(1).words
        'proved: no such disturbance drives the loop further'
    """

    NOT_COMPUTED = 0, "not computed"
    PROVED = 1, "proved: no such disturbance drives the loop further"
    NOT_PROVED = 2, "no bound is proved: the loop is unstable, or too close to the boundary"


class Amplitude(NamedTuple):
    """The most by which disturbances can drive a loop away from its undisturbed motion.

    All are infinite where nothing is proved. Position, velocity and force (of the wall) hold at all
    times; ``force_per_count`` is the jump of the computed force at one count of the encoder.

    Example:
        >>> bounds = jaxstab.amplitude(0.1, 0.4, gamma=0.0, delta=0.001, delay=0.0, encoder=1.0)
        >>> round(float(bounds.position), 2), bounds.status
        (1.03, <AmplitudeStatus.PROVED: 1>)
    """

    position: Float64[Array, "*grid"]
    velocity: Float64[Array, "*grid"]
    force: Float64[Array, "*grid"]
    force_per_count: Float64[Array, "*grid"]
    status: Int8[Array, "*grid"]

    def __repr__(self) -> str:
        return answer_text("Amplitude", self[:4], _COLUMNS, self.status, AmplitudeStatus)


class WallAmplitude(Amplitude):
    """The same in m, m/s and N."""

    def __repr__(self) -> str:
        return answer_text("Amplitude", self[:4], _SI_COLUMNS, self.status, AmplitudeStatus)


_COLUMNS = [
    Column(name.replace("_", " "), rounding=ROUND_CEILING) for name in Amplitude._fields[:4]
]

_SI_COLUMNS = [
    column._replace(unit=unit, factor=factor)
    for column, unit, factor in zip(
        _COLUMNS, ("um", "mm/s", "N", "N"), (10**6, 1000, 1, 1), strict=True
    )
]


def amplitude(
    alpha: Numbers,
    beta: Numbers,
    *,
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    encoder: Numbers = 0.0,
    force_step: Numbers = 0.0,
    friction: Numbers = 0.0,
    noise: Numbers = 0.0,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> Amplitude:
    """Bound what a quantised encoder, a quantised force, friction and noise do to a loop.

    The loop is compared with the same loop without any of these, started and pushed alike. The
    answer bounds how far the two are apart, at all times and not only at the samples. As the
    undisturbed loop comes to rest under a constant push, this bounds the chatter that the hand
    feels in the long run. It holds while the hand is in the wall. Where it is infinite, nothing is
    proved.

    Friction is treated as any force that is never larger than the given one; that it only brakes is
    not used.

    Args:
        alpha, beta, gamma, delta, delay, velocity, position: see ``jaxstab.conventions``.
        encoder: resolution of the encoder, which rounds to the nearest multiple, >= 0, in any unit
            of length U.
        force_step: resolution of the force, which is rounded to the nearest multiple, >= 0, in m
            U/T^2.
        friction: largest Coulomb friction of the device, >= 0, in m U/T^2; it may change at any
            time, between samples too.
        noise: largest error of the sampled position, beside that of the resolution, >= 0, in U.

    Returns:
        Amplitude in U, U/T and m U/T^2. The proof holds for the gains, the plant and the filter
        coefficients as float64 holds them; rounding and the tails of all sums are bounded. It is
        differentiable in the disturbances only.

    Raises: see ``jaxstab.conventions``; ValueError also if nothing disturbs the loop, or JAX
    differentiates by gains or plant.

    Source: the l1 norm of a linear system (Vidyasagar 1986) for the loop of eqs. (1)-(5); lemmas M3
    to M9 of docs/proofs.md.

    Example:
        >>> bounds = jaxstab.amplitude(0.1, 0.4, gamma=0.0, delta=0.001, delay=0.0, encoder=1.0)
        >>> round(float(bounds.position), 2)
        1.03
    """
    require_x64(alpha, beta, gamma, delta)
    delay = checked_delay(delay)
    sizes = _checked_disturbances(encoder, force_step, friction, noise)
    gains = float_arrays(checked_gain("alpha", alpha), checked_gain("beta", beta))
    lanes = *gains, *float_arrays(checked_gamma(gamma), checked_delta(delta)), delay
    bank = bank_for(given_filters(velocity, position))
    search = partial(_of_masses, bank=bank, causes=_causes(sizes))
    grid = namespace(lanes).broadcast_shapes(*map(np.shape, lanes))
    bounds = on_host(search, *lanes, shape=grid, like=_LIKE, is_count=False)
    return _answered(Amplitude, bounds, sizes, gains, bank)


def _of_masses(*lanes: np.ndarray, bank: Bank, causes: Causes) -> tuple[Bounds, Bounds, Bounds]:
    """Return the bounds of loops with alpha, beta, gamma, delta and delay, for m = T = 1."""
    columns = np.array([np.ravel(lane) for lane in lanes])
    bounds = np.zeros((3, 3, columns.shape[1]))
    for members in alike(map(tuple, columns[2:].T.tolist())):
        gamma, delta, delay = columns[2:, members[0]].tolist()
        device = Device.mass_spring_damper(1.0, damping=delta, stiffness=gamma)
        alpha, beta = columns[:2, members]
        plant = _Plant.from_device(device, 1.0, delay, bank)
        bounds[..., members] = plant.bounds(alpha, beta, causes)
    return _in_shape(bounds, lanes[0].shape)


def _in_shape(
    bounds: Float64[np.ndarray, "3 3 loop"], shape: tuple[int, ...]
) -> tuple[Bounds, Bounds, Bounds]:
    position, force, friction = bounds.reshape(3, 3, *shape)
    return Bounds(*position), Bounds(*force), Bounds(*friction)


class _Sizes(NamedTuple):
    """The resolution of the encoder, and the size of each cause."""

    resolution: Array
    causes: tuple[Array, Array, Array]


def _checked_disturbances(
    encoder: Numbers, force_step: Numbers, friction: Numbers, noise: Numbers
) -> _Sizes:
    """The sizes of disturbances, not all of them 0."""
    given = {"encoder": encoder, "force_step": force_step, "friction": friction, "noise": noise}
    require_x64(*given.values())
    sizes = float_arrays(*(checked(name, value, 0.0) for name, value in given.items()))
    if not any(is_traced(size) or np.any(size) for size in sizes):
        raise ValueError(f"{', '.join(given)} are all 0; give what disturbs the loop.")
    resolution, step, rubbing, extra = sizes
    return _Sizes(resolution, (0.5 * resolution + extra, 0.5 * step, rubbing))


def _causes(sizes: _Sizes) -> Causes:
    """Whether each cause is present."""
    position, force, friction = (is_traced(x) or bool(np.any(x)) for x in sizes.causes)
    return position, force, friction


def _answered(
    kind: type[Kind],
    bounds: tuple[Bounds, Bounds, Bounds],
    sizes: _Sizes,
    gains: Sequence[Array],
    bank: Bank,
) -> Kind:
    """The sums of the bounds of all causes, infinite where one is not proved."""
    xp = namespace(bounds, sizes, gains)
    is_proved = xp.isfinite(sum(of_cause.position for of_cause in bounds))
    totals = []
    for of_causes in zip(*bounds, strict=True):  # of the position, the velocity or the force
        finite = (xp.where(is_proved, bound, 0.0) for bound in of_causes)
        total = RAISED * sum(a * b for a, b in zip(sizes.causes, finite, strict=True))
        totals.append(xp.where(is_proved, total, xp.inf))
    status = xp.where(is_proved, AmplitudeStatus.PROVED, AmplitudeStatus.NOT_PROVED)
    direct = bank.outputs[:, POSITION] + bank.outputs[:, DIFFERENCE]
    per_count = sizes.resolution * abs(gains[0] * direct[0] + gains[1] * direct[1])
    answers = kind(*xp.broadcast_arrays(*totals, per_count, status.astype(np.int8)))
    return answers._replace(status=named(answers.status, AmplitudeStatus))


def device_amplitude(
    device: SampledDevice,
    filters: Filters | None,
    stiffness: Numbers,
    damping: Numbers,
    *,
    encoder: Numbers = 0.0,
    force_step: Numbers = 0.0,
    friction: Numbers = 0.0,
    noise: Numbers = 0.0,
) -> WallAmplitude:
    """Bound what disturbances do to a general device, in SI units; see ``HapticLoop.amplitude``.

    Friction acts at the handle, behind the actuators; an amplifier's steps come before them.
    ValueError also if the device has zero DC gain.
    """
    require_x64(stiffness, damping)
    sizes = _checked_disturbances(encoder, force_step, friction, noise)
    gains = float_arrays(checked_gain("stiffness", stiffness), checked_gain("damping", damping))
    sample_time = device.sample_time
    bank, causes = bank_for(filters, sample_time), _causes(sizes)
    plant = _Plant.from_device(device.device, sample_time, device.delay, bank)

    def search(stiffness: np.ndarray, damping: np.ndarray) -> tuple[Bounds, Bounds, Bounds]:
        bounds = plant.bounds(np.ravel(stiffness), np.ravel(damping) / sample_time, causes)
        bounds[:, 1] /= sample_time
        return _in_shape(bounds, stiffness.shape)

    grid = namespace(gains).broadcast_shapes(*map(np.shape, gains))
    bounds = on_host(search, *gains, shape=grid, like=_LIKE, is_count=False)
    per_sample = gains[0], gains[1] / sample_time
    return _answered(WallAmplitude, bounds, sizes, per_sample, bank)


def _bounds(
    stiffness: PerLoop, damping: PerLoop, plant: _Plant, causes: Causes
) -> Float64[np.ndarray, "3 3 loop"]:
    systems, direct = _systems(stiffness, damping, plant, causes)
    sums = impulse_sums(systems)
    is_proved = np.isfinite(sums).all(axis=(1, 2))
    sums = np.where(is_proved[:, None, None], sums, 0.0)
    bounds = np.zeros((3, 3, len(stiffness)))
    present = [k for k, cause in enumerate(causes[:2]) if cause]
    for column, k in enumerate(present):
        bounds[k] = _at_all_times(sums[:, :, column] + direct[:, :, k], plant.between)
    if causes[2]:
        totals = _of_friction(sums[:, :, len(present) :], plant.between)
        within = np.array([*plant.between.path, 0.0])[:, None]
        bounds[2] = _at_all_times(totals, plant.between) + within
    return np.where(is_proved, bounds, np.inf)


def _at_all_times(
    totals: Float64[np.ndarray, "loop output"], between: Between
) -> Float64[np.ndarray, "3 loop"]:
    """Return bounds at all times by those at the ends of pieces, without friction's last share."""
    totals = RAISED * totals
    ends = totals[:, between.ends].reshape(len(totals), -1, 2, 2, 2)  # end, derivatives, which
    states = totals[:, between.states]  # and the acting force, which the arriving one does not pass
    states = np.concatenate([states, states[:, -1:]], axis=1)
    bent = 0.5 * between.half**2
    fourth = np.einsum("pwc,lc->lpw", between.remainder, states)
    most = ends.max(axis=2)
    curved = most[:, :, 1] + bent[:, None] * fourth
    bounds = (most[:, :, 0] + bent[:, None] * curved).max(axis=1)
    return RAISED * np.stack([*bounds.T, states[:, -1]])


def _of_friction(
    sums: Float64[np.ndarray, "loop output input"], between: Between
) -> Float64[np.ndarray, "loop output"]:
    """Return the integrals over all times of what unit blows do, at most."""
    ends = between.blows.shape[1]
    half = between.blow_half
    values, curves, states = sums[..., :ends], sums[..., ends : 2 * ends], sums[..., 2 * ends :]
    bent = (2.0 * half) ** 3 / 12.0
    total = half * (values[..., :-1] + values[..., 1:]).sum(axis=-1)
    total = total + bent * (curves[..., :-1] + curves[..., 1:]).sum(axis=-1)
    total = total + bent * 0.5 * half**2 * (states * between.blow_remainder).sum(axis=-1)
    return np.asarray(RAISED * total)


def _systems(
    stiffness: PerLoop, damping: PerLoop, plant: _Plant, causes: Causes
) -> tuple[Systems, Float64[np.ndarray, "loop output 2"]]:
    """Return the loops with inputs: encoder, computed force, and blows; what acts at once, too.

    The outputs are the rows of ``Between``.
    """
    bank, whole, count = plant.bank, plant.whole_delay, stiffness.size
    rows = np.broadcast_to(plant.rows, (count, *plant.rows.shape))
    tiny = _SMALLEST * np.abs(plant.rows).max()
    step = _with_inputs(-stiffness, -damping, rows, bank.outputs, bank.steps, whole)
    size = step.shape[1]
    step[:, DIFFERENCE, size] -= 1.0
    sizes = _with_inputs(abs(stiffness), abs(damping), np.abs(rows) + tiny, *bank.sizes, whole)
    sizes[:, DIFFERENCE, [POSITION, size]] += [2.0, 1.0]  # the modulus of -1, for the difference
    outputs, direct = _outputs(step, plant)
    output_sizes, _ = _outputs(sizes, plant, np.abs)
    is_wanted = np.array([True] * size + [*causes[:2]])
    step, sizes = step[:, :, is_wanted], sizes[:, :, is_wanted]
    if causes[2]:
        blows = _blows(plant, count, size)
        step = np.concatenate([step, blows], axis=2)
        sizes = np.concatenate([sizes, np.abs(blows)], axis=2)
    systems = Systems(
        transition=step[:, :, :size],
        inputs=step[:, :, size:],
        outputs=outputs,
        sizes=sizes,
        output_sizes=output_sizes,
        error=TRANSITION + bank.roundings * UNIT,
    )
    return systems, RAISED * np.abs(direct)


def _with_inputs(
    alpha: PerLoop,
    beta: PerLoop,
    rows: Matrices,
    outputs: np.ndarray,
    steps: np.ndarray,
    whole_delay: int,
) -> Matrices:
    """Return the steps of loops with two more inputs: the reading error, and an extra push."""
    wall = alpha[:, None] * outputs[0] + beta[:, None] * outputs[1]
    wall = np.column_stack([wall, wall[:, 0] + wall[:, 1], np.ones(len(wall))])
    remembered = np.column_stack([steps, steps[:, 0] + steps[:, 1], np.zeros(len(steps))])
    return steps_of(wall, rows, remembered, whole_delay)


def _outputs(
    step: np.ndarray, plant: _Plant, function: Callable[[np.ndarray], np.ndarray] = np.asarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return rows of the state, and of the two inputs that act at once."""
    size, places = step.shape[1], plant.places
    acting = places[-1]
    between = function(plant.between.rows)
    rows = np.zeros((len(step), len(between), size))
    rows[:, :, places] = between[:, :-1]
    rows += between[:, -1:] * step[:, [acting], :size]
    return rows, between[:, -1:] * step[:, [acting], size : size + 2]


def _blows(plant: _Plant, count: int, size: int) -> np.ndarray:
    """The states after unit impulses at the handle, and each state alone."""
    columns = np.concatenate([*plant.between.blows, np.eye(len(plant.rows))]).T
    blows = np.zeros((count, size, columns.shape[1]))
    blows[:, plant.places[:-1]] = columns
    blows[:, DIFFERENCE] = columns[0]
    return blows
