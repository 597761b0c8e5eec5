"""Where the linear condition loses its validity (sec. VII): the first such point, with proof.

With H = alpha + gamma, which is positive to the right of the line z = 1, the error of the linear
condition exceeds a level where

    E = |N(z)|^2 t_r (alpha_lin - alpha - level (alpha + gamma)),       z = e^(i theta),

has the sign of H. On the curve |N|^2 beta = Im W/sin(theta) and |N|^2 (alpha + beta (1 - cos
theta)) = Re W, with W = -z^m D(z) N(1/z), m = floor(delay) + 1, so that

    E = (1 + kappa (1 - cos theta)) Im W/sin(theta) - kappa Re W + (delta - level t_r gamma) |N|^2,

kappa = (1 + level) t_r, is a polynomial in x = cos(theta) of degree m + 2 at most. It vanishes at
x = 1 for gamma = 0, and for delta = 0 with a whole delay or one with half a sample; there it is
divided by 1 - x. The error rises through the level where E changes its sign in the direction of H:
the first rise is at the largest such root.

python-flint encloses the coefficients in balls, and isolates all roots, complex ones too, so that
the first root where the error rises is the first one indeed. Where balls are too wide to tell two
roots apart, or a root and an end, twice as many bits are taken.
"""

from collections.abc import Sequence
from functools import partial
from math import nan
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float64, Int8

from jaxstab.arrays import Array, Numbers, namespace
from jaxstab.conventions import Status, Verdict
from jaxstab.exact.roots import real_roots
from jaxstab.model import Device, by_name, checked_delay, checked_delta, checked_gamma, require_x64
from jaxstab.model.balls import plant_in_balls
from jaxstab.model.device.parts import decided
from jaxstab.numbers import checked
from jaxstab.point import verdict

if TYPE_CHECKING:
    from flint import arb, arb_poly

_MOST_BITS = 6144


class ValidityStatus(Status):
    """The status of the point where the linear condition loses its validity.

    Example:
        >>> jaxstab.paper.ValidityStatus(1).words
        "a point of the stable region's boundary"
    """

    NOT_COMPUTED = 0, "not computed"
    FOUND = 1, "a point of the stable region's boundary"
    NEVER = 2, "the error never rises through this level: NaN"
    OFF_THE_EDGE = 3, "on the boundary curve, but the stable region does not reach this point"
    NOT_PROVED = 4, "rounding hides which point is the first, or its side: NaN"


class LinearValidity(NamedTuple):
    """A point (alpha, beta) of the boundary, its angle on the curve, and a ValidityStatus.

    Example:
        >>> found = jaxstab.paper.linear_validity(0.02, gamma=0.0, delta=0.0, delay=0.0)
        >>> round(float(found.alpha), 9)
        0.038827412
    """

    alpha: Float64[Array, "*grid"]
    beta: Float64[Array, "*grid"]
    theta: Float64[Array, "*grid"]
    status: Int8[np.ndarray, "*grid"]


def linear_validity(
    level: Numbers, *, gamma: Numbers, delta: Numbers, delay: Numbers
) -> LinearValidity:
    """The boundary point up to which the linear condition errs by at most ``level``.

    It is the first one, along the boundary curve from its corner at alpha = -gamma, where the
    signed error (alpha_lin - alpha)/(alpha + gamma) rises through ``level``: the circles (2 %) and
    squares (5 %) of Fig. 7. The absolute value of eq. (24) may reach the level before that, because
    with damping the linear condition is too careful at small stiffness (by 2.2 % for d = 1, delta =
    0.015). Such crossings are not returned.

    It is proved, over the whole curve, that this point is the first. Each point has its own status;
    NOT_PROVED says that 6,144 bits do not tell two roots apart, or float64 the side of the point.

    Args:
        level: relative error in (0, 1e3], any shape; like all arguments it broadcasts. None of them
            may be traced.
        gamma, delta, delay: see ``jaxstab.conventions``.

    Returns:
        LinearValidity of the broadcast shape; NaN where no point was found.

    Raises: see ``jaxstab.conventions``.

    Example:
        >>> point = linear_validity(0.02, gamma=0.0, delta=0.0, delay=0.0)
        >>> print(f"{point.alpha:.6f} {point.beta:.6f}")
        0.038827 0.019802

    Source: sec. VII, eq. (24) and Fig. 7 of Hulin, Preusche, Hirzinger (2008).
    """
    step_back = 1e-6  # of alpha + gamma: how far inside of a boundary point its side is tested
    require_x64(level, gamma, delta, delay)
    xp = namespace(level, gamma, delta, delay)
    values = (
        checked("level", level, 0.0, 1e3, is_open=True),
        checked_gamma(gamma),
        checked_delta(delta),
        checked_delay(delay),
    )
    grids = np.broadcast_arrays(*(np.asarray(value, np.float64) for value in values))
    questions = np.stack([np.ravel(grid) for grid in grids])
    not_proved = _Rise(ValidityStatus.NOT_PROVED)
    rises = [
        decided(partial(_first_rise, *question), _MOST_BITS) or not_proved
        for question in questions.T.tolist()
    ]
    points = np.array([rise.point for rise in rises]).reshape(-1, 3).T
    status = np.array([rise.status for rise in rises], np.int8)
    there = status == ValidityStatus.FOUND
    (alpha, beta, _), slices = points[:, there], by_name(*questions[1:, there])
    inner = verdict(alpha - step_back * (alpha + slices["gamma"]), beta, **slices)
    by_side = {Verdict.STABLE: ValidityStatus.FOUND, Verdict.UNSTABLE: ValidityStatus.OFF_THE_EDGE}
    sides = np.ravel(inner).tolist()
    status[there] = [by_side.get(side, ValidityStatus.NOT_PROVED) for side in sides]
    points[:, status == ValidityStatus.NOT_PROVED] = nan
    alpha, beta, theta = (xp.asarray(row.reshape(grids[0].shape)) for row in points)
    return LinearValidity(alpha, beta, theta, status.reshape(grids[0].shape))


