"""The paper's plant and its simple rules: the linear condition, and that of Routh and Hurwitz.

The linear condition replaces sampling and hold by a delay of half a sample, so the loop has the
effective delay t_r = t_d + T/2, in samples 1/2 + delay.
"""

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.arrays import Array, Numbers, float_arrays
from jaxstab.model import checked_delay, checked_delta, checked_gain, checked_gamma, require_x64
from jaxstab.model.plant import PlantCoefficients, plant_pairs
from jaxstab.numbers import require_together
from jaxstab.region.closed_form import slice_coefficients


def plant_coefficients(
    *, gamma: Numbers, delta: Numbers, delay: Numbers = 0.0
) -> PlantCoefficients:
    """Discretise mass, spring and damper behind a zero-order hold and the fraction of a delay.

    Args and Raises: see ``jaxstab.conventions``.

    Returns:
        PlantCoefficients of float64 arrays of the broadcast shape, differentiable to any order in
        gamma and delta. Over gamma <= 40, delta <= 10 each field is the correctly rounded value,
        or within 3 ulp of it where it nearly vanishes (d1 at gamma = (pi/2)^2, N(z) at
        gamma = (2 pi)^2, both at delta = 0); values below 1e-300 may be flushed to zero.

    Source: eqs. (2)-(6) and (9) of Hulin, Preusche, Hirzinger (2008), rewritten; for a fractional
    delay the modified z-transform.

    Example:
        >>> free = jaxstab.paper.plant_coefficients(gamma=0.0, delta=0.0)
        >>> float(free.n1)  # N(z) = (z + 1)/2 without hand
        0.5
    """
    require_x64(gamma, delta)
    delay = checked_delay(delay)
    fraction = delay - np.floor(delay)
    pairs = plant_pairs(checked_gamma(gamma), checked_delta(delta), fraction)
    return PlantCoefficients(*(pair.rounded() for pair in pairs))


def linear_alpha_limit(beta: Numbers, *, delta: Numbers, delay: Numbers) -> Float64[Array, "*grid"]:
    """Largest alpha for which the linear condition promises stability.

    Args and Raises: see ``jaxstab.conventions``.

    Source: eqs. (22) and (23) of Hulin, Preusche, Hirzinger (2008).

    Example:
        >>> round(float(jaxstab.paper.linear_alpha_limit(0.2, delta=0.015, delay=1.0)), 9)
        0.143333333
    """
    _, beta, _, delta, lag = checked_loop(0.0, beta, 0.0, delta, delay)
    return (beta + delta) / lag


def linear_condition(
    alpha: Numbers, beta: Numbers, *, gamma: Numbers, delta: Numbers, delay: Numbers
) -> Bool[Array, "*grid"]:
    """True where the linear condition holds: alpha > -gamma and beta + delta > alpha t_r.

    t_r = 1/2 + delay. The condition neither implies stability nor follows from it;
    ``linear_validity`` says up to which stiffness it is close to the exact boundary.

    Args and Raises: see ``jaxstab.conventions``.

    Source: eqs. (19), (22) and (23) of Hulin, Preusche, Hirzinger (2008).

    Example:
        >>> bool(jaxstab.paper.linear_condition(0.1, 0.2, gamma=0.0, delta=0.015, delay=1.0))
        True
    """
    alpha, beta, gamma, delta, lag = checked_loop(alpha, beta, gamma, delta, delay)
    return (alpha > -gamma) & (beta + delta > alpha * lag)


def linear_error(
    alpha: Numbers, beta: Numbers, *, gamma: Numbers, delta: Numbers, delay: Numbers
) -> Float64[Array, "*grid"]:
    """Signed error (alpha_lin - alpha) / (alpha + gamma) at a point of the exact boundary.

    Eq. (24) is its absolute value. It is positive where the linear condition promises more
    stiffness than is stable, negative where it promises less, infinite or NaN at alpha = -gamma.

    Args and Raises: see ``jaxstab.conventions``.

    Source: eq. (24) of Hulin, Preusche, Hirzinger (2008).

    Example:
        >>> alpha, beta = jaxstab.boundary_curve(0.2, gamma=0.0, delta=0.0, delay=0.0)
        >>> error = jaxstab.paper.linear_error(alpha, beta, gamma=0.0, delta=0.0, delay=0.0)
        >>> round(float(error), 4)
        0.0203
    """
    alpha, beta, gamma, delta, lag = checked_loop(alpha, beta, gamma, delta, delay)
    with np.errstate(all="ignore"):
        return ((beta + delta) / lag - alpha) / (alpha + gamma)


