"""The boundary over boxes of (gamma, delta), enclosed: where roots can lie on the unit circle.

The closed form (``region.closed_form``), evaluated in linear models of theta, gamma, delta and
perhaps the delay, gives patches of the curve with a proved error: as N alpha + N (1 - 1/z) beta =
-z^m D on the circle is two real equations, alpha and beta are quotients of real functions over
|N|^2. With h = 1 - cos(theta) and the line of a root at 1 written explicitly,

    alpha = -gamma + h lift,

so that curve and line stay apart wherever h does. With filters alpha and beta are a linear map of
those without, whose determinant takes part in the divisor (lemma B12 of docs/proofs.md).

Patches start at equal steps, finer next to theta = 0, and are halved until theta moves them by less
than a width, or until halving no longer helps. A patch is dropped when it is proved to be outside
of the domain of gains: by its own bounds; by those of the gains times the divisor, which may
vanish; by the line of a root at 1; or because |alpha P N| + |beta V N| < |D|, so that no wall of
the domain can hold a root. What is dropped holds no wall of the domain with a root at these angles.
"""

from collections.abc import Callable
from functools import partial
from math import pi
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Bool, Float64, Int64

from jaxstab.arrays import take
from jaxstab.boxes.enclosures import LinearModel, Moving
from jaxstab.model.filters import Filters
from jaxstab.proofs.filters import (
    filter_cells,
    filter_ends,
    filter_models,
    largest_within,
    responses,
)
from jaxstab.proofs.plant import CurveParts, HandBoxes, plant_models
from jaxstab.rounding import COSINES

# Intervals of theta, each for a box of hands, and parts of them.

Patch = Float64[np.ndarray, " patch"]

Box = Int64[np.ndarray, " patch"]


class Intervals(NamedTuple):
    """Intervals of theta, each for a box of hands."""

    box: Box
    start: Patch
    end: Patch

    def parts(self, halvings: Box) -> tuple[Box, "Intervals"]:
        """Equal parts of intervals after their halvings (none for 0), and the interval of each."""
        count = np.where(halvings > 0, 1 << halvings, 0)
        owner = np.repeat(np.arange(count.size), count)
        index = np.arange(owner.size) - np.repeat(np.cumsum(count) - count, count)
        whole, counts = take(self, owner), count[owner]

        def edge(index: Box) -> Patch:  # neighbours have the same one
            inside = whole.start + (whole.end - whole.start) * (index / counts)
            return np.where(index == counts, whole.end, inside)

        return owner, Intervals(whole.box, edge(index), edge(index + 1))


_FIRST_PATCHES = 64
_PER_TURN = 8  # of z^(delay + 1)
_MOST_HALVINGS = 10
_AT_ONCE = 4  # of them: parts that are outside are dropped before they are halved on
_BLOCK = 2**13  # intervals whose models are in memory at once
_TOLERATED = 8.0  # times the width: patches with a larger rest are halved, if that helps
_CLEAR = 0.25  # of the divisor of the gains: if its swing is larger, a pole may be near
_HELPS = 0.5  # of the rest before the last halvings: a larger one shows that they did not help

Model = TypeVar("Model", LinearModel, Moving)


class Domain(NamedTuple):
    """The lowest and the highest gains that matter."""

    alpha: tuple[float, float]
    beta: tuple[float, float]


class Patches(NamedTuple):
    """Parts of the curve over boxes of (gamma, delta), in the order of the boxes and then of theta.

    They are linear models in theta and the variables of the plant; where their rest is infinite,
    the curve may be anywhere.
    """

    box: Box
    start: Patch  # of theta
    end: Patch
    alpha: LinearModel
    beta: LinearModel
    may_turn: Bool[np.ndarray, " patch"]  # for one hand, beta is not proved monotonic in theta

    def take(self, which: Bool[np.ndarray, " patch"] | Int64[np.ndarray, " chosen"]) -> "Patches":
        """Return chosen patches."""
        box, start, end, may_turn = (
            values[which] for values in (self.box, self.start, self.end, self.may_turn)
        )
        return Patches(box, start, end, self.alpha.take(which), self.beta.take(which), may_turn)

    @staticmethod
    def joined(parts: "list[Patches]") -> "Patches":
        """Return all patches of some lists, in order."""
        *intervals, alphas, betas, may_turn = zip(*parts, strict=True)
        box, start, end = map(np.concatenate, intervals)
        alpha, beta = (LinearModel.joined(list(models)) for models in (alphas, betas))
        every = Patches(box, start, end, alpha, beta, np.concatenate(may_turn))
        return every.take(np.lexsort((start, box)))


