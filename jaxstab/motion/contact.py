"""Contact as it is felt: a one-sided wall, friction, an encoder, saturation. Simulated, not proved.

The wall acts through the sampled controller, so its force is constant between arrivals of forces.
In such a piece, with the velocity's sign s and Coulomb friction f_c, one mass (T = m = 1) obeys

    x'' + delta x' + gamma x = f + push - s f_c,

and with b = f + push - s f_c - gamma x_0 it has the position and the velocity

    x_0 + v_0 S(t) + b Y(t),    v_0 S'(t) + b S(t),

where S is the response to a unit impulse and Y, its integral, that to a unit step. With
w^2 = gamma - delta^2/4, of either sign, the velocity reaches 0 where tan(w t) / w equals
r = v_0 / (v_0 delta/2 - b). There the mass sticks if the other forces are not larger than the
static friction f_s >= f_c, and stays until the force changes; otherwise it turns round.

Pieces are cut to at most 1 / max(delta, sqrt(gamma)). Then S and Y at any time of a piece are power
series of few terms without cancellation. So is t, after the angle is halved twice: r / (1 + sqrt(1
+ w^2 r^2)) is tan(w t / 2) / w, also where w is imaginary. And as a piece is shorter than half a
period, the velocity passes through 0 at most once: two legs are enough, in every run. So one
formulation serves plain numbers, NumPy and XLA, without a loop for each run.

A run is summed up while it is computed: a million runs need the memory of a few tiles. Devices with
more states than one mass are at the end (``Handle``).
"""

from collections.abc import Callable
from math import ceil, sqrt
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import (
    Array,
    is_jax,
    namespace,
    repeat,
    repeat_and_keep,
    repeat_while,
)
from jaxstab.batches import TILE, compiled, lists, on_cores
from jaxstab.exact.turns import segments_of
from jaxstab.model.device import Device
from jaxstab.model.device.mechanics import handle_equations
from jaxstab.motion.response import Controller

FASTEST = 64.0  # max(delta, sqrt(gamma)) that is simulated: as many pieces has a sample
LIMIT = 1e6  # positions and velocities beyond it are given up
SMALLEST_TERM = 1e-18  # of a series
_ARCTAN = tuple((-1.0) ** k / (2 * k + 1) for k in range(13, -1, -1))  # of squares up to 0.066
_MANY = 1 << 19  # runs times samples from which on a program of XLA pays


class Runs(NamedTuple):
    """The parameters of runs, for T = m = 1; arrays of one shape, or plain numbers.

    A resolution of 0 is none. The phase of the encoder is a share of its resolution. A run rests
    while it stays within the tolerance of one place.
    """

    alpha: Array
    beta: Array
    friction: Array
    static_friction: Array
    encoder: Array
    phase: Array
    force_step: Array
    max_force: Array
    push: Array
    position: Array
    velocity: Array
    tolerance: Array


class Summary(NamedTuple):
    """The results of runs; times are in samples.

    low, high: extremes of the position in the last quarter; ``earlier``: in the one before.
    since: from when on the position was within the tolerance of ``place``.
    maxima: how many maxima of the position the last quarter has, the first and the last of them.
    deepest: the largest position; LIMIT where the run passed it and was given up.
    strongest: the largest modulus of the wall's force.
    limited_since: from when on that force was at one of its limits.
    energy: what the wall's force did to the mass.
    """

    low: Array
    high: Array
    earlier_low: Array
    earlier_high: Array
    place: Array
    since: Array
    maxima: Array
    first_maximum: Array
    last_maximum: Array
    deepest: Array
    strongest: Array
    limited_since: Array
    energy: Array

    def with_position(self, x: Array, work: Array, xp: Any) -> "Summary":
        """Note a position that may be an extreme, and what the wall's force did on the way."""
        low, high = xp.minimum(self.low, x), xp.maximum(self.high, x)
        return self._replace(low=low, high=high, energy=self.energy + work)

    def with_maximum(self, is_maximum: Array, time: Array, xp: Any) -> "Summary":
        """Note at what time a maximum was, where there was one."""
        last = xp.where(is_maximum, time, self.last_maximum)
        earliest = xp.where(is_maximum & (self.maxima == 0.0), last, self.first_maximum)
        return self._replace(
            maxima=self.maxima + is_maximum, first_maximum=earliest, last_maximum=last
        )


