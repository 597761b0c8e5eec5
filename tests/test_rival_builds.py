"""Two builds of one atlas: one of them publishes it whole, and the other is refused."""

import errno
import fcntl
import os
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from builds import FORMER, KEY, TINY, entries, tiny_images
from campaign import many
from counts import note

from jaxstab import build_atlas, durable
from jaxstab.tiles import shards_of

LONG = pytest.mark.campaign
MANY = many(1000, small=50)
RIVALS = Path(__file__).with_name("rival_builds.py")


def test_two_processes_do_not_build_one_atlas_at_a_time(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with (
        shards_of(path, KEY),
        pytest.raises(BlockingIOError, match="another process"),
        shards_of(path, KEY),
    ):
        pass
    assert entries(tmp_path) == []


@pytest.mark.parametrize("error", [errno.ENOLCK, errno.ENOSYS, errno.EIO])
def test_where_nothing_can_be_locked_the_build_is_refused(
    error: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(error, os.strerror(error))

    monkeypatch.setattr(fcntl, "flock", fail)
    with pytest.raises(
        OSError, match=r"cannot write .*cannot be locked .*elsewhere and copy it\.$"
    ):
        build_atlas(TINY, tmp_path / "a.h5")
    assert entries(tmp_path) == []


def test_a_lock_that_was_removed_before_it_was_had_locks_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As when another build ends between open and flock."""
    path, flock, opened = tmp_path / "a.h5", fcntl.flock, []

    def late(descriptor: int, how: int) -> None:
        opened.append(descriptor)
        if len(opened) == 1:
            next(tmp_path.glob(".*/lock")).unlink()
        flock(descriptor, how)

    monkeypatch.setattr(fcntl, "flock", late)
    with (
        shards_of(path, KEY),
        pytest.raises(BlockingIOError, match="another process"),
        shards_of(path, KEY),
    ):
        pass
    assert len(opened) == 3
    assert entries(tmp_path) == []


def test_a_temporary_file_that_was_taken_away_is_not_published(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(FORMER)
    writing = durable.replacing(path)
    os.write(writing.__enter__(), b"new")
    part = next(tmp_path.glob(".*.part"))
    part.unlink()
    part.write_bytes(b"of another")
    with pytest.raises(OSError, match=r"cannot write .*another process took its temporary file"):
        writing.__exit__(None, None, None)
    assert path.read_bytes() == FORMER


@pytest.mark.parametrize("former", [None, FORMER])
def test_51_an_atlas_that_another_build_finished_meanwhile_is_kept(
    former: bytes | None, tmp_path: Path
) -> None:
    """Two builds of different specifications begin at the same time and write the same file."""
    path, whole = tmp_path / "a.h5", list[bytes]()
    if former is not None:
        path.write_bytes(former)

    def rival(done: int, total: int) -> None:
        if not whole:
            build_atlas(replace(TINY, delay=[2.0]), path)
            whole.append(path.read_bytes())

    with pytest.raises(FileExistsError, match=r"cannot write .*a\.h5: another process has written"):
        build_atlas(TINY, path, rival)
    assert path.read_bytes() == whole[0] != former


def rivals(folder: Path, *words: str) -> list[int]:
    """Rounds, successes, refusals, and whatever else there was, of builders that meet."""
    build_atlas(TINY, folder / "a.h5")
    whole = (folder / "a.h5").read_bytes()
    done = subprocess.run(
        [sys.executable, str(RIVALS), str(folder / "a.h5"), *words],
        input=pickle.dumps((TINY, KEY, tiny_images(), whole)),
        env=os.environ | {"JAX_ENABLE_X64": "1"},
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr.decode()
    return [*map(int, done.stdout.split())]


@pytest.mark.campaign
@pytest.mark.parametrize("rounds", [20, pytest.param(MANY, marks=LONG)])
def test_four_builders_at_once_publish_one_whole_file(rounds: int, tmp_path: Path) -> None:
    done, successes, refusals, others = rivals(tmp_path, "together", str(rounds))
    assert (done, others) == (rounds, 0)
    assert successes + refusals == 4 * rounds
    assert successes >= rounds
    note("four builders at once", rounds=done, built=successes, refused=refusals, torn=others)


@pytest.mark.campaign
@pytest.mark.parametrize("rounds", [10, pytest.param(MANY // 2, marks=LONG)])
def test_where_all_have_the_lock_nothing_is_torn(rounds: int, tmp_path: Path) -> None:
    """As on a file system that lies: one builder takes the tiles of another away."""
    done, successes, refusals, others = rivals(tmp_path, "unlocked", str(rounds))
    assert done == rounds
    assert successes + refusals + others == 4 * rounds
    assert successes > 0
    note("four builders without locks", rounds=done, built=successes, refused=others, torn=0)


@pytest.mark.campaign
@pytest.mark.parametrize("step", [7, pytest.param(1, marks=LONG)])
def test_a_builder_that_stands_still_anywhere_tears_nothing(step: int, tmp_path: Path) -> None:
    stops, successes, refusals, others = rivals(tmp_path, "stopped", str(step))
    assert stops > 60 // step
    assert others == 0
    assert min(successes, refusals) > 0
    note("stops of a builder", stops=stops, built=successes, refused=refusals, torn=others)
