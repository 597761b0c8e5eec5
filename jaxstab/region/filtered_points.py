"""Points and slopes of the boundary of a loop with filters, and the other roots there. NumPy only.

See ``filtered_curve`` for the form that is evaluated. Formulas are written once, for arrays and for
arrays with slopes.
"""

from dataclasses import dataclass
from math import comb
from typing import Any

import numpy as np
from jaxtyping import Bool, Complex128, Float64

from jaxstab.arrays import PI_REST, Array, tree_map
from jaxstab.model.double_double import DoubleDouble
from jaxstab.region.exact_points import determinants, exact_gains
from jaxstab.region.filtered_curve import Angles, FilteredCurve, Form, Half
from jaxstab.region.pole_lines import PoleLine
from jaxstab.region.stretches import true_angles

Values = Any  # an array, or a Dual
_TINY = 1e-100  # in place of the angle 0, where quotients of sines have a limit


@dataclass(frozen=True, slots=True)
class Dual:
    """Numbers with their slopes in an angle; what stands to the right of a sign may have none."""

    value: Array
    slope: Array

    def __add__(self, other: Values) -> "Dual":
        if isinstance(other, Dual):
            return Dual(self.value + other.value, self.slope + other.slope)
        return Dual(self.value + other, self.slope)

    def __sub__(self, other: Values) -> "Dual":
        if isinstance(other, Dual):
            return Dual(self.value - other.value, self.slope - other.slope)
        return Dual(self.value - other, self.slope)

    def __mul__(self, other: Values) -> "Dual":
        if isinstance(other, Dual):
            slope = self.slope * other.value + self.value * other.slope
            return Dual(self.value * other.value, slope)
        return Dual(self.value * other, self.slope * other)

    def __truediv__(self, other: Values) -> "Dual":
        if isinstance(other, Dual):
            value = self.value / other.value
            return Dual(value, (self.slope - value * other.slope) / other.value)
        return Dual(self.value / other, self.slope / other)

    @property
    def real(self) -> "Dual":
        """The real parts."""
        return Dual(self.value.real, self.slope.real)

    @property
    def imag(self) -> "Dual":
        """The imaginary parts."""
        return Dual(self.value.imag, self.slope.imag)


def filtered_point(
    curve: FilteredCurve, theta: Array, low: Array | float
) -> tuple[Array, Array, Array]:
    """Return alpha, beta and (alpha - W(1)) / (1 - cos th) at angles, which may be negative.

    ``low`` is what rounding took from the angles. A complex step of theta (``with_slope``) adds the
    slopes.
    """
    theta, low = np.broadcast_arrays(np.asarray(theta), low)
    flat, rest = theta.ravel(), low.ravel()
    turned = np.where(flat.real < 0.0, -1.0, 1.0)
    size, rest = flat.real * turned, rest.real * turned
    moves = flat.imag * turned if np.iscomplexobj(theta) else None
    evaluated = _exact_values if curve.is_exact else _float_values
    values = evaluated(curve, size, rest, moves)
    for line in curve.lines:
        held = line.holds(size)
        real, slopes = _on_line(curve, line, size[held] + rest[held])
        values[:, held] = real if moves is None else real + 1j * moves[held] * slopes
    alpha, beta, lift = values.reshape(3, *theta.shape)
    return alpha, beta, lift


def _float_values(curve: FilteredCurve, size: Angles, rest: Angles, moves: Angles | None) -> Array:
    """Return alpha, beta and the lift in float64, and how they move as their imaginary part."""
    upper, u = _folded(size, rest)
    if moves is None:
        return np.stack(_gains(curve, upper, u, with_slopes=False))
    step = 1j * moves * np.where(upper, -1.0, 1.0)
    gains = _gains(curve, upper, u, with_slopes=True)
    return np.stack([one.value + step * one.slope for one in gains])


def _exact_values(curve: FilteredCurve, size: Angles, rest: Angles, moves: Angles | None) -> Array:
    """Return the same in double-double, rounded."""
    angles, speed = true_angles(curve.stretches, size, rest)
    exact = exact_gains(curve.pairs, angles, with_slopes=moves is not None)
    values = np.stack([one.rounded() for one in exact.values])
    return values if moves is None else values + 1j * moves * speed * np.stack(exact.slopes)


def _folded(size: Angles, rest: Array | float) -> tuple[Bool[np.ndarray, " _"], Angles]:
    """Return which angles between 0 and pi are in the upper half, and those of zeta."""
    upper = size > np.pi / 2
    u = np.where(upper, (np.pi - size) + (PI_REST - rest), size + rest)
    return upper, np.where(u == 0.0, _TINY, u)


def exact_walls(curve: FilteredCurve, theta: Array) -> tuple[DoubleDouble, DoubleDouble]:
    """Return alpha and beta in double-double at angles, which may be negative."""
    size = np.abs(theta).ravel()
    angles, _ = true_angles(curve.stretches, size, np.zeros_like(size))
    values = exact_gains(curve.pairs, angles, with_slopes=False).values[:2]
    for line in curve.lines:
        held = line.holds(size)
        for one, wall in zip(values, _on_line(curve, line, size[held])[0], strict=False):
            one.hi[held], one.lo[held] = wall, 0.0
    alpha, beta = (tree_map(lambda x: x.reshape(theta.shape), value) for value in values)
    return alpha, beta


