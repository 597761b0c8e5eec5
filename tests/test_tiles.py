"""Tiles in the hidden folder of a build, and from workers: none of others is believed."""

import hashlib
import io
import os
import stat
import sys
from collections.abc import Callable
from concurrent.futures import Executor, Future
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builds import FORMER, KEY, TINY, entries, tiny_build, tiny_images, tiny_plan

from jaxstab import build_atlas, tiles
from jaxstab.atlas.schema import values_digest
from jaxstab.atlas.write import build
from jaxstab.atlas.write.tiles import build_key
from jaxstab.atlas.write.variables import packed
from jaxstab.tiles import shards_of

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="folders are opened by descriptor")


def folder_of(path: Path) -> Path:
    return path.with_name(f".{path.name}.{build_key(TINY)[:16]}.tiles")


@pytest.mark.parametrize("is_tile", [True, False])
def test_24_a_link_in_place_of_the_folder_is_not_followed(is_tile: bool, tmp_path: Path) -> None:
    elsewhere, path = tmp_path / "elsewhere", tmp_path / "a.h5"
    elsewhere.mkdir(mode=0o700)
    (elsewhere / ("0-0-0.tile" if is_tile else "thesis.tex")).write_text("precious")
    folder_of(path).symlink_to(elsewhere)
    with pytest.raises(
        PermissionError, match=r"cannot write .*\.tiles.*is not a folder; remove it"
    ):
        build_atlas(TINY, path)
    assert len(entries(elsewhere)) == 1


def test_24_a_folder_of_others_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.h5"
    folder_of(path).mkdir(mode=0o700)
    folder_of(path).chmod(0o770)
    with pytest.raises(PermissionError, match="is open to other users; remove it"):
        build_atlas(TINY, path)
    folder_of(path).chmod(0o700)
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    with pytest.raises(PermissionError, match="belongs to another user; remove it"):
        build_atlas(TINY, path)
    assert not path.exists()


def test_24_the_folder_is_this_users_alone_and_what_is_not_a_tile_stays(tmp_path: Path) -> None:
    path, modes = tmp_path / "a.h5", []

    def look(done: int, _: int) -> None:
        modes.append(stat.S_IMODE(folder_of(path).stat().st_mode))
        if done == 1:
            (folder_of(path) / "thesis.tex").write_text("precious")

    build_atlas(TINY, path, look)
    assert set(modes) == {0o700}
    assert entries(folder_of(path)) == ["thesis.tex"]


def test_24_the_folder_is_meant_though_its_path_becomes_a_link(tmp_path: Path) -> None:
    """As when another user renames it away and puts a link there while tiles are computed."""
    path, elsewhere = tmp_path / "a.h5", tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "1-0-0.tile").write_text("precious")

    def swap(done: int, _: int) -> None:
        if done == 1:
            folder_of(path).rename(tmp_path / "moved")
            folder_of(path).symlink_to(elsewhere)

    build_atlas(TINY, path, swap)
    assert (elsewhere / "1-0-0.tile").read_text() == "precious"
    assert entries(tmp_path / "moved") == []


Edit = Callable[[dict[str, np.ndarray]], object]


def with_values(arrays: dict[str, np.ndarray], values: np.ndarray, digest: str = "") -> None:
    arrays["verdict"] = np.frombuffer(packed(values), np.uint8)
    if digest:
        arrays["verdict sha256"] = np.array(digest)


WRONG: dict[str, Edit] = {
    "another name": lambda arrays: arrays.update(verdicts=arrays.pop("verdict")),
    "a stranger": lambda arrays: arrays.update(passenger=np.ones(1)),
    "nothing": lambda arrays: arrays.pop("cell_verdict"),
    "no chunk": lambda arrays: arrays.update(verdict=np.zeros(0, np.uint8)),
    "another shape": lambda arrays: with_values(arrays, np.ones((3, 3, 1, 1, 1), np.int8)),
    "another type": lambda arrays: with_values(arrays, np.ones((3, 2, 1, 1, 1), np.int16)),
    "other values": lambda arrays: with_values(arrays, np.ones((3, 2, 1, 1, 1), np.int8)),
    "codes beyond": lambda arrays: with_values(
        arrays, np.full((3, 2, 1, 1, 1), 7, np.int8), values_digest(np.full(6, 7, np.int8))
    ),
    "no digests": lambda arrays: arrays.pop("verdict sha256"),
    "digests of numbers": lambda arrays: arrays.update({"verdict sha256": np.array(1.0)}),
}


