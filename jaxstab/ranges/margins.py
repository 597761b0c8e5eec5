"""How far a wall can be changed before it loses stability: in stiffness, damping or delay.

One quantity is changed, starting from a wall that is proved stable. Until the first root reaches
the unit circle no root can have crossed it, so the loop is proved stable that far (lemma B5 of
docs/proofs.md). The delay is changed continuously, through all fractions of a sample.

A gain is doubled until the wall is proved unstable; the first root on the circle along that line is
then bracketed (``proofs.exclusion.search``). A delay has no such end, but only the angles at which
|D| = |N| |H| for some fraction of a sample matter: at other angles no delay, however long, brings a
root onto the circle. These angles are enclosed first (``exclude_any_delay``), and stretches of more
delay are searched at them alone.
"""

from collections.abc import Callable
from decimal import ROUND_CEILING, ROUND_FLOOR
from functools import partial
from math import ceil, inf, nan, pi
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Int8, Int64

from jaxstab.arrays import Array, Numbers, are_numbers, float_arrays, is_jax, namespace, take
from jaxstab.conventions import AXES, Verdict
from jaxstab.model import by_name, checked_delta, checked_gain, checked_gamma, require_x64
from jaxstab.model.filters import Filter, Filters, Velocity, as_keywords, known_filters
from jaxstab.model.loop import refuses_loops
from jaxstab.model.parameters import LONGEST_DELAY
from jaxstab.numbers import checked, without_noise
from jaxstab.point import verdict
from jaxstab.proofs.exclusion import (
    Exclusion,
    FirstRoots,
    LineBoxes,
    Lines,
    Loops,
    exclude_any_delay,
    first_roots,
)
from jaxstab.ranges.box import ParameterBox, Proof, excluded
from jaxstab.rounding import EPS, LOWERED
from jaxstab.shown import number_text, table_text

# From stable walls to the first root on the unit circle, when one quantity is changed.

Walls = Float64[np.ndarray, "wall 5"]

Column = Float64[np.ndarray, " wall"]

MOST_DELAY = 1024.0  # samples: longer extra delays are not tried
_ALPHA, _BETA, _DELAY = (AXES.index(name) for name in ("alpha", "beta", "delay"))
GAIN_WAYS = ((_ALPHA, -1.0), (_ALPHA, 1.0), (_BETA, -1.0), (_BETA, 1.0))
WAYS = (*GAIN_WAYS, (_DELAY, 1.0))

"""The axes along which a wall is changed, and the signs."""

_ANGLES_AT_ONCE = 8192  # of walls: their boxes, four for each at first, stay in the cache
_ANGLES, _ANGLES_PER_TURN = 16, 4  # boxes of theta at first, for half a turn of the root
_FIRST_STEP = 2.0**-10  # of a gain, in units of the dimensionless parameters
_DOUBLINGS, _DOUBLINGS_AT_ONCE = 48, 8
_DELAY_ANGLES = 32  # boxes at first, for half a turn
_FRACTIONS = np.array([0.0, 0.5, 1.0])  # of a sample, at which boxes end at first
_FINER = 8  # boxes of angles where these are not free
_COARSE = np.array([2.0**-4, 2.0**-10])  # half the size of boxes of fractions, angles / pi
_FINE = np.array([2.0**-12, 2.0**-16])  # where the first stretch of delay was free
_MOST_ANGLES = 2000  # such boxes of a wall at once
_TOUCHING = 1e-9
_LONGER = 4.0  # each stretch of delay than the one before


class Crossings(NamedTuple):
    """Steps within which no root reaches the circle, and the angles of the roots that then do."""

    step: Column
    angle: Column


