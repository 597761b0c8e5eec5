"""The loop in the time domain: exact at its samples and between them.

Between two events (a sample, the arrival of a delayed force) the force is constant, so the plant's
transition is exact there. This route shares the plant with p(z), but neither z nor polynomials.
"""

from functools import lru_cache, reduce
from math import prod
from operator import add, mul
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import Array, Numbers, float_arrays, is_traced, namespace, repeat_and_keep
from jaxstab.batches import compiled
from jaxstab.model import LoopParameters, checked_gain, plant_transition, require_x64
from jaxstab.model.device import Device
from jaxstab.model.device.mechanics import mechanics
from jaxstab.model.filters import Filters, given_filters
from jaxstab.motion.controller import Controller
from jaxstab.motion.shown import Column, answer_text
from jaxstab.numbers import checked, checked_count


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
        """Return the number of loops and times, and the range of each quantity."""
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
) -> Response:
    """Simulate a device, held by a hand, against a virtual wall: ``HapticLoop.simulate``."""
    require_x64(stiffness, damping, force, initial_velocity, initial_position)
    checked_count("samples", samples, 1)
    checked_count("between", between, 0)
    period = loop.sample_time
    values = float_arrays(
        loop.alpha(checked_gain("stiffness", stiffness)),
        loop.beta(checked_gain("damping", damping)),
        checked("force", force) * (period**2 / loop.mass),
        checked("initial_position", initial_position),
        checked("initial_velocity", initial_velocity) * period,
    )
    _require_excitation(*values[2:])
    filters = given_filters(**loop.filters)
    whole, fraction = divmod(loop.delay_samples, 1.0)
    offsets = np.arange(between + 2) / (between + 1)
    *walls, position, velocity = namespace(values).broadcast_arrays(*values)
    propagate = propagator(loop.gamma, loop.delta, fraction, offsets)
    x, v, f = _simulate(
        walls,
        [position, velocity],
        propagate[-1],
        propagate[:-1],
        offsets[:-1] < fraction,
        None if filters is None else Controller.of(filters),
        samples=samples,
        whole_delay=int(whole),
        unilateral=unilateral,
    )
    time = np.arange(x.shape[-1]) * (period / (between + 1))
    return Response(float_arrays(time, x)[0], x, v / period, f * (loop.mass / period**2))


def simulate_device(
    device: Device,
    sample_time: float,
    delay: float,
    filters: Filters | None,
    stiffness: Numbers,
    damping: Numbers,
    *,
    samples: int = 200,
    force: Numbers = 0.0,
    initial_velocity: Numbers = 0.0,
    initial_position: Numbers = 0.0,
    between: int = 0,
    unilateral: bool = False,
) -> Response:
    """Simulate a general device against a virtual wall; see ``HapticLoop.simulate``.

    The hand's force pulls at the handle, behind the actuators. What starts with a velocity was
    thrown by a blow at the handle; what starts displaced stood there, its actuators without force.

    Args:
        device: with its hands and actuators.
        sample_time: T in s.
        delay: in samples.
        filters: estimator and filter in SI units.
        stiffness: K in N/m, any shape; broadcasts with the four other arrays.
        damping: B in N s/m.
        samples: how many samples to simulate.
        force: a step in N.
        initial_velocity: in m/s.
        initial_position: in m.
        between: how many equidistant points to return between two samples.
        unilateral: whether the wall acts only while the sampled position is positive.

    Raises:
        ValueError: an argument is infinite or NaN, nothing moves the device, a count is too small,
            a blow cannot throw the device, or it does not give way to a constant force.
        RuntimeError: JAX arrays are given without x64.
    """
    require_x64(stiffness, damping, force, initial_velocity, initial_position)
    checked_count("samples", samples, 1)
    checked_count("between", between, 0)
    values = float_arrays(
        checked_gain("stiffness", stiffness),
        checked_gain("damping", damping) / sample_time,
        checked("force", force),
        checked("initial_position", initial_position),
        checked("initial_velocity", initial_velocity) * sample_time,
    )
    _require_excitation(*values[2:])
    whole, fraction = divmod(delay, 1.0)
    offsets = np.arange(between + 2) / (between + 1)
    moves = mechanics(device, sample_time, fraction, tuple(offsets.tolist()))
    *walls, position, velocity = namespace(values).broadcast_arrays(*values)
    start = [one * position for one in moves.at_rest]
    if is_traced(velocity) or np.any(velocity):
        if moves.thrown is None:
            raise ValueError(
                "initial_velocity is given, but a blow does not throw this device: its compliance "
                "has not two degrees more in the denominator; give force or initial_position."
            )
        start = [one + k * velocity for one, k in zip(start, moves.thrown, strict=True)]
    x, v, f = _simulate(
        walls,
        start,
        moves.rows[-1],
        moves.seen[:-1],
        offsets[:-1] < fraction,
        None if filters is None else Controller.of(filters, sample_time),
        samples=samples,
        whole_delay=int(whole),
        unilateral=unilateral,
    )
    time = np.arange(x.shape[-1]) * (sample_time / (between + 1))
    return Response(float_arrays(time, x)[0], x, v / sample_time, f)