def curve_patches(
    hands: HandBoxes,
    delay: float,
    domain: Domain,
    width: tuple[float, float],
    filters: Filters | None = None,
    half_delay: float = 0.0,
) -> Patches:
    """Enclose the curve of a pair of roots on the unit circle where it may meet a domain of gains.

    It is left out beyond the line of a root at 1: p(1) < 0 there, so a real root is always outside.
    Patches are halved until theta moves alpha and beta by no more than ``width``. ``half_delay`` is
    the largest distance of the delay from this one, between whole samples.
    """
    parts = CurveParts.from_plant(plant_models(hands, delay, half_delay))
    turns = int(np.floor(delay)) + 1
    count = max(_FIRST_PATCHES, _PER_TURN * (turns + _order_of(filters)))
    angles = pi * (np.arange(count + 1) / count) ** 1.5
    boxes = np.arange(hands.gamma.size)
    intervals = Intervals(
        np.repeat(boxes, count), np.tile(angles[:-1], boxes.size), np.tile(angles[1:], boxes.size)
    )
    curve_of = partial(_curve, parts, turns, filters)
    remaining = np.full(intervals.box.size, _MOST_HALVINGS)
    rests = np.full((2, intervals.box.size), np.inf)  # of what the intervals are parts of
    patches: list[Patches] = []
    while intervals.box.size or not patches:
        halvings = np.zeros_like(remaining)
        for start in range(0, max(intervals.box.size, 1), _BLOCK):
            block = slice(start, start + _BLOCK)
            chunk = take(intervals, block)
            curve = curve_of(chunk)
            most = np.minimum(remaining[block], _AT_ONCE)
            wanted = np.minimum(curve.halvings(width, rests[:, block]), most)
            is_inside = ~curve.is_outside(domain)
            patches.append(curve.patches(chunk).take(is_inside & (wanted == 0)))
            halvings[block] = np.where(is_inside, wanted, 0)
            rests[:, block] = curve.rests
        whole, intervals = intervals.parts(halvings)
        rests, remaining = rests[:, whole], (remaining - halvings)[whole]
    return _with_unknown_joined(Patches.joined(patches), angles, curve_of)


def _with_unknown_joined(
    patches: Patches,
    angles: Float64[np.ndarray, " angle"],
    curve_of: Callable[["Intervals"], "_Curve"],
) -> Patches:
    """Join neighbours without bounds between two angles: apart they say no more."""
    box, start, end = patches[:3]
    is_known = np.all(np.isfinite([patches.alpha.rest, patches.beta.rest]), axis=0)
    between = np.searchsorted(angles, start, side="right")
    follows = ~(is_known[1:] | is_known[:-1]) & (start[1:] == end[:-1])
    follows &= (box[1:] == box[:-1]) & (between[1:] == between[:-1])
    if not follows.any():
        return patches
    follows_one, has_one_behind = np.append(False, follows), np.append(follows, False)
    begins, ends = has_one_behind & ~follows_one, follows_one & ~has_one_behind
    wide = Intervals(box[begins], start[begins], end[ends])
    alone = patches.take(~(follows_one | has_one_behind))
    return Patches.joined([alone, curve_of(wide).patches(wide)])


def minus_line_models(
    hands: HandBoxes, delay: float, half_delay: float = 0.0
) -> tuple[LinearModel, LinearModel]:
    """Enclose value and weight of the line of a root at -1: weight (alpha + 2 beta) = value.

    With filters it is weight (alpha P(-1) + beta V(-1)) = value.
    """
    plant = plant_models(hands, delay, half_delay)
    sign = -1.0 if int(np.floor(delay)) % 2 == 0 else 1.0
    return (1.0 - plant.d1 + plant.d0) * -sign, plant.difference


def _order_of(filters: Filters | None) -> int:
    """Return the largest order of the filters: samples that they look back, or poles."""
    if filters is None:
        return 0
    return max(filters[0].filter.transfer().order, filters[1].transfer().order)


