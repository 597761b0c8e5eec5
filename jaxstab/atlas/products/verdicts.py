"""Verdicts at nodes and of whole cells.

A node has the verdict of its point, a cell the verdict that is proved for all of its points, or
none. ``atlas.proved`` proves both column by column; a reader looks them up (``atlas.atlas``).
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.product import (
    CELL,
    CODES,
    NODE,
    SLICE,
    Array,
    Check,
    Floats,
    Inspection,
    Product,
    SliceIndex,
    Variable,
)
from jaxstab.conventions import Verdict

if TYPE_CHECKING:
    from jaxstab.atlas.plan import Grid, Plan, Tile

VERDICT = "verdict"
CELL_VERDICT = "cell_verdict"

_VARIABLES = (
    Variable(
        VERDICT,
        "int8",
        NODE,
        "stability at the node",
        "stable: all roots of the characteristic polynomial inside the unit circle; "
        "unstable: not so; both proved. Undecided: too close to the boundary",
        *CODES,
    ),
    Variable(
        CELL_VERDICT,
        "int8",
        CELL,
        "stability of all points of the cell",
        "stable or unstable: proved for each point of the closed cell (the boundary in closed "
        "form is enclosed and passes elsewhere); undecided: no proof",
        *CODES,
    ),
)


class Verdicts(Product):
    """Verdicts of nodes and cells."""

    name = VERDICT
    variables = _VARIABLES
    gridded = VERDICT, CELL_VERDICT
    unit = ("beta_node", *SLICE)

    def compute(self, plan: "Plan", tile: "Tile") -> dict[str, Array]:
        from jaxstab.atlas.proved import cell_verdicts, node_verdicts

        alpha, beta, delay = plan.grid.walls(tile.delay)
        hands, boxes = plan.hands(tile), plan.boxes(tile)
        nodes = node_verdicts(alpha, beta, hands[:, 0], hands[:, 1], delay, plan.spec.filters)
        cells = np.zeros((0, alpha.size - 1, beta.size - 1), np.int8)
        if boxes.gamma.size:
            cells = cell_verdicts(alpha, beta, boxes, delay, plan.spec.filters)
        return {
            VERDICT: np.moveaxis(nodes, 0, -1).reshape(plan.shape(VERDICT, tile)),
            CELL_VERDICT: np.moveaxis(cells, 0, -1).reshape(plan.shape(CELL_VERDICT, tile)),
        }

    def small_grid(self, grid: "Grid", place: Floats) -> "Grid":
        return grid.slice_at(*place[:3].tolist())

    def checks(self, stored: Inspection) -> Iterator[Check]:
        for name, points_at in ((VERDICT, _nodes_at), (CELL_VERDICT, _points_in_cells)):
            places = stored.places(stored.datasets[name].shape[2:])
            each, wrong = -(-stored.sample // len(places)), 0
            for place in places:
                gamma, delta, delay = place
                codes = stored.datasets[name][:, :, gamma, delta, delay]
                i, j = _chosen_places(codes, each, stored.chance)
                point = points_at(stored, i, j, place)
                wrong += wrong_codes(codes[i, j], point, stored.filters)
            yield Check(name, wrong == 0, f"{wrong} of {each * len(places)} points are wrong")


def _chosen_places(
    values: Array, count: int, chance: np.random.Generator
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return places in a slice, half of them where the value changes along beta."""
    i, j = (chance.integers(0, length, count) for length in values.shape)
    changes = np.argwhere(values[:, 1:] != values[:, :-1])
    if len(changes):
        near = chance.choice(changes, count // 2)
        i[: count // 2], j[: count // 2] = near[:, 0], near[:, 1] + chance.integers(0, 2)
    return i, j


def _nodes_at(stored: Inspection, i: Array, j: Array, place: SliceIndex) -> tuple[Any, ...]:
    alpha, beta = (stored.datasets[name][:, place[-1]] for name in ("alpha", "beta"))
    return alpha[i], beta[j], *stored.loop(place)


def _points_in_cells(stored: Inspection, i: Array, j: Array, place: SliceIndex) -> tuple[Any, ...]:
    """Return a random point of each cell; a single node is its cell."""
    gamma, delta, delay = place
    alpha, beta = (stored.datasets[name][:, delay] for name in ("alpha", "beta"))
    hands = (
        (stored.datasets["gamma"], np.full(i.size, gamma)),
        (stored.datasets["delta"], np.full(i.size, delta)),
    )
    points = []
    for nodes, cell in ((alpha, i), (beta, j), *hands):
        lower, upper = nodes[cell], nodes[np.minimum(cell + 1, nodes.size - 1)]
        inside = lower + stored.chance.random(cell.size) * (upper - lower)
        points.append(np.clip(inside, lower, upper))
    return *points, stored.datasets["delay"][delay]


def wrong_codes(codes: Array, point: tuple[Any, ...], filters: Mapping[str, Any]) -> int:
    """Count codes that are none, and those that say the opposite of a verdict for the point."""
    from jaxstab.model import by_name
    from jaxstab.point import verdict

    exact = np.asarray(verdict(**by_name(*point), resolve="exact", **filters))
    both = np.isin(codes, (Verdict.STABLE, Verdict.UNSTABLE)) & np.isin(
        exact, (Verdict.STABLE, Verdict.UNSTABLE)
    )
    return int(np.sum((both & (codes != exact)) | (codes == Verdict.NOT_COMPUTED)))


def decided_share(
    blocks: Iterable[tuple[tuple[int, ...], NDArray[np.int8]]], axes: Sequence[Floats]
) -> float:
    """The share of the volume of a grid in which the verdicts of cells are decided.

    ``blocks`` are where blocks of cells begin along the five axes, and their codes; ``axes`` the
    nodes along the first four.
    """
    widths = [np.diff(nodes) / np.ptp(nodes) if nodes.size > 1 else np.ones(1) for nodes in axes]
    total = 0.0
    for start, codes in blocks:
        share = ((codes == Verdict.STABLE) | (codes == Verdict.UNSTABLE)).astype(np.float64)[..., 0]
        for begin, along in zip(start, widths, strict=False):
            share = np.tensordot(along[begin : begin + share.shape[0]], share, 1)
        total += float(share)
    return total
