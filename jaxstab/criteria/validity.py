"""Where the linear condition loses its validity (sec. VII): the first such point, with proof.

With H = alpha + gamma, which is positive to the right of the line z = 1, the error of the linear
condition exceeds a level where

    E = |N(z)|^2 t_r (alpha_lin - alpha - level (alpha + gamma)),       z = e^(i theta),

has the sign of H. On the curve E is a cosine series in theta of degree floor(delay) + 3, so all of
its sign changes can be isolated (``sign_changes``): lemmas C1 to C4 of docs/proofs.md. E(0) is of
third order in gamma and delta and summed in double-double.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int8

from jaxstab.arrays import Array, Numbers, namespace
from jaxstab.conventions import Status, Verdict
from jaxstab.criteria.cosine_series import series_values
from jaxstab.criteria.sign_changes import Series, SignChanges, sign_changes
from jaxstab.model import (
    DoubleDouble,
    PlantPairs,
    by_name,
    checked_delay,
    checked_delta,
    checked_gamma,
    plant_pairs,
    require_x64,
)
from jaxstab.model.plant import may_cancel, pairs_error
from jaxstab.numbers import checked
from jaxstab.point import verdict
from jaxstab.region.curve import SliceCoefficients, curve_and_lift, slice_coefficients

Values = Float64[np.ndarray, " batch"]

_STEP_BACK = 1e-6  # of alpha + gamma: how far inside of a boundary point its side is tested
_EPS = np.finfo(np.float64).eps
_CHUNK = 2048  # questions answered at once
_NEWTON_STEPS = 60


class ValidityStatus(Status):
    """What is known about the point where the linear condition loses its validity.

    Example:
        >>> jaxstab.ValidityStatus(1).words
        "a point of the stable region's boundary"
    """

    NOT_COMPUTED = 0, "not computed"
    FOUND = 1, "a point of the stable region's boundary"
    NEVER = 2, "the error never rises through this level: NaN"
    OFF_THE_EDGE = 3, "on the boundary curve, but the stable region does not reach this point"
    NOT_PROVED = 4, "rounding hides which point is the first: NaN"


class LinearValidity(NamedTuple):
    """A point (alpha, beta) of the boundary, its angle on the curve, and a ValidityStatus.

    Example:
        >>> found = jaxstab.linear_validity(0.02, gamma=0.0, delta=0.0, delay=0.0)
        >>> round(float(found.alpha), 9)
        0.038827412
    """

    alpha: Float64[Array, "*grid"]
    beta: Float64[Array, "*grid"]
    theta: Float64[Array, "*grid"]
    status: Int8[np.ndarray, "*grid"]


class _Question(NamedTuple):
    """Levels and slices; arrays of one shape."""

    level: Values
    gamma: Values
    delta: Values
    delay: Values

    @property
    def lag(self) -> Values:
        """The effective delay t_r in samples."""
        return 0.5 + self.delay

    def select(self, chosen: np.ndarray) -> "_Question":
        """Return some of them."""
        return _Question(*(values[chosen] for values in self))


def linear_validity(
    level: Numbers, *, gamma: Numbers, delta: Numbers, delay: Numbers
) -> LinearValidity:
    """Return the boundary point up to which the linear condition errs by at most ``level``.

    It is the first one, along the boundary curve from its corner at alpha = -gamma, where the
    signed error (alpha_lin - alpha)/(alpha + gamma) rises through ``level``: the circles (2 %) and
    squares (5 %) of Fig. 7. The absolute value of eq. (24) may reach the level before that, because
    with damping the linear condition is too careful at small stiffness (by 2.2 % for d = 1,
    delta = 0.015). Such crossings are not returned.

    It is proved, over the whole curve, that this point is the first. Each point has its own status;
    NOT_PROVED says that float64 cannot tell, as for levels below about 1e-9.

    Args:
        level: relative error in (0, 1e3], any shape; like all arguments it broadcasts. None of
            them may be traced.
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, whole or fractional.

    Returns:
        LinearValidity of the broadcast shape; NaN where no point was found.

    Raises:
        TypeError: an argument is traced or not made of numbers.
        ValueError: an argument is outside its range, infinite or NaN.
        RuntimeError: JAX arrays are given without x64.

    Example:
        >>> point = linear_validity(0.02, gamma=0.0, delta=0.0, delay=0.0)
        >>> print(f"{point.alpha:.6f} {point.beta:.6f}")
        0.038827 0.019802

    Source: sec. VII, eq. (24) and Fig. 7 of Hulin, Preusche, Hirzinger (2008).
    """
    require_x64(level, gamma, delta, delay)
    xp = namespace(level, gamma, delta, delay)
    values = (
        checked("level", level, 0.0, 1e3, is_open=True),
        checked_gamma(gamma),
        checked_delta(delta),
        checked_delay(delay),
    )
    grids = np.broadcast_arrays(*(np.asarray(value, np.float64) for value in values))
    question = _Question(*(np.ravel(grid) for grid in grids))
    answers = [
        _answers(question.select(np.arange(start, min(start + _CHUNK, grids[0].size))))
        for start in range(0, max(grids[0].size, 1), _CHUNK)
    ]
    columns = [
        np.concatenate(column).reshape(grids[0].shape) for column in zip(*answers, strict=True)
    ]
    alpha, beta, theta = (xp.asarray(column) for column in columns[:3])
    return LinearValidity(alpha, beta, theta, columns[3])


def _answers(question: _Question) -> LinearValidity:
    """Return alpha, beta, theta and status of each question."""
    series = excess_series(*question)
    changes = sign_changes(series)
    ones = np.ones_like(question.delay)
    slices = slice_coefficients(question.gamma, question.delta, question.delay, ones)
    owners = question.select(changes.owner)
    curve = _Curve(
        owners,
        SliceCoefficients(
            *(np.asarray(part)[changes.owner] for part in slices if part is not None)
        ),
    )
    theta = _solved(curve, series.coefficients[changes.owner], changes)
    alpha, beta, height = curve.point(theta)
    # Left of the line z = 1 the error rises where its numerator falls.
    rises = (changes.direction * height > 0) | (changes.direction == 0)
    owner, first = np.unique(changes.owner[rises], return_index=True)
    first = np.flatnonzero(rises)[first]
    proved = changes.is_proved[first]
    status = np.full(len(question.level), ValidityStatus.NEVER, np.int8)
    status[owner[~proved]] = ValidityStatus.NOT_PROVED
    owner, first = owner[proved], first[proved]
    point = np.full((3, len(question.level)), np.nan)
    point[:, owner] = alpha[first], beta[first], theta[first]
    slice_ = (values[owner] for values in question[1:])
    inner = verdict(alpha[first] - _STEP_BACK * height[first], beta[first], **by_name(*slice_))
    is_edge = np.asarray(inner) == Verdict.STABLE
    status[owner] = np.where(is_edge, ValidityStatus.FOUND, ValidityStatus.OFF_THE_EDGE)
    return LinearValidity(point[0], point[1], point[2], status)


class _Curve(NamedTuple):
    """The boundary curves of some questions."""

    question: _Question
    slices: SliceCoefficients

    def point(self, theta: Values) -> tuple[Values, Values, Values]:
        """Return alpha, beta and alpha + gamma, which has digits of its own."""
        alpha, beta, lift = (np.asarray(part) for part in curve_and_lift(self.slices, theta))
        return alpha, beta, 2.0 * np.sin(0.5 * theta) ** 2 * lift

    def excess(self, theta: Values) -> Values:
        """Return alpha_lin - alpha - level (alpha + gamma)."""
        level, gamma, delta, _ = self.question
        _, beta, height = self.point(theta)
        return (beta + delta) / self.question.lag + gamma - (1.0 + level) * height


def _solved(curve: _Curve, series: np.ndarray, changes: SignChanges) -> Values:
    """Return the sign change in each cell: Newton's method, kept in the cell by bisection."""
    low, high = changes.low.copy(), changes.high.copy()
    theta = 0.5 * (low + high)
    for _ in range(_NEWTON_STEPS):
        excess = changes.direction * curve.excess(theta)
        low, high = np.where(excess < 0, theta, low), np.where(excess < 0, high, theta)
        _, slope = series_values(series, theta)
        slope = changes.direction * slope / (curve.question.lag * _square(curve.slices, theta))
        following = theta - excess / np.where(slope == 0.0, np.inf, slope)
        is_inside = (following >= low) & (following <= high)
        following = np.where(is_inside, following, 0.5 * (low + high))
        is_done = np.all(np.abs(following - theta) <= 2 * _EPS * theta)
        theta = following
        if is_done:
            break
    return theta


