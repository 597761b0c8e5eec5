"""A study on one and on two workers of a dask cluster, and on two of which one is killed.

Scheduler and workers are processes of this machine, each with one thread. Verdicts of walls on a
device with a vibration mode are the work, which uses one core: blocks of 1,000 loops, some seconds
each. All studies must be equal. The times are the client's; the CPU time of the workers is printed
beside them, as a busy machine gives each worker less than a core. Ctrl-C, SIGTERM and SIGHUP end
scheduler and workers, too; if this process is killed, the scheduler ends when it has been idle for
a minute, and the workers with it.
"""

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Timer
from typing import Any

import jaxstab

_LOOPS, _SMALL_LOOPS = 32_000, 8_000
_SECONDS_TO_DEATH = 2.0


def main(small: bool, points: int | None = None) -> int:
    """Print the times; how many studies differ."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, _: sys.exit(128 + number))
    count = points or (_SMALL_LOOPS if small else _LOOPS)
    with TemporaryDirectory() as name:
        studies, times, busiest = list[Any](), list[float](), list[float]()
        for workers, is_killed in ((1, False), (2, False), (2, True)):
            made, seconds, cpu = _measured(Path(name), count, workers, is_killed)
            studies.append(made)
            times.append(seconds)
            words = f"workers: {workers}" + ", one killed" * is_killed
            busiest.append(max(cpu))
            print(f"{words}: {seconds:.1f} s, {sum(cpu):.1f} CPU s of those alive", flush=True)
    print(f"two workers are {times[0] / times[1]:.2f} times as fast as one")
    print(
        f"with a core each: {busiest[0] / busiest[1]:.2f} times, by the CPU time of the busier one"
    )
    return sum(not made.identical(studies[0]) for made in studies)


def _measured(
    folder: Path, count: int, workers: int, is_killed: bool
) -> tuple[Any, float, list[float]]:
    from distributed import Client

    with _cluster(folder, workers) as (file, running), Client(scheduler_file=str(file)) as client:
        client.wait_for_workers(workers)
        client.run(_study, 8)
        before = client.run(time.process_time)
        if is_killed:
            Timer(_SECONDS_TO_DEATH, running[-1].kill).start()
        start = time.perf_counter()
        made = _study(count)
        seconds = time.perf_counter() - start
        after = client.run(time.process_time)
        return made, seconds, [cpu - before[worker] for worker, cpu in after.items()]


def _study(count: int) -> Any:
    scene = {
        "device": {
            "mass": 0.25,
            "damping": 0.1,
            "modes": [{"frequency": 90.0, "damping_ratio": 0.02, "modal_mass": 0.3}],
        },
        "controller": {"sample_time": 1e-3, "delay": 1e-3, "velocity": {"window_samples": 20}},
    }
    over = {"hand.stiffness": "uniform:0:500", "hand.mass": "uniform:0:0.2"}
    walls = {"soft": (1000.0, 10.0)}
    return jaxstab.study(scene, over, answers=["verdict"], walls=walls, samples=count)


@contextmanager
def _cluster(folder: Path, workers: int) -> Iterator[tuple[Path, list[subprocess.Popen[bytes]]]]:
    file = folder / "scheduler.json"
    file.unlink(missing_ok=True)
    running = list[subprocess.Popen[bytes]]()

    def start(*words: str) -> None:
        command = [sys.executable, "-m", "dask", *words, "--no-dashboard"]
        running.append(subprocess.Popen(command, stderr=subprocess.DEVNULL))

    try:
        start("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file),
              "--idle-timeout", "60 s")  # fmt: skip
        while not file.exists():
            time.sleep(0.05)
        for _ in range(workers):
            start("worker", "--scheduler-file", str(file), "--no-nanny", "--nthreads", "1")
        yield file, running
    finally:
        for process in reversed(running):
            process.kill()
            process.wait()