class _Rise(NamedTuple):
    """The status of a first rise, and its alpha, beta and theta."""

    status: ValidityStatus
    point: tuple[float, float, float] = (nan, nan, nan)


class _Curve(NamedTuple):
    """E on the boundary curve, and what gives its points, as polynomials in x = cos(theta)."""

    excess: "arb_poly"
    damping: "arb_poly"  # |N|^2 beta
    real: "arb_poly"  # |N|^2 (alpha + beta (1 - x))
    square: "arb_poly"  # |N|^2


def _first_rise(level: float, gamma: float, delta: float, delay: float) -> _Rise | None:
    """Return the largest root x in (-1, 1) where the error rises; None where balls do not tell."""
    digits = 60  # bits to which an answer is wanted, at least
    curve = _curve(level, gamma, delta, delay)
    slope, roots = curve.excess.derivative(), real_roots(curve.excess)
    if roots is None:
        return None
    for x in sorted(roots, key=float, reverse=True):
        if x > 1 or x < -1:
            continue
        square = curve.square(x)
        beta = curve.damping(x) / square
        alpha = curve.real(x) / square - beta * (1 - x)
        rising = -slope(x) * (alpha + gamma)  # of the sign of d error/d theta
        if not (-1 < x < 1 and (rising > 0 or rising < 0)):
            return None
        if rising > 0:
            theta = x.acos()
            if min(theta.rel_accuracy_bits(), beta.rel_accuracy_bits()) < digits:
                return None
            return _Rise(ValidityStatus.FOUND, (float(alpha), float(beta), float(theta)))
    return _Rise(ValidityStatus.NEVER)


def _curve(level: float, gamma: float, delta: float, delay: float) -> _Curve:
    """Return the curve and its excess over a level."""
    import flint

    polynomial = flint.arb_poly
    plant = plant_in_balls(
        Device.mass_spring_damper(1.0, damping=delta, stiffness=gamma), 1.0, delay
    )
    rising, denominator = plant.numerator.polynomial().coeffs(), plant.denominator.polynomial()
    mirrored, degree = polynomial(rising[::-1]), len(rising) - 1  # z^degree N(1/z)
    waves = (-denominator * mirrored).coeffs()
    real, damping = _in_cosines(waves, plant.lag - degree)
    square, _ = _in_cosines((polynomial(rising) * mirrored).coeffs(), -degree)
    lag = flint.arb(delay) + 0.5
    kappa = (1 + flint.arb(level)) * lag
    excess = (1 + kappa * polynomial([1, -1])) * damping - kappa * real
    excess += (delta - flint.arb(level) * lag * gamma) * square
    if gamma == 0.0 or (delta == 0.0 and delay % 1.0 in (0.0, 0.5)):
        excess //= polynomial([1, -1])  # exactly: the sign stays
    return _Curve(excess, damping, real, square)


def _in_cosines(sizes: Sequence["arb"], lowest: int) -> "tuple[arb_poly, arb_poly]":
    """Return Re S and Im S / sin(theta), of S = sum of s_k z^k from the lowest k, in cos(theta)."""
    from flint import arb_poly, fmpz_poly

    real = imaginary = arb_poly(0)
    for power, size in enumerate(sizes, lowest):
        real += size * arb_poly(fmpz_poly.chebyshev_t(abs(power)))
        if power:
            ratio = arb_poly(fmpz_poly.chebyshev_u(abs(power) - 1))
            imaginary += (size if power > 0 else -size) * ratio
    return real, imaginary