def retold(image: bytes, edit: Callable[[list[bytes]], object]) -> bytes:
    """An image after an edit of its three parts (maker, title, archive), with the right seal."""
    parts = image[32:].split(b"\n", 2)
    edit(parts)
    words = b"\n".join(parts)
    return hashlib.sha256(words).digest() + words


def retiled(image: bytes, edit: Edit) -> bytes:
    def edit_archive(parts: list[bytes]) -> None:
        with np.load(io.BytesIO(parts[2])) as archive:
            arrays = dict(archive)
        edit(arrays)
        stream = io.BytesIO()
        np.savez(stream, **arrays)  # type: ignore[arg-type]
        parts[2] = stream.getvalue()

    return retold(image, edit_archive)


@pytest.mark.parametrize("name", WRONG)
def test_24_a_tile_of_wrong_content_with_a_right_seal_is_not_taken(
    name: str, tmp_path: Path
) -> None:
    tile = tiny_plan().tiles[0]
    right, place = tiny_images()[tile], tiny_build().name(tile)
    with shards_of(tmp_path / "a.h5", KEY) as shards:
        shards.put(place, retiled(right, lambda _: None))
        assert shards.has(tiny_build(), tile)
        shards.put(place, retiled(right, WRONG[name]))
        assert not shards.has(tiny_build(), tile)
        shards.remove()


def test_24_a_pipe_in_place_of_a_tile_is_not_waited_for(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    folder_of(path).mkdir(mode=0o700)
    os.mkfifo(folder_of(path) / "0-0-0.tile")
    (folder_of(path) / "1-0-0.tile").symlink_to(path)
    build_atlas(TINY, path)
    assert entries(tmp_path) == ["a.h5"]


def test_24_tiles_of_other_code_are_of_another_build(monkeypatch: pytest.MonkeyPatch) -> None:
    key = build_key(TINY)
    maker = tiles.computed_by()
    assert "code " in maker
    other = lambda: maker.replace("code ", "code 1")  # noqa: E731
    monkeypatch.setattr("jaxstab.atlas.write.tiles.computed_by", other)
    assert build_key(TINY) != key


def test_24_a_merged_file_that_cannot_be_opened_leaves_the_former_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As when a variable is merged wrong, whatever the reason."""
    path = tmp_path / "a.h5"
    path.write_bytes(FORMER)
    monkeypatch.setattr("jaxstab.atlas.write.tiles.table_text", lambda *_: b"no table\n")
    with pytest.raises(ValueError, match=r"a\.h5 make no sound atlas; remove .*build again\.$"):
        build_atlas(TINY, path)
    assert path.read_bytes() == FORMER


# ------------------------------------------------------------------------------------------ workers


class Worker(Executor):
    """A worker on which another jaxstab is installed."""

    def __init__(self, answer: Callable[[], Any]) -> None:
        self.answer = answer

    def submit(self, call: Callable[..., Any], /, *given: Any, **options: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(self.answer())
        except (ImportError, AttributeError, TypeError) as error:
            future.set_exception(error)
        return future


def test_25_tiles_of_workers_of_another_jaxstab_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(build, "build_key", lambda *_: KEY)
    image, maker = tiny_images()[tiny_plan().tiles[0]], tiles.computed_by()
    other = maker.replace("NumPy ", "NumPy 0.")
    path = tmp_path / "a.h5"
    for answer, words in (
        (lambda: retold(image, lambda parts: parts.__setitem__(0, other.encode())), other),
        (lambda: build.no_such_thing, "cannot compute tiles of this build"),
        (lambda: None, "cannot compute tiles of this build"),
    ):
        with pytest.raises(RuntimeError) as refusal:
            build_atlas(TINY, path, executor=Worker(answer))
        assert words in str(refusal.value)
        assert maker in str(refusal.value)
        assert str(refusal.value).count(". ") == 0
    for wrong in (
        image[:-1],
        retold(image, lambda parts: parts.__setitem__(1, b"0-0-9")),
        retiled(image, WRONG["a stranger"]),
    ):
        with pytest.raises(ValueError, match=r"tile \d-\d-\d of .*a\.h5 is damaged; compute"):
            build_atlas(TINY, path, executor=Worker(partial(bytes, wrong)))
    assert entries(tmp_path) == []