def first_crossings(
    walls: Walls, filters: Filters | None = None
) -> Float64[np.ndarray, "wall column"]:
    """The verdict on each wall and then, each way of ``WAYS``, a step and an angle.

    Within the signed step no root reaches the circle; the step of the delay is infinite if no root
    ever does. The angle is that of the root which reaches the circle, in units of pi. Both are NaN
    for a wall that is not proved stable.
    """
    counts = _angle_counts(walls)
    parts = np.linspace(0, counts.sum(), ceil(counts.sum() / _ANGLES_AT_ONCE) + 1)
    ends = np.searchsorted(np.cumsum(counts), parts[1:-1])

    def ways(stable: Walls) -> list[Crossings]:
        return [*_along_gains(stable, filters), _along_delay(stable, filters)]

    tables = [
        crossings_table(block, _verdicts(block.T[:2], block, filters), ways)
        for block in np.split(walls, ends)
    ]
    return np.concatenate(tables)


def crossings_table(
    walls: Float64[np.ndarray, "wall number"],
    codes: np.ndarray,
    ways: Callable[[Float64[np.ndarray, "stable number"]], list[Crossings]],
) -> Float64[np.ndarray, "wall column"]:
    """The verdicts on walls and their crossings; ``ways`` returns those of stable walls."""
    table = np.full((len(walls), 1 + 2 * len(WAYS)), nan)
    table[:, 0], stable = codes, np.asarray(codes) == Verdict.STABLE
    if stable.any():
        columns = [column for way in ways(walls[stable]) for column in way]
        table[stable, 1:] = np.stack(columns, axis=-1)
    return table


def _verdicts(
    gains: Float64[np.ndarray, "2 *wall"], walls: Walls, filters: Filters | None
) -> np.ndarray:
    codes: np.ndarray = verdict(**by_name(*gains, *_plants(walls)), **as_keywords(filters))
    return codes


def _plants(walls: Walls) -> Float64[np.ndarray, "3 *wall"]:
    """Gamma, delta and delay of walls, once if they are those of all: quicker to prove."""
    plants = walls.T[2:]
    return plants[:, 0] if len(walls) and np.all(plants == plants[:, :1]) else plants


def _along_gains(walls: Walls, filters: Filters | None) -> list[Crossings]:
    def verdicts(gains: np.ndarray, wall: np.ndarray) -> np.ndarray:
        return _verdicts(gains, walls[wall], filters)

    def roots(start: np.ndarray, change: np.ndarray) -> FirstRoots:
        others = np.zeros((3, change.shape[1]))
        lines = Lines(np.concatenate([start, np.tile(walls.T[2:], 4)]), np.vstack([change, others]))
        return first_roots(lines, _all_angles(walls, len(GAIN_WAYS)), filters)

    return along_gains(walls.T[:2], (_FIRST_STEP, _DOUBLINGS), verdicts, roots)


def along_gains(
    gains: Float64[np.ndarray, "2 wall"],
    doubling: tuple[float, int],
    verdicts: Callable[[np.ndarray, np.ndarray], np.ndarray],
    roots: Callable[[np.ndarray, np.ndarray], FirstRoots],
) -> list[Crossings]:
    """How far stable walls (alpha, beta) may go each way of the gains.

    ``doubling`` is the least first step, and the number of steps, each twice as long as the one
    before. ``verdicts`` returns the codes of other gains of walls, given by their indices,
    ``roots`` the first roots on lines from walls, by their starts and changes.
    """
    axes, signs = (np.array(column) for column in zip(*GAIN_WAYS, strict=True))
    least, count = doubling
    start = np.maximum(least, 0.5 * np.abs(gains[axes]))
    length = np.full(start.shape, inf)
    for doubled in range(0, count, _DOUBLINGS_AT_ONCE):
        way, wall = np.nonzero(length == inf)
        if not way.size:
            break
        steps = np.outer(2.0 ** np.arange(doubled, doubled + _DOUBLINGS_AT_ONCE), start[way, wall])
        others = np.repeat(gains[:, None, wall], _DOUBLINGS_AT_ONCE, axis=1)
        others[axes[way], :, np.arange(way.size)] += (signs[way] * steps).T
        is_unstable = verdicts(others, wall) == Verdict.UNSTABLE
        length[way, wall] = np.min(np.where(is_unstable, steps, inf), axis=0)
    length = np.minimum(length, 2.0 ** (count - 1) * start)
    change = np.zeros((2, *length.shape))
    change[axes, np.arange(len(axes))] = signs[:, None] * length
    crossing = roots(np.tile(gains, len(axes)), change.reshape(2, -1))
    low, angle = (x.reshape(length.shape) for x in (crossing.low, crossing.theta / pi))
    step = signs[:, None] * (np.minimum(low, 1.0) * length * LOWERED)
    return [Crossings(*way) for way in zip(step, angle, strict=True)]


