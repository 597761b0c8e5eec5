"""The boundary over whole boxes of hands, enclosed: where roots can lie on the unit circle.

The closed form (``curve``) in linear models of theta, gamma and delta gives patches of the curve
with a proved error. Patches that meet a domain of (alpha, beta) are halved in theta until they are
short. With h = 1 - cos(theta) and the line of a root at 1 written out by hand,

    alpha = -gamma + h lift,

so that curve and line stay apart wherever h does.
"""

from math import pi
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from jaxstab.boxes.models import LinearModel, Moving
from jaxstab.boxes.plant import HandBoxes, PlantModels, plant_models

_ROUNDING = 16 * np.finfo(np.float64).eps  # more than cosines have
_FIRST_PATCHES = 64
_PER_TURN = 8  # of z^(delay + 1)
_MOST_HALVINGS = 10
_TOLERATED = 8.0  # widths of what is not known of a patch, if halving it helps
_HELPS = 0.5  # times what was not known of the whole

Patch = Float64[np.ndarray, " patch"]
Box = Int64[np.ndarray, " patch"]


class Domain(NamedTuple):
    """The lowest and the highest gains that matter."""

    alpha: tuple[float, float]
    beta: tuple[float, float]


class Patches(NamedTuple):
    """Parts of the curve over boxes of hands, in the order of the boxes and then of theta.

    Linear models in (theta, gamma, delta); where their rest is infinite the curve may be anywhere.
    """

    box: Box
    first: Patch  # theta
    last: Patch
    alpha: LinearModel
    beta: LinearModel
    may_turn: Bool[np.ndarray, " patch"]  # for one hand, beta is not proved monotonic in theta


def curve_patches(
    hands: HandBoxes, delay: float, domain: Domain, width: tuple[float, float]
) -> Patches:
    """Enclose the curve of a pair of roots on the unit circle where it may meet a domain.

    Below alpha = -gamma it is left out: there p(1) < 0, so that one real root is outside always.

    Args:
        hands: boxes of gamma in [0, 1e4] and delta in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples.
        domain: of the gains.
        width: patches are halved until theta moves alpha and beta no farther.
    """
    plant = plant_models(hands, delay)
    turns = int(np.floor(delay)) + 1
    count = max(_FIRST_PATCHES, _PER_TURN * turns)
    angles = pi * (np.arange(count + 1) / count) ** 1.5
    boxes = np.arange(hands.gamma.size)
    intervals = _Intervals(
        np.repeat(boxes, count), np.tile(angles[:-1], boxes.size), np.tile(angles[1:], boxes.size)
    )
    short = []
    rests = np.full((2, intervals.box.size), np.inf)  # of what the intervals are halves of
    for halving in range(_MOST_HALVINGS + 1):
        curve = _curve(plant, turns, intervals)
        is_short = curve.is_short(width, rests) | (halving == _MOST_HALVINGS)
        is_inside = ~curve.is_outside(domain)
        short.append(intervals.some(is_inside & is_short))
        intervals = intervals.some(is_inside & ~is_short).halves()
        rests = np.tile(curve.rests[:, is_inside & ~is_short], 2)
    parts = _Intervals(*map(np.concatenate, zip(*short, strict=True)))
    parts = parts.some(np.lexsort((parts.first, parts.box)))
    curve = _curve(plant, turns, parts)
    rate = curve.beta.rate
    may_turn = ~((rate.low > 0.0) | (rate.high < 0.0))
    return Patches(*parts, curve.alpha.value, curve.beta.value, may_turn)


def minus_line_models(hands: HandBoxes, delay: float) -> tuple[LinearModel, LinearModel]:
    """Enclose value and weight of the line of a root at -1: weight (alpha + 2 beta) = value."""
    plant = plant_models(hands, delay)
    sign = -1.0 if int(np.floor(delay)) % 2 == 0 else 1.0
    return (1.0 - plant.d1 + plant.d0) * -sign, plant.difference


class _Intervals(NamedTuple):
    """Intervals of theta, each for a box of hands."""

    box: Box
    first: Patch
    last: Patch

    def some(self, which: Bool[np.ndarray, " patch"] | Box) -> "_Intervals":
        return _Intervals(self.box[which], self.first[which], self.last[which])

    def halves(self) -> "_Intervals":
        middle = 0.5 * (self.first + self.last)
        return _Intervals(
            np.tile(self.box, 2),
            np.concatenate([self.first, middle]),
            np.concatenate([middle, self.last]),
        )


