"""Processes and clusters build the atlas that one process builds, also when they are killed."""

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import run

from jaxstab import AtlasSpec, Velocity, build_atlas
from jaxstab import tiles as work
from jaxstab.tiles import dask_cluster, processes

pytestmark = pytest.mark.campaign

SPEC = AtlasSpec(
    alpha=[0.0, 0.005, 0.01], beta=[0.05, 0.1], gamma=[0.0, 0.0005, 0.001], delta=[0.0, 0.015],
    delay=[0.0, 1.0], products=["verdict", "alpha_limits"], limit_cells=8, delay_cells=4,
    velocity=Velocity.difference(10),
)  # fmt: skip
# A job in the background of a shell ignores Ctrl-C, and so would what it starts.
SCRIPT = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
from jaxstab.cli.main import main
main()
"""
COMMAND = [sys.executable, "-c", SCRIPT, "atlas", "build"]


@pytest.fixture(scope="module")
def serial(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("serial") / "a.h5"
    build_atlas(SPEC, path)
    return path.read_bytes()


def when_done(count: int, deed: Callable[[], object]) -> Callable[[int, int], None]:
    """A progress at which something happens once, after so many tiles."""
    once = iter([deed])

    def tell(done: int, total: int) -> None:
        if done >= count:
            next(once, lambda: None)()

    return tell


def kill(process: int | None) -> None:
    assert process is not None
    os.kill(process, signal.SIGKILL)


class LastFirst(Executor):
    """Runs what was submitted last, first, and only when it must."""

    def __init__(self) -> None:
        self.waiting: list[tuple[Future[Any], Callable[[], Any]]] = []

    def submit(self, call: Callable[..., Any], /, *given: Any, **options: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.waiting.append((future, lambda: call(*given, **options)))
        threading.Timer(0.01, self.run).start()
        return future

    def run(self) -> None:
        future, call = self.waiting.pop()
        if future.set_running_or_notify_cancel():
            try:
                future.set_result(call())
            except (ValueError, RuntimeError) as error:
                future.set_exception(error)


def test_the_bytes_do_not_depend_on_who_computed_the_tiles_and_when(
    serial: bytes, tmp_path: Path
) -> None:
    path, found = tmp_path / "a.h5", set[bytes]()
    for executor in (LastFirst(), ThreadPoolExecutor(3)):
        build_atlas(SPEC, path, executor=executor)
        found.add(path.read_bytes())
    assert found == {serial}


def test_a_worker_process_that_dies_is_told_and_the_next_build_goes_on(
    serial: bytes, tmp_path: Path
) -> None:
    path = tmp_path / "a.h5"
    kill_one = when_done(1, lambda: kill(multiprocessing.active_children()[0].pid))
    with processes(2) as executor, pytest.raises(RuntimeError, match=r"a worker died; \d of 6"):
        build_atlas(SPEC, path, kill_one, executor)
    assert not path.exists()
    told: list[tuple[int, int]] = []
    with processes(2) as executor:
        build_atlas(SPEC, path, lambda *progress: told.append(progress), executor)
    assert told[0][0] >= 1
    assert path.read_bytes() == serial
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.h5"]


# ------------------------------------------------------------------------------------------- Ctrl-C


def test_ctrl_c_ends_workers_and_command_in_one_sentence(tmp_path: Path) -> None:
    long = AtlasSpec(
        alpha=[0.0, 0.1, 0.2], beta=[0.1, 0.2], gamma=np.linspace(0.0, 0.001, 100).tolist(),
        delta=[0.0, 0.015], delay=[0.0], products=["verdict"],
    )  # fmt: skip
    (tmp_path / "a.toml").write_text(long.to_toml(), encoding="utf-8")
    output = tmp_path / "a.h5"
    building = subprocess.Popen(
        [*COMMAND, "--spec", tmp_path / "a.toml", "-o", output, "--workers", "1"],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    while building.poll() is None and not any(tmp_path.glob(".a.h5.*.tiles/*.tile")):
        time.sleep(0.01)
    os.killpg(building.pid, signal.SIGINT)  # as a terminal does, to all of its processes
    _, told = building.communicate()
    assert building.returncode == 130
    assert told.splitlines()[-1].startswith("jaxstab: interrupted; the finished tiles are stored")
    assert "Traceback" not in told
    assert not output.exists()
    told_progress: list[tuple[int, int]] = []
    build_atlas(long, output, lambda *progress: told_progress.append(progress))
    assert told_progress[0][0] >= 1
    assert [entry.name for entry in tmp_path.iterdir() if entry.name != "a.toml"] == ["a.h5"]


# --------------------------------------------------------------------------------------------- dask


class Cluster:
    """A scheduler and three workers, each a process of its own, on the loopback."""

    def __init__(self, folder: Path) -> None:
        file = folder / "scheduler.json"
        where = ["--scheduler-file", str(file), "--no-dashboard"]
        self.running: list[subprocess.Popen[bytes]] = []
        self.start("scheduler", "--host", "127.0.0.1", "--port", "0", *where)
        while not file.exists():
            time.sleep(0.05)
        self.file = file
        self.address = json.loads(file.read_text(encoding="utf-8"))["address"]
        for _ in range(3):
            self.start("worker", self.address, "--no-nanny", "--nthreads", "1", "--no-dashboard")

    def start(self, *command: str) -> None:
        run = [sys.executable, "-m", "dask", *command]
        self.running.append(subprocess.Popen(run, stderr=subprocess.DEVNULL))

    def stop(self) -> None:
        for process in self.running[::-1]:
            process.kill()
            process.wait()


@pytest.fixture
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    cluster = Cluster(tmp_path_factory.mktemp("cluster"))
    yield cluster
    cluster.stop()


def test_a_dask_cluster_builds_the_serial_atlas_though_a_worker_is_killed(
    serial: bytes, cluster: Cluster, tmp_path: Path
) -> None:
    path = tmp_path / "a.h5"
    with dask_cluster(cluster.address) as executor:
        build_atlas(SPEC, path, when_done(1, cluster.running[-1].kill), executor)
    assert path.read_bytes() == serial


def test_the_file_of_a_scheduler_and_a_client_of_this_process_are_found(
    serial: bytes, cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from distributed import Client

    spec, a, b = tmp_path / "spec.toml", tmp_path / "a.h5", tmp_path / "b.h5"
    spec.write_text(SPEC.to_toml(), encoding="utf-8")
    here = work.images
    used = list[str]()

    def images(compute: Any, items: Any, at_once: int, executor: Any) -> Any:
        used.append(type(executor).__name__)
        return here(compute, items, at_once, executor)

    monkeypatch.setattr(work, "images", images)
    done = run("atlas", "build", "--spec", spec, "-o", a, "--scheduler-file", cluster.file)
    assert done.exit_code == 0, done.stderr
    with Client(cluster.address):
        build_atlas(SPEC, b)
    assert a.read_bytes() == b.read_bytes() == serial
    build_atlas(SPEC, tmp_path / "c.h5")
    assert used == ["ClientExecutor", "ClientExecutor", "NoneType"]


def as_of_another_code() -> None:
    """Make a worker name another code than that of the build."""
    maker = work.computed_by()
    work.computed_by = lambda: maker.replace("code ", "code 1")  # type: ignore[assignment]


def test_31_25_workers_of_a_local_cluster_are_believed_if_their_code_is_that_of_the_build(
    serial: bytes, tmp_path: Path
) -> None:
    from distributed import LocalCluster

    path = tmp_path / "a.h5"
    with (
        LocalCluster(
            n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
        ) as local,
        local.get_client() as client,
        dask_cluster(local.scheduler_address) as executor,
    ):
        build_atlas(SPEC, path, executor=executor)
        assert path.read_bytes() == serial
        assert len(client.run(as_of_another_code)) == 2
        with pytest.raises(
            RuntimeError, match=r"a worker computes with .*\(code 1.*install the same"
        ):
            build_atlas(replace(SPEC, delay=[1.0]), path, executor=executor)
    assert path.read_bytes() == serial


def test_without_a_scheduler_or_dask_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jaxstab.tiles._SECONDS_TO_CONNECT", 1)
    with pytest.raises(OSError, match=r"no dask scheduler answers at tcp://127\.0\.0\.1:9;"):
        dask_cluster("tcp://127.0.0.1:9").__enter__()
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(RuntimeError, match=r"jaxstab\[distributed\]"):
        dask_cluster("tcp://127.0.0.1:9").__enter__()
