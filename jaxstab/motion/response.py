"""The loop in the time domain: exact at its samples and between them.

Between two events (a sample, the arrival of a delayed force) the force is constant, so the plant's
transition is exact there. This route shares the plant with p(z), but neither z nor polynomials.

A simulation is a recursion from sample to sample. Its state is that of the plant, the memory of the
controller, the force that acts and the forces on their way; the estimator and the filters run as
difference equations. The motion between two samples is linear in the state at the first of them and
follows for all samples at once. For proofs the same recursion without a hand's push is one matrix
A: the deviation from rest moves by s -> A s (``steps_of``), the controller's share of A being read
off its difference equations, entry by entry, from unit memories.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from decimal import ROUND_HALF_EVEN
from functools import cached_property, lru_cache, reduce
from itertools import accumulate, cycle, zip_longest
from math import ceil, prod
from operator import add, mul
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64

from jaxstab.arrays import (
    Array,
    Numbers,
    are_numbers,
    fixed,
    float_arrays,
    is_any_jax,
    is_traced,
    leaves,
    namespace,
    pytree,
    repeat_and_keep,
    tree_map,
)
from jaxstab.batches import compiled
from jaxstab.conventions import Excitation, Status
from jaxstab.exact.turns import Segments, segments_of
from jaxstab.model import LoopParameters, by_name, checked_gain
from jaxstab.model.device.mechanics import Mechanics, mechanics
from jaxstab.model.filters import NO_FILTERS, Filter, Filters, Stage, Velocity, given_filters
from jaxstab.numbers import checked, checked_count, require_together
from jaxstab.point.poles import closed_loop_poles
from jaxstab.shown import rounded_text

# What the controller runs at each sample: the estimator and the filter as difference equations.
#
# The velocity is a difference over a window, then a chain of filters of low orders; the position
# goes through another chain. The coefficients are those of ``jaxstab.model``, rounded to float64.

Memory = tuple[Array, ...]
Matrices = Float64[np.ndarray, "_ _ _"]


class Equation(NamedTuple):
    """y_k = b_0 u_k + ... + b_n u_(k-n) - a_1 y_(k-1) - ... - a_n y_(k-n).

    There are as many a as b, or none. The memory from sample to sample is the n sums from which the
    next outputs are made (transposed direct form II).
    """

    inputs: tuple[Array, ...]  # b_0 ... b_n
    outputs: tuple[Array, ...]  # a_1 ... a_n

    @classmethod
    def from_stage(cls, stage: Stage) -> "Equation":
        """Return the difference equation of a filter in powers of 1/z."""
        above, (_, *outputs) = stage
        order = max(len(above) - 1, len(outputs))
        inputs = (*above, *[0.0] * (order + 1 - len(above)))
        return cls(inputs, (*outputs, *[0.0] * (order - len(outputs))) if outputs else ())

    def step(self, value: Array, memory: Memory) -> tuple[Array, Memory]:
        """Return the output for an input, and the new memory."""
        first, *waiting = (*memory, 0.0)
        output = first + self.inputs[0] * value
        sums = [later + b * value for later, b in zip(waiting, self.inputs[1:], strict=True)]
        if self.outputs:
            sums = [each - a * output for each, a in zip(sums, self.outputs, strict=True)]
        return output, tuple(sums)

    def at_rest(self, value: Array) -> tuple[Array, Memory]:
        """Return the output for an input that never changed, and the memory then."""
        output = value * (sum(self.inputs) / (1.0 + sum(self.outputs)))
        pairs = zip_longest(self.inputs[1:], self.outputs, fillvalue=0.0)
        shares = [b * value - a * output for b, a in pairs]
        return output, tuple(accumulate(shares[::-1]))[::-1]


Chain = tuple[Equation, ...]


@pytree
@dataclass(frozen=True)
class Controller:
    """A velocity estimator, times T, behind the windowed difference, and a position filter."""

    velocity: Chain
    position: Chain
    window: int = fixed()

    @classmethod
    def from_filters(cls, filters: Filters) -> "Controller":
        """Return the difference equations of an estimator and a filter, in units of one sample."""
        window, behind = filters[0].stages()
        chains = behind, filters[1].stages()
        velocity, position = (tuple(map(Equation.from_stage, chain)) for chain in chains)
        return cls(velocity, position, window)

    @cached_property
    def is_plain(self) -> bool:
        """True for the difference over one sample alone."""
        return not (self.velocity or self.position or self.window > 1)

    def at_rest(self, position: Array) -> Any:
        """The memory after a long rest at one position."""
        past = (position,) * self.window
        if self.is_plain:
            return past
        return past, run(self.velocity, 0.0 * position)[1], run(self.position, position)[1]

    def step(self, position: Array, memory: Any) -> tuple[Array, Array, Any]:
        """Return the filtered position, the velocity times the period, and the new memory."""
        if self.is_plain:
            return position, position - memory[0], (position,)
        past, behind, beside = memory
        difference = (position - past[-1]) / self.window
        velocity, behind = run(self.velocity, difference, behind)
        filtered, beside = run(self.position, position, beside)
        return filtered, velocity, ((position, *past[:-1]), behind, beside)


def run(
    chain: Chain, value: Array, memories: tuple[Memory, ...] | None = None
) -> tuple[Array, tuple[Memory, ...]]:
    """The output of a chain for an input, and its new memory; without one, after a long rest."""
    after = []
    for k, equation in enumerate(chain):
        if memories is None:
            value, memory = equation.at_rest(value)
        else:
            value, memory = equation.step(value, memories[k])
        after.append(memory)
    return value, tuple(after)


# How answers about motions print themselves: the numbers of one loop, the ranges of many.


class Column(NamedTuple):
    """A field of an answer: its label, the unit, the factor to that unit, the rounding."""

    label: str
    unit: str = ""
    factor: int = 1
    rounding: str = ROUND_HALF_EVEN


def answer_text(
    name: str,
    values: Sequence[Numbers],
    columns: Sequence[Column],
    codes: Numbers = None,
    kind: type[Status] | None = None,
) -> str:
    """One line: a name, the values of one loop or the ranges of many, and the status, if any.

    ``values`` are an array for each column; infinite and NaN values are left out.
    """
    fields = (*values,) if kind is None else (*values, codes)
    if not are_numbers(fields):
        return f"{name}{fields}"
    count, is_one = np.size(fields[-1]), np.ndim(fields[-1]) == 0
    words = ", ".join(filter(None, map(_range_text, values, columns)))
    if kind is not None:
        flat = np.ravel(codes)
        counts = {code: np.count_nonzero(flat == code) for code in kind}
        names = (
            f"{'' if is_one else f'{loops} '}{code.name.lower().replace('_', ' ')}"
            for code, loops in counts.items()
            if loops
        )
        status = ", ".join(names) if words or not is_one else kind(int(flat[0])).words
        words = f"{words} ({status})" if words else status
    head = name if is_one or kind is None else f"{name} of {count} loops"
    return f"{head}: {words}"


def _range_text(value: Numbers, column: Column) -> str:
    """A number with label and unit, the range of several, "" where none is finite."""
    shown_digits = 4
    flat = np.ravel(value)
    finite = flat[np.isfinite(flat)]
    if not finite.size:
        return ""
    ends = (
        rounded_text(float(end), shown_digits, column.rounding, factor=column.factor)
        for end in (finite.min(), finite.max())
    )
    return f"{column.label} {' to '.join(dict.fromkeys(ends))} {column.unit}".strip()


class Response(NamedTuple):
    """A motion of the loop: time in s, position in m, velocity in m/s, the wall's force in N.

    The force is the one that acts on the device from this time on, after hold and delay. All arrays
    except ``time`` have the shape of the walls and the initial values, then one axis of time.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> response = loop.simulate(1000.0, 20.0, samples=400, force=1.0)
        >>> round(float(response.position[-1]), 6)  # of 1 N on 1000 N/m
        0.001
        >>> response
        Response of 1 loop at 400 times: 0 to 399 ms, position 0 to 1 mm,
        velocity 0 to 37.23 mm/s, force -1.097 to 0 N
    """

    time: Float64[Array, " time"]
    position: Float64[Array, "*grid time"]
    velocity: Float64[Array, "*grid time"]
    force: Float64[Array, "*grid time"]

    def __repr__(self) -> str:
        times, loops = np.size(self.time), prod(np.shape(self.position)[:-1])
        name = f"Response of {loops} loop{'s' * (loops != 1)} at {times} times"
        return answer_text(name, self, _COLUMNS)


_COLUMNS = [
    Column("", "ms", 1000),
    Column("position", "mm", 1000),
    Column("velocity", "mm/s", 1000),
    Column("force", "N"),
]


def simulate(
    loop: LoopParameters,
    stiffness: Numbers,
    damping: Numbers,
    *,
    samples: int = 200,
    force: Numbers = 0.0,
    initial_velocity: Numbers = 0.0,
    initial_position: Numbers = 0.0,
    between: int = 0,
    unilateral: bool = False,
    delays: tuple[float, ...] | None = None,
) -> Response:
    """Simulate a device, held by a hand, against a virtual wall: ``HapticLoop.simulate``.

    ``delays`` are in samples and take the place of the loop's in turn. The hand's force pulls at
    the handle, behind the actuators. A device with an initial position was at rest there, its
    actuators without force. ValueError also if a blow cannot throw the device, or it has zero DC
    gain.
    """
    starts = {"initial_velocity": initial_velocity, "initial_position": initial_position}
    require_together(stiffness=stiffness, damping=damping, force=force, **starts)
    checked_count("samples", samples, 1)
    checked_count("between", between, 0, 10**8 // samples - 1)
    loop = loop.in_floats()
    period = loop.sample_time
    values = float_arrays(
        checked_gain("stiffness", stiffness),
        checked_gain("damping", damping) / period,
        checked("force", force),
        checked("initial_position", initial_position),
        checked("initial_velocity", initial_velocity) * period,
    )
    if not any(is_traced(cause) or np.any(cause) for cause in values[2:]):
        raise ValueError(
            "force, initial_velocity and initial_position are all 0, so nothing moves: give one of "
            "them another value."
        )
    if delays is not None:
        values = list(map(np.asarray, values))
    *walls, position, velocity = namespace(values).broadcast_arrays(*values)
    offsets = tuple((np.arange(between + 2) / (between + 1)).tolist())
    turns = segments_of((loop.delay_samples,) if delays is None else delays)
    moves, ages = motion_in_turn(loop, turns, offsets)
    x, v, f = _simulate(
        walls,
        _states(moves[0], position, velocity),
        [each.rows[-1] for each in moves],
        np.stack([each.seen[:-1] for each in moves]),
        controller_for(given_filters(**loop.filters)),
        samples=samples,
        ages=ages,
        unilateral=unilateral,
    )
    time = np.arange(x.shape[-1]) * (period / (between + 1))
    return Response(float_arrays(time, x)[0], x, v / period, f)


Ages = tuple[tuple[int, ...], ...]


def motion_in_turn(
    loop: LoopParameters, turns: Sequence[Segments], offsets: tuple[float, ...]
) -> tuple[list[Mechanics], Ages]:
    """The device in each sample of a turn, and the ages of the forces that act there."""
    most = max(2, *map(len, turns))  # two: so that one mass has always five columns
    filled = [(*turn, *[(0, 1.0, 1.0)] * (most - len(turn))) for turn in turns]
    ages, begins, _ = zip(*(zip(*turn, strict=True) for turn in filled), strict=True)
    given = loop.held_device, loop.sample_time
    return [mechanics(*given, own, offsets) for own in begins], ages


def _states(moves: Mechanics, position: Array, velocity: Array) -> list[Array]:
    """The states of a device that stood at a position, and has a velocity."""
    states = [entry * position for entry in moves.at_rest]
    if not is_traced(velocity) and not np.any(velocity):
        return states
    if moves.thrown is None:
        raise ValueError(
            "initial_velocity is given, but a blow does not throw this device: its compliance "
            "has not two degrees more in the denominator; give force or initial_position."
        )
    return [entry + k * velocity for entry, k in zip(states, moves.thrown, strict=True)]


@compiled(static=["samples", "ages", "unilateral"])
def _simulate(
    walls: list[Array],
    start: list[Array],
    rows: list[Array],
    seen: Array,
    controller: Controller,
    *,
    samples: int,
    ages: Ages,
    unilateral: bool,
) -> tuple[Array, Array, Array]:
    """Return position, velocity and force; the times are on the last axis.

    Only the step from sample to sample is a loop; what lies between follows from it at once.
    """
    xp = namespace(walls, start)
    if xp is np:
        rows = [own.tolist() for own in rows]
    if xp is np and not walls[0].ndim:  # numbers of Python are several times faster here
        walls, start = [wall.item() for wall in walls], [state.item() for state in start]
    step, oldest = step_of(rows, ages, controller, walls, unilateral=unilateral)
    position = start[0]
    initial = (tuple(start), controller.at_rest(position), (0.0 * position,) * oldest)
    _, history = repeat_and_keep(samples, step, initial)
    causes = xp.stack([xp.asarray(cause) for cause in history])
    if len(ages) == 1:
        paths = xp.tensordot(seen[0], causes, 1)
    else:
        paths = xp.einsum("sork,ks...->ors...", seen[np.arange(samples) % len(ages)], causes)
    paths = xp.moveaxis(paths, (2, 0), (-2, -1))  # the times within a sample are the last axis
    x, v, f = paths.reshape(*paths.shape[:-2], prod(paths.shape[-2:]))
    return x, v, f


Step = Callable[[Any], tuple[Any, tuple[Array, ...]]]


def step_of(
    rows: list[Any], ages: Ages, controller: Controller, walls: Sequence[Array], *, unilateral: bool
) -> tuple[Step, int]:
    """The step from sample to sample, and the age of the oldest force that acts.

    It gives the next state, and what moves the plant until then. The state: that of the plant, the
    memory of the controller, and the forces that may still act, the newest first.
    """
    alpha, beta, push = walls
    turn = cycle(zip(rows, ages, strict=True))

    # NumPy and Python are quick with plain tuples.
    def step(state: Any) -> tuple[Any, tuple[Array, ...]]:
        plant, memory, line = state
        x = plant[0]
        filtered, difference, memory = controller.step(x, memory)
        force = -(alpha * filtered + beta * difference)
        if unilateral:
            force = force * (x > 0.0)
        line, (own, acting) = (force, *line), next(turn)
        causes = (*plant, *[line[age] for age in acting], push)
        return (_moved(own, causes), memory, line[:-1]), causes

    return step, max(map(max, ages))


def _moved(rows: Any, causes: tuple[Array, ...]) -> tuple[Array, ...]:
    if len(causes) == 5:  # one mass, twice as fast so
        x, v, acting, arriving, push = causes
        return tuple(
            [a * x + b * v + c * acting + d * arriving + e * push for a, b, c, d, e in rows]
        )
    return tuple([reduce(add, map(mul, row, causes)) for row in rows])


# Many walls side by side, without a hand's push: the deviation from rest.

_STRETCH = 32  # samples, a power of two, that follow from one state by rows
_BLOCK = 64  # states of one product, so few that BLAS does not share them out to threads
_NUMBERS = 1 << 20  # of an array that walls side by side fill, about

Lanes = Float64[np.ndarray, " wall"]


def controller_for(filters: Filters | None) -> Controller:
    """The controller of an estimator and a filter; those of plain numbers are remembered."""
    make = Controller.from_filters if is_any_jax(filters) else _remembered_controller
    return make(filters or NO_FILTERS)


_remembered_controller = lru_cache(maxsize=64)(Controller.from_filters)


def deviations(
    loop: LoopParameters, stiffness: Lanes, damping: Lanes, excitation: Excitation, samples: int
) -> Iterator[tuple[slice, Float64[np.ndarray, "wall sample"]]]:
    """The sampled deviations of walls of a loop in plain numbers as they come to rest; in SI units.

    Some walls at a time, as many as memory allows. Positions are in units of the final
    displacement, or of the velocity at an impact. They are those of a simulation, or of powers of
    its step A: of few states and many samples these take less time.
    """
    (moves,), ages = motion_in_turn(loop, segments_of((loop.delay_samples,)), (1.0,))
    rows, oldest = [moves.rows[-1].tolist()], max(*ages[0])
    controller = controller_for(given_filters(**loop.filters))

    def begun(stiffness: Lanes) -> Any:
        if excitation == "impact":
            position, plant, force = 0.0, moves.impact, 0.0 * stiffness
        else:
            position, memory = -1.0, controller.at_rest(1.0)
            force = controller.step(1.0, memory)[0] * stiffness  # less that at rest
            plant = np.where(moves.follows, force[:, None], -moves.at_rest)
        plant = np.broadcast_to(plant, (stiffness.size, len(moves.at_rest)))
        return tuple(plant.T), controller.at_rest(position), (force,) * oldest

    def step_at(stiffness: Array, damping: Array) -> Step:
        walls = stiffness, damping / loop.sample_time, 0.0
        return step_of(rows, ages, controller, walls, unilateral=False)[0]

    states, plant = sum(1 for _ in leaves(begun(stiffness[:1]))), len(moves.at_rest)
    by_steps = max(1, _NUMBERS // samples)  # walls
    together, products = min(by_steps, max(stiffness.size, 1)), plant * (plant + 3)
    of_steps = samples * products * (1.5e-6 / together + 5e-10)  # s a wall, about
    of_powers = (20.0 * states**3 + 2.0 * samples * states) / 3e9
    is_stepped = of_steps < of_powers
    by_powers = max(1, _NUMBERS // (samples + states * (states + _STRETCH)))
    count = by_steps if is_stepped else by_powers
    for first in range(0, stiffness.size, count):
        own = slice(first, first + count)
        walls = stiffness[own], damping[own]
        start = begun(walls[0])
        with np.errstate(all="ignore"):  # unstable walls overflow
            if is_stepped:
                found = _stepped(step_at(*walls), start, samples)
            else:
                step = step_at(*(gain[:, None] for gain in walls))
                found = _by_powers(step, start, samples)
        yield own, found


def _stepped(step: Step, start: Any, samples: int) -> Float64[np.ndarray, "wall sample"]:
    """The first state at the beginning of each step."""

    def seen(state: Any) -> tuple[Any, Array]:
        after, causes = step(state)
        return after, causes[0]

    return np.array(repeat_and_keep(samples, seen, start)[1]).T


def _by_powers(step: Step, start: Any, samples: int) -> Float64[np.ndarray, "wall sample"]:
    """The same by powers of A, the step taken from each unit state."""
    states = np.stack(np.broadcast_arrays(*leaves(start)), axis=-1)[:, None]
    unit_states = iter(np.eye(states.shape[2]))
    after, _ = step(tree_map(lambda _: next(unit_states), start))
    columns = [np.broadcast_to(row, states[:, 0].shape) for row in leaves(after)]
    power = np.stack(columns, axis=1)
    rows = np.zeros_like(states)  # of the position, times A^i
    rows[..., 0] = 1.0
    while rows.shape[1] < _STRETCH:
        rows = np.concatenate([rows, rows @ power], axis=1)
        power = power @ power
    stretches = ceil(samples / _STRETCH)
    while states.shape[1] < stretches:
        later = _mapped(power, states[:, : stretches - states.shape[1]])
        states, power = np.concatenate([states, later], axis=1), power @ power
    return _mapped(rows, states).reshape(len(power), -1)[:, :samples]


def _mapped(matrices: Matrices, states: np.ndarray) -> Float64[np.ndarray, "wall stretch row"]:
    """The products of each wall's matrix and its states."""
    turned = np.swapaxes(matrices, 1, 2)
    blocks = range(0, states.shape[1], _BLOCK)
    return np.concatenate([states[:, k : k + _BLOCK] @ turned for k in blocks], axis=1)


