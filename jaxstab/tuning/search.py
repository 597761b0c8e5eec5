"""The search for the dominant pair of poles of the smallest radius.

For a pair z = r e^(+-i theta) (theta = 0 or pi: a double real root) both gains follow from
p(z) = 0, a linear system. If some gains have all roots inside radius r, then gains at the edge of
the set of all such gains have a pair on the circle, at some theta, and no larger root. Let
rest(theta) be the largest modulus of the other roots. If its minimum is above r, the set is empty;
in any case max(r, rest) is a radius that some gains have. A scan minimises rest over theta, then
again around the best of its local minima.

The first guess is a triple real root, all of which are known. A scan at a slightly smaller radius
shows whether it is the best. If it is not, the radius is lowered from scan to scan until a double
pair next to the best point, or the point itself, passes this test.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Int8

from jaxstab.arrays import Array
from jaxstab.model import companion_matrix
from jaxstab.tuning.component import ALL_GAINS, Component
from jaxstab.tuning.multiple_root import (
    Family,
    Pair,
    multiple_root,
    triple_roots,
    value,
)
from jaxstab.tuning.status import TuningStatus

_SMALLEST, _LARGEST = 1e-4, 1.3  # radii that are looked at
_REAL = 1e-3  # rad: dominant pairs closer to the real axis are taken for real
_FIRST = 1e-5  # rad: close enough to a double real root
_NEAR = 1.2  # radii: how large other poles may be where a scan looks at them
_MINIMA, _POINTS, _ROUNDS = 8, 9, 5  # of the scan that are looked at closer
_MORE = 4.0  # times what a minimum lost when it was looked at closer
_STEP = 0.8  # from one radius to the next smaller one that is tried
_CLOSE = 1.01  # ends of the interval for the radius at which the search becomes local
_SHORT = 0.1  # of the way to the radius that was guessed: what is left of it
_ROWS, _COLUMNS, _ZOOMS = 32, 48, 14
_FLAT = 1e-11  # relative: radii this close are not told apart
_AGREEMENT = 1e-6  # relative, between the scan and the solution of the equations
_ROOM = 1e-4  # relative, below a radius, where a smaller one is looked for once more
_ATTEMPTS = 4
_NOISE, _MOST_NOISE = 1e-5, 1e-3  # relative, of a triple pole; of one whose gains lost digits

Angles = Float64[np.ndarray, " angle"]


class Walls(NamedTuple):
    """All walls of a loop, among which the best one is searched.

    family: p(z) of each.
    angles: angles of pairs on a circle, for a scan.
    component: the component of the stable set that is searched.
    """

    family: Family
    angles: Angles
    component: Component = ALL_GAINS

    def largest_pole(self, alpha: Array, beta: Array) -> Array:
        """Return the largest modulus of the poles; infinite for no gains and other components."""
        coefficients = self.family.polynomial(alpha, beta)
        finite = np.all(np.isfinite(coefficients), axis=-1)
        largest = np.full(finite.shape, np.inf)
        poles = np.linalg.eigvals(companion_matrix(coefficients[finite]))
        largest[finite] = np.max(np.abs(poles), axis=-1)
        if self.component.edges is not None:
            stable = np.flatnonzero(largest < 1.0)
            is_elsewhere = ~self.component.holds(alpha[stable], beta[stable])
            largest[stable[is_elsewhere]] = np.inf
        return largest


def searched(every: Iterable[Walls], shape: tuple[int, ...]) -> tuple[Array, ...]:
    """Return alpha, beta, x and y of the best pairs of loops, and how each is known."""
    with np.errstate(all="ignore"):  # gains overflow where no pair can be
        best = [_best(walls) for walls in every]
    pairs = np.array([pair for pair, _ in best]).reshape(-1, 4).T
    kinds: Int8[np.ndarray, " plant"] = np.array([kind for _, kind in best], np.int8)
    return *(part.reshape(shape) for part in pairs), kinds.reshape(shape)


def scan_angles(length: int, zeros: Complex128[np.ndarray, " zero"]) -> Angles:
    """Return the angles of a scan: parts of a turn of z^m, finer to both ends and at zeros of N."""
    count = 24 + 8 * length
    even = (np.arange(count) + 0.5) * (np.pi / count)
    ends = np.geomspace(_FIRST, even[0], 12, endpoint=False)
    near = np.geomspace(_FIRST, even[0], 8)
    turns = np.abs(np.angle(zeros))[:, None]
    around = np.concatenate([(turns - near).ravel(), (turns + near).ravel()])
    angles = np.concatenate([ends, even, np.pi - ends, around])
    return np.unique(np.clip(angles, _FIRST, np.pi - _FIRST))


class _Point(NamedTuple):
    """Gains that put a pair of poles on a circle, and the largest modulus of all poles there."""

    reached: float
    radius: float
    angle: float


def _best(walls: Walls) -> tuple[Pair, int]:
    """Return the best pair of a plant; what is found must stand a last scan of all angles."""
    low, (pair, kind) = _SMALLEST, _triple_root(walls)
    for _ in range(_ATTEMPTS):
        radius = float(np.hypot(pair.x, pair.y))
        point = _Point(np.inf, _LARGEST, float(walls.angles[0]))
        if radius < _LARGEST:
            point = _scanned(walls, radius * (1.0 - _ROOM))
            if point.reached >= radius * (1.0 - _AGREEMENT):
                break
        low, other, its_kind = _descended(walls, 0.9 * low, point)
        if np.hypot(other.x, other.y) >= radius:
            break
        pair, kind = other, its_kind
    return pair, kind


def _descended(walls: Walls, low: float, best: _Point) -> tuple[float, Pair, int]:
    """Return a radius below which no pair was found, the best pair above it, and its kind.

    From the best point known, the radius is taken down until no pair is left, faster and faster.
    Below the best radius, what is reached misses the circle by about as much as the circle is too
    small: two such circles tell where the next one nearly fits.
    """
    high, step, misses = best.radius, _STEP, list[_Point]()
    while high > low * _CLOSE:
        guess = _guess(misses, low, high)
        trial = min(1.0, max(step * high, guess))
        if not low < trial < high:
            break
        point = _scanned(walls, trial)
        is_better, best = point < best, min(best, point)
        if point.reached <= trial * (1.0 + _NOISE):
            high, step = trial, step * step
            misses.clear()
            continue
        low, high = trial, min(high, point.reached)
        misses.append(point)
        if is_better:
            pair = multiple_root(walls.family, _pair_at(walls, point), is_triple=False)
            radius = np.hypot(pair.x, pair.y)
            if low <= radius <= high and pair.y > _REAL * radius and _holds(walls, pair):
                return low, pair, TuningStatus.DOUBLE_PAIR
    return low, *_local(walls, low, high, best)


def _guess(misses: list[_Point], low: float, high: float) -> float:
    """Return a radius a little below the best one by two circles that were too small."""
    middle = float(np.sqrt(low * high))
    if len(misses) < 2:
        return middle
    (first, first_gap), (last, last_gap) = ((p.radius, p.reached - p.radius) for p in misses[-2:])
    if not last_gap < first_gap < np.inf:
        return middle
    best = last + last_gap * (last - first) / (first_gap - last_gap)
    guess = best - _SHORT * (best - low)
    return guess if middle < guess < high else middle


def _triple_root(walls: Walls) -> tuple[Pair, int]:
    """Return the smallest triple real root without a larger pole; an infinite one for none."""
    roots = triple_roots(walls.family)
    sizes, largest = abs(roots.x), walls.largest_pole(roots.alpha, roots.beta)
    stands = (sizes > _SMALLEST) & (largest <= sizes * (1.0 + _MOST_NOISE))
    for number in np.argsort(np.where(stands, sizes, np.inf))[: np.sum(stands)]:
        pair = multiple_root(walls.family, Pair(*(part[number] for part in roots)), is_triple=True)
        is_same = abs(abs(pair.x) - sizes[number]) <= _AGREEMENT * sizes[number]
        if is_same and _holds(walls, pair):
            return pair, TuningStatus.TRIPLE_ROOT
    return Pair(*(np.float64(np.inf),) * 4), TuningStatus.SCANNED


def _holds(walls: Walls, pair: Pair) -> bool:
    """Return whether gains have the radius of their pair, but for the noise of a multiple root.

    Gains that miss it by far more are an artefact of digits that were lost.
    """
    radius = np.hypot(pair.x, pair.y)
    gains = np.atleast_1d(pair.alpha), np.atleast_1d(pair.beta)
    is_reached = walls.largest_pole(*gains)[0] <= radius * (1.0 + _MOST_NOISE)
    return bool(is_reached and _is_dominant(walls, pair, radius * (1.0 + _AGREEMENT)))


def _scanned(walls: Walls, radius: float) -> _Point:
    """Return the point of the smallest radius among the pairs on a circle.

    Poles are computed where others than the pair are not much larger, and next to there.
    """
    angles = walls.angles
    pairs = _pairs(walls, np.full(angles.shape, radius), angles)
    fits = _is_dominant(walls, pairs, np.full(angles.shape, _NEAR * radius))
    is_near = fits.copy()
    is_near[1:] |= fits[:-1]
    is_near[:-1] |= fits[1:]
    reached = np.full(angles.shape, np.inf)
    reached[is_near] = walls.largest_pole(pairs.alpha[is_near], pairs.beta[is_near])
    is_least = np.isfinite(reached)
    is_least[1:] &= reached[1:] <= reached[:-1]
    is_least[:-1] &= reached[:-1] <= reached[1:]
    minima = np.flatnonzero(is_least)
    if not minima.size:
        return _Point(np.inf, radius, float(angles[0]))
    minima = minima[np.argsort(reached[minima])[:_MINIMA]]
    last = reached.size - 1
    left, right = angles[np.maximum(minima - 1, 0)], angles[np.minimum(minima + 1, last)]
    former = reached[minima]
    best = _Point(float(former[0]), radius, float(angles[minima[0]]))
    for _ in range(_ROUNDS):
        if best.reached <= radius * (1.0 + _NOISE) or not left.size:
            break
        closer = left[:, None] + (right - left)[:, None] * np.linspace(0.0, 1.0, _POINTS)
        values = _reached(walls, radius, closer.ravel()).reshape(closer.shape)
        least = np.argmin(values, axis=1)
        rows = np.arange(least.size)
        lowest = values[rows, least]
        row = int(np.argmin(lowest))
        best = min(best, _Point(float(lowest[row]), radius, float(closer[row, least[row]])))
        # What a minimum may still lose is not much more than what it lost.
        is_open = lowest - _MORE * np.maximum(former - lowest, 0.0) <= best.reached
        left, right = (closer[rows, np.clip(least + side, 0, _POINTS - 1)] for side in (-1, 1))
        left, right, former = left[is_open], right[is_open], lowest[is_open]
    return best


def _reached(walls: Walls, radius: float, angles: Angles) -> Angles:
    """Return the largest modulus of the poles where pairs are on a circle; infinite for no gains.

    All poles are those of the gains as float64 has them, so each value is one that gains reach.
    """
    pairs = _pairs(walls, np.full(angles.shape, radius), angles)
    return walls.largest_pole(pairs.alpha, pairs.beta)


def _local(walls: Walls, low: float, high: float, point: _Point) -> tuple[Pair, int]:
    """Return the best pair around a point: a multiple root where its equations have one.

    Elsewhere the answer is the radius that the better gains have, as float64 has them.
    """
    start = _zoomed(walls, low, high, point.angle)
    is_triple = bool(np.sin(np.arctan2(start.y, start.x)) < _REAL)
    solution = multiple_root(walls.family, start, is_triple)
    radius, scanned = np.hypot(solution.x, solution.y), np.hypot(start.x, start.y)
    if abs(radius - scanned) <= _AGREEMENT * scanned and _holds(walls, solution):
        return solution, TuningStatus.TRIPLE_ROOT if is_triple else TuningStatus.DOUBLE_PAIR
    reached = walls.largest_pole(np.atleast_1d(start.alpha), np.atleast_1d(start.beta))[0]
    pair, share = start, reached / scanned
    if not reached <= point.reached:
        pair, share = _pair_at(walls, point), point.reached / point.radius
    return pair._replace(x=share * pair.x, y=share * pair.y), TuningStatus.SCANNED


def _pair_at(walls: Walls, point: _Point) -> Pair:
    """Return the pair of a point."""
    radius, angle = np.array([point.radius]), np.array([point.angle])
    return Pair(*(part[0] for part in _pairs(walls, radius, angle)))


def _zoomed(walls: Walls, low: float, high: float, angle: float) -> Pair:
    """Zoom in on the smallest r for which no other root is larger than the pair."""
    width = max(0.05, 0.3 * np.sin(angle))
    box = np.array([np.log(low) - 1e-3, np.log(high) + 1e-12, angle - width, angle + width])
    best = _pair_at(walls, _Point(high, high, angle))
    best = best._replace(x=high * np.cos(angle), y=high * np.sin(angle))
    for _ in range(_ZOOMS):
        radii = np.exp(np.linspace(box[0], box[1], _ROWS))[:, None]
        left, right = np.clip(box[2:], 0.0, np.pi)
        columns = np.linspace(left, right, _COLUMNS)
        columns = np.sort(np.append(columns, np.clip(angle, left, right)))
        pairs = _pairs(walls, *np.broadcast_arrays(radii, columns))
        fits = _is_dominant(walls, pairs, np.broadcast_to(radii, pairs.x.shape))
        fits[fits] = walls.component.holds(pairs.alpha[fits], pairs.beta[fits])
        rows = np.flatnonzero(np.any(fits, axis=1))
        if not rows.size:
            break
        row = int(rows[0])
        inside = np.flatnonzero(fits[row])
        first, last = int(inside[0]), int(inside[-1])
        middle = 0 if first == 0 else last if last == len(columns) - 1 else (first + last) // 2
        middle = int(inside[np.argmin(np.abs(inside - middle))])
        best = Pair(*(part[row, middle] for part in pairs))
        angle = float(columns[middle])
        height, step = (box[1] - box[0]) / (_ROWS - 1), (right - left) / (_COLUMNS - 1)
        bottom = float(np.log(radii[row, 0]))
        room = 6.0 * step
        sides = columns[first] - room, columns[last] + room
        box = np.array([bottom - 3.0 * height, bottom + height, *sides])
        if height < _FLAT:
            break
    return best


def _pairs(walls: Walls, radius: Array, angle: Array) -> Pair:
    """Solve p(z) = 0 for the gains; at theta = 0 and pi close enough to the double real root."""
    angle = np.clip(angle, _FIRST, np.pi - _FIRST)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    parts = np.stack(walls.family)
    base, stiff, damp = value(parts.reshape(len(parts), *(1,) * x.ndim, -1), x + 1j * y)
    determinant = stiff.real * damp.imag - stiff.imag * damp.real
    alpha = (base.imag * damp.real - base.real * damp.imag) / determinant
    beta = (stiff.imag * base.real - stiff.real * base.imag) / determinant
    return Pair(alpha, beta, x, y)


def _is_dominant(walls: Walls, pair: Pair, radius: Array) -> Bool[np.ndarray, "*grid"]:
    """Return whether all roots but the pair are smaller than the radius (Schur and Cohn)."""
    rest = _quotient(walls.family.polynomial(pair.alpha, pair.beta), pair)
    rest = rest / np.asarray(radius)[..., None] ** np.arange(rest.shape[-1])
    inside = np.full(np.shape(radius), True)
    for _ in range(rest.shape[-1] - 1):
        reflection = rest[..., -1:] / rest[..., :1]
        inside &= np.abs(reflection[..., 0]) < 1.0
        rest = rest[..., :-1] - reflection * rest[..., :0:-1]
    return inside


def _quotient(coefficients: Array, pair: Pair) -> Array:
    """Divide by z^2 - 2 x z + x^2 + y^2."""
    last, before, parts = np.zeros_like(pair.x), np.zeros_like(pair.x), []
    for power in range(coefficients.shape[-1] - 2):
        part = coefficients[..., power] + 2.0 * pair.x * last - (pair.x**2 + pair.y**2) * before
        parts.append(part)
        last, before = part, last
    return np.stack(parts, axis=-1)
