"""Whether all other roots are inside the circle, at walls on the boundary. Double-double, NumPy.

Slow modes have roots next to each other near z = 1, which the coefficients in powers of z cannot
tell apart. So p(z) is written in powers of z - 1, where each small root makes one more coefficient
small, and
z = r (1 + w) / (1 - w) turns the circle of radius r into the imaginary axis, z = r into 0. With

    p = sum c_k (z - r)^k = (1 - w)^-n sum c_k (2 r w)^k (1 - w)^(n - k)

Routh's criterion counts the roots. r is just so much larger than 1 that the roots which the wall
puts on the unit circle count as inside: the less, the smaller the gains are, because a mode that
nothing damps is on the circle without them, and moves as little as they are small.
"""

from functools import lru_cache
from math import comb

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.arrays import tree_map
from jaxstab.model.double_double import DoubleDouble
from jaxstab.region.exact_points import polished_angles
from jaxstab.region.filtered_curve import FilteredCurve

_ON_CIRCLE = 1e-14  # a root so close is on the circle, where gains count as much as the plant
_STEP, _LEAST = 1e-3, 1e-15  # of the share that gains count for, and the least one
_NEAR_CIRCLE = 1e-2
_AT_ONCE = 1 << 11  # walls


def all_inside(
    curve: FilteredCurve, alpha: DoubleDouble, beta: DoubleDouble, within: float
) -> Bool[np.ndarray, "*wall"]:
    """Return where all roots of p(z) are inside a circle; those on the unit circle count."""
    inside = np.zeros(np.shape(alpha.hi), bool)
    walls = [tree_map(np.ravel, wall) for wall in (alpha, beta)]
    falling = np.ascontiguousarray(curve.pairs[0, 1, :, :, ::-1])  # in powers of z - 1
    outside = np.maximum(within - 1.0, _on_circle(curve, *walls))
    for one in np.unique(outside).tolist():
        parts = _parts_in_half_plane(falling.tobytes(), falling.shape[-1], one)
        chosen = np.flatnonzero(outside == one)
        for start in range(0, chosen.size, _AT_ONCE):
            some = chosen[start : start + _AT_ONCE]
            gains = (DoubleDouble(wall.hi[some], wall.lo[some]) for wall in walls)
            inside.flat[some] = _are_left(_with_gains(parts, *gains))
    return inside


def _on_circle(
    curve: FilteredCurve, alpha: DoubleDouble, beta: DoubleDouble
) -> Float64[np.ndarray, " wall"]:
    """Return how far outside a root is on the circle: in steps, by what gains count for in p(z)."""
    base, stiffness, damping = np.sum(np.abs(curve.pairs[0, 0, 0]), axis=-1)
    share = (np.abs(alpha.hi) * stiffness + np.abs(beta.hi) * damping) / base
    share = np.clip(np.nan_to_num(share, nan=1.0), _LEAST, 1.0)
    steps: np.ndarray = np.floor(np.log(share) / np.log(_STEP))
    return _ON_CIRCLE * _STEP**steps


def _with_gains(parts: DoubleDouble, alpha: DoubleDouble, beta: DoubleDouble) -> DoubleDouble:
    base, stiffness, damping = (
        DoubleDouble(parts.hi[:, k, None], parts.lo[:, k, None]) for k in range(3)
    )
    return base + (stiffness * alpha + damping * beta)


@lru_cache(maxsize=64)
def _parts_in_half_plane(falling: bytes, count: int, outside: float) -> DoubleDouble:
    """Return base, stiffness and damping (coefficient, part) in powers of w, highest first.

    They are given in powers of z - 1, (pair, part, coefficient); r = 1 + outside. Many walls are
    asked of one curve.
    """
    pairs = np.frombuffer(falling).reshape(2, 3, count).transpose(0, 2, 1)
    return _to_half_plane(_about(DoubleDouble(*pairs), outside), DoubleDouble.of(outside) + 1.0)


