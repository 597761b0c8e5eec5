"""The search for the dominant pair of poles of the smallest radius.

For a pair z = r e^(+-i theta) (theta = 0 or pi: a double real root) both gains follow from
p(z) = 0, a linear system. If gains have all roots inside of r, then gains at the edge of the set of
all such gains have a pair on the circle, at some theta, and no other root is larger. So the set is
empty if the smallest rest(theta), the largest modulus of the other roots, is above r; and whatever
it is, max(r, rest) is a radius that gains reach. Both ends of an interval for the smallest radius
come from each r that is tried: rest is minimised over theta, first on a scan, then around the best
of its local minima.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int8

from jaxstab.arrays import Array, constant, namespace
from jaxstab.model import PlantCoefficients, companion_matrix

TRIPLE_ROOT, DOUBLE_PAIR, SCANNED = 1, 2, 3  # as TuningStatus numbers them

_SMALLEST, _LARGEST = 1e-4, 1.3  # radii that are looked at
_REAL = 1e-3  # rad: dominant pairs closer to the real axis are taken for real
_FIRST = 1e-5  # rad: close enough to a double real root
_MINIMA, _POINTS, _ROUNDS = 8, 9, 5  # of the scan that are looked at closer
_CLOSE = 1.01  # ends of the interval for the radius at which the search becomes local
_ROWS, _COLUMNS, _ZOOMS = 32, 48, 14
_NEWTON_STEPS = 24
_AGREEMENT = 1e-6  # relative, between the scan and the solution of the equations
_ROOM = 1e-4  # relative, below a radius, where a smaller one is looked for once more
_ATTEMPTS = 3
_NOISE, _MOST_NOISE = 1e-5, 1e-3  # relative, of a triple pole; of one whose gains lost digits

Angles = Float64[np.ndarray, " angle"]


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


def family_of(plant: PlantCoefficients, whole_delay: int) -> Family:
    """Return the polynomials of all walls at a plant, multiplied by z for a whole delay."""
    xp = namespace(plant)
    zero, one = xp.zeros_like(plant.d0), xp.ones_like(plant.d0)
    before, after = [zero] * (whole_delay + 1), [zero] * (whole_delay + 2)
    fall = plant.difference - plant.n0  # n2 - n1, to all of its digits for a whole delay
    columns = (
        [one, plant.d1, plant.d0, *after],
        [*before, plant.n2, plant.n1, plant.n0, zero],
        [*before, plant.n2, -fall, plant.n0 - plant.n1, -plant.n0],
    )
    return Family(*(xp.stack(column, axis=-1) for column in columns))


def searched(plant: PlantCoefficients, whole_delay: int) -> tuple[Array, ...]:
    """Return alpha, beta, x and y of the best pairs of plants, and how each is known."""
    shape = plant.d0.shape
    family = family_of(PlantCoefficients(*(np.ravel(field) for field in plant)), whole_delay)
    zeros = np.stack([np.ravel(field) for field in (plant.n2, plant.n1, plant.n0)], axis=-1)
    with np.errstate(all="ignore"):  # gains overflow where no pair can be
        found = [
            _best(Family(*one), _angles(whole_delay + 3, numerator))
            for *one, numerator in zip(*family, zeros, strict=True)
        ]
    pairs = np.array([pair for pair, _ in found]).reshape(-1, 4).T
    kinds: Int8[np.ndarray, " plant"] = np.array([kind for _, kind in found], np.int8)
    return *(part.reshape(shape) for part in pairs), kinds.reshape(shape)


def _angles(length: int, numerator: Float64[np.ndarray, "3"]) -> Angles:
    """Return the angles of a scan: parts of a turn of z^m, finer to both ends and at zeros of N."""
    count = 24 + 8 * length
    even = (np.arange(count) + 0.5) * (np.pi / count)
    ends = np.geomspace(_FIRST, even[0], 12, endpoint=False)
    near = np.geomspace(_FIRST, even[0], 8)
    zeros = np.abs(np.angle(np.roots(numerator)))[:, None]
    around = np.concatenate([(zeros - near).ravel(), (zeros + near).ravel()])
    angles = np.concatenate([ends, even, np.pi - ends, around])
    return np.unique(np.clip(angles, _FIRST, np.pi - _FIRST))


class _Point(NamedTuple):
    """Gains that put a pair of poles on a circle, and the largest modulus of all poles there."""

    reached: float
    radius: float
    angle: float


def _best(family: Family, angles: Angles) -> tuple[Pair, int]:
    """Return the best pair of a plant; what is found must stand a last scan of all angles."""
    low, high, point = _interval(family, angles, _SMALLEST, _LARGEST)
    pair, kind = _local(family, low, high, point)
    for _ in range(_ATTEMPTS):
        radius = float(np.hypot(pair.x, pair.y))
        if _scanned(family, radius * (1.0 - _ROOM), angles).reached >= radius * (1.0 - _AGREEMENT):
            break
        low, high, point = _interval(family, angles, 0.9 * low, radius)
        other, its_kind = _local(family, low, high, point)
        if np.hypot(other.x, other.y) >= radius:
            break
        pair, kind = other, its_kind
    return pair, kind


def _interval(
    family: Family, angles: Angles, low: float, high: float
) -> tuple[float, float, _Point]:
    """Return two radii, the smallest one between them, and the best point that was met."""
    trial = min(1.0, high)
    best = _Point(np.inf, high, float(angles[0]))
    while high > low * _CLOSE:
        point = _scanned(family, trial, angles)
        best = min(best, point)
        if point.reached <= trial * (1.0 + _NOISE):
            high = trial
        else:
            low, high = trial, min(high, point.reached)
        trial = float(np.sqrt(low * high))
        if not low < trial < high:
            break
    return low, high, best


def _scanned(family: Family, radius: float, angles: Angles) -> _Point:
    """Return the point of the smallest radius among the pairs on a circle."""
    reached = _reached(family, radius, angles)
    padded = np.concatenate([[np.inf], reached, [np.inf]])
    is_least = (reached <= padded[:-2]) & (reached <= padded[2:]) & np.isfinite(reached)
    minima = np.flatnonzero(is_least)
    if not minima.size:
        return _Point(np.inf, radius, float(angles[0]))
    minima = minima[np.argsort(reached[minima])[:_MINIMA]]
    last = reached.size - 1
    left, right = angles[np.maximum(minima - 1, 0)], angles[np.minimum(minima + 1, last)]
    best = _Point(float(reached[minima[0]]), radius, float(angles[minima[0]]))
    rows = np.arange(minima.size)
    for _ in range(_ROUNDS):
        if best.reached <= radius * (1.0 + _NOISE):
            break
        closer = left[:, None] + (right - left)[:, None] * np.linspace(0.0, 1.0, _POINTS)
        values = _reached(family, radius, closer.ravel()).reshape(closer.shape)
        least = np.argmin(values, axis=1)
        row = int(np.argmin(values[rows, least]))
        found = float(values[row, least[row]]), radius, float(closer[row, least[row]])
        best = min(best, _Point(*found))
        left, right = (closer[rows, np.clip(least + side, 0, _POINTS - 1)] for side in (-1, 1))
    return best


def _reached(family: Family, radius: float, angles: Angles) -> Angles:
    """Return the largest modulus of the poles where pairs are on a circle; infinite for no gains.

    All poles are those of the gains as float64 has them, so each value is one that gains reach.
    """
    pairs = _pairs(family, np.full(angles.shape, radius), angles)
    return _largest_pole(family, pairs.alpha, pairs.beta)


def _largest_pole(family: Family, alpha: Array, beta: Array) -> Array:
    coefficients = family.polynomial(alpha, beta)
    finite = np.all(np.isfinite(coefficients), axis=-1)
    largest = np.full(finite.shape, np.inf)
    poles = np.linalg.eigvals(companion_matrix(coefficients[finite]))
    largest[finite] = np.max(np.abs(poles), axis=-1)
    return largest


def _local(family: Family, low: float, high: float, point: _Point) -> tuple[Pair, int]:
    """Return the best pair around a point: a multiple root where its equations have one.

    Pairs whose gains do not have their radius, by far more than the noise of a multiple root, are
    an artefact of digits that were lost: then the point itself is the answer.
    """
    start = _zoomed(family, low, high, point.angle)
    is_triple = bool(np.sin(np.arctan2(start.y, start.x)) < _REAL)
    solution = _multiple_root(family, start, is_triple)
    radius, scanned = np.hypot(solution.x, solution.y), np.hypot(start.x, start.y)
    agrees = abs(radius - scanned) <= _AGREEMENT * scanned
    if agrees and _is_dominant(family, solution, radius * (1.0 + _AGREEMENT)):
        best, kind = solution, TRIPLE_ROOT if is_triple else DOUBLE_PAIR
    else:
        best, kind = start, SCANNED
    gains = np.atleast_1d(best.alpha), np.atleast_1d(best.beta)
    if _largest_pole(family, *gains)[0] <= np.hypot(best.x, best.y) * (1.0 + _MOST_NOISE):
        return best, kind
    radius, angle = np.array([point.radius]), np.array([point.angle])
    met = Pair(*(part[0] for part in _pairs(family, radius, angle)))
    share = point.reached / point.radius
    return met._replace(x=share * met.x, y=share * met.y), SCANNED


def _zoomed(family: Family, low: float, high: float, angle: float) -> Pair:
    """Zoom in on the smallest r for which no other root is larger than the pair."""
    width = max(0.05, 0.3 * np.sin(angle))
    box = np.array([np.log(low) - 1e-3, np.log(high) + 1e-12, angle - width, angle + width])
    best = Pair(*(part[0] for part in _pairs(family, np.array([high]), np.array([angle]))))
    best = best._replace(x=high * np.cos(angle), y=high * np.sin(angle))
    for _ in range(_ZOOMS):
        radii = np.exp(np.linspace(box[0], box[1], _ROWS))[:, None]
        left, right = np.clip(box[2:], 0.0, np.pi)
        columns = np.linspace(left, right, _COLUMNS)
        columns = np.sort(np.append(columns, np.clip(angle, left, right)))
        pairs = _pairs(family, *np.broadcast_arrays(radii, columns))
        fits = _is_dominant(family, pairs, np.broadcast_to(radii, pairs.x.shape))
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
    return best


def _pairs(family: Family, radius: Array, angle: Array) -> Pair:
    """Solve p(z) = 0 for the gains; at theta = 0 and pi close enough to the double real root."""
    angle = np.clip(angle, _FIRST, np.pi - _FIRST)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    base, stiff, damp = (_value(part, x + 1j * y) for part in family)
    determinant = stiff.real * damp.imag - stiff.imag * damp.real
    alpha = (base.imag * damp.real - base.real * damp.imag) / determinant
    beta = (stiff.imag * base.real - stiff.real * base.imag) / determinant
    return Pair(alpha, beta, x, y)


def _is_dominant(family: Family, pair: Pair, radius: Array) -> Bool[np.ndarray, "*grid"]:
    """Return whether all roots but the pair are smaller than the radius (Schur and Cohn)."""
    rest = _quotient(family.polynomial(pair.alpha, pair.beta), pair)
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


# ------------------------------------------------------------- the equations of a multiple root


def _multiple_root(family: Family, start: Pair, is_triple: bool) -> Pair:
    """Solve for the multiple root; NaN where its equations are singular."""
    pair = start._replace(y=np.float64(0.0)) if is_triple else start
    for _ in range(_NEWTON_STEPS):
        try:
            step = newton_step(family, pair, np.asarray(is_triple))
        except np.linalg.LinAlgError:
            return Pair(*(np.float64(np.nan),) * 4)
        pair = Pair(*(a + b for a, b in zip(pair, step, strict=True)))
        size = max(abs(part) for part in pair)
        if not max(abs(part) for part in step) > 1e-15 * size:
            break
    return pair


def newton_step(family: Family, pair: Pair, is_triple: Array) -> Pair:
    """Return the step of Newton's method to a triple real root, or to a double complex pair.

    The equations are p = p' = p'' = y = 0 or p = p' = 0, those for alpha, beta, x and y.
    """
    xp = namespace(family, pair)
    z = pair.x + 1j * pair.y
    whole = family.polynomial(pair.alpha, pair.beta)
    # The polynomial and its derivatives, and those of its derivatives in alpha and beta.
    p, stiff, damp = (_taylor(part, z) for part in (whole, family.stiff, family.damp))
    zero = xp.zeros_like(pair.y)

    def rows(order: int, *, imaginary: bool) -> list[Array]:
        entries = stiff[order], damp[order], p[order + 1], 1j * p[order + 1], p[order]
        return [entry.imag if imaginary else entry.real for entry in entries]

    last = [zero, zero, zero, zero + 1.0, pair.y]
    triple = [*(rows(order, imaginary=False) for order in range(3)), last]
    double = [rows(order, imaginary=part) for order in range(2) for part in (False, True)]
    both = [xp.stack([xp.stack(row, axis=-1) for row in one], axis=-2) for one in (triple, double)]
    system = xp.where(xp.asarray(is_triple)[..., None, None], *both)
    step = xp.linalg.solve(constant(system[..., :4]), -system[..., 4:])[..., 0]
    return Pair(*(step[..., part] for part in range(4)))


def _taylor(coefficients: Array, z: Array) -> list[Array]:
    """Return a polynomial and its first three derivatives."""
    values = []
    for _ in range(4):
        values.append(_value(coefficients, z))
        powers = np.arange(coefficients.shape[-1] - 1, 0, -1)
        coefficients = coefficients[..., :-1] * powers
    return values


def _value(coefficients: Array, z: Array) -> Array:
    value = 0.0 * z
    for power in range(coefficients.shape[-1]):
        value = value * z + coefficients[..., power]
    return value
