"""Ten thousand queries leak nothing, and threads that ask one atlas at once agree."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from atlases import small_atlas, write_small

THREADS = 8

# In a process of its own: the checks of shapes and dtypes would be most of the work here.
QUERIES_SCRIPT = """
import gc, random, sys
import jaxstab

atlas = jaxstab.open_atlas(sys.argv[1])
rng = random.Random(5)

def ask(count):
    for _ in range(count):
        point = {"alpha": rng.uniform(0.0, 0.4), "beta": rng.uniform(0.0, 0.9)}
        rest = {"gamma": rng.uniform(0.0, 1e-3), "delta": rng.uniform(0.0, 0.015)}
        atlas.query(**point, **rest, delay=rng.choice([0.0, 1.5]), outside="undecided")
    gc.collect()
    return sys.getallocatedblocks()

before = ask(500)
print(ask(10_000) - before)
"""


@pytest.mark.campaign
def test_ten_thousand_queries_leak_nothing(tmp_path: Path) -> None:
    completed = subprocess.run(
        [sys.executable, "-c", QUERIES_SCRIPT, str(write_small(tmp_path))],
        capture_output=True,
        text=True,
        check=False,
    )
    assert completed.returncode == 0, completed.stderr
    assert int(completed.stdout) < 1000  # blocks of memory


def test_threads_that_ask_one_atlas_agree(rng: np.random.Generator) -> None:
    atlas = small_atlas()

    def points() -> dict[str, np.ndarray]:
        return {
            "alpha": rng.uniform(0.01, 0.3, 200),
            "beta": rng.uniform(0.1, 0.6, 200),
            "gamma": rng.uniform(0.0, 0.001, 200),
            "delta": rng.uniform(0.0, 0.015, 200),
            "delay": rng.choice([0.0, 1.5], 200),
        }

    asked = [points() for _ in range(4 * THREADS)]
    alone = [atlas.query(**some, outside="undecided") for some in asked]
    with ThreadPoolExecutor(THREADS) as pool:
        together = list(pool.map(lambda some: atlas.query(**some, outside="undecided"), asked))
    for one, other in zip(alone, together, strict=True):
        np.testing.assert_array_equal(one.verdict, other.verdict)
        np.testing.assert_array_equal(one.status, other.status)