def _all_angles(walls: Walls, ways: int) -> LineBoxes:
    """Boxes of all angles of lines, the real roots in the middle of the first and last."""
    count = np.tile(_angle_counts(walls), ways)
    line = np.repeat(np.arange(count.size), count + 1)
    index = np.arange(line.size) - np.repeat(np.cumsum(count + 1) - count - 1, count + 1)
    ends = pi * (index + np.array([[-0.5], [0.5]])) / count[line]
    low, high = np.stack(np.broadcast_arrays([[0.0], [1.0]], ends), axis=1)
    return LineBoxes(line, low, high)


def _angle_counts(walls: Walls) -> Int64[np.ndarray, " wall"]:
    return _ANGLES + _ANGLES_PER_TURN * (1 + np.floor(walls[:, _DELAY]).astype(np.int64))


def _along_delay(walls: Walls, filters: Filters | None) -> Crossings:
    def roots(angles: LineBoxes, begin: Column, length: Column) -> FirstRoots:
        change = np.zeros((len(AXES), len(walls)))
        change[_DELAY] = length
        start = walls.T.copy()
        start[_DELAY] += begin
        return first_roots(Lines(start, change), _in_pieces(angles, length), filters)

    def critical(numbers: Int64[np.ndarray, " chosen"], is_fine: bool) -> LineBoxes:
        smallest = _FINE if is_fine else _COARSE
        return critical_angles(numbers, _FRACTIONS, prove, smallest, _MOST_ANGLES)

    prove = partial(_proof, walls, partial(exclude_any_delay, filters=filters))
    return first_delays(len(walls), critical, roots)


def first_delays(
    count: int,
    critical: Callable[[Int64[np.ndarray, " chosen"], bool], LineBoxes],
    roots: Callable[[LineBoxes, Column, Column], FirstRoots],
    longest: Callable[[LineBoxes], Column | float] = lambda angles: inf,
) -> Crossings:
    """How much longer the delay of ``count`` stable walls may become, up to ``MOST_DELAY``.

    ``critical`` returns the angles at which some delay may put a root of chosen walls on the
    circle, coarse or fine; ``roots`` the first roots at such angles along stretches of more delay,
    from the beginning and the length of each; ``longest`` the largest length of a stretch.
    """
    angles = critical(np.arange(count), False)
    begin, angle = np.zeros(count), np.full(count, nan)
    # Within about one turn of the phase at a critical angle a root meets the circle.
    highest = np.full(count, -inf)
    np.maximum.at(highest, angles.line, angles.high[1])
    stretch = np.where(highest > 0.0, 2.0 * pi / np.where(highest > 0.0, highest, 1.0), MOST_DELAY)
    step = np.full(count, inf)
    is_open = highest > -inf
    while is_open.any():
        open_angles = take(angles, (..., is_open[angles.line]))
        length = np.minimum(np.minimum(stretch, MOST_DELAY - begin), longest(open_angles))
        crossing = roots(open_angles, begin, length)
        crosses = np.isfinite(crossing.low)
        share = np.where(crosses, crossing.low, 0.0)
        step = np.where(crosses, begin + length * share * LOWERED, step)
        angle = np.where(crosses, crossing.theta / pi, angle)
        is_open &= ~crosses & (begin + length < MOST_DELAY)
        if not begin.any() and is_open.any():
            angles = critical(np.flatnonzero(is_open), True)
            is_open &= np.isin(np.arange(count), angles.line)
        begin, stretch = begin + length, _LONGER * stretch
    return Crossings(step, angle)


