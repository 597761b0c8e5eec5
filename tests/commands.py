"""Commands, run as a user runs them, and what is expected of every failure."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from jaxstab.app.cli.main import main

POINT = ["--alpha", "0.1", "--beta", "0.5", "--gamma", "0.0005", "--delta", "0.01", "--delay", "0"]
EXAMPLE = (Path(__file__).parents[1] / "data/scenes/gains/wall.toml").read_text(encoding="utf-8")
START = "from jaxstab.__main__ import main; main()"


def run(*arguments: str | Path, stdin: str = "") -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments], input=stdin)


def run_process(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", START, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
    )


def run_code(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run lines of Python in a process of their own, without a screen."""
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env=os.environ | {"MPLBACKEND": "Agg"},
        capture_output=True,
        text=True,
        check=False,
    )


def assert_one_sentence(stderr: str, *parts: str | Path) -> None:
    """A refusal on stderr, with the name, the value and what is allowed in it."""
    assert stderr.startswith("jaxstab: ")
    assert stderr.count("\n") == 1
    assert "Traceback" not in stderr
    assert [part for part in map(str, parts) if part not in stderr] == []


def assert_refuses(call: Callable[[], Any], *parts: str) -> None:
    """The same of a ValueError."""
    with pytest.raises(ValueError, match=re.escape(parts[0])) as refused:
        call()
    assert_one_sentence(f"jaxstab: {refused.value}\n", *parts)
