"""The first root on the unit circle along straight lines through the space of loops, bracketed.

The search keeps boxes of (t, theta), with t from 0 at the start of a line to 1 at its end. Boxes in
which g has no zero are dropped (lemma B3 of docs/proofs.md); the others are shrunk to where both
real parts of g can vanish (lemma B4), and halved if that shrinks them little. Shrinking squares the
width, so a few rounds lead from a coarse grid to the last digits.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from jaxstab.boxes.circle import QuickPlant, accurate_plant, quick_plant
from jaxstab.boxes.exclusion import Loops, expansion, is_free
from jaxstab.model.filters import Filters

Ends = Float64[np.ndarray, "2 box"]

_MOST = 100_000  # boxes at once
_NARROW = 1e-12  # of the way from the start: a root bracketed like this is found
_FINEST = np.array([[2.0**-48], [2.0**-30]])  # of t and theta: boxes are not halved beyond
_EPS = np.finfo(np.float64).eps
_PROGRESS = 0.6  # a box shrunk to less than this along t or theta is not halved


class Lines(NamedTuple):
    """Where lines start and how far they go: the five parameters, a line in each column."""

    start: Float64[np.ndarray, "5 line"]
    change: Float64[np.ndarray, "5 line"]


class Parts(NamedTuple):
    """Boxes of (t, theta): the number of the line, and the ends of both."""

    line: Int64[np.ndarray, " box"]
    low: Ends
    high: Ends

    def some(self, which: Bool[np.ndarray, " box"]) -> "Parts":
        """Return some of them."""
        return Parts(self.line[which], self.low[:, which], self.high[:, which])


class FirstRoots(NamedTuple):
    """For each line: no root is on the circle before ``low``, and one is proved before ``high``.

    Both are parts of the line. ``low`` is infinite where all boxes are free of roots, ``high``
    where no root is proved; ``theta`` is an angle next to ``low``.
    """

    low: Float64[np.ndarray, " line"]
    high: Float64[np.ndarray, " line"]
    theta: Float64[np.ndarray, " line"]


class Models(NamedTuple):
    """g over boxes: the value in the middle, the moves to the ends of each axis, the rest."""

    value: np.ndarray
    moves: np.ndarray  # (2, box)
    rest: np.ndarray
    bends: np.ndarray  # (2, box): how much each axis moves g, and its rest
    rounding: np.ndarray

    def some(self, which: Bool[np.ndarray, " box"]) -> "Models":
        """Return some of them."""
        return Models(*(part[..., which] for part in self))


def first_roots(lines: Lines, parts: Parts, filters: Filters | None = None) -> FirstRoots:
    """Return where, within some boxes of lines, a root is on the unit circle for the first time.

    ``filters`` are the velocity estimator and the position filter, in units of one sample.
    """
    with np.errstate(all="ignore"):
        plants = accurate_plant(*lines.start[2:])
    return search(lines.start.shape[1], parts, lambda some: _models(lines, plants, some, filters))


def search(count: int, parts: Parts, models_of: Callable[[Parts], Models]) -> FirstRoots:
    """Return the first roots on some lines, by models of g over boxes."""
    found = FirstRoots(*(np.full(count, end) for end in (np.inf, np.inf, np.nan)))
    with np.errstate(all="ignore"):
        while parts.line.size:
            models = models_of(parts)
            is_open = ~is_free(*models[:3])
            parts, models = parts.some(is_open), models.some(is_open)
            shrunk, is_proved = _shrunk(parts, models)
            np.minimum.at(found.high, shrunk.line[is_proved], shrunk.high[0, is_proved])
            is_open = np.all(shrunk.low <= shrunk.high, axis=0)
            is_open &= shrunk.low[0] <= found.high[shrunk.line]
            size, before = shrunk.high - shrunk.low, parts.high - parts.low
            has_shrunk = np.any(size < _PROGRESS * before, axis=0)
            is_narrow = size[0] <= _NARROW * shrunk.high[0]
            is_rounded = models.rest <= 2.0 * models.rounding
            is_flat = np.sum(np.abs(models.moves), axis=0) <= 4.0 * models.rest
            is_done = is_proved & is_narrow | is_rounded & (is_proved | is_flat)
            is_done |= np.all(size <= _FINEST, axis=0)
            is_done |= np.sum(is_open) > _MOST
            _keep(found, shrunk.some(is_open & is_done))
            is_open &= ~is_done
            bends = np.where(size > _FINEST, models.bends * (size / before), -1.0)
            parts = _joined(
                shrunk.some(is_open & has_shrunk),
                _halved(shrunk.some(is_open & ~has_shrunk), bends[:, is_open & ~has_shrunk]),
            )
    return found


def _models(lines: Lines, plants: QuickPlant, parts: Parts, filters: Filters | None) -> Models:
    t, theta = 0.5 * (parts.low + parts.high)
    half = 0.5 * (parts.high - parts.low) * (1.0 + 4.0 * _EPS)
    change = lines.change[:, parts.line]
    middle = lines.start[:, parts.line] + change * t
    center = Loops(*np.concatenate([middle, theta[None]]))
    moved = np.abs(change) * half[0]
    plant = QuickPlant(*(part[parts.line] for part in plants))
    is_other = np.any(change[2:] != 0.0, axis=0)
    if np.any(is_other):
        others = quick_plant(*(np.maximum(value[is_other], 0.0) for value in center[2:5]))
        for part, other in zip(plant, others, strict=True):
            part[is_other] = other
    g = expansion(center, Loops(*np.concatenate([moved, half[1:]])), plant, filters)
    moves = np.stack([np.sum(g.linear[:5] * change, axis=0), g.linear[5]]) * half
    bends = np.stack([np.sum(g.rest_slopes[:5] * moved, axis=0), g.rest_slopes[5] * half[1]])
    return Models(g.value, moves, g.rest, bends + np.abs(moves), g.rounding)


def _shrunk(parts: Parts, models: Models) -> tuple[Parts, Bool[np.ndarray, " box"]]:
    """Shrink boxes to where g can vanish, and say which of them are proved to hold a zero."""
    value, (by_t, by_theta), rest, *_ = models
    determinant = _turned(by_t, by_theta)
    is_regular = determinant != 0.0
    determinant = np.where(is_regular, determinant, 1.0)
    middle = np.stack([_turned(by_theta, value), -_turned(by_t, value)]) / determinant
    spread = np.stack([np.abs(by_theta), np.abs(by_t)]) * (rest / np.abs(determinant))
    spread = np.where(is_regular, spread, np.inf) * (1.0 + 64.0 * _EPS)
    spread += 64.0 * _EPS * np.abs(middle)
    # In units of the half-widths
    low, high = middle - spread, middle + spread
    is_proved = np.all((low > -1.0) & (high < 1.0), axis=0)
    center, half = 0.5 * (parts.low + parts.high), 0.5 * (parts.high - parts.low)
    slack = 2.0 * _EPS * np.abs(center)
    low = np.where(low > -1.0, center + half * low - slack, parts.low)
    high = np.where(high < 1.0, center + half * high + slack, parts.high)
    return Parts(parts.line, np.maximum(low, parts.low), np.minimum(high, parts.high)), is_proved


def _turned(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the imaginary part of conj(one) other."""
    part: np.ndarray = one.real * other.imag - one.imag * other.real
    return part


def _keep(found: FirstRoots, done: Parts) -> None:
    """Note the first of the boxes that are left of each line."""
    order = np.argsort(-done.low[0], kind="stable")  # the first one is written last
    line, low = done.line[order], done.low[0, order]
    theta = 0.5 * (done.low[1] + done.high[1])[order]
    is_first = low < found.low[line]
    found.low[line[is_first]] = low[is_first]
    found.theta[line[is_first]] = theta[is_first]


def _halved(parts: Parts, bends: np.ndarray) -> Parts:
    """Halve boxes along the axis that moves g most."""
    axis, box = np.argmax(bends, axis=0), np.arange(parts.line.size)
    middle = 0.5 * (parts.low[axis, box] + parts.high[axis, box])
    low, high = parts.low.copy(), parts.high.copy()
    low[axis, box] = high[axis, box] = middle
    return _joined(Parts(parts.line, parts.low, high), Parts(parts.line, low, parts.high))


def _joined(one: Parts, other: Parts) -> Parts:
    return Parts(
        np.concatenate([one.line, other.line]),
        np.concatenate([one.low, other.low], axis=1),
        np.concatenate([one.high, other.high], axis=1),
    )
