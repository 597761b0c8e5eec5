"""Build an atlas: compute the tiles of the plan, keep each when it is done, publish one file."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import closing, contextmanager
from itertools import islice
from os import PathLike
from pathlib import Path

import jaxstab
from jaxstab.atlas.compute.plan import Plan, Tile, compute_tile, plan_atlas
from jaxstab.atlas.format.spec import AtlasSpec
from jaxstab.atlas.read.atlas import Atlas, open_atlas
from jaxstab.atlas.write.tiles import (
    build_key,
    computed_by,
    encode_tile,
    merge,
    opened_tile,
    shards_of,
)

# Where tiles are computed: in this process, in processes of this machine, or on a dask cluster.

_NODES_IN_FLIGHT = 2**26
_SECONDS_TO_CONNECT = 10


def tile_images(
    plan: Plan, tiles: Sequence[Tile], key: str, executor: Executor | None
) -> Generator[tuple[Tile, bytes], None, None]:
    """Yield tiles and their images as they are done, and keep few of them waiting."""
    if executor is None:
        for tile in tiles:
            yield tile, tile_image(plan, tile, key)
        return
    size = plan.deltas_of_a_tile * plan.grid.alpha.shape[0] * plan.grid.beta.shape[0]
    most = max(2, _NODES_IN_FLIGHT // size)
    rest = iter(tiles)
    running: dict[Future[bytes], Tile] = {}
    try:
        while True:
            for tile in islice(rest, most - len(running)):
                running[executor.submit(tile_image, plan, tile, key)] = tile
            if not running:
                return
            wait(running, return_when=FIRST_COMPLETED)
            for future in [future for future in running if future.done()]:
                yield running.pop(future), _result(future)
    finally:
        for future in running:
            future.cancel()


def _result(future: Future[bytes]) -> bytes:
    """Return the image of a tile, or say why a worker of another jaxstab has none."""
    try:
        return bytes(future.result())
    except (ImportError, AttributeError, TypeError) as error:
        raise RuntimeError(
            f"a worker cannot compute tiles of this build ({error}); install {computed_by()} for "
            "all workers."
        ) from error


def tile_image(plan: Plan, tile: Tile, key: str) -> bytes:
    """The image of a tile, computed."""
    return encode_tile(plan, tile, key, compute_tile(plan, tile))


@contextmanager
def processes(count: int) -> Iterator[Executor]:
    """Open worker processes, spawned: a process that has used JAX must not be forked."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(count, context, _follow_parent) as executor:
        yield executor


def _follow_parent() -> None:
    """Leave Ctrl-C to the parent, and end when the parent does, however it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def wait_for_end() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=wait_for_end, daemon=True).start()


@contextmanager
def dask_cluster(
    address: str, tell: Callable[[str], object] = lambda words: None
) -> Iterator[Executor]:
    """Open the workers of a dask scheduler; a tile whose worker dies is computed by another.

    ``tell`` is called with a sentence where the scheduler has no workers yet. RuntimeError: dask is
    not installed; OSError: no scheduler answers at the address, such as tcp://10.0.0.1:8786.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise RuntimeError(
            "a dask cluster needs dask: python -m pip install 'jaxstab[distributed]'."
        ) from error
    try:
        client = Client(address, timeout=_SECONDS_TO_CONNECT)
    except OSError as error:
        raise OSError(
            f"no dask scheduler answers at {address}; start one, or correct the address."
        ) from error
    except ValueError as error:  # of an address that dask cannot read
        raise ValueError(
            f"scheduler is {address!r}; give an address such as tcp://10.0.0.1:8786."
        ) from error
    with client:
        if not client.scheduler_info()["workers"]:
            tell(f"the dask scheduler at {address} has no workers; the build waits for one.")
        yield client.get_executor(pure=False, retries=3)


Progress = Callable[[int, int], object]


def build_atlas(
    spec: AtlasSpec,
    path: str | PathLike[str],
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> Atlas:
    """Compute an atlas, publish it as one file, and open it.

    The file appears whole and durably, or not at all; a former one of this name is replaced. Until
    then finished tiles are in a hidden folder beside it, and after an interruption the next build
    of an equal specification continues from them. On one machine, equal specifications give equal
    bytes, however the work was done. A few tiles are in memory at a time.

    Args:
        spec: the specification of the atlas.
        path: of the file.
        progress: called with the number of finished tiles and of all tiles.
        executor: computes the tiles; without one, this process does. A tile may be computed twice.
            An executor of processes must not fork them.

    Raises:
        OSError: the folder is missing, read-only or full, or another process builds this atlas; a
            former file is still there.
        ValueError: a parameter is too large for the model, or an axis cannot be fitted; or the
            atlas is larger than can be opened in memory.
        RuntimeError: a worker computed what the schema does not allow, or workers died.

    Source: the verdicts, the fields and the proofs for cells name theirs.

    Example:
        >>> spec = jaxstab.AtlasSpec(delay=(1.0,), gamma=(0.0,), delta=(0.0, 0.015))
        >>> atlas = jaxstab.build_atlas(spec, "atlas.h5")  # doctest: +SKIP
    """
    write_atlas(spec, Path(path), progress, executor)
    return open_atlas(path)


def write_atlas(
    spec: AtlasSpec, path: Path, progress: Progress | None, executor: Executor | None
) -> None:
    """Build an atlas of any size; see ``build_atlas``, which opens it."""
    created_by = f"jaxstab {jaxstab.__version__}"
    with shards_of(path, build_key(spec)) as shards:
        plan = plan_atlas(spec)
        tiles = plan.tiles
        missing = [tile for tile in tiles if not shards.has(plan, tile)]
        done = len(tiles) - len(missing)
        tell = progress or (lambda done, total: None)
        tell(done, len(tiles))
        try:
            with closing(tile_images(plan, missing, shards.key, executor)) as images:
                for tile, image in images:
                    with opened_tile(plan, tile, shards.key, image):
                        shards.put(tile, image)
                    done += 1
                    tell(done, len(tiles))
        except BrokenExecutor as error:
            raise RuntimeError(
                f"a worker died; {done} of {len(tiles)} tiles are stored, so build the same atlas "
                "again to continue."
            ) from error
        merge(plan, shards, path, created_by)
        shards.remove()
