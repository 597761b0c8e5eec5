"""libFuzzer looks at the reader in C: no file may make it read or write beyond its memory."""

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from campaign import many
from programs_in_c import READER, hdf5_options

HERE = Path(__file__).parents[1]
SECONDS = many(900, small=10)


@pytest.fixture(scope="module")
def fuzzer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The harness with the sanitizers of addresses and undefined behaviour."""
    compiler = shutil.which("clang")
    if compiler is None:
        pytest.skip("clang is not installed")
    program = tmp_path_factory.mktemp("fuzz") / "fuzz_reader"
    warned = ["-std=c99", "-g", "-O1", "-Wall", "-Wextra", "-Werror", f"-I{READER}"]
    sanitized = ["-fsanitize=fuzzer,address,undefined", "-fno-sanitize-recover=all"]
    done = subprocess.run(
        [compiler, *warned, *sanitized, HERE / "fuzz_reader.c", *hdf5_options(), "-o", program],
        capture_output=True,
        text=True,
    )
    if "cannot find" in done.stderr:
        pytest.skip("libFuzzer is not installed")
    assert done.returncode == 0, done.stderr
    return program


def start() -> bytes:
    """The input of a sound table: two nodes along each axis, three rows."""
    nodes = np.array([0.0, 1.0, 0.0, 0.5, 0.0, 1.0, 0.0, 0.5, 1.0])
    limits = np.tile([0.0, 0.1], 24), np.tile([0.0, 1.0], 8)
    errors = np.full(4 + 2, 1e-4, np.float32)
    return (
        bytes([1, 1, 1, 1])
        + nodes.tobytes()
        + b"".join(v.tobytes() for v in limits)
        + (errors.tobytes() + b"\x01")
    )


def fuzzed(fuzzer: Path, folder: Path, *options: str) -> str:
    """What libFuzzer says; a crash is an error, and so are 2 GB of memory or 10 s for one file.

    The sanitizer watches the memory in use. libFuzzer's own limit is for the peak, which Linux
    hands down from the process that starts it: pytest, after tests that need much.
    """
    corpus = folder / "corpus"
    corpus.mkdir()
    (corpus / "start").write_bytes(start())
    limits = ["-rss_limit_mb=0", "-malloc_limit_mb=1200", "-timeout=10", "-max_len=20000"]
    done = subprocess.run(
        [fuzzer, *limits, *options, corpus],
        capture_output=True,
        text=True,
        cwd=folder,
        env=os.environ | {"ASAN_OPTIONS": "allocator_may_return_null=1:hard_rss_limit_mb=2000"},
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stderr


@pytest.mark.campaign
def test_the_corpus_and_some_mutants_are_read_safely(fuzzer: Path, tmp_path: Path) -> None:
    said = fuzzed(fuzzer, tmp_path, "-runs=20000", "-seed=1")
    assert "Done 20000 runs" in said


@pytest.mark.campaign
def test_minutes_of_mutants_are_read_safely(fuzzer: Path, tmp_path: Path) -> None:
    """15 minutes at full size."""
    said = fuzzed(fuzzer, tmp_path, f"-max_total_time={SECONDS}")
    assert "Done " in said
