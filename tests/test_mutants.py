"""What single-token changes of the code showed to be untested; each test fails on one of them."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab
from jaxstab.region.filtered_curve import PoleLine
from jaxstab.region.pieces import _all_inside


def test_batched_counts_of_roots_are_those_of_numpys_roots() -> None:
    """other_roots: ``&`` of the steps; the first steps decide where the last one passes."""
    rng = np.random.default_rng(5)
    pairs = rng.uniform(0.3, 1.6, (2, 400)) * np.exp(1j * rng.uniform(0.1, 3.0, (2, 400)))
    roots = np.concatenate([pairs, pairs.conj(), rng.uniform(-0.9, 0.9, (1, 400))])
    falling = np.stack([np.poly(column).real for column in roots.T], axis=1)
    inside = np.abs(roots).max(axis=0) < 1.0
    assert 50 < inside.sum() < 350
    for array in (np.asarray, jnp.asarray):
        assert np.asarray(_all_inside(array(falling))).tolist() == inside.tolist()


@pytest.mark.parametrize("width", [1e-3, 0.3, 1.0, 2.0])
def test_a_curve_meets_its_line_where_both_ways_begin(width: float) -> None:
    """pole_lines: the knots lie below the middle of each side, for wide lines well below."""
    line = SimpleNamespace(is_double=False, half_width=width, angle=1.5)
    ends = PoleLine.knots.fget(line)
    share = (1.5 - np.array(ends)) / width * [1.0, -1.0]
    way = 2.0 * np.sin(width / 2) + width * np.cos(width / 2) * (share - 1.0)
    assert way == pytest.approx(width * (1.0 - share) ** 2 / share, abs=1e-12)


@pytest.mark.parametrize("samples", [0.0, 0.25, 1.0, 1.3, 2.9])
def test_a_traced_delay_has_the_fraction_of_the_delay(samples: float) -> None:
    """loop: a whole delay stays so, a fraction stays, too."""
    loop = jaxstab.HapticLoop(
        device_mass=0.1, device_damping=1.5, sample_time=1e-3, delay=samples * 1e-3
    )
    traced = jax.jit(lambda loop: loop.delay_samples)(loop)
    assert float(traced) == pytest.approx(samples, abs=1e-12)
    code = jax.jit(lambda loop: loop.verdict(1000.0, 10.0))(loop)
    assert int(code) == int(loop.verdict(1000.0, 10.0))