class _Curve(NamedTuple):
    """alpha and beta of patches, and both times ``square``, which may vanish.

    Without filters the square is |N|^2. ``lift`` is how far alpha is from the line of a root at 1,
    in units of h, to the side where p(1) > 0. ``forces`` bound |P N| and |V N| from above and |D|
    from below: where the walls' force is too small there is no root.
    """

    alpha: LinearModel
    beta: Moving
    square_gains: tuple[LinearModel, ...]  # beta; with filters alpha, too
    square: LinearModel
    lift: LinearModel
    forces: Float64[np.ndarray, "3 patch"]

    @property
    def rests(self) -> Float64[np.ndarray, "2 patch"]:
        """The rests of alpha and beta."""
        return np.stack([self.alpha.rest, self.beta.value.rest])

    def patches(self, intervals: Intervals) -> Patches:
        """Return the patches of the curve over these intervals."""
        rate = self.beta.rate
        may_turn = ~((rate.low > 0.0) | (rate.high < 0.0))
        return Patches(*intervals, self.alpha, self.beta.value, may_turn)

    def halvings(
        self, width: tuple[float, float], before: Float64[np.ndarray, "2 patch"]
    ) -> Float64[np.ndarray, " patch"]:
        """How often to halve patches until theta moves them no farther than it should."""
        # That is a width, or the unknown part of the patch; a large unknown part is halved, too,
        # unless it is more than half of that ``before`` the last halvings.
        most, square = np.zeros(self.lift.rest.shape), self.square
        for gain, wanted, former in zip((self.alpha, self.beta.value), width, before, strict=True):
            moves = 2.0 * np.abs(gain.slope[0]) * gain.half[0]
            is_vain = gain.rest > _HELPS * former
            # Next to a pole halving helps later.
            is_vain &= square.swing < _CLEAR * np.abs(square.centre)
            is_short = (moves <= np.maximum(wanted, gain.rest)) & np.isfinite(gain.rest)
            is_short &= (gain.rest <= _TOLERATED * wanted) | is_vain
            with np.errstate(all="ignore"):
                halvings = np.ceil(np.log2(moves / np.maximum(wanted, gain.rest)))
            most = np.maximum(most, np.where(is_short, 0.0, np.fmax(halvings, 1.0)))
        return most

    def is_outside(self, domain: Domain) -> Bool[np.ndarray, " patch"]:
        """Return which patches lie wholly outside, or beyond the line of a root at 1."""
        outside: np.ndarray = (
            self.alpha.is_off(*domain.alpha)
            | self.beta.value.is_off(*domain.beta)
            | (self.lift.high < 0.0)
        )
        square = np.stack([self.square.low, self.square.high])
        if len(self.square_gains) == 1:  # |N|^2
            square[0] = 0.0
        for gain, limits in zip(self.square_gains, (domain.beta, domain.alpha), strict=False):
            ends = np.stack([square * end for end in limits]).reshape(4, -1)
            outside |= gain.is_off(ends.min(axis=0), ends.max(axis=0))
        by_position, by_velocity, least = self.forces
        most = [np.max(np.abs(limits)) for limits in domain]
        outside |= most[0] * by_position + most[1] * by_velocity < least * (1.0 - COSINES)
        return outside


def _curve(
    of_boxes: CurveParts, turns: int, filters: Filters | None, intervals: Intervals
) -> _Curve:
    """Evaluate the closed form, as in ``jaxstab.region.closed_form`` for radius 1."""
    start, end = intervals.start, intervals.end
    theta, half_theta = 0.5 * (start + end), 0.5 * (end - start) * (1.0 + COSINES)
    plant = of_boxes.over_patches(intervals.box, half_theta)
    waves = _waves(theta, turns, plant.gamma.half)
    eps, nu = plant.eps, plant.nu
    h, mirror_h = waves.h, 2.0 - waves.h  # of theta, and of pi - theta
    d, q = h * -plant.kappa + plant.gamma_sum, h * -plant.sigma + plant.sum
    sine_square = h * mirror_h
    real, slope = d * q + sine_square * plant.eps_nu, q * eps - d * nu
    square = q * q + sine_square * plant.nu_square
    square_beta = -(waves.sine_ratio * real + waves.cos_turns * slope)
    sizes = _least(d.value), np.sin(theta) * _least(eps), np.sqrt(square.value.high)
    forces = _forces(filters, theta, half_theta, sizes)

    moving = q, mirror_h, real, slope, waves.sine_ratio, waves.lag_ratio

    def rise(q: Model, mirror: Model, real: Model, slope: Model, sine: Model, lag: Model) -> Model:
        return q * plant.by_q + mirror * (sine * slope + plant.by_mirror_h) + lag * real

    if filters is not None:
        plain = _Plain(h, plant.gamma, square, square_beta, rise(*moving) - square_beta)
        return _filtered(plain, theta, filters, forces)
    over_square = square.reciprocal()
    beta = square_beta * over_square
    lift = over_square.value * rise(*(model.value for model in moving)) - beta.value
    alpha = h.value * lift - plant.gamma
    return _Curve(alpha, beta, (square_beta.value,), square.value, lift, forces)


class _Plain(NamedTuple):
    """The curve without filters, alpha = h lift - gamma and beta, the last two times |N|^2."""

    h: Moving
    gamma: LinearModel
    square: Moving
    square_beta: Moving
    square_lift: Moving


