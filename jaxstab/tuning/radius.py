"""The wall gains with the smallest spectral radius.

The radius has no smooth minimum: at the best gains several roots share the largest modulus, and at
a triple root it grows with the cube root of any change. So the search does not run
over gains, but over the dominant pair z = r e^(+-i theta) itself. Where a multiple root is found,
its equations, p = p' = p'' = 0 at a real z or p = p' = 0 at a complex one, are solved to full
precision.
See Blondel, Gurbuzbalaban, Megretski, Overton (2012) for why roots coalesce.
"""

from collections.abc import Callable
from functools import cache, lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Int8

from jaxstab.arrays import Array, Numbers, constant, float_arrays, is_any_traced, namespace, take
from jaxstab.batches import on_host
from jaxstab.conventions import Status, Verdict
from jaxstab.model import (
    by_name,
    checked_delay,
    checked_delta,
    checked_gamma,
    companion_matrix,
    require_x64,
)
from jaxstab.model.filters import NO_FILTERS, Filter, Filters, Velocity, given_filters
from jaxstab.model.linear_loop import LinearLoop, filtered_loop
from jaxstab.numbers import checked_number
from jaxstab.point.radius import have_roots_inside
from jaxstab.point.verdicts import verdict
from jaxstab.region import RegionStatus, StableRegion, stable_region
from jaxstab.region.outline import are_inside, edges_of
from jaxstab.region.stable_set import holds_small_gains

# What is known about the best gains.


class TuningStatus(Status):
    """How the best gains are known; small integers, so that arrays store int8.

    None of them proves that no other gains are better. With filters the stable set may have several
    components: the search covers the one that holds small positive gains, which is reached by
    turning gains up from 0, and other components only where the status says so.

    Example:
        >>> jaxstab.results.TuningStatus(1).words
        'best of a search: a triple real pole, to full precision'
    """

    NOT_COMPUTED = 0, "not computed"
    TRIPLE_ROOT = 1, "best of a search: a triple real pole, to full precision"
    DOUBLE_PAIR = 2, "best of a search: a double pair of poles, to full precision"
    SCANNED = 3, "best of a search; in 1,000 loops others found radii 0.02 % smaller at most"
    NO_STABLE_GAINS = 4, "no gains found that make the loop stable"
    ISLAND = 5, "best of a search, in an island: small gains are not stable"
    ANY_COMPONENT = 6, "best of a search, perhaps in an island: the region is unresolved"
    NOT_CALM = 7, "no gains found that keep encoder chatter within the limit"


class OptimalGains(NamedTuple):
    """The best gains, what they achieve (a radius, or samples) and how they are known.

    Example:
        >>> best = jaxstab.minimize_radius(gamma=0.0, delta=0.0, delay=0.0)
        >>> round(float(best.value), 9)  # 4^(1/3) - 1
        0.587401052
    """

    alpha: Float64[Array, "*grid"]
    beta: Float64[Array, "*grid"]
    value: Float64[Array, "*grid"]
    status: Int8[Array, "*grid"]


_NUMBERS = 1 << 20  # of an array that points beside edges fill, about


