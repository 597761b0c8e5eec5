"""How many nodes along each axis give which error and which share computed, at which cost.

The exact limits of the haptic range at nodes of growing numbers are interpolated in three ways: by
the nearest node, linearly, and as an atlas does, by cubics through four nodes. The error of a cell
is measured as by a build, over a stencil inside of it, and a wall that is not clear of the limits
by four times that error is computed. ``error`` is the largest error of the upper limit at random
walls, over the largest stable alpha of their plant, and ``ratio`` the largest over the error of its
cell, where that is more than rounding; ``wrong`` counts walls whose verdict contradicts an exact
one. Seconds are those of the answers by one implementation for all three; an atlas takes less
(``benchmarks answers``).
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

import jaxstab
from benchmarks.record import Row
from benchmarks.timing import interleaved
from jaxstab.atlas.axis import Axis
from jaxstab.atlas.nodes import Arcs, table_of
from jaxstab.atlas.table import CLEAR, LimitTable
from jaxstab.conventions import AXES, Verdict

MEASURE = "largest error of the upper limit, over the largest stable alpha of the plant"
GRIDS = ((9, 2, 2, 13), (9, 2, 3, 37), (17, 2, 3, 73), (65, 3, 3, 97), (129, 3, 5, 193))
SMALL = ((5, 2, 2, 4), (9, 2, 2, 13))

_PLANTS, _WALLS = 1000, 100
_ASIDE = 0.08, 0.1  # below and above the stable interval of beta

Weights = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""What the values at nodes count at points: (node,) and (point,) to (point, node)."""


class Asked(NamedTuple):
    """Random walls of random plants, with exact verdicts and limits: (plant, wall)."""

    alpha: np.ndarray
    beta: np.ndarray
    plants: list[np.ndarray]
    codes: np.ndarray
    upper: np.ndarray
    top: np.ndarray


def nearest(nodes: np.ndarray, points: np.ndarray) -> np.ndarray:
    middles = 0.5 * (nodes[1:] + nodes[:-1])
    return np.eye(nodes.size)[np.searchsorted(middles, points)]


def linear(nodes: np.ndarray, points: np.ndarray) -> np.ndarray:
    return np.stack([np.interp(points, nodes, one) for one in np.eye(nodes.size)], axis=1)


def cubic(nodes: np.ndarray, points: np.ndarray, *, bends_at_integers: bool = False) -> np.ndarray:
    axis = Axis(nodes, bends_at_integers=bends_at_integers)
    return axis.interpolated(np.eye(nodes.size), axis.cell(points), points, 0)


CUBIC: tuple[Weights, ...] = cubic, cubic, partial(cubic, bends_at_integers=True), cubic
METHODS: dict[str, tuple[Weights, ...]] = {
    "nearest": (nearest,) * 4, "linear": (linear,) * 4, "cubic": CUBIC,
}  # fmt: skip
"""The weights along gamma, delta, delay and row."""


def rows(small: bool) -> Iterator[Row]:
    asked = _asked(50 if small else _PLANTS, 20 if small else _WALLS)
    for grid in SMALL if small else GRIDS:
        spec = _spec(*grid)
        timing = interleaved({"build": partial(table_of, spec)}, budget=0.0, least=1, most=1)
        table: LimitTable = timing["build"].answer
        build_seconds = min(timing["build"].cpu_seconds)
        size = sum(array.nbytes for array in table.arrays.values())
        for method, weights in METHODS.items():
            yield _row(grid, method, weights, table, asked) | {
                "bytes": size,
                "build_seconds": build_seconds,
            }


def _spec(rows: int, gammas: int, deltas: int, delays: int) -> jaxstab.AtlasSpec:
    default = jaxstab.AtlasSpec().nodes
    ends = (
        np.linspace(n[0], n[-1], c) for n, c in zip(default, (gammas, deltas, delays), strict=True)
    )
    gamma, delta, delay = (nodes.tolist() for nodes in ends)
    return jaxstab.AtlasSpec(rows=rows, gamma=gamma, delta=delta, delay=delay)


def _asked(plants: int, walls: int) -> Asked:
    rng = np.random.default_rng(20120412)
    axes = jaxstab.AtlasSpec().nodes
    own = [rng.uniform(nodes[0], nodes[-1], plants) for nodes in axes]
    arcs = Arcs(*own)
    ends, limits_at = arcs.ends, arcs.rows
    low, high = ends[:, :1], ends[:, 1:]
    beta = low + rng.uniform(-_ASIDE[0], 1.0 + _ASIDE[1], (plants, walls)) * (high - low)
    inside = (beta > low) & (beta < high)
    upper = np.where(inside, limits_at(beta)[..., 1], np.nan)
    top = np.max(limits_at(np.linspace(ends[:, 0], ends[:, 1], 65).T)[..., 1], axis=1)
    alpha = rng.uniform(-0.05, 1.1, (plants, walls)) * top[:, None]
    plant = [values[:, None] for values in own]
    point = dict(zip(AXES, (alpha, beta, *plant), strict=True))
    codes = np.asarray(jaxstab.verdict(**point, resolve="exact"))
    return Asked(alpha, beta, own, codes, upper, top)


