"""Programs in C around the reader of data/readers, for tests that ask it."""

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

READER = Path(__file__).resolve().parents[1] / "data" / "readers" / "c"


def compiled(source: Path, folder: Path, *choices: Sequence[str]) -> Path:
    """The program of a source in a folder, by the first choice of options that the compiler knows.

    A test that needs a compiler is skipped where there is none.
    """
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler")
    program = folder / source.stem
    for options in choices:
        words = [compiler, "-std=c99", *options, f"-I{READER}", source, "-lm", "-o", program]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        if done.returncode == 0:
            return program
    pytest.fail(done.stderr)
