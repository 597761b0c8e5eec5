"""Maps of contacts as files: computed in blocks, resumed, labelled, and the same by any workers."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any
from unittest.mock import patch

import h5py
import numpy as np
import pytest
import xarray
from commands import run
from mapped import AT_REST, GIVEN, LOOP, SIZES, WALLS, mapped

from jaxstab import contact_map, tiles
from jaxstab.loop import contact as maps
from jaxstab.results import ContactKind
from jaxstab.tiles import processes

SCENE = """
[device]
inertia = 0.002
damping = 0.001
[controller]
sample_time = 0.001
[contact]
push = 0.05
duration = 0.2
"""


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks of 30 contacts."""
    for name, size in SIZES.items():
        monkeypatch.setattr(maps, name, size)


def entries(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def stop_after(count: int) -> Any:
    def stop(done: int, _: int) -> None:
        if done == count:
            raise KeyboardInterrupt

    return stop


def test_a_file_holds_the_contacts_of_the_call_without_one(tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    own = mapped(tmp_path / "a.h5", progress=lambda *counts: told.append(counts))
    plain = contact_map(LOOP, **GIVEN, **AT_REST)
    assert told == [(done, 7) for done in range(8)]
    assert own.kind.shape == (7, 9, 3)
    for name in plain._fields[:-1]:
        np.testing.assert_array_equal(getattr(own, name), getattr(plain, name))
    assert entries(tmp_path) == ["a.h5"]


def test_arrays_of_one_number_are_no_dimensions(tmp_path: Path) -> None:
    walls = {"stiffness": np.array([800.0, 900.0]), "damping": np.full((1, 1, 1), 9.0)}
    own = contact_map(LOOP, **walls, **AT_REST, store=tmp_path / "a.h5")
    plain = contact_map(LOOP, **walls, **AT_REST)
    assert own.kind.shape == plain.kind.shape == (1, 1, 2)
    np.testing.assert_array_equal(own.amplitude, plain.amplitude)


def test_xarray_finds_named_dimensions_units_and_codes(tmp_path: Path) -> None:
    own = mapped(tmp_path / "a.h5")
    opened = xarray.open_dataset(tmp_path / "a.h5", engine="h5netcdf")
    assert dict(opened.sizes) == {"stiffness": 7, "damping": 9, "friction": 3}
    at = opened.sel(friction=0.1).isel(stiffness=2, damping=3)
    assert at.amplitude.item() == own.amplitude[2, 3, 1]
    assert opened.penetration.attrs["units"] == "m"
    assert opened.stiffness.attrs == {"long_name": "stiffness of the virtual wall", "units": "N/m"}
    words = dict(zip(opened.kind.flag_values, opened.kind.flag_meanings.split(), strict=True))
    assert words == {kind.value: kind.name.lower() for kind in ContactKind}
    assert "nothing is proved" in opened.attrs["title"]
    assert opened.attrs["loop"] == repr(LOOP)
    assert "push=1.0" in opened.attrs["conditions"]


def test_it_continues_after_ctrl_c_and_an_equal_call_computes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, whole = tmp_path / "a.h5", tmp_path / "whole.h5"
    mapped(whole)
    computed: list[Any] = []
    block = maps._Blocks.__call__
    monkeypatch.setattr(
        maps._Blocks, "__call__", lambda self, part: computed.append(part) or block(self, part)
    )
    with pytest.raises(KeyboardInterrupt):
        mapped(path, progress=stop_after(3))
    assert len(computed) == 3
    assert not path.exists()
    own = mapped(path)
    assert len(computed) == 7
    assert path.read_bytes() == whole.read_bytes()
    again = mapped(path)
    assert len(computed) == 7
    np.testing.assert_array_equal(own.amplitude, again.amplitude)
    assert entries(tmp_path) == ["a.h5", "whole.h5"]


def test_a_block_that_is_damaged_is_computed_again(tmp_path: Path) -> None:
    path, whole = tmp_path / "a.h5", tmp_path / "whole.h5"
    mapped(whole)
    with pytest.raises(KeyboardInterrupt):
        mapped(path, progress=stop_after(4))
    first, second, third, *_ = sorted(next(tmp_path.glob(".a.h5.*.tiles")).glob("*.tile"))
    image = bytearray(first.read_bytes())
    image[len(image) // 2] ^= 1
    first.write_bytes(image)
    second.write_bytes(third.read_bytes()[:-9])
    mapped(path)
    assert path.read_bytes() == whole.read_bytes()


@pytest.mark.parametrize("other", [{"push": 0.9}, {"stiffness": 1.01 * WALLS[0]}])
def test_blocks_of_another_map_are_not_taken(other: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with pytest.raises(KeyboardInterrupt):
        mapped(path, progress=stop_after(2))
    counts: list[int] = []
    given = {**GIVEN, **AT_REST, **other}
    contact_map(LOOP, **given, store=path, progress=lambda done, _: counts.append(done))
    assert counts[0] == 0
    with pytest.raises(FileExistsError, match=r"a\.h5 exists, and holds something else or is"):
        mapped(path)
    assert h5py.File(path).attrs["conditions"] != b""


def test_sequences_of_delays_that_differ_in_one_sample_are_of_different_maps(
    tmp_path: Path,
) -> None:
    delays = np.full(3000, 1e-3)
    keys = set()
    for place in (None, 1500):
        turn = delays.copy()
        turn[place] = 0.0 if place else 1e-3
        given = {**GIVEN, **AT_REST, "delays": turn}
        dataset = maps.contact_dataset(LOOP, given, tmp_path / "a.h5")
        assert len(dataset.attributes["conditions"]) < 1000
        keys.add(dataset.key)
    assert len(keys) == 2


def test_workers_give_the_same_bytes_and_their_death_loses_nothing(tmp_path: Path) -> None:
    path, whole = tmp_path / "a.h5", tmp_path / "whole.h5"
    mapped(whole)

    def kill(done: int, _: int) -> None:
        if done == 2:
            for worker in executor._processes.values():  # type: ignore[attr-defined]
                os.kill(worker.pid, signal.SIGKILL)

    with processes(2) as executor, pytest.raises(RuntimeError, match=r"a worker died; \d of 7"):
        mapped(path, progress=kill, executor=executor)
    with processes(2) as executor:
        mapped(path, executor=executor)
    assert path.read_bytes() == whole.read_bytes()


class Elsewhere(Executor):
    """A worker with another jaxstab."""

    def submit(self, call: Any, /, *given: Any, **options: Any) -> Future[Any]:
        future: Future[Any] = Future()
        with patch.object(tiles, "computed_by", lambda: "jaxstab 9.9"):
            future.set_result(call(*given, **options))
        return future


def test_a_worker_of_other_code_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match=r"computes with jaxstab 9\.9, .*; install the same for"):
        mapped(tmp_path / "a.h5", executor=Elsewhere())
    assert entries(tmp_path) == []


KILLED = """
import sys, time
from pathlib import Path
sys.path.insert(0, {tests!r})
from jaxstab.loop import contact
from mapped import SIZES, mapped
vars(contact).update(SIZES)
mapped(Path({path!r}), progress=lambda done, total: (print(done, flush=True), time.sleep(0.3)))
"""


def test_a_killed_map_continues(tmp_path: Path) -> None:
    path, whole = tmp_path / "a.h5", tmp_path / "whole.h5"
    mapped(whole)
    script = KILLED.format(tests=str(Path(__file__).parent), path=str(path))
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        while child.stdout.readline().strip() != b"2":
            assert child.poll() is None
        child.kill()
    time.sleep(0.1)
    counts: list[int] = []
    mapped(path, progress=lambda done, _: counts.append(done))
    assert counts[0] >= 2
    assert path.read_bytes() == whole.read_bytes()


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        ({"stiffness": 1000.0, "damping": 10.0, "friction": 0.1}, ValueError, "no argument is an"),
        ({"stiffness": [1.0, 2.0], "damping": [1.0, 2.0]}, ValueError, "a different axis"),
        ({"stiffness": np.ones((2, 2)), "damping": 1.0}, ValueError, "a different axis"),
        ({"stiffness": [1.0, np.nan], "damping": 1.0}, ValueError, "stiffness is nan"),
        ({"stiffness": [1.0, 2.0], "damping": 1.0, "push": 0.0}, ValueError, "nothing moves"),
    ],
)
def test_what_is_no_map_is_refused(
    given: dict[str, Any], error: type[Exception], words: str, tmp_path: Path
) -> None:
    with pytest.raises(error, match=words) as refusal:
        contact_map(LOOP, **{**AT_REST, **given}, store=tmp_path / "a.h5")
    assert "\n" not in str(refusal.value)
    assert entries(tmp_path) == []


def test_progress_needs_a_file() -> None:
    with pytest.raises(ValueError, match="without store; give store, a file"):
        contact_map(LOOP, **GIVEN, **AT_REST, progress=print)


def test_the_command_stores_a_map_in_the_units_of_its_scene(tmp_path: Path) -> None:
    scene, path = tmp_path / "scene.toml", tmp_path / "map.h5"
    scene.write_text(SCENE)
    words = ("contact", scene, "-o", path, "--count", "6", "--frictions", "0:0.01:3")
    done = run(*words)
    assert done.exit_code == 0, done.stderr
    assert "3 friction x 6 damping x 6 stiffness: 108 contacts of 0.2 s" in done.stderr
    opened = xarray.open_dataset(path, engine="h5netcdf")
    assert opened.stiffness.units == "N m/rad"
    assert opened.friction.units == "N m"
    assert opened.amplitude.units == "rad"
    share = 100.0 * float(np.mean(opened.kind == ContactKind.RESTS))
    assert done.stdout == f"{path}: {share:.1f} % of the contacts come to rest\n"
    before = path.stat().st_mtime_ns
    assert run(*words).stdout == done.stdout
    assert path.stat().st_mtime_ns == before
    for more, said in (
        (("--plot", tmp_path / "a.png"), "--plot is given beside --output; give one of them"),
        ((scene,), "a map is for one scene; give one FILE"),
    ):
        refused = run(*words, *more)
        assert (refused.exit_code, refused.stdout) == (2, "")
        assert said in refused.stderr
    other = run(*words[:-1], "0:0.02:3")
    assert other.exit_code == 2
    assert "holds something else or is of another version" in other.stderr
