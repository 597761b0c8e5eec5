"""Ten thousand queries leak nothing."""

import subprocess
import sys
from pathlib import Path

import pytest
from atlases import write_small
from campaign import many

# In a process of its own: the checks of shapes and dtypes would be most of the work here.
QUERIES_SCRIPT = """
import gc, random, sys
import jaxstab

atlas = jaxstab.open_atlas(sys.argv[1])
rng = random.Random(5)
plants = [  # few: some thousand plants are remembered
    {
        "gamma": rng.uniform(0.0, 1e-3),
        "delta": rng.uniform(0.0, 0.015),
        "delay": rng.uniform(0.0, 1.5),
    }
    for _ in range(20)
]

def ask(count):
    for _ in range(count):
        point = {"alpha": rng.uniform(0.0, 0.4), "beta": rng.uniform(0.0, 0.9)}
        atlas.query(**point, **rng.choice(plants))
    gc.collect()
    return sys.getallocatedblocks()

before = ask(500)
print(ask(int(sys.argv[2])) - before)
"""


@pytest.mark.campaign
def test_thousands_of_queries_leak_nothing(tmp_path: Path) -> None:
    completed = subprocess.run(
        [sys.executable, "-c", QUERIES_SCRIPT, str(write_small(tmp_path)), str(many(10_000, 3000))],
        capture_output=True,
        text=True,
        check=False,
    )
    assert completed.returncode == 0, completed.stderr
    assert int(completed.stdout) < 1000  # blocks of memory
