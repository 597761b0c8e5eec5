"""Files of atlases: plain HDF5 for others, and refused in one sentence when they are unsound."""

import io
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from atlases import UNSOUND, attribute, edited, set_to, small_file, write_small
from campaign import many
from commands import assert_one_sentence, run

import jaxstab
from jaxstab.atlas import file
from jaxstab.atlas.build import write_atlas

GOLDEN = Path(__file__).resolve().parents[2] / "data" / "golden"


def datasets(path: Path) -> dict[str, h5py.Dataset]:
    found: dict[str, h5py.Dataset] = {}
    with h5py.File(path) as opened:
        opened.visititems(
            lambda name, item: found.__setitem__(name, item[()]) if hasattr(item, "shape") else None
        )
    return found


def test_every_dataset_has_a_checksum_words_and_scales(tmp_path: Path) -> None:
    with h5py.File(write_small(tmp_path)) as opened:
        names: list[str] = []
        opened.visit(names.append)
        for name in names:
            item = opened[name]
            if isinstance(item, h5py.Group):
                continue
            assert item.fletcher32, name
            assert item.attrs["long_name"]
            assert item.attrs["interpretation"]
            assert item.is_scale or all(len(dimension) == 1 for dimension in item.dims), name
            if item.dtype.kind == "f":
                assert item.attrs["units"] in (b"1", b"rad")
        assert set(names) == {v.name for v in file.LIMITS} | {file.FIELDS} | {
            f"{file.FIELDS}/{v.name}" for v in file.FIELD_VARIABLES
        }


def test_the_groups_are_nxdata_and_the_root_says_what_it_is(tmp_path: Path) -> None:
    with h5py.File(write_small(tmp_path)) as opened:
        assert opened.attrs["format"] == b"jaxstab atlas"
        assert opened.attrs["schema_version"] == file.SCHEMA_VERSION
        for group in (opened, opened[file.FIELDS]):
            assert group.attrs["NX_class"] == b"NXdata"
            signal = group[group.attrs["signal"].decode()]
            axes = [name.decode() for name in group.attrs["axes"]]
            assert [group[name].shape[0] for name in axes] == list(signal.shape)


