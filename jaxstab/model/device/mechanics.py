"""The motion of a general device under held forces, exact up to the rounding of coefficients.

The encoder's position over the motor's force, (b_1 s^(n-1) + ... + b_n)/(s^n + ... + a_n), and over
the hand's, with c_i, are realised together in the observer's canonical form, in units of one
sample, with the position as its first state:

    x_i' = -a_i x_1 + x_(i+1) + b_i f + c_i h,     x_(n+1) = 0,     f and h the two forces

(c = b where motor, encoder and handle are one point), and each actuator adds its force as a state,
u' = w (input - u). With A of all states and B of the wall's and the hand's force, exp(t [[A, B],
[0, 0]]) is the motion for a time t while both are held. The wall's force changes within the sample,
at the fraction of the delay: what the new force adds by time t is the exponential over t -
fraction, and the old force has the rest. The exponentials are computed in balls, at a precision
that is doubled until every entry is known, and rounded once.

A device in z moves from step to step by exact numbers; the hand's force and blow act there, too.
"""

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from math import ceil, log2, pi
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from jaxstab.model.device.device import Device, in_steps
from jaxstab.model.device.discrete import InSteps, held_steps
from jaxstab.model.device.parts import (
    MassSpringDamper,
    Modes,
    Rational,
    balls_of,
    decided,
    exact,
    flint,
    rational,
    remembered,
    turn,
    working_precision,
)
from jaxstab.model.device.sampling import in_samples, speed_of
from jaxstab.rounding import RAISED

if TYPE_CHECKING:
    from flint import arb, arb_mat, fmpq_mat

_MOST_BITS = 1 << 14


class Mechanics(NamedTuple):
    """A device between samples; x is in m, forces in N, the unit of time is one sample.

    The columns of rows are the states, of which the first one is the position, then the wall's
    forces that act in turn within a sample, and the hand's force, which acts all the time.

    rows: of the states, at times after a sample, the last one at the next sample.
    seen: rows of position, velocity and the wall's force at the same times.
    at_rest: the states of a device at rest at position 1 without a wall's force.
    follows: which states are the forces of actuators; at rest they are the wall's force.
    impact: the states when it hits a wall with some velocity at 0 (``after_impact``).
    thrown: those of an impact with unit velocity; None if a blow cannot throw the device so.
    """

    rows: Float64[np.ndarray, "offset state column"]
    seen: Float64[np.ndarray, "offset 3 column"]
    at_rest: Float64[np.ndarray, " state"]
    follows: np.ndarray
    impact: Float64[np.ndarray, " state"]
    thrown: Float64[np.ndarray, " state"] | None


@lru_cache(maxsize=256)  # delays in turn ask for one each
def mechanics(
    device: Device, sample_time: float, begins: tuple[float, ...], offsets: tuple[float, ...]
) -> Mechanics:
    """The motion of a device at times in [0, 1] after a sample, and when forces begin in it.

    The first one begins at 0; one that begins at 1 does not act.
    """
    if own := in_steps(device):
        return _in_steps(own, round(sample_time / own.step), begins, offsets)

    def asked() -> tuple[tuple["arb", ...], list["arb"], int, list["arb_mat"]]:
        matrix, above, below = equations(device, sample_time)
        give, order = below[0] / above[0], len(below) - 1
        resting = [below[power] - give * above[power] for power in range(order - 1, 0, -1)]
        hit, actuators = after_impact(device, sample_time), matrix.ncols() - 2 - order
        return hit, resting, actuators, [_held(matrix, begins, offset) for offset in offsets]

    hit, resting, actuators, rows = decided(
        asked, most=_MOST_BITS, is_answered=lambda found: all(map(_are_known, found[-1]))
    )
    forces = [0.0] * actuators
    impact = np.array([*map(_float, hit), *forces])
    values = np.array(list(map(_floats, rows)))
    is_thrown = len(hit) > 1 and impact[0] == 0.0 and impact[1] != 0.0
    return Mechanics(
        rows=values[:, :-1],
        seen=_seen(values[:, 0], values[:, -1], begins, offsets),
        at_rest=np.array([1.0, *map(_float, resting), *forces]),
        follows=np.arange(len(impact)) >= len(hit),
        impact=impact,
        thrown=impact / impact[1] if is_thrown else None,
    )