def _filtered(
    plain: _Plain, theta: Patch, filters: Filters, forces: Float64[np.ndarray, "3 patch"]
) -> _Curve:
    """Return the curve with filters: a linear map of the one without, see lemma B12."""
    h, gamma, square, square_beta, square_lift = plain
    parts = p_rise, p_slope, v_rise, v_slope = filter_models(filters, theta, gamma.half)
    at_one = filter_ends(filters).position_at_one
    p_zero = h * p_rise + at_one
    square_alpha = h * square_lift - square * gamma
    determinant = p_zero * v_slope - h * (p_slope * v_rise)
    both_beta = p_zero * square_beta - p_slope * square_alpha
    both = determinant * square
    over_both = both.reciprocal()
    beta = both_beta * over_both
    values = [p.value for p in (*parts, h, square, square_alpha, square_beta, square_lift)]
    both_alpha, both_lift = _alpha_and_lift(values, gamma, 1.0 / at_one)
    lift = both_lift * over_both.value
    alpha = h.value * lift - gamma * (1.0 / at_one)
    gains = both_beta.value, both_alpha
    return _Curve(alpha, beta, gains, both.value, lift * at_one, forces)


def _alpha_and_lift(
    parts: list[LinearModel], gamma: LinearModel, over_one: float
) -> tuple[LinearModel, LinearModel]:
    """Return alpha and lift of the curve with filters, times the determinant and |N|^2."""
    p_rise, p_slope, v_rise, v_slope, h, square, square_alpha, square_beta, square_lift = parts
    alpha = v_slope * square_alpha - h * (v_rise * square_beta)
    tilt = (v_slope * p_rise - p_slope * v_rise) * (square * gamma)
    return alpha, v_slope * square_lift - v_rise * square_beta + tilt * over_one


def _forces(
    filters: Filters | None, theta: Patch, half: Patch, sizes: tuple[Patch, Patch, Patch]
) -> Float64[np.ndarray, "3 patch"]:
    """Bound |P N| and |V N| from above and |D| from below; ``sizes`` are of D and of N."""
    real, imaginary, numerator = sizes
    if filters is None:  # P = 1 and V = 1 - 1/z
        most = np.stack([np.ones_like(theta), 2.0 * np.sin(0.5 * theta) + half])
    else:
        cells = filter_cells(filters)
        values, _, errors = responses(cells, theta)
        steep = largest_within(cells.steepness, cells, theta, half)
        most = np.abs(values) + errors[:2] + half * steep[:2]
    most = most * (1.0 + COSINES)
    least = np.hypot(real, np.maximum(imaginary - 2.0 * half, 0.0))  # |eps| <= 1
    return np.stack([*(most * numerator), least])


def _least(function: LinearModel) -> Patch:
    """Bound the absolute value of a function from below."""
    least: Patch = np.maximum(np.abs(function.centre) - function.swing, 0.0)
    return least


class _Waves(NamedTuple):
    """Functions of theta alone, for m turns of z^m."""

    h: Moving  # 1 - cos(theta)
    cos_turns: Moving  # cos(m theta)
    sine_ratio: Moving  # sin(m theta) / sin(theta)
    lag_ratio: Moving  # (1 - cos(m theta)) / (1 - cos(theta))


def _waves(theta: Patch, turns: int, half: Float64[np.ndarray, "variable patch"]) -> _Waves:
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
    half: Float64[np.ndarray, "variable patch"],
) -> Moving:
    """Return the sum of weight cos(order theta)."""
    phase, factor = np.multiply.outer(theta, order), weight.astype(float)
    cosine, sine = np.cos(phase), np.sin(phase)
    value, slope, bend = cosine @ factor, sine @ (factor * order), cosine @ (factor * order**2)
    bends = [float(np.sum(np.abs(factor) * np.abs(order) ** k)) for k in range(4)]
    rounding = pi * (bends[0] + bends[1] + bends[2])
    return Moving(
        _of_theta(value, -slope, bends[2], rounding, half),
        _of_theta(-slope, -bend, bends[3], rounding, half),
    )


def _of_theta(
    value: Patch,
    slope: Patch,
    bend: float,
    size: float,
    half: Float64[np.ndarray, "variable patch"],
) -> LinearModel:
    """Return the model of a function of theta alone, from a bound of its second derivative."""
    still = np.zeros_like(half[1:])
    rest = 0.5 * bend * half[0] ** 2 + COSINES * size
    return LinearModel(value, np.concatenate([slope[None], still]), rest, half)
