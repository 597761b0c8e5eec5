"""Files: what is written is read; what is damaged, foreign or hostile is refused in a sentence."""

import os
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from math import prod
from pathlib import Path

import h5py
import numpy as np
import pytest
from atlases import (
    SMALL,
    edited,
    small_contents,
    small_file,
    small_image,
    small_table,
    write_small,
)
from footers import image_of, sealed
from hostile import retold, sub
from hostile_images import IMAGES, with_another_image

import jaxstab
from jaxstab import open_atlas, plan_atlas
from jaxstab.atlas import file, schema
from jaxstab.atlas.plan import compute_tile
from jaxstab.atlas.product import NODE
from jaxstab.atlas.products.table import PRODUCTS
from jaxstab.atlas.write.build import verify_atlas
from jaxstab.atlas.write.variables import filters_of, packed
from jaxstab.model import by_name

FOREIGN = {
    "empty": b"",
    "short": b"jaxstab\n",
    "text": b"alpha,beta\n" * 99,
    "zeros": bytes(5000),
}


def ask_for_all(path: Path) -> dict[str, np.ndarray]:
    return dict(open_atlas(path).arrays)


def refusal(path: Path, ask: Callable[[Path], object] = open_atlas) -> str:
    """What a reader is told, in one sentence."""
    with pytest.raises(ValueError, match=r"\.$") as caught:
        ask(path)
    assert "\n" not in str(caught.value)
    assert path.name in str(caught.value)
    return str(caught.value)


# --------------------------------------------------------------------------------------- round trip


def variables_of_small() -> list[str]:
    chosen = [name for product in SMALL.products for name in PRODUCTS[product].names]
    return [name for name in schema.VARIABLES if name in schema.ALWAYS.union(chosen)]


def test_what_is_computed_is_read(tmp_path: Path) -> None:
    arrays, plan = file.read(write_small(tmp_path)), plan_atlas(SMALL)
    assert arrays.table.created_by == f"jaxstab {jaxstab.__version__}"
    assert list(arrays) == variables_of_small()
    for tile in plan.tiles:
        for name, values in compute_tile(plan, tile).items():
            places = (plan.numbers(d, tile) for d in schema.VARIABLES[name].dimensions)
            assert arrays[name].dtype == values.dtype
            np.testing.assert_array_equal(arrays[name][np.ix_(*places)], values)


def test_every_dataset_is_checksummed_and_has_units_words_and_dimensions(tmp_path: Path) -> None:
    """As any HDF5 program sees it: the footer does not disturb one."""
    with h5py.File(write_small(tmp_path)) as opened:
        assert set(opened) == set(variables_of_small())
        for name, dataset in opened.items():
            assert dataset.fletcher32
            assert (
                dataset.shuffle
                == (dataset.compression == "gzip")
                == schema.VARIABLES[name].is_packed
            )
            assert dataset.attrs["long_name"].decode()
            assert dataset.attrs["interpretation"].decode()
            variable = schema.VARIABLES[name]
            assert dataset.is_scale == variable.is_axis
            if not variable.is_axis:
                scales = [dimension[0].name for dimension in dataset.dims]
                assert scales == [f"/{dimension}" for dimension in variable.dimensions]
        meanings = opened["verdict"].attrs["flag_meanings"].decode().split()
        flags = dict(zip(opened["verdict"].attrs["flag_values"], meanings, strict=True))
        assert flags == {0: "not_computed", 1: "stable", 2: "unstable", 3: "undecided"}


@pytest.mark.parametrize("size", [1, 2, 3, 1000, 100_003, 1_000_000])
@pytest.mark.parametrize("dtype", ["<f4", "<i2", "<i4"])
def test_hdf5_reads_packed_chunks_and_has_the_same_checksum_of_them(
    dtype: str, size: int, rng: np.random.Generator
) -> None:
    for values in (rng.normal(0.0, 1e4, size).astype(dtype), np.ones(size, dtype)):
        chunk = packed(values)
        with h5py.File.in_memory() as opened:
            options = {"chunks": (size,), "dtype": dtype, **filters_of(schema.VARIABLES["outside"])}
            opened.create_dataset("x", (size,), **options).id.write_direct_chunk((0,), chunk)
            np.testing.assert_array_equal(opened["x"][()], values)
            deflated = np.frombuffer(chunk[: -schema.CHECKSUM_SIZE], np.uint8)
            opened.create_dataset("y", data=deflated, chunks=deflated.shape, fletcher32=True)
            assert opened["y"].id.read_direct_chunk((0,)) == (0, chunk)


@pytest.mark.parametrize("version", [1, 2, 99])
def test_a_file_of_another_version_of_the_schema_is_refused_with_the_remedy(
    version: int, tmp_path: Path
) -> None:
    path = tmp_path / "other.h5"
    path.write_bytes(retold(small_file(), sub("atlas 3", f"atlas {version}")))
    assert f"schema version {version}, and this jaxstab reads version 3; use" in refusal(path)
    path.write_bytes(sealed(small_image()))
    assert "has no table of schema version 3" in refusal(path)


# ------------------------------------------------------------------------------------------- damage


@pytest.mark.parametrize("name", FOREIGN)
def test_a_foreign_file_is_refused(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(FOREIGN[name])
    refusal(path)


def test_another_hdf5_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.h5"
    with h5py.File(path, "w") as other:
        other["verdict"] = np.ones((2, 2))
    refusal(path)
    path.write_bytes(sealed(path.read_bytes()))
    refusal(path)


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"nowhere\.h5"):
        open_atlas(tmp_path / "nowhere.h5")
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path, tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(OSError, match="cannot read"):
            open_atlas(path)


