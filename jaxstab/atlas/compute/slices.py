"""Products of slices (gamma, delta, delay), from the closed form: without a grid."""

from typing import Any

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

from jaxstab.atlas.compute.plan import Plan, Tile
from jaxstab.atlas.format import schema
from jaxstab.model.filters import Filters, as_keywords
from jaxstab.region import StableRegion, stable_region
from jaxstab.tuning import minimize_radius

Arrays = dict[str, NDArray[Any]]


def outlines(plan: Plan, tile: Tile) -> Arrays:
    """Return the outlines of the stable regions of a tile, one after the other."""
    regions = _regions(plan.hands(tile), *_loop(plan, tile))
    points = [_ended(region.points) for region in regions]
    corners = [_ended(region.corners) for region in regions]
    # A piece begins at every point but the last one and the end mark.
    branches = [
        np.append(region.branch, np.full(len(part) - len(region.branch), -1))
        for region, part in zip(regions, points, strict=True)
    ]
    counts = {
        schema.OUTLINE_STATUS: [int(region.status) for region in regions],
        schema.OUTLINE_SIZE: [len(part) for part in points],
        schema.CORNER_COUNT: [len(part) for part in corners],
    }
    shape = plan.shape(schema.OUTLINE_SIZE, tile)
    arrays: Arrays = {name: np.array(n, np.int32).reshape(shape) for name, n in counts.items()}
    outline, corner = np.concatenate(points), np.concatenate(corners)
    return arrays | {
        schema.OUTLINE_ALPHA: outline[:, 0].copy(),
        schema.OUTLINE_BETA: outline[:, 1].copy(),
        schema.OUTLINE_BRANCH: np.concatenate(branches).astype(np.int32),
        schema.CORNER_ALPHA: corner[:, 0].copy(),
        schema.CORNER_BETA: corner[:, 1].copy(),
    }


def summaries(plan: Plan, tile: Tile) -> Arrays:
    """Return the extremes of the stable regions of a tile, and the fastest loops."""
    values = slice_summaries(plan.hands(tile), *_loop(plan, tile))
    return {name: value.reshape(plan.shape(name, tile)) for name, value in values.items()}


def slice_summaries(
    hands: Float64[np.ndarray, "slice 2"], delay: float, filters: Filters | None = None
) -> dict[str, Float64[np.ndarray, " slice"]]:
    """Return the variables of the product ``summary``.

    Args:
        hands: gamma and delta of each slice.
        delay: time delay t_d/T of all of them.
        filters: velocity estimator and position filter of all of them.
    """
    regions = _regions(hands, delay, filters)
    best = minimize_radius(
        gamma=hands[:, 0], delta=hands[:, 1], delay=delay, **as_keywords(filters)
    )
    values = (
        [float(region.max_alpha[0]) for region in regions],
        [float(region.max_alpha[1]) for region in regions],
        [float(region.max_beta[1]) for region in regions],
        [float(region.area) for region in regions],
        best.value,
        best.alpha,
        best.beta,
    )
    return {
        name: np.array(value, np.float64)
        for name, value in zip(schema.SUMMARY, values, strict=True)
    }


def _loop(plan: Plan, tile: Tile) -> tuple[float, Filters | None]:
    return float(plan.grid.delay[tile.delay]), plan.spec.filters


def _regions(
    hands: Float64[np.ndarray, "slice 2"], delay: float, filters: Filters | None
) -> list[StableRegion]:
    keywords = as_keywords(filters)
    return [
        stable_region(gamma=gamma, delta=delta, delay=delay, **keywords)
        for gamma, delta in hands.tolist()
    ]


def _ended(points: Float64[np.ndarray, "point 2"]) -> Float64[np.ndarray, "point_and_end 2"]:
    """Return points and, so that a plot of many breaks off here, one that is not a number."""
    return np.append(points, [[np.nan, np.nan]], axis=0)
