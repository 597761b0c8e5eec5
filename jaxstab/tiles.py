"""Work in tiles: computed anywhere, kept until all are done, then published as one file.

A *job* divides its work into tiles that need nothing of each other. Tiles are computed in this
process, in processes of this machine or on a dask cluster, by any ``concurrent.futures.Executor``;
what a tile gives is its *image*, bytes with a hash, with the code that computed them and the arrays
of the tile.

Until all tiles are done, their images lie in a hidden folder beside the target: what is in it are
the tiles that are done, and an interrupted job continues from there. The folder is its owner's
alone, locked by one process, and named by the job's key, which tells it from other jobs.
"""

import errno
import hashlib
import io
import multiprocessing
import os
import platform
import re
import signal
import sys
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache
from itertools import islice
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

import jaxstab
from jaxstab.durable import Folder, Identity, identity_of, named_errors, own_folder, target_of

Item = TypeVar("Item")
Progress = Callable[[int, int], object]
Arrays = dict[str, NDArray[Any]]

_LOCK = "lock"
_LEFT_OVER = re.compile(r"\..+\.[0-9a-f]{16}\.part")
_OURS = re.compile(rf"[\w-]+\.tile|{_LEFT_OVER.pattern}")
_BUSY = "another process is building it"
_ATTEMPTS = 100
_SEAL = 32  # bytes of a hash
_SECONDS_TO_CONNECT = 10


class Job(ABC, Generic[Item]):
    """Work in tiles.

    ``key`` is a hash of what is computed and of what computes it: tiles of other jobs do not match.
    ``path`` is where the file goes. ``compute`` returns what a tile holds, arrays by their names;
    workers call it, so jobs and tiles can be pickled.
    """

    key: str
    path: Path
    compute: Callable[[Item], Arrays]

    @property
    @abstractmethod
    def items(self) -> Sequence[Item]:
        """The tiles."""

    @property
    @abstractmethod
    def at_once(self) -> int:
        """How many tiles may be in flight."""

    @abstractmethod
    def name(self, item: Item) -> str:
        """The name of a tile: letters, digits, "_" and "-"."""

    @abstractmethod
    def are_of(self, item: Item, arrays: Arrays) -> bool:
        """Whether names, types and shapes of arrays are those of a tile."""

    def are_sound(self, item: Item, arrays: Arrays) -> bool:
        """Whether the values of a tile that was stored may be used."""
        return True

    @abstractmethod
    def publish(self, shards: "Shards") -> None:
        """Write the file of all tiles, which are done."""

    def image(self, item: Item) -> bytes:
        """The image of a tile, computed: a hash of what follows, who computed which, its arrays."""
        stream, arrays = io.BytesIO(), self.compute(item)
        np.savez(stream, **arrays)  # type: ignore[arg-type]
        words = f"{computed_by()}\n{self._title(item)}\n".encode() + stream.getvalue()
        return hashlib.sha256(words).digest() + words

    def arrays(self, item: Item, image: bytes) -> Arrays:
        """The arrays in an image; ValueError: it is damaged; RuntimeError: it is of other code."""
        seal, words = image[:_SEAL], image[_SEAL:]
        if hashlib.sha256(words).digest() == seal:
            maker, title, archive = words.split(b"\n", 2)
            if maker.decode() != computed_by():
                raise RuntimeError(
                    f"a worker computes with {maker.decode()}, and this process with "
                    f"{computed_by()}; install the same for all workers."
                )
            with np.load(io.BytesIO(archive)) as opened:
                arrays = dict(opened)
            if title.decode() == self._title(item) and self.are_of(item, arrays):
                return arrays
        raise ValueError(f"tile {self.name(item)} of {self.path} is damaged; compute it again.")

    def is_done(self, item: Item, image: bytes) -> bool:
        """Whether an image that was stored is whole and of this job."""
        try:
            return self.are_sound(item, self.arrays(item, image))
        except (ValueError, RuntimeError):
            return False

    def _title(self, item: Item) -> str:
        return f"{self.key} {self.name(item)}"


