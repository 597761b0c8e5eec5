"""The wall gains with the smallest spectral radius.

The radius has no smooth minimum: at the best gains several roots share the largest modulus, and at
a triple root it grows with the cube root of any change. So the search does not run over gains, but
over the dominant pair z = r e^(+-i theta) itself (theta = 0 or pi: a double real root), for which
p(z) = 0 gives both gains. If some gains have all roots inside radius r, then gains at the edge of
the set of all such gains have a pair on that circle, and no larger root. So r can be reached where
the largest modulus of the other roots, minimised over theta, is at most r; and the smallest such r
is found by bisection. All triple real roots are known beforehand: mostly one search at a slightly
smaller radius shows that one of them is the best.

Where the minimum is a multiple root, its equations are solved to full precision. Walls (K, B >= 0)
may have theirs on an edge, where one gain is fixed: the radius is then minimised over the other.

See Blondel, Gurbuzbalaban, Megretski, Overton (2012) for why roots coalesce.
"""

from collections.abc import Callable
from functools import cache, lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int8, Int64
from numpy.lib.stride_tricks import sliding_window_view

from jaxstab.arrays import Array, Numbers, constant, float_arrays, namespace, take
from jaxstab.batches import asked_of_lanes
from jaxstab.conventions import Status, Verdict
from jaxstab.model import checked_delay, checked_delta, checked_gain, checked_gamma, require_x64
from jaxstab.model.filters import NO_FILTERS, Filter, Velocity, known_filters
from jaxstab.model.linear_loop import LinearLoop, filtered_loop
from jaxstab.model.loop import LoopParameters, unit_loops
from jaxstab.numbers import checked_number, require_together
from jaxstab.point import linear_spectral_radius, linear_verdict
from jaxstab.region import RegionStatus, StableRegion
from jaxstab.region.measures import contains
from jaxstab.region.pieces import all_inside, without_pair
from jaxstab.region.region import loop_region

# The one minimiser: a grid over two coordinates, and finer grids around its best points.
#
# Radii and settling times have kinks, edges, and narrow valleys where poles meet, so no slopes are
# asked for. All points of a grid are computed at once. Around the best of its local minima finer
# grids follow, each a quarter or less as wide as the last one; a minimum that cannot become the
# best one is given up. One coordinate may be fixed.

Axis = Float64[np.ndarray, " _"]
Values = Callable[[np.ndarray, np.ndarray], np.ndarray]  # at lists of both coordinates


