"""Files: what is written is read; what is damaged, foreign or hostile is refused in a sentence."""

import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
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
from hostile import retold, sub

import jaxstab
from jaxstab import open_atlas, plan_atlas
from jaxstab.atlas.compute.products import compute_tile
from jaxstab.atlas.format import footer, schema
from jaxstab.atlas.read import file
from jaxstab.atlas.write.verify import verify_atlas

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


def replace(name: str, **options: object) -> Callable[[h5py.File], None]:
    """An edit that stores a dataset in another way."""

    def edit(opened: h5py.File) -> None:
        values = opened[name][()]
        del opened[name]
        opened.create_dataset(name, **({"data": values} | options))

    return edit


# --------------------------------------------------------------------------------------- round trip


def variables_of_small() -> list[str]:
    chosen = [name for product in SMALL.products for name in schema.PRODUCTS[product]]
    return [name for name in schema.VARIABLES if name in schema.ALWAYS.union(chosen)]


def test_what_is_computed_is_read(tmp_path: Path) -> None:
    contents, plan = file.read(write_small(tmp_path)), plan_atlas(SMALL)
    assert contents.created_by == f"jaxstab {jaxstab.__version__}"
    assert list(contents.arrays) == variables_of_small()
    for tile in plan.tiles:
        for name, values in compute_tile(plan, tile).items():
            places = (plan.numbers(d, tile) for d in schema.VARIABLES[name].dimensions)
            assert contents.arrays[name].dtype == values.dtype
            np.testing.assert_array_equal(contents.arrays[name][np.ix_(*places)], values)


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


@pytest.mark.parametrize("version", [1, 3, 99])
def test_a_file_of_another_version_of_the_schema_is_refused_with_the_remedy(
    version: int, tmp_path: Path
) -> None:
    path = tmp_path / "other.h5"
    path.write_bytes(retold(small_file(), sub("atlas 4", f"atlas {version}")))
    assert f"schema version {version}, and this jaxstab reads version 4; use" in refusal(path)
    path.write_bytes(footer.sealed(small_image()))
    assert "has no table of schema version 4" in refusal(path)


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
    path.write_bytes(footer.sealed(path.read_bytes()))
    refusal(path)


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"nowhere\.h5"):
        open_atlas(tmp_path / "nowhere.h5")
    with pytest.raises(OSError, match="cannot read"):
        open_atlas(tmp_path)


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
        assert footer.image_of(bytes(damaged)) is None
    path.write_bytes(damaged)
    refusal(path)
    for length in rng.integers(0, len(whole), 200):
        path.write_bytes(whole[:length])
        refusal(path)
    path.write_bytes(whole + b"\0")
    refusal(path)


# --------------------------------------------------------------------------------- hostile contents


def soft_link(opened: h5py.File) -> None:
    opened.move("alpha", "hidden")
    opened["alpha"] = h5py.SoftLink("/hidden")


def external_link(opened: h5py.File) -> None:
    del opened["alpha"]
    opened["alpha"] = h5py.ExternalLink("/etc/passwd", "/alpha")


def group(opened: h5py.File) -> None:
    del opened["alpha"]
    opened.create_group("alpha")


def stranger(opened: h5py.File) -> None:
    opened["passengers"] = np.arange(3)


def missing(opened: h5py.File) -> None:
    del opened["alpha"]


def half_a_product(opened: h5py.File) -> None:
    del opened["cell_verdict"]


def virtual(opened: h5py.File) -> None:
    shape = opened["verdict"].shape
    del opened["verdict"]
    layout = h5py.VirtualLayout(shape, np.int8)
    layout[:] = h5py.VirtualSource("elsewhere.h5", "verdict", shape)
    opened.create_virtual_dataset("verdict", layout)


def external_storage(opened: h5py.File) -> None:
    shape = opened["verdict"].shape
    del opened["verdict"]
    opened.create_dataset(
        "verdict", shape, np.int8, external=[("/etc/passwd", 0, h5py.h5f.UNLIMITED)]
    )


def promise_without_data(opened: h5py.File) -> None:
    shape = (1 << 10, *opened["verdict"].shape[1:])
    del opened["verdict"]
    opened.create_dataset(
        "verdict",
        shape,
        np.int8,
        chunks=shape,
        shuffle=True,
        compression="gzip",
        fletcher32=True,
    )


def descending_axis(opened: h5py.File) -> None:
    opened["gamma"][:] = opened["gamma"][()][::-1]


def short_axis(opened: h5py.File) -> None:
    replace("alpha", data=opened["alpha"][:-1], **AS_WRITTEN)(opened)


def say(value: object) -> Callable[[h5py.File], None]:
    """An edit of what a reader may ask for first."""

    def edit(opened: h5py.File) -> None:
        opened.attrs["content_sha256"] = opened["alpha"].ref if value is h5py.ref_dtype else value

    return edit


