"""Whether the other roots of p lie inside the circle, where a pair of roots is known.

A point of the curve bounds the stable set exactly where all roots but the pair at r e^(+-i th) lie
inside of the circle: p is divided by that pair, and the Schur-Cohn test decides.
"""

import numpy as np

from jaxstab.arrays import Array, namespace, repeat, scan, stored
from jaxstab.region.curve import SliceCoefficients, curve_and_lift
from jaxstab.region.exact_points import lines_crossing_of
from jaxstab.region.exact_roots import all_inside
from jaxstab.region.filtered_curve import FilteredCurve
from jaxstab.region.filtered_points import (
    exact_walls,
    filtered_quotient,
    may_be_stable,
    root_angles,
)
from jaxstab.region.lines import lines_crossing

_REAL_MARGIN = 1e-13  # of the polynomial at z = r and -r, beside its coefficients
_MARGIN = 1e-12  # reflection coefficients closer to 1 are taken for roots on the circle
_AT_ONCE = 1 << 18  # coefficients of polynomials that are held in memory
_ROUND = 32  # steps of the test after which NumPy drops the polynomials that failed


def others_inside(c: SliceCoefficients, theta: Array, length: int, within: float = 1.0) -> Array:
    """Return where all roots of p but those at r e^(+-i theta) lie inside of the circle.

    ``within`` is the size of another circle, as a multiple of that.

    Source: the criterion of Schur and Cohn, as a recursion for the polynomial and its reverse.
    """
    if c.filtered is not None and c.filtered.is_exact:
        return all_inside(c.filtered, *exact_walls(c.filtered, theta), within)
    xp = namespace(c, theta)
    if xp is np and theta.size * length > _AT_ONCE and theta.size > 1:
        parts = np.array_split(theta.ravel(), -(-theta.size * length // _AT_ONCE))
        inside = [others_inside(c, part, length, within) for part in parts]
        return np.concatenate(inside).reshape(theta.shape)
    if c.filtered is not None:
        return _others_inside(c, c.filtered, theta.ravel(), length, within).reshape(theta.shape)
    return _all_inside(stored(_shrunk(other_roots(c, theta, length), within)))


def _others_inside(
    c: SliceCoefficients, curve: FilteredCurve, theta: Array, length: int, within: float
) -> Array:
    """Return the same for a loop with filters; p is divided only where its coefficients may be."""
    alpha, beta = curve_and_lift(c, theta)[:2]
    inside = may_be_stable(curve, alpha, beta, within)
    wall, angle = (alpha[inside], beta[inside]), root_angles(curve, theta[inside])
    others = _quotient(c, wall, 2.0 * np.cos(angle), 1.0, length)
    inside[inside] = _all_inside(_shrunk(others, within))
    return inside


def _shrunk(falling: Array, within: float) -> Array:
    """Return the polynomials of the roots over a number."""
    powers = namespace(falling).arange(float(len(falling)))
    return falling * (within**-powers).reshape(-1, *(1 for _ in falling.shape[1:]))


def lines_crossing_is_stable(c: SliceCoefficients, length: int) -> Array:
    """Return whether all roots lie inside where the lines z = r and z = -r cross, but for those."""
    if c.filtered is not None and c.filtered.is_exact:
        return all_inside(c.filtered, *lines_crossing_of(c.filtered.pairs), 1.0)
    both = _quotient(c, lines_crossing(c), namespace(c).zeros(()), -1.0, length)
    return _all_inside(both)


def other_roots(c: SliceCoefficients, theta: Array, length: int) -> Array:
    """Return the coefficients of p(r zeta) / (zeta^2 - 2 cos(theta) zeta + 1), highest first.

    There are ``length`` of them, the last ones zeros: roots at 0 are inside of any circle.
    """
    wall = stored(curve_and_lift(c, theta)[:2])
    angle = theta if c.filtered is None else root_angles(c.filtered, theta)
    return _quotient(c, wall, 2.0 * namespace(c, theta).cos(angle), 1.0, length)


def _quotient(
    c: SliceCoefficients, wall: tuple[Array, Array], total: Array, product: float, length: int
) -> Array:
    """Divide p(r zeta) by zeta^2 - total zeta + product, of two roots that the wall has."""
    if c.filtered is not None:
        return filtered_quotient(c.filtered, wall, total, product, length)
    xp = namespace(c, wall)
    alpha, beta = wall
    unit = c.gain * c.radius
    gain, lagged = (alpha + beta) / unit, beta / (c.radius * unit)
    leading, middle = 0.5 * (c.sigma + c.nu), c.num_plus - c.sigma
    first, second = (c.den_plus - c.kappa) / c.radius, 0.5 * (c.kappa - c.eps) / c.radius
    third, fourth = leading * gain, middle * gain - leading * lagged  # of powers m and m + 1
    series = _series_of_inverse(total, product, length)
    zeros = xp.zeros_like(series[:2])
    once = xp.concatenate([zeros[:1], series[:-1]])
    twice = xp.concatenate([zeros, series[:-2]])
    power = xp.arange(length).reshape(-1, *(1 for _ in total.shape))
    quotient = series + first * once + second * twice
    quotient = quotient + xp.where(power == c.turns, third, 0.0)
    quotient = quotient + xp.where(power == c.turns + 1, third * total + fourth, 0.0)
    return xp.where(power <= c.turns + 1, quotient, 0.0)


def _series_of_inverse(total: Array, product: float, length: int) -> Array:
    """Return the series of 1 / (1 - total x + product x^2): Chebyshev's polynomials for 1."""

    def step(before: tuple[Array, Array]) -> tuple[tuple[Array, Array], Array]:
        last, last_but_one = before
        return (total * last - product * last_but_one, last), last

    xp = namespace(total)
    return scan(length, step, (xp.ones_like(total), xp.zeros_like(total)))


def _all_inside(falling: Array) -> Array:
    """Return where all roots of polynomials (coefficient, ...) lie inside of the unit circle."""
    # Where all walls leave a root at z = r or -r, rounding must not decide.
    xp = namespace(falling)
    even, odd = xp.sum(falling[::2], axis=0), xp.sum(falling[1::2], axis=0)
    real = xp.minimum(even + odd, even - odd)
    is_clear = real > _REAL_MARGIN * xp.sum(abs(falling), axis=0)
    if xp is np:
        return _passes(falling.reshape(len(falling), -1), is_clear.ravel()).reshape(is_clear.shape)

    def step(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        falling, rising, inside = state
        reflection = rising[0] / falling[0]
        lower = rising - reflection * falling
        return (
            falling - reflection * rising,
            xp.concatenate([lower[1:], xp.zeros_like(lower[:1])]),
            inside & (abs(reflection) < 1.0 - _MARGIN),
        )

    return repeat(len(falling) - 1, step, (falling, falling[::-1], is_clear))[2]


def _passes(falling: Array, is_clear: Array) -> Array:
    """Run the same recursion on arrays that shrink, as NumPy may: fewer and shorter polynomials."""
    passes = is_clear.copy()
    index = np.arange(passes.size)
    while len(falling) > 1 and index.size:
        open_ones = passes[index]
        falling, index = falling[:, open_ones], index[open_ones]
        inside = np.ones(index.size, bool)
        for _ in range(min(_ROUND, len(falling) - 1)):
            reflection = falling[-1] / falling[0]
            inside &= abs(reflection) < 1.0 - _MARGIN
            falling = falling[:-1] - reflection * falling[:0:-1]
        passes[index] = inside
    return passes
