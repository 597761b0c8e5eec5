"""libFuzzer looks at the reader in C: no file may make it read or write beyond its memory."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from campaign import many
from programs_in_c import READER

HERE = Path(__file__).parent
SECONDS = many(900, small=20)


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
        [compiler, *warned, *sanitized, HERE / "fuzz_reader.c", "-lm", "-o", program],
        capture_output=True,
        text=True,
    )
    if "cannot find" in done.stderr:
        pytest.skip("libFuzzer is not installed")
    assert done.returncode == 0, done.stderr
    return program


def fuzzed(fuzzer: Path, folder: Path, *options: str) -> str:
    """What libFuzzer says; a crash is an error, and so are 2 GB of memory or 10 s for one file.

    The sanitizer watches the memory in use. libFuzzer's own limit is for the peak, which Linux
    hands down from the process that starts it: pytest, after tests that need much.
    """
    corpus = folder / "corpus"
    shutil.copytree(HERE / "corpus", corpus)
    limits = ["-rss_limit_mb=0", "-malloc_limit_mb=1200", "-timeout=10", "-max_len=20000"]
    done = subprocess.run(
        [fuzzer, f"-dict={HERE / 'fuzz_reader.dict'}", *limits, *options, corpus],
        capture_output=True,
        text=True,
        cwd=folder,
        env=os.environ | {"ASAN_OPTIONS": "allocator_may_return_null=1:hard_rss_limit_mb=2000"},
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stderr


def test_32_the_corpus_and_some_mutants_are_read_safely(fuzzer: Path, tmp_path: Path) -> None:
    said = fuzzed(fuzzer, tmp_path, "-runs=20000", "-seed=1")
    assert "Done 20000 runs" in said


@pytest.mark.campaign
def test_32_minutes_of_mutants_are_read_safely(fuzzer: Path, tmp_path: Path) -> None:
    """15 minutes at full size."""
    said = fuzzed(fuzzer, tmp_path, f"-max_total_time={SECONDS}")
    assert "Done " in said
