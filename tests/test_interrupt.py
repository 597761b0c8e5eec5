"""Ctrl-C ends a command soon, whatever it does, and leaves no process, file or folder."""

import os
import signal
import subprocess
import sys
import threading
import time
from multiprocessing import active_children
from pathlib import Path

import numpy as np
import pytest
from campaign import many
from commands import START

from jaxstab.cli.options import processes, prompt_interrupts

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")

SCENE = """
[device]
mass = 0.1
damping = 0.1
[controller]
sample_time = 0.001
[contact]
push = 1.0
"""
STUDY = ("study", "scene.toml", "--over", "device.mass=uniform:0.1:0.5", "--samples", "200000")
CONTACT = ("contact", "scene.toml", "--count", "300")
COMMANDS = {
    "study": (*STUDY, "-o", "a.h5"),
    "study with workers": (*STUDY, "-o", "a.h5", "--workers", "2"),
    "contact with workers": (*CONTACT, "-o", "a.h5", "--workers", "2"),
}
MOST = 3.0  # s, where two cores are free
BUSY = 2.0  # times as long where other tests run
WORKER = "Process Spawn"  # begins what multiprocessing prints of a worker that an exception ended


def test_workers_never_see_ctrl_c() -> None:
    blocked, handler = signal.pthread_sigmask(signal.SIG_BLOCK, []), signal.getsignal(signal.SIGINT)
    with prompt_interrupts(), processes(1) as pool:
        assert signal.SIGINT in pool.submit(signal.pthread_sigmask, signal.SIG_BLOCK, []).result()
    assert signal.pthread_sigmask(signal.SIG_BLOCK, []) == blocked
    assert signal.getsignal(signal.SIGINT) is handler


def test_an_error_ends_workers_at_once_whatever_they_compute() -> None:
    began = time.monotonic()

    def interrupted_work() -> None:
        with processes(1) as pool:
            pool.submit(time.sleep, 1e3)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted_work()
    assert time.monotonic() - began < 10.0
    assert not active_children()


SUDDEN_END = """
import os
from jaxstab.cli.options import processes

with processes(1) as pool:
    pool.submit(abs, 1).result()
    os._exit(130)
"""


def test_nothing_is_said_of_what_a_sudden_end_left() -> None:
    done = subprocess.run([sys.executable, "-c", SUDDEN_END], capture_output=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, b"", b"")


def test_what_watches_ends_with_a_command() -> None:
    before = threading.active_count()
    for _ in range(5):
        with prompt_interrupts():
            pass
    time.sleep(0.2)
    assert threading.active_count() == before


def interrupted(command: tuple[str, ...], seconds: float, folder: Path) -> tuple[float, str]:
    """Interrupt a command as a terminal does, all of its processes; the time it takes, stderr."""
    (folder / "scene.toml").write_text(SCENE)
    begin = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
    running = subprocess.Popen(
        [sys.executable, "-c", begin + START, *command],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    time.sleep(seconds)
    assert running.poll() is None
    os.killpg(running.pid, signal.SIGINT)
    began = time.monotonic()
    _, told = running.communicate(timeout=60.0)  # stderr is open as long as a worker lives
    assert running.returncode in (130, -signal.SIGINT)  # the latter while Python starts
    assert [entry.name for entry in folder.iterdir()] == ["scene.toml"]
    return time.monotonic() - began, told


@pytest.mark.parametrize(
    ("name", "seconds"),
    [
        ("study", 0.7),
        pytest.param("contact with workers", 2.0, marks=pytest.mark.campaign),
        pytest.param("study with workers", 5.0, marks=pytest.mark.campaign),
    ],
)
def test_ctrl_c_ends_a_command(name: str, seconds: float, tmp_path: Path) -> None:
    took, told = interrupted(COMMANDS[name], seconds, tmp_path)
    assert took < BUSY * MOST
    assert WORKER not in told


HELD = """
import os, signal, time
from jaxstab.cli.options import prompt_interrupts

with prompt_interrupts():
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGUSR1})  # as a program of XLA that runs
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(60.0)
"""


@pytest.mark.parametrize("is_terminal", [False, True])
def test_a_command_that_is_held_up_says_that_it_is_interrupted(is_terminal: bool) -> None:
    ours, theirs = os.openpty() if is_terminal else os.pipe()
    done = subprocess.run([sys.executable, "-c", HELD], stderr=theirs, check=False)
    told = os.read(ours, 1000)
    os.close(ours), os.close(theirs)
    assert done.returncode == 130
    assert told.rstrip().endswith(b"jaxstab: interrupted; no file is half-written.")
    assert (b"\033[?25h" in told) == is_terminal  # the cursor, which a bar has hidden


def test_an_interruption_says_nothing_of_files_that_are_written(tmp_path: Path) -> None:
    script = "from jaxstab.cli import main, scene; import os, signal; scene.print_with_csv = lambda"
    script += " *_: os.kill(os.getpid(), signal.SIGINT) or signal.pause(); main.main()"
    (tmp_path / "scene.toml").write_text(SCENE)
    command = "study", "scene.toml", "--over", "device.mass=0.1,0.2", "-o", "a.nc"
    done = subprocess.run(
        [sys.executable, "-c", script, *command], cwd=tmp_path, capture_output=True, check=False
    )
    assert done.returncode == 130
    assert (tmp_path / "a.nc").exists()
    assert done.stderr.endswith(b"jaxstab: interrupted; no file is half-written.\n")


IMPORTING = """
import builtins, os, signal
from jaxstab.__main__ import main

signal.signal(signal.SIGINT, signal.default_int_handler)
load = builtins.__import__

def interrupted(name, *given, **options):
    if name == "click":
        os.kill(os.getpid(), signal.SIGINT)
    return load(name, *given, **options)

builtins.__import__ = interrupted
main()
"""


def test_ctrl_c_while_commands_are_imported_ends_without_a_traceback() -> None:
    done = subprocess.run([sys.executable, "-c", IMPORTING], capture_output=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, b"", b"")


@pytest.mark.campaign
def test_ctrl_c_at_any_moment_ends_a_command_within_3_s(tmp_path: Path) -> None:
    rng = np.random.default_rng(53)
    for k in range(many(300, 4)):
        folder = tmp_path / str(k)
        folder.mkdir()
        command = [*COMMANDS.values()][k % len(COMMANDS)]
        took, told = interrupted(command, rng.uniform(0.05, 8.0), folder)
        assert took < MOST, (command, took, told)
        assert WORKER not in told
