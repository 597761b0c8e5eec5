"""Builders of one atlas that meet; prints how many rounds, successes and refusals there were.

Run with a path, what they do (`together`; `unlocked`, where all have the lock; or `stopped` at
each call of the system in turn) and a number: of rounds, or of the calls from one stop to the next.
As for ``killed_builds`` all that is computed comes pickled from stdin.
"""

import fcntl
import os
import pickle
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from jaxstab import build_atlas, tiles
from jaxstab.atlas.write import build

FORMER = b"the former file"
BUILDERS = 4
CALLS = ("write", "fsync", "ftruncate", "unlink", "rmdir", "open", "mkdir", "replace", "close")
spec, key, images, whole = pickle.load(sys.stdin.buffer)
path, deed, number = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])


def stored_images(_: Any, items: Any, *__: Any) -> Iterator[Any]:
    for tile in items:
        yield tile, images[tile]


build.build_key, tiles.images = (lambda *_: key), stored_images


def built() -> int:
    """0 where this process built the atlas, 1 where another one did, 2 for what should not be."""
    try:
        build_atlas(spec, path)
    except BlockingIOError:
        return 1
    except (OSError, KeyError, ValueError, RuntimeError) as error:
        sys.stderr.write(f"{error!r}\n")
        return 2
    return 0


def fork(deed: Callable[[], int]) -> int:
    child = os.fork()
    if child == 0:
        os._exit(deed())
    return child


def together() -> list[int]:
    children = [fork(built) for _ in range(BUILDERS)]
    codes = []
    for child in children:
        assert path.read_bytes() in (FORMER, whole)
        codes.append(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
    return codes


def stopping_at(call: int) -> int:
    """Build, with a stop before a call of the system."""
    count = 0

    def counted(real: Callable[..., Any]) -> Callable[..., Any]:
        def counting(*given: Any, **options: Any) -> Any:
            nonlocal count
            count += 1
            if count == call:
                os.kill(os.getpid(), signal.SIGSTOP)
            return real(*given, **options)

        return counting

    for name in CALLS:
        setattr(os, name, counted(getattr(os, name)))
    return built()


def stopped(call: int) -> list[int]:
    """Build with one that stands still, and then let it go on; nothing where it never stood."""
    child = fork(lambda: stopping_at(call))
    _, status = os.waitpid(child, os.WUNTRACED)
    if not os.WIFSTOPPED(status):
        return []
    codes = [os.waitstatus_to_exitcode(os.waitpid(fork(built), 0)[1])]
    assert path.read_bytes() in (FORMER, whole)
    os.kill(child, signal.SIGCONT)
    return [*codes, os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])]


if deed == "unlocked":
    fcntl.flock = lambda *_: None
rounds, counts = 0, [0, 0, 0]
for place in range(1, 10**6, number) if deed == "stopped" else range(number):
    path.write_bytes(FORMER)
    codes = stopped(place) if deed == "stopped" else together()
    if not codes:
        break
    rounds += 1
    for code in codes:
        counts[code] += 1
    assert path.read_bytes() == (whole if 0 in codes else FORMER)
    if deed != "unlocked":
        assert 0 in codes, codes
        assert os.listdir(path.parent) == [path.name], os.listdir(path.parent)
sys.stdout.write(" ".join(map(str, [rounds, *counts])))