def _row(
    grid: tuple[int, int, int, int],
    method: str,
    weights: tuple[Weights, ...],
    table: LimitTable,
    asked: Asked,
) -> Row:
    errors = _errors(table, weights)
    timing = interleaved(
        {"answer": partial(_answer, table, weights, errors, asked)}, budget=0.5, most=3
    )["answer"]
    codes, upper, room = timing.answer
    computed = codes == Verdict.UNDECIDED
    wrong = ~computed & (codes != asked.codes) & (asked.codes != Verdict.UNDECIDED)
    off = np.abs(upper - asked.upper) / asked.top[:, None]
    rows, gammas, deltas, delays = grid
    return timing.row(
        f"{rows} x {gammas} x {deltas} x {delays}",
        method,
        float(np.nanmax(off)),
        MEASURE,
        delay=3.0,
        points=codes.size,
        seconds_per_point=timing.cpu_median / codes.size,
        nodes=rows * gammas * deltas * delays,
        median_error=float(np.nanmedian(off)),
        computed=float(np.mean(computed)),
        wrong=int(wrong.sum()),
        ratio=float(
            np.nanmax(np.where(room > 1e-12, CLEAR * off * asked.top[:, None] / room, 0.0))
        ),
    )


def _plant_weights(
    weights: tuple[Weights, ...], table: LimitTable, plants: list[np.ndarray]
) -> list[np.ndarray]:
    return [one(*pair) for one, *pair in zip(weights[:3], table.axes, plants, strict=True)]


def _errors(table: LimitTable, weights: Weights) -> tuple[np.ndarray, np.ndarray]:
    """The largest errors of cells, of alpha and of beta, over the stencil of a build."""
    fine = [_with_middles(nodes) for nodes in (*table.axes, table.row)]
    found = []
    for side in (-1.0, 1.0):  # of a middle, where the nearest node changes
        places = [np.clip(f + side * 1e-12 * np.ptp(f), f[0], f[-1]) for f in fine]
        by_plant = _plant_weights(weights, table, places[:3])
        ends = np.einsum("ai,bj,ck,ijks->abcs", *by_plant, table.beta_limits, optimize=True)
        of_rows = np.einsum("ai,bj,ck,ijkrs->abcrs", *by_plant, table.alpha_limits, optimize=True)
        alpha = np.einsum(
            "dr,abcrs->abcds", weights[3](table.row, places[3]), of_rows, optimize=True
        )
        plants = [values.ravel() for values in np.meshgrid(*fine[:3], indexing="ij")]
        arcs = Arcs(*plants)
        beta = ends[..., :1] + fine[3] * (ends[..., 1:] - ends[..., :1])
        exact = arcs.rows(beta.reshape(-1, fine[3].size)).reshape(alpha.shape)
        found.append((np.abs(alpha - exact), np.abs(ends - arcs.ends.reshape(ends.shape))))
    alpha_error, beta_error = (np.maximum(*pair) for pair in zip(*found, strict=True))
    return _of_cells(alpha_error, 4), _of_cells(beta_error, 3)


def _with_middles(nodes: np.ndarray) -> np.ndarray:
    return np.sort(np.concatenate([nodes, 0.5 * (nodes[1:] + nodes[:-1])]))


def _of_cells(values: np.ndarray, axes: int) -> np.ndarray:
    for axis in range(axes):
        along = np.moveaxis(values, axis, 0)
        largest = np.maximum(np.maximum(along[:-2:2], along[1:-1:2]), along[2::2])
        values = np.moveaxis(largest, 0, axis)
    return values


def _answer(
    table: LimitTable, weights: Weights, errors: tuple[np.ndarray, np.ndarray], asked: Asked
) -> tuple[np.ndarray, ...]:
    """Codes, UNDECIDED where a wall is to be computed, and interpolated upper limits with room."""
    by_plant = _plant_weights(weights, table, asked.plants)
    ends = np.einsum("pi,pj,pk,ijks->ps", *by_plant, table.beta_limits, optimize=True)
    of_rows = np.einsum("pi,pj,pk,ijkrs->prs", *by_plant, table.alpha_limits, optimize=True)
    low, high = ends[:, :1], ends[:, 1:]
    u = (asked.beta - low) / (high - low)
    inside = np.clip(u, 0.0, 1.0)
    along = weights[3](table.row, inside.ravel()).reshape(*u.shape, -1)
    lower, upper = np.moveaxis(along @ of_rows, -1, 0)
    cells = [
        np.clip(np.searchsorted(nodes, values, "right") - 1, 0, nodes.size - 2)[:, None]
        for nodes, values in zip(table.axes, asked.plants, strict=True)
    ]
    row = np.minimum((inside * (table.row.size - 1)).astype(int), table.row.size - 2)
    room = CLEAR * np.moveaxis(errors[0][(*cells, row)], -1, 0) + 1e-14
    band = CLEAR * np.moveaxis(errors[1][tuple(cells)], -1, 0)
    within = (asked.beta > low + band[0]) & (asked.beta < high - band[1])
    beyond = (asked.beta < low - band[0]) | (asked.beta > high + band[1])
    stable = within & (asked.alpha > lower + room[0]) & (asked.alpha < upper - room[1])
    unstable = (asked.alpha < lower - room[0]) | (asked.alpha > upper + room[1])
    codes = np.full(u.shape, Verdict.UNDECIDED, np.int8)
    codes[stable], codes[beyond | (within & unstable)] = Verdict.STABLE, Verdict.UNSTABLE
    return codes, upper, room[1]
