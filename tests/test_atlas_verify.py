"""`atlas verify` finds what is wrong in a file: bytes, contents, verdicts, fields."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from atlases import edited
from click.testing import CliRunner
from footers import image_of, sealed
from hostile import parted, retold, sub

from jaxstab import AtlasSpec, FittedAxis, build_atlas, open_atlas, spectral_radius
from jaxstab.atlas.schema import VARIABLES, content_digest, stored_of
from jaxstab.cli.main import main

SPEC = AtlasSpec(
    alpha=FittedAxis(16), beta=FittedAxis(16), gamma=[0.0, 0.001], delta=[0.0, 0.015], delay=[1.0],
    products=["verdict", "fields", "outline", "summary"],
)  # fmt: skip
NAMES = [
    "file", "schema", "content", "verdict", "cell_verdict", "fields", "outline", "summary",
    "answers",
]  # fmt: skip


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("verify") / "a.h5"
    build_atlas(SPEC, path)
    return path.read_bytes()


@pytest.fixture(scope="module")
def image(whole: bytes) -> bytes:
    image = image_of(whole)
    assert image is not None
    return image


def verified(data: bytes, folder: Path) -> tuple[int, list[str]]:
    """The exit code, and the checks that found something wrong."""
    path = folder / "small.h5"
    path.write_bytes(data)
    result = CliRunner().invoke(main, ["atlas", "verify", str(path), "--sample", "300"])
    assert result.stderr == ""
    checks = [line.partition(": ") for line in result.stdout.splitlines()]
    assert [name for name, _, _ in checks] == NAMES[: len(checks)]
    assert all(words.startswith(("ok, ", "WRONG, ")) for _, _, words in checks)
    return result.exit_code, [name for name, _, words in checks if words.startswith("WRONG")]


def with_right_digest(edit: Callable[[h5py.File], None]) -> Callable[[h5py.File], None]:
    """An edit that gives itself away by nothing but its values."""

    def edit_all(opened: h5py.File) -> None:
        edit(opened)
        digest = content_digest(
            stored_of(name, opened[name]).line for name in VARIABLES if name in opened
        )
        opened.attrs["content_sha256"] = np.bytes_(digest.encode())

    return edit_all


def test_nothing_is_wrong_in_an_atlas_as_it_was_built(whole: bytes, tmp_path: Path) -> None:
    assert verified(whole, tmp_path) == (0, [])


def test_a_flipped_bit_and_another_version_are_found(whole: bytes, tmp_path: Path) -> None:
    flipped = whole[:500] + bytes([whole[500] ^ 4]) + whole[501:]
    assert verified(flipped, tmp_path) == (1, ["file"])
    assert verified(retold(whole, sub("atlas 3", "atlas 99")), tmp_path) == (1, ["file"])


def test_an_image_that_is_not_what_the_table_says_is_found(whole: bytes, tmp_path: Path) -> None:
    def change(opened: h5py.File) -> None:
        opened["verdict"][0, 0, 0, 0, 0] = 3 - opened["verdict"][0, 0, 0, 0, 0]

    image, table = parted(whole)
    other, _ = parted(edited(change, image))
    assert verified(sealed(other, table), tmp_path)[0] == 1


def test_a_single_changed_value_under_a_right_footer_is_found(image: bytes, tmp_path: Path) -> None:
    def change(opened: h5py.File) -> None:
        value = opened["stable_area"][0, 0, 0]
        opened["stable_area"][0, 0, 0] = np.nextafter(value, value + value)

    assert verified(edited(change, image), tmp_path) == (1, ["content"])


def swap(name: str) -> Callable[[h5py.File], None]:
    """Stable becomes unstable, and the other way round."""

    def edit(opened: h5py.File) -> None:
        opened[name][...] = np.array([0, 2, 1, 3], np.int8)[opened[name][...]]

    return edit


def wipe(opened: h5py.File) -> None:
    opened["verdict"][...] = 0


def boast(opened: h5py.File) -> None:
    opened["spectral_radius"][...] *= 1.0 - 1e-5


def scale(name: str, factor: float) -> Callable[[h5py.File], None]:
    def edit(opened: h5py.File) -> None:
        opened[name][...] *= factor

    return edit


def cut_off(opened: h5py.File) -> None:
    """A loop as before, of points of the boundary, with a fifth of them replaced by one of them."""
    ends = np.cumsum(opened["outline_size"][...].transpose(2, 0, 1))
    for name in ("outline_alpha", "outline_beta"):
        values = opened[name][...]
        for part in np.split(values, ends[:-1]):
            part[200:400] = part[200]
        opened[name][...] = values


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("edit", "wrong"),
    [
        (scale("outline_alpha", 1.0 + 1e-7), {"outline"}),
        (cut_off, {"outline"}),
        (scale("corner_beta", 1.0 + 1e-7), {"outline"}),
        (scale("stable_area", 1.0 + 1e-7), {"summary"}),
        (scale("beta_of_least_radius", 1.0 + 1e-5), {"summary"}),
        (swap("verdict"), {"verdict"}),
        (wipe, {"verdict"}),
        (swap("cell_verdict"), {"cell_verdict", "answers"}),
        (boast, {"fields"}),
    ],
)
def test_wrong_values_under_right_digests_are_found_by_computing_them_again(
    edit: Callable[[h5py.File], None], wrong: set[str], image: bytes, tmp_path: Path
) -> None:
    code, found = verified(edited(with_right_digest(edit), image), tmp_path)
    assert code == 1
    assert set(found) <= wrong
    assert min(wrong, key=NAMES.index) in found


def test_a_radius_that_cannot_be_computed_is_not_taken_for_right(
    whole: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lost(**asked: Any) -> Any:
        radius = spectral_radius(**asked)
        return radius._replace(value=np.full_like(radius.value, np.nan))

    monkeypatch.setattr("jaxstab.point.spectral_radius", lost)
    assert verified(whole, tmp_path) == (1, ["fields"])


def test_outlines_that_are_counted_wrong_are_refused(image: bytes, tmp_path: Path) -> None:
    path = tmp_path / "miscounted.h5"
    path.write_bytes(edited(lambda opened: opened["outline_size"].__setitem__((0, 0, 0), 5), image))
    with pytest.raises(ValueError, match=r"miscounted.h5 is damaged"):
        open_atlas(path)


def test_a_missing_file_is_one_sentence(tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["atlas", "verify", str(tmp_path / "none.h5")])
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith("jaxstab: cannot read ")
    assert result.stderr.count("\n") == 1