class Flow(NamedTuple):
    """A piece of a sample: its length, and S, S' and Y at its end."""

    length: Array
    impulse: Array
    slope: Array
    step: Array


class SwitchedMass(NamedTuple):
    """One mass whose force changes in turn.

    gamma, half_damping: of the equation of motion; square: the w^2 above.
    impulse, step: coefficients of S(t) / t and Y(t) / t^2, the highest power first.
    ages: how many samples old the force is in each piece of each sample of a turn.
    flows: these pieces; one more axis, of the fields of ``Flow``.
    oldest: the age of the oldest force that acts.
    """

    gamma: Array
    half_damping: Array
    square: Array
    impulse: Any
    step: Any
    ages: Any
    flows: Any
    oldest: int

    @classmethod
    def from_delays(cls, gamma: float, delta: float, delays: tuple[float, ...]) -> "SwitchedMass":
        """Return the plant; delays in samples, in turn, infinite for a lost sample."""
        fastest = max(delta, sqrt(gamma))
        ages, lengths = pieces(delays, fastest)
        terms = series(gamma, delta, 1.0 / max(fastest, 1.0))
        impulse = lengths * series_at(terms[0], lengths)
        step = lengths**2 * series_at(terms[1], lengths)
        slope = 1.0 - delta * impulse - gamma * step
        return cls(
            gamma,
            0.5 * delta,
            gamma - 0.25 * delta**2,
            *terms,
            ages,
            np.stack([lengths, impulse, slope, step], axis=-1).tolist(),
            max(map(max, ages)),
        )

    def start(self, position: Array, velocity: Array) -> tuple[Array, ...]:
        """Return position and velocity."""
        return position, velocity

    def moved(
        self, runs: Runs, state: tuple[Array, ...], seen: Summary, forces: Any, sample: Any
    ) -> tuple[tuple[Array, ...], Summary]:
        """Return position and velocity at the next sample: two legs for each piece."""
        (x, v), xp, begin = state, functions(runs.alpha), sample
        turn = sample % len(self.ages)
        ages, flows = self.ages[turn], self.flows[turn]
        for piece in range(len(flows)):
            acting, flow = forces[ages[piece]], Flow(*flows[piece])
            others = acting + runs.push - self.gamma * x
            sign, b = _pushed(runs, v, others)
            way = flow.impulse * v + flow.step * b
            speed = flow.slope * v + flow.impulse * b
            turns = sign * speed < 0.0
            if is_jax(turns) or xp.any(turns):
                time = xp.minimum(self._time_to_turn(turns, v, b), flow.length)
                remaining = flow.length - time
                there = time * (v * series_at(self.impulse, time))
                there = there + time * time * (b * series_at(self.step, time))
                _, b = _pushed(runs, 0.0 * v, others - self.gamma * there)
                back = remaining * remaining * (b * series_at(self.step, remaining))
                way = xp.where(turns, there + back, way)
                speed = xp.where(turns, remaining * (b * series_at(self.impulse, remaining)), speed)
                seen = seen.with_position(xp.where(turns, x + there, x), 0.0, xp)
                seen = seen.with_maximum(turns & (sign > 0.0), begin + time, xp)
            x, v, begin = x + way, speed, begin + flow.length
            seen = seen.with_position(x, acting * way, xp)
        return (x, v), seen

    def _time_to_turn(self, turns: Array, v: Array, b: Array) -> Array:
        xp = functions(v)
        time = xp.where(turns, v, 0.0) / xp.where(turns, self.half_damping * v - b, 1.0)
        for _ in range(2):
            time = time / (1.0 + xp.sqrt(1.0 + self.square * time * time))
        return 4.0 * time * series_at(_ARCTAN, self.square * time * time)


