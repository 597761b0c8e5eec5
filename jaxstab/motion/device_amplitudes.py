"""Proved amplitudes of any linear device: lemma M9 of docs/proofs.md.

The sums of moduli are formed as for one mass (``disturbed``), but position and velocity between
samples are bounded from the ends of pieces of the sample, with their second derivatives.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import Numbers, float_arrays, is_traced, named, namespace
from jaxstab.batches import on_host
from jaxstab.model import checked_gain, require_x64
from jaxstab.model.device import Device
from jaxstab.model.device.between import Between, between_samples
from jaxstab.model.device.mechanics import mechanics
from jaxstab.model.filters import Filters
from jaxstab.motion.amplitudes import AmplitudeStatus, WallAmplitude
from jaxstab.motion.contraction import Systems
from jaxstab.motion.controller import Bank
from jaxstab.motion.disturbed import Causes, with_inputs
from jaxstab.motion.impulse import impulse_sums
from jaxstab.motion.state_space import DIFFERENCE, POSITION, bank_for, groups
from jaxstab.numbers import checked

_NUMBERS = 1 << 18  # of the matrices of all loops that are looked at together
_ERROR = 16 * 2.0**-53  # of the entries of a transition, beside that of filters
_SMALLEST = 2.0**-100  # of the largest entry: what entries next to 0 may be wrong by, and more
_SAFETY = 1.0 + 2.0**-40  # on sums of a few bounds

PerLoop = Float64[np.ndarray, " loop"]


class _Plant(NamedTuple):
    """A device with its whole delay, and what the controller runs.

    rows: of the states at the next sample, of states and of two forces.
    """

    rows: Float64[np.ndarray, "state column"]
    between: Between
    whole_delay: int
    bank: Bank

    @property
    def places(self) -> np.ndarray:
        """Where a loop's state has those of the device, the acting force last."""
        states = len(self.rows)
        return np.array([POSITION, *range(DIFFERENCE + 1, states + 1), states + 1])


