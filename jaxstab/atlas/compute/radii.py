"""Spectral radii at all points: functions of cells, in float32 that claims no more."""

from typing import Any

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

from jaxstab.atlas.compute.plan import Plan, Tile
from jaxstab.atlas.format.schema import (
    RADIUS_CELL,
    RADIUS_FUNCTIONS,
    RADIUS_KIND,
    RADIUS_TERMS,
    TERMS_OF_RADIUS,
)
from jaxstab.proofs.plant import HandBoxes
from jaxstab.proofs.radius_cells import (
    WIDEST_CLUSTER,
    RadiusSurfaces,
    SurfaceKind,
    WallBoxes,
    radius_surfaces,
)

_BEYOND = 1e-9  # of a cell: cells overlap, so that rounding finds no gap between them
_STEP = 1 / 64  # of an error: terms are multiples of less than this, which take little room
_LEAST_ERROR = 1e-9
_DIGITS = 5  # of an error that are kept, upwards
_LARGEST = 1e6  # of terms


def radii(plan: Plan, tile: Tile) -> dict[str, NDArray[Any]]:
    """Return the functions of the cells that are in a tile, one cell of delays after the other."""
    grid = plan.grid
    counts = grid.radius_cells
    kinds = np.zeros(plan.shape(RADIUS_KIND, tile), np.int32)
    rows = [np.zeros((TERMS_OF_RADIUS, 0), np.float32)]
    for number, cell in enumerate(plan.numbers(RADIUS_CELL[-1], tile) if kinds.size else ()):
        early, late, *walls = grid.radius_range[cell].tolist()
        ends = (*np.reshape(walls, (2, 2)), grid.gamma[[0, -1]], grid.delta[[0, -1]])
        boxes = [_parts(pair, count) for pair, count in zip(ends, counts, strict=True)]
        middles = np.meshgrid(*(middle for middle, _ in boxes), indexing="ij")
        halves = [np.full(middles[0].size, half) for _, half in boxes]
        alpha, beta, gamma, delta = (middle.ravel() for middle in middles)
        middle = 0.5 * (early + late)
        half = (1.0 + _BEYOND) * max(middle - early, late - middle)
        known = radius_surfaces(
            WallBoxes(alpha, beta, *halves[:2]),
            HandBoxes(gamma, delta, *halves[2:]),
            middle,
            half,
            plan.spec.filters,
        )
        kind, of_cells = _in_float32(known)
        kinds[..., number] = kind.reshape(counts)
        rows.append(of_cells)
    return {RADIUS_KIND: kinds, RADIUS_TERMS: np.concatenate(rows, axis=1)}


def _parts(
    ends: Float64[np.ndarray, "2"], count: int
) -> tuple[Float64[np.ndarray, " count"], float]:
    """Return the middles of equal parts of a range, and half of their width."""
    low, high = ends.tolist()
    half = 0.5 * (high - low) / count
    return low + half * (2.0 * np.arange(count) + 1.0), half * (1.0 + _BEYOND)


def _in_float32(known: RadiusSurfaces) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return the kinds of cells and the terms of their functions, with what rounding loses."""
    kind, terms = known.kind.astype(np.int32), known.terms.copy()
    errors = np.concatenate([known.error, np.zeros((1, kind.size))])
    is_known = (kind != SurfaceKind.NONE) & np.all(np.abs(terms) < _LARGEST, axis=(0, 1))
    is_known &= np.all(np.isfinite(errors), axis=0)
    terms[..., ~is_known], errors[:, ~is_known], kind[~is_known] = 0.0, np.inf, SurfaceKind.ONE
    meets = np.isin(kind, (SurfaceKind.PAIR, SurfaceKind.CLUSTER))
    scale = np.where(meets, errors[0], errors)
    step = np.exp2(np.floor(np.log2(_STEP * np.clip(scale, _LEAST_ERROR, 1.0))))
    rounded = (np.round(terms / step[:, None]) * step[:, None]).astype(np.float32)
    lost = np.abs(rounded - terms).sum(axis=1) + _BEYOND * np.abs(terms[:, 1:]).sum(axis=1)
    # A mean that is moved moves the roots; the others change the polynomial in w.
    of_polynomial = np.where(kind == SurfaceKind.PAIR, lost[1], WIDEST_CLUSTER * lost[1] + lost[2])
    lost = np.where(meets, np.stack([of_polynomial, lost[0], 0.0 * lost[0]]), lost)
    of_cells = np.concatenate([rounded, _raised(errors + lost + _LEAST_ERROR)[:, None]], axis=1)
    is_used = np.arange(len(terms))[:, None] < np.array(RADIUS_FUNCTIONS)[kind]
    return kind, _strung(of_cells, is_used)


def _strung(of_cells: NDArray[np.float32], is_used: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the functions that are used, those of one cell after those of another: (term, row)."""
    rows = np.moveaxis(of_cells, (0, 1, 2), (1, 2, 0))  # (cell, function, term)
    return np.ascontiguousarray(rows[is_used.T].T)


def _raised(errors: Float64[np.ndarray, "function cell"]) -> NDArray[np.float32]:
    """Round errors up to a few digits, which float32 has and which take little room."""
    fraction, exponent = np.frexp(errors)
    raised = np.ldexp(np.ceil(np.ldexp(fraction, _DIGITS)), exponent - _DIGITS)
    return np.where(np.isfinite(errors), raised, np.inf).astype(np.float32)
