"""The loop as a third-order model in continuous time, and its condition of Routh and Hurwitz."""

from jaxtyping import Bool

from jaxstab.arrays import Array, Numbers
from jaxstab.criteria.linear import checked_loop


def routh_hurwitz_condition(
    alpha: Numbers, beta: Numbers, *, gamma: Numbers, delta: Numbers, delay: Numbers
) -> Bool[Array, "*grid"]:
    """Return True where the third-order model of the loop is stable.

    The model is continuous in time, with the effective delay t_r = 1/2 + delay as a first-order
    lag. The linear condition is this one without the term delta t_r (beta + delta + gamma t_r).

    Args:
        alpha: wall stiffness K T^2/m, any shape; like all arguments it broadcasts.
        beta: wall damping B T/m.
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, whole or fractional.

    Raises:
        ValueError: a concrete argument is outside its range, infinite or NaN.
        RuntimeError: JAX arrays are given without x64.

    Source: eqs. (17)-(21) of Hulin, Preusche, Hirzinger (2008).

    Example:
        >>> bool(jaxstab.routh_hurwitz_condition(0.1, 0.2, gamma=0.0, delta=0.015, delay=1.0))
        True
    """
    alpha, beta, gamma, delta, lag = checked_loop(alpha, beta, gamma, delta, delay)
    damped = beta + delta + gamma * lag > 0
    stiff = alpha + gamma > 0
    fast = delta * lag * (beta + delta + gamma * lag) + (beta + delta - alpha * lag) > 0
    return damped & stiff & fast