def propagator(
    gamma: Numbers, delta: Numbers, fraction: Numbers, offsets: Numbers
) -> Float64[Array, "*grid offset 2 5"]:
    """Return position and velocity (rows) at times in [0, 1] after a sample.

    The columns: position and velocity at the sample, the force that acts up to ``fraction``, the
    force that acts from then on, and a force that acts all the time. Propagators of single loops
    are remembered, for one loop is asked about many walls.
    """
    gamma, delta, fraction, offsets = float_arrays(gamma, delta, fraction, offsets)
    loop = gamma, delta, fraction
    if namespace(loop, offsets) is np and not any(value.ndim for value in loop):
        single = float(gamma), float(delta), float(fraction)
        return _propagator_of_one(*single, tuple(offsets.tolist()))
    return _propagator(gamma, delta, fraction, offsets)


def _propagator(gamma: Array, delta: Array, fraction: Array, offsets: Array) -> Array:
    xp = namespace(gamma, delta, fraction, offsets)
    gamma, delta, fraction = (value[..., None] for value in (gamma, delta, fraction))
    late = xp.maximum(offsets - fraction, 0.0)
    times = xp.stack(xp.broadcast_arrays(offsets, late, gamma, delta)[:2])  # one batch is faster
    whole, rest = plant_transition(gamma, delta, times)
    pushed, late = whole[..., 2:], rest[..., 2:]
    return xp.concatenate([whole[..., :2], pushed - late, late, pushed], axis=-1)


@lru_cache(maxsize=64)
def _propagator_of_one(
    gamma: float, delta: float, fraction: float, offsets: tuple[float, ...]
) -> Float64[np.ndarray, "offset 2 5"]:
    loop = np.float64(gamma), np.float64(delta), np.float64(fraction)
    answer: np.ndarray = _propagator(*loop, np.array(offsets))
    answer.flags.writeable = False
    return answer


@compiled(static=["samples", "whole_delay", "unilateral"])
def _simulate(
    walls: list[Array],
    start: list[Array],
    rows: Array,
    seen: Array,
    early: Array,
    controller: Controller | None,
    *,
    samples: int,
    whole_delay: int,
    unilateral: bool,
) -> tuple[Array, Array, Array]:
    """Return position, velocity and force; the times are on the last axis.

    Only the step from sample to sample is a loop; what lies between follows from it at once. The
    first state of the plant is the position. The rows take states, the force that acts up to the
    fraction of the delay, the one from then on, and the one that acts all the time.
    """
    xp = namespace(walls, start, rows)
    if xp is np:
        rows = rows.tolist()
    if xp is np and not walls[0].ndim:  # numbers of Python are several times faster here
        walls, start = [wall.item() for wall in walls], [state.item() for state in start]
    alpha, beta, push = walls

    # The state: that of the plant, what the controller remembers (the position at the last sample,
    # or what filters do), the force at the end of the last hold, and the forces on their way, the
    # next one to arrive first. NumPy and Python are quick with plain tuples.
    def step(state: Any) -> tuple[tuple[Any, ...], tuple[Array, ...]]:
        plant, memory, acting, waiting = state
        x = plant[0]
        if controller is None:
            force = -(alpha * x + beta * (x - memory))
            memory = x
        else:
            filtered, difference, memory = controller.step(x, memory)
            force = -(alpha * filtered + beta * difference)
        if unilateral:
            force = force * (x > 0.0)
        line: tuple[Array, ...] = (*waiting, force)
        arriving = line[0]
        causes = (*plant, acting, arriving, push)
        return (_moved(rows, causes), memory, arriving, line[1:]), causes

    position = start[0]
    rest = 0.0 * position
    memory = position if controller is None else controller.at_rest(position)
    first = (tuple(start), memory, rest, (rest,) * whole_delay)
    _, history = repeat_and_keep(samples, step, first)
    causes = xp.stack([xp.moveaxis(xp.asarray(cause), 0, -1) for cause in history])
    paths = xp.einsum("ork,k...s->r...so", seen, causes)
    held = xp.where(early, causes[-3][..., None], causes[-2][..., None])
    x, v, f = (xp.reshape(path, (*path.shape[:-2], -1)) for path in (*paths, held))
    return x, v, f


def _moved(rows: Any, causes: tuple[Array, ...]) -> tuple[Array, ...]:
    """Return the states of the plant a sample later."""
    if len(causes) == 5:  # one mass, twice as fast so
        x, v, acting, arriving, push = causes
        return tuple(
            [a * x + b * v + c * acting + d * arriving + e * push for a, b, c, d, e in rows]
        )
    return tuple([reduce(add, map(mul, row, causes)) for row in rows])


def _require_excitation(*causes: Array) -> None:
    if not any(is_traced(cause) or np.any(cause) for cause in causes):
        raise ValueError(
            "force, initial_velocity and initial_position are all 0, so nothing moves: give one of "
            "them another value."
        )