def _pushed(runs: Runs, v: Array, others: Array) -> tuple[Array, Array]:
    """Return the direction in which the mass moves, 0 if it sticks, and the b above."""
    xp = functions(runs.alpha)
    slips = xp.where(abs(others) > runs.static_friction, xp.sign(others), 0.0)
    sign = xp.where(v == 0.0, slips, xp.sign(v))
    return sign, xp.where(sign == 0.0, 0.0, others - sign * runs.friction)


def pieces(
    delays: tuple[float, ...], fastest: float
) -> tuple[list[list[int]], Float64[np.ndarray, "turn piece"]]:
    """Return ages of forces and lengths of the pieces of each sample of a turn, none too long."""
    turns = []
    for segments in segments_of(delays):
        turn = []
        for age, begin, end in segments:
            count = max(1, ceil((end - begin) * fastest))
            turn += [(age, (end - begin) / count)] * count
        turns.append(turn)
    most = max(map(len, turns))
    turns = [[*turn, *[(0, 0.0)] * (most - len(turn))] for turn in turns]
    ages = [[age for age, _ in turn] for turn in turns]
    return ages, np.array([[length for _, length in turn] for turn in turns])


def series(
    gamma: Array, delta: Array, longest: float
) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Return the coefficients of S(t) / t and Y(t) / t^2 for times up to the longest.

    Arrays get as many as the largest numbers need, where gamma and delta are up to 1.
    """
    most = 33
    terms, power = [0.0 * gamma, 1.0 + 0.0 * gamma], 1.0

    def is_short() -> bool:
        last = abs(terms[-1]) + abs(terms[-2]) * longest
        return len(terms) < most and bool(np.max(last) > SMALLEST_TERM / power)

    while len(terms) % 4 != 1 or is_short():
        order = len(terms) - 1
        term = -(delta * order * terms[-1] + gamma * terms[-2]) / (order * (order + 1))
        terms.append(term)
        power *= longest
    impulse = terms[1:]
    step = [term / (order + 2) for order, term in enumerate(impulse)]
    return tuple(reversed(impulse)), tuple(reversed(step))


class _PlainNumbers:
    """Functions of a namespace for numbers of Python, with which one run is fastest."""

    minimum, maximum, sqrt, any = min, max, sqrt, bool

    @staticmethod
    def where(condition: bool, value: float, other: float) -> float:
        return value if condition else other

    @staticmethod
    def rint(value: float) -> float:
        whole = 2.0**52  # larger float64 are whole numbers
        return float(round(value)) if abs(value) < whole else value

    @staticmethod
    def sign(value: float) -> float:
        return float((value > 0.0) - (value < 0.0))


def functions(value: Array) -> Any:
    """Return the namespace of an array or a number."""
    return _PlainNumbers if type(value) is float else namespace(value)


Mechanism: TypeAlias = Any
"""The moving device: a ``SwitchedMass``, or a ``Handle``, whose methods have the same meaning."""


class Sides(NamedTuple):
    """The sides on which a wall acts: where the position is positive alone, and if it may pull.

    A wall that is gated by its force is -max(0, K x + B v), wherever the position is.
    """

    one_sided: bool
    pulls: bool
    by_force: bool = False


def contacts(
    plant: Mechanism, controller: Controller, runs: Runs, samples: int, sides: Sides
) -> Summary:
    """Simulate runs, arrays of one length, and sum them up; many by XLA, on all cores."""
    count = len(runs.alpha)
    if count * samples < _MANY:
        with np.errstate(all="ignore"):
            return _summary(plant, controller, runs, samples, sides)
    arrays = plant._replace(ages=np.array(plant.ages), flows=np.array(plant.flows))
    fixed = {"oldest": plant.oldest, "sides": sides}

    def of_tile(tile: tuple[np.ndarray, np.ndarray]) -> Summary:
        members, padded = tile
        own = Runs(*(column[padded] for column in runs))
        summary = _of_tile(arrays, controller, own, samples, **fixed)
        return Summary(*(column[: members.size] for column in summary))

    tile = TILE if isinstance(plant, SwitchedMass) else TILE // 32  # of any device, with its series
    tiles = on_cores(of_tile, list(lists(np.arange(count), tile, TILE // 64)))
    return Summary(*map(np.concatenate, zip(*tiles, strict=True)))


@compiled(static=["oldest", "sides"], many=0, wide=True)
def _of_tile(
    plant: Mechanism, controller: Controller, runs: Runs, samples: Any, *, oldest: int, sides: Sides
) -> Summary:
    return _summary(plant._replace(oldest=oldest), controller, runs, samples, sides)


def _summary(
    plant: Mechanism, controller: Controller, runs: Runs, samples: Any, sides: Sides
) -> Summary:
    step, start = _motion(plant, controller, runs, samples, sides)
    return repeat(samples, lambda state: step(state)[0], start)[-1]


def paths(
    plant: Mechanism, controller: Controller, runs: Runs, samples: int, sides: Sides
) -> tuple[Summary, Float64[np.ndarray, "3 sample *run"]]:
    """Simulate runs, arrays of one shape or plain numbers; also position, velocity and force.

    The force is that computed at the sample.
    """
    step, start = _motion(plant, controller, runs, samples, sides)
    with np.errstate(all="ignore"):
        state, history = repeat_and_keep(samples, step, start)
    return state[-1], np.array(history)


def _motion(
    plant: Mechanism, controller: Controller, runs: Runs, samples: Any, sides: Sides
) -> tuple[Callable[[Any], tuple[Any, tuple[Array, Array, Array]]], Any]:
    """Return the step from sample to sample, and the state at the first one.

    The state: sample, that of the plant, memory of the filters, forces, the newest first, summary.
    A step also gives position, velocity and force at its beginning.
    """
    xp = functions(runs.alpha)
    read, force_at = _wall(controller, runs, sides)
    quarter = samples // 4
    middle, last = samples - 2 * quarter, samples - quarter

    def step(state: Any) -> tuple[Any, tuple[Array, Array, Array]]:
        sample, body, memory, line, was = state
        x, v, *_ = body
        force, memory = force_at(x, memory)
        before = x, v, force
        is_limited = (abs(force) >= runs.max_force) & (force == line[0])
        if isinstance(line, tuple):
            line = (force, *line[:-1])
        else:
            line = xp.concatenate([force[None], line[:-1]])
        is_new = (sample == middle) | (sample == last)  # a quarter of the run
        seen = was._replace(low=x, high=x, maxima=xp.where(is_new, 0.0, was.maxima))
        body, seen = plant.moved(runs, body, seen, line, sample)
        is_near = (abs(body[0]) < LIMIT) & (abs(body[1]) < LIMIT)
        x, *others = (xp.where(is_near, value, 0.0) for value in body)
        x = xp.where(is_near, x, LIMIT)
        low, high = xp.where(is_near, seen.low, LIMIT), xp.where(is_near, seen.high, LIMIT)
        moved = xp.maximum(high - was.place, was.place - low) > runs.tolerance
        now = seen._replace(
            low=xp.where(is_new, low, xp.minimum(was.low, low)),
            high=xp.where(is_new, high, xp.maximum(was.high, high)),
            earlier_low=xp.where(is_new, was.low, was.earlier_low),
            earlier_high=xp.where(is_new, was.high, was.earlier_high),
            place=xp.where(moved, x, was.place),
            since=xp.where(moved, sample + 1.0, was.since),
            deepest=xp.maximum(was.deepest, high),
            strongest=xp.maximum(was.strongest, abs(force)),
            limited_since=xp.where(is_limited, was.limited_since, sample + 1.0),
        )
        return (sample + 1, (x, *others), memory, line, now), before

    x = runs.position
    zero = 0.0 * x
    start = Summary(x, x, x, x, x, zero, zero, zero, zero, x, zero, zero, zero)
    forces: Any = (zero,) * (plant.oldest + 1)
    if is_jax(x):
        forces = xp.stack(forces)
    body = plant.start(x, runs.velocity)
    return step, (0, body, controller.at_rest(read(x)), forces, start)


def _wall(
    controller: Controller, runs: Runs, sides: Sides
) -> tuple[Callable[[Array], Array], Callable[[Array, Any], tuple[Array, Any]]]:
    """The encoder's reading at a position, and the force there with the next memory."""
    xp = functions(runs.alpha)
    is_coarse, is_stepped = runs.encoder > 0.0, runs.force_step > 0.0
    count = xp.where(is_coarse, runs.encoder, 1.0)
    force_unit = xp.where(is_stepped, runs.force_step, 1.0)

    def read(x: Array) -> Array:
        return xp.where(is_coarse, count * (xp.rint(x / count + runs.phase) - runs.phase), x)

    def force_at(x: Array, memory: Any) -> tuple[Array, Any]:
        position = read(x)
        filtered, velocity, memory = controller.step(position, memory)
        force = -(runs.alpha * filtered + runs.beta * velocity)
        if sides.by_force:
            force = xp.minimum(force, 0.0)
        elif sides.one_sided:
            pushed = force if sides.pulls else xp.minimum(force, 0.0)
            force = xp.where(position > 0.0, pushed, 0.0)
        force = xp.where(is_stepped, force_unit * xp.rint(force / force_unit), force)
        return xp.maximum(xp.minimum(force, runs.max_force), -runs.max_force), memory

    return read, force_at


