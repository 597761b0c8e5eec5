"""Bracketed roots of many smooth functions of one angle at once, to full precision.

They are found by the secant method within brackets, all lanes in step. NumPy only.
"""

from collections.abc import Callable

import numpy as np

from jaxstab.arrays import Array
from jaxstab.rounding import UNIT


def nonzero(divisor: Array, instead: float) -> Array:
    """Return a divisor without zeros: 1 or infinity in their place keeps quotients finite."""
    return np.where(divisor == 0.0, instead, divisor)


def bracketed_root(
    function: Callable[[Array], Array],
    lower: Array,
    upper: Array,
    ends: tuple[Array, Array] | None = None,
) -> Array:
    """Return a root of an elementwise function between two angles at which its signs differ.

    It is the secant method, with a bisection wherever that would leave the bracket or crawl. Where
    the signs at the ends agree, the result is the end of the smaller value. ``ends`` are the values
    at the ends, if they are known.

    Source: the safeguards of Press et al., Numerical Recipes, 9.4.
    """
    steps = 60  # bisection alone would take 53 from any bracket of like ends
    still = 4.0 * UNIT
    enough = 1e-10  # of a step of the secant method: what is left after it is below rounding
    if not lower.size:
        return lower
    at_lower, at_upper = ends or (function(lower), function(upper))
    sign = np.sign(at_upper)
    rise = at_upper - at_lower
    product = at_lower * at_upper
    share = np.where(product < 0.0, -at_lower / nonzero(rise, 1.0), 0.5)
    is_lower_nearer = abs(at_lower) < abs(at_upper)
    last = np.where(is_lower_nearer, lower, upper)
    at_last = np.where(is_lower_nearer, at_lower, at_upper)
    has_root = product <= 0.0
    x: Array = np.where(has_root, lower + share * (upper - lower), last)
    low: Array = lower
    high: Array = upper
    moving = has_root & (lower < upper)
    for _ in range(steps):
        if not np.any(moving):
            break
        value = function(x)
        above = value * sign > 0.0
        low, high = np.where(above, low, x), np.where(above, x, high)
        following = x - value * (x - last) / (value - at_last)  # NaN or infinite: bisected
        step = abs(following - x)
        inside = (following > low) & (following < high)
        done = (step <= enough * abs(x)) | (value == 0.0) | (high - low <= still * high)
        usable = (done & np.isfinite(following)) | (inside & (2.0 * step < abs(x - last)))
        following = np.where(usable, np.clip(following, low, high), 0.5 * (low + high))
        following = np.where(moving & (value != 0.0), following, x)
        x, last, at_last, moving = following, x, value, moving & ~done
    return x
