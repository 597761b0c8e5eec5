"""What every test stands on: float64, checked shapes and dtypes, seeded randomness.

What XLA compiles is kept with pytest's own cache: workers of pytest-xdist, the processes that tests
start and the next run do not compile the same again. JAX tells programs apart by what is compiled,
by its own version and by its options; but what it writes on Python 3.14 older ones do not read, and
so each version of Python has a folder. ``--cache-clear`` deletes them. The user's cache is not
touched.
"""

import ctypes
import gc
import os
import resource
import sys
from collections.abc import Iterator
from pathlib import Path

# Threads of BLAS wait for each other busily: two of them took 500 times as long for an exponential
# of a small matrix on two cores that are taken.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import annotations

annotations.install()

import jax  # noqa: E402

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402
import pytest  # noqa: E402
from hypothesis import settings  # noqa: E402

import jaxstab  # noqa: E402
from jaxstab.loop import many  # noqa: E402

# Every run draws the same examples, and no example is timed.
settings.register_profile("reproducible", derandomize=True, deadline=None)
settings.load_profile("reproducible")


_DEGREES, _ONE_DEGREE = many._DEGREES, (41,)  # up to which p(z) of many loops are filled
_STATUS = Path("/proc/self/statm")
_forget_at = 17 << 25  # bytes of a process, from which on it forgets what it has compiled


def pytest_configure(config: pytest.Config) -> None:
    """Name the folder of compiled programs to all processes; workers have it from their parent."""
    if "PYTEST_XDIST_WORKER" not in os.environ and config.pluginmanager.has_plugin("cacheprovider"):
        folder = "programs-{}.{}".format(*sys.version_info)
        jaxstab.use_compilation_cache(config.cache.mkdir(folder))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Fill batches to one degree: a program takes 10 s and 0.5 GB. Campaigns have all degrees."""
    annotations.begin()
    many._DEGREES = _DEGREES if item.get_closest_marker("campaign") else _ONE_DEGREE
    many._FEWEST = dict.fromkeys(_DEGREES, 64)  # else hardly any test would compile


@pytest.fixture(autouse=True)
def _forget_programs() -> Iterator[None]:
    """Keep what XLA needs while it compiles, and what it has compiled, from filling the memory.

    The folder has the programs. What cannot be given back raises the bound: a process that stays
    at its bound would compile anew for every test.
    """
    global _forget_at
    yield
    if _STATUS.exists() and _resident() > _forget_at:
        give_back = ctypes.CDLL(None).malloc_trim  # else the system seldom gets the memory
        give_back(0)
        if _resident() > _forget_at:
            jax.clear_caches()
            gc.collect()  # programs are parts of cycles
            give_back(0)
            _forget_at = max(_forget_at, _resident() + (1 << 27))


def _resident() -> int:
    return int(_STATUS.read_text().split()[1]) * resource.getpagesize()


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator that starts from the same seed in every test."""
    return np.random.default_rng(20120412)