def _on_line(
    curve: FilteredCurve, line: PoleLine, size: Angles
) -> tuple[Float64[np.ndarray, "3 angle"], Float64[np.ndarray, "3 angle"]]:
    """Return alpha, beta and the lift next to a line at a pole, and their slopes."""
    (alpha, beta, angle), (alpha_slope, beta_slope, turn) = line.gains(size)
    below = 2.0 * np.sin(0.5 * angle) ** 2
    lift = (alpha - curve.plus.constants[4]) / below
    lift_slope = (alpha_slope - lift * np.sin(angle) * turn) / below
    return np.stack([alpha, beta, lift]), np.stack([alpha_slope, beta_slope, lift_slope])


def root_angles(curve: FilteredCurve, theta: Array) -> Array:
    """Return the angles of the roots; next to a line at a pole they are closer to the pole."""
    size = np.abs(theta).ravel()
    for line in curve.lines:
        held = line.holds(size)
        if np.any(held):
            size[held] = line.gains(size[held])[0][2]
    return size.reshape(theta.shape)


def _gains(
    curve: FilteredCurve, upper: Array, u: Array, *, with_slopes: bool
) -> tuple[Values, Values, Values]:
    """Return alpha, beta and the lift, by the angles u of zeta on one half of the circle each."""
    d, n, y, x, rise, fall = _rows(curve, upper, u, with_slopes=with_slopes)
    d_one, n_one, y_one, x_one, plant_one, estimate_one, sign = _constants(curve, upper)
    sine, cosine = _sinusoids(0.5, u, with_slopes=with_slopes)
    tangent = sine / cosine
    rolled = _geometric(curve.lag, u, with_slopes=with_slopes)
    plant = (rolled * d * n_one + fall) / n
    plant = plant * (-sign / _divisor(n_one))
    estimate = rise / y / _divisor(y_one)
    plant_swing, estimate_swing = _swing(plant, tangent), _swing(estimate, tangent)
    beta = plant_swing / estimate_swing
    swing = beta * estimate.imag - plant.imag
    alpha = tangent * swing * 2.0 + plant_one - beta * estimate_one
    of_plant, of_estimate = curve.minus.forms
    if of_plant or of_estimate:
        turn = _turn(curve.lag, u, with_slopes=with_slopes)
        whole, speed = turn * d / n * -sign, x / y  # W and V
        if of_plant == Form.INVERSE:
            gain, fallen = n / d, fall / d / -_divisor(d_one)
            moved = rolled * (n_one / _divisor(d_one)) - fallen
            plant_swing = _swing(moved, tangent) + tangent * _cross(fallen, rolled) * 2.0
            plant_swing = plant_swing * -sign / _square(gain)
        elif of_plant == Form.WHOLE:
            plant_swing = whole.imag / (sine * cosine * 2.0)
        if of_estimate == Form.INVERSE:
            estimate_swing = _swing(rise / x / _divisor(x_one), tangent) * _square(speed)
        elif of_estimate == Form.WHOLE:
            estimate_swing = speed.imag / (sine * cosine * 2.0)
        beta = _where(upper, plant_swing / estimate_swing, beta)
        alpha = _where(upper, whole.real - beta * speed.real, alpha)
    far_lift = (alpha - curve.plus.constants[4]) / (cosine * cosine * 2.0)
    return alpha, beta, _where(upper, far_lift, swing / (sine * cosine))


def _swing(quotient: Values, tangent: Values) -> Values:
    """Return the imaginary part of a value, over sin u, by its quotient by s."""
    return quotient.real - tangent * quotient.imag


def _square(one: Values) -> Values:
    return one.real * one.real + one.imag * one.imag


def _divisor(number: Array) -> Array:
    """Return a number, but 1 for 0: what is divided by it is not used."""
    return np.where(number == 0.0, 1.0, number)


def _constants(curve: FilteredCurve, upper: Array) -> list[Array]:
    """Return the constants of the half of each angle, and the sign of z^w at zeta = 1."""
    columns = ([*half.constants, half.sign] for half in (curve.minus, curve.plus))
    return [np.where(upper, *pair) for pair in zip(*columns, strict=True)]


def _rows(curve: FilteredCurve, upper: Array, u: Array, *, with_slopes: bool) -> list[Values]:
    """Return the rows of the halves at zeta = e^(iu), in the powers that have smaller terms."""
    values = np.empty((1 + with_slopes, 6, len(u)), complex)
    for half, chosen in ((curve.plus, ~upper), (curve.minus, upper)):
        values[..., chosen] = _row_values(half, u[chosen], with_slopes=with_slopes)
    return [Dual(*pair) for pair in zip(*values, strict=True)] if with_slopes else list(values[0])


