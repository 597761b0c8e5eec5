"""Programs in C around the reader of data/readers and around guards, for tests that ask them."""

import os
import shutil
import subprocess
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

STRICT = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"]
READER = Path(__file__).resolve().parents[1] / "data" / "readers" / "c"


def compiled(
    source: Path, folder: Path, *choices: Sequence[str], libraries: Sequence[str] = ("-lm",)
) -> Path:
    """The program of a source in a folder, by the first choice of options that the compiler knows.

    A test that needs a compiler is skipped where there is none.
    """
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler")
    program = folder / source.stem
    for options in choices:
        words = [compiler, "-std=c99", *options, f"-I{READER}", source, *libraries, "-o", program]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        if done.returncode == 0:
            return program
    pytest.fail(done.stderr)


def hdf5_options() -> list[str]:
    """What a compiler needs for libhdf5; a test that needs it is skipped where it is missing.

    ``HDF5_DIR`` names a folder with ``include`` and ``lib``, else pkg-config is asked.
    """
    folder = os.environ.get("HDF5_DIR")
    if folder is not None:
        return [f"-I{folder}/include", f"-L{folder}/lib", "-lhdf5", "-lm"]
    for package in ("hdf5", "hdf5-serial"):
        words = ["pkg-config", "--cflags", "--libs", package]
        with suppress(FileNotFoundError):
            done = subprocess.run(words, capture_output=True, text=True, check=False)
            if done.returncode == 0:
                return [*done.stdout.split(), "-lm"]
    pytest.skip("libhdf5 is not installed for C (Debian: libhdf5-dev)")


def rows_of(program: Path, count: int, seed: int) -> np.ndarray:
    """Calls of a guard at random: K, B, mass, delay, then K, B, the code and the largest K."""
    done = subprocess.run(
        [program, "calls", str(count), str(seed)], capture_output=True, check=True
    )
    return np.frombuffer(done.stdout).reshape(-1, 8)