# The slowest mode of the loop, as damping ratio and frequency.


class Oscillation(NamedTuple):
    """The mode of the pole with the largest modulus.

    ``damping_ratio`` is 1 for a mode that creeps without oscillating, 0 on the edge of stability
    and negative where the oscillation grows. ``frequency`` is that of the damped oscillation,
    between 0 and the Nyquist frequency; a pole on the negative axis is at the Nyquist frequency.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> mode = loop.oscillation(20000.0, 20.0)
        >>> print(f"damping ratio {mode.damping_ratio:.3f}, {mode.frequency:.1f} Hz")
        damping ratio 0.109, 77.5 Hz
    """

    damping_ratio: Float64[Array, "*grid"]
    frequency: Float64[Array, "*grid"]


def dominant_mode(
    alpha: Numbers,
    beta: Numbers,
    *,
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> Oscillation:
    """Damping ratio and frequency of the slowest pole z = exp(s), in samples, on a broadcast grid.

    The damping ratio is -Re s / |s|, the frequency |Im s| in rad per sample, at most pi. Near a
    double real pole the companion eigenvalues may split into a pair with a tiny frequency. Source:
    the poles of eq. (9).

    Args and Raises: see ``jaxstab.conventions``.

    Example:
        >>> mode = jaxstab.dominant_mode(0.2, 0.2, gamma=0.0, delta=0.015, delay=0.0)
        >>> round(float(mode.damping_ratio), 4)
        0.1086
    """
    point = alpha, beta, gamma, delta, delay
    return mode_of(closed_loop_poles(**by_name(*point), velocity=velocity, position=position))


def mode_of(poles: Complex128[Array, "*grid degree"]) -> Oscillation:
    """Return damping ratio and frequency in rad per sample of the first pole of each loop."""
    xp, pole = namespace(poles), poles[..., 0]
    with np.errstate(all="ignore"):  # a pole at 0 or at 1
        decay, frequency = -xp.log(abs(pole)), abs(xp.angle(pole))
        return Oscillation(decay / xp.hypot(decay, frequency), frequency)
