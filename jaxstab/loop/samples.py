"""Many loops as a batch needs them, by their balls: coefficients, and angles that tell of them.

Their parts come from balls one by one, rounded once to pairs of float64. All else is found for all
loops of one degree at once, in float64, from samples of base and S around the circle:

- *poles*, the angles where Im(conj(S) R) changes its sign: the curve goes to infinity there;
- *roots* of base and of S next to the circle: where one of them is small between two neighbours,
  Newton's method leads to the root; the slowest pair follows from the last powers of z - 1.

A loop of which an angle is missed is not resolved by a batch, and is answered by itself.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Int64

from jaxstab.arrays import Array
from jaxstab.batches import alike
from jaxstab.conventions import Verdict
from jaxstab.exact import TripleAt
from jaxstab.exact.verdict import roots_outside
from jaxstab.model.balls import Factored
from jaxstab.model.device.parts import FIRST_BITS, working_precision
from jaxstab.model.double_double import DoubleDouble
from jaxstab.point.polynomials import codes_in_float64

_SAMPLES = 512  # of half the circle
_STEPS = 4  # of Newton's method
_NO_ROOT = 0.0, 0.05  # its angle, and its distance from the circle

Rows = Float64[np.ndarray, "loop power"]
Angles = Float64[np.ndarray, "loop _"]


class Formed(NamedTuple):
    """Loops that are formed together, as arrays: while they wait, these take the least memory."""

    members: Int64[np.ndarray, " loop"]
    parts: DoubleDouble  # (loop, part, power) coefficients of p(z)
    ends: Float64[Array, "loop 2 3"]
    poles: Float64[np.ndarray, "loop pole"]  # angles where the curve goes to infinity
    roots: Float64[Array, "loop root 2"]  # next to the circle: angles and distances
    units: Float64[np.ndarray, "loop 2"]  # of answers, in those of the parts
    turned: Bool[np.ndarray, " loop"]  # the second gain takes the place of the first one
    unstable: Bool[np.ndarray, " loop"]  # with small gains


def sampled_loops(
    members: Int64[np.ndarray, " loop"],
    triples: Sequence[TripleAt],
    degrees: Sequence[int],
) -> Iterator[Formed]:
    """Loops filled up to one of the degrees, those with as many poles together.

    Gains are in units that make them of size 1. Where the second one alone moves p(1), it takes the
    place of the first.
    """
    every = list(map(_in_floats, triples))
    filled = [min((n for n in degrees if n >= len(row[0][0]) - 1), default=0) for row in every]
    for own in map(np.array, alike(filled)):
        degree = filled[own[0]]
        if not degree:
            continue
        rows = np.zeros((2, own.size, 3, degree + 1))
        for k, place in enumerate(own):
            rows[:, k, :, : len(every[place][0][0])] = every[place][:2]
        scale = 2.0 ** -np.round(np.log2(np.abs(rows[0]).sum(axis=-1)))
        scale[:, 0] = 1.0
        parts, ends = rows * scale[..., None], np.array([every[k][2] for k in own]) * scale[:, None]
        turned = (ends[:, 0, 1] == 0.0) & (ends[:, 0, 2] != 0.0)
        for rest in (parts[0], parts[1], scale, ends.transpose(0, 2, 1)):
            rest[turned, 1:] = rest[turned, :0:-1]
        unstable = _are_unstable([every[k][3] for k in own])
        with np.errstate(all="ignore"):  # NaN tells where nothing is found
            values = np.fft.rfft(parts[0], 2 * _SAMPLES)[..., 1:-1]
            poles = _poles(parts[0], values)
            near = [_slowest(parts[0, :, 0]), *(_near(parts[0], values, k) for k in (0, 1))]
        roots = np.concatenate(near, axis=1)
        order = np.argsort(roots[..., 1], axis=1)[..., None]
        roots = np.take_along_axis(roots, order, axis=1)
        counts = np.sum(np.isfinite(poles), axis=1)
        for kind in map(np.array, alike(counts.tolist())):
            there = np.any(roots[kind, :, 0] != 0.0, axis=0)
            yield Formed(
                members[own[kind]],
                DoubleDouble(*parts[:, kind]),
                ends[kind],
                poles[kind, : counts[kind[0]]],
                roots[kind, : max(1, int(np.sum(there)))],
                scale[kind, 1:],
                turned[kind],
                unstable[kind],
            )


def _in_floats(triple_at: TripleAt) -> tuple[Any, Any, Any, Any]:
    """Coefficients of the parts, highest power first, what rounding took from them, and ends.

    Last the factor of base without roots at 0, 1 and -1.
    """
    with working_precision(FIRST_BITS):
        triple = triple_at().monic()
        degree, sign = triple.degree, (-1) ** triple.degree
        high, low = zip(*(_pairs(part, degree) for part in triple), strict=True)
        ends = [[float(part.at_end(z)) * s for part in triple] for z, s in ((1, 1), (-1, sign))]
    return high, low, ends, triple.base.rest


def _are_unstable(rests: list[Any]) -> Bool[np.ndarray, " loop"]:
    """True where roots of base are outside, so far that small gains do not bring them in."""
    radius, roundings = 1.0 + 1e-9, 4.0  # of a coefficient, of a power of the radius, a product
    count = max(2, *map(len, rests))
    falling = np.zeros((len(rests), count))
    for k, rest in enumerate(rests):
        falling[k, : len(rest)] = rest.coeffs()[::-1]
    codes = codes_in_float64(falling * radius ** np.arange(count)[::-1], roundings=roundings)
    is_outside = codes == Verdict.UNSTABLE
    for k in np.flatnonzero(codes == Verdict.UNDECIDED).tolist():
        with working_precision(FIRST_BITS):
            around = Factored(rests[k]).of_radius(radius).rest
            is_outside[k] = bool(roots_outside(around, most=0))
    return is_outside


def _pairs(part: Factored, degree: int) -> tuple[list[float], list[float]]:
    """The coefficients of a polynomial, highest power first, and what rounding took from them."""
    falling = part._replace(power=0).polynomial().coeffs()[::-1]
    before, after = degree - part.degree, part.power
    high = list(map(float, falling))
    low = [float(c - h) for c, h in zip(falling, high, strict=True)]
    return [0.0] * before + high + [0.0] * after, [0.0] * before + low + [0.0] * after


def _at(z: Complex128[np.ndarray, " row"], *parts: Rows) -> list[tuple[Any, Any]]:
    """The values of polynomials at one place each, and their derivatives times z."""
    count = parts[0].shape[1]
    powers = np.ones((z.size, count), complex)
    powers[:, :-1] = np.cumprod(np.broadcast_to(z[:, None], (z.size, count - 1)), axis=1)[:, ::-1]
    order = np.arange(count)[::-1]
    terms = (rows * powers for rows in parts)
    return [(own.sum(axis=1), np.einsum("rp,p->r", own, order)) for own in terms]


def _poles(parts: Float64[np.ndarray, "loop 3 power"], values: Any) -> Angles:
    """The angles where Im(conj(S) R) changes its sign, and NaN behind them."""
    det = values[:, 1].real * values[:, 2].imag - values[:, 1].imag * values[:, 2].real
    loop, place = np.nonzero(det[:, 1:] * det[:, :-1] < 0.0)
    share = det[loop, place] / (det[loop, place] - det[loop, place + 1])
    step, low = np.pi / _SAMPLES, (place + 1) * (np.pi / _SAMPLES)
    angle = low + share * step
    for _ in range(_STEPS):
        (s, s_slope), (r, r_slope) = _at(np.exp(1j * angle), parts[loop, 1], parts[loop, 2])
        slope = (s.conj() * r_slope - s_slope.conj() * r).real  # d/dtheta is iz d/dz
        angle = np.clip(angle - (s.conj() * r).imag / slope, low, low + step)
    return _in_rows(loop, angle, len(parts))


def _near(parts: Float64[np.ndarray, "loop 3 power"], values: Any, part: int) -> Any:
    """The roots of a part next to the circle."""
    step, farthest = np.pi / _SAMPLES, 0.05
    rows, squares = parts[:, part], np.abs(values[:, part]) ** 2
    before, here, after = squares[:, :-2], squares[:, 1:-1], squares[:, 2:]
    bend = (before + after - 2.0 * here) / (2.0 * step**2)  # here is that times distance squared
    loop, place = np.nonzero((here < before) & (here < after) & (here < bend * farthest**2))
    z = np.exp(1j * (place + 2) * step)
    for _ in range(_STEPS):
        ((value, slope),) = _at(z, rows[loop])
        z = z - z * value / slope
    found = _in_rows(loop, _places(z), len(rows))
    return np.where(np.isnan(found), _NO_ROOT, found)


def _slowest(base: Rows) -> Any:
    """The pair of roots of base next to 1, by its last powers of z - 1."""
    powers = np.arange(base.shape[1])[::-1]
    a, b, c = (base @ weight for weight in (0.5 * powers * (powers - 1), powers, powers**0))
    return _places(1.0 + (np.sqrt(b * b - 4.0 * a * c + 0j) - b) / (2.0 * a))[:, None]


def _places(root: Complex128[np.ndarray, " root"]) -> Float64[np.ndarray, "root 2"]:
    """Angles of roots, and distances from the circle; far from it, or real, they are none."""
    narrowest, farthest, real = 1e-9, _NO_ROOT[1], 1e-6
    angle, distance = np.abs(np.angle(root)), np.abs(np.log(np.abs(root)))
    is_one: Bool[np.ndarray, " root"] = (angle > real) & (angle < np.pi - real)
    is_one &= distance < farthest
    places = np.stack([angle, np.maximum(distance, narrowest)], axis=-1)
    return np.where(is_one[:, None], places, _NO_ROOT)


def _in_rows(loop: Int64[np.ndarray, " _"], found: Any, count: int) -> Any:
    """The values found for loops, in their order, as a row for each; NaN fills them up."""
    counts = np.bincount(loop, minlength=count)
    rows = np.full((count, int(np.max(counts, initial=0)), *found.shape[1:]), np.nan)
    rows[loop, np.arange(loop.size) - (np.cumsum(counts) - counts)[loop]] = found
    return rows