def _square(slices: SliceCoefficients, theta: Values) -> Values:
    """Return |N(e^(i theta))|^2."""
    far = 2.0 * np.cos(0.5 * theta) ** 2
    q = slices.sigma * far - slices.num_minus
    return q**2 + (slices.nu * np.sin(theta)) ** 2


def excess_series(level: Values, gamma: Values, delta: Values, delay: Values) -> Series:
    """Return |N|^2 t_r (alpha_lin - alpha - level (alpha + gamma)) as cosine series in theta."""
    whole = np.floor(delay)
    pairs = plant_pairs(gamma, delta, delay - whole)
    terms = int(np.max(whole, initial=0.0)) + 4
    series = np.zeros((len(level), terms))
    errors = np.zeros_like(series)
    plant = np.stack([pair.rounded() for pair in pairs[:5]])
    # Errors of N are relative to the sum of its coefficients, or to the root of it.
    size = np.sum(np.abs(plant[2:]), axis=0)
    loss = pairs_error(gamma, delta) / _EPS
    size += np.where(may_cancel(gamma, delta), loss * np.sqrt(size), 0.0)
    sizes = np.broadcast_to(size, plant.shape).copy()
    sizes[:2] = [[2.0], [1.0]]
    question = np.stack([level, gamma, delta, 0.5 + delay])
    for turns in np.unique(whole).astype(int).tolist():
        rows, columns = np.flatnonzero(whole == turns), slice(turns + 4)
        level_, gamma_, delta_, lag = question[:, rows, None]
        damping, real, square = _wall_series(plant[:, rows], turns, 1)
        slope = (1 + level_) * lag
        series[rows, columns] = (
            damping
            + slope * (damping - _times_cosine(damping) - real)
            + (delta_ - level_ * lag * gamma_) * square
        )
        damping, real, square = _wall_series(sizes[:, rows], turns, -1)
        errors[rows, columns] = (
            16
            * _EPS
            * (
                damping
                + slope * (damping + _times_cosine(damping) + real)
                + (delta_ + level_ * lag * gamma_) * square
            )
        )
    start = _excess_at_corner(gamma, delta, delay - whole, pairs, size)
    return Series(series, errors, *start)