def critical_angles(
    numbers: Int64[np.ndarray, " chosen"],
    ends: Float64[np.ndarray, " end"],
    prove: Callable[[ParameterBox], Proof],
    smallest: Float64[np.ndarray, "2"],
    most: int,
) -> LineBoxes:
    """The angles at which some delay may put a root of chosen walls on the circle.

    ``prove`` takes boxes of theta / pi and of fractions of the delay, between two of the ``ends``
    each, indexed by walls; it proves that no delay does, however many whole samples are added. They
    are halved down to the half-widths ``smallest``, up to ``most`` of them at once for a wall.
    """
    middles, half = (np.arange(_DELAY_ANGLES) + 0.5) / _DELAY_ANGLES, 0.5 / _DELAY_ANGLES
    grid = np.meshgrid(numbers, np.arange(len(ends) - 1), middles, indexing="ij")
    wall, piece, angle = (column.ravel() for column in grid)
    low, high = ends[piece], ends[piece + 1]
    fractions = 0.5 * (low + high), 0.5 * (high - low)
    boxes = ParameterBox.from_axes(wall, fraction=fractions, angle=(angle, half))
    boxes = _finer_angles(boxes.select(~prove(boxes).free))
    return joined_angles(boxes.paved(prove, smallest, most_each=most).boxes)


def joined_angles(boxes: ParameterBox) -> LineBoxes:
    """The angles of boxes of fractions of the delay and theta / pi, indexed by walls."""
    wall = boxes.index
    middle, half = (pi * angle for angle in boxes["angle"])
    low, high = middle - half, middle + half
    order = np.lexsort((low, wall))
    wall, low, high = wall[order], low[order], high[order]
    # Intervals that touch are joined.
    ends, rank = np.unique(high, return_inverse=True)
    high = ends[np.maximum.accumulate(rank + ends.size * wall) - ends.size * wall]
    is_apart = (np.diff(wall) > 0) | (low[1:] > high[:-1] + _TOUCHING)
    is_start = np.append(True, is_apart)[: wall.size]
    is_end = np.append(is_apart, True)[: wall.size]
    ends = np.stack([low[is_start] - _TOUCHING, high[is_end] + _TOUCHING])
    whole = np.repeat([[0.0], [1.0]], is_start.sum(), axis=1)
    return LineBoxes(wall[is_start], *np.stack([whole, ends], axis=1))


def _finer_angles(boxes: ParameterBox) -> ParameterBox:
    """Divide the angles of boxes at once into as many as most of them need."""
    finer = boxes.select(np.repeat(np.arange(boxes.count), _FINER))
    angle, half = finer["angle"]
    half = half / _FINER
    angle = angle + np.tile(2.0 * np.arange(_FINER) + 1.0 - _FINER, boxes.count) * half
    return ParameterBox.from_axes(finer.index, fraction=finer["fraction"], angle=(angle, half))


def _proof(walls: Walls, test: Callable[[Loops, Loops], Exclusion], boxes: ParameterBox) -> Proof:
    (fraction, by_fraction), (angle, by_angle) = boxes["fraction"], boxes["angle"]
    alpha, beta, gamma, delta, _ = walls[boxes.index].T
    moves = {("fraction", "delay"): by_fraction, ("angle", "theta"): pi * by_angle}
    center = Loops(alpha, beta, gamma, delta, fraction, pi * angle)
    return excluded(test, center, boxes.moved(moves))


def _in_pieces(angles: LineBoxes, length: Column) -> LineBoxes:
    """Divide lines along the delay, so that the phase turns little in each box."""
    pieces = np.ceil(length[angles.line] * np.maximum(angles.high[1], 0.0)).astype(np.int64) + 1
    box = np.repeat(np.arange(pieces.size), pieces)
    index = np.arange(box.size) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    low, high = angles.low[:, box], angles.high[:, box]
    low[0], high[0] = index / pieces[box], (index + 1.0) / pieces[box]
    return LineBoxes(angles.line[box], low, high)


# Margins as a table for people: limits rounded inwards, and 0 if they are 0 but for rounding.

_DIGITS = 5
_MOST_ROWS = 8  # of many walls


class MarginNames(NamedTuple):
    """The names of the rows of a table of margins, with their units."""

    stiffness: str
    damping: str
    delay: str


DIMENSIONLESS = MarginNames("alpha", "beta", "extra delay (samples)")
IN_SI_UNITS = MarginNames("K (N/m)", "B (N s/m)", "extra delay (s)")


