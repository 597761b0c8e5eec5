"""Slopes and bracketed roots of many smooth functions of one angle at once, to full precision.

Slopes are complex steps in NumPy and forward derivatives in JAX: both are exact to rounding. Roots
are found by the secant method within brackets, all lanes in step; one Newton step at the root,
which is zero in value, carries its derivative in the parameters.
"""

from collections.abc import Callable
from functools import partial
from typing import TypeVar

import numpy as np

from jaxstab.arrays import Array, constant, namespace, repeat_while, stored, tree_map
from jaxstab.rounding import UNIT

Parameters = TypeVar("Parameters")
Values = TypeVar("Values")
_State = tuple[Array, ...]

_STEPS = 60  # bisection alone would take 53 from any bracket of like ends
_STILL = 4.0 * UNIT
_ENOUGH = 1e-10  # of a step of the secant method: what is left after it is below rounding
_COMPLEX_STEP = 2.0**-300  # its square is nothing beside any number


def with_slope(function: Callable[[Array], Values], x: Array) -> tuple[Values, Values]:
    """Return the values of elementwise, analytic functions and their derivatives.

    Source: Squire and Trapp, Using complex variables to estimate derivatives (SIAM Review, 1998).
    """
    if namespace(x) is np:
        moved = function(x + 1j * _COMPLEX_STEP)
        return (
            tree_map(lambda value: value.real, moved),
            tree_map(lambda value: value.imag / _COMPLEX_STEP, moved),
        )
    import jax

    both: tuple[Values, Values] = jax.jvp(function, (x,), (namespace(x).ones_like(x),))
    return both


def nonzero(divisor: Array, instead: float) -> Array:
    """Return a divisor without zeros: 1 or infinity in their place keeps quotients finite."""
    return namespace(divisor).where(divisor == 0.0, instead, divisor)


def bracketed_root(
    function: Callable[[Parameters, Array], Array],
    parameters: Parameters,
    lower: Array,
    upper: Array,
    ends: tuple[Array, Array] | None = None,
) -> Array:
    """Return a root of an elementwise function between two angles at which its signs differ.

    It is the secant method, with a bisection wherever that would leave the bracket or crawl. Where
    the signs at the ends agree, the result is the end of the smaller value. ``ends`` are the values
    at the ends, if they are known. In JAX the root is differentiable once in the parameters.

    Source: the safeguards of Press et al., Numerical Recipes, 9.4; the implicit function
    theorem for the derivatives.
    """
    fixed = constant(parameters)
    root = root_between(partial(function, fixed), *constant((lower, upper, ends)))
    if namespace(parameters, lower, upper) is np:
        return root
    root = constant(root)
    slope = with_slope(partial(function, fixed), root)[1]
    value = function(parameters, root)
    # Zero, with the derivative of the root.
    return root - (value - constant(value)) / nonzero(slope, np.inf)


def root_between(
    function: Callable[[Array], Array],
    lower: Array,
    upper: Array,
    ends: tuple[Array, Array] | None = None,
) -> Array:
    """Return such a root as ``bracketed_root`` does, without a derivative."""
    if namespace(lower) is np and not lower.size:
        return lower
    xp = namespace(lower, upper)
    at_lower, at_upper = ends or stored((function(lower), function(upper)))
    sign = xp.sign(at_upper)
    rise = at_upper - at_lower
    product = at_lower * at_upper
    share = xp.where(product < 0.0, -at_lower / nonzero(rise, 1.0), 0.5)
    is_lower_nearer = abs(at_lower) < abs(at_upper)
    last = xp.where(is_lower_nearer, lower, upper)
    at_last = xp.where(is_lower_nearer, at_lower, at_upper)
    has_root = product <= 0.0
    start = xp.where(has_root, lower + share * (upper - lower), last)

    def unfinished(state: _State) -> Array:
        count, *_, moving = state
        return (count < _STEPS) & xp.any(moving)

    def narrowed(state: _State) -> _State:
        count, low, high, x, last, at_last, moving = state
        value = stored(function(x))
        above = value * sign > 0.0
        low, high = xp.where(above, low, x), xp.where(above, x, high)
        following = x - value * (x - last) / (value - at_last)  # NaN or infinite: bisected
        step = abs(following - x)
        inside = (following > low) & (following < high)
        done = (step <= _ENOUGH * abs(x)) | (value == 0.0) | (high - low <= _STILL * high)
        usable = done | (inside & (2.0 * step < abs(x - last)))
        following = xp.where(usable, xp.clip(following, low, high), 0.5 * (low + high))
        following = xp.where(moving & (value != 0.0), following, x)
        return count + 1, low, high, following, x, value, moving & ~done

    state = (xp.asarray(0), lower, upper, start, last, at_last, has_root & (lower < upper))
    return repeat_while(unfinished, narrowed, state)[3]
