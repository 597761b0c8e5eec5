"""A build ends in the old file, the new file or a refusal, and goes on where the last one ended."""

import errno
import hashlib
import itertools
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py
import jax
import numpy as np
import pytest
from builds import FORMER, KEY, TINY, entries, tiny_build, tiny_images, tiny_plan
from campaign import many
from counts import note
from hostile import retold, sub

import jaxstab
from jaxstab import build_atlas, durable, open_atlas
from jaxstab.atlas.plan import Plan, Tile
from jaxstab.atlas.products.table import PRODUCTS
from jaxstab.atlas.schema import VARIABLES
from jaxstab.atlas.write import build
from jaxstab.tiles import shards_of

LONG = pytest.mark.campaign
KILLS = Path(__file__).with_name("killed_builds.py")


@pytest.fixture(scope="module")
def plan() -> Plan:
    return tiny_plan()


@pytest.fixture(scope="module")
def images() -> dict[Tile, bytes]:
    return tiny_images()


@pytest.fixture
def computed(images: dict[Tile, bytes], monkeypatch: pytest.MonkeyPatch) -> list[Tile]:
    """The tiles that were computed; they come at once, from what was computed before."""
    asked: list[Tile] = []

    def stored(_: Any, tiles: list[Tile], *__: Any) -> Iterator[tuple[Tile, bytes]]:
        for tile in tiles:
            asked.append(tile)
            yield tile, images[tile]

    monkeypatch.setattr(build, "build_key", lambda *_: KEY)
    monkeypatch.setattr("jaxstab.tiles.images", stored)
    return asked


