"""Boxes of loops, and functions over whole boxes, enclosed.

A box is center +- half along named axes. An axis is one quantity that varies: a mass, a stiffness
or a damping of device or hand, the delay, the way along an edge of walls, and always theta, the
angle of a root on the unit circle. What does not vary is no axis.

Sums, products and reciprocals of models enclose whatever is composed of them: the value in the
middle of each box, the slope along each axis, and a bound of what these leave, as Taylor models of
first order do (Makino, Berz 1996; lemma B13 of docs/proofs.md).

Axes are rows of the slopes, which the functions that make models name. Rounding is counted with
the rest. In batches, real or complex. NumPy only.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from math import pi
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from jaxstab.model.filters import Filter, Filters, exact_chain, rounded
from jaxstab.rounding import (
    ELEMENTARY,
    EPS,
    LINEAR_MODEL,
    PARAMETER,
    RAISED_MANY,
    RAISED_MUCH,
    SINC_SLOPE,
)

HAND = "hand_mass", "hand_stiffness", "hand_damping"
THETA = "theta"

Rows = Float64[np.ndarray, "axis box"]
Row = Float64[np.ndarray, " box"]

Floats = Any  # real or complex arrays

Number = Any  # the same, or one number

_HINT = 0.1  # of slopes that only show which axis to halve (``phasor``)


@dataclass(frozen=True)
class LinearModel:
    """A function over boxes; where no bound is known, ``rest`` is infinite.

    It holds every function f with

        |f(x) - centre - sum_k slope_k x_k| <= rest         for all |x_k| <= 1,

    x_k the place along axis k, from one end of the box to the other one. Shapes: (*box), slopes
    (axis, *box).
    """

    centre: Floats
    slope: Floats
    rest: Floats

    @property
    def swing(self) -> Floats:
        """The largest distance of the function from its centre."""
        return self._sloped + self.rest

    @property
    def size(self) -> Floats:
        """A bound of its absolute value."""
        return abs(self.centre) + self.swing

    @property
    def low(self) -> Floats:
        """A lower bound of a real function."""
        return self.centre - self.swing

    def constant(self, value: Number) -> "LinearModel":
        """Return a number as a model over the same boxes."""
        centre = np.full(self.centre.shape, value)
        return LinearModel(centre, np.zeros(self.slope.shape), np.zeros(centre.shape))

    def __add__(self, other: "LinearModel | Number") -> "LinearModel":
        if not isinstance(other, LinearModel):
            return _rounded(self.centre + other, self.slope, self.rest)
        rest = self.rest + other.rest
        return _rounded(self.centre + other.centre, self.slope + other.slope, rest)

    def __neg__(self) -> "LinearModel":
        return LinearModel(-self.centre, -self.slope, self.rest)

    def __sub__(self, other: "LinearModel | Number") -> "LinearModel":
        return self.__add__(-other)

    def __rsub__(self, other: Number) -> "LinearModel":
        return (-self).__add__(other)

    def __mul__(self, other: "LinearModel | Number") -> "LinearModel":
        if not isinstance(other, LinearModel):
            return _rounded(self.centre * other, self.slope * other, self.rest * abs(other))
        slope = self.centre * other.slope + other.centre * self.slope
        with np.errstate(invalid="ignore"):  # what has no bound has none when it is taken 0 times
            rest = abs(self.centre) * other.rest + self.rest * other.size
            rest = rest + self._sloped * other.swing
        rest = np.where(rest >= 0.0, rest, np.inf)
        return _rounded(self.centre * other.centre, slope, rest)

    __radd__ = __add__
    __rmul__ = __mul__

    def reciprocal(self) -> "LinearModel":
        """Return 1/f; unbounded where f may vanish."""
        clear = abs(self.centre) - self.swing
        is_known = clear > 0.0
        clear, centre = np.where(is_known, clear, 1.0), np.where(is_known, self.centre, 1.0)
        square, size = centre**2, abs(centre) ** 2
        rest = self.swing**2 / (size * clear) + self.rest / size
        bounded = _rounded(1.0 / centre, -self.slope / square, rest)
        return replace(bounded, rest=np.where(is_known, bounded.rest, np.inf))

    @cached_property
    def _sloped(self) -> Floats:
        return abs(self.slope).sum(axis=0)


def _rounded(centre: Floats, slope: Floats, rest: Floats) -> LinearModel:
    """Return a result of arithmetic on models, with its rounding."""
    exact = LinearModel(centre, slope, rest)
    made = LinearModel(centre, slope, rest + LINEAR_MODEL * exact.size)
    vars(made)["_sloped"] = exact._sloped  # the slopes are the same
    return made


@dataclass(frozen=True)
class Moving:
    """A function of boxes, and its derivative by one of the variables."""

    value: LinearModel
    rate: LinearModel

    def __add__(self, other: "Moving | LinearModel | Number") -> "Moving":
        if isinstance(other, Moving):
            return Moving(self.value + other.value, self.rate + other.rate)
        return Moving(self.value + other, self.rate)

    def __neg__(self) -> "Moving":
        return Moving(-self.value, -self.rate)

    def __sub__(self, other: "Moving | LinearModel | Number") -> "Moving":
        return self + -other

    def __mul__(self, other: "Moving | LinearModel | Number") -> "Moving":
        if isinstance(other, Moving):
            rate = self.value * other.rate + other.value * self.rate
            return Moving(self.value * other.value, rate)
        return Moving(self.value * other, self.rate * other)

    __radd__ = __add__
    __rmul__ = __mul__

    def reciprocal(self) -> "Moving":
        """Return 1/f; unbounded where f may vanish."""
        inverse = self.value.reciprocal()
        return Moving(inverse, -(self.rate * inverse * inverse))


def clearances(normal: Floats, models: Sequence[LinearModel]) -> tuple[list[Floats], list[Floats]]:
    """Distances of functions, in all of a box, from a line through 0 across a direction.

    All are on one side where all distances are positive. Then how far each axis moves each model
    along the direction.
    """
    normal = normal / np.maximum(np.abs(normal), 1e-300)
    away = [np.real(normal.conj() * model.centre) for model in models]
    side = np.where(sum(away) < 0.0, -1.0, 1.0)
    moves = [np.abs(np.real(normal.conj() * model.slope)) for model in models]
    distances = [
        side * far - by.sum(axis=0) - model.rest
        for model, far, by in zip(models, away, moves, strict=True)
    ]
    return distances, moves


def variable(axis: int, axes: int, centre: Floats, half: Floats) -> LinearModel:
    """Return a variable that runs along one of some axes, with its half-width."""
    slope = np.zeros((axes, centre.size))
    slope[axis] = half
    return LinearModel(centre, slope, np.zeros(centre.size))


def conjugate(model: LinearModel) -> LinearModel:
    """Return the conjugate of a function."""
    return LinearModel(model.centre.conj(), model.slope.conj(), model.rest)


def disc(model: LinearModel) -> LinearModel:
    """Return a function without moves along the axes."""
    return LinearModel(model.centre, model.slope[:0], model.swing)


def on_axes_of(model: LinearModel, other: LinearModel) -> LinearModel:
    """Return a function with the axes of another."""
    if len(model.slope) == len(other.slope):
        return model
    return replace(model, slope=np.zeros(other.slope.shape))


def phasor(phase: LinearModel) -> LinearModel:
    """Return e^(-i phase), and the unit disc where the phase moves by 1 or more.

    The slopes of a disc are no derivatives: they show which axis to halve, and its rest covers
    them.
    """
    centre = np.exp(-1j * phase.centre)
    rest = 0.5 * (phase.swing - phase.rest) ** 2 + phase.rest
    rest = rest + ELEMENTARY * (1.0 + np.abs(phase.centre))
    is_known = phase.swing < 1.0
    hint = _HINT * phase.slope / np.maximum(phase.swing, 1.0)
    slope = np.where(is_known, -1j * centre * phase.slope, hint)
    rest = np.where(is_known, rest, 1.0 + _HINT)
    return LinearModel(np.where(is_known, centre, 0.0), slope, rest)


def sine(theta: LinearModel) -> LinearModel:
    """Return 2 sin(theta/2)."""
    half = 0.5 * theta.centre
    rest = 0.25 * theta.swing**2 + theta.rest + ELEMENTARY
    return LinearModel(2.0 * np.sin(half), np.cos(half) * theta.slope, rest)


def sinc(theta: LinearModel) -> Moving:
    """Return sin(theta/2)/(theta/2) and its derivative, whose own is at most 1/12."""
    x, swing = theta.centre, theta.swing
    value, is_small = np.sinc(x / (2.0 * pi)), np.abs(x) < 1e-3
    slope = np.where(is_small, -x / 12.0, (np.cos(0.5 * x) - value) / np.where(is_small, 1.0, x))
    rest = swing**2 / 24.0 + SINC_SLOPE * swing + ELEMENTARY
    return Moving(
        LinearModel(value, slope * theta.slope, rest),
        LinearModel(slope, np.zeros_like(theta.slope), swing / 12.0 + SINC_SLOPE),
    )


# Estimator and filter on the unit circle as models over boxes of the angle.
#
# A filter is a quotient of polynomials in 1/z. Its numerator is multiplied out in exact numbers;
# the denominators of its sections stay apart, because next to z = 1, where poles are, their product
# would cancel. A polynomial with real coefficients is on the circle
#
#     f(theta) = sum_k c_k e^(-i k theta),     |f^(m)| <= sum_k k^m |c_k|,
#
# so that around theta_0, |theta - theta_0| <= h, with f, f' and f" evaluated there,
#
#     f = f(theta_0) + f'(theta_0) (theta - theta_0) + r,
#     |r| <= h^2/2 (|f"(theta_0)| + h sum k^3 |c_k|),
#
# or h^2/2 times the bound of f" itself, where that is less. Its derivative has the bounds of one
# order more (lemma B14 of docs/proofs.md). No tables, and nothing that depends on the degree but
# the sums.

_TURNS = np.array([1.0, -1j, -1.0, 1j])  # powers of -i

Coefficients = Float64[np.ndarray, " power"]  # of powers of 1/z, lowest first


class Quotient(NamedTuple):
    """A filter: a numerator over a product of short denominators."""

    above: Coefficients
    below: tuple[Coefficients, ...]

    def over(self, theta: LinearModel) -> Moving:
        """The filter over boxes of the angle."""
        value = _over(self.above, theta)
        for side in self.below:
            value = value * _over(side, theta).reciprocal()
        return value


@lru_cache(maxsize=32)
def quotients(filters: Filters) -> tuple[Quotient, Quotient]:
    """Return P and T V of filters in units of one sample."""
    velocity, position = filters
    return _quotient(position, is_velocity=False), _quotient(velocity.filter, is_velocity=True)


def _quotient(chain: Filter, *, is_velocity: bool) -> Quotient:
    """A chain of filters, that of a velocity behind 1 - 1/z."""
    above, _ = exact_chain(chain.per_sample(1.0).sections)
    if is_velocity:
        above -= above.left_shift(1)
    below = [np.array(side) for _, side in chain.stages() if len(side) > 1]
    return Quotient(rounded(above), tuple(below))


def _over(c: Coefficients, theta: LinearModel) -> Moving:
    """A polynomial in 1/z over boxes of the angle."""
    order = np.arange(c.size, dtype=float)
    powers = c * order ** np.arange(5.0)[:, None]
    derivatives = powers[:4] * _TURNS[:, None]
    value, slope, bend, third = derivatives @ np.exp(-1j * np.multiply.outer(order, theta.centre))
    sizes = np.abs(powers)
    # Of coefficients, angles, exponentials and the sum, for the value and each derivative.
    rounding = EPS * (sizes @ (c.size + 8.0 + 8.0 * order))
    bounds = sizes.sum(axis=1)

    def model(k: int, own: np.ndarray, first: np.ndarray, second: np.ndarray) -> LinearModel:
        swing, rest = theta.swing, theta.rest
        bent = np.minimum(np.abs(second) + rounding[k + 2] + swing * bounds[k + 3], bounds[k + 2])
        left = 0.5 * bent * swing**2 + np.abs(first) * rest + rounding[k] + swing * rounding[k + 1]
        return LinearModel(own, first * theta.slope, left * RAISED_MANY)

    return Moving(model(0, value, slope, bend), model(1, slope, bend, third))


# Boxes, and the models of what is an axis.


@dataclass(frozen=True)
class ParameterBoxes:
    """Boxes along named axes; ``index`` is, for example, the number of the wall or cell of each."""

    axes: tuple[str, ...]
    center: Rows
    half: Rows
    index: Int64[np.ndarray, " box"]

    @classmethod
    def between(cls, index: Int64[np.ndarray, " box"], **ends: tuple[Any, Any]) -> "ParameterBoxes":
        """One box for each index, from the ends along each named axis.

        Numbers that are the same at both ends are no axes; arrays are, whatever they hold.
        """
        axes = {
            name: (low, high)
            for name, (low, high) in ends.items()
            if np.ndim(low) or np.ndim(high) or low < high
        }
        low, high = (
            np.stack([np.broadcast_to(np.float64(pair[k]), index.shape) for pair in axes.values()])
            for k in (0, 1)
        )
        half = 0.5 * (high - low)
        return cls(tuple(axes), low + half, half, index)

    def ends(self, name: str) -> tuple[Row, Row]:
        """The middles and the half-widths along an axis."""
        row = self.axes.index(name)
        return self.center[row], self.half[row]

    def middles(self, name: str, low: float, high: float) -> Row:
        """The middles of a quantity between two ends, also of one that is no axis."""
        if name in self.axes:
            return np.clip(self.ends(name)[0], low, high)
        return np.full(self.index.size, low)

    def select(self, chosen: Any) -> "ParameterBoxes":
        """Chosen boxes: an index of numbers, of truth values, or a slice."""
        parts = self.center[:, chosen], self.half[:, chosen], self.index[chosen]
        return ParameterBoxes(self.axes, *parts)

    def halved(self, axis: Int64[np.ndarray, " box"]) -> "ParameterBoxes":
        """The halves of each box along one of its axes, given by number."""
        boxes = np.arange(self.index.size)
        half, shift = self.half.copy(), np.zeros_like(self.half)
        half[axis, boxes] *= 0.5
        shift[axis, boxes] = half[axis, boxes]
        sides = [replace(self, center=self.center + side, half=half) for side in (-shift, shift)]
        return joined(sides)

    def along(self, name: str, unit: float = 1.0, start: float = 0.0) -> LinearModel:
        """A quantity that is an axis, counted from a start in steps of a unit."""
        center, half = self.ends(name)
        middle = start + center * unit
        exact = variable(self.axes.index(name), len(self.axes), middle, half * unit * RAISED_MUCH)
        return replace(exact, rest=PARAMETER * (np.abs(middle) + abs(start)))

    def constant(self, value: Any) -> LinearModel:
        """A number, or one for each box, that was converted between units."""
        centre = np.broadcast_to(np.asarray(value), self.index.shape)
        slope = np.zeros((len(self.axes), centre.size))
        return LinearModel(centre, slope, PARAMETER * np.abs(centre))

    def quantity(self, name: str, value: float, unit: float = 1.0) -> LinearModel:
        """A quantity in units of the plant: along its axis, or the number that it always is."""
        return self.along(name, unit) if name in self.axes else self.constant(value * unit)


def joined(parts: Sequence[ParameterBoxes]) -> ParameterBoxes:
    """The boxes of one, then of the next, all with the same axes."""
    columns = zip(*((boxes.center, boxes.half, boxes.index) for boxes in parts), strict=True)
    return ParameterBoxes(parts[0].axes, *(np.concatenate(column, axis=-1) for column in columns))
