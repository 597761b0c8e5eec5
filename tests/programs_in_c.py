"""Programs in C around the reader of data/readers and around guards, for tests that ask them."""

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

STRICT = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"]
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


def rows_of(program: Path, count: int, seed: int) -> np.ndarray:
    """Calls of a guard at random: K, B, mass, delay, then K, B, the code and the largest K."""
    done = subprocess.run(
        [program, "calls", str(count), str(seed)], capture_output=True, check=True
    )
    return np.frombuffer(done.stdout).reshape(-1, 8)