@pytest.fixture
def whole(computed: list[Tile], tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The bytes of the atlas when nothing goes wrong."""
    path = tmp_path_factory.mktemp("whole") / "a.h5"
    build_atlas(TINY, path)
    computed.clear()
    return path.read_bytes()


def stop_after(count: int) -> Callable[[int, int], None]:
    """A progress that is told of so many tiles, and then of Ctrl-C."""

    def tell(done: int, total: int) -> None:
        if done == count:
            raise KeyboardInterrupt

    return tell


# ----------------------------------------------------------------------------------------- going on


@pytest.mark.parametrize("done", [0, 1, 3, 4])
def test_an_interrupted_build_goes_on_where_it_ended(
    done: int, whole: bytes, computed: list[Tile], plan: Plan, tmp_path: Path
) -> None:
    path, told = tmp_path / "a.h5", []
    path.write_bytes(FORMER)
    with pytest.raises(KeyboardInterrupt):
        build_atlas(TINY, path, stop_after(done))
    assert path.read_bytes() == FORMER
    assert len(entries(tmp_path)) == (2 if done else 1)
    computed.clear()
    build_atlas(TINY, path, lambda *progress: told.append(progress))
    assert computed == plan.tiles[done:]
    assert told == [(count, 4) for count in range(done, 5)]
    assert path.read_bytes() == whole
    assert entries(tmp_path) == ["a.h5"]


def damaged(data: bytes) -> bytes:
    return data[:100] + bytes([data[100] ^ 1]) + data[101:]


@pytest.mark.parametrize(
    "damage", [damaged, lambda data: data[:-1], lambda data: b"", lambda data: data * 2]
)
def test_a_damaged_tile_is_computed_again(
    damage: Callable[[bytes], bytes],
    whole: bytes,
    computed: list[Tile],
    plan: Plan,
    tmp_path: Path,
) -> None:
    path = tmp_path / "a.h5"
    with pytest.raises(KeyboardInterrupt):
        build_atlas(TINY, path, stop_after(4))
    (folder,) = tmp_path.iterdir()
    shard = next(folder.glob("1-0-*.tile"))
    shard.write_bytes(damage(shard.read_bytes()))
    computed.clear()
    build_atlas(TINY, path)
    assert [tile[::2] for tile in computed] == [(0, 1)]
    assert path.read_bytes() == whole


def test_a_tile_of_another_place_or_build_is_not_taken(
    whole: bytes, computed: list[Tile], plan: Plan, images: dict[Tile, bytes], tmp_path: Path
) -> None:
    path = tmp_path / "a.h5"
    first, second, third, _ = plan.tiles
    with shards_of(path, KEY) as shards:
        shards.put(tiny_build().name(first), images[second])
        shards.put(tiny_build().name(second), images[second])
        shards.put(tiny_build().name(third), tiny_build("1" * 64).image(third))
    build_atlas(TINY, path)
    assert computed == [first, *plan.tiles[2:]]
    assert path.read_bytes() == whole


def test_the_digest_of_the_content_is_that_of_its_description(whole: bytes) -> None:
    """As in data/README.md, written once more from its words."""
    digest = hashlib.sha256()
    with h5py.File.in_memory(whole) as opened:
        for name in (name for name in VARIABLES if name in opened):
            dataset = opened[name]
            shapes = ("x".join(map(str, shape)) for shape in (dataset.shape, dataset.chunks))
            chunks = [
                hashlib.sha256(dataset[place].astype(dataset.dtype.newbyteorder("<")).tobytes())
                for place in dataset.iter_chunks()
            ]
            words = [name, dataset.dtype.str, *shapes, *(chunk.hexdigest() for chunk in chunks)]
            digest.update((" ".join(words) + "\n").encode())
        assert digest.hexdigest() == opened.attrs["content_sha256"].decode()


# ------------------------------------------------------------------------------------------ workers


def test_what_is_not_in_float64_is_refused_in_the_worker(
    plan: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    wrong = {"verdict": np.zeros((3, 2, 1, 1, 1))}
    monkeypatch.setattr(PRODUCTS["verdict"], "compute", lambda *_: wrong)
    with pytest.raises(RuntimeError, match=r"verdict was computed as float64 .*, not as int8"):
        tiny_build().image(plan.tiles[0])


def test_a_worker_computes_in_float64_whatever_its_process_was_set_to(
    plan: Plan, images: dict[Tile, bytes]
) -> None:
    with jax.enable_x64(False):
        assert tiny_build().image(plan.tiles[0]) == images[plan.tiles[0]]


# ----------------------------------------------------------------------------------- failing writes


def failing_write(error: int, after: int) -> Callable[[int, bytes], int]:
    """An os.write that writes by small pieces and fails at last, as on a full disk."""
    real_write, calls = os.write, iter(range(after))

    def write(descriptor: int, data: bytes) -> int:
        if next(calls, None) is None:
            raise OSError(error, os.strerror(error))
        return real_write(descriptor, bytes(data[:1000]))

    return write


@pytest.mark.parametrize(
    "error",
    [
        errno.ENOSPC,
        *(pytest.param(e, marks=pytest.mark.campaign) for e in (errno.EIO, errno.EDQUOT)),
    ],
)
@pytest.mark.usefixtures("computed")
def test_a_full_disk_leaves_the_former_file_and_the_tiles_that_are_done(
    error: int, whole: bytes, tmp_path: Path
) -> None:
    """Each write in turn is the first that fails, up to those of the merge, until none does."""
    path, told = tmp_path / "a.h5", []
    for after in itertools.count():
        path.write_bytes(FORMER)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(os, "write", failing_write(error, after))
            try:
                build_atlas(TINY, path)
                break
            except OSError as caught:
                told.append((caught.errno, str(caught).count("cannot write")))
        assert path.read_bytes() == FORMER
        assert [name for name in entries(tmp_path) if name.endswith(".part")] == []
        for folder in tmp_path.glob(".*.tiles"):
            assert {entry.suffix for entry in folder.iterdir()} <= {".tile", ""}
    assert told == [(error, 1)] * after
    assert after > 20
    note(f"writes that failed with {errno.errorcode[error]}", tried=after, torn=0)
    assert path.read_bytes() == whole
    assert entries(tmp_path) == ["a.h5"]


@pytest.mark.parametrize("step", ["fsync", "replace", "open", "ftruncate"])
@pytest.mark.usefixtures("computed")
def test_a_failure_of_any_step_is_a_sentence_and_leaves_no_file(
    step: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(os, step, fail)
    with pytest.raises(OSError, match=r"cannot write .*\.$"):
        build_atlas(TINY, tmp_path / "new.h5")
    assert not (tmp_path / "new.h5").exists()


def test_a_place_that_cannot_be_written_is_known_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("jaxstab.atlas.write.tiles.plan_atlas", None)
    (tmp_path / "file").write_text("not a folder")
    (tmp_path / "folder").mkdir()
    for error, place in (
        (FileNotFoundError, tmp_path / "missing" / "new.h5"),
        (IsADirectoryError, tmp_path / "folder"),
        (NotADirectoryError, tmp_path / "file" / "new.h5"),
    ):
        with pytest.raises(error, match=f"cannot write {place}: .*\\.$"):
            build_atlas(TINY, place)
    assert entries(tmp_path) == ["file", "folder"]


# ------------------------------------------------------------------------------------ sudden deaths


class DeadError(BaseException):
    """Nothing reaches the disk any more."""


class Death:
    """The death of this process after so many calls of the system, as far as the disk can tell."""

    def __init__(self, patch: pytest.MonkeyPatch, after: int) -> None:
        self.calls, self.after = 0, after
        silent: dict[str, Callable[..., Any]] = {
            "write": lambda _, data: len(data),
            "fsync": lambda *_, **__: None,
            "ftruncate": lambda *_, **__: None,
            "unlink": lambda *_, **__: None,
            "rmdir": lambda *_, **__: None,
        }
        for name in (*silent, "open", "mkdir", "replace"):
            patch.setattr(os, name, self.mortal(getattr(os, name), silent.get(name)))

    def mortal(self, call: Callable[..., Any], after: Callable[..., Any] | None) -> Any:
        def mortal_call(*given: Any, **options: Any) -> Any:
            self.calls += 1
            if self.calls <= self.after:
                return call(*given, **options)
            if after is None:
                raise DeadError
            return after(*given, **options)

        return mortal_call


@pytest.mark.campaign
@pytest.mark.usefixtures("computed")
def test_after_a_death_at_any_call_there_is_the_old_file_or_the_new_one_and_a_build_mends_all(
    whole: bytes, tmp_path: Path
) -> None:
    path = tmp_path / "a.h5"
    found = set()
    for after in itertools.count():
        path.write_bytes(FORMER)
        with pytest.MonkeyPatch.context() as patch:
            death = Death(patch, after)
            with suppress(DeadError, OSError, ValueError):  # the dead find what they did not write
                build_atlas(TINY, path)
        found.add(path.read_bytes())
        build_atlas(TINY, path)
        assert path.read_bytes() == whole
        assert entries(tmp_path) == ["a.h5"]
        if death.calls <= after:
            break
    assert after > 60
    assert found == {FORMER, whole}
    note("deaths at each call of the system", tried=after, torn=0)


@pytest.mark.campaign
@pytest.mark.usefixtures("computed")
def test_kill_9_at_any_time_leaves_the_old_file_or_the_new_one(
    whole: bytes, images: dict[Tile, bytes], tmp_path: Path
) -> None:
    kills = many(1000)
    campaign = subprocess.run(
        [sys.executable, str(KILLS), str(tmp_path / "a.h5"), str(kills)],
        input=pickle.dumps((TINY, KEY, images, whole)),
        env=os.environ | {"JAX_ENABLE_X64": "1"},
        capture_output=True,
        check=False,
    )
    assert campaign.returncode == 0, campaign.stderr.decode()
    former, new = map(int, campaign.stdout.split())
    assert former + new == kills
    assert min(former, new) > 0
    note("kills at random", tried=kills, former_file=former, new_file=new, torn=0)


# ------------------------------------------------------------------------------------- file systems


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of our own, of 64 kB."""
    command = ["mount", "-t", "tmpfs", "-o", "size=64k", "jaxstab", str(tmp_path)]
    if subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("mounting a file system needs root")
    yield tmp_path
    subprocess.run(["umount", str(tmp_path)], check=True)


def remount(disk: Path, option: str) -> None:
    subprocess.run(["mount", "-o", f"remount,{option}", str(disk)], check=True)


@pytest.mark.campaign
@pytest.mark.usefixtures("computed")
@pytest.mark.parametrize("free", [0, 4096, 8192, 16384, 24576])
def test_on_a_full_disk_the_build_is_refused_and_goes_on_when_there_is_room(
    free: int, whole: bytes, disk: Path
) -> None:
    path = disk / "a.h5"
    path.write_bytes(FORMER)
    (disk / "other").write_bytes(bytes(max(0, 64 * 1024 - 8192 - free)))
    with pytest.raises(OSError, match=rf"cannot write .*: {os.strerror(errno.ENOSPC)}\.$"):
        build_atlas(TINY, path)
    assert path.read_bytes() == FORMER
    remount(disk, "size=1m")
    build_atlas(TINY, path)
    assert path.read_bytes() == whole
    assert entries(disk) == ["a.h5", "other"]


@pytest.mark.usefixtures("computed")
def test_in_a_read_only_folder_the_build_is_refused_before_the_work(disk: Path) -> None:
    (disk / "a.h5").write_bytes(FORMER)
    remount(disk, "ro")
    with pytest.raises(OSError, match=rf"cannot write .*: {os.strerror(errno.EROFS)}\.$"):
        build_atlas(TINY, disk / "a.h5")
    assert entries(disk) == ["a.h5"]


@pytest.mark.campaign
def test_readers_meet_the_old_atlas_or_the_new_one_while_it_is_published(
    whole: bytes, tmp_path: Path
) -> None:
    path = tmp_path / "a.h5"
    versions = [retold(whole, sub("made by [^\n]*", "made by another")), whole]
    path.write_bytes(whole)
    done, met = threading.Event(), set()

    def read() -> None:
        while not done.is_set():
            atlas = open_atlas(path)
            met.add(atlas.created_by)
            assert len(dict(atlas.arrays)) == len(atlas.arrays)  # each of them unpacked

    with ThreadPoolExecutor(2) as readers:
        reading = [readers.submit(read) for _ in range(2)]
        for number in range(200):
            durable.publish(versions[number % 2], path)
        done.set()
        assert [reader.result() for reader in reading] == [None, None]
    assert met == {"another", f"jaxstab {jaxstab.__version__}"}