def series_at(coefficients: Any, time: Array) -> Array:
    """Return the value of a polynomial whose highest power comes first."""
    total = coefficients[0]
    for coefficient in coefficients[1:]:
        total = total * time + coefficient
    return total


# Contacts of any linear device with a mass at its handle, and friction there: ``Handle`` is to
# general devices what ``SwitchedMass`` is to one mass.
#
# While a force f of the wall is held, the states z obey z' = A z + w f + h (push - s f_c). The
# handle's velocity v is one of them, s is its sign; its entry of h is 1/m, m the mass at the
# handle.
#
# Where v is 0, the force F on the handle beside friction is m times the velocity's row of A z + w
# f, plus the push. The handle sticks while |F| is at most the static friction. Friction then is -F,
# and the other states obey z' = A z + w f + h (push - F), which is linear, too. Modes and actuators
# go on moving meanwhile, so F changes and the handle may break loose between two samples. A sample
# therefore has several legs, in each of which v has one sign or the handle sticks; a piece of it
# has at most 32, and the last of these goes to the end of the piece.
#
# Pieces of samples are so short that exp(A t) is a power series of few terms, and the states of a
# leg are polynomials in time. A leg ends where v leaves its side of 0, or F the interval of static
# friction; Newton's method in a bracket finds when. It may also leave and return within a leg, so
# one extreme within the leg is checked as well; a second one in a piece of at most 2 rad would be
# missed.