def test_xarray_reads_limits_and_fields_with_coordinates(tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    path = write_small(tmp_path)
    atlas = jaxstab.open_atlas(path)
    with xarray.open_dataset(path, engine="h5netcdf") as limits:
        plant = {"gamma": 0.001, "delta": 0.005, "delay": 0.5}
        upper = limits.alpha_limits.sel(end=1, row=0.375, **plant)
        low, high = limits.beta_limits.sel(plant).values
        own = atlas.alpha_limits(low + 0.375 * (high - low), **plant)
        assert float(upper) == pytest.approx(float(own.upper), rel=1e-12)
    with xarray.open_dataset(path, engine="h5netcdf", group="fields") as fields:
        at = fields.spectral_radius.sel(gamma=0.001, delta=0.015, delay=1.5)
        np.testing.assert_array_equal(at, atlas.fields["spectral_radius"][:, :, 1, 2, 1])
        assert at.alpha.attrs["long_name"] == "stiffness of the virtual wall"


def test_the_golden_atlases_are_read_and_answer() -> None:
    for name, filters in (("atlas-v5", False), ("atlas-v5-window", True)):
        atlas = jaxstab.open_atlas(GOLDEN / f"{name}.h5")
        spec = jaxstab.AtlasSpec.from_file(GOLDEN / f"{name}.toml")
        assert jaxstab.AtlasSpec.from_toml(atlas.spec) == spec
        assert (atlas.filters is not None) == filters
        code = atlas.query(0.01, 0.2, gamma=0.0005, delta=0.01, delay=1.2).verdict
        assert code == jaxstab.Verdict.STABLE


def test_a_build_gives_the_values_of_the_golden_atlas(tmp_path: Path) -> None:
    spec = jaxstab.AtlasSpec.from_file(GOLDEN / "atlas-v5.toml")
    write_atlas(spec, tmp_path / "a.h5")
    built, kept = datasets(tmp_path / "a.h5"), datasets(GOLDEN / "atlas-v5.h5")
    assert built.keys() == kept.keys()
    for name, values in kept.items():
        if values.dtype.kind == "f":
            np.testing.assert_allclose(built[name], values, rtol=1e-6, atol=1e-11, err_msg=name)
        else:
            np.testing.assert_array_equal(built[name], values, err_msg=name)


@pytest.mark.parametrize("name", UNSOUND)
def test_what_is_unsound_is_refused_in_one_sentence(name: str, tmp_path: Path) -> None:
    path = edited(tmp_path / "bad.h5", UNSOUND[name])
    with pytest.raises(ValueError, match=r"bad\.h5 is damaged, or no atlas \(.*\); build"):
        jaxstab.open_atlas(path)
    answer = run("atlas", "info", path)
    assert (answer.exit_code, answer.stdout) == (2, "")
    assert_one_sentence(answer.stderr)
    assert run("atlas", "verify", path).exit_code == 1


def test_fields_that_are_unsound_are_refused_when_they_are_used(tmp_path: Path) -> None:
    path = edited(tmp_path / "bad.h5", set_to("fields/damping_ratio", 2.0, (0, 0, 0, 0, 0)))
    atlas = jaxstab.open_atlas(path)
    with pytest.raises(ValueError, match=r"damping_ratio is not as the format says"):
        _ = atlas.fields
    assert run("atlas", "plot", path, "-o", tmp_path / "a.png").exit_code == 2


def test_a_file_that_was_replaced_gives_no_fields(tmp_path: Path) -> None:
    path = write_small(tmp_path)
    atlas = jaxstab.open_atlas(path)
    (tmp_path / "new").write_bytes(small_file())
    (tmp_path / "new").replace(path)
    with pytest.raises(ValueError, match="was replaced since it was opened"):
        _ = atlas.fields


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "is no atlas of jaxstab: it is not HDF5"),
        (b"no atlas", "is no atlas of jaxstab: it is not HDF5"),
        (None, "is damaged, or no atlas"),
        (b"\x89HDF\r\n\x1a\n", "is damaged, or no atlas"),
    ],
    ids=["empty", "text", "cut", "start"],
)
def test_what_is_no_atlas_is_said(data: bytes | None, says: str, tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    path.write_bytes(small_file()[:4096] if data is None else data)
    with pytest.raises(ValueError, match=says):
        jaxstab.open_atlas(path)


def test_other_hdf5_and_other_versions_are_named(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "other.h5", "w") as opened:
        opened["x"] = 1
    with pytest.raises(ValueError, match="is HDF5, but no atlas of jaxstab"):
        jaxstab.open_atlas(tmp_path / "other.h5")
    path = edited(tmp_path / "old.h5", attribute("schema_version", np.int32(4)))
    with pytest.raises(ValueError, match="has version 4 of the format, and this jaxstab reads 5"):
        jaxstab.open_atlas(path)
    with pytest.raises(FileNotFoundError, match=r"cannot read .*missing"):
        jaxstab.open_atlas(tmp_path / "missing.h5")
    with pytest.raises(IsADirectoryError):
        jaxstab.open_atlas(tmp_path)


MUTANTS = """
import io, random, sys
from pathlib import Path
import numpy as np
import jaxstab
from jaxstab.atlas import file

path, target, count = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
data, chance = path.read_bytes(), random.Random(20120412)
right = jaxstab.open_atlas(path)
fields = right.fields
found = {"refused": 0, "right": 0, "wrong": 0}
for number in range(count):
    mutant = bytearray(data)
    for _ in range(chance.choice([1, 1, 2, 8])):
        place = chance.randrange(len(mutant))
        kind = chance.randrange(4)
        if kind == 0:
            mutant[place] ^= 1 << chance.randrange(8)
        elif kind == 1:
            mutant[place] = chance.randrange(256)
        elif kind == 2:
            del mutant[place : place + chance.randrange(1, 64)]
        else:
            mutant[place:place] = chance.randbytes(chance.randrange(1, 9))
    target.write_bytes(mutant)
    try:
        atlas = jaxstab.open_atlas(target)
        is_same = all(
            np.array_equal(value, atlas.table.arrays[name], equal_nan=True)
            for name, value in right.table.arrays.items()
        ) and all(
            np.array_equal(value, atlas.fields[name], equal_nan=value.dtype.kind == "f")
            for name, value in fields.items()
        )
        found["right" if is_same else "wrong"] += 1
    except (ValueError, OSError):
        found["refused"] += 1
print(*found.values())
"""


@pytest.mark.parametrize("count", [60, pytest.param(0, marks=pytest.mark.campaign)])
def test_mutants_are_refused_or_right_and_none_crashes(count: int, tmp_path: Path) -> None:
    """1,000 at full size: bytes changed, left out and put in."""
    count = count or many(1000)
    words = [sys.executable, "-c", MUTANTS, write_small(tmp_path), tmp_path / "m.h5", str(count)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    refused, right, wrong = map(int, done.stdout.split())
    assert (refused + right, wrong) == (count, 0)
    assert refused > 0.5 * count


def test_a_packed_chunk_is_what_libhdf5_would_read(rng: np.random.Generator) -> None:
    for shape, dtype in (((7, 5), np.float32), ((8, 3), np.int16), ((1, 1), np.float32)):
        values = (100.0 * rng.normal(size=shape)).astype(dtype)
        with h5py.File(io.BytesIO(), "w") as opened:
            dataset = opened.create_dataset(
                "x", (8, 6), dtype, chunks=(8, 6), shuffle=True, compression="gzip", fletcher32=True
            )
            dataset.id.write_direct_chunk((0, 0), file.packed(values, (8, 6)))
            whole = np.zeros((8, 6), dtype)
            whole[tuple(map(slice, shape))] = values
            np.testing.assert_array_equal(dataset[()], whole)


@pytest.mark.skipif(shutil.which("octave-cli") is None, reason="Octave is not installed")
def test_octave_reads_limits_by_itself(tmp_path: Path) -> None:
    """As docs/atlas.md says."""
    path = write_small(tmp_path)
    code = f"a = load('-hdf5', '{path}'); printf('%d ', size(a.alpha_limits)); disp(a.delay(2));"
    done = subprocess.run(
        ["octave-cli", "--eval", code], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    *shape, delay = done.stdout.split()
    assert list(map(int, shape)) == [2, 17, 5, 3, 2]
    assert float(delay) == 0.25