def _row_values(half: Half, u: Array, *, with_slopes: bool) -> Complex128[np.ndarray, "_ 6 angle"]:
    rows = half.rows
    zeta = np.exp(1j * u)
    size = 2.0 * np.sin(0.5 * u)
    count = rows.straight.shape[1]
    straight, shifted = _powers(zeta, count), _powers(1j * size * np.exp(0.5j * u), count)
    is_close = size < rows.close[:, None]
    values = np.where(is_close, _product(rows.shifted, shifted), _product(rows.straight, straight))
    if not with_slopes:
        return np.stack([values])
    order = np.arange(float(count))
    slopes = np.where(
        is_close,
        _product(rows.shifted[:, 1:] * order[1:], shifted[:-1]) * zeta,
        _product(rows.straight * order, straight),
    )
    return np.stack([values, 1j * slopes])


def _product(matrix: Array, columns: Complex128[np.ndarray, "power angle"]) -> Array:
    """Return a real matrix times a complex one, which NumPy would make of two complex ones."""
    product: Array = (matrix @ columns.view(float)).view(complex)
    return product


def _powers(number: Array, count: int) -> Complex128[np.ndarray, "power angle"]:
    """Return the powers 0 ... count - 1."""
    powers = np.empty((count, len(number)), complex)
    powers[0], powers[1:] = 1.0, number
    return np.cumprod(powers, axis=0, out=powers)


def _sinusoids(factor: float, u: Array, *, with_slopes: bool) -> tuple[Values, Values]:
    """Return sine and cosine of a multiple of angles."""
    sine, cosine = np.sin(factor * u), np.cos(factor * u)
    if not with_slopes:
        return sine, cosine
    return Dual(sine, factor * cosine), Dual(cosine, -factor * sine)


def _turn(factor: float, u: Array, *, with_slopes: bool) -> Values:
    """Return e^(i factor u)."""
    turn = np.exp(1j * factor * u)
    return Dual(turn, 1j * factor * turn) if with_slopes else turn


def _geometric(count: float, u: Array, *, with_slopes: bool) -> Values:
    """Return 1 + zeta + ... + zeta^(count - 1)."""
    sine, _ = _sinusoids(0.5, u, with_slopes=with_slopes)
    whole, _ = _sinusoids(0.5 * count, u, with_slopes=with_slopes)
    return _turn(0.5 * (count - 1.0), u, with_slopes=with_slopes) * (whole / sine)


def _cross(one: Values, other: Values) -> Values:
    """Return the imaginary part of other times the conjugate of one."""
    return one.real * other.imag - one.imag * other.real


def _where(mask: Array, one: Values, other: Values) -> Values:
    if isinstance(one, Dual):
        value = np.where(mask, one.value, other.value)
        return Dual(value, np.where(mask, one.slope, other.slope))
    return np.where(mask, one, other)


def is_oriented(curve: FilteredCurve, theta: Angles) -> Bool[np.ndarray, " angle"]:
    """Return where the sign of angles is that of Im V: the stable side is the left one."""
    size = np.abs(theta)
    for line in curve.lines:  # the curve beside it has the same sign
        side = np.where(size < line.angle, -line.half_width, line.half_width)
        size = np.where(line.holds(size), line.angle + side, size)
    if curve.is_exact:
        angles, _ = true_angles(curve.stretches, size, np.zeros_like(size))
        above: np.ndarray = (determinants(curve.pairs, angles)[0] > 0.0) == (theta > 0.0)
        return above
    upper, folded = _folded(size, 0.0)
    _, _, y, x, rise, _ = _rows(curve, upper, folded, with_slopes=False)
    _, _, y_one, x_one, *_ = _constants(curve, upper)
    tangent = np.tan(0.5 * folded)
    swing = _swing(rise / y / _divisor(y_one), tangent)
    of_estimate = curve.minus.forms[1]
    if of_estimate == Form.INVERSE:
        swing = np.where(upper, _swing(rise / x / _divisor(x_one), tangent), swing)
    elif of_estimate == Form.WHOLE:
        swing = np.where(upper, (x / y).imag, swing)
    is_left: np.ndarray = ((swing > 0.0) != upper) == (theta > 0.0)
    return is_left


def may_be_stable(curve: FilteredCurve, alpha: Array, beta: Array) -> Bool[np.ndarray, " wall"]:
    """Return False where a coefficient of p is above that of any stable polynomial: binomial."""
    base, stiffness, damping = curve.parts[:, :, None]
    degree = len(base) - 1
    largest = np.array([comb(degree, k) for k in range(degree + 1)], float)[:, None]
    fits: np.ndarray = np.all(abs(base + stiffness * alpha + damping * beta) <= largest, axis=0)
    return fits


def filtered_quotient(
    curve: FilteredCurve, wall: tuple[Array, Array], total: Array, product: float, length: int
) -> Array:
    """Divide p(zeta) of a wall by zeta^2 - total zeta + product, of two roots that the wall has."""
    alpha, beta = wall
    base, stiffness, damping = curve.parts
    before, last = np.zeros_like(total), np.zeros_like(total)
    quotient = []
    for k in range(length):
        coefficient = base[k] + (stiffness[k] * alpha + damping[k] * beta)
        before, last = last, coefficient + total * last - product * before
        quotient.append(last)
    return np.stack(quotient)