def _held(matrix: "arb_mat", begins: tuple[float, ...], offset: float) -> "arb_mat":
    """Rows of the states, and of the velocity, at a time after a sample."""
    columns = matrix.ncols()
    states = (flint.arb_mat(columns, columns) + 1).tolist()[:-2]
    seen = flint.arb_mat([*states, matrix.tolist()[0]])
    times = [flint.arb(exact(offset) - exact(begin)) for begin in begins if begin <= offset]
    moved = [(seen * (matrix * time).exp()).tolist() for time in times]
    late = [[row[-2] for row in rows] for rows in moved]
    late += [[flint.arb(0)] * len(moved[0])] * (len(begins) + 1 - len(late))
    pushed = ([new - newer for new, newer in pairwise(each)] for each in zip(*late, strict=True))
    rows = zip(moved[0], pushed, strict=True)
    return flint.arb_mat([[*row[:-2], *own, row[-1]] for row, own in rows])


def _seen(
    position: np.ndarray, velocity: np.ndarray, begins: Sequence[float], offsets: Sequence[float]
) -> Float64[np.ndarray, "offset 3 column"]:
    """Rows of position, velocity, and of the force that acts."""
    acting, forces = np.zeros_like(position), len(begins)
    last = np.searchsorted(begins, offsets, side="right") - forces - 2
    acting[np.arange(len(offsets)), last] = 1.0
    return np.stack([position, velocity, acting], axis=1)


@remembered(16)
def after_impact(device: Device, sample_time: float) -> tuple["arb", ...]:
    """The states when the device hits a wall with some velocity, without those of actuators.

    They are the coefficients of the position's numerator over ``below``: of the device on its free
    path, or, where masses are not known, after a unit of the hand's impulse.
    """
    ports, path = device.ports(), _free_path(device)
    above = ports.encoder_by_hand
    if path is not None:
        above = path.numerator * (ports.below / path.denominator)  # it shows no other poles
    return tuple(in_samples(Rational(above, ports.below), sample_time)[0][::-1])


@lru_cache(maxsize=256)
def _free_path(device: Device) -> Rational | None:
    """The encoder's position in s while no force acts, all masses moving at velocity 1 at first.

    None of a transfer function or a state space, whose masses are not known, and of a structure
    that is fixed to the ground.
    """
    body = device.mechanism
    if not isinstance(body, MassSpringDamper | Modes) or body.mass is None:
        return None
    spring = body.stiffness if isinstance(body, MassSpringDamper) else 0.0
    alone = rational([body.mass], [body.mass, body.damping, spring])  # without the hands
    ports, path = device.ports(), alone
    for hand in device.hands:
        arm, (above, below) = hand.dynamics, hand.dynamic_stiffness()
        if not isinstance(arm, MassSpringDamper):
            return None
        push = rational([arm.mass], [1.0])  # on a handle that is held, as the arm arrives
        if hand.grip is not None:
            (grip, _), (own, _) = hand.grip.dynamic_stiffness(), arm.dynamic_stiffness()
            push = push.times(Rational(grip, grip + own))
        # The hand on the path that the body takes alone needs a force; its reaction bends the path.
        needed = alone.times(Rational(above, below)).minus(push)
        path = path.minus(needed.times(Rational(ports.encoder_by_hand, ports.below)))
    return path.reduced()[0]