_MOST_LEGS, _MOST_STEPS = 32, 64  # of a piece; of a search for a time


class Handle(NamedTuple):
    """A device whose force changes in turn; its unit of time is a tick.

    series: coefficients of powers of time, the highest first, of the states, of what is watched
        and of the force that pulls beside hand and friction. The columns: states, force of the wall
        and force at the handle, where it slips, and the same once more where it sticks.
    load: the force on the handle beside friction, from such columns.
    at_rest, thrown: states at rest at position 1, and at velocity 1 (``Mechanics``).
    ticks: how many make a sample.
    ages, flows, oldest: as of ``SwitchedMass``; flows are lengths in ticks.
    """

    series: Array
    load: Array
    at_rest: Array
    thrown: Array
    ticks: float
    ages: Any
    flows: Any
    oldest: int

    @classmethod
    def from_device(cls, device: Device, sample_time: float, delays: tuple[float, ...]) -> "Handle":
        """Return a device; delays in samples, in turn. ValueError if no mass is at its handle."""
        most_motion = 2.0  # of a piece, in rad
        matrix, pull, at_rest, thrown, ticks = handle_equations(device, sample_time)
        size, columns = matrix.shape
        load, struck = matrix[1] / matrix[1, -1], matrix[:, -1] / matrix[1, -1]
        rates, whole = np.zeros((2, columns, columns)), np.eye(columns)
        rates[:, :size] = matrix, matrix - np.outer(struck, matrix[1])
        rates[1, :2] = 0.0  # exactly
        rows = np.stack([np.vstack([whole[:size], row, whole[pull]]) for row in (whole[1], load)])
        fastest = ticks * float(np.abs(rates[:, :size, :size]).sum(axis=2).max())  # at most
        ages, lengths = pieces(delays, fastest / most_motion)
        series, term, motion = [rows], 1.0, fastest * lengths.max()
        while term > SMALLEST_TERM:
            series.append(series[-1] @ rates / len(series))
            term *= motion / len(series)
        return cls(
            np.concatenate(np.moveaxis(np.array(series[::-1]), 1, 0), axis=-1),
            load,
            at_rest,
            thrown,
            ticks,
            ages,
            (ticks * lengths).tolist(),
            max(map(max, ages)),
        )

    def start(self, position: Array, velocity: Array) -> tuple[Array, ...]:
        """Return the states at a position and a velocity, per sample."""
        speed = velocity / self.ticks
        x, v, *others = (
            a * position + b * speed for a, b in zip(self.at_rest, self.thrown, strict=True)
        )
        return x, v * self.ticks, *others

    def moved(
        self, runs: Runs, state: tuple[Array, ...], seen: Summary, forces: Any, sample: Any
    ) -> tuple[tuple[Array, ...], Summary]:
        """Return the states at the next sample."""
        x, v, *others = state
        xp, turn = functions(x), sample % len(self.ages)
        states = xp.stack([x, v / self.ticks, *others])
        ages, flows, end = self.ages[turn], self.flows[turn], sample
        for piece in range(len(flows)):
            acting, length = forces[ages[piece]], flows[piece]
            end = end + length / self.ticks

            def leg(moving: Any, acting: Array = acting, end: Any = end) -> Any:
                return self._leg(runs, acting, end, *moving)

            start = (0, length + 0.0 * x, 0.0 * x, states, seen)
            *_, states, seen = repeat_while(
                lambda moving: (moving[0] < _MOST_LEGS) & xp.any(moving[1] > 0.0), leg, start
            )
        x, v, *others = states
        return (x, v * self.ticks, *others), seen

    def _leg(
        self,
        runs: Runs,
        acting: Array,
        end: Array,
        count: Array,
        remaining: Array,
        loose: Array,
        states: Array,
        seen: Summary,
    ) -> Any:
        """Move until the velocity passes 0, a handle that sticks breaks loose, or the piece ends.

        The time left is in ticks; ``loose`` is the direction in which the handle broke loose.
        """
        xp, static = functions(remaining), runs.static_friction
        v = states[1]
        load = xp.tensordot(self.load, _with(states, acting, runs.push), 1)
        slips = xp.where(abs(load) > static, xp.sign(load), loose)
        sign = xp.where(v == 0.0, slips, xp.sign(v))
        sticks = sign == 0.0
        causes = _with(states, acting, runs.push - sign * runs.friction)
        causes = xp.concatenate([xp.where(sticks, 0.0, causes), xp.where(sticks, causes, 0.0)])
        terms = xp.tensordot(self.series, causes, 1)  # (power, state, *run), and two more
        terms, watched, pull = terms[:, :-2], terms[:, -2], terms[:, -1]
        low = xp.where(sticks, -static, xp.where(sign > 0.0, 0.0, -np.inf))
        high = xp.where(sticks, static, xp.where(sign < 0.0, 0.0, np.inf))

        time, value, ends = _exit(watched, low, high, remaining, sticks | (v != 0.0))
        ends = ends & (count < _MOST_LEGS - 1)
        time = xp.where(ends, time, remaining)

        moved = _value(terms, time)
        work = _product(pull, terms[:, 1], time)
        stops, breaks = ends & ~sticks, ends & sticks
        moved = xp.concatenate([moved[:1], xp.where(stops, 0.0, moved[1])[None], moved[2:]])
        remaining = remaining - time
        seen = seen.with_position(moved[0], work, xp)
        seen = seen.with_maximum(stops & (sign > 0.0), end - remaining / self.ticks, xp)
        return count + 1, remaining, xp.where(breaks, xp.sign(value), 0.0), moved, seen


