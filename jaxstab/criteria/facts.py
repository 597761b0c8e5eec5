"""What there is to say about one stable region, in numbers and words."""

from typing import Any

from jaxstab.criteria.linear import ValidityStatus, linear_validity
from jaxstab.criteria.passive import passive_region
from jaxstab.region.region import RegionStatus, StableRegion, stable_region

_FINE = 1e-7
_VALIDITY_LEVELS = {"2": 0.02, "5": 0.05}  # percent, sec. VII


def resolved_region(gamma: float, delta: float, delay: float, radius: float = 1.0) -> StableRegion:
    """Return a stable region that is neither empty nor unresolved.

    Raises:
        ValueError: an argument is outside its range, or there is no such region.
        RuntimeError: JAX's x64 mode is off.

    Source: sec. V of Hulin, Preusche, Hirzinger (2008).
    """
    region = stable_region(gamma, delta, delay, radius)
    where = f"gamma = {gamma:g}, delta = {delta:g}, delay = {delay:g}, radius = {radius:g}"
    if region.is_empty:
        raise ValueError(f"no wall is stable for {where}; there is nothing to show.")
    if region.status == RegionStatus.UNRESOLVED:
        raise ValueError(f"the region for {where} was not resolved; change one value a little.")
    return region


def region_facts(gamma: float, delta: float, delay: float, radius: float = 1.0) -> dict[str, Any]:
    """Return the numbers of a stable region by name: floats, lists of floats, words or None.

    Points are [alpha, beta]. For radius 1 the facts include the largest passive alpha and the
    points of the region's boundary up to which the linear condition errs by at most 2 % and 5 %,
    along the boundary from alpha = -gamma; None where the region has no such point.

    Args:
        gamma: physical stiffness k T^2/m in [0, 1e4].
        delta: physical damping b T/m in [0, 1e3].
        delay: time delay t_d/T >= 0 in samples, whole or fractional.
        radius: modulus in (0, 1] below which all roots lie; 1 is stability.

    Raises:
        ValueError: an argument is outside its range, or the region is empty or unresolved.
        RuntimeError: JAX's x64 mode is off.

    Source: sec. V to VIII of Hulin, Preusche, Hirzinger (2008).
    """
    region = resolved_region(gamma, delta, delay, radius)
    facts: dict[str, Any] = {
        "gamma": gamma,
        "delta": delta,
        "delay": delay,
        "radius": radius,
        "largest_alpha": _point(region.max_alpha),
        "largest_beta": _point(region.max_beta),
        "corners": [_point(corner) for corner in region.corners],
        "area": float(region.area),
    }
    if radius == 1.0:
        facts["largest_passive_alpha"] = _point(passive_region(delta, delay, _FINE).max_alpha)
        for percent, level in _VALIDITY_LEVELS.items():
            limit = linear_validity(level, gamma, delta, delay)
            met = int(limit.status) == ValidityStatus.FOUND
            name = f"linear_condition_within_{percent}_percent_up_to"
            facts[name] = _point((limit.alpha, limit.beta)) if met else None
    return facts


def _point(point: Any) -> list[float]:
    return [float(value) for value in point]