def _in_steps(
    device: InSteps, count: int, begins: tuple[float, ...], offsets: tuple[float, ...]
) -> Mechanics:
    """The same of a device in z with so many steps a sample."""
    places = count * np.array(offsets)
    steps = np.rint(places).astype(int).tolist()
    if not np.allclose(places, steps, rtol=0.0, atol=1e-6):
        raise ValueError(
            f"the device ({device}) is known at its steps alone, {count} a sample; give a number "
            f"of points between samples with which these are steps, such as {count - 1}."
        )
    held, velocity = held_steps(device)
    size = held.nrows() - 1
    values = []
    for step in steps:
        late = [held ** max(step - round(begin * count), 0) for begin in (*begins, 1.0)]
        pushed = [_of_fractions(new - newer)[:size, size:] for new, newer in pairwise(late)]
        whole = _of_fractions(held**step)[:size]
        values.append(np.hstack([whole[:, :size], *pushed, whole[:, size:]]))
    rows = np.array(values)
    first: Any = [[int(k == 0) for k in range(size + 1)]]
    resting = flint.fmpq_mat((held - held**0).tolist()[:size] + first)
    try:
        at_rest = _of_fractions(resting.solve(flint.fmpq_mat([[0]] * size + [[1]])))[:size, 0]
    except ZeroDivisionError:
        raise ValueError(
            f"the device ({device}) has zero DC gain: its transfer function in z is 0 at z = 1; "
            "give one that moves under a constant force."
        ) from None
    speeds, thrown = np.full_like(rows[:, 0], np.nan), None
    if velocity is not None:
        row = _of_fractions(velocity)[0] * (device.step * count)
        speeds = np.einsum("s,osc->oc", row, rows)
        thrown = np.eye(size)[1] / row[1] if size == 2 and row[1] else None
    blow = count * _of_fractions(held)[:size, size]
    seen = _seen(rows[:, 0], speeds, begins, offsets)
    return Mechanics(rows, seen, at_rest, np.zeros(size, bool), blow, thrown)


def _of_fractions(exact_numbers: "fmpq_mat") -> Float64[np.ndarray, "row column"]:
    return np.array([[int(x.p) / int(x.q) for x in row] for row in exact_numbers.tolist()])


Equations = tuple["arb_mat", list["arb"], list["arb"]]


@remembered(16)
def equations(device: Device, sample_time: float) -> Equations:
    """[[A, B], [0, 0]] for the states, the wall's force and the hand's, time in samples.

    Behind it numerator and denominator of the encoder by the hand's force, all in balls of the
    precision that is set.

    Raises: as ``in_samples``; ValueError also if the hand's constant force does not move it.
    """
    ports = device.ports()
    (by_motor, _), (by_hand, below) = (
        in_samples(Rational(above, ports.below), sample_time)
        for above in (ports.encoder, ports.encoder_by_hand)
    )
    if not by_hand[0] != 0:
        raise ValueError(
            "the device has zero DC gain: its transfer function in s is 0 at s = 0; give one "
            "that moves under a constant force."
        )
    order, actuators = len(below) - 1, len(device.bandwidths)
    size = order + actuators
    wall, hand = size, size + 1
    pull = size - 1 if actuators else wall  # the motor's force
    matrix = flint.arb_mat(size + 2, size + 2)
    for state in range(order):
        matrix[state, 0] = -below[order - 1 - state]
        if state + 1 < order:
            matrix[state, state + 1] = flint.arb(1)
        matrix[state, pull] = by_motor[order - 1 - state]
        matrix[state, hand] = by_hand[order - 1 - state]
    for index, bandwidth in enumerate(device.bandwidths):
        (rate,) = balls_of(turn(bandwidth))
        rate = rate * flint.arb(exact(sample_time))
        state = order + index
        matrix[state, state] = -rate
        matrix[state, state - 1 if index else wall] = rate
    return matrix, by_hand, below


class HandleEquations(NamedTuple):
    """The equations of a device with a mass at its handle, in continuous time, in m and N.

    The unit of time is a tick, in which the fastest pole moves by 1 rad or so. The first states are
    position and velocity.

    matrix: rates of the states, of these, of the wall's force and of the hand's.
    pull: the column of the motor's force.
    at_rest, thrown: the states of a device at rest at position 1 without a wall's force, and at
        velocity 1, as those of ``Mechanics``.
    ticks: how many make a sample, a power of 2.
    """

    matrix: Float64[np.ndarray, "state column"]
    pull: int
    at_rest: Float64[np.ndarray, " state"]
    thrown: Float64[np.ndarray, " state"]
    ticks: float


