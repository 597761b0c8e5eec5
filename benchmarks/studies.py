"""A study on one and on two workers of a dask cluster, and on two of which one is killed.

Scheduler and workers are processes of this machine, each with one thread. A study of margins is the
work, which is NumPy's: blocks of 8,192 loops, a few seconds each. All files must have the same
bytes. The times are the client's, from the first block submitted to the file published; the CPU
time of the workers is printed beside them, as a busy machine gives each worker less than a core.
Ctrl-C, SIGTERM and SIGHUP end scheduler and workers, too; if this process is killed, the scheduler
ends when it has been idle for a minute, and the workers with it.
"""

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory

import jaxstab

_LOOPS, _SMALL_LOOPS = 65_536, 16_384


def main(small: bool, points: int | None = None) -> int:
    """Print the times; whether files differ."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, _: sys.exit(128 + number))
    count = points or (_SMALL_LOOPS if small else _LOOPS)
    with TemporaryDirectory() as name:
        folder = Path(name)
        digests, times = list[str](), list[float]()
        for workers, killed in ((1, 0), (2, 0), (2, 1)):
            path = folder / f"{workers}-{killed}.h5"
            seconds, cpu = _measured(folder, path, count, workers, killed)
            digests.append(sha256(path.read_bytes()).hexdigest())
            times.append(seconds)
            words = f"workers: {workers}" + ", one killed after its first blocks" * killed
            print(f"{words}: {seconds:.1f} s, {cpu:.1f} CPU s of those alive, {digests[-1][:12]}")
    print(f"two workers are {times[0] / times[1]:.2f} times as fast as one")
    return len(set(digests)) - 1


def _measured(
    folder: Path, path: Path, count: int, workers: int, killed: int
) -> tuple[float, float]:
    from distributed import Client

    with _cluster(folder, workers) as (file, running), Client(scheduler_file=str(file)) as client:
        client.wait_for_workers(workers)
        _study(folder / f"warm-{path.name}", 64 * workers)
        before = sum(client.run(time.process_time).values())

        def show(done: int, _: int) -> None:
            if killed and done == workers:
                running[-1].kill()

        start = time.perf_counter()
        _study(path, count, show)
        return time.perf_counter() - start, sum(client.run(time.process_time).values()) - before


def _study(path: Path, count: int, progress: object = None) -> None:
    loop = jaxstab.HapticLoop(
        device_mass=0.25, device_damping=0.1, sample_time=1e-3, delay=1e-3,
        velocity=jaxstab.Velocity.difference(20),
    )  # fmt: skip
    over = {"hand_stiffness": jaxstab.Uniform(0.0, 500.0), "hand_mass": jaxstab.Uniform(0.0, 0.2)}
    given = {"answers": ["margins"], "walls": {"soft": (1000.0, 10.0)}, "samples": count}
    jaxstab.study(loop, over, store=path, progress=progress, **given)


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