class Component(NamedTuple):
    """A component of a stable set, or all gains.

    edges: of its outline, from (alpha, beta) to (alpha, beta); None for all gains.
    status: of gains that are found there; NOT_COMPUTED leaves it to the search.
    lowest: alpha and beta of searches on grids; 0 where gains must be those of walls.
    """

    edges: Float64[np.ndarray, "edge 4"] | None = None
    status: TuningStatus = TuningStatus.NOT_COMPUTED
    lowest: float = -np.inf

    def holds(self, alpha: np.ndarray, beta: np.ndarray) -> Bool[np.ndarray, "*grid"]:
        """Return which stable gains are in the component: those that its outline encloses."""
        # Stable gains are not next to another component's edge, so the polygon is as good for this
        # as the exact curve.
        alpha, beta = np.broadcast_arrays(alpha, beta)
        if self.edges is None:
            return np.full(alpha.shape, True)
        count = max(1, _NUMBERS // len(self.edges))
        points = np.stack([alpha.ravel(), beta.ravel()])
        parts = [
            are_inside(self.edges, points[:, begin : begin + count])
            for begin in range(0, points.shape[1], count)
        ]
        return np.concatenate([np.zeros(0, bool), *parts]).reshape(alpha.shape)


ALL_GAINS = Component()


@lru_cache(maxsize=64)
def searched_component(
    gamma: float, delta: float, delay: float, filters: Filters | None
) -> Component:
    """Return the component of small gains; if there is none, all gains and a status."""
    if filters is None:  # the stable set was always seen to be one component
        return ALL_GAINS
    velocity, position = filters
    return component_of(
        stable_region(gamma=gamma, delta=delta, delay=delay, velocity=velocity, position=position)
    )


def component_of(region: StableRegion) -> Component:
    """Return the component of small gains of a stable set; all gains if there is none."""
    if region.status == RegionStatus.UNRESOLVED:
        return Component(None, TuningStatus.ANY_COMPONENT)
    components = region.components
    if not components or not holds_small_gains(region.curve, components[0].outline):
        return Component(None, TuningStatus.ISLAND)
    main, *islands = components
    return Component(edges_of(main.points, main.branch)) if islands else ALL_GAINS


# Multiple roots of p(z), which the best gains have, as equations for Newton's method.
#
# A triple real root solves p = p' = p'' = 0, a double complex pair p = p' = 0, for the gains and z.

_NEWTON_STEPS = 10
_PATIENCE, _LOST = 4, 0.05  # after so many steps, of the root: no root is near
_FARTHEST = 1.3  # a root beyond it is no longer the one that was followed
_REAL = 1e-3  # relative: imaginary parts of a real root of a polynomial with rounded coefficients


class Family(NamedTuple):
    """p(z) = base + alpha stiff + beta damp, each with the highest power first."""

    base: Float64[Array, "*grid coefficient"]
    stiff: Float64[Array, "*grid coefficient"]
    damp: Float64[Array, "*grid coefficient"]

    def polynomial(self, alpha: Array, beta: Array) -> Float64[Array, "*grid coefficient"]:
        """Return the coefficients for arrays of gains, on a new last axis."""
        return self.base + alpha[..., None] * self.stiff + beta[..., None] * self.damp


class Pair(NamedTuple):
    """The gains that put a pair of poles at x +- i y."""

    alpha: Float64[Array, "*grid"]
    beta: Float64[Array, "*grid"]
    x: Float64[Array, "*grid"]
    y: Float64[Array, "*grid"]


def family_of_loop(loop: LinearLoop) -> Family:
    """Return the polynomials of all walls at any linear loop."""
    xp = namespace(loop[:3])
    parts = ([coefficient.rounded() for coefficient in polynomial] for polynomial in loop[:3])
    return Family(*(xp.stack(polynomial, axis=-1) for polynomial in parts))


def triple_roots(family: Family) -> Pair:
    """Return all triple real roots, with y = 0, to the accuracy of the roots of a polynomial."""
    # The equations are linear in the gains and 1, so that the determinant of the three is a
    # polynomial in z that vanishes at the triple roots of all gains.
    base, stiff, damp = map(_derivatives, family)
    determinant: Array = np.zeros(1)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        minor = np.convolve(stiff[j], damp[k]), np.convolve(stiff[k], damp[j])
        determinant = np.polyadd(determinant, np.convolve(base[i], np.polysub(*minor)))
    roots = np.roots(determinant)
    z = roots[(abs(roots.imag) < _REAL * abs(roots)) & (abs(roots) < _FARTHEST)].real
    p, stiff, damp = (
        [value(polynomials, z) for polynomials in parts[:2]] for parts in (base, stiff, damp)
    )
    divisor = stiff[0] * damp[1] - stiff[1] * damp[0]
    alpha = (p[1] * damp[0] - p[0] * damp[1]) / divisor
    beta = (p[0] * stiff[1] - p[1] * stiff[0]) / divisor
    return Pair(alpha, beta, z, np.zeros_like(z))


def multiple_root(family: Family, start: Pair, is_triple: bool) -> Pair:
    """Solve for the multiple root; NaN where its equations are singular."""
    pair = start._replace(y=np.float64(0.0)) if is_triple else start
    for count in range(_NEWTON_STEPS):
        try:
            step = newton_step(family, pair, np.asarray(is_triple))
        except np.linalg.LinAlgError:
            return Pair(*(np.float64(np.nan),) * 4)
        pair = Pair(*(a + b for a, b in zip(pair, step, strict=True)))
        size = max(abs(entry) for entry in pair)
        if not max(abs(entry) for entry in step) > 1e-15 * size or abs(pair.x) > _FARTHEST:
            break
        if count == _PATIENCE and abs(step.x) + abs(step.y) > _LOST * (abs(pair.x) + abs(pair.y)):
            break
    return pair


def newton_step(family: Family, pair: Pair, is_triple: Array) -> Pair:
    """Return the step of Newton's method to a triple real root, or to a double complex pair."""
    # The equations are p = p' = p'' = y = 0 or p = p' = 0, those for alpha, beta, x and y.
    xp = namespace(family, pair)
    z = pair.x + 1j * pair.y
    whole = family.polynomial(pair.alpha, pair.beta)
    # The polynomial and its derivatives, and those of its derivatives in alpha and beta.
    every = xp.stack(xp.broadcast_arrays(whole, family.stiff, family.damp))
    p, stiff, damp = value(_derivatives(every), z[..., None])
    orders, after = slice(0, 3), slice(1, 4)
    columns = stiff[..., orders], damp[..., orders], p[..., after], 1j * p[..., after]
    rows = xp.stack([*columns, p[..., orders]], axis=-1)
    zero = xp.zeros_like(pair.y)
    last = xp.stack([zero, zero, zero, zero + 1.0, pair.y], axis=-1)
    triple = xp.concatenate([rows.real, last[..., None, :]], axis=-2)
    pairs = xp.stack([rows.real[..., :2, :], rows.imag[..., :2, :]], axis=-2)
    system = xp.where(xp.asarray(is_triple)[..., None, None], triple, pairs.reshape(triple.shape))
    step = xp.linalg.solve(constant(system[..., :4]), -system[..., 4:])[..., 0]
    return Pair(*(step[..., column] for column in range(4)))


def _derivatives(coefficients: Array) -> Float64[Array, "*grid 4 coefficient"]:
    """Return polynomials and their first three derivatives, with zeros in front."""
    places, factors = _places_and_factors(coefficients.shape[-1])
    return coefficients[..., places] * factors


@cache
def _places_and_factors(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return where the coefficients of derivatives come from, and times what."""
    order, place = np.arange(4)[:, None], np.arange(size) - np.arange(4)[:, None]
    powers = size - 1.0 - place
    factors = np.ones(place.shape)
    for below in range(3):
        factors *= np.where(order > below, powers - below, 1.0)
    return np.maximum(place, 0), np.where(place >= 0, factors, 0.0)


def value(coefficients: Array, z: Array) -> Array:
    """Return the value of a polynomial."""
    result = 0.0 * z
    for power in range(coefficients.shape[-1]):
        result = result * z + coefficients[..., power]
    return result


# The search for the dominant pair of poles of the smallest radius.
#
# For a pair z = r e^(+-i theta) (theta = 0 or pi: a double real root) both gains follow from p(z) =
# 0, a linear system. If some gains have all roots inside radius r, then gains at the edge of the
# set of all such gains have a pair on the circle, at some theta, and no larger root. Let
# rest(theta) be the largest modulus of the other roots. If its minimum is above r, the set is
# empty; in any case max(r, rest) is a radius that some gains have. A scan minimises rest over
# theta, then again around the best of its local minima.
#
# The first guess is a triple real root; all of these are known. A scan at a slightly smaller radius
# shows whether it is the best. If it is not, the radius is lowered from scan to scan until a double
# pair next to the best point, or the point itself, passes this test.

_SMALLEST, _LARGEST = 1e-4, 1.3  # radii of the search
_FIRST = 1e-5  # rad: close enough to a double real root
_NEAR = 1.2  # radii: how large other poles may be where a scan looks at them
_MINIMA, _POINTS, _ROUNDS = 8, 9, 5  # of the scan that are refined
_MORE = 4.0  # times the improvement of a minimum by refinement
_STEP = 0.8  # from one radius to the next smaller one that is tried
_CLOSE = 1.01  # ends of the interval for the radius at which the search becomes local
_SHORT = 0.1  # of the way to the radius that was guessed
_ROWS, _COLUMNS, _ZOOMS = 32, 48, 14
_FLAT = 1e-11  # relative: radii this close are not told apart
_AGREEMENT = 1e-6  # relative, between the scan and the solution of the equations
_ROOM = 1e-4  # relative, below a radius, where a smaller one is looked for once more
_ATTEMPTS = 4
_NOISE, _MOST_NOISE = 1e-5, 1e-3  # relative, of a triple pole; of one whose gains lost digits

Angles = Float64[np.ndarray, " angle"]


class Walls(NamedTuple):
    """All walls of a loop, p(z) of each, among which the best one of a component is searched.

    ``angles`` are those of pairs on a circle, for a scan.
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


def _best_known(walls: Walls) -> tuple[Pair, int]:
    """Return the best pair, and how it is known: by the search, or by the searched component."""
    with np.errstate(all="ignore"):  # gains overflow where no pair can be
        pair, kind = _best(walls)
    return pair, walls.component.status or kind


def _best(walls: Walls) -> tuple[Pair, int]:
    """Return the best pair of a plant; a last scan of all angles must find no better one."""
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
    """Return a radius below which no pair was found, the best pair above it, and its kind."""
    # From the best point known, the radius is taken down until no pair is left, faster and faster.
    # Below the best radius, the closest radius misses the circle by about as much as the circle is
    # too small: two such circles tell where the next one nearly fits.
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
    (before, gap_before), (last, last_gap) = ((p.radius, p.reached - p.radius) for p in misses[-2:])
    if not last_gap < gap_before < np.inf:
        return middle
    best = last + last_gap * (last - before) / (gap_before - last_gap)
    guess = best - _SHORT * (best - low)
    return guess if middle < guess < high else middle


def _triple_root(walls: Walls) -> tuple[Pair, int]:
    """Return the smallest triple real root without a larger pole; an infinite one for none."""
    roots = triple_roots(walls.family)
    sizes, largest = abs(roots.x), walls.largest_pole(roots.alpha, roots.beta)
    is_real = (sizes > _SMALLEST) & (largest <= sizes * (1.0 + _MOST_NOISE))
    for index in np.argsort(np.where(is_real, sizes, np.inf))[: np.sum(is_real)]:
        pair = multiple_root(walls.family, take(roots, index), is_triple=True)
        is_same = abs(abs(pair.x) - sizes[index]) <= _AGREEMENT * sizes[index]
        if is_same and _holds(walls, pair):
            return pair, TuningStatus.TRIPLE_ROOT
    return Pair(*(np.float64(np.inf),) * 4), TuningStatus.SCANNED


def _holds(walls: Walls, pair: Pair) -> bool:
    """Return whether gains have the radius of their pair, but for the noise of a multiple root."""
    # Gains that miss it by far more are an artefact of cancellation.
    radius = np.hypot(pair.x, pair.y)
    gains = np.atleast_1d(pair.alpha), np.atleast_1d(pair.beta)
    is_reached = walls.largest_pole(*gains)[0] <= radius * (1.0 + _MOST_NOISE)
    return bool(is_reached and _is_dominant(walls, pair, radius * (1.0 + _AGREEMENT)))


def _scanned(walls: Walls, radius: float) -> _Point:
    """Return the point of the smallest radius among the pairs on a circle."""
    # Poles are computed where others than the pair are not much larger, and next to there.
    angles = walls.angles
    pairs = _family_pairs(walls, np.full(angles.shape, radius), angles)
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
        # All poles are those of the gains as float64 has them: each value is one that gains reach.
        pairs = _family_pairs(walls, np.full(closer.size, radius), closer.ravel())
        values = walls.largest_pole(pairs.alpha, pairs.beta).reshape(closer.shape)
        least = np.argmin(values, axis=1)
        rows = np.arange(least.size)
        lowest = values[rows, least]
        row = int(np.argmin(lowest))
        best = min(best, _Point(float(lowest[row]), radius, float(closer[row, least[row]])))
        # A minimum improves further by not much more than it just did.
        is_open = lowest - _MORE * np.maximum(former - lowest, 0.0) <= best.reached
        left, right = (closer[rows, np.clip(least + side, 0, _POINTS - 1)] for side in (-1, 1))
        left, right, former = left[is_open], right[is_open], lowest[is_open]
    return best


def _local(walls: Walls, low: float, high: float, point: _Point) -> tuple[Pair, int]:
    """Return the best pair around a point: a multiple root where its equations have one."""
    # Elsewhere the answer is the radius that the better gains have, as float64 has them.
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
    radius, angle = np.array([point.radius]), np.array([point.angle])
    return take(_family_pairs(walls, radius, angle), 0)


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
        pairs = _family_pairs(walls, *np.broadcast_arrays(radii, columns))
        fits = _is_dominant(walls, pairs, np.broadcast_to(radii, pairs.x.shape))
        fits[fits] = walls.component.holds(pairs.alpha[fits], pairs.beta[fits])
        rows = np.flatnonzero(np.any(fits, axis=1))
        if not rows.size:
            break
        row = int(rows[0])
        inside = np.flatnonzero(fits[row])
        inner, outer = int(inside[0]), int(inside[-1])
        middle = 0 if inner == 0 else outer if outer == len(columns) - 1 else (inner + outer) // 2
        middle = int(inside[np.argmin(np.abs(inside - middle))])
        best = take(pairs, (row, middle))
        angle = float(columns[middle])
        height, step = (box[1] - box[0]) / (_ROWS - 1), (right - left) / (_COLUMNS - 1)
        bottom = float(np.log(radii[row, 0]))
        room = 6.0 * step
        sides = columns[inner] - room, columns[outer] + room
        box = np.array([bottom - 3.0 * height, bottom + height, *sides])
        if height < _FLAT:
            break
    return best


def _family_pairs(walls: Walls, radius: Array, angle: Array) -> Pair:
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
    quotient = _quotient(walls.family.polynomial(pair.alpha, pair.beta), pair)
    return have_roots_inside(quotient, np.asarray(radius))


def _quotient(coefficients: Array, pair: Pair) -> Array:
    """Divide by z^2 - 2 x z + x^2 + y^2."""
    last, before, parts = np.zeros_like(pair.x), np.zeros_like(pair.x), []
    for power in range(coefficients.shape[-1] - 2):
        coefficient = (
            coefficients[..., power] + 2.0 * pair.x * last - (pair.x**2 + pair.y**2) * before
        )
        parts.append(coefficient)
        last, before = coefficient, last
    return np.stack(parts)


_LIKE = (np.float64,) * 4 + (np.int8,)
_NEAR_CIRCLE = 0.9  # how far out zeros are that bend the curve sharply


def minimize_radius(
    *,
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> OptimalGains:
    """The gains (alpha, beta) with the smallest spectral radius: the fastest decay.

    In the haptic range the best gains make a triple real pole; with a stiff hand and a delay, a
    double complex pair. Both are solved for to full precision. The best alpha may be negative if
    the hand is stiff, beta if it is damped; ``HapticLoop.tune`` gives walls of K >= 0 and B >= 0.
    It is not proved that no other gains are better: the search looks for a smaller radius at every
    angle of the dominant pair, to the resolution of its scan.

    With an estimator or a filter the stable set may have several components. The best gains are
    then those of the component that holds small positive gains; if there is none, those of the
    islands, and the status says so.

    Args:
        gamma, delta, velocity, position: see ``jaxstab.conventions``.
        delay: time delay t_d/T >= 0 in samples, one concrete number; filters are concrete, too.

    Returns:
        OptimalGains of the broadcast shape. ``value`` is the radius at the exact multiple root: at
        a triple root, gains rounded to float64 come within about 1e-5 of it, gains of six digits
        within 1e-2. Differentiable once in gamma and delta where the status is TRIPLE_ROOT or
        DOUBLE_PAIR; elsewhere the derivative is NaN.

    Raises: see ``jaxstab.conventions``.

    Source: eq. (9) for the poles; the theorem of Blondel et al. (2012), IEEE TAC 57(12).

    Example:
        >>> best = jaxstab.minimize_radius(gamma=0.0, delta=0.0, delay=0.0)
        >>> round(float(best.value), 9)  # 4^(1/3) - 1
        0.587401052
    """
    require_x64(gamma, delta)
    checked_delay(delay)
    delay = checked_number("delay", delay, 0.0)
    filters = given_filters(velocity, position)
    gamma, delta = float_arrays(checked_gamma(gamma), checked_delta(delta))
    if is_any_traced(filters):
        raise TypeError(
            "the best gains are searched for outside of JAX: give filters of concrete numbers, not "
            "traced."
        )
    xp = namespace(gamma, delta)
    plants = xp.broadcast_arrays(gamma, delta)
    search = partial(_searched, delay=delay, filters=filters)
    *fields, kind = on_host(search, *plants, shape=plants[0].shape, like=_LIKE)
    best = Pair(*fields)
    if xp is not np:
        best = _followed(family_of_loop(_loop_of(plants[0], plants[1], delay, filters)), best, kind)
    scene = constant((best.alpha, best.beta, gamma, delta))
    codes = verdict(**by_name(*scene, delay), velocity=velocity, position=position)
    return _as_gains(best, kind, codes)


def smallest_radius(walls: Walls, verdicts: Callable[[Array, Array], Array]) -> OptimalGains:
    """Return the best gains of one loop among its ``walls``."""
    best, kind = _best_known(walls)
    return _as_gains(best, np.int8(kind), verdicts(best.alpha, best.beta))


def _as_gains(best: Pair, kind: Array, codes: Array) -> OptimalGains:
    xp = namespace(best)
    value = xp.hypot(best.x, best.y)
    is_stable = xp.asarray(codes == Verdict.STABLE)
    status = xp.where(is_stable, kind, TuningStatus.NO_STABLE_GAINS).astype(np.int8)
    return OptimalGains(best.alpha, best.beta, value, status)


def _searched(
    gamma: Array, delta: Array, *, delay: float, filters: Filters | None
) -> tuple[Array, ...]:
    """Return alpha, beta, x and y of the best pairs of plants, and how each is known."""
    plants = zip(gamma.ravel().tolist(), delta.ravel().tolist(), strict=True)
    best = [_best_known(mass_walls(*plant, delay, filters)) for plant in plants]
    pairs = np.array([pair for pair, _ in best]).reshape(-1, 4).T
    kinds = np.array([kind for _, kind in best], np.int8)
    return *(column.reshape(gamma.shape) for column in pairs), kinds.reshape(gamma.shape)


def _loop_of(gamma: Array, delta: Array, delay: float, filters: Filters | None) -> LinearLoop:
    return filtered_loop(gamma, delta, int(delay), delay % 1.0, filters or NO_FILTERS)


def mass_walls(gamma: float, delta: float, delay: float, filters: Filters | None) -> Walls:
    """Return all walls of a loop of one mass, its filters in units of one sample."""
    loop = _loop_of(np.float64(gamma), np.float64(delta), delay, filters)
    return walls_of(loop, searched_component(gamma, delta, delay, filters))


def walls_of(loop: LinearLoop, component: Component) -> Walls:
    """Return all walls of any linear loop, with the component that the search covers."""
    family = family_of_loop(loop)
    zeros = np.roots(family.stiff)
    near = zeros[np.abs(zeros) > _NEAR_CIRCLE] + 0j
    return Walls(family, scan_angles(family.base.size - 1, near), component)


def _followed(family: Family, best: Pair, kind: Array) -> Pair:
    """Return the pair with its derivatives: those of one more step of Newton's method."""
    # Where no equations are known that it solves, they are NaN.
    is_triple = kind == TuningStatus.TRIPLE_ROOT
    step = newton_step(family, constant(best), is_triple)
    moved = [a + b for a, b in zip(constant(best), step, strict=True)]
    exact = is_triple | (kind == TuningStatus.DOUBLE_PAIR)
    return Pair(*_chosen()(moved, list(best), exact))


@cache
def _chosen() -> Any:
    import jax
    import jax.numpy as jnp

    @jax.custom_jvp
    def chosen(solution: list[Array], scanned: list[Array], exact: Array) -> list[Array]:
        return [jnp.where(exact, a, b) for a, b in zip(solution, scanned, strict=True)]

    @chosen.defjvp
    def _jvp(primals: Any, tangents: Any) -> Any:
        exactly = jnp.where(primals[2], 1.0, jnp.nan)
        return chosen(*primals), [tangent * exactly for tangent in tangents[0]]

    return chosen
