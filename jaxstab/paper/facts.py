"""The facts about one stable region, and where the linear condition loses its validity (sec. VII).

The first such point is proved. The error of the linear condition (``paper.linear_error``) is
``level`` on a straight line of walls, which begins at the corner of the boundary curve. With H =
alpha + gamma and t_r = 1/2 + delay,

    alpha = H - gamma,     beta = t_r (1 + level) H - t_r gamma - delta.

So E3 (``exact.line``) has every place where the curve meets it, by the angle theta of the curve,
and by how many roots leave the unit circle there as H grows. In theta the curve has the walls with
fewer roots outside on its left, as (alpha, beta) -> p has a positive determinant, |N|^2 sin(theta).
Where a pair leaves, the line passes the curve from left to right, hence the curve passes the line
from right to left. There, for H > 0, the error is larger: it rises through the level where H and
the change of the roots have one sign. The first rise is at the smallest such theta; it is a point
of the stable region where a stable interval of the line ends.

At the corner a root lies at z = 1; for gamma = 0, and for delta = 0 with a whole delay or one with
half a sample, there are two, which the structure of the polynomial need not know.
"""

from functools import lru_cache, partial
from math import inf, nan, pi
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Int8

from jaxstab.arrays import Array, Numbers, namespace
from jaxstab.conventions import Status
from jaxstab.exact.line import LineStatus, stable_pencil
from jaxstab.model import checked_delay, checked_delta, checked_gamma
from jaxstab.model.balls import Factored, ball_triple, known_out
from jaxstab.model.device.parts import flint, remembered
from jaxstab.model.loop import LoopParameters, unit_loop
from jaxstab.numbers import checked, require_together, require_x64, without_noise
from jaxstab.paper.passive import passive_region
from jaxstab.region.region import stable_region
from jaxstab.region.stable_set import RegionStatus, StableRegion, printed_extremes
from jaxstab.shown import Printed


class ValidityStatus(Status):
    """The status of the point where the linear condition loses its validity.

    Example:
        >>> jaxstab.paper.ValidityStatus(1).words
        "a point of the stable region's boundary"
    """

    NOT_COMPUTED = 0, "not computed"
    FOUND = 1, "a point of the stable region's boundary"
    NEVER = 2, "the error never rises through this level: NaN"
    OFF_THE_EDGE = 3, "on the boundary curve, but the stable region does not reach this point"
    NOT_PROVED = 4, "rounding hides which point is the first, or its side: NaN"


class LinearValidity(NamedTuple):
    """A point (alpha, beta) of the boundary, its angle on the curve, and a ValidityStatus.

    Example:
        >>> found = jaxstab.paper.linear_validity(0.02, gamma=0.0, delta=0.0, delay=0.0)
        >>> round(float(found.alpha), 9)
        0.038827412
    """

    alpha: Float64[Array, "*grid"]
    beta: Float64[Array, "*grid"]
    theta: Float64[Array, "*grid"]
    status: Int8[np.ndarray, "*grid"]


def linear_validity(
    level: Numbers, *, gamma: Numbers, delta: Numbers, delay: Numbers
) -> LinearValidity:
    """The boundary point up to which the linear condition errs by at most ``level``.

    It is the first one, along the boundary curve from its corner at alpha = -gamma, where the
    signed error (alpha_lin - alpha)/(alpha + gamma) rises through ``level``: the circles (2 %) and
    squares (5 %) of Fig. 7. The absolute value of eq. (24) may reach the level before that, because
    with damping the linear condition is too careful at small stiffness (by 2.2 % for d = 1, delta =
    0.015). Such crossings are not returned.

    It is proved, over the whole curve, that this point is the first. Each point has its own status;
    NOT_PROVED says that 3,072 bits do not tell two roots apart.

    Args:
        level: relative error in (0, 1e3], any shape; like all arguments it broadcasts. None of them
            may be traced.
        gamma, delta, delay: see ``jaxstab.conventions``.

    Returns:
        LinearValidity of the broadcast shape; NaN where no point was found.

    Raises: see ``jaxstab.conventions``.

    Example:
        >>> point = linear_validity(0.02, gamma=0.0, delta=0.0, delay=0.0)
        >>> print(f"{point.alpha:.6f} {point.beta:.6f}")
        0.038827 0.019802

    Source: sec. VII, eq. (24) and Fig. 7 of Hulin, Preusche, Hirzinger (2008).
    """
    require_together(level=level, gamma=gamma, delta=delta, delay=delay)
    xp = namespace(level, gamma, delta, delay)
    values = (
        checked("level", level, 0.0, 1e3, is_open=True),
        checked_gamma(gamma),
        checked_delta(delta),
        checked_delay(delay),
    )
    grids = np.broadcast_arrays(*(np.asarray(value, np.float64) for value in values))
    questions = np.stack([np.ravel(grid) for grid in grids]).T.tolist()
    rises = [_first_rise(*question) for question in questions]
    status, *points = np.reshape(rises, (-1, 4)).T.reshape(4, *grids[0].shape)
    alpha, beta, theta = map(xp.asarray, points)
    return LinearValidity(alpha, beta, theta, status.astype(np.int8))


def _first_rise(
    level: float, gamma: float, delta: float, delay: float
) -> tuple[ValidityStatus, float, float, float]:
    """The status of the first rise, and its alpha, beta and theta."""
    line = stable_pencil(partial(_line, unit_loop(gamma, delta, delay, None, None), level))
    if line.status != LineStatus.PROVED or line.horizon < inf:
        return ValidityStatus.NOT_PROVED, nan, nan, nan
    stable_ends = {end.value for interval in line.intervals for end in interval}
    for end in sorted(line.crossings, key=lambda end: (end.angle, end.angle_rest)):
        change = end.change if 0.0 < end.angle < pi else 0  # a pair, not a real root
        if end.is_shared or change is None:
            return ValidityStatus.NOT_PROVED, nan, nan, nan
        if change * end.value > 0.0:
            is_found = end.value in stable_ends
            status = ValidityStatus.FOUND if is_found else ValidityStatus.OFF_THE_EDGE
            beta = (delay + 0.5) * ((1.0 + level) * end.value - gamma) - delta
            return status, end.value - gamma, beta, end.angle
    return ValidityStatus.NEVER, nan, nan, nan


@remembered(8)
def _line(loop: LoopParameters, level: float) -> tuple[Factored, Factored]:
    """p(z) at the corner, and what H adds to it."""
    triple, lag = ball_triple(loop), flint.arb(loop.delay) + 0.5
    gamma, delta, delay = loop.slice.values()
    roots = 2 if gamma == 0.0 or (delta == 0.0 and delay % 1.0 in (0.0, 0.5)) else 1
    corner = triple.at(-gamma, -(lag * gamma + delta))
    more = max(roots - corner.at_one, 0)
    corner = corner._replace(rest=known_out(corner.rest, 1, more), at_one=corner.at_one + more)
    return corner, triple.stiffness.plus(triple.damping.scaled((1 + flint.arb(level)) * lag))


# ---------------------------------------------------------------------------------------- the facts
DIGITS = 10  # that are printed
LARGEST = "largest_alpha", "largest_beta", "largest_passive_alpha"  # which are not rounded up

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
            passive_region(delta=delta, delay=delay, tolerance=fine).stiffest, extent
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
