"""Tiles in the hidden folder of a build, and from workers: none of others is believed."""

import os
import stat
import sys
from collections.abc import Callable
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from builds import FORMER, KEY, TINY, entries, tiny_build, tiny_images, tiny_plan

from jaxstab import build_atlas
from jaxstab.atlas.schema import image_of, sealed
from jaxstab.atlas.write import build, tiles
from jaxstab.atlas.write.tiles import VALUES_DIGEST, build_key, name_of
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


Edit = Callable[[h5py.File], object]


def with_values(file: h5py.File, values: np.ndarray, digest: str = "") -> None:
    attributes = dict(file["verdict"].attrs)
    del file["verdict"]
    options = {"shuffle": True, "compression": "gzip", "fletcher32": True, "chunks": values.shape}
    dataset = file.create_dataset("verdict", data=values, **options)
    dataset.attrs[VALUES_DIGEST] = np.bytes_(digest) if digest else attributes[VALUES_DIGEST]


WRONG: dict[str, Edit] = {
    "another name": lambda file: file.move("verdict", "verdicts"),
    "a stranger": lambda file: file.create_dataset("passenger", data=1),
    "a group": lambda file: (file.move("verdict", "v"), file.create_group("verdict")),
    "a link": lambda file: (
        file.move("verdict", "cell_verdict2"),
        file.__setitem__("verdict", h5py.SoftLink("/cell_verdict2")),
    ),
    "nothing": lambda file: file.__delitem__("cell_verdict"),
    "another shape": lambda file: with_values(file, np.ones((3, 3, 1, 1, 1), np.int8)),
    "another type": lambda file: with_values(file, np.ones((3, 2, 1, 1, 1), np.int16)),
    "other values": lambda file: file["verdict"].__setitem__(0, 1),
    "codes beyond": lambda file: with_values(
        file, np.full((3, 2, 1, 1, 1), 7, np.int8), tiles.values_digest(np.full(6, 7, np.int8))
    ),
    "no digests": lambda file: file["verdict"].attrs.__delitem__(VALUES_DIGEST),
    "digests of numbers": lambda file: file["verdict"].attrs.modify(VALUES_DIGEST, 1.0),
    "no title": lambda file: file.attrs.__delitem__("tile"),
}


def retiled(image: bytes, edit: Edit) -> bytes:
    whole = image_of(image)
    assert whole is not None
    with h5py.File.in_memory(whole) as file:
        edit(file)
        file.flush()
        return sealed(bytes(file.id.get_file_image()))


@pytest.mark.parametrize("name", WRONG)
def test_24_a_tile_of_wrong_content_with_a_right_seal_is_not_taken(
    name: str, tmp_path: Path
) -> None:
    tile = tiny_plan().tiles[0]
    right = tiny_images()[tile]
    with shards_of(tmp_path / "a.h5", KEY) as shards:
        shards.put(name_of(tile), right)
        assert shards.has(tiny_build(), tile)
        shards.put(name_of(tile), retiled(right, WRONG[name]))
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
    monkeypatch.setattr(tiles, "computed_by", lambda: maker.replace("code ", "code 1"))
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
        (
            lambda: retiled(
                image, lambda file: file.attrs.__setitem__("computed_by", np.bytes_(other))
            ),
            other,
        ),
        (lambda: retiled(image, lambda file: file.attrs.__delitem__("computed_by")), "an older"),
        (lambda: build.no_such_thing, "cannot compute tiles of this build"),
        (lambda: None, "cannot compute tiles of this build"),
    ):
        with pytest.raises(RuntimeError) as refusal:
            build_atlas(TINY, path, executor=Worker(answer))
        assert words in str(refusal.value)
        assert maker in str(refusal.value)
        assert str(refusal.value).count(". ") == 0
    with pytest.raises(ValueError, match=r"tile \d-\d-\d is (damaged|none of this build);"):
        build_atlas(TINY, path, executor=Worker(lambda: image[:-1]))
    assert entries(tmp_path) == []
