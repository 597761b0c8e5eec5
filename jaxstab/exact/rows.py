"""Verdicts of a dense slice by rows: one for each stretch that the boundary does not meet.

A row of a grid has one alpha. Along it a root of p(z) reaches the unit circle only where the row
meets the curve of the walls with a pair at e^(+-i theta), or the line of z = -1; the line of z = 1
is a row itself. The curve is

    alpha = A/M,    beta = B/M,    x = 2 cos(theta) in [-2, 2],

where A, B and M are Im(base conj damping), Im(stiffness conj base) and Im(damping conj stiffness),
each over sin(theta), of the parts of p(z): cosine sums, known in balls. So all zeros of the
derivatives of both quotients are isolated (``exact.circle``). Between two of them, and between any
other places that are put there, alpha and beta are monotone: the curve stays in the box of its two
ends. Ends are computed in float64, with a bound of their error. Boxes that hold more than a few
points are parted.

A row falls into stretches that no box meets, each with one proved verdict, and the few points in
boxes, which are asked one by one (lemma V11 of docs/proofs.md). Not all slices are fit for it: a
plant may vanish on the circle elsewhere than at -1, or the boundary may meet too many points.
"""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from flint import arb, arb_poly
from jaxtyping import Float64, Int8, Int64

from jaxstab.arrays import Array, Numbers
from jaxstab.conventions import Verdict
from jaxstab.exact.circle import is_positive, zeros
from jaxstab.exact.roots import is_sharp, sign_of
from jaxstab.model.balls import Triple, ball_triple
from jaxstab.model.device.parts import decided
from jaxstab.model.loop import unit_loop
from jaxstab.rounding import SAFETY, UNIT

_SHARE = 8  # one point of so many may be asked
_SHARP = 2.0**-60  # the radii of places, and of the coefficients of a sum relative to these

Row = Float64[np.ndarray, " _"]
Indices = Int64[np.ndarray, " _"]
Codes = Int8[np.ndarray, " _"]


class _Boundary(NamedTuple):
    """Where a root is on the circle.

    Attributes:
        cosines: the coefficients of A, B and M.
        places: x of the ends of the curve and of all zeros of the two derivatives, rising.
        line: beta for z = -1 at alpha = 0, and its slope; nothing if no wall moves a root there.
    """

    cosines: Float64[np.ndarray, "3 order"]
    places: Row
    line: tuple[float, ...]