def checked_loop(
    alpha: Numbers, beta: Numbers, gamma: Numbers, delta: Numbers, delay: Numbers
) -> list[Array]:
    """Return the checked parameters as float64 arrays, with the effective delay for the delay."""
    require_together(alpha=alpha, beta=beta, gamma=gamma, delta=delta, delay=delay)
    return float_arrays(
        checked_gain("alpha", alpha),
        checked_gain("beta", beta),
        checked_gamma(gamma),
        checked_delta(delta),
        checked_delay(delay) + 0.5,
    )


# The loop as a third-order model in continuous time, and its condition of Routh and Hurwitz.
def routh_hurwitz_condition(
    alpha: Numbers, beta: Numbers, *, gamma: Numbers, delta: Numbers, delay: Numbers
) -> Bool[Array, "*grid"]:
    """True where the third-order model of the loop is stable.

    The model is continuous in time, with the effective delay t_r = 1/2 + delay as a first-order
    lag. The linear condition is this one without the term delta t_r (beta + delta + gamma t_r).

    Args and Raises: see ``jaxstab.conventions``.

    Source: eqs. (17)-(21) of Hulin, Preusche, Hirzinger (2008).

    Example:
        >>> bool(jaxstab.paper.routh_hurwitz_condition(0.1, 0.2, gamma=0.0, delta=0.015, delay=1.0))
        True
    """
    alpha, beta, gamma, delta, lag = checked_loop(alpha, beta, gamma, delta, delay)
    damped = beta + delta + gamma * lag > 0
    stiff = alpha + gamma > 0
    fast = delta * lag * (beta + delta + gamma * lag) + (beta + delta - alpha * lag) > 0
    return damped & stiff & fast


# The straight lines of the plane (alpha, beta) on which a real root lies at z = 1 or z = -1.


def plus_line(
    beta: Numbers, *, gamma: Numbers, delta: Numbers, delay: Numbers, radius: Numbers = 1.0
) -> Float64[Array, "*grid"]:
    """The alpha that puts a real root at z = +radius; for radius 1 it is -gamma.

    Args:
        beta, gamma, delta, delay: see ``jaxstab.conventions``.
        radius: modulus of the root in (0, 1].

    Returns:
        alpha of the broadcast shape; infinite where N(radius) = 0.

    Raises: see ``jaxstab.conventions``.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) at z = radius.

    Example:
        >>> float(jaxstab.paper.plus_line(0.5, gamma=0.001, delta=0.015, delay=0.0))
        -0.001
    """
    require_together(beta=beta, gamma=gamma, delta=delta, delay=delay, radius=radius)
    return _line(beta, *slice_coefficients(gamma, delta, delay, radius).plus_line)


def minus_line(
    beta: Numbers, *, gamma: Numbers, delta: Numbers, delay: Numbers, radius: Numbers = 1.0
) -> Float64[Array, "*grid"]:
    """The alpha that puts a real root at z = -radius.

    Infinite where N(-radius) = 0 (delta = 0 and a whole delay); arguments, errors and source as
    ``plus_line``. Raises: see there.

    Example:
        >>> round(float(jaxstab.paper.minus_line(0.5, gamma=0.0, delta=0.015, delay=0.0)), 4)
        1599.036
    """
    require_together(beta=beta, gamma=gamma, delta=delta, delay=delay, radius=radius)
    with np.errstate(all="ignore"):  # infinite where N(-radius) = 0
        return _line(beta, *slice_coefficients(gamma, delta, delay, radius).minus_line)


def _line(beta: Numbers, offset: Array, slope: Array) -> Array:
    (damping,) = float_arrays(checked_gain("beta", beta))
    with np.errstate(all="ignore"):
        return offset - damping * slope
