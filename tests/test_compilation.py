"""What meets a compiler: plain numbers never meet JAX at all, and the rest compiles few programs.

Each question is put to a fresh process, whose programs nobody else has compiled.
"""

import json
import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from calls import COMPUTING_CALLS, outcome

TESTS = Path(__file__).parent

# What is written for both array namespaces; all other functions still ask JAX for everything.
CONVERTED = {"characteristic_polynomial", "companion_matrix", "plant_coefficients"}

# No JAX array can be given to them: they take a HapticLoop and a HandRange alone.
WITHOUT_ARRAYS = {"optimal_gains", "robust_limit", "wall_limits"}

WITHOUT_JAX = """
import json, sys

class NoJax:
    def find_spec(self, name, *_):
        if name.partition(".")[0] in ("jax", "jaxlib"):
            raise ImportError("JAX was asked for")

sys.meta_path.insert(0, NoJax())
from calls import outcome
print(json.dumps({name: outcome(name) for name in sys.argv[1:]}))
"""

IN_SINGLE_PRECISION = """
import json, sys
import jax.numpy as jnp
from calls import outcome

print(json.dumps({name: outcome(name, jnp.asarray) for name in sys.argv[1:]}))
"""


def in_new_process(script: str, **environment: str) -> dict[str, str]:
    completed = subprocess.run(
        [sys.executable, "-c", script, *sorted(CONVERTED)],
        cwd=TESTS,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert completed.returncode == 0, completed.stderr
    return json.loads(completed.stdout)


@cache
def without_jax() -> dict[str, str]:
    return in_new_process(WITHOUT_JAX)


@cache
def in_single_precision() -> dict[str, str]:
    return in_new_process(IN_SINGLE_PRECISION, JAX_ENABLE_X64="0")


@pytest.mark.parametrize("name", sorted(CONVERTED))
def test_plain_numbers_are_answered_without_jax_as_with_it(name: str) -> None:
    assert "JAX was asked for" not in without_jax()[name]
    assert without_jax()[name] == outcome(name)


@pytest.mark.parametrize("name", sorted(CONVERTED - WITHOUT_ARRAYS))
def test_jax_arrays_are_refused_without_x64(name: str) -> None:
    kind, _, message = in_single_precision()[name].partition(": ")
    assert kind == "RuntimeError"
    assert "jax_enable_x64" in message
    assert "\n" not in message


def test_the_names_are_those_of_functions_that_compute() -> None:
    assert set(COMPUTING_CALLS) >= CONVERTED | WITHOUT_ARRAYS
