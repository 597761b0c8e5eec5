"""How long a build takes and how large its file is, from parts of two tiles that are computed."""

from dataclasses import replace
from time import process_time
from typing import NamedTuple

import h5py
import numpy as np

from jaxstab.atlas.compute.plan import Plan, Tile
from jaxstab.atlas.format.footer import image_of
from jaxstab.atlas.format.schema import ALPHA_LIMITS, SPECTRAL_RADIUS
from jaxstab.atlas.write.workers import tile_image

_RADII = 2**16  # that are computed at most, unless two columns hold more
_FILE = 30_000  # bytes of a file whose arrays are empty
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
            f"about {_two_digits(self.size / 1e6)} MB, judged by parts of two tiles"
        )


def estimate_build(plan: Plan) -> Estimate:
    """Compute parts of a tile of the first and of the last delay, and say what all tiles take.

    Raises:
        ValueError: as for a build.
    """
    delays = plan.grid.delay.size
    parts = [_measured(plan, index) for index in sorted({0, delays - 1})]
    start, seconds, size = np.mean(parts, axis=0).tolist()
    tiles = sum(1.0 if _has_cells(plan, tile) else _WITHOUT_CELLS for tile in plan.tiles)
    return Estimate(start * delays + seconds * tiles, _FILE + size * tiles)


def _has_cells(plan: Plan, tile: Tile) -> bool:
    return all(plan.numbers(name, tile) for name in ("gamma_cell", "delta_cell"))


def _measured(plan: Plan, delay: int) -> tuple[float, float, float]:
    """Return the seconds that a tile takes more if it is the first, what all take, and the bytes.

    Of limits those of one cell of delays are computed, the first or the last.

    Verdicts and what belongs to slices take a second at most. Of radii, which take as long as there
    are nodes, some columns in the middle are computed.
    """
    tile = next(tile for tile in plan.tiles if tile.delay == delay)
    alphas, betas, *_ = plan.grid.shape
    columns = min(betas, max(2, _RADII // (alphas * len(tile.delta))))
    first = (betas - columns) // 2
    middle = replace(plan.grid, beta=plan.grid.beta[first : first + columns])
    start = seconds = size = 0.0
    for product in plan.spec.products:
        asked, grid, scale = tile, plan.grid, 1.0
        if product == SPECTRAL_RADIUS:
            grid, scale = middle, betas / columns
        elif product == ALPHA_LIMITS:
            cells = plan.grid.limit_range
            one = cells[-1:] if delay else cells[:1]
            grid, scale = replace(plan.grid, limit_range=one), len(cells) / plan.grid.delay.size
            owner = int(np.searchsorted(plan.grid.delay, one[0, 0], "right")) - 1
            asked = tile._replace(delay=owner)
        part = Plan(replace(plan.spec, products=(product,)), grid)
        (slow, _), (quick, stored) = (_timed(part, asked) for _ in range(2))
        start += max(0.0, slow - quick)  # XLA compiles once
        seconds += scale * quick
        size += scale * stored
    return start, seconds, size


def _timed(plan: Plan, tile: Tile) -> tuple[float, int]:
    """Return the seconds that a tile takes and the bytes of its compressed values."""
    begin = process_time()
    image = tile_image(plan, tile, key="")
    seconds = process_time() - begin
    with h5py.File.in_memory(image_of(image)) as file:
        return seconds, sum(dataset.id.get_storage_size() for dataset in file.values())


def _duration(seconds: float) -> str:
    for unit, length in (("hours", 3600.0), ("minutes", 60.0)):
        if seconds > 2.0 * length:
            return f"{_two_digits(seconds / length)} {unit}"
    return f"{_two_digits(seconds)} seconds"


def _two_digits(value: float) -> str:
    return f"{float(f'{value:.2g}'):g}"
