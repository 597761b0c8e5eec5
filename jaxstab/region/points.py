"""Points and slopes of the boundary curve. NumPy only.

The form that is evaluated is that of ``region.curve``: polynomials on one half of the circle, in
powers of zeta or of zeta - 1, whichever has the smaller terms, and their quotients by zeta - 1.
Their real and imaginary parts give beta, and then alpha and the distance from the line of a real
root. Formulas are written once, for arrays and for arrays with slopes (``Dual``). Next to a line at
a pole the curve is that of ``PoleLine``; curves that need more digits are evaluated by ``exact``.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Complex128, Float64

from jaxstab.arrays import PI_REST, Array, tree_map
from jaxstab.model.double_double import DoubleDouble
from jaxstab.region.curve import (
    Angles,
    Curve,
    Form,
    Half,
    PoleLine,
    Rows,
    true_angles,
)
from jaxstab.region.exact import determinants, exact_gains
from jaxstab.region.roots import nonzero

Values = Any  # an array, or a Dual
_TINY = 1e-100  # in place of the angle 0, where quotients of sines have a limit


class Dual(NamedTuple):
    """Numbers with their slopes in an angle; the right operand of an operator may have none."""

    value: Array
    slope: Array

    def __add__(self, other: Values) -> "Dual":
        if type(other) is Dual:
            return Dual(self.value + other.value, self.slope + other.slope)
        return Dual(self.value + other, self.slope)

    def __sub__(self, other: Values) -> "Dual":
        if type(other) is Dual:
            return Dual(self.value - other.value, self.slope - other.slope)
        return Dual(self.value - other, self.slope)

    def __mul__(self, other: Values) -> "Dual":
        if type(other) is Dual:
            slope = self.slope * other.value + self.value * other.slope
            return Dual(self.value * other.value, slope)
        return Dual(self.value * other, self.slope * other)

    def __truediv__(self, other: Values) -> "Dual":
        if type(other) is Dual:
            value = self.value / other.value
            return Dual(value, (self.slope - value * other.slope) / other.value)
        return Dual(self.value / other, self.slope / other)

    def conj(self) -> "Dual":
        """The conjugates."""
        return Dual(self.value.conj(), self.slope.conj())

    @property
    def real(self) -> "Dual":
        """The real parts."""
        return Dual(self.value.real, self.slope.real)

    @property
    def imag(self) -> "Dual":
        """The imaginary parts."""
        return Dual(self.value.imag, self.slope.imag)


class _Circle(NamedTuple):
    """The points zeta = e^(iu) of a half of the circle, and s = zeta - 1 with its size."""

    zeta: Complex128[np.ndarray, " angle"]
    s: Complex128[np.ndarray, " angle"]
    size: Angles

    @classmethod
    def at_angles(cls, u: Angles) -> "_Circle":
        """Return the points at angles."""
        size = 2.0 * np.sin(0.5 * u)
        return cls(np.exp(1j * u), 1j * size * np.exp(0.5j * u), size)


def curve_and_lift(
    curve: Curve, theta: Array, low: Array | float = 0.0
) -> tuple[Array, Array, Array]:
    """Return alpha, beta and (alpha + beta V(r) - W(r)) / (1 - cos th).

    ``low`` is what rounding took from the angles, which may be negative. A complex step of theta
    (``with_slope``) adds the slopes.
    """
    theta = np.asarray(theta)
    flat, low = theta.ravel(), np.broadcast_to(low, theta.shape).ravel()
    turned = np.where(flat.real < 0.0, -1.0, 1.0)
    size, low = flat.real * turned, low.real * turned
    moves = flat.imag * turned if np.iscomplexobj(theta) else None
    evaluated = _exact_values if curve.is_exact else _float_values
    values = evaluated(curve, size, low, moves)
    for line in curve.lines:
        held = line.holds(size)
        real, slopes = _on_line(curve, line, size[held] + low[held])
        values[:, held] = real if moves is None else real + 1j * moves[held] * slopes
    alpha, beta, lift = values.reshape(3, *theta.shape)
    return alpha, beta, lift


def curve_gains(curve: Curve, theta: Array, low: Array | float = 0.0) -> Array:
    """Return alpha and beta of the curve, stacked."""
    return np.stack(curve_and_lift(curve, theta, low)[:2])


def _float_values(curve: Curve, size: Angles, low: Angles, moves: Angles | None) -> Array:
    """Return alpha, beta and the lift in float64, with slopes times ``moves`` as imaginary part."""
    upper, u = _folded(size, low)
    values = np.empty((3, len(u)), float if moves is None else complex)
    for half, sign, chosen in ((curve.plus, 1.0, ~upper), (curve.minus, -1.0, upper)):
        if not np.any(chosen):
            continue
        gains = _gains(curve, half, u[chosen], with_slopes=moves is not None)
        if moves is None:
            values[:, chosen] = gains
        else:
            step = 1j * (sign * moves[chosen])
            values[:, chosen] = [gain.value + step * gain.slope for gain in gains]
    return values


def _exact_values(curve: Curve, size: Angles, low: Angles, moves: Angles | None) -> Array:
    """Return the same in double-double, rounded."""
    angles, speed = true_angles(curve.stretches, size, low)
    exact = exact_gains(curve.pairs, angles, with_slopes=moves is not None)
    values = np.stack([value.rounded() for value in exact.values])
    return values if moves is None else values + 1j * moves * speed * np.stack(exact.slopes)


def _folded(size: Angles, low: Array | float) -> tuple[Bool[np.ndarray, " _"], Angles]:
    """Return which angles between 0 and pi are in the upper half, and those of zeta."""
    upper = size > np.pi / 2
    u = np.where(upper, (np.pi - size) + (PI_REST - low), size + low)
    return upper, np.where(u == 0.0, _TINY, u)


def exact_walls(curve: Curve, theta: Array) -> tuple[DoubleDouble, DoubleDouble]:
    """Return alpha and beta in double-double at angles, which may be negative."""
    size = np.abs(theta).ravel()
    angles, _ = true_angles(curve.stretches, size, np.zeros_like(size))
    values = exact_gains(curve.pairs, angles, with_slopes=False).values[:2]
    for line in curve.lines:
        held = line.holds(size)
        for gain, wall in zip(values, _on_line(curve, line, size[held])[0], strict=False):
            gain.hi[held], gain.lo[held] = wall, 0.0
    alpha, beta = (tree_map(lambda x: x.reshape(theta.shape), value) for value in values)
    return alpha, beta


def _on_line(
    curve: Curve, line: PoleLine, size: Angles
) -> tuple[Float64[np.ndarray, "3 angle"], Float64[np.ndarray, "3 angle"]]:
    """Return alpha, beta and the lift next to a line at a pole, and their slopes."""
    (alpha, beta, angle), (alpha_slope, beta_slope, turn) = line.gains(size)
    below = 2.0 * np.sin(0.5 * angle) ** 2
    lift = (alpha + curve.plus_slope * beta - curve.plus_offset) / below
    line_slope = alpha_slope + curve.plus_slope * beta_slope
    lift_slope = (line_slope - lift * np.sin(angle) * turn) / below
    return np.stack([alpha, beta, lift]), np.stack([alpha_slope, beta_slope, lift_slope])


def root_angles(lines: Sequence[PoleLine], theta: Array) -> Array:
    """Return the angles of the roots; next to a line at a pole they are closer to the pole."""
    size = np.abs(theta).ravel()
    for line in lines:
        held = line.holds(size)
        if np.any(held):
            size[held] = line.gains(size[held])[0][2]
    return size.reshape(theta.shape)


def _gains(
    curve: Curve, half: Half, u: Angles, *, with_slopes: bool
) -> tuple[Values, Values, Values]:
    """Return alpha, beta and the lift, by the angles u of zeta on one half of the circle."""
    circle = _Circle.at_angles(u)
    n, d, fall, y, x, rise = _rows(half.rows, circle, with_slopes=with_slopes)
    n_one, d_one, y_one, x_one = nonzero(np.array(half.at_one), 1.0)  # 0 is not used
    (plant_one, estimate_one), gain = half.values, half.gain
    sine, cosine = _sinusoids(0.5, u, with_slopes=with_slopes)
    tangent = sine / cosine
    rolled = _geometric(curve.lag, u, sine, with_slopes=with_slopes)
    plant = (rolled * d * half.at_one[0] + fall) / n * (-gain / n_one)
    estimate = rise / y / y_one
    plant_swing, estimate_swing = _swing(plant, tangent), _swing(estimate, tangent)
    of_plant, of_estimate = half.forms
    if of_plant or of_estimate:
        turn = _turn(curve.lag, u, with_slopes=with_slopes)
        whole, speed = turn * d / n * -gain, x / y  # W and V
        if of_plant == Form.INVERSE:
            # Times |D|^2: an undamped hand has D = 0 on the circle.
            fallen = fall * d.conj() / -d_one
            moved = rolled * _square(d) * (half.at_one[0] / d_one) - fallen
            plant_swing = _swing(moved, tangent) + tangent * _cross(fallen, rolled) * 2.0
            plant_swing = plant_swing * -gain / _square(n)
        elif of_plant == Form.WHOLE:
            plant_swing = whole.imag / (sine * cosine * 2.0)
        if of_estimate == Form.INVERSE:
            estimate_swing = _swing(rise * x.conj() / x_one, tangent) / _square(y)
        elif of_estimate == Form.WHOLE:
            estimate_swing = speed.imag / (sine * cosine * 2.0)
    beta = plant_swing / estimate_swing
    swing = beta * estimate.imag - plant.imag
    if of_plant or of_estimate:
        alpha = whole.real - beta * speed.real
    else:
        alpha = tangent * swing * 2.0 + plant_one - beta * estimate_one
    if half is curve.plus:
        return alpha, beta, swing / (sine * cosine)
    away = alpha + beta * curve.plus_slope - curve.plus_offset
    return alpha, beta, away / (cosine * cosine * 2.0)


def _swing(quotient: Values, tangent: Values) -> Values:
    """Return the imaginary part of a value, over sin u, by its quotient by s."""
    return quotient.real - tangent * quotient.imag


def _square(z: Values) -> Values:
    return z.real * z.real + z.imag * z.imag


def _rows(rows: Rows, circle: _Circle, *, with_slopes: bool) -> list[Values]:
    """Return polynomials on the circle, in the powers that have smaller terms."""
    orders, count = 1 + with_slopes, rows.straight.shape[2]
    values = _product(rows.straight[:orders], _powers(circle.zeta, count))
    near = np.flatnonzero(circle.size < np.max(rows.close))
    if near.size:
        shifted = _product(rows.shifted[:orders], _powers(circle.s[near], count))
        shifted[1:] *= circle.zeta[near]
        is_close = circle.size[near] < rows.close[:, None]
        values[..., near] = np.where(is_close, shifted, values[..., near])
    if not with_slopes:
        return list(values[0])
    return list(map(Dual, values[0], 1j * values[1]))


def _product(rows: Array, columns: Complex128[np.ndarray, "power angle"]) -> Array:
    """Return real matrices times a complex one; NumPy would make them complex first."""
    product = rows.reshape(-1, len(columns)) @ columns.view(float)
    return product.view(complex).reshape(*rows.shape[:2], -1)


def _powers(base: Array, count: int) -> Complex128[np.ndarray, "power angle"]:
    """Return the powers 0 ... count - 1, by a few products of many of them."""
    powers = np.empty((count, len(base)), complex)
    powers[0], powers[1:2] = 1.0, base
    filled = 2
    while filled < count:
        more = min(filled - 1, count - filled)
        np.multiply(powers[1 : 1 + more], powers[filled - 1], out=powers[filled : filled + more])
        filled += more
    return powers


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


def _geometric(count: float, u: Array, sine: Values, *, with_slopes: bool) -> Values:
    """Return 1 + zeta + ... + zeta^(count - 1), by the sine of u/2."""
    whole, _ = _sinusoids(0.5 * count, u, with_slopes=with_slopes)
    return _turn(0.5 * (count - 1.0), u, with_slopes=with_slopes) * (whole / sine)


def _cross(a: Values, b: Values) -> Values:
    """Return the imaginary part of conj(a) b."""
    return a.real * b.imag - a.imag * b.real


def is_oriented(curve: Curve, theta: Angles) -> Bool[np.ndarray, " angle"]:
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
    is_left = np.empty(len(size), bool)
    for half, chosen in ((curve.plus, ~upper), (curve.minus, upper)):
        is_left[chosen] = _swing_of_estimate(half, folded[chosen]) > 0.0
    oriented: np.ndarray = (is_left != upper) == (theta > 0.0)
    return oriented


def _swing_of_estimate(half: Half, u: Angles) -> Angles:
    """Return a number of the sign of Im V at zeta = e^(iu)."""
    _, _, _, y, x, rise = _rows(half.rows, _Circle.at_angles(u), with_slopes=False)
    _, _, y_one, x_one = nonzero(np.array(half.at_one), 1.0)
    swing: Angles
    if half.forms[1] == Form.WHOLE:
        swing = (x / y).imag
    elif half.forms[1] == Form.INVERSE:
        swing = _swing(rise * x.conj() / x_one, np.tan(0.5 * u))
    else:
        swing = _swing(rise / y / y_one, np.tan(0.5 * u))
    return swing