def angles_on_circle(
    curve: FilteredCurve, alpha: DoubleDouble, beta: DoubleDouble, *, within: float = np.inf
) -> DoubleDouble:
    """Return the angles in (0, pi) of roots that are close to the circle for slow roots.

    ``within`` is how close they have to be at last.
    """
    base, stiffness, damping = curve.pairs[0, 1, 0, :, ::-1]
    angles = [DoubleDouble.of(np.empty(0))]
    for k in range(len(alpha.hi)):
        coefficients = base + stiffness * alpha.hi[k] + damping * beta.hi[k]
        step = np.roots(coefficients) if np.all(np.isfinite(coefficients)) else np.empty(0)
        modulus = np.abs(1.0 + step)
        is_near = np.abs(modulus - 1.0) < _NEAR_CIRCLE * np.minimum(1.0, np.abs(step))
        rough = step[is_near & (step.imag > 0.0)]
        stiffness_gain, damping_gain = (DoubleDouble(one.hi[k], one.lo[k]) for one in (alpha, beta))
        polished, excess = polished_angles(curve.pairs, stiffness_gain, damping_gain, rough)
        chosen = np.abs(excess) < within
        angles.append(DoubleDouble(polished.hi[chosen], polished.lo[chosen]))
    high, low = ([getattr(one, name) for one in angles] for name in ("hi", "lo"))
    return DoubleDouble(np.concatenate(high), np.concatenate(low))


def _about(falling: DoubleDouble, move: float) -> DoubleDouble:
    """Return the coefficients in powers of s - move by those in powers of s, part by part.

    sum c_k s^k has the coefficients sum over k of binomial(k, j) move^(k - j) c_k.
    """
    degree = len(falling.hi) - 1
    total, power = falling, DoubleDouble.of(1.0)
    for more in range(1, degree + 1):
        power = power * move
        ways = np.array([float(comb(k, more)) for k in range(degree, more - 1, -1)])[:, None]
        higher = DoubleDouble(falling.hi[:-more], falling.lo[:-more]) * power * ways
        moved = (np.pad(one, ((more, 0), (0, 0))) for one in (higher.hi, higher.lo))
        total = total + DoubleDouble(*moved)
    return total


def _to_half_plane(falling: DoubleDouble, radius: DoubleDouble) -> DoubleDouble:
    """Return sum c_k (2 r w)^k (1 - w)^(n - k), highest power of w first."""
    degree = len(falling.hi) - 1
    total, factor = DoubleDouble.of(np.zeros_like(falling.hi)), DoubleDouble.of(1.0)
    for power in range(degree + 1):
        index = degree - power
        one = DoubleDouble(falling.hi[index], falling.lo[index]) * factor
        total = total + DoubleDouble(one.hi[None], one.lo[None]) * _binomials(degree, power)
        factor = factor * radius.scaled(2.0)
    return total


def _binomials(degree: int, power: int) -> Float64[np.ndarray, "coefficient 1"]:
    """Return the coefficients of w^power (1 - w)^(degree - power), highest first."""
    rest = degree - power
    signed = [float((-1) ** k * comb(rest, k)) for k in range(rest, -1, -1)]
    return np.array(signed + [0.0] * power)[:, None]


def _are_left(falling: DoubleDouble) -> Bool[np.ndarray, " wall"]:
    """Return where all roots have negative real parts (Routh 1877)."""
    even, odd = (DoubleDouble(falling.hi[k::2], falling.lo[k::2]) for k in (0, 1))
    is_left = np.ones(falling.hi.shape[1], bool)
    while len(odd.hi):
        is_left = is_left & (odd.hi[0] * even.hi[0] > 0.0)
        ratio = DoubleDouble(even.hi[0], even.lo[0]) / DoubleDouble(odd.hi[0], odd.lo[0])
        length = len(even.hi) - 1
        lower = DoubleDouble(even.hi[1:], even.lo[1:])
        missing = length - (len(odd.hi) - 1)
        above = [np.pad(part[1:], ((0, missing), (0, 0))) for part in (odd.hi, odd.lo)]
        even, odd = odd, lower - DoubleDouble(*above) * ratio
    return is_left