class _Curve(NamedTuple):
    """alpha and beta of patches, and square beta, where square = |N|^2 may vanish."""

    alpha: Moving
    beta: Moving
    square_beta: Moving
    square: Moving
    lift: Moving

    @property
    def rests(self) -> Float64[np.ndarray, "2 patch"]:
        """What is not known of alpha and beta."""
        return np.stack([self.alpha.value.rest, self.beta.value.rest])

    def is_short(
        self, width: tuple[float, float], before: Float64[np.ndarray, "2 patch"]
    ) -> Bool[np.ndarray, " patch"]:
        """Say which patches theta moves no farther than a width, or than what is not known.

        Where that is much, it is more than half of what was not known ``before`` the last halving.
        """
        short = np.ones(self.lift.value.rest.shape, bool)
        for gain, wanted, former in zip(
            (self.alpha.value, self.beta.value), width, before, strict=True
        ):
            moves = 2.0 * np.abs(gain.slope[0]) * gain.half[0]
            short &= (moves <= np.maximum(wanted, gain.rest)) & np.isfinite(gain.rest)
            short &= (gain.rest <= _TOLERATED * wanted) | (gain.rest > _HELPS * former)
        return short

    def is_outside(self, domain: Domain) -> Bool[np.ndarray, " patch"]:
        """Say which patches lie wholly outside, or below alpha = -gamma."""
        ends = [np.outer([0.0, 1.0], self.square.value.high) * end for end in domain.beta]
        outside: np.ndarray = (
            self.alpha.value.is_off(*domain.alpha)
            | self.beta.value.is_off(*domain.beta)
            | self.square_beta.value.is_off(ends[0].min(axis=0), ends[1].max(axis=0))
            | (self.lift.value.high < 0.0)
        )
        return outside


def _curve(plant: PlantModels, turns: int, intervals: _Intervals) -> _Curve:
    """Evaluate the closed form, as in ``jaxstab.region.curve`` for radius 1."""
    first, last = intervals.first, intervals.last
    theta, half_theta = 0.5 * (first + last), 0.5 * (last - first) * (1.0 + _ROUNDING)
    plant = plant.some(intervals.box).beside(half_theta[None])
    waves = _waves(theta, turns, plant.gamma.half)
    h, rest = waves.h, 2.0 - waves.h

    kappa, eps = plant.d0 + 1.0, 1.0 - plant.d0
    sigma, nu = plant.n2 + plant.n0, plant.n2 - plant.n0
    d, q = h * -kappa + plant.gamma * plant.sum, h * -sigma + plant.sum
    sine_square = h * rest
    real, slope = d * q + sine_square * (eps * nu), q * eps - d * nu
    square = q * q + sine_square * (nu * nu)
    over_square = square.reciprocal()
    square_beta = -(waves.sine_ratio * real + waves.cos_turns * slope)
    beta = square_beta * over_square
    lift = over_square * (
        q * (kappa - plant.gamma * sigma)
        + rest * (waves.sine_ratio * slope + nu * (plant.gamma * nu - eps))
        + waves.lag_ratio * real
    )
    lift = lift - beta
    return _Curve(h * lift - plant.gamma, beta, square_beta, square, lift)


class _Waves(NamedTuple):
    """Functions of theta alone, for m turns of z^m."""

    h: Moving  # 1 - cos(theta)
    cos_turns: Moving  # cos(m theta)
    sine_ratio: Moving  # sin(m theta) / sin(theta)
    lag_ratio: Moving  # (1 - cos(m theta)) / (1 - cos(theta))


def _waves(theta: Patch, turns: int, half: Float64[np.ndarray, "3 patch"]) -> _Waves:
    lag = np.arange(turns)
    sines = np.arange(turns - 1, -turns, -2)
    sine = np.sin(theta)
    return _Waves(
        Moving(
            _of_theta(2.0 * np.sin(0.5 * theta) ** 2, sine, 1.0, 1.0, half),
            _of_theta(sine, np.cos(theta), 1.0, 1.0, half),
        ),
        _cosines(theta, np.array([turns]), np.array([1]), half),
        _cosines(theta, sines, np.ones_like(sines), half),
        _cosines(theta, lag, np.where(lag > 0, 2, 1) * (turns - lag), half),
    )


def _cosines(
    theta: Patch,
    order: Int64[np.ndarray, " term"],
    weight: Int64[np.ndarray, " term"],
    half: Float64[np.ndarray, "3 patch"],
) -> Moving:
    """Return the sum of weight cos(order theta)."""
    phase, factor = np.multiply.outer(theta, order), weight.astype(float)
    cosine, sine = np.cos(phase), np.sin(phase)
    value, slope, bend = cosine @ factor, sine @ (factor * order), cosine @ (factor * order**2)
    bends = [float(np.sum(np.abs(factor) * np.abs(order) ** k)) for k in range(4)]
    lost = pi * (bends[0] + bends[1] + bends[2])
    return Moving(
        _of_theta(value, -slope, bends[2], lost, half),
        _of_theta(-slope, -bend, bends[3], lost, half),
    )


def _of_theta(
    value: Patch, slope: Patch, bend: float, size: float, half: Float64[np.ndarray, "3 patch"]
) -> LinearModel:
    """Return the model of a function of theta alone, from a bound of its second derivative."""
    still = np.zeros_like(value)
    rest = 0.5 * bend * half[0] ** 2 + _ROUNDING * size
    return LinearModel(value, np.stack([slope, still, still]), rest, half)