@pytest.mark.parametrize("fill", [b"\x00", b"\xff"])
def test_every_sector_that_was_wiped_is_noticed(fill: bytes, tmp_path: Path) -> None:
    path = write_small(tmp_path)
    whole = path.read_bytes()
    for start in range(0, len(whole), 512):
        damaged = whole[:start] + fill * len(whole[start : start + 512]) + whole[start + 512 :]
        if damaged != whole:
            path.write_bytes(damaged)
            refusal(path)


def test_every_flipped_bit_and_every_truncation_is_noticed(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    path = write_small(tmp_path)
    whole = path.read_bytes()
    for place in rng.integers(0, 8 * len(whole), 5000).tolist():
        damaged = bytearray(whole)
        damaged[place // 8] ^= 1 << (place % 8)
        assert image_of(bytes(damaged)) is None
    path.write_bytes(damaged)
    refusal(path)
    for length in rng.integers(0, len(whole), 200):
        path.write_bytes(whole[:length])
        refusal(path)
    path.write_bytes(whole + b"\0")
    refusal(path)


# --------------------------------------------------------------------------------- hostile contents


def test_damage_under_a_right_footer_is_refused_or_changes_no_value(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    """The digests of the chunks behind the footer: the rest of the image is not looked at."""
    image, path = small_image(), tmp_path / "sealed.h5"
    for place in rng.integers(0, 8 * len(image), 200).tolist():
        damaged = bytearray(image)
        damaged[place // 8] ^= 1 << (place % 8)
        path.write_bytes(sealed(bytes(damaged), small_table()))
        is_refused_or_as_it_was(path)


def is_refused_or_as_it_was(path: Path) -> None:
    try:
        arrays = ask_for_all(path)
    except ValueError:
        return
    for name, values in small_contents().items():
        np.testing.assert_array_equal(arrays[name], values)


@pytest.mark.parametrize("name", IMAGES)
def test_an_image_that_is_not_as_the_table_says_changes_no_answer_and_fails_verification(
    name: str, tmp_path: Path
) -> None:
    path = tmp_path / "hostile.h5"
    path.write_bytes(with_another_image(small_file(), IMAGES[name]))
    is_refused_or_as_it_was(path)
    assert not all(check.passed for check in islice(verify_atlas(path, 1), 3))


@pytest.mark.parametrize("name", ["verdict", "cell_verdict"])
def test_a_code_that_is_none_is_refused_when_it_is_asked_for(name: str, tmp_path: Path) -> None:
    path = tmp_path / "hostile.h5"
    path.write_bytes(edited(lambda f: f[name].__setitem__((0, 0, 0, 0, 0), 77)))
    assert "is damaged" in refusal(path, ask_for_all)
    atlas = open_atlas(path)
    assert refusal(path, lambda _: atlas.arrays[name]) == refusal(path, ask_for_all)


# ----------------------------------------------------------------------------- what is read when


def test_whatever_becomes_of_the_file_an_opened_atlas_answers_as_before(tmp_path: Path) -> None:
    path = write_small(tmp_path)
    whole, point = ask_for_all(path), (0.1, 0.5, 0.0005, 0.01, 0.0)
    known = open_atlas(path).query(**by_name(*point))
    atlas = open_atlas(path)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2] + bytes(len(data)))
    answer = atlas.query(**by_name(*point))
    assert answer.verdict == known.verdict
    path.unlink()
    for name, values in whole.items():
        np.testing.assert_array_equal(atlas.arrays[name], values)


def test_threads_that_ask_for_an_array_first_share_it(tmp_path: Path) -> None:
    atlas = open_atlas(write_small(tmp_path))
    names = [name for name in atlas.arrays for _ in range(8)]
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(atlas.arrays.__getitem__, names))
    assert all(values is atlas.arrays[name] for name, values in zip(names, found, strict=True))


def test_a_fork_while_threads_unpack_can_read_on(tmp_path: Path) -> None:
    """In a process of its own: JAX has threads in this one."""
    path = write_small(tmp_path)
    script = f"""
import os, threading
from jaxstab import open_atlas
def unpack():
    for _ in range(200):
        dict(open_atlas({str(path)!r}).arrays)
threads = [threading.Thread(target=unpack) for _ in range(2)]
for thread in threads: thread.start()
for _ in range(20):
    child = os.fork()
    if child == 0:
        dict(open_atlas({str(path)!r}).arrays)
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
os._exit(0)
"""
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", script], timeout=100, check=False)
    assert done.returncode == 0


def test_what_is_too_large_is_refused_and_the_rest_answers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_small(tmp_path)
    monkeypatch.setattr(file, "LARGEST_ARRAY", path.stat().st_size - 1)
    assert "read into memory" in refusal(path)
    monkeypatch.undo()
    monkeypatch.setattr(file, "LARGEST_UNASKED", 0)
    monkeypatch.setattr(schema, "LARGEST_EXPANSION", 1)
    atlas = open_atlas(path)
    size = 4 * prod(atlas.arrays[name].size for name in NODE)
    assert f"has {size} bytes of frequency" in refusal(path, lambda _: atlas.arrays["frequency"])
    assert atlas.verdict(0.1, 0.5, gamma=0.0005, delta=0.01, delay=0.0) == jaxstab.Verdict.STABLE
    with pytest.raises(KeyError):
        atlas.arrays["passengers"]
