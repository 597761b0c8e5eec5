"""What every test stands on: float64, checked shapes and dtypes, seeded randomness."""

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402
import pytest  # noqa: E402
from hypothesis import settings  # noqa: E402
from jaxtyping import install_import_hook  # noqa: E402

# Before the first import of jaxstab: from here on its annotations are checked at every call.
install_import_hook("jaxstab", "beartype.beartype")

# Every run draws the same examples, and no example is timed.
settings.register_profile("reproducible", derandomize=True, deadline=None)
settings.load_profile("reproducible")


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator that starts from the same seed in every test."""
    return np.random.default_rng(20120412)