def filters_twice(opened: h5py.File) -> None:
    layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    layout.set_chunk((24, 2))
    for _ in range(2):
        layout.set_shuffle()
        layout.set_deflate(6)
        layout.set_fletcher32()
    values = opened["alpha"][()]
    del opened["alpha"]
    space = h5py.h5s.create_simple(values.shape)
    dataset = h5py.h5d.create(opened.id, b"alpha", h5py.h5t.IEEE_F64LE, space, layout)
    dataset.write(h5py.h5s.ALL, h5py.h5s.ALL, values)


AS_WRITTEN = {"chunks": True, "shuffle": True, "compression": "gzip", "fletcher32": True}
HOSTILE = {
    edit.__name__: edit
    for edit in (
        soft_link,
        external_link,
        group,
        stranger,
        missing,
        half_a_product,
        virtual,
        external_storage,
        promise_without_data,
        descending_axis,
        short_axis,
    )
} | {
    "array attribute": say(np.full(1000, b"jaxstab atlas__")),
    "attribute of any length": say("jaxstab atlas"),
    "huge attribute": say(np.bytes_(b"a" * 65000)),
    "object attribute": say(h5py.ref_dtype),
    "attribute of numbers": say(np.arange(3)),
    "empty attribute": say(h5py.Empty("S64")),
    "contiguous": replace("alpha"),
    "unchecked": replace("alpha", chunks=True, compression="gzip", shuffle=True),
    "other filter": replace("alpha", compression="lzf", shuffle=True, fletcher32=True),
    "single precision": replace("alpha", dtype="float32", chunks=True),
    "complex": replace("alpha", data=np.zeros((24, 2), complex), **AS_WRITTEN),
    "big endian": replace("alpha", dtype=">f8", **AS_WRITTEN),
    "half precision": replace("alpha", dtype="float16", **AS_WRITTEN),
    "unsigned codes": replace("verdict", dtype="uint8", **AS_WRITTEN),
    "an enumeration": replace("verdict", dtype=h5py.enum_dtype({"a": 0}, "i1"), **AS_WRITTEN),
    "opaque": replace("alpha", data=np.zeros((24, 2), "V8"), **AS_WRITTEN),
    "a compound": replace("alpha", data=np.zeros((24, 2), [("a", "f8")]), **AS_WRITTEN),
    "arrays": replace("alpha", dtype=np.dtype("(3,)f8"), data=None, shape=(24, 2), **AS_WRITTEN),
    "a scalar": replace("alpha", data=1.0),
    "no values": replace("alpha", data=h5py.Empty("f8")),
    "a long line": replace("spec", data=np.array([b"a" * 5000]), **AS_WRITTEN),
    "one filter twice": filters_twice,
    "a lossy filter": replace("spec_line", scaleoffset=0, chunks=True),
    "references": replace("alpha", dtype=h5py.ref_dtype, data=None, shape=(24, 2), chunks=True),
    "strings of any length": replace("spec", dtype=h5py.string_dtype(), data=["a", "b"]),
}


def test_damage_under_a_right_footer_is_refused_or_changes_no_value(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    """The digests of the chunks behind the footer: the rest of the image is not looked at."""
    image, path = small_image(), tmp_path / "sealed.h5"
    for place in rng.integers(0, 8 * len(image), 200).tolist():
        damaged = bytearray(image)
        damaged[place // 8] ^= 1 << (place % 8)
        path.write_bytes(footer.sealed(bytes(damaged), small_table()))
        is_refused_or_as_it_was(path)


def is_refused_or_as_it_was(path: Path) -> None:
    try:
        arrays = ask_for_all(path)
    except ValueError:
        return
    for name, values in small_contents().arrays.items():
        np.testing.assert_array_equal(arrays[name], values)


@pytest.mark.parametrize("name", HOSTILE)
def test_an_image_that_is_not_as_the_table_says_changes_no_answer_and_fails_verification(
    name: str, tmp_path: Path
) -> None:
    path = tmp_path / "hostile.h5"
    with h5py.File.in_memory(small_image()) as opened:
        HOSTILE[name](opened)
        opened.flush()
        image = bytes(opened.id.get_file_image())
    path.write_bytes(footer.sealed(image, small_table()))
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
    known = open_atlas(path).query(*point)
    atlas = open_atlas(path)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2] + bytes(len(data)))
    answer = atlas.query(*point)
    assert answer.verdict == known.verdict
    assert answer.spectral_radius == known.spectral_radius
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
    monkeypatch.setattr(schema, "LARGEST_ARRAY", path.stat().st_size - 1)
    assert "read into memory" in refusal(path)
    monkeypatch.undo()
    monkeypatch.setattr(schema, "LARGEST_UNASKED", 0)
    monkeypatch.setattr(schema, "LARGEST_EXPANSION", 1)
    atlas = open_atlas(path)
    size = 4 * atlas.arrays["verdict"].size
    assert f"has {size} bytes of spectral_radius" in refusal(
        path, lambda _: atlas.query(0.1, 0.5, 0.0005, 0.01, 0.0)
    )
    assert atlas.verdict(0.1, 0.5, 0.0005, 0.01, 0.0) == jaxstab.STABLE
    with pytest.raises(KeyError):
        atlas.arrays["passengers"]
