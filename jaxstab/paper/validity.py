"""Where the linear condition loses its validity (sec. VII): the first such point, with proof.

With H = alpha + gamma, which is positive to the right of the line z = 1, the error of the linear
condition exceeds a level where

    E = |N(z)|^2 t_r (alpha_lin - alpha - level (alpha + gamma)),       z = e^(i theta),

has the sign of H. On the curve E is a cosine series in theta of degree floor(delay) + 3, so all of
its sign changes can be isolated (``sign_changes``): lemmas C1 to C4 of docs/proofs.md. E(0) is of
third order in gamma and delta and summed in double-double.
"""

from math import pi
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int8, Int64

from jaxstab.arrays import Array, Numbers, at, joined, namespace
from jaxstab.conventions import Status, Verdict
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
from jaxstab.region.roots import bracketed_root
from jaxstab.rounding import EPS

# Proved facts about cosine series f(theta) = sum_k c_k cos(k theta) on [0, pi].
#
# Criteria that hold "for all frequencies" are such series. They are bounded between samples by
#
#     |f(theta) - f(t) - f'(t) (theta - t)| <= M (theta - t)^2 / 2,      M = sum_k k^2 |c_k|,
#
# so a sample decides for its neighbourhood, and where it cannot decide more samples are taken.
# Series that are sums of the same few series are evaluated as such: ``weights @ basis``. NumPy
# alone: the number of samples depends on the values.

Coefficients = Float64[np.ndarray, "batch term"]

Values = Float64[np.ndarray, " batch"]

_LARGEST_GAP = 1e-13  # of the sizes: how far the bound of a largest value may lie above it
_AT_ONCE = 1 << 18  # cells, and terms at angles, that are held in memory


class LargestValue(NamedTuple):
    """A value that each series takes, its angle, and a proved upper bound of all values."""

    value: Values
    theta: Values
    bound: Values


def series_values(coefficients: Coefficients, theta: Values) -> Values:
    """Return the value of each series at one angle each."""
    phase = theta[:, None] * np.arange(coefficients.shape[-1])
    value: Values = np.sum(coefficients * np.cos(phase), axis=-1)
    return value