def margins_text(margins: tuple[Numbers, ...], names: MarginNames) -> str:
    """A ``Margins`` as a table: of one wall a row per quantity, of many a row per wall."""
    if not are_numbers(margins):
        return f"Margins{tuple(margins)}"
    verdict, stiffness, damping, stiffness_gain, damping_gain, extra_delay = margins
    codes = [Verdict(int(code)).name.lower() for code in np.ravel(verdict)]
    delays = [
        "not known" if code == "stable" and np.isnan(delay) else _largest(delay)
        for code, delay in zip(codes, np.ravel(extra_delay), strict=True)
    ]
    limits = [
        [(*_interval(low, high), _largest(gain)) for (low, high), gain in pairs]
        for pairs in (
            zip(np.reshape(stiffness, (-1, 2)), np.ravel(stiffness_gain), strict=True),
            zip(np.reshape(damping, (-1, 2)), np.ravel(damping_gain), strict=True),
        )
    ]
    if np.ndim(verdict) == 0:
        rows = [
            (f"Margins: {codes[0]}", "least", "largest", "factor"),
            (names.stiffness, *limits[0][0]),
            (names.damping, *limits[1][0]),
            (names.delay, "", delays[0], ""),
        ]
        return table_text(rows)
    heads = [(name, "to", "factor") for name in (names.stiffness, names.damping)]
    table = [("verdict", *heads[0], *heads[1], names.delay)]
    walls = zip(codes, *limits, delays, strict=True)
    table += [(code, *stiff, *damp, delay) for code, stiff, damp, delay in walls]
    more = f"\n... and {len(codes) - _MOST_ROWS} more" if len(codes) > _MOST_ROWS else ""
    return f"Margins of {len(codes)} walls\n{table_text(table[: 1 + _MOST_ROWS])}{more}"


def _interval(low: float, high: float) -> tuple[str, str]:
    extent = float(high) - float(low)
    least, largest = without_noise((low, high), extent).tolist()
    return _least(least), _largest(largest)


def _least(value: float) -> str:
    return number_text(float(value), _DIGITS, ROUND_CEILING).replace("unlimited", "-unlimited")


def _largest(value: float) -> str:
    return number_text(float(value), _DIGITS, ROUND_FLOOR)


class Margins(NamedTuple):
    """How much a wall may change; NaN throughout for a wall that is not proved stable.

    All numbers are proved: the wall stays stable that far. They fall short of the first root on the
    circle by at most about 1e-9 of the way there, or by the effect of rounding: where |p(z)|
    somewhere on the circle is below about 1e-13 of its largest term, per sample of delay, it cannot
    be told from 0. With filters this is about ten times as much. A few extra delays of tens of
    samples fall short by more, because the search is given up for a wall whose roots stay next to
    the circle at nearly all angles.
    The table rounds limits inwards, and prints 0 for one below 1e-9 of its interval, such as a
    least stiffness that the root at z = 1 sets.

    Attributes:
        verdict: certified codes of ``Verdict``.
        stiffness: the smallest and the largest K between which the wall stays stable at this B.
        damping: the smallest and the largest B between which it stays stable at this K.
        stiffness_gain: the factor by which K may be multiplied; infinite for K <= 0.
        damping_gain: the factor by which B may be multiplied; infinite for B <= 0.
        extra_delay: the time by which the delay may grow; infinite if no delay is too long, or none
            of up to 1024 further samples (MOST_DELAY).

    Example:
        >>> jaxstab.margins(0.1, 0.2, gamma=0.0, delta=0.015, delay=1.0)
        Margins: stable        least   largest  factor
        alpha                  0       0.11185  1.1185
        beta                   0.1689  0.6702   3.351
        extra delay (samples)          0.15444
    """

    verdict: Int8[Array, "*grid"]
    stiffness: Float64[Array, "*grid 2"]
    damping: Float64[Array, "*grid 2"]
    stiffness_gain: Float64[Array, "*grid"]
    damping_gain: Float64[Array, "*grid"]
    extra_delay: Float64[Array, "*grid"]

    def __repr__(self) -> str:
        """A table: a row for each quantity of one wall, or one for each of several walls."""
        return margins_text(self, DIMENSIONLESS)