def row_codes(
    points: Iterable[Numbers], codes_of: Callable[[Row, Row], Array]
) -> Int8[np.ndarray, "alpha beta"] | None:
    """Return the verdicts of a dense slice; None for other points, and where a slice is not fit.

    ``points`` are alpha (A, 1), beta (B,) or (1, B), which rises, and one gamma, delta and delay.
    ``codes_of`` proves the verdicts of walls one by one.
    """
    most_bits = 768
    alpha, beta, *plant = (np.asarray(value, np.float64) for value in points)
    size, width = alpha.size * beta.size, beta.size
    is_slice = alpha.shape == (alpha.size, 1) and beta.shape in ((width,), (1, width))
    is_slice = is_slice and all(value.size == 1 and value.ndim < 3 for value in plant)
    alpha, beta = alpha.ravel(), beta.ravel()
    if not is_slice or np.any(beta[1:] < beta[:-1]):
        return None
    gamma, delta, delay = (value.item() for value in plant)
    loop = unit_loop(gamma, delta, delay, None, None)
    boundary = decided(lambda: _boundary(ball_triple(loop)), most_bits)
    if boundary is None:
        return None
    start, stop = _met(boundary, alpha, beta)
    if np.sum(stop - start) + start.size > size // _SHARE:
        return None

    def of_points(indices: Indices) -> Codes:
        rows, columns = np.divmod(indices, width)
        return np.ravel(codes_of(alpha[rows], beta[columns]))

    before = np.maximum.accumulate(np.append(0, stop))
    ends = np.stack([before, np.append(start, size)])
    begin, end = ends[:, ends[0] < ends[1]]  # of stretches
    shared = of_points((begin + end) // 2)
    codes = np.full(size, Verdict.UNSTABLE, np.int8)
    is_stable, is_open = shared == Verdict.STABLE, shared == Verdict.UNDECIDED
    for first, last in zip(begin[is_stable].tolist(), end[is_stable].tolist(), strict=True):
        codes[first:last] = Verdict.STABLE
    in_boxes = _members(np.maximum(start, before[:-1]), stop)
    asked = np.concatenate([in_boxes, _members(begin[is_open], end[is_open])])
    codes[asked] = of_points(asked)
    return codes.reshape(alpha.size, width)


def _members(begin: Indices, end: Indices) -> Indices:
    """Return all members of ranges, one range after the other."""
    count = np.maximum(end - begin, 0)
    return np.arange(np.sum(count)) + np.repeat(begin - np.cumsum(count) + count, count)


def _met(boundary: _Boundary, alpha: Row, beta: Row) -> tuple[Indices, Indices]:
    """Return ranges of points, by their begins, that hold all which the boundary may meet.

    Each row begins with an empty one.
    """
    rows, order = np.arange(alpha.size), np.argsort(alpha)
    low_row, high_row, low, high = _boxes(boundary, alpha[order], beta)
    count = high_row - low_row
    own = order[_members(low_row, high_row)]
    met = [(rows, 0 * rows, 0 * rows), (own, np.repeat(low, count), np.repeat(high, count))]
    for offset, slope in [boundary.line] if boundary.line else []:
        place = offset + slope * alpha
        error = 8.0 * UNIT * (abs(offset) + abs(slope * alpha))
        first, last = _between(beta, place - error, place + error)
        met.append((rows, first, last))
    row, low, high = map(np.concatenate, zip(*met, strict=True))
    start, stop = row * beta.size + low, row * beta.size + high
    by_start = np.argsort(start, kind="stable")
    return start[by_start], stop[by_start]


def _boxes(boundary: _Boundary, alpha: Row, beta: Row) -> Int64[np.ndarray, "4 box"]:
    """Return boxes that cover the curve: of rows and of columns the first, and the one behind."""
    parts, few, rounds = 8, 8, 16
    found, left, right = [], boundary.places[:-1], boundary.places[1:]
    for is_last in (*(rounds - 1) * [False], True):
        places = np.minimum(np.linspace(left, right, parts + 1), right)
        ends = _values(boundary.cosines, places.ravel()).reshape(2, 2, *places.shape)
        low, high = (
            pick(side[:, :-1], side[:, 1:]).reshape(2, -1)
            for pick, side in zip((np.minimum, np.maximum), ends, strict=True)
        )
        rows, columns = _between(alpha, low[0], high[0]), _between(beta, low[1], high[1])
        is_met = (rows[0] < rows[1]) & (columns[1] > 0) & (columns[0] < beta.size)
        is_small = (rows[1] - rows[0]) * (columns[1] - columns[0]) <= few
        found.append(np.stack([*rows, *columns])[:, is_met & (is_small | is_last)])
        left, right = (x.ravel()[is_met & ~is_small] for x in (places[:-1], places[1:]))
        if not left.size:
            break
    return np.concatenate(found, axis=1)


def _between(rising: Row, low: Row, high: Row) -> tuple[Indices, Indices]:
    return np.searchsorted(rising, low), np.searchsorted(rising, high, side="right")


def _values(cosines: Float64[np.ndarray, "3 order"], x: Row) -> Float64[np.ndarray, "2 2 place"]:
    """Return the least and the largest alpha and beta at places; see lemma V11."""
    order = np.arange(cosines.shape[1])
    cosine, following = np.ones(x.size), 0.5 * x  # of k theta
    values = np.zeros((3, x.size))
    for terms in cosines.T[:, :, None]:
        values += terms * cosine
        cosine, following = following, x * following - cosine
    error = SAFETY * UNIT * (abs(cosines) @ (4.0 * order**2 + len(order) + 6.0))
    low, high = values - error[:, None], values + error[:, None]
    least, most = np.maximum(low[2], 0.0), high[2]  # of M
    with np.errstate(divide="ignore"):
        low = low[:2] / np.where(low[:2] >= 0.0, most, least)
        high = high[:2] / np.where(high[:2] <= 0.0, most, least)
    return np.stack([np.nextafter(low, -np.inf), np.nextafter(high, np.inf)])


# The boundary, in balls.


def _boundary(triple: Triple) -> _Boundary | None:
    """Return the boundary; None where more bits are needed, or the slice does not fit."""
    base, stiffness, damping = (part.polynomial() for part in triple)
    pairs = (base, damping), (stiffness, base), (damping, stiffness)
    sums = [_over_sine(above, below) for above, below in pairs]
    found = [_turns(quotient, sums[2]) for quotient in sums[:2]]
    common = min(triple.stiffness.at_minus_one, triple.damping.at_minus_one)
    others = (part.divided(0, 0, common) for part in (triple.damping, triple.stiffness))
    is_definite = is_positive(_over_sine(*(part.polynomial() for part in others)))
    p, by_alpha, by_beta = (part.at_end(-1) for part in triple)
    line = [p] if common else [-p / by_beta, -by_alpha / by_beta]
    places = [2 * angle.cos() for angles in found for angle in angles or ()]
    is_known = None not in found and all(map(is_sharp, line)) and all(map(_is_sharp_sum, sums))
    if not (is_known and is_definite and all(x.rad() < _SHARP for x in places)):
        return None
    cosines = np.zeros((3, max(map(len, sums))))
    for row, coefficients in zip(cosines, sums, strict=True):
        row[: len(coefficients)] = [float(c.mid()) for c in coefficients]
    edges = np.sort([-2.0, *(float(x.mid()) for x in places), 2.0])
    return _Boundary(cosines, edges, () if common else tuple(float(x.mid()) for x in line))


def _is_sharp_sum(cosines: list[arb]) -> bool:
    radius = sum((c.rad() for c in cosines), arb(0))
    return bool(radius < _SHARP * sum(map(abs, cosines), arb(0)))


def _over_sine(above: arb_poly, below: arb_poly) -> list[arb]:
    """Return Im(above conj below)/sin(theta)."""
    return _sines_over_sine(above * arb_poly(below.coeffs()[::-1]), below.degree())


def _sines_over_sine(terms: arb_poly, centre: int) -> list[arb]:
    """Return the sum of terms[centre + k] sin(k theta), over sin(theta), as a cosine sum."""
    # sin(k theta) = sin(theta) (2 cos((k - 1) theta) + 2 cos((k - 3) theta) + ...)
    length = max(centre, terms.degree() - centre)
    rising = terms.left_shift(length - centre)
    sums = [arb(0)] * (length + 2)
    for k in range(length, 0, -1):
        sums[k - 1] = sums[k + 1] + rising[length + k] - rising[length - k]
    return [sums[0], *(2 * c for c in sums[1:length])]


def _turns(above: list[arb], below: list[arb]) -> list[arb] | None:
    """Return the angles in (0, pi) where the quotient of two cosine sums turns, or None."""
    a, b = (arb_poly([*row[:0:-1], 2 * row[0], *row[1:]]) for row in (above, below))
    orders = len(above) - 1, len(below) - 1
    slopes = [
        arb_poly([(k - order) * c for k, c in enumerate(row.coeffs())])
        for row, order in zip((a, b), orders, strict=True)
    ]
    turns = _sines_over_sine(slopes[0] * b - a * slopes[1], sum(orders))
    found = zeros(turns, is_last_try=False)
    ends = sum(turns[1:], turns[0]), sum(turns[1::2], arb(0)) - sum(turns[::2], arb(0))
    if found is None or not all(map(sign_of, ends)):
        return None
    return [zero.angle for zero in found]