@lru_cache(maxsize=64)
def handle_equations(device: Device, sample_time: float) -> HandleEquations:
    """Return the equations of a device at its handle.

    ValueError if no mass is there, or its encoder does not show the handle: friction acts there.
    """
    ports = device.ports()
    if (ports.encoder, ports.encoder_by_hand) != (ports.handle, ports.handle_by_hand):
        raise ValueError(
            f"the encoder of the device ({device}) does not show the handle, where friction acts "
            "and contacts are simulated; give modes of one shape at encoder and handle, or use "
            "simulate, settling_time and amplitude."
        )
    with working_precision(1024):
        _, _, below = equations(device, sample_time)
        turns = (2.0 * pi * width * sample_time for width in device.bandwidths)
        fastest = max(2.0 ** speed_of(below), *turns, 1.0)
        ticks = 2.0 ** ceil(log2(fastest))
        tick = sample_time / ticks
        moves = mechanics(device, tick, (0.0,), (0.0,))
        matrix, _, _ = equations(device, tick)
        columns = matrix.ncols()
        if moves.thrown is None or matrix[0, columns - 1] != 0 or not matrix[1, columns - 1] > 0:
            raise ValueError(
                f"the device ({device}) has no mass at its handle, or a negative one, but friction "
                "needs a mass there; give a compliance whose denominator is two degrees higher."
            )
        # The second state of the canonical form is the velocity, less a share of the position.
        there, back = (flint.arb_mat(columns, columns) + 1 for _ in range(2))
        there[1, 0], back[1, 0] = matrix[0, 0], -matrix[0, 0]
        rates = _floats(there * matrix * back)[:-2]
    at_rest = moves.at_rest.copy()
    at_rest[1] = 0.0
    pull = columns - 3 if device.bandwidths else columns - 2
    return HandleEquations(rates, pull, at_rest, moves.thrown, ticks)


def _are_known(matrix: "arb_mat") -> bool:
    """True if each entry is known to 64 bits, or next to 0 compared with the largest of them."""
    balls = matrix.entries()
    least = max((ball.abs_lower() for ball in balls), key=float, default=0.0) * 2.0**-200
    return all(ball.rel_accuracy_bits() >= 64 or ball.abs_upper() <= least for ball in balls)


def _float(ball: "arb") -> float:
    return float(ball.mid())


# The motion of a general device between two samples, for lemma M9 of docs/proofs.md.
#
# Position and velocity are linear in the states at a sample and in the forces. These functionals
# and their second derivatives are known at the ends of pieces of the sample, and their fourth
# derivatives are bounded within the pieces. The effect of a blow at the handle on later states is
# known likewise.


class Between(NamedTuple):
    """A device within a sample; x is in m, forces in N, the unit of time is one sample.

    Columns: the states, the force that acts up to the fraction of the delay, the one from then on.

    Attributes:
        rows: those of all ends.
        ends: indices of the rows of position, velocity and their second derivatives at both ends of
            each piece.
        states: indices of the rows of the states and of the acting force.
        half: half the lengths of the pieces.
        remainder: bounds of the fourth derivatives in each piece, of position and velocity.
        blows: the states a time after a unit impulse at the handle, and their second derivatives,
            at the ends of pieces that are all alike.
        blow_half: half the length of these.
        blow_remainder: bounds of the fourth derivatives of the states, summed over the pieces.
        path: what a force at the handle, never larger than 1, does to position and velocity within
            a sample, at most.
    """

    rows: Float64[np.ndarray, "row column"]
    ends: Int64[np.ndarray, "piece 2 4"]
    states: Int64[np.ndarray, " state"]
    half: Float64[np.ndarray, " piece"]
    remainder: Float64[np.ndarray, "piece 2 column"]
    blows: Float64[np.ndarray, "2 end state"]
    blow_half: float
    blow_remainder: Float64[np.ndarray, " state"]
    path: tuple[float, float]


@lru_cache(maxsize=32)
def between_samples(device: Device, sample_time: float, fraction: float) -> Between:
    """The motion of a device within a sample, for a fraction of the delay."""
    return decided(
        lambda: _between(equations(device, sample_time), fraction),
        most=_MOST_BITS,
        is_answered=lambda found: found[0],
    )[1]


