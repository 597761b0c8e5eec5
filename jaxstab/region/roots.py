"""Bracketed roots of many smooth functions of one variable at once, to full precision."""

from collections.abc import Callable
from functools import partial
from typing import TypeVar

import jax
import jax.numpy as jnp
from jax import Array, lax

Parameters = TypeVar("Parameters")
_State = tuple[Array, Array, Array, Array, Array, Array]

_STEPS = 60  # bisection alone would take 53 from any bracket of like ends
_STILL = 4.0 * 2.0**-53
_ENOUGH = 1e-10  # of a Newton step: its square is below rounding


def bracketed_root(
    function: Callable[[Parameters, Array], Array],
    parameters: Parameters,
    lower: Array,
    upper: Array,
) -> Array:
    """Return a root of an elementwise function of an angle between two angles of unlike sign.

    Newton's method, replaced by a bisection wherever it would leave the bracket or creeps. Where
    the signs at the ends agree the result is some angle between them. The root is differentiable
    in the parameters, once.

    Source: the safeguarded Newton method of Press et al., Numerical Recipes, 9.4; the theorem of
    the implicit function for the derivatives.
    """
    known = lax.stop_gradient(parameters)
    frozen = _search(partial(function, known), *lax.stop_gradient((lower, upper)))
    slope = with_slope(partial(function, known), frozen)[1]
    value = function(parameters, frozen)
    # Zero, with the derivative of the root.
    step = (value - lax.stop_gradient(value)) / jnp.where(slope == 0.0, jnp.inf, slope)
    return frozen - step


def _search(function: Callable[[Array], Array], lower: Array, upper: Array) -> Array:
    at_lower, at_upper = function(lower), function(upper)
    sign = jnp.sign(at_upper)
    rise = at_upper - at_lower
    share = jnp.where(at_lower * at_upper < 0.0, -at_lower / jnp.where(rise == 0.0, 1.0, rise), 0.5)
    start = lower + share * (upper - lower)

    def unfinished(state: _State) -> Array:
        count, *_, moving = state
        return (count < _STEPS) & jnp.any(moving)

    def narrowed(state: _State) -> _State:
        count, low, high, x, last, moving = state
        value, slope = with_slope(function, x)
        above = value * sign > 0.0
        low, high = jnp.where(above, low, x), jnp.where(above, x, high)
        newton = x - value / slope
        step = jnp.abs(newton - x)
        done = (step <= _ENOUGH * jnp.abs(x)) | (value == 0.0) | (high - low <= _STILL * high)
        usable = done | ((newton > low) & (newton < high) & (2.0 * step < last))
        following = jnp.where(usable, newton, 0.5 * (low + high))
        following = jnp.where(moving & (value != 0.0), following, x)
        return count + 1, low, high, following, jnp.abs(following - x), moving & ~done

    state = (jnp.asarray(0), lower, upper, start, upper - lower, lower < upper)
    root: Array = lax.while_loop(unfinished, narrowed, state)[3]
    return root


def with_slope(function: Callable[[Array], Array], x: Array) -> tuple[Array, Array]:
    """Return the values of an elementwise function and their derivatives."""
    value, slope = jax.jvp(function, (x,), (jnp.ones_like(x),))
    return value, slope
