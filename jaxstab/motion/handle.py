"""Contacts of any linear device with a mass at its handle, and friction there.

It is to general devices what ``Plant`` of ``jaxstab.motion.contact`` is to one mass.

While a force f of the wall is held, the states z obey z' = A z + w f + h (push - s f_c). The
handle's velocity v is one of them, s is its sign; its entry of h is 1/m, m the mass at the handle.

Where v is 0, the force F on the handle beside friction is m times the velocity's row of A z + w f,
plus the push. The handle sticks while |F| is at most the static friction. Friction then is -F, and
the other states obey z' = A z + w f + h (push - F), which is linear, too. Modes and actuators go on
moving meanwhile, so F changes and the handle may break loose between two samples. A sample
therefore has several legs, in each of which v has one sign or the handle sticks; a piece of it has
at most 32, and the last of these goes to the end of the piece.

Pieces of samples are so short that exp(A t) is a power series of few terms, and the states of a leg
are polynomials in time. A leg ends where v leaves its side of 0, or F the interval of static
friction; Newton's method in a bracket finds when. It may also leave and return within a leg, so one
extreme within the leg is checked as well; a second one in a piece of at most 2 rad would be missed.
"""

from typing import Any, NamedTuple

import numpy as np

from jaxstab.arrays import Array, is_jax, repeat_while
from jaxstab.model.device import Device
from jaxstab.model.device.mechanics import handle_equations
from jaxstab.motion.contact import SMALLEST_TERM, Runs, Seen, functions, pieces, series_at

_MOST_MOTION = 2.0  # of a piece, in rad
_MOST_LEGS, _MOST_STEPS = 32, 64  # of a piece; of a search for a time
_CLOSE = 2.0**-50  # of a piece: the accuracy of times


class Handle(NamedTuple):
    """A device whose force changes in turn; its unit of time is a tick.

    series: coefficients of powers of time, the highest first, of the states, of what is watched
        and of the force that pulls beside hand and friction. The columns: states, force of the wall
        and force at the handle, where it slips, and the same once more where it sticks.
    load: the force on the handle beside friction, from such columns.
    at_rest, thrown: states at rest at position 1, and at velocity 1.
    ticks: how many make a sample.
    ages, flows, oldest: as of ``Plant``; flows are lengths in ticks.
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
        matrix, pull, at_rest, ticks = handle_equations(device, sample_time)
        size, columns = matrix.shape
        load, thrown = matrix[1] / matrix[1, -1], matrix[:, -1] / matrix[1, -1]
        rates, whole = np.zeros((2, columns, columns)), np.eye(columns)
        rates[:, :size] = matrix, matrix - np.outer(thrown, matrix[1])
        rates[1, :2] = 0.0  # exactly
        rows = np.stack([np.vstack([whole[:size], row, whole[pull]]) for row in (whole[1], load)])
        fastest = ticks * float(np.abs(rates[:, :size, :size]).sum(axis=2).max())  # at most
        ages, lengths = pieces(delays, fastest / _MOST_MOTION)
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
        """Return the states of a device at rest that is thrown; the velocity is per sample."""
        speed = velocity / self.ticks
        x, v, *others = (
            a * position + b * speed for a, b in zip(self.at_rest, self.thrown, strict=True)
        )
        return x, v * self.ticks, *others

    def moved(
        self, runs: Runs, state: tuple[Array, ...], seen: Seen, forces: Any, sample: Any
    ) -> tuple[tuple[Array, ...], Seen]:
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
            *_, states, seen = repeat_while(_is_moving, leg, start)
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
        seen: Seen,
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
        seen = seen.with_position(moved[0], xp)._replace(energy=seen.energy + work)
        seen = seen.with_maximum(stops & (sign > 0.0), end - remaining / self.ticks, xp)
        return count + 1, remaining, xp.where(breaks, xp.sign(value), 0.0), moved, seen


def _is_moving(moving: Any) -> Array:
    count, remaining, *_ = moving
    return (count < _MOST_LEGS) & functions(remaining).any(remaining > 0.0)


def _with(states: Array, acting: Array, force: Array) -> Array:
    """Return causes: states, the wall's force, a force at the handle."""
    return functions(force).concatenate([states, acting[None], force[None]])


def _value(terms: Array, time: Array) -> Array:
    """Return what ``series_at`` returns; without JAX the terms are added in one call."""
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
    """Return when a polynomial leaves an interval, its value then or soon after, and if it does.

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
    """Return when a polynomial passes a target between two times, where the search is open.

    Newton's method, within a bracket that shrinks; a step that leaves it is to its middle.
    """
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
        return count + 1, low, high, after, is_open & (abs(after - time) > _CLOSE * length)

    def is_on(search: Any) -> Array:
        return (search[0] < _MOST_STEPS) & xp.any(search[-1])

    return repeat_while(is_on, step, (0, low, high, 0.5 * (low + high), is_open))[3]