def _between(given: Equations, fraction: float) -> tuple[bool, Between]:
    """The same in balls of the precision that is set, and whether its rows are known."""
    (matrix, _, below), order = given, len(given[2]) - 1
    size, turned = matrix.ncols() - 2, matrix.transpose()
    units = (flint.arb_mat(size + 2, size + 2) + 1).tolist()
    seen = _derivatives(flint.arb_mat(units[:1]), matrix)
    struck = _derivatives(flint.arb_mat(units[-1:]) * turned, turned)

    def rows_at(time: "float | arb", is_late: bool) -> "arb_mat":
        """The position and its derivatives, of states and two forces."""
        since = time - flint.arb(exact(fraction))
        whole = seen * (matrix * flint.arb(time)).exp()
        late = seen * (matrix * since).exp() if is_late else 0 * whole
        pairs = zip(whole.tolist(), late.tolist(), strict=True)
        return flint.arb_mat([[*row[:-2], row[-2] - new[-2], new[-2]] for row, new in pairs])

    def blows_at(time: "float | arb") -> "arb_mat":
        """The states a time after a unit impulse at the handle, and their derivatives."""
        rows = (struck * (turned * flint.arb(time)).exp()).tolist()
        return flint.arb_mat([row[:size] for row in rows])

    rates = [2.0 ** speed_of(below), *(float(-matrix[k, k]) for k in range(order, size))]
    speed = min(max(rates), 24.0)
    pieces = []  # between two times, and whether the wall's force has changed by then
    for start, end, is_late in ((0.0, fraction, False), (fraction, 1.0, True)):
        if start < end:
            times = np.linspace(start, end, ceil(speed * (end - start)) + 1).tolist()
            pieces += [(*ends, is_late) for ends in pairwise(times)]
    # The end of a sample is the beginning of the next one.
    nodes = [
        ((start, is_late), (end % 1.0, is_late and end < 1.0)) for start, end, is_late in pieces
    ]
    rows = {k: rows_at(*k) for k in dict.fromkeys(node for pair in nodes for node in pair)}
    index = dict(zip(rows, np.arange(4 * len(rows)).reshape(-1, 4), strict=True))
    values = [*(_floats(balls)[:4] for balls in rows.values()), np.eye(size + 1, size + 2)]
    remainder = [_sizes(rows_at(_over(start, end), is_late))[4:] for start, end, is_late in pieces]
    count = len(pieces)
    times = [k / count for k in range(count + 1)]
    blows = np.array([_floats(blows_at(time)) for time in times])
    widest = np.array([_sizes(blows_at(_over(*ends))) for ends in pairwise(times)])
    share = 0.5 / count * RAISED
    # The integral of a modulus: that of the chord, and what the second derivative adds.
    chords = share * (abs(blows[:-1, :2, 0]) + abs(blows[1:, :2, 0]))
    path = np.sum(chords + (2.0 * share) ** 3 / 12.0 * widest[:, 2:4, 0], axis=0)
    path[1] += _sizes(blows_at(0.0))[0, 0]
    return all(map(_are_known, rows.values())), Between(
        rows=np.concatenate(values),
        ends=np.array([[index[node] for node in pair] for pair in nodes]),
        states=np.arange(size + 1) + 4 * len(rows),
        half=np.array([0.5 * (end - start) for start, end, _ in pieces]) * RAISED,
        remainder=np.array(remainder),
        blows=np.moveaxis(blows[:, [0, 2]], 1, 0),
        blow_half=share,
        blow_remainder=widest[:, 4].sum(axis=0) * RAISED,
        path=(float(path[0]) * RAISED, float(path[1]) * RAISED),
    )


def _derivatives(row: "arb_mat", matrix: "arb_mat") -> "arb_mat":
    """A row, and its derivatives by time up to the fifth, which exp(matrix time) follows."""
    rows = [row]
    while len(rows) < 6:
        rows.append(rows[-1] * matrix)
    return flint.arb_mat([each.entries() for each in rows])


def _over(start: float, end: float) -> "arb":
    return flint.arb(0.5 * (start + end), 0.5 * (end - start) * RAISED + 2.0**-60)


def _floats(matrix: "arb_mat") -> np.ndarray:
    return np.array([[float(ball.mid()) for ball in row] for row in matrix.tolist()])


def _sizes(matrix: "arb_mat") -> np.ndarray:
    return np.array([[float(abs(ball).upper()) for ball in row] for row in matrix.tolist()])