def device_amplitude(
    device: Device,
    sample_time: float,
    delay: float,
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

    Args:
        device: with its hands and actuators.
        sample_time: T in s.
        delay: in samples.
        filters: estimator and filter in SI units.
        stiffness: K in N/m, any shape; like all others it broadcasts.
        damping: B in N s/m.
        encoder: resolution of the position in m.
        force_step: resolution of the force in N.
        friction: largest force at the handle in N.
        noise: largest error of the position in m, beside that of the resolution.

    Raises:
        ValueError: an argument is negative, infinite or NaN, nothing disturbs the loop, or the
            device does not give way to a constant force.
        TypeError: a filter is traced.
        RuntimeError: JAX arrays are given without x64.
    """
    given = {"encoder": encoder, "force_step": force_step, "friction": friction, "noise": noise}
    require_x64(stiffness, damping, *given.values())
    sizes = float_arrays(*(checked(name, value, 0.0) for name, value in given.items()))
    if not any(is_traced(size) or np.any(size) for size in sizes):
        raise ValueError(f"{', '.join(given)} are all 0; give what disturbs the loop.")
    gains = float_arrays(checked_gain("stiffness", stiffness), checked_gain("damping", damping))
    bank, fraction = bank_for(filters, sample_time), delay % 1.0
    moves = mechanics(device, sample_time, fraction, (1.0,))
    between = between_samples(device, sample_time, fraction)
    plant = _Plant(moves.rows[-1, :, :-1], between, int(delay), bank)
    resolution, step, rubbing, extra = sizes
    lanes = *gains, 0.5 * resolution + extra, 0.5 * step, rubbing
    xp = namespace(gains, sizes)
    grid = xp.broadcast_shapes(*map(np.shape, lanes))
    search = partial(_bounds, plant=plant, sample_time=sample_time)
    x, v, force = on_host(search, *lanes, shape=grid, like=(np.float64,) * 3)
    is_proved = xp.isfinite(x + v + force)
    x, v, force = (xp.where(is_proved, one, xp.inf) for one in (x, v, force))
    status = xp.where(is_proved, AmplitudeStatus.PROVED, AmplitudeStatus.NOT_PROVED)
    direct = bank.outputs[:, POSITION] + bank.outputs[:, DIFFERENCE]
    rate = gains[1] / sample_time
    per_count = resolution * abs(gains[0] * direct[0] + rate * direct[1])
    answers = x, v / sample_time, force, per_count, status.astype(np.int8)
    found = WallAmplitude(*xp.broadcast_arrays(*answers))
    return found._replace(status=named(found.status, AmplitudeStatus))


def _bounds(
    *lanes: np.ndarray, plant: _Plant, sample_time: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return bounds of position, velocity (per sample) and force, infinite where none is proved.

    The lanes: the two gains, and the sizes of the errors of position and force and of friction.
    """
    columns = np.array([np.ravel(lane) for lane in lanes])
    columns[1] = columns[1] / sample_time
    found = np.full((3, columns.shape[1]), np.inf)
    wholes = np.full(columns.shape[1], plant.whole_delay)
    memory = len(plant.rows) - 2 + len(plant.bank.steps)
    is_any = np.ones(columns.shape[1], bool)
    causes = Causes(*(bool(np.any(size)) for size in columns[2:]))
    for _, some in groups(wholes, is_any, memory, _NUMBERS):
        found[:, some] = _bounds_of(columns[:, some], plant, causes)
    x, v, force = (one.reshape(lanes[0].shape) for one in found)
    return x, v, force


def _bounds_of(
    columns: Float64[np.ndarray, "5 loop"], plant: _Plant, causes: Causes
) -> Float64[np.ndarray, "3 loop"]:
    stiffness, damping, *sizes = columns
    systems, direct = _systems(stiffness, damping, plant, causes)
    sums = impulse_sums(systems)
    is_proved = np.isfinite(sums).all(axis=(1, 2))
    sums = np.where(is_proved[:, None, None], sums, 0.0)
    simple = [number for number, cause in enumerate(causes[:2]) if cause]
    totals, path = np.zeros(sums.shape[:2]), np.zeros((2, len(stiffness)))
    for place, number in enumerate(simple):
        totals += (sums[:, :, place] + direct[:, :, number]) * sizes[number][:, None]
    if causes.friction:
        totals += _of_friction(sums[:, :, len(simple) :], plant.between) * sizes[2][:, None]
        path = np.array(plant.between.path)[:, None] * sizes[2]
    found = _at_all_times(_SAFETY * totals, plant.between) + np.stack([*path, 0.0 * path[0]])
    return np.where(is_proved, found, np.inf)


def _at_all_times(
    totals: Float64[np.ndarray, "loop output"], between: Between
) -> Float64[np.ndarray, "3 loop"]:
    """Return bounds at all times by those at the ends of pieces, without friction's last share."""
    ends = totals[:, between.ends].reshape(len(totals), -1, 2, 2, 2)  # end, derivatives, which
    states = totals[:, between.states]  # and the acting force, which the arriving one does not pass
    states = np.concatenate([states, states[:, -1:]], axis=1)
    bent = 0.5 * between.half**2
    rest = np.einsum("pwc,lc->lpw", between.rest, states)
    most = ends.max(axis=2)
    curved = most[:, :, 1] + bent[:, None] * rest
    found = (most[:, :, 0] + bent[:, None] * curved).max(axis=1)
    return _SAFETY * np.stack([*found.T, states[:, -1]])


def _of_friction(
    sums: Float64[np.ndarray, "loop output input"], between: Between
) -> Float64[np.ndarray, "loop output"]:
    """Return the integrals over all times of what unit blows do, at most."""
    ends = between.blows.shape[1]
    half = between.blow_half
    values, curves, rest = sums[..., :ends], sums[..., ends : 2 * ends], sums[..., 2 * ends :]
    bent = (2.0 * half) ** 3 / 12.0
    total = half * (values[..., :-1] + values[..., 1:]).sum(axis=-1)
    total = total + bent * (curves[..., :-1] + curves[..., 1:]).sum(axis=-1)
    total = total + bent * 0.5 * half**2 * (rest * between.blow_rest).sum(axis=-1)
    return np.asarray(_SAFETY * total)


def _systems(
    stiffness: PerLoop, damping: PerLoop, plant: _Plant, causes: Causes
) -> tuple[Systems, Float64[np.ndarray, "loop output 2"]]:
    """Return the loops with inputs: encoder, computed force, and blows; what acts at once, too.

    The outputs are the rows of ``Between``.
    """
    bank, whole, states = plant.bank, plant.whole_delay, len(plant.rows)
    count, between = stiffness.size, plant.between
    rows = np.broadcast_to(plant.rows, (count, *plant.rows.shape))
    tiny = _SMALLEST * np.abs(plant.rows).max()
    step = with_inputs(-stiffness, -damping, rows, bank.outputs, bank.steps, whole)
    size = step.shape[1]
    step[:, DIFFERENCE, size] -= 1.0
    sizes = with_inputs(abs(stiffness), abs(damping), np.abs(rows) + tiny, *bank.sizes, whole)
    sizes[:, DIFFERENCE, [POSITION, size]] += [2.0, 1.0]  # the modulus of -1, for the difference
    outputs, direct = _outputs(step, plant)
    output_sizes, _ = _outputs(sizes, plant, np.abs)
    is_wanted = np.array([True] * size + [*causes[:2]])
    step, sizes = step[:, :, is_wanted], sizes[:, :, is_wanted]
    if causes.friction:
        blows = _blows(between, count, size, states)
        step = np.concatenate([step, blows], axis=2)
        sizes = np.concatenate([sizes, np.abs(blows)], axis=2)
    systems = Systems(
        transition=step[:, :, :size],
        inputs=step[:, :, size:],
        outputs=outputs,
        sizes=sizes,
        output_sizes=output_sizes,
        error=_ERROR + bank.roundings * 2.0**-53,
    )
    return systems, _SAFETY * np.abs(direct)


def _outputs(
    step: np.ndarray, plant: _Plant, part: Callable[[np.ndarray], np.ndarray] = np.asarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return rows of the state, and of the two inputs that act at once."""
    size, places = step.shape[1], plant.places
    first = places[-1]
    known = part(plant.between.rows)
    rows = np.zeros((len(step), len(known), size))
    rows[:, :, places] = known[:, :-1]
    rows += known[:, -1:] * step[:, [first], :size]
    return rows, known[:, -1:] * step[:, [first], size : size + 2]


def _blows(between: Between, count: int, size: int, states: int) -> np.ndarray:
    """Return what unit impulses at the handle do to the state, and each state alone."""
    plant = np.array([POSITION, *range(DIFFERENCE + 1, states + 1)])
    columns = np.concatenate([*between.blows, np.eye(states)]).T
    blows = np.zeros((count, size, columns.shape[1]))
    blows[:, plant] = columns
    blows[:, DIFFERENCE] = columns[0]
    return blows