def complete(job: Job[Item], progress: Progress | None, executor: Executor | None) -> None:
    """Compute the tiles of a job that are not done, and publish its file.

    Without an executor the dask client of this process computes; without one, this process.

    OSError: the folder is missing, read-only or full, or another process does the same;
    RuntimeError: workers died, or are of other code.
    """
    with shards_of(job.path, job.key) as shards:
        items = job.items
        missing = [item for item in items if not shards.has(job, item)]
        done = len(items) - len(missing)
        tell = progress or (lambda done, total: None)
        tell(done, len(items))
        try:
            where = executor or _own_client()
            with closing(images(job.image, missing, job.at_once, where)) as computed:
                for item, image in computed:
                    job.arrays(item, image)  # which refuses what is wrong
                    shards.put(job.name(item), image)
                    done += 1
                    tell(done, len(items))
        except BrokenExecutor as error:
            raise RuntimeError(
                f"a worker died; {done} of {len(items)} tiles are stored, so repeat the same call "
                "to continue."
            ) from error
        job.publish(shards)
        shards.remove()


@cache
def computed_by() -> str:
    """Return what computes tiles here: jaxstab and a hash of its code, NumPy and Python."""
    root = Path(jaxstab.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(f"{path.relative_to(root).as_posix()}\n".encode() + path.read_bytes())
    code = digest.hexdigest()[:16]
    versions = f"NumPy {np.__version__}, Python {platform.python_version()}"
    return f"jaxstab {jaxstab.__version__} (code {code}), {versions}"


# ----------------------------------------------------------------------- where tiles are computed


def images(
    compute: Callable[[Item], bytes],
    items: Sequence[Item],
    at_once: int,
    executor: Executor | None,
) -> Generator[tuple[Item, bytes], None, None]:
    """Yield tiles and their images as they are done, and keep few of them waiting."""
    if executor is None:
        for item in items:
            yield item, compute(item)
        return
    left = iter(items)
    running: dict[Future[bytes], Item] = {}
    try:
        while True:
            for item in islice(left, at_once - len(running)):
                running[executor.submit(compute, item)] = item
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


@contextmanager
def processes(count: int) -> Iterator[Executor]:
    """Open worker processes, spawned: a process that has used JAX must not be forked.

    They leave Ctrl-C to this process, from their first instruction on. They end with it, however it
    ends, and at once, whatever they are computing, where an error leaves the ``with`` statement.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    with ours, theirs, _Processes(count, context, _end_with, (theirs,)) as executor:
        try:
            yield executor
        except BaseException:
            ours.close()
            executor.forget_tasks()
            raise


class _Processes(ProcessPoolExecutor):
    """Processes that are started, each by a ``submit``, with Ctrl-C held back."""

    def submit(self, *given: Any, **options: Any) -> Future[Any]:
        with _interrupts_held():
            return super().submit(*given, **options)

    def forget_tasks(self) -> None:
        """Let this process end though a task is on its way that no worker will read."""
        # Python before 3.12.2 would wait for ever (https://github.com/python/cpython/issues/94777).
        self._call_queue.cancel_join_thread()  # type: ignore[attr-defined]


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back until the end, and for good from processes that are started meanwhile."""
    # They inherit what this thread blocks; Python would still interrupt its main thread.
    is_main = threading.current_thread() is threading.main_thread()
    came = list[int]()
    if is_main:
        former = signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    blocked = _masked(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        _masked(signal.SIG_SETMASK, blocked)
        if is_main:
            signal.signal(signal.SIGINT, former)
        if came:
            signal.raise_signal(signal.SIGINT)


def _masked(how: int, signals: Iterable[int]) -> Iterable[int]:
    return signal.pthread_sigmask(how, signals) if os.name == "posix" else set()


def _end_with(parent: Connection) -> None:
    """Leave Ctrl-C to the parent, and end when it closes its end of a pipe, or ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def wait_for_end() -> None:
        with suppress(EOFError, OSError):
            parent.recv_bytes()
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
        yield _of_client(client)


def _of_client(client: Any) -> Executor:
    made: Executor = client.get_executor(pure=False, retries=3)
    return made


def _own_client() -> Executor | None:
    """Return the workers of the dask client of this process, if it has opened one."""
    if "distributed" not in sys.modules:
        return None
    from distributed import default_client  # inside a task get_client would wait for itself

    with suppress(ValueError):
        return _of_client(default_client())
    return None


# --------------------------------------------------------------------------- where they are stored


@dataclass(frozen=True)
class Shards:
    """The images of the tiles of one job (``key``) in its folder; ``shards_of`` makes it.

    ``former`` is the file at the path of the job when it began.
    """

    folder: Folder
    key: str
    former: Identity = None

    def put(self, name: str, image: bytes) -> None:
        """Store the image of a tile, durably."""
        with named_errors("write", self.folder.path):
            self.folder.put(f"{name}.tile", image)

    def read(self, name: str) -> bytes:
        """The image of a tile; OSError without one."""
        return self.folder.read(f"{name}.tile")

    def has(self, job: Job[Any], item: Any) -> bool:
        """Whether the image of a tile is here, whole and of its job."""
        try:
            return job.is_done(item, self.read(job.name(item)))
        except OSError:
            return False

    def has_any(self) -> bool:
        """Whether the image of any tile is here."""
        return any(name.endswith(".tile") for name in self.folder.names())

    def clear(self, pattern: re.Pattern[str] = _OURS) -> None:
        """Remove what jobs put into the folder, and nothing else."""
        for name in self.folder.names():
            if pattern.fullmatch(name):
                self.folder.remove(name)

    def remove(self) -> None:
        """Remove the tiles and the folder, the lock last: until then it keeps others out."""
        # Another process may have made a new lock by then, and continue in the folder.
        with suppress(OSError):
            self.clear()
            self.folder.remove(_LOCK)
            os.rmdir(self.folder.path)


@contextmanager
def shards_of(path: Path, key: str) -> Iterator[Shards]:
    """Open, or make, the folder of a job whose file goes to a path, for this process alone.

    It stays for the next run of the same job unless it is empty, or removed. OSError: it cannot
    be made or locked, it is a link, another user's or open to others, there is something else than
    a file at the path, or another process does this job.
    """
    with ExitStack() as stack:
        with named_errors("write", path):
            target, _ = target_of(path)
            place = target.with_name(f".{target.name}.{key[:16]}.tiles")
            shards = replace(_locked(place, key, stack), former=identity_of(target))
        try:  # the system opens the lock when this process ends in whatever way
            shards.clear(_LEFT_OVER)
            yield shards
        finally:
            if not shards.has_any():
                shards.remove()


def _locked(place: Path, key: str, stack: ExitStack) -> Shards:
    """Return the folder of a job, open and locked until the stack is left."""
    for _ in range(_ATTEMPTS):
        with ExitStack() as attempt, suppress(_GoneError):
            try:
                shards = Shards(attempt.enter_context(own_folder(place)), key)
            except FileNotFoundError as error:
                if place.parent.is_dir():
                    raise _GoneError from error
                raise
            attempt.callback(os.close, _lock_in(shards))
            stack.push(attempt.pop_all())
            return shards
    raise BlockingIOError(errno.EAGAIN, _BUSY)


class _GoneError(Exception):
    """Who had the lock removed the folder in the meantime."""


def _lock_in(shards: Shards) -> int:
    try:
        lock = shards.folder.open(_LOCK, os.O_RDWR | os.O_CREAT, 0o600)
    except FileNotFoundError as error:
        raise _GoneError from error
    try:
        _lock(lock)
        if not shards.folder.has(_LOCK, lock):
            raise _GoneError
    except BaseException as error:
        os.close(lock)
        if not isinstance(error, BlockingIOError | _GoneError) and not shards.has_any():
            shards.remove()
        raise
    return lock


def _lock(descriptor: int) -> None:
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError) as error:
        raise BlockingIOError(error.errno, _BUSY) from error
    except OSError as error:
        words = f"its folder cannot be locked ({error.strerror}), so build it elsewhere and copy it"
        raise OSError(error.errno, words) from error
