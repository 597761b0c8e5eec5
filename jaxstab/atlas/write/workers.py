"""Where tiles are computed: in this process, in processes of this machine, or on a dask cluster."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from itertools import islice

from jaxstab.atlas.compute.plan import Plan, Tile
from jaxstab.atlas.compute.products import compute_tile
from jaxstab.atlas.write.tiles import computed_by, encode_tile, opened_tile

_NODES_IN_FLIGHT = 2**26
_SECONDS_TO_CONNECT = 10


def tile_images(
    plan: Plan, tiles: Sequence[Tile], key: str, executor: Executor | None
) -> Generator[tuple[Tile, bytes], None, None]:
    """Yield tiles and their images as they are done, and keep few of them waiting.

    Raises:
        RuntimeError: a worker has another jaxstab, NumPy or Python.
        ValueError: what a worker computed is not what the schema says.
    """
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
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                tile, image = running.pop(future), _result(future)
                with opened_tile(plan, tile, key, image):
                    yield tile, image
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
    """Compute a tile and return its image.

    Raises:
        RuntimeError: a result is not in the precision of the schema.
    """
    return encode_tile(plan, tile, key, compute_tile(plan, tile))


@contextmanager
def processes(count: int) -> Iterator[Executor]:
    """Open so many worker processes.

    They are spawned: a process that has used JAX must not be forked.
    """
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

    Args:
        address: of the scheduler, such as tcp://10.0.0.1:8786.
        tell: called with a sentence where the scheduler has no workers yet.

    Raises:
        RuntimeError: dask is not installed.
        OSError: no scheduler answers there.
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
