"""How long a build takes and how large its file is, from parts of a few tiles that are computed."""

from dataclasses import replace
from math import prod
from time import process_time
from typing import NamedTuple

import h5py
import numpy as np
from jaxtyping import Float64

from jaxstab.atlas.compute.layout import regions_around
from jaxstab.atlas.compute.plan import Plan, Tile
from jaxstab.atlas.compute.tolerance import known_region
from jaxstab.atlas.format.footer import image_of
from jaxstab.atlas.format.schema import (
    ALPHA_LIMITS,
    LIMITS,
    RADIUS_CELL,
    SPECTRAL_RADIUS,
    VARIABLES,
)
from jaxstab.atlas.write.workers import tile_image

_RADII = 24, 64  # cells of radii along alpha and beta that are computed at once, at most
_SHARES = (0.1, 0.5, 0.9), (0.5, 0.9, 0.1), (0.9, 0.1, 0.5)  # of the delays, gammas and deltas
_REGIONS = 0.1, 0.3, 0.5, 0.7, 0.9  # of the way through the delays
_CALLS = (1, 32), (16, 512)  # boxes of hands and columns along beta, at most
_FILE, _CHUNK = 28_000, 90  # bytes of a file whose arrays are empty, and of a chunk beside values
_WITHOUT_CELLS = 0.4  # of the work of a tile: at the last of several hands no cells begin


class Estimate(NamedTuple):
    """The expected cost of a build, in our experience right to a factor of two.

    Attributes:
        seconds: of CPU time, on this machine.
        size: of the file in bytes.
    """

    seconds: float
    size: float

    def __str__(self) -> str:
        return (
            f"build: about {_duration(self.seconds)} of CPU time on this machine, and a file of "
            f"about {_two_digits(self.size / 1e6)} MB, judged by parts of a few tiles"
        )