def minimised(
    values: Values,
    axes: tuple[Axis, Axis],
    *,
    first: Float64[np.ndarray, " point"] | None = None,
    starts: int = 1,
    points: int = 33,
    reach: int = 4,
    zooms: int = 12,
    enough: float = -np.inf,
    lowest: float = -np.inf,
) -> tuple[tuple[float, float], float]:
    """Return the point of the smallest value that grids find, and this value.

    They are NaN and infinite where no value of the first grid is finite.

    Args:
        values: infinite where a point does not count.
        axes: the first grid, increasing; an axis of one value is fixed.
        first: the values on it, if they are known.
        starts: how many local minima of the first grid are followed.
        points: on an axis of finer grids.
        reach: steps of a grid, to each side of its best point, over which the next one extends.
        zooms: how many finer grids there are at most.
        enough: a value at which the search ends; minima that cannot reach it are given up.
        lowest: no coordinate of a finer grid is below it.
    """
    first = values(*on_grid(axes)) if first is None else first
    first = first.reshape([axis.size for axis in axes])
    places = _local_minima(first)[:starts].T
    if not places.size:
        return (np.nan, np.nan), np.inf
    centres, least = np.array([axes[0][places[0]], axes[1][places[1]]]), first[tuple(places)]
    halves = np.array([_extent(*pair, reach) for pair in zip(axes, places, strict=True)])
    steps = np.linspace(-1.0, 1.0, points)
    shares = np.meshgrid(*(steps if axis.size > 1 else np.zeros(1) for axis in axes), indexing="ij")
    offsets = np.stack([mesh.ravel() for mesh in shares])[:, None, :]
    best, value = centres[:, 0], float(least[0])
    for _ in range(zooms):
        if value <= enough or not least.size:
            break
        finer = np.maximum(centres[..., None] + halves[..., None] * offsets, lowest)
        found = values(*finer.reshape(2, -1)).reshape(finer.shape[1:])
        boxes, place = np.arange(least.size), np.argmin(found, axis=1)
        is_better = found[boxes, place] < least
        centres = np.where(is_better, finer[:, boxes, place], centres)
        least = np.minimum(least, found[boxes, place])
        smallest = np.argmin(least)
        if least[smallest] < value:
            best, value = centres[:, smallest], float(least[smallest])
        # Between two points, slopes go down by no more than about what they do over the grid.
        spread = np.where(np.isfinite(found), found, -np.inf).max(axis=1) - least
        lower = least - np.maximum(spread, 0.0) * (4.0 / points)
        is_open = lower < (enough if enough > -np.inf else value)
        centres, least, halves = centres[:, is_open], least[is_open], halves[:, is_open]
        halves = halves * (reach / (points // 2))
    return (float(best[0]), float(best[1])), value


def on_grid(axes: tuple[Axis, Axis]) -> list[Axis]:
    """Both coordinates of the points of a grid."""
    return [mesh.ravel() for mesh in np.meshgrid(*axes, indexing="ij")]


def _extent(axis: Axis, index: np.ndarray, reach: int) -> Axis:
    """The reach of some steps along an axis from points of it."""
    sides = [np.clip(index + side * reach, 0, axis.size - 1) for side in (-1, 1)]
    return np.max([np.abs(axis[side] - axis[index]) for side in sides], axis=0)


def _local_minima(values: np.ndarray) -> Int64[np.ndarray, "minimum 2"]:
    """Return the places of values that no neighbour is below, the least first."""
    around = sliding_window_view(np.pad(values, 1, constant_values=np.inf), (3, 3))
    is_least = np.isfinite(values) & (values <= around.min(axis=(2, 3)))
    places = np.argwhere(is_least)
    return places[np.argsort(values[is_least], kind="stable")]


# Multiple roots of p(z), which the best gains have, as equations for Newton's method.
#
# A triple real root solves p = p' = p'' = 0, a double complex pair p = p' = 0, for the gains and z.
# p is affine in the gains, so that triple roots are those of one polynomial: all of them are known.

_LARGEST = 1.3  # radius of the search; a root beyond it is no longer the one that was followed
_NEARLY_REAL = 1e-3  # imaginary parts of real roots of polynomials with rounded coefficients


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
    return Family(*(xp.stack(xp.broadcast_arrays(*part), axis=-1) for part in parts))


def _triple_roots(family: Family) -> Pair:
    """Return all triple real roots, with y = 0, to the accuracy of the roots of a polynomial."""
    # The equations are linear in the gains and 1, so that the determinant of the three is a
    # polynomial in z that vanishes at the triple roots of all gains.
    base, stiff, damp = map(_derivatives, family)
    determinant: Array = np.zeros(1)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        minor = np.convolve(stiff[j], damp[k]), np.convolve(stiff[k], damp[j])
        determinant = np.polyadd(determinant, np.convolve(base[i], np.polysub(*minor)))
    roots = np.roots(determinant)
    z = roots[(abs(roots.imag) < _NEARLY_REAL * abs(roots)) & (abs(roots) < _LARGEST)].real
    p, stiff, damp = (
        [_value(polynomials, z) for polynomials in parts[:2]] for parts in (base, stiff, damp)
    )
    divisor = stiff[0] * damp[1] - stiff[1] * damp[0]
    alpha = (p[1] * damp[0] - p[0] * damp[1]) / divisor
    beta = (p[0] * stiff[1] - p[1] * stiff[0]) / divisor
    return Pair(alpha, beta, z, np.zeros_like(z))


def _solved(family: Family, start: Pair, is_triple: bool) -> Pair:
    """Solve for the multiple root; NaN where the steps do not become small."""
    nothing = Pair(*(np.float64(np.nan),) * 4)
    pair = start._replace(y=np.float64(0.0)) if is_triple else start
    change = np.inf
    for count in range(10):
        try:
            step = _newton_step(family, pair, np.asarray(is_triple))
        except np.linalg.LinAlgError:
            return nothing
        pair = Pair(*(a + b for a, b in zip(pair, step, strict=True)))
        change = np.hypot(step.x, step.y) / np.hypot(pair.x, pair.y)
        size = max(abs(entry) for entry in pair)
        if not max(abs(entry) for entry in step) > 1e-15 * size or abs(pair.x) > _LARGEST:
            break
        if count == 4 and change > 0.05:  # no root is near
            break
    return pair if change < 1e-6 else nothing


def _newton_step(family: Family, pair: Pair, is_triple: Array) -> Pair:
    """Return the step of Newton's method to a triple real root, or to a double complex pair."""
    # The equations are p = p' = p'' = y = 0 or p = p' = 0, those for alpha, beta, x and y.
    xp = namespace(family, pair)
    z = pair.x + 1j * pair.y
    whole = family.polynomial(pair.alpha, pair.beta)
    # The polynomial and its derivatives, and those of its derivatives in alpha and beta.
    every = xp.stack(xp.broadcast_arrays(whole, family.stiff, family.damp))
    p, stiff, damp = _value(_derivatives(every), z[..., None])
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
    """Polynomials and their first three derivatives, with zeros in front."""
    xp, powers = namespace(coefficients), np.arange(coefficients.shape[-1])[::-1]
    found = [coefficients]
    for _ in range(3):
        falling = found[-1] * powers
        found.append(xp.concatenate([0.0 * falling[..., :1], falling[..., :-1]], axis=-1))
    return xp.stack(found, axis=-2)


def _value(coefficients: Array, z: Array) -> Array:
    """Return the value of a polynomial."""
    xp = namespace(coefficients, z)
    return xp.polyval(xp.moveaxis(coefficients, -1, 0), z)


# Walls, and the search over the dominant pair.


class TuningStatus(Status):
    """The status of the best gains; small integers, so that arrays store int8.

    None of them proves that no other gains are better. With filters the stable set may have several
    components: the search covers the one that is connected to zero gains through positive ones, and
    other components only where the status says so.

    Example:
        >>> jaxstab.results.TuningStatus(1).words
        'found by a search: a triple real pole, to full precision'
    """

    NOT_COMPUTED = 0, "not computed"
    TRIPLE_ROOT = 1, "found by a search: a triple real pole, to full precision"
    DOUBLE_PAIR = 2, "found by a search: a double pair of poles, to full precision"
    SCANNED = 3, "found by a search, not proved to be the best"
    NO_STABLE_GAINS = 4, "no stable gains were found"
    ISLAND = 5, "found by a search, in an island: small gains are not stable"
    ANY_COMPONENT = 6, "found by a search, perhaps in an island: the region is not resolved"
    NOT_CALM = 7, "no gains were found that keep encoder chatter within the limit"
    ENDLESS = 8, "there are no best gains: ever larger ones decay ever faster"
    NOT_USABLE = 9, "no gains were found that have the margins asked for"


class OptimalGains(NamedTuple):
    """The best gains, their radius or settling time in samples, and a status.

    Example:
        >>> best = jaxstab.minimize_radius(gamma=0.0, delta=0.0, delay=0.0)
        >>> round(float(best.value), 9)  # 4^(1/3) - 1
        0.587401052
    """

    alpha: Float64[Array, "*grid"]
    beta: Float64[Array, "*grid"]
    value: Float64[Array, "*grid"]
    status: Int8[Array, "*grid"]


def found_gains(wall: tuple[float, float], value: float, status: TuningStatus) -> OptimalGains:
    """Return those of one loop."""
    alpha, beta, number = (np.array(each, np.float64) for each in (*wall, value))
    return OptimalGains(alpha, beta, number, np.array(status, np.int8))


_CLOSEST = 1e-5  # rad: of a pair, to a double real root
_AGREEMENT = 1e-6  # relative, between a search and the solution of equations
_NOISE = 1e-3  # relative, of a triple pole whose gains are rounded


class Walls(NamedTuple):
    """All walls of a loop, p(z) of each, among which the best one is searched.

    main: the component that the search covers; None for all gains.
    status: of gains that are found; NOT_COMPUTED leaves it to the search.
    lowest: alpha and beta of searches; 0 where gains must be those of walls.
    shares: of alpha and beta, whose sum is at most 1 in searches.
    """

    linear: LinearLoop
    family: Family
    main: StableRegion | None = None
    status: TuningStatus = TuningStatus.NOT_COMPUTED
    lowest: float = -np.inf
    shares: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def of_loop(cls, loop: LinearLoop, region: StableRegion | None) -> "Walls":
        """All walls of any linear loop; the search covers the component of small gains."""
        walls = cls(loop, family_of_loop(loop))
        if region is None:  # the stable set was always seen to be one component
            return walls
        if region.status == RegionStatus.UNRESOLVED:
            return walls._replace(status=TuningStatus.ANY_COMPONENT)
        if region.main is None:
            return walls._replace(status=TuningStatus.ISLAND)
        return walls._replace(main=region.main if region.islands else None)

    def decay(self, alpha: float, beta: float, radius: float) -> bool:
        """True if gains are proved stable, and their radius is less than 1 in float64, too."""
        slow = 0.999  # radii from which on those of coinciding poles may be 1
        wall = np.asarray(alpha), np.asarray(beta)
        if linear_verdict(wall[0], wall[1], self.linear) != Verdict.STABLE:
            return False
        if radius < slow:
            return True
        return bool(linear_spectral_radius(wall[0], wall[1], self.linear).value < 1.0)

    def holds(self, alpha: np.ndarray, beta: np.ndarray) -> Bool[np.ndarray, "*grid"]:
        """True for the stable gains that are searched: those inside of the component."""
        is_wall = self.are_searched(alpha, beta)
        if self.main is None or not is_wall.size:
            return is_wall
        return is_wall & np.asarray(contains(self.main.curve, self.main.outline, alpha, beta))

    def are_searched(self, alpha: Array, beta: Array) -> Bool[np.ndarray, "*grid"]:
        """True for gains that are neither too small nor too large; NaN is not."""
        used = self.shares[0] * alpha + self.shares[1] * beta
        return np.asarray((np.minimum(alpha, beta) >= self.lowest) & (used <= 1.0))

    def are_inside(self, alpha: Array, beta: Array, radius: float) -> Bool[np.ndarray, "*grid"]:
        """Return where all poles seem to be inside of a circle; not proved."""
        coefficients = np.moveaxis(self.family.polynomial(alpha, beta), -1, 0)
        return all_inside(coefficients, radius)

    def radii(self, alpha: Array, beta: Array, below: float = np.inf) -> np.ndarray:
        """The largest modulus of poles; infinite for others than searched, or not ``below``."""
        coefficients = self.family.polynomial(alpha, beta)
        searched = np.isfinite(coefficients).all(axis=-1) & self.are_searched(alpha, beta)
        if below < np.inf:
            searched &= self.are_inside(alpha, beta, below)
        radii = np.full(searched.shape, np.inf)
        radii[searched] = _largest_moduli(coefficients[searched])
        stable = radii < 1.0
        radii[stable] = np.where(self.holds(alpha[stable], beta[stable]), radii[stable], np.inf)
        return radii

    @property
    def angles(self) -> Axis:
        """Angles of a scan: parts of a turn of z^n, finer to both ends and at zeros of N."""
        zeros = np.roots(self.family.stiff) + 0j
        turns = np.abs(np.angle(zeros[np.abs(zeros) > 0.9]))[:, None]  # they bend the curve sharply
        count = 16 + 8 * self.family.base.size
        even = (np.arange(count) + 0.5) * (np.pi / count)
        near = np.geomspace(_CLOSEST, even[0], 12)
        around = [near, np.pi - near, (turns - near).ravel(), (turns + near).ravel()]
        return np.unique(np.clip(np.concatenate([even, *around]), _CLOSEST, np.pi - _CLOSEST))

    def pairs(self, radius: Array, angle: Array) -> Pair:
        """Solve p(z) = 0 for the gains; at 0 and pi close enough to the double real root."""
        angle = np.clip(angle, _CLOSEST, np.pi - _CLOSEST)
        x, y = radius * np.cos(angle), radius * np.sin(angle)
        parts = np.stack(self.family)
        base, stiff, damp = _value(parts.reshape(len(parts), *(1,) * x.ndim, -1), x + 1j * y)
        determinant = stiff.real * damp.imag - stiff.imag * damp.real
        alpha = (base.imag * damp.real - base.real * damp.imag) / determinant
        beta = (stiff.imag * base.real - stiff.real * base.imag) / determinant
        return Pair(alpha, beta, x, y)

    def others(self, radius: Array, angle: Array, near: float = 1.2) -> np.ndarray:
        """The largest modulus of the poles beside a pair; infinite beyond ``near`` radii."""
        pair = self.pairs(radius, angle)
        falling = np.moveaxis(self.family.polynomial(pair.alpha, pair.beta), -1, 0)
        quotient = without_pair(falling[:-2], 2.0 * pair.x, pair.x**2 + pair.y**2)
        searched = self.are_searched(pair.alpha, pair.beta)
        searched &= all_inside(quotient, near * radius) & np.isfinite(quotient).all(axis=0)
        others = np.full(radius.shape, np.inf)
        others[searched] = _largest_moduli(quotient[:, searched].T)
        # Gains that lost digits to cancellation do not have the pair; gains elsewhere do not count.
        best = np.flatnonzero(others <= radius * (1.0 + _NOISE))
        reached = self.radii(pair.alpha[best], pair.beta[best])
        is_wrong = reached > np.maximum(others, radius)[best] * (1.0 + 0.1 * _NOISE)
        others[best] = np.where(is_wrong, reached, others[best])
        return others

    def least_others(
        self, radius: float, angles: Axis, near: float = 1.2, enough: float = -np.inf
    ) -> tuple[float, float]:
        """Minimise the other poles over the angle of a pair; return it with their modulus."""
        (_, angle), others = minimised(
            partial(self.others, near=near),
            (np.array([radius]), angles),
            starts=8,
            points=17,
            reach=1,
            zooms=8,
            enough=enough,
        )
        return angle, others


def _largest_moduli(coefficients: Float64[np.ndarray, "polynomial coefficient"]) -> np.ndarray:
    """The largest moduli of roots; of high degrees by halving the circles that may hold all."""
    degree, long, halvings = coefficients.shape[1] - 1, 60, 45
    if degree <= long:
        companion = np.zeros((len(coefficients), degree, degree))
        companion[:, :1] = -coefficients[:, None, 1:]
        companion[:, range(1, degree), range(degree - 1)] = 1.0
        return np.abs(np.linalg.eigvals(companion)).max(axis=-1, initial=0.0)
    falling, powers = coefficients.T, 1.0 / np.arange(1, degree + 1)
    high = 2.0 * np.max(np.abs(coefficients[:, 1:]) ** powers, axis=1)  # Fujiwara's bound
    low = np.zeros_like(high)
    for _ in range(halvings):
        middle = 0.5 * (low + high)
        inside = all_inside(falling, middle)
        low, high = np.where(inside, low, middle), np.where(inside, middle, high)
    return high


class Best(NamedTuple):
    """A pair of poles, with the gains and their radius as far as it is known, and a status."""

    pair: Pair
    radius: float
    status: TuningStatus

    @property
    def wall(self) -> tuple[float, float]:
        """The gains."""
        return float(self.pair.alpha), float(self.pair.beta)


_NOTHING = Best(Pair(*(np.float64(np.inf),) * 4), np.inf, TuningStatus.SCANNED)


def smallest_radius(walls: Walls, alpha: float | None = None) -> Best:
    """Return the best gains of one loop, or the best beta for an alpha.

    The pair has the radius, also where it is on an edge: gains of walls are searched there, too.
    """
    if alpha is not None:
        return _best_damping(walls, alpha)
    with np.errstate(all="ignore"):  # gains overflow where no pair can be
        best = _smallest(walls._replace(lowest=-np.inf, shares=(0.0, 0.0)))
        if not walls.are_searched(*best.wall):
            zero, edge = np.zeros(1), np.append(0.0, _GAINS)
            edges = [(zero, edge), (edge, zero)]
            edges += [(edge, np.full(1, 1.0 / share)) for share in walls.shares[1:] if share]
            on_edges = [_on_line(walls, axes, below=1.0) for axes in edges]
            best = min([_smallest(walls), *on_edges], key=lambda each: each.radius)
    if not (best.radius < _LARGEST and walls.decay(*best.wall, best.radius)):
        return best._replace(status=TuningStatus.NO_STABLE_GAINS)
    return best._replace(status=walls.status or best.status)


def _smallest(walls: Walls) -> Best:
    """Return the best pair of a loop; a last scan of all angles finds no better one."""
    # Ever smaller circles are tried, first just below a triple root. The least one that a pair can
    # be on is that of a multiple root next to it, or else the root of how far the other poles are
    # outside: the secant method, in which an end that stays weighs less and less.
    best, angles, low = _triple_root(walls), walls.angles, 1e-4
    high, is_multiple = min(best.radius, _LARGEST), best.radius < _LARGEST
    outside, inside, step, stays = np.inf, np.nan, 0.9, ""  # how far outside, at both ends
    for _ in range(100):
        if not high - low > 1e-8 * high:
            break
        trial = max(step * high, np.sqrt(low * high))
        near = np.clip(1.0 + 20.0 * (high - low) / high, 1.002, 1.2)
        if is_multiple:
            trial, near = (1.0 - _AGREEMENT) * high, 1.2
        elif np.isfinite(outside - inside):
            share = outside / (outside - inside)
            trial = low + np.clip(share, 0.05, 0.95) * (high - low)
        angle, others = walls.least_others(trial, angles, near, trial)
        if others <= trial:
            high, step, inside, is_multiple = trial, step * step, others - trial, False
            outside, stays = (0.5 * outside if stays == "low" else outside), "low"
        elif is_multiple:
            break
        else:
            low, outside = trial, others - trial
            inside, stays = (0.5 * inside if stays == "high" else inside), "high"
        if others < np.inf:
            angles = np.union1d(angles, angle)
            pair = _pair_at(walls, trial, angle)
            best = min(best, _reached(walls, pair), key=lambda each: each.radius)
            found = _multiple_root(walls, pair)
            if outside < np.inf and low <= found.radius <= high:
                best, high, inside, is_multiple = found, found.radius, np.nan, True
    return best


def _triple_root(walls: Walls) -> Best:
    """Return the smallest triple real root without a larger pole."""
    roots = _triple_roots(walls.family)
    sizes = abs(roots.x)
    is_real = walls.radii(roots.alpha, roots.beta) <= sizes * (1.0 + _NOISE)
    for index in np.argsort(np.where(is_real, sizes, np.inf))[: np.sum(is_real)]:
        found = _multiple_root(walls, take(roots, index))
        if abs(found.radius - sizes[index]) <= _AGREEMENT * sizes[index]:
            return found
    return _NOTHING


def _multiple_root(walls: Walls, start: Pair) -> Best:
    """Return the multiple root next to a pair; nothing where there is none without larger poles."""
    is_triple = bool(abs(start.y) < _NEARLY_REAL * abs(start.x))
    pair = _solved(walls.family, start, is_triple)
    radius, angle = np.hypot(pair.x, pair.y), np.arctan2(pair.y, pair.x)
    is_kind = is_triple or pair.y > _NEARLY_REAL * radius
    if not (radius < _LARGEST and is_kind):
        return _NOTHING
    if not walls.others(radius[None], angle[None])[0] <= radius * (1.0 + _AGREEMENT):
        return _NOTHING
    status = TuningStatus.TRIPLE_ROOT if is_triple else TuningStatus.DOUBLE_PAIR
    return Best(pair, float(radius), status)


def _reached(walls: Walls, pair: Pair) -> Best:
    """Return gains with the radius that they have."""
    radius = float(walls.radii(pair.alpha[None], pair.beta[None])[0])
    share = radius / np.hypot(pair.x, pair.y)
    return Best(pair._replace(x=share * pair.x, y=share * pair.y), radius, TuningStatus.SCANNED)


def _pair_at(walls: Walls, radius: float, angle: float) -> Pair:
    return take(walls.pairs(np.array([radius]), np.array([angle])), 0)


# The best gains where one of them is given.

_GAINS = np.geomspace(1e-7, 1e2, 600)  # of either sign, tried for the other one


def _on_line(walls: Walls, axes: tuple[Axis, Axis], below: float) -> Best:
    """Return the best gains of a line, searched among those of radii below a limit."""
    radii = partial(walls.radii, below=below)
    (alpha, beta), radius = minimised(
        radii, axes, starts=8, points=17, reach=1, lowest=walls.lowest
    )
    pair = Pair(np.float64(alpha), np.float64(beta), np.float64(radius), np.float64(0.0))
    return Best(pair, radius, TuningStatus.SCANNED)


def _best_damping(walls: Walls, alpha: float) -> Best:
    """Return the damping with the smallest radius for a stiffness."""
    betas = np.concatenate([-_GAINS[::-1], [0.0], _GAINS])
    axes = np.array([alpha]), betas[betas >= walls.lowest]
    for own, status in ((walls, walls.status), (walls._replace(main=None), TuningStatus.ISLAND)):
        best = _on_line(own, axes, below=1.0)
        if best.radius < 1.0:
            return best._replace(status=status or best.status)
    return _on_line(walls, axes, below=np.inf)._replace(status=TuningStatus.NO_STABLE_GAINS)


def minimize_radius(
    *,
    gamma: Numbers,
    delta: Numbers,
    delay: Numbers,
    alpha: float | None = None,
    velocity: Velocity | None = None,
    position: Filter | None = None,
) -> OptimalGains:
    """The gains (alpha, beta) with the smallest spectral radius, or beta for an alpha.

    In the haptic range the best gains make a triple real pole; with a stiff hand and a delay, a
    double complex pair. Both are solved for to full precision. The best alpha may be negative if
    the hand is stiff, beta if it is damped; ``HapticLoop.tune`` gives walls of K >= 0 and B >= 0.
    It is not proved that no other gains are better: the search looks for a smaller radius at every
    angle of the dominant pair, to the resolution of its scan.

    With an estimator or a filter the stable set may have several components. The best gains are
    then those of the component that holds small positive gains; if there is none, those of the
    islands, and the status says so. Damping for a given stiffness is scanned over both signs and
    nine decades: where two real poles meet, to about 1e-14 of beta and 1e-8 of the radius.

    Args:
        gamma, delta, velocity, position: see ``jaxstab.conventions``.
        delay: time delay t_d/T >= 0 in samples, one concrete number; filters are concrete, too.
        alpha: the stiffness, one concrete number, where only the damping is chosen.

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
        >>> best = jaxstab.minimize_radius(alpha=0.05, gamma=0.0, delta=0.015, delay=1.0)
        >>> round(float(best.beta), 4), round(float(best.value), 4)
        (0.3203, 0.823)
    """
    require_x64(alpha)
    require_together(gamma=gamma, delta=delta)
    checked_delay(delay)
    if alpha is not None:
        alpha = checked_number("alpha", checked_gain("alpha", alpha))
    delay = checked_number("delay", delay, 0.0)
    filters = known_filters(velocity, position)
    gamma, delta = float_arrays(checked_gamma(gamma), checked_delta(delta))
    xp = namespace(gamma, delta)
    gamma, delta = xp.broadcast_arrays(gamma, delta)

    def ask(loop: LoopParameters) -> tuple[Array, ...]:
        found = smallest_radius(walls_of(loop), alpha)
        return *found.pair, found.status

    lanes, loop_of = (gamma, delta, delay), unit_loops(velocity, position)
    *fields, kind = asked_of_lanes(ask, loop_of, lanes, 5, is_count=True, gains=0)
    best = Pair(*fields)
    if xp is not np:
        loop = filtered_loop(gamma, delta, int(delay), delay % 1.0, filters or NO_FILTERS)
        best = _followed(family_of_loop(loop), best, kind)
    value = xp.hypot(best.x, best.y)
    return OptimalGains(best.alpha, best.beta, value, kind.astype(np.int8))


@lru_cache(maxsize=64)
def walls_of(loop: LoopParameters) -> Walls:
    """All walls of a loop in plain numbers, as alpha and beta."""
    is_plain = loop.body is not None and not (loop.velocity or loop.position)
    return Walls.of_loop(loop.linear, None if is_plain else loop_region(loop, 1e-6))


def _followed(family: Family, best: Pair, kind: Array) -> Pair:
    """Return the pair with its derivatives: those of one more step of Newton's method."""
    # Where no equations are known that it solves, they are NaN.
    is_triple = kind == TuningStatus.TRIPLE_ROOT
    step = _newton_step(family, constant(best), is_triple)
    moved = [a + b for a, b in zip(constant(best), step, strict=True)]
    exact = is_triple | (kind == TuningStatus.DOUBLE_PAIR)
    return Pair(*_chosen()(moved, list(best), exact))


@cache
def _chosen() -> Any:
    import jax

    jnp = jax.numpy

    @jax.custom_jvp
    def chosen(solution: list[Array], scanned: list[Array], exact: Array) -> list[Array]:
        return [jnp.where(exact, a, b) for a, b in zip(solution, scanned, strict=True)]

    @chosen.defjvp
    def _jvp(primals: Any, tangents: Any) -> Any:
        exactly = jnp.where(primals[2], 1.0, jnp.nan)
        return chosen(*primals), [tangent * exactly for tangent in tangents[0]]

    return chosen