def _with(states: Array, acting: Array, force: Array) -> Array:
    """Return causes: states, the wall's force, a force at the handle."""
    return functions(force).concatenate([states, acting[None], force[None]])


def _value(terms: Array, time: Array) -> Array:
    """The value of ``series_at``; without JAX the terms are added in one call."""
    if is_jax(terms):
        return series_at(terms, time)
    powers = _powers(time, len(terms))
    return (terms * (powers if terms.ndim == powers.ndim else powers[:, None])).sum(axis=0)


def _exponents(count: int, ndim: int) -> Array:
    """Return the exponents of a polynomial's terms, with axes for runs behind."""
    return np.arange(count - 1.0, -1.0, -1.0).reshape(-1, *(1,) * ndim)


def _powers(time: Array, count: int) -> Array:
    """Return the powers of a time that a polynomial's terms multiply."""
    return time ** _exponents(count, time.ndim)


def _exit(
    terms: Array, low: Array, high: Array, length: Array, is_within: Array
) -> tuple[Array, Array, Array]:
    """The time when a polynomial leaves an interval, its value then or soon after, and if it does.

    Where it begins at an end of the interval (not ``is_within``), it moves inwards at first.
    """
    xp = functions(length)

    def is_out(value: Array) -> Array:
        return (value < low) | (value > high)

    slope, end = _slope(terms), _value(terms, length)
    bends = slope[-1] * _value(slope, length) < 0.0
    if not (is_jax(end) or np.any(bends | is_out(end))):
        return length, end, bends
    none = 0.0 * length
    middle = _time_of(slope, none, none, length, bends)
    returns = bends & is_out(_value(terms, middle)) & is_within
    begin, last = xp.where(bends & ~returns, middle, none), xp.where(returns, middle, length)
    value = _value(terms, last)
    leaves = is_out(value)
    limit = xp.where(leaves, xp.where(value > high, high, low), 0.0)
    return _time_of(terms, limit, begin, last, leaves), value, leaves