def _wall_series(
    plant: Float64[np.ndarray, "5 batch"], turns: int, sign: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return |N|^2 times beta, times alpha + beta (1 - cos(theta)), and |N|^2 as cosine series.

    With ``sign`` -1 all products are added up without their signs, for bounds of errors.
    """
    d1, d0, n2, n1, n0 = plant
    # W = |N|^2 w: the powers turns + 3 down to turns - 1 of z. |N|^2 beta = Im W / sin(theta).
    powers = np.arange(turns + 3, turns - 2, -1)
    products = -sign * np.stack(
        [
            n0,
            n1 + d1 * n0,
            n2 + d1 * n1 + d0 * n0,
            d1 * n2 + d0 * n1,
            d0 * n2,
        ],
        axis=-1,
    )
    ratios, cosines = np.zeros((2, 5, turns + 4))
    cosines[np.arange(5), np.abs(powers)] = 1.0
    for row, power in zip(ratios, powers, strict=True):  # sin(power theta) / sin(theta)
        if power:
            row[abs(power) - 1 :: -2] = 2.0 * (power if sign > 0 else 1) / abs(power)
            row[0] /= 2.0
    square = np.zeros((len(d1), turns + 4))
    square[:, :3] = np.stack([n2**2 + n1**2 + n0**2, 2 * n1 * (n2 + n0), 2 * n2 * n0], axis=-1)
    return products @ ratios, products @ cosines, square


def _times_cosine(series: np.ndarray) -> np.ndarray:
    """Return cos(theta) times cosine series whose last term is zero."""
    product = np.zeros_like(series)
    product[:, 1:] += 0.5 * series[:, :-1]
    product[:, :-1] += 0.5 * series[:, 1:]
    product[:, 1] += 0.5 * series[:, 0]
    return product


def _excess_at_corner(
    gamma: Values, delta: Values, fraction: Values, plant: PlantPairs, size: Values
) -> tuple[Values, Values]:
    """Return E(0) and a bound of its error.

    At the corner beta is the slope of w = -z^m D/N at z = 1, where D(1) = gamma N(1).
    """
    rest = plant.n2.scaled(2.0) + plant.n1  # N'(1)
    bracket = plant.sum * (DoubleDouble.of(gamma) * (fraction - 0.5) + delta)
    bracket = bracket - (plant.d1 + 2.0) + rest * gamma
    value = (plant.sum * bracket).rounded()
    terms = size * (size * (3 * gamma + delta) + 4.0)
    error = 16 * (pairs_error(gamma, delta) + 2.0**-98) * terms + 4 * _EPS * np.abs(value)
    is_zero = (gamma == 0.0) | ((delta == 0.0) & ((fraction == 0.0) | (fraction == 0.5)))
    return np.where(is_zero, 0.0, value), np.where(is_zero, 0.0, error)
