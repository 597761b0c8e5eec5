"""The facts about one stable region, in numbers and words."""

from functools import lru_cache, partial
from typing import Any

import numpy as np

from jaxstab.numbers import require_x64, without_noise
from jaxstab.paper.rules import passive_region
from jaxstab.paper.validity import ValidityStatus, linear_validity
from jaxstab.region.region import stable_region
from jaxstab.region.stable_set import RegionStatus, StableRegion, printed_extremes
from jaxstab.shown import Printed

DIGITS = 10  # that are printed

_kept_region = lru_cache(8)(stable_region)  # who asks for facts asks for a picture, too


def resolved_region(
    *, gamma: int | float, delta: int | float, delay: int | float, radius: int | float = 1.0
) -> StableRegion:
    """The stable region of roots below a radius (sec. V); ValueError if empty or unresolved."""
    require_x64(gamma, delta, delay, radius)
    region = _kept_region(
        gamma=float(gamma), delta=float(delta), delay=float(delay), radius=float(radius)
    )
    where = f"gamma = {gamma:g}, delta = {delta:g}, delay = {delay:g}, radius = {radius:g}"
    if region.is_empty:
        raise ValueError(f"no wall is stable for {where}; there is nothing to show.")
    if region.status == RegionStatus.UNRESOLVED:
        raise ValueError(f"the region for {where} was not resolved; change one value a little.")
    return region


def region_facts(
    *, gamma: int | float, delta: int | float, delay: int | float, radius: int | float = 1.0
) -> dict[str, Any]:
    """The numbers of a stable region by name: floats, lists of floats, words or None.

    Points are [alpha, beta]. For radius 1 the facts include the largest passive alpha and the
    points up to which the linear condition errs by at most 2 % and 5 %, along the boundary from
    alpha = -gamma; None where the region has none. Arguments, errors and sources: as
    ``resolved_region``.
    """
    validity_levels = {"2": 0.02, "5": 0.05}  # percent, sec. VII
    fine = 1e-7  # of delta: the tolerance of the passive region
    region = resolved_region(gamma=gamma, delta=delta, delay=delay, radius=radius)
    extent = np.ptp(region.points, axis=0)
    point = partial(_point, extent=extent, line=-gamma if radius == 1.0 else None)
    printed = printed_extremes(region, DIGITS)
    facts: dict[str, Any] = {
        "gamma": gamma,
        "delta": delta,
        "delay": delay,
        "radius": radius,
        "largest_alpha": _as_printed(point(region.max_alpha), printed[0]),
        "largest_beta": _as_printed(point(region.max_beta), printed[1]),
        "corners": [point(corner) for corner in region.corners],
        "area": float(region.area),
    }
    if radius == 1.0:
        facts["largest_passive_alpha"] = _point(
            passive_region(delta=delta, delay=delay, tolerance=fine).max_alpha, extent
        )
        for percent, level in validity_levels.items():
            limit = linear_validity(level, gamma=gamma, delta=delta, delay=delay)
            is_found = int(limit.status) == ValidityStatus.FOUND
            name = f"linear_condition_within_{percent}_percent_up_to"
            facts[name] = _point((limit.alpha, limit.beta), extent) if is_found else None
    return facts


def _as_printed(point: list[float], printed: Any) -> list[float]:
    """The numbers of a point, with the texts by which they are printed."""
    return [
        Printed(value, known.text) if isinstance(known, Printed) else value
        for value, known in zip(point, printed, strict=True)
    ]


def _point(point: Any, extent: Any, line: float | None = None) -> list[float]:
    """The numbers of a point; one that rounding took off the line alpha = -gamma is on it."""
    # What is 0 but for rounding, beside the extent of the region, is 0, and zeros lose their sign.
    alpha, beta = (float(without_noise(*pair)) for pair in zip(point, extent, strict=True))
    if line is not None and abs(alpha - line) <= 1e-15 * (abs(alpha) + abs(beta)):
        alpha = line
    return [alpha + 0.0, beta + 0.0]
