"""What single-token changes of the code showed to be untested; each test fails on one of them."""

import math

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

import jaxstab
from jaxstab.point.fields import _mode, _outwards, _rounded_up
from jaxstab.point.radius import radius_error
from jaxstab.point.traced_radius import _fitted
from jaxstab.point.verdicts import is_plant_lost
from jaxstab.region.pieces import _is_clear, all_inside
from tests.truth import loop as truth


def test_batched_counts_of_roots_are_those_of_numpys_roots() -> None:
    """other_roots: ``&`` of the steps; the first steps decide where the last one passes."""
    rng = np.random.default_rng(5)
    pairs = rng.uniform(0.3, 1.6, (2, 400)) * np.exp(1j * rng.uniform(0.1, 3.0, (2, 400)))
    roots = np.concatenate([pairs, pairs.conj(), rng.uniform(-0.9, 0.9, (1, 400))])
    falling = np.stack([np.poly(column).real for column in roots.T], axis=1)
    inside = np.abs(roots).max(axis=0) < 1.0
    assert 50 < inside.sum() < 350
    assert all_inside(falling).tolist() == inside.tolist()


def test_a_polynomial_next_to_the_circle_is_doubted_whatever_is_asked_beside_it() -> None:
    """pieces: those of which the first step decides are open no more; others still are."""
    pairs = np.array([1.0 - 1e-14, 0.5, 3.0]) * np.exp(1j * np.array([1.0, 2.0, 0.4]))
    roots = np.stack([pairs, pairs.conj(), np.full(3, 0.7)])
    falling = np.stack([np.poly(column).real for column in roots.T], axis=1)
    assert _is_clear(falling).tolist() == [False, True, True]


@pytest.mark.campaign
@pytest.mark.parametrize("samples", [0.25, 1.0, 0.0, 1.3, 2.9])
def test_a_traced_delay_has_the_fraction_of_the_delay(samples: float) -> None:
    """loop: a whole delay stays so, a fraction stays, too."""
    loop = jaxstab.HapticLoop(
        device_mass=0.1, device_damping=1.5, sample_time=1e-3, delay=samples * 1e-3
    )
    traced = jax.jit(lambda loop: loop.delay_samples)(loop)
    assert float(traced) == pytest.approx(samples, abs=1e-12)
    code = jax.jit(lambda loop: loop.verdict(1000.0, 10.0))(loop)
    assert int(code) == int(loop.verdict(1000.0, 10.0))