class Costs(NamedTuple):
    """What parts of an atlas take, by which the cost of any resolution of its range follows.

    Attributes:
        region_seconds: of a stable region around which axes are laid.
        start: seconds that the first tile of a delay takes more than others.
        slice_seconds: of a hand at one delay, but for the limits of alpha and the radii.
        node_bytes: of its compressed values, but for those of cells, limits and radii.
        cell_bytes: of the values of cells that begin at a hand.
        call_seconds: of the limits of alpha in one tile and one cell of delays, whatever they are.
        column_seconds: that each column of limits takes more.
        radius_seconds: of a cell of radii.
        radius_bytes: of its compressed values.
    """

    region_seconds: float
    start: float
    slice_seconds: float
    node_bytes: float
    cell_bytes: float
    call_seconds: float
    column_seconds: float
    radius_seconds: float
    radius_bytes: float

    def of(self, plan: Plan, of_limits: float = 1.0) -> Estimate:
        """Return what a build takes; nodes along alpha and beta are those that were measured.

        Args:
            plan: of the build.
            of_limits: how many times what was measured its limits of alpha take.
        """
        length = plan.grid.lengths
        cells = length["gamma_cell"] * length["delta_cell"] * length["delay"]
        tiles = plan.tiles
        hands = sum(
            len(tile.delta) * (1.0 if _has_cells(plan, tile) else _WITHOUT_CELLS) for tile in tiles
        )
        seconds = self.region_seconds * regions_around(plan.spec, plan.grid)
        seconds += self.start * length["delay"] + self.slice_seconds * hands
        size = _FILE + self.node_bytes * prod(plan.grid.shape[2:]) + self.cell_bytes * cells
        size += _CHUNK * len(tiles) * len(plan.variables) + len(plan.spec.to_toml())
        size += 1.5 * (plan.grid.alpha.nbytes + plan.grid.beta.nbytes)  # and their scales
        if ALPHA_LIMITS in plan.spec.products:
            gammas, deltas, delays = (length[name] for name in LIMITS[1:4])
            columns = plan.grid.limit_cells * gammas * deltas * delays
            calls = gammas * -(-deltas // plan.deltas_of_a_tile) * delays
            seconds += of_limits * self.limit_seconds(calls, columns)
            size += calls * (_CHUNK + 4.0 * prod(plan.chunk(ALPHA_LIMITS)))
        if SPECTRAL_RADIUS in plan.spec.products:
            radii = prod(length[name] for name in RADIUS_CELL)
            seconds += self.radius_seconds * radii
            size += self.radius_bytes * radii + _CHUNK * length[RADIUS_CELL[-1]]
        return Estimate(seconds, size)

    def limit_seconds(self, calls: int, columns: int) -> float:
        """Return what limits of alpha take, so many tiles of so many columns in all."""
        return self.call_seconds * calls + self.column_seconds * columns


def estimate_build(plan: Plan) -> Estimate:
    """Compute parts of some tiles, and say what all of them take.

    Raises:
        ValueError: as for a build.
    """
    return costs_of(plan).of(plan)


def costs_of(plan: Plan) -> Costs:
    """Compute parts of a tile of the first and of the last delay, and some limits of alpha.

    Raises:
        ValueError: as for a build.
    """
    delays = sorted({0, plan.grid.delay.size - 1})
    slices = np.mean([_of_slices(plan, delay) for delay in delays], axis=0)
    limits = radii = [0.0, 0.0]
    if ALPHA_LIMITS in plan.spec.products:
        limits = limit_costs(plan)
    if SPECTRAL_RADIUS in plan.spec.products:
        radii = np.mean([_of_radii(plan, along) for along, *_ in _SHARES], axis=0).tolist()
    return Costs(_of_region(plan), *slices.tolist(), *limits, *radii)


def limit_costs(plan: Plan) -> list[float]:
    """Return ``call_seconds`` and ``column_seconds`` of a plan with limits of alpha."""
    found: list[float] = np.mean([_of_limits(plan, *one) for one in _SHARES], axis=0).tolist()
    return found


def _of_region(plan: Plan) -> float:
    """Return the seconds of a stable region, of a few hands and delays."""
    grid = plan.grid
    delays = [_at(grid.limit_range[:, 0], share) for share in _REGIONS]
    begin = process_time()
    for end in (0, -1):
        for delay in delays:
            known_region(float(grid.gamma[end]), float(grid.delta[end]), delay, plan.spec.filters)
    return (process_time() - begin) / (2 * len(delays))


def _at(nodes: Float64[np.ndarray, " node"], share: float) -> float:
    """Return the node at a share of the way through all of them."""
    return float(nodes[round(share * (nodes.size - 1))])


def _has_cells(plan: Plan, tile: Tile) -> bool:
    return all(plan.numbers(name, tile) for name in ("gamma_cell", "delta_cell"))


def _of_slices(plan: Plan, delay: int) -> tuple[float, ...]:
    """Return the seconds that a tile takes more if it is the first, and what a hand takes.

    These are its seconds and the bytes of its nodes and of its cells.

    Verdicts and what belongs to slices take a second at most.
    """
    tile = next(tile for tile in plan.tiles if tile.delay == delay)
    start, taken = 0.0, np.zeros(3)
    others = (ALPHA_LIMITS, SPECTRAL_RADIUS)
    for product in (name for name in plan.spec.products if name not in others):
        part = Plan(replace(plan.spec, products=(product,)), plan.grid)
        (slow, *_), (quick, *stored) = (_timed(part, tile) for _ in range(2))
        start += max(0.0, slow - quick)  # XLA compiles once
        taken += [quick, *stored]
    return start, *(taken / len(tile.delta)).tolist()


def _of_limits(plan: Plan, along: float, of_gamma: float, of_delta: float) -> tuple[float, float]:
    """Return the seconds of limits of alpha at shares of the way through delays and hands.

    Few columns in the middle of one box of hands are computed, and many of several boxes.
    """
    grid = plan.grid
    row = grid.limit_range[int(along * (len(grid.limit_range) - 1))]
    gamma = int(of_gamma * max(0, grid.gamma.size - 2))
    taken: list[tuple[int, float]] = []
    for boxes, most in _CALLS:
        columns = min(most, grid.limit_cells)
        before = (grid.limit_cells - columns) // 2
        ends = np.array([before, before + columns]) / grid.limit_cells
        delta = int(of_delta * max(0, grid.delta.size - 1 - boxes))
        part = replace(
            grid,
            alpha=grid.alpha[:, :1],
            beta=grid.beta[:, :1],
            gamma=grid.gamma[gamma : gamma + 2],
            delta=grid.delta[delta : delta + boxes + 1],
            delay=row[:1],
            limit_cells=columns,
            limit_range=np.array([[*row[:4], *(row[4] + (row[5] - row[4]) * ends)]]),
        )
        asked = Plan(replace(plan.spec, products=(ALPHA_LIMITS,)), part)
        whole = min(part.delta.size, asked.deltas_of_a_tile)
        tile = Tile(0, range(whole), 0)
        boxes = len(asked.numbers("delta_cell", tile))
        taken.append((boxes * columns, _timed(asked, tile)[0]))
    (few, quick), (many, slow) = taken
    column = max(0.0, slow - quick) / max(1, many - few)
    return max(0.0, quick - few * column), column


def _of_radii(plan: Plan, share: float) -> tuple[float, float]:
    """Return seconds and bytes of a cell of radii at a share of the way through the delays."""
    grid = plan.grid
    row = grid.radius_range[int(share * (len(grid.radius_range) - 1))]
    alphas, betas = map(min, grid.radius_cells[:2], _RADII)
    cells = alphas, betas, 1, 1
    part = replace(
        grid,
        alpha=grid.alpha[:, :1],
        beta=grid.beta[:, :1],
        delay=row[:1],
        radius_cells=cells,
        radius_range=row[None],
    )
    asked = Plan(replace(plan.spec, products=(SPECTRAL_RADIUS,)), part)
    seconds, stored, _ = min(_timed(asked, asked.tiles[0]) for _ in range(2))
    return seconds / prod(cells), stored / prod(cells)


def _timed(plan: Plan, tile: Tile) -> tuple[float, int, int]:
    """Return the seconds that a tile takes, and the bytes of its nodes' and its cells' values."""
    begin = process_time()
    image = tile_image(plan, tile, key="")
    seconds = process_time() - begin
    stored = [0, 0]
    with h5py.File.in_memory(image_of(image)) as file:
        for name, dataset in file.items():
            of_cells = "gamma_cell" in VARIABLES[name].dimensions
            stored[of_cells] += dataset.id.get_storage_size()
    return seconds, stored[False], stored[True]


def _duration(seconds: float) -> str:
    for unit, length in (("hours", 3600.0), ("minutes", 60.0)):
        if seconds > 2.0 * length:
            return f"{_two_digits(seconds / length)} {unit}"
    return f"{_two_digits(seconds)} seconds"


def _two_digits(value: float) -> str:
    return f"{float(f'{value:.2g}'):g}"