class WallMargins(Margins):
    """Margins in SI units, with these units in their printed table."""

    def __repr__(self) -> str:
        """The table of ``Margins`` with units."""
        return margins_text(self, IN_SI_UNITS)


@refuses_loops("margins(K, B)")
def margins(
    alpha: Numbers,
    beta: Numbers,
    *,
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> Margins:
    """How far alpha, beta and delay may change, one at a time, before a loop is unstable.

    With JAX arrays the search is called back from JAX, so it works under jit and vmap. It is
    differentiable once in every argument, the delay too. Where two crossings come first at once,
    the derivative is that of one of them; it is NaN where the margin is infinite or the loop not
    stable.

    Args and Raises: see ``jaxstab.conventions``; here JAX may trace the delay.

    Returns:
        Margins: intervals of alpha and beta, and samples.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) on the unit circle; lemmas B5 and B10 of
    docs/proofs.md.

    Example:
        >>> window = jaxstab.Velocity.difference(samples=20)
        >>> wall = {"gamma": 0.0, "delta": 0.001, "delay": 1.0, "velocity": window}
        >>> float(margins(0.003, 0.04, **wall).stiffness_gain)
        2.7159...
    """
    filters = known_filters(velocity, position)
    values = (
        checked_gain("alpha", alpha),
        checked_gain("beta", beta),
        checked_gamma(gamma),
        checked_delta(delta),
        checked("delay", delay, 0.0, LONGEST_DELAY),
    )
    require_x64(*values)
    arrays = float_arrays(*values)
    xp = namespace(arrays)
    point: Array = xp.stack(xp.broadcast_arrays(*arrays), axis=-1)
    if is_jax(point):
        from jaxstab.ranges.margin_slopes import moving_steps

        axes = [axis for axis, _ in WAYS]
        code, steps = moving_steps(first_crossings, axes, point, filters)
    else:
        rows: Array = first_crossings(point.reshape(-1, len(values)), filters)
        table = rows.reshape(*point.shape[:-1], rows.shape[-1])
        code, steps = table[..., 0], table[..., 1::2]
    return margins_of(point, code, steps)


def margins_of(point: Array, code: Array, steps: Array) -> Margins:
    """The margins of walls, whose first numbers are alpha and beta, from steps to crossings."""
    xp = namespace(point)
    ends = [_end(xp, point[..., axis], steps[..., way]) for way, (axis, _) in enumerate(WAYS[:-1])]
    alphas, betas = xp.stack(ends[:2], axis=-1), xp.stack(ends[2:], axis=-1)
    return Margins(
        code.astype(xp.int8),
        alphas,
        betas,
        _factor(xp, alphas[..., 1], point[..., 0]),
        _factor(xp, betas[..., 1], point[..., 1]),
        steps[..., -1],
    )


def in_si_units(
    margins: Margins, stiffness: Numbers, damping: Numbers, sample_time: Numbers
) -> WallMargins:
    """Margins in units of one sample, by K in N/m and B in N s/m of alpha = 1 and beta = 1.

    Those of many loops are arrays.
    """
    per_alpha, per_beta = (u[..., None] if np.ndim(u) else u for u in (stiffness, damping))
    return WallMargins(
        margins.verdict,
        margins.stiffness * per_alpha,
        margins.damping * per_beta,
        margins.stiffness_gain,
        margins.damping_gain,
        sample_time * margins.extra_delay,
    )


def _end(xp: Any, gain: Array, step: Array) -> Array:
    """The gain after a step, less a rounding error."""
    end = gain + step
    return xp.where(xp.isfinite(end), end - xp.sign(step) * EPS * abs(end), end)


def _factor(xp: Any, most: Array, gain: Array) -> Array:
    """The factor by which a gain may be multiplied; NaN where it is not known."""
    without = xp.where(xp.isnan(most), most, inf)
    is_positive = gain > 0.0
    return xp.where(is_positive, most / xp.where(is_positive, gain, 1.0), without)
