"""What the limits of a column say about an alpha, and which of the two says it. NumPy alone."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.format.schema import LIMIT_TERMS
from jaxstab.atlas.read.parts import in_parts
from jaxstab.conventions import UNDECIDED

Floats = NDArray[np.float64]
Codes = NDArray[np.int8]
Mask = NDArray[np.bool_]

ignoring = np.errstate(over="ignore", invalid="ignore")  # infinite limits may have infinite errors
_ROUNDING = 1e-6  # of what is added up: far more than is lost, also where cells begin


def surface(terms: Any, beta: Any, gamma: Any, delta: Any, delay: Any) -> Any:
    """Return a limit by its terms; numbers or arrays."""
    c, per_beta, per_gamma, per_delta, per_delay, bend, by_beta, by_gamma, by_delta, _ = terms
    rate = per_delay + bend * delay + by_beta * beta + by_gamma * gamma + by_delta * delta
    return c + per_beta * beta + per_gamma * gamma + per_delta * delta + rate * delay


def surfaces(columns: NDArray[np.float32], *point: Floats) -> Sequence[Floats]:
    """Return the lower limit, its error, the upper and its error, of columns (20, point)."""
    terms = columns.astype(np.float64, order="C")  # at once: many times faster than in each product
    lower, upper = terms[:LIMIT_TERMS], terms[LIMIT_TERMS:]
    return surface(lower, *point), lower[-1], surface(upper, *point), upper[-1]


@ignoring
def codes_by_limits(
    alpha: Floats, lower: Floats, lower_error: Floats, upper: Floats, upper_error: Floats
) -> Codes:
    """Return the verdicts on alphas."""
    is_unstable = (alpha < lower - lower_error) | (alpha > upper + upper_error)
    is_stable = (alpha > lower + lower_error) & (alpha < upper - upper_error)
    return _codes(is_unstable | is_stable, is_stable)


@ignoring
def codes_by_one(
    alpha: Floats, is_upper: Mask, terms: NDArray[np.float32], *point: Floats
) -> Codes:
    """Return the verdicts on alphas that one limit decides, by its terms (10, point)."""
    of_limit = terms.astype(np.float64, order="C")
    limit, error = surface(of_limit, *point), of_limit[-1]
    is_below = alpha < limit - error
    is_decided = is_below | (alpha > limit + error)
    return _codes(is_decided, is_decided & (is_below == is_upper))


def _codes(is_decided: Mask, is_stable: Mask) -> Codes:
    """Return UNDECIDED, UNSTABLE or STABLE: codes that follow each other downwards."""
    codes: Codes = np.int8(UNDECIDED) - is_decided.view(np.int8)
    codes -= is_stable.view(np.int8)
    return codes


def deciding_alphas(
    columns: NDArray[np.float32], middles: Sequence[Floats], halves: Sequence[Floats]
) -> Floats:
    """Return above which alpha, and below which one, one limit decides, in columns (column, 2).

    Above the first, which is above all that the lower limit leaves open in the column, that is the
    upper limit; below the second, which is below all that the upper one leaves open, the lower. Of
    a column without a stable alpha the lower limit says so: there it is infinite.

    Args:
        columns: (column, 20), those of a grid of cells of beta, gamma, delta and delay.
        middles: of the cells along the four, broadcast to the grid.
        halves: half of the widths of the cells, likewise.
    """
    shape = np.broadcast_shapes(*(middle.shape for middle in middles))
    numbers = np.arange(len(columns), dtype=np.float64).reshape(shape)
    found = in_parts(partial(_deciding, columns), [numbers, *middles, *halves], float, float)
    return np.stack(found, axis=-1).reshape(-1, 2)


@ignoring
def _deciding(
    columns: NDArray[np.float32], numbers: Floats, *boxes: Floats
) -> tuple[Floats, Floats]:
    terms = columns.take(numbers.astype(np.intp), axis=0).T.astype(np.float64, order="C")
    lower, upper = terms[:LIMIT_TERMS], terms[LIMIT_TERMS:]
    (lowest, reach), (highest, room) = (_range(of_limit, *boxes) for of_limit in (lower, upper))
    is_empty = lower[0] - lower[-1] == np.inf
    return lowest + reach, np.where(is_empty, np.inf, highest - room)


def _range(terms: Floats, *boxes: Floats) -> tuple[Floats, Floats]:
    """Return a limit at the middle of its column, and how far it and its error reach from there."""
    beta, gamma, delta, delay, *halves = boxes
    _, per_beta, per_gamma, per_delta, per_delay, bend, *mixed, error = terms
    by_beta, by_gamma, by_delta = mixed
    slopes = (
        per_beta + by_beta * delay,
        per_gamma + by_gamma * delay,
        per_delta + by_delta * delay,
        per_delay + 2.0 * bend * delay + by_beta * beta + by_gamma * gamma + by_delta * delta,
    )
    half_delay = halves[-1]
    bends = zip((*mixed, bend), halves, strict=True)
    reach = error + half_delay * sum(np.abs(term) * half for term, half in bends)
    reach += sum(np.abs(slope) * half for slope, half in zip(slopes, halves, strict=True))
    farthest = (np.abs(middle) + half for middle, half in zip(boxes[:4], halves, strict=True))
    return surface(terms, *boxes[:4]), reach + _ROUNDING * surface(np.abs(terms), *farthest)
