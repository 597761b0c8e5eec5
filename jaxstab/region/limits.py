"""What the stable region of a loop says in SI units: limits of stiffness and damping, distances.

Every answer is one of ``stable_region``, so exact to rounding. Where that region is UNRESOLVED
nothing is known, and all of them are NaN; the status of ``wall_limits`` says so.
"""

from functools import lru_cache
from typing import NamedTuple

from jaxtyping import Float64

from jaxstab.arrays import Array, Numbers, float_arrays
from jaxstab.model import HapticLoop, checked_gain, require_x64
from jaxstab.region import measures
from jaxstab.region.region import RegionStatus, StableRegion, stable_region


class WallLimits(NamedTuple):
    """The stiffest and the most damped wall, in SI units; NaN where no wall is stable.

    ``stiffness`` is the largest stable K in N/m, reached at the damping ``at_damping`` in N s/m;
    ``damping`` is the largest stable B in N s/m, reached at the stiffness ``at_stiffness`` in N/m.
    All four are limits: stable walls come as close as one likes. ``status`` is that of the region:
    of an UNRESOLVED one all four are NaN as well, though walls may be stable.
    """

    stiffness: float
    at_damping: float
    damping: float
    at_stiffness: float
    status: RegionStatus


def wall_limits(loop: HapticLoop) -> WallLimits:
    """Return the largest stiffness and the largest damping that a loop allows.

    Args:
        loop: device, hand, sample time and delay.

    Returns:
        WallLimits in SI units.

    Raises:
        ValueError: the dimensionless parameters are out of range, or the delay is longer than 500
            samples.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) by the D-decomposition.

    Example:
        >>> loop = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> round(wall_limits(loop).damping, 3)
        202.009
    """
    region = region_of(loop)
    (alpha, beta), (other_alpha, other_beta) = region.max_alpha.tolist(), region.max_beta.tolist()
    return WallLimits(
        loop.stiffness(alpha),
        loop.damping(beta),
        loop.damping(other_beta),
        loop.stiffness(other_alpha),
        RegionStatus(region.status),
    )


def stiffness_limits(loop: HapticLoop, damping: Numbers) -> Float64[Array, "*grid 2"]:
    """Return the least and the largest stable stiffness at given dampings.

    Args:
        loop: device, hand, sample time and delay.
        damping: B of the wall in N s/m, any shape.

    Returns:
        Array (*grid, 2) in N/m; NaN where no stiffness is stable, and everywhere for a loop whose
        region is UNRESOLVED. Where the stable stiffnesses are more than one interval, it is the one
        that reaches farthest. JAX arrays and tracers in give JAX arrays, differentiable, out.

    Raises:
        ValueError: a damping is infinite or NaN, or a parameter of the loop is out of range.
        RuntimeError: JAX arrays are given without x64.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) by the D-decomposition.
    """
    return loop.stiffness(_last_interval(loop, loop.beta(_checked("damping", damping)), axis=1))


def damping_limits(loop: HapticLoop, stiffness: Numbers) -> Float64[Array, "*grid 2"]:
    """Return the least and the largest stable damping at given stiffnesses.

    Args:
        loop: device, hand, sample time and delay.
        stiffness: K of the wall in N/m, any shape.

    Returns:
        Array (*grid, 2) in N s/m; NaN where no damping is stable, and everywhere for a loop whose
        region is UNRESOLVED. Where the stable dampings are more than one interval, it is the one
        that reaches farthest. JAX arrays and tracers in give JAX arrays, differentiable, out.

    Raises:
        ValueError: a stiffness is infinite or NaN, or a parameter of the loop is out of range.
        RuntimeError: JAX arrays are given without x64.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) by the D-decomposition.
    """
    return loop.damping(_last_interval(loop, loop.alpha(_checked("stiffness", stiffness)), axis=0))


def boundary_distance(
    loop: HapticLoop, stiffness: Numbers, damping: Numbers
) -> Float64[Array, "*grid"]:
    """Return how far walls are from the edge of the stable set, in the (alpha, beta) plane.

    Args:
        loop: device, hand, sample time and delay.
        stiffness: K of the wall in N/m, any shape; broadcasts with the damping.
        damping: B of the wall in N s/m.

    Returns:
        The Euclidean distance to the nearest limit of the stable set in units of alpha and beta,
        positive for a stable wall. For an unstable wall it is negative, and the way that leads to
        the nearest stable walls: roots that cross the circle on the way without that all the others
        are inside do not count. It is -inf where no wall is stable and NaN for a loop whose region
        is UNRESOLVED. JAX arrays and tracers of gains give JAX arrays, differentiable once in them.

    Raises:
        ValueError: a gain is infinite or NaN, or a parameter of the loop is out of range.
        RuntimeError: JAX arrays are given without x64.

    Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) by the D-decomposition.
    """
    alpha = loop.alpha(_checked("stiffness", stiffness))
    beta = loop.beta(_checked("damping", damping))
    return region_of(loop).distance(alpha, beta)


def region_of(loop: HapticLoop) -> StableRegion:
    """Return the stable region of a loop; the last ones asked for are remembered."""
    return _region(loop.gamma, loop.delta, loop.delay_samples)


@lru_cache(maxsize=64)
def _region(gamma: float, delta: float, delay: float) -> StableRegion:
    return stable_region(gamma, delta, delay)


def _checked(name: str, value: Numbers) -> Array:
    require_x64(value)
    return float_arrays(checked_gain(name, value))[0]


def _last_interval(loop: HapticLoop, values: Array, axis: int) -> Array:
    region = region_of(loop)
    return measures.limits(region.coefficients, region.outline, values, axis=axis, outermost=False)