def drawn_polynomials(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of degree 5, highest power first, and the largest modulus of a root."""
    pairs = rng.uniform(0.1, 1.4, (2, count)) * np.exp(1j * rng.uniform(0.1, 3.0, (2, count)))
    roots = np.concatenate([pairs, pairs.conj(), rng.uniform(-1.2, 1.2, (1, count))])
    falling = np.stack([np.poly(column).real for column in roots.T], axis=1)
    return falling, np.abs(roots).max(axis=0)


def test_a_sieve_of_polynomials_lets_through_those_with_all_roots_inside() -> None:
    """radius: of each degree all reflections, of circles of any size."""
    falling, moduli = drawn_polynomials(np.random.default_rng(5), 300)
    for radius in (0.8, 1.0, 1.3):
        assert all_inside(falling, radius).tolist() == (moduli < radius).tolist()


def test_bounds_of_radii_hold_for_grids_of_polynomials() -> None:
    """radius: bounds of a grid are those of each polynomial, and bound the true error."""
    falling, moduli = drawn_polynomials(np.random.default_rng(6), 60)
    moved = moduli * (1.0 + np.random.default_rng(7).choice([-1e-7, 0.0, 1e-9], 60))
    grid = np.asarray(radius_error(falling.T.reshape(12, 5, 6), moved.reshape(12, 5)))
    assert grid.shape == (12, 5)
    assert np.mean(np.isfinite(grid)) > 0.9
    assert np.all(np.abs(moved - moduli) <= grid.ravel() + 1e-12)
    alone = [float(radius_error(row, np.array(r))) for row, r in zip(falling.T, moved, strict=True)]
    assert grid.ravel().tolist() == alone


@pytest.mark.parametrize("radius", [0.5, 1.0, 2.0])
def test_the_bound_of_a_radius_is_no_less_than_the_step_that_was_proved(radius: float) -> None:
    """radius: steps are powers of four, and the radius that was tried is rounded; XLA may not."""
    falling = np.poly([radius, 0.3 * radius, -0.2 * radius])
    for own in (np.array(falling), jnp.array(falling)):
        share = float(radius_error(own, own[0] * radius)) / radius
        step = 4.0 ** round(math.log(share, 4.0))
        assert share == pytest.approx(step + 2.0**-52, rel=1e-9)


def test_a_recurrence_gives_its_larger_root() -> None:
    """traced_radius: of a pair, of two real roots, and where one real root is left."""
    rng = np.random.default_rng(8)
    count, size = np.arange(4)[:, None], rng.uniform(0.3, 1.2, 60)
    pair = size * np.exp(1j * rng.uniform(0.2, 2.9, 60))
    real = size * rng.choice([-1.0, 1.0], 60)
    smaller = real * rng.uniform(-0.9, 0.9, 60)
    weights = rng.uniform(0.5, 2.0, (2, 60))
    of_pair = ((weights[0] + 1j * weights[1]) * pair**count).real
    of_two = weights[0] * real**count + weights[1] * smaller**count
    for samples, root in ((of_pair, pair), (of_two, real + 0j), (weights[0] * real**count, real)):
        re, im = _fitted([jnp.asarray(row) for row in samples])
        assert np.asarray(re) == pytest.approx(root.real - 1.0, abs=1e-6)
        assert np.asarray(im) == pytest.approx(np.abs(root.imag), abs=1e-6)


def test_distances_of_many_walls_are_those_to_the_nearest_points() -> None:
    """measures: until the nearest point of each wall is found; to a polygon of many points."""
    region = jaxstab.stable_region(gamma=0.2, delta=0.1, delay=1.0, tolerance=1e-7)
    low, high = region.points.min(axis=0), region.points.max(axis=0)
    walls = np.random.default_rng(11).uniform(
        1.5 * low - 0.5 * high, 1.5 * high - 0.5 * low, (60, 2)
    )
    here, there = region.points[:-1], region.points[1:]
    chord = there - here
    square = np.maximum(np.sum(chord**2, axis=1), 1e-300)
    share = np.clip(np.sum((walls[:, None] - here) * chord, axis=2) / square, 0.0, 1.0)
    feet = here + share[..., None] * chord
    nearest = np.min(np.hypot(*np.moveaxis(walls[:, None] - feet, -1, 0)), axis=1)
    assert np.abs(region.distance(*walls.T)) == pytest.approx(nearest, abs=1e-6)


def test_a_set_without_holes_is_one_component_of_one_loop() -> None:
    """stable_set: so lines of constant alpha may be said to meet it in one interval."""
    region = jaxstab.stable_region(gamma=0.001, delta=0.015, delay=1.0)
    (component,) = region.components
    assert component.loops == region.loops == 1
    assert component.columns_are_intervals


def test_a_circle_without_a_radius_is_refused() -> None:
    """region: 0 itself is no radius."""
    with pytest.raises(ValueError, match="radius is 0"):
        jaxstab.stable_region(gamma=0.2, delta=0.1, delay=1.0, radius=0.0)


def test_numbers_are_rounded_up_to_fewer_bits() -> None:
    """fields: those with a single low bit, too, and no number that has no low bits."""
    low = np.array([0, 1, 2, (1 << 29) - 1])
    for last, count in ((1 << 29, 24), (1 << 52, 1)):
        numbers = (np.float64(1.5).view(np.int64) + low).view(np.float64)
        rounded = np.asarray(_rounded_up(numbers, last))
        step = 2.0 ** (1 - count)
        assert rounded.tolist() == [float(np.ceil(x / step) * step) for x in numbers]


def test_radii_in_float32_hold_those_of_float64() -> None:
    """fields: those that float32 flushes to 0, too."""
    radius = np.array([0.0, 1e-300, 1e-50, 1e-39, 1e-30, 0.7, 3.0])
    for bound in (0.0, 1e-60, 1e-42, 1e-9):
        upper, error = (np.asarray(x, float) for x in _outwards(radius, np.full(7, bound)))
        assert np.all((upper >= radius + bound) & (upper - error <= radius - bound))
        assert np.all(error[-2:] <= 8.0 * max(bound, 2.0**-24 * 4.0))


def test_a_plant_is_lost_next_to_whole_turns_within_a_sample() -> None:
    """verdicts: N(1) = |1 - exp(-delta/2 + i rate)|^2 / gamma, by mpmath."""
    rng = np.random.default_rng(12)
    turns, way = 2.0 * np.pi * rng.integers(1, 5, 200), rng.uniform(-1.5, 1.5, 200)
    away = rng.uniform(0.3, 1.7, 200) * 2.0**-12.5 * turns
    delta, rate = 2.0 * away * np.cos(way), turns + away * np.sin(way)
    gamma = rate**2 + 0.25 * delta**2
    lost = [
        abs(1 - mpmath.exp(mpmath.mpc(-d / 2, r))) ** 2 < 2**-25 * g
        for d, r, g in zip(delta, rate, gamma, strict=True)
    ]
    assert 30 < sum(lost) < 170
    assert is_plant_lost(gamma, delta).tolist() == lost


def test_a_pole_is_shown_to_the_digits_that_its_bound_leaves() -> None:
    """fields: 22 bits of its distances from 0 and from 1, or nothing."""
    rng = np.random.default_rng(13)
    decay, frequency = 10.0 ** rng.uniform(-6.0, 0.5, (2, 300))
    frequency = np.minimum(frequency, 3.0)
    radius, factor = np.exp(-decay), rng.choice([0.9, 1.1], 300)
    bound = factor * 2.0**-22 * np.minimum(radius, np.hypot(decay, frequency))
    shown, ratio = _mode(radius * np.exp(1j * frequency), radius, bound)
    assert np.isnan(shown).tolist() == np.isnan(ratio).tolist() == (factor > 1.0).tolist()
    known = factor < 1.0
    assert shown[known] == pytest.approx(frequency[known], rel=1e-6, abs=2.0**-20)
    true = (decay / np.hypot(decay, frequency))[known]
    assert ratio[known] == pytest.approx(true, rel=1e-6, abs=2.0**-20)


@pytest.mark.parametrize("delay", [0.0, 1.0])
def test_walls_without_stiffness_are_small_gains_of_an_undamped_device(delay: float) -> None:
    """stable_set: held by a spring alone, it is stable with damping, not with as much stiffness."""
    region = jaxstab.stable_region(gamma=1e-3, delta=0.0, delay=delay)
    assert truth.unstable_count(1e-14, 1e-8, 1e-3, 0.0, delay) == 0
    assert truth.unstable_count(1e-8, 1e-14, 1e-3, 0.0, delay) > 0
    assert region.main is not None
    assert region.main.area == region.area


@pytest.mark.parametrize("delay", [0.0, 0.5, 2.0])
def test_a_wall_on_the_boundary_is_not_inside(delay: float) -> None:
    """measures: at alpha = -gamma a root is at 1, and balls leave open on which side it is."""
    gamma, delta = 0.04282458357181218, 0.10920262664902493
    region = jaxstab.stable_region(gamma=gamma, delta=delta, delay=delay)
    low, high = region.beta_limits(-gamma * (1.0 - 1e-9))
    beta = np.linspace(low, high, 7)[1:-1]
    assert not region.contains(-gamma, beta).any()
    assert region.contains(-gamma * (1.0 - 1e-14), beta).all()
    codes = jaxstab.verdict(-gamma, beta, gamma=gamma, delta=delta, delay=delay)
    assert np.all(codes == jaxstab.Verdict.UNSTABLE)
