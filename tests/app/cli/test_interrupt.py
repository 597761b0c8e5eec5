"""Ctrl-C ends a command at once, whatever it does, and leaves no process and no file."""

import os
import pty
import signal
import subprocess
import sys
import time
from multiprocessing import active_children
from pathlib import Path

import numpy as np
import pytest
from campaign import many
from commands import START

from jaxstab.app.cli.options import processes

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
LONG = "delay = [0.0, 0.5, 1.0]\nrows = 65\n" + "".join(
    f"{name} = {np.linspace(0.0, most, 65).tolist()}\n"
    for name, most in {"gamma": 1e-3, "delta": 0.015}.items()
)
STUDY = ("study", "scene.toml", "--over", "device.mass=uniform:0.1:0.5", "--samples", "200000")
CONTACT = ("contact", "scene.toml", "--count", "300")
BUILD = ("atlas", "build", "--spec", "long.toml")
COMMANDS = {
    "study": (*STUDY, "-o", "a.h5"),
    "study with workers": (*STUDY, "-o", "a.h5", "--workers", "2"),
    "contact with workers": (*CONTACT, "-o", "a.h5", "--workers", "2"),
    "build": (*BUILD, "-o", "a.h5"),
    "build with workers": (*BUILD, "-o", "a.h5", "--workers", "2"),
}
AS_A_TERMINAL = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
TOLD_START = "from jaxstab.__main__ import main; print('begins', flush=True); main()"


def interrupted(command: tuple[str, ...], seconds: float, folder: Path) -> tuple[float, str]:
    """Interrupt a command as a terminal does, all of its processes; the time it takes, stderr."""
    (folder / "scene.toml").write_text(SCENE)
    (folder / "long.toml").write_text(LONG)
    running = subprocess.Popen(
        [sys.executable, "-c", AS_A_TERMINAL + TOLD_START, *command],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert running.stdout is not None  # it is a pipe
    assert running.stdout.readline() == "begins\n"  # before, Python itself starts
    time.sleep(seconds)
    assert running.poll() is None
    os.killpg(running.pid, signal.SIGINT)
    began = time.monotonic()
    _, told = running.communicate(timeout=60.0)  # stderr is open as long as a worker lives
    took = time.monotonic() - began
    assert running.returncode == -signal.SIGINT
    assert sorted(entry.name for entry in folder.iterdir()) == ["long.toml", "scene.toml"]
    assert "Traceback" not in told  # nor of workers
    assert "leaked" not in told
    return took, told


@pytest.mark.parametrize(
    ("name", "seconds"),
    [
        ("study", 0.5),
        ("build", 1.5),
        pytest.param("study with workers", 5.0, marks=pytest.mark.campaign),
        pytest.param("build with workers", 5.0, marks=pytest.mark.campaign),
    ],
)
def test_ctrl_c_ends_a_command(name: str, seconds: float, tmp_path: Path) -> None:
    interrupted(COMMANDS[name], seconds, tmp_path)


@pytest.mark.campaign
def test_ctrl_c_at_any_moment_ends_a_command_within_a_second(tmp_path: Path) -> None:
    rng = np.random.default_rng(53)
    for k in range(many(300, 5)):
        folder = tmp_path / str(k)
        folder.mkdir()
        command = [*COMMANDS.values()][k % len(COMMANDS)]
        took, told = interrupted(command, rng.uniform(0.05, 8.0), folder)
        assert took < 1.0, (command, took, told)


ENDLESS = """
import os, signal, sys, threading
from pathlib import Path

import jax

from jaxstab.atlas import AtlasSpec, build

def endless(*_):
    threading.Timer(1.0, os.kill, (os.getpid(), int(sys.argv[1]))).start()
    jax.lax.while_loop(lambda x: x < 2.0, jax.numpy.sin, 1.0).block_until_ready()

signal.signal(signal.SIGINT, signal.SIG_DFL)
build.LimitPlan.computed = endless
build.write_atlas(AtlasSpec(gamma=[0.0], delta=[0.0], delay=[0.0]), Path("a.h5"))
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_program_of_xla_does_not_keep_a_build_from_its_end(number: int, tmp_path: Path) -> None:
    words = [sys.executable, "-c", ENDLESS, str(int(number))]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, timeout=60.0, check=False)
    assert (done.returncode, done.stderr) == (-number, b"")
    assert [*tmp_path.iterdir()] == []


def test_a_bar_that_is_interrupted_leaves_the_cursor() -> None:
    script = (
        AS_A_TERMINAL + "import os; from jaxstab.app.cli.options import at_work; bar = at_work('a')"
    )
    script += "; bar.__enter__(); os.kill(os.getpid(), signal.SIGKILL)"
    ours, theirs = pty.openpty()
    subprocess.run([sys.executable, "-c", script], stderr=theirs, check=False)
    shown = os.read(ours, 10_000)
    os.close(ours), os.close(theirs)
    hidden, visible = b"\033[?25l", b"\033[?25h"
    assert shown.rfind(visible) > shown.rfind(hidden) >= 0


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
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGINT, b"", b"")


def test_a_command_that_ignores_ctrl_c_goes_on_ignoring_it() -> None:
    script = "import signal, os; signal.signal(signal.SIGINT, signal.SIG_IGN); "
    script += (
        "import jaxstab.app.cli.main as m; m.main = lambda: os.kill(os.getpid(), signal.SIGINT); "
        + START
    )
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0


# Workers.


def test_ctrl_c_stays_as_it_was_here_and_ends_a_worker_at_once() -> None:
    blocked, handler = signal.pthread_sigmask(signal.SIG_BLOCK, []), signal.getsignal(signal.SIGINT)
    with processes(1) as pool:
        assert pool.submit(signal.getsignal, signal.SIGINT).result() == signal.SIG_DFL
        assert (
            signal.SIGINT not in pool.submit(signal.pthread_sigmask, signal.SIG_BLOCK, []).result()
        )
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


ORPHANS = """
import os, sys, time
from jaxstab.app.cli.options import processes

with processes(2) as pool:
    pool.submit(abs, 1).result()
    pool.submit(time.sleep, 1e3)
    pool.submit(time.sleep, 1e3)
    os.kill(os.getpid(), int(sys.argv[1]))
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_their_command_which_says_nothing_of_them(number: int) -> None:
    words = [sys.executable, "-c", ORPHANS, str(int(number))]
    # A worker that went on would hold stderr open.
    done = subprocess.run(words, capture_output=True, timeout=60.0, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (-number, b"", b"")