def _slope(terms: Array) -> Array:
    """Return the derivative of a polynomial."""
    return terms[:-1] * _exponents(len(terms), terms.ndim - 1)[:-1]


def _product(factor: Array, other: Array, time: Array) -> Array:
    """Return the integral of the product of two polynomials up to a time."""
    exponents, powers = _exponents(len(factor), 1), _powers(time, len(factor))
    shares = 1.0 / (exponents + exponents[:, 0] + 1.0)
    inner = functions(factor).tensordot(shares, other * powers, 1)
    return time * (factor * powers * inner).sum(axis=0)


def _time_of(terms: Array, target: Array, low: Array, high: Array, is_open: Array) -> Array:
    """The time when a polynomial passes a target between two times, where the search is open.

    Newton's method, within a bracket that shrinks; a step that leaves it is to its middle.
    """
    close = 2.0**-50  # of a piece: the accuracy of times
    xp = functions(target)
    slope, rises, length = _slope(terms), _value(terms, high) > target, high - low

    def step(search: Any) -> Any:
        count, low, high, time, is_open = search
        value = _value(terms, time) - target
        is_past = (value > 0.0) == rises
        low, high = xp.where(is_past, low, time), xp.where(is_past, time, high)
        after = time - value / _value(slope, time)
        after = xp.where((after >= low) & (after <= high), after, 0.5 * (low + high))
        after = xp.where(is_open, after, time)
        return count + 1, low, high, after, is_open & (abs(after - time) > close * length)

    start = 0, low, high, 0.5 * (low + high), is_open
    return repeat_while(lambda own: (own[0] < _MOST_STEPS) & xp.any(own[-1]), step, start)[3]
