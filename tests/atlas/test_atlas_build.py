"""Builds: one file by one rename, the same bytes however it is computed, nothing left over."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from atlases import SMALL, edited, small_file, write_small
from commands import run

from jaxstab import AtlasSpec, FieldSpec, build_atlas, open_atlas
from jaxstab.app.cli.options import processes
from jaxstab.atlas import build
from jaxstab.atlas.build import verify_atlas, write_atlas

TINY = AtlasSpec(gamma=[0.0], delta=[0.015], delay=[0.0, 0.1], rows=5)
FORMER = b"the former file"


def entries(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


@pytest.mark.parametrize(
    "workers", [ThreadPoolExecutor, pytest.param(processes, marks=pytest.mark.campaign)]
)
def test_equal_specifications_give_equal_bytes_however_they_are_computed(
    workers: Callable[[int], Any], tmp_path: Path
) -> None:
    path = tmp_path / "a.h5"
    with workers(2) as executor:
        write_atlas(SMALL, path, executor=executor)
    assert path.read_bytes() == small_file()
    assert entries(tmp_path) == ["a.h5"]


def test_the_dask_client_of_this_process_computes(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    path = tmp_path / "a.h5"
    asked: list[str] = []
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        submit = client.submit
        client.submit = lambda *given, **more: asked.append("") or submit(*given, **more)
        write_atlas(TINY, path)
    assert asked
    alone = tmp_path / "b.h5"
    write_atlas(TINY, alone)
    assert path.read_bytes() == alone.read_bytes()


def test_progress_counts_runs_and_tiles(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    build_atlas(SMALL, tmp_path / "a.h5", lambda *pair: seen.append(pair))
    total = seen[0][1]
    assert seen == [(done, total) for done in range(1, total + 1)]
    assert total == 1 + 2 * 2  # a run, and two gammas at two delays


def test_the_file_says_what_its_build_found_at_random_walls(tmp_path: Path) -> None:
    tested = open_atlas(write_small(tmp_path)).tested
    assert tested["tested_points"] == 100_000
    assert tested["tested_wrong"] == 0
    assert 0 < tested["tested_computed"] < 50_000
    assert tested["tested_undecided"] <= tested["tested_computed"]


def test_a_table_that_would_answer_wrongly_is_given_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An error that is told too small by far, as of a kink that the stencil misses."""
    computed = build.LimitPlan.computed

    def flattered(plan: Any, run: range) -> Any:
        arrays = computed(plan, run)
        return arrays | {"alpha_error": np.full_like(arrays["alpha_error"], 1e-12)}

    monkeypatch.setattr(build.LimitPlan, "computed", flattered)
    path = tmp_path / "a.h5"
    path.write_bytes(FORMER)
    with pytest.raises(RuntimeError, match=r"^\d+ of 100000 random walls .*; give more rows, or"):
        write_atlas(TINY, path)
    assert path.read_bytes() == FORMER
    assert entries(tmp_path) == ["a.h5"]


def test_a_build_that_fails_leaves_nothing_and_the_former_file(tmp_path: Path) -> None:
    class StopError(Exception):
        pass

    def stop(done: int, total: int) -> None:
        if done == total - 1:
            raise StopError

    path = tmp_path / "a.h5"
    with pytest.raises(StopError):
        write_atlas(SMALL, path, stop)
    assert entries(tmp_path) == []
    path.write_bytes(FORMER)
    with pytest.raises(StopError):
        write_atlas(SMALL, path, stop)
    assert (entries(tmp_path), path.read_bytes()) == (["a.h5"], FORMER)


def test_a_worker_that_dies_is_one_sentence(tmp_path: Path) -> None:
    with processes(1) as executor:
        executor.submit(os._exit, 1)
        with pytest.raises(RuntimeError):
            write_atlas(TINY, tmp_path / "a.h5", executor=executor)
    assert entries(tmp_path) == []


def test_a_folder_in_place_of_a_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=f"cannot read {tmp_path}: there is a folder of this name"):
        open_atlas(tmp_path)
    with pytest.raises(OSError, match=f"cannot write {tmp_path}: there is a folder of this name"):
        build_atlas(TINY, tmp_path)


def test_a_folder_that_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"^\[Errno 2\] cannot write .*nowhere"):
        write_atlas(TINY, tmp_path / "nowhere" / "a.h5")


def test_fields_that_cannot_be_fitted_are_refused(tmp_path: Path) -> None:
    spec = replace(TINY, fields=FieldSpec(gamma=[0.0], delta=[0.0], delay=[0.0]))
    assert isinstance(spec.fields, FieldSpec)
    assert isinstance(spec.fields.alpha, int)
    write_atlas(replace(spec, fields=replace(spec.fields, beta=8)), tmp_path / "a.h5")
    assert open_atlas(tmp_path / "a.h5").fields["outside"].shape == (128, 8, 1, 1, 1)


@pytest.mark.parametrize(
    ("name", "place", "factor", "check"),
    [
        (
            "alpha_limits",
            (slice(None), slice(None), slice(None), slice(1, -1), 1),
            1.0001,
            "limits",
        ),
        ("beta_limits", (slice(None), slice(None), slice(None), 1), 1.01, "limits"),
        ("alpha_error", ..., 1e-6, "answers"),
    ],
)
def test_verification_finds_wrong_limits_and_errors(
    name: str, place: Any, factor: float, check: str, tmp_path: Path
) -> None:
    assert all(found.passed for found in verify_atlas(write_small(tmp_path), 200))
    path = edited(
        tmp_path / "wrong.h5",
        lambda file: file[name].__setitem__(place, file[name][place] * factor),
    )
    found = {each.name: each.passed for each in verify_atlas(path, 200)}
    assert found["file"] is True
    assert found[check] is False


def test_damaged_fields_are_called_so_and_not_the_file(tmp_path: Path) -> None:
    path = write_small(tmp_path)
    with h5py.File(path) as file:
        place = file["fields/outside"].id.get_chunk_info(0).byte_offset
    whole = path.read_bytes()
    path.write_bytes(whole[:place] + bytes([whole[place] ^ 0xFF]) + whole[place + 1 :])
    found = {each.name: each.passed for each in verify_atlas(path, 200)}
    assert found == {"file": True, "limits": True, "answers": True, "fields": False}


def test_the_command_builds_verifies_and_describes(tmp_path: Path) -> None:
    spec, path = tmp_path / "tiny.toml", tmp_path / "an atlas.h5"
    spec.write_text(TINY.to_toml(), encoding="utf-8")
    built = run("atlas", "build", "--spec", spec, "-o", path)
    assert built.exit_code == 0, built.stderr
    assert built.stdout == run("atlas", "info", path).stdout
    last = built.stdout.splitlines()[-1].split()
    assert last[:3] == ["jaxstab", "atlas", "query"]
    assert run("atlas", "verify", path).exit_code == 0
