"""Files that appear whole or not at all, whatever happens to the process or the disk. No JAX.

A file is written beside its place, as ``.jaxstab-*.part``, synchronised, renamed, and the folder is
synchronised. An error removes it, and so does a signal that ends the process, but for SIGKILL. HDF5
cannot be trusted with a full disk (after an error it continues until it reads what was never
written), so it writes to a stream of ours, which keeps the error for us.
"""

import errno
import io
import mmap
import os
import secrets
import signal
import stat
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from os import PathLike
from pathlib import Path
from typing import Any

_ENDING = [getattr(signal, own) for own in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, own)]
OUTPUTS: dict[Path, str] = {}
"""What the command at work is to write, with its options: it may read none of these files."""
_TAKEN = "another process has written it meanwhile; remove that file, or give another name"


def publish(data: bytes, path: Path, *, may_replace: bool = True) -> None:
    """Put a whole file in its place, durably and by one rename, or change nothing."""
    with replacing(path, may_replace=may_replace) as descriptor:
        write_all(descriptor, data)


def identity_of(path: Path) -> tuple[int, ...] | None:
    """The identity of a file, unlike that of any later one of its name; None without one."""
    try:
        status = os.stat(path)
    except FileNotFoundError:
        return None
    return status.st_dev, status.st_ino, status.st_mtime_ns, status.st_size


@contextmanager
def replacing(path: Path, *, may_replace: bool = True) -> Iterator[int]:
    """Yield the descriptor of a new file, which takes the place of the old one if no error occurs.

    OSError: the folder is missing, read-only or full, the path is not that of a file, or the new
    file was removed; or the new file is there, but its name not yet on the disk, as the sentence
    then says; FileExistsError: a file that may not be replaced is at the path, also one that has
    appeared meanwhile.
    """
    with named_errors("write", path):
        target, mode = target_of(path)
        with _temporary(target.parent) as temporary:
            with temporary.open("x+b", buffering=0) as file:
                if mode is not None and hasattr(os, "fchmod"):
                    os.fchmod(file.fileno(), mode)
                yield file.fileno()
                os.fsync(file.fileno())
            if may_replace or not _linked(temporary, target):
                os.replace(temporary, target)
    try:
        _synchronise(target.parent)
    except OSError as error:
        words = "is written and in its place, but may be lost if the power fails now"
        reason = error.strerror or str(error)
        raise type(error)(error.errno, f"{path} {words}: {reason}.") from error


@contextmanager
def _temporary(folder: Path) -> Iterator[Path]:
    """Yield the name of a file that is gone at the end, also where a signal ends the process."""
    path = folder / f".jaxstab-{secrets.token_hex(8)}.part"

    def end(number: int, _: object) -> None:
        with suppress(OSError):
            path.unlink()
        signal.signal(number, signal.SIG_DFL)
        signal.raise_signal(number)

    is_main = threading.current_thread() is threading.main_thread()  # no other may set handlers
    ending = [own for own in _ENDING if is_main and signal.getsignal(own) is signal.SIG_DFL]
    for own in ending:
        signal.signal(own, end)
    try:
        yield path
    finally:
        with suppress(OSError):
            path.unlink()
        for own in ending:
            signal.signal(own, signal.SIG_DFL)


def _linked(path: Path, target: Path) -> bool:
    """Give a file a second name, unless it is taken; False where the file system has no links."""
    try:
        os.link(path, target)
    except OSError as error:
        if os.path.lexists(target):
            raise FileExistsError(errno.EEXIST, _TAKEN) from error
        return False
    return True


def _synchronise(folder: Path) -> None:
    """Make the names in a folder durable."""
    if os.name == "posix":  # elsewhere a folder cannot be opened: the rename is journaled
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def target_of(path: Path) -> tuple[Path, int | None]:
    """The target of a path, behind symbolic links, and the mode of the file there, if any."""
    target = Path(os.path.realpath(path))
    try:
        status = target.stat()
    except FileNotFoundError:
        return target, None
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, "there is a folder of this name")
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "it is a device, a pipe or a socket, not a file")
    return target, stat.S_IMODE(status.st_mode)


def require_no_output(source: str | PathLike[str] | int) -> None:
    """Refuse to read what the command at work is to replace, by any name; FileExistsError."""
    for output, option in OUTPUTS.items():
        try:
            is_same = os.path.samefile(source, output)
        except OSError:  # one of them does not exist
            continue
        if is_same:
            words = f"{option} is {output}, which this command reads; give another name."
            raise FileExistsError(words)


@contextmanager
def named_errors(deed: str, path: Path) -> Iterator[None]:
    """Give an error of the operating system one sentence with the name of the file."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise type(error)(error.errno, f"cannot {deed} {path}: {reason}.") from error


def is_memory_short() -> bool:
    """True if 64 MiB cannot be had: libhdf5 then fails at sound files as at damaged ones."""
    try:
        mmap.mmap(-1, 1 << 26).close()  # asked for, not touched
    except OSError:
        return True
    return False


def write_all(descriptor: int, data: bytes | memoryview) -> None:
    """Write all of the data, however little the system takes at once."""
    with memoryview(data) as view:  # an error would keep it, and the data could not be closed
        done = 0
        while done < len(view):
            done += os.write(descriptor, view[done:])


class PatientStream(io.RawIOBase):
    """A file for HDF5 to write to, which keeps errors from it.

    After the first error nothing more goes to the disk: writes stay in memory, so that reads are
    consistent, and ``check`` raises the error. A long write calls it often.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._place = 0
        self.size = 0  # of the file in bytes
        self._error: OSError | None = None
        self._unwritten: list[tuple[int, bytes]] = []

    def check(self) -> None:
        """Raise the error that came up, if any."""
        if self._error is not None:
            raise self._error

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a place."""
        self._place = (0, self._place, self.size)[whence] + offset
        return self._place

    def truncate(self, size: int | None = None) -> int:
        """Set the size; HDF5 makes the file as long as its last address."""
        self.size = self._place if size is None else size
        return self.size

    def write(self, data: Any) -> int:
        """Write all of the data at this place, to the disk if that can be."""
        written = bytes(data)
        try:
            self.check()
            os.lseek(self._descriptor, self._place, os.SEEK_SET)
            write_all(self._descriptor, written)
        except OSError as error:
            self._error = self._error or error
            self._unwritten.append((self._place, written))
        self._place += len(written)
        self.size = max(self.size, self._place)
        return len(written)

    def readinto(self, buffer: Any) -> int:
        """Read what was written at this place; zeros where nothing was."""
        target = memoryview(buffer)
        start, stop = self._place, self._place + len(target)
        target[:] = bytes(len(target))
        try:
            os.lseek(self._descriptor, start, os.SEEK_SET)
            on_disk = os.read(self._descriptor, len(target))
        except OSError as error:
            self._error = self._error or error
            on_disk = b""
        target[: len(on_disk)] = on_disk
        for place, data in self._unwritten:
            begin, end = max(place, start), min(place + len(data), stop)
            if begin < end:
                target[begin - start : end - start] = data[begin - place : end - place]
        self._place = stop
        return len(target)