def largest_value(
    weights: Float64[np.ndarray, "batch part"], basis: Float64[np.ndarray, "part term"]
) -> LargestValue:
    """Return the largest values of series ``weights @ basis`` over [0, pi], by branch and bound.

    The bound is above the value by at most 1e-13 of the sizes |weights| @ |basis|, summed, and the
    rounding of the series.
    """
    cells = 4 * basis.shape[1]
    rows = max(1, _AT_ONCE // cells)
    parts = range(0, len(weights), rows)
    answers = [_largest_value(weights[start : start + rows], basis, cells) for start in parts]
    return joined(answers)


def _largest_value(weights: np.ndarray, basis: np.ndarray, cells: int) -> LargestValue:
    batch = len(weights)
    order = np.arange(basis.shape[1])
    curvature = np.abs(weights @ basis) @ order**2
    sizes = np.abs(weights) @ np.abs(basis)
    gap = _LARGEST_GAP * np.sum(sizes, axis=-1)
    half = pi / (2 * cells)
    owner = np.repeat(np.arange(batch), cells)
    center = np.tile((2 * np.arange(cells) + 1) * half, batch)
    best, angle = np.full(batch, -np.inf), np.zeros(batch)
    while owner.size:
        value, slope = _combined(weights, basis, owner, center)
        climb = np.argsort(value)  # of equal owners the last one written stays
        better = climb[value[climb] > best[owner[climb]]]
        best[owner[better]], angle[owner[better]] = value[better], center[better]
        above = value + np.abs(slope) * half + 0.5 * curvature[owner] * half**2
        is_open = above > best[owner] + gap[owner]
        half /= 2
        owner = np.repeat(owner[is_open], 2)
        center = (center[is_open, None] + np.array([-half, half])).ravel()
    return LargestValue(best, angle, best + gap + _rounding(sizes, len(basis)))


def _combined(
    weights: np.ndarray, basis: np.ndarray, owner: np.ndarray, center: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return values and slopes of series at their centers, of which many have the same."""
    angles, index = np.unique(center, return_inverse=True)
    rows = max(1, _AT_ONCE // basis.shape[1])
    order = np.arange(basis.shape[1])
    table = np.empty((2, len(angles), len(basis)))
    for start in range(0, len(angles), rows):
        block = slice(start, start + rows)
        phase = angles[block, None] * order
        table[0, block] = np.cos(phase) @ basis.T
        table[1, block] = np.sin(phase) @ (-order * basis).T
    value, slope = np.einsum("kij,ij->ki", table[:, index], weights[owner])
    return value, slope


def _rounding(sizes: Coefficients, parts: int) -> Values:
    """Bound the rounding error of a computed value: of the phases and of the sums."""
    order = np.arange(sizes.shape[-1])
    units = order * pi + len(order) + parts + 5
    rounding: Values = EPS * (sizes @ units)
    return rounding


# All sign changes of cosine series on [0, pi], each in its own cell.
#
# A cell is decided at its middle, by bounds of the second derivative of f in theta or in h = 1 -
# cos(theta): a polynomial in h is regular at theta = 0 and pi, where df/dtheta vanishes. Cells that
# neither decides are halved. A computed sign counts only beyond a bound of its error, which shrinks
# with theta^2 towards 0 as the changes of f do. Proofs: lemmas C2 and C3 of docs/proofs.md.

Column = Float64[np.ndarray, " cells"]


_HALVINGS = 48
_MOST_CELLS = 64  # of a series that are open at once, times its terms: beyond, it is given up
_SHIFT = 0.382  # of the inner ends of cells, so that they miss the roots at rational parts of pi


class Series(NamedTuple):
    """Cosine series with bounds of their coefficients' errors; f(0) is known more accurately."""

    coefficients: Coefficients
    errors: Coefficients
    start: Values  # f(0)
    start_error: Values


class SignChanges(NamedTuple):
    """Cells of angles that hold the sign changes, in the order of the series and of the angles.

    Where ``is_proved``, the cell holds exactly one change, with its ``direction`` (1 for a rise, -1
    for a fall). Elsewhere it may hold none or, if the direction is 0, several.
    """

    owner: Int64[np.ndarray, " cells"]
    low: Column
    high: Column
    direction: Column
    is_proved: Bool[np.ndarray, " cells"]


class _Bounds(NamedTuple):
    """What bounds a series: its second derivatives in theta and in h, and the errors of values."""

    in_theta: Values
    in_h: Values
    error: Values  # over theta
    slope_error: Values  # over theta; half of it over theta^2 bounds the error of a value, too


class _Sample(NamedTuple):
    value: Column
    value_error: Column
    slope: Column
    slope_error: Column


def sign_changes(series: Series) -> SignChanges:
    """Return where each series changes its sign in (0, pi)."""
    batch, terms = series.coefficients.shape
    bounds = _bounds(series)
    inner = (np.arange(1, 2 * terms + 1) - _SHIFT) * (pi / (2 * terms + 0.5))
    ends = np.concatenate([[0.0], inner, [pi]])
    owner = np.repeat(np.arange(batch), len(ends) - 1)
    low, high = np.tile(ends[:-1], batch), np.tile(ends[1:], batch)
    kept: list[SignChanges] = []
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        sample = _sample(series, bounds, owner, middle)
        is_clear, is_monotone = _decided(sample, bounds, owner, middle, 0.5 * (high - low))
        is_lost = (np.abs(sample.value) <= sample.value_error) & (
            np.abs(sample.slope) <= sample.slope_error
        )
        is_open = ~(is_clear | is_monotone | is_lost)
        many = np.bincount(owner[is_open], minlength=batch) > _MOST_CELLS * terms
        is_lost = ~(is_clear | is_monotone) & (is_lost | many[owner])
        is_open &= ~is_lost
        direction = np.sign(sample.slope)
        here = is_monotone & ~is_clear
        kept.append(_changes(series, bounds, owner[here], low[here], high[here], direction[here]))
        kept.append(_unproved(owner[is_lost], low[is_lost], high[is_lost]))
        owner = np.repeat(owner[is_open], 2)
        low, middle, high = low[is_open], middle[is_open], high[is_open]
        low, high = np.stack([low, middle], -1).ravel(), np.stack([middle, high], -1).ravel()
        if not owner.size:
            break
    kept.append(_unproved(owner, low, high))
    together = [np.concatenate(column) for column in zip(*kept, strict=True)]
    order = np.lexsort((together[1], together[0]))
    return at(SignChanges(*together), order)


def _bounds(series: Series) -> _Bounds:
    order = np.arange(series.coefficients.shape[-1])
    size = np.abs(series.coefficients) + series.errors
    # Each term is right to a few units: its angle, its sine, the product and the sum.
    errors = series.errors + (len(order) + 8) * EPS * np.abs(series.coefficients)
    return _Bounds(
        in_theta=np.sum(order**2 * size, axis=-1),
        in_h=np.sum(order**2 * (order**2 - 1) * size, axis=-1) / 3,
        error=np.sum(order * errors, axis=-1),
        slope_error=np.sum(order**2 * errors, axis=-1),
    )


def _sample(
    series: Series, bounds: _Bounds, owner: Int64[np.ndarray, " cells"], theta: Column
) -> _Sample:
    """Return f, df/dtheta and bounds of their errors, one angle for each cell."""
    order = np.arange(series.coefficients.shape[-1])
    half = 0.5 * theta[:, None] * order
    sine, terms = np.sin(half), 2.0 * series.coefficients[owner]
    value = series.start[owner] - np.sum(terms * sine**2, axis=-1)
    slope = -np.sum(terms * order * sine * np.cos(half), axis=-1)
    slope_error = theta * bounds.slope_error[owner]
    error = np.minimum(theta * bounds.error[owner], 0.5 * theta * slope_error)
    error = error + series.start_error[owner] + 4 * EPS * np.abs(value)
    return _Sample(value, error, slope, slope_error)


def _decided(
    sample: _Sample,
    bounds: _Bounds,
    owner: Int64[np.ndarray, " cells"],
    middle: Column,
    half: Column,
) -> tuple[Bool[np.ndarray, " cells"], Bool[np.ndarray, " cells"]]:
    """Return which cells are proved to hold no root, and which to be monotone."""
    away = np.abs(sample.value) - sample.value_error
    slope = np.abs(sample.slope)
    clear, monotone = np.zeros(len(owner), bool), np.zeros(len(owner), bool)
    widest = np.maximum(np.sin(middle - 0.5 * half), np.sin(middle + 0.5 * half))
    in_h = 2.0 * np.sin(0.5 * half) * widest
    for change, bend, width in (
        (1.0, bounds.in_theta[owner], half * (1 + 8 * EPS)),
        (1.0 / np.sin(middle), bounds.in_h[owner], in_h * (1 + 8 * EPS)),
    ):
        steepest = (slope + sample.slope_error) * change
        clear |= away > (steepest * width + 0.5 * bend * width**2) * (1 + 8 * EPS)
        monotone |= (slope - sample.slope_error) * change > bend * width * (1 + 8 * EPS)
    return clear, monotone


def _changes(
    series: Series,
    bounds: _Bounds,
    owner: Int64[np.ndarray, " cells"],
    low: Column,
    high: Column,
    direction: Column,
) -> SignChanges:
    """Return the monotone cells whose ends differ in sign, or may do so."""
    at_low, at_high = (_sample(series, bounds, owner, theta) for theta in (low, high))
    starts, ends = direction * at_low.value, direction * at_high.value
    is_known = (starts < -at_low.value_error) & (ends > at_high.value_error)
    from_zero = (low == 0.0) & (series.start[owner] == 0.0) & (series.start_error[owner] == 0.0)
    kept = (starts <= at_low.value_error) & (ends >= -at_high.value_error) & ~from_zero
    return SignChanges(owner[kept], low[kept], high[kept], direction[kept], is_known[kept])


def _unproved(owner: Int64[np.ndarray, " cells"], low: Column, high: Column) -> SignChanges:
    return SignChanges(owner, low, high, np.zeros(len(owner)), np.zeros(len(owner), bool))


_STEP_BACK = 1e-6  # of alpha + gamma: how far inside of a boundary point its side is tested
_CHUNK = 2048  # questions answered at once


class ValidityStatus(Status):
    """What is known about the point where the linear condition loses its validity.

    Example:
        >>> jaxstab.paper.ValidityStatus(1).words
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
        >>> found = jaxstab.paper.linear_validity(0.02, gamma=0.0, delta=0.0, delay=0.0)
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
    NOT_PROVED says that float64 cannot tell, as for levels below about 1e-9.

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
        _answers(at(question, np.arange(start, min(start + _CHUNK, grids[0].size))))
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
    owners = at(question, changes.owner)
    curve = _Curve(
        owners,
        SliceCoefficients(*(np.asarray(column)[changes.owner] for column in slices)),
    )
    ends = -changes.direction, changes.direction
    with np.errstate(divide="ignore", invalid="ignore"):  # of steps, which are bisected then
        theta = bracketed_root(_Curve.excess, curve, changes.low, changes.high, ends)
    alpha, beta, height = curve.point(theta)
    # Left of the line z = 1 the error rises where its numerator falls.
    rises = (changes.direction * height > 0) | (changes.direction == 0)
    owner, lowest = np.unique(changes.owner[rises], return_index=True)
    lowest = np.flatnonzero(rises)[lowest]
    proved = changes.is_proved[lowest]
    status = np.full(len(question.level), ValidityStatus.NEVER, np.int8)
    status[owner[~proved]] = ValidityStatus.NOT_PROVED
    owner, lowest = owner[proved], lowest[proved]
    point = np.full((3, len(question.level)), np.nan)
    point[:, owner] = alpha[lowest], beta[lowest], theta[lowest]
    slice_ = (values[owner] for values in question[1:])
    inner = verdict(alpha[lowest] - _STEP_BACK * height[lowest], beta[lowest], **by_name(*slice_))
    is_edge = np.asarray(inner) == Verdict.STABLE
    status[owner] = np.where(is_edge, ValidityStatus.FOUND, ValidityStatus.OFF_THE_EDGE)
    return LinearValidity(point[0], point[1], point[2], status)


class _Curve(NamedTuple):
    """The boundary curves of some questions."""

    question: _Question
    slices: SliceCoefficients

    def point(self, theta: Values) -> tuple[Values, Values, Values]:
        """Return alpha, beta and alpha + gamma, to full relative accuracy."""
        alpha, beta, lift = (np.asarray(values) for values in curve_and_lift(self.slices, theta))
        return alpha, beta, 2.0 * np.sin(0.5 * theta) ** 2 * lift

    def excess(self, theta: Values) -> Values:
        """Return alpha_lin - alpha - level (alpha + gamma)."""
        level, gamma, delta, _ = self.question
        _, beta, height = self.point(theta)
        return (beta + delta) / self.question.lag + gamma - (1.0 + level) * height


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
    loss = pairs_error(gamma, delta) / EPS
    size += np.where(may_cancel(gamma, delta), loss * np.sqrt(size), 0.0)
    sizes = np.broadcast_to(size, plant.shape).copy()
    sizes[:2] = [[2.0], [1.0]]
    question = np.stack([level, gamma, delta, 0.5 + delay])
    for turns in np.unique(whole).astype(int).tolist():
        rows, columns = np.flatnonzero(whole == turns), slice(turns + 4)
        level_, gamma_, delta_, lag = question[:, rows, None]
        damping, real, square = _wall_series(plant[:, rows], turns, 1)
        slope = (1 + level_) * lag
        series[rows, columns] = damping + slope * (damping - _times_cosine(damping) - real)
        series[rows, columns] += (delta_ - level_ * lag * gamma_) * square
        damping, real, square = _wall_series(sizes[:, rows], turns, -1)
        errors[rows, columns] = damping + slope * (damping + _times_cosine(damping) + real)
        errors[rows, columns] += (delta_ + level_ * lag * gamma_) * square
        errors[rows, columns] *= 16 * EPS
    start = _excess_at_corner(gamma, delta, delay - whole, pairs, size)
    return Series(series, errors, *start)


def _wall_series(
    plant: Float64[np.ndarray, "5 batch"], turns: int, sign: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return |N|^2 times beta, times alpha + beta (1 - cos(theta)), and |N|^2 as cosine series."""
    # With ``sign`` -1 all products are added up without their signs, for bounds of errors.
    d1, d0, n2, n1, n0 = plant
    # W = |N|^2 w: the powers turns + 3 down to turns - 1 of z. |N|^2 beta = Im W / sin(theta).
    powers = np.arange(turns + 3, turns - 2, -1)
    rising = [n0, n1 + d1 * n0, n2 + d1 * n1 + d0 * n0, d1 * n2 + d0 * n1, d0 * n2]
    products = -sign * np.stack(rising, axis=-1)
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
    """Return E(0) and a bound of its error."""
    # At the corner beta is the slope of w = -z^m D/N at z = 1, where D(1) = gamma N(1).
    slope = plant.n2.scaled(2.0) + plant.n1  # N'(1)
    bracket = plant.sum * (DoubleDouble.of(gamma) * (fraction - 0.5) + delta)
    bracket = bracket - (plant.d1 + 2.0) + slope * gamma
    value = (plant.sum * bracket).rounded()
    terms = size * (size * (3 * gamma + delta) + 4.0)
    error = 16 * (pairs_error(gamma, delta) + 2.0**-98) * terms + 4 * EPS * np.abs(value)
    is_zero = (gamma == 0.0) | ((delta == 0.0) & ((fraction == 0.0) | (fraction == 0.5)))
    return np.where(is_zero, 0.0, value), np.where(is_zero, 0.0, error)
