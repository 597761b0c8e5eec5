"""E2 against mpmath and roots that were chosen."""

from math import isfinite

import flint
import numpy as np
import pytest
from mpmath import mp, mpf

from jaxstab import Filter, HapticLoop, Velocity
from jaxstab.exact.roots import (
    isolated_roots,
    poles,
    real_or_not,
    rough_radius,
    spectral_radius,
)
from jaxstab.model.balls import Factored, Triple, ball_triple
from tests.truth.plain import Loop, radius
from tests.truth.random_loops import DeviceLoop, MassLoop

NOTHING = Factored(flint.arb_poly([]))


@pytest.mark.parametrize("draw", [MassLoop.drawn, DeviceLoop.drawn])
@pytest.mark.parametrize("seed", range(3))
def test_the_radius_is_that_of_mpmath_to_the_last_bit(draw: object, seed: int) -> None:
    truth = Loop.of(draw(np.random.default_rng([524, seed])))  # type: ignore[operator]
    found = spectral_radius(lambda: ball_triple(truth.loop), 0.0625, 0.25)
    expected = radius(truth.polynomial(0.0625, 0.25))
    assert isfinite(found.error)
    with mp.workdps(60):
        assert abs(mpf(found.value) - expected) <= found.error
    assert found.error <= np.spacing(found.value)


def test_the_smallest_radius_at_a_triple_root() -> None:
    loop = HapticLoop(device_mass=1.0, device_damping=0.0, sample_time=1.0)
    r = 4.0 ** (1 / 3) - 1.0
    alpha, beta = 6.0 * r * r - 2.0, 2.0 * r**3
    found = spectral_radius(lambda: ball_triple(loop), alpha, beta)
    # p = z^3 - (2 - (a + b)/2) z^2 + (1 + a/2) z - b/2, of these very numbers.
    with mp.workdps(80):
        a, b = mpf(alpha), mpf(beta)
        expected = radius([mpf(1), -(2 - (a + b) / 2), 1 + a / 2, -b / 2])
        assert abs(mpf(found.value) - expected) <= found.error
    assert found.error <= np.spacing(found.value)
    assert abs(found.value - r) < 1e-4


def test_poles_are_those_of_the_closed_form_and_structure() -> None:
    loop = HapticLoop(device_mass=1.0, device_damping=0.0, sample_time=1.0)
    found = poles(lambda: ball_triple(loop), 0.0, 0.0)  # z (z - 1)^2
    assert found.values.tolist() == [1.0, 1.0, 0.0]
    assert found.error == 0.0


def test_a_rough_radius_is_near_the_largest_root_of_the_closed_form() -> None:
    loop, a, b = HapticLoop(device_mass=1.0, device_damping=0.0, sample_time=1.0), 0.5, 0.25
    roots = np.roots([1.0, -(2.0 - (a + b) / 2.0), 1.0 + a / 2.0, -b / 2.0])
    found = rough_radius(lambda: ball_triple(loop), a, b)
    assert found == pytest.approx(np.abs(roots).max(), rel=1e-9)


def test_chosen_roots_come_back() -> None:
    chosen = [0.5, -0.25, 0.75, 0.0]
    rising = flint.fmpq_poly([0, 1])
    for root in chosen[:-1]:
        rising *= flint.fmpq_poly([flint.fmpq(*(-root).as_integer_ratio()), 1])
    triple = Triple(Factored.from_rational(rising), NOTHING, NOTHING)
    found = poles(lambda: triple, 0.0, 0.0)
    assert sorted(found.values.real.tolist()) == sorted(chosen)
    assert found.error < 1e-17


@pytest.mark.parametrize("seed", range(6))
def test_the_error_of_the_poles_is_that_of_the_worst_of_them(seed: int) -> None:
    truth = Loop.of(MassLoop.drawn(np.random.default_rng([524, seed])))
    found = poles(lambda: ball_triple(truth.loop), 0.01, 0.01)
    with mp.workdps(60):
        falling = truth.polynomial(0.01, 0.01)
        exact = mp.polyroots(falling[::-1], maxsteps=500, extraprec=800, asc=True)
        values = [mp.mpc(complex(value)) for value in found.values]
        errors = [min(abs(value - root) for root in exact) for value in values]
        assert max(errors) <= found.error < max(4 * max(errors), mpf(2) ** -60)


@pytest.mark.parametrize("at_minus_one", [0, 1, 2])
@pytest.mark.parametrize("windows", [(), (4,), (5,), (4, 6)])
def test_roots_of_the_structure_are_poles_as_often_as_it_says(
    at_minus_one: int, windows: tuple[int, ...]
) -> None:
    p = Factored(flint.arb_poly([-0.5, 1.0]), 2, 1, at_minus_one, windows)
    rising = [float(c.mid()) for c in p.polynomial().coeffs()]
    found = isolated_roots(p) or []
    counts = {place: sum(root == place for root in found) for place in (0, 1, -1)}
    expected = {0: 2, 1: 1, -1: at_minus_one + sum(n % 2 == 0 for n in windows)}
    assert (counts, len(found)) == (expected, len(rising) - 1)


def test_poles_that_coincide_have_a_radius_but_are_not_told_apart() -> None:
    filters = Filter.low_pass(30.0, order=2)
    loop = HapticLoop(
        device_mass=0.25, device_damping=0.1, sample_time=1e-3, velocity=Velocity() * filters
    )
    pole = float(np.exp(-2.0 * np.pi * 30.0 * 1e-3))  # the filter that runs
    found = spectral_radius(lambda: ball_triple(loop), 100.0, 0.0)
    assert isfinite(found.error)
    plain = HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
    own = spectral_radius(lambda: ball_triple(plain), 100.0, 0.0)
    assert abs(found.value - max(pole, own.value)) <= found.error + own.error
    assert found.error < 1e-15
    answer = poles(lambda: ball_triple(loop), 100.0, 0.0)
    assert np.all(np.isnan(answer.values))
    assert answer.values.shape == (4,)
    assert answer.error == np.inf


def test_double_poles_may_be_farther_out_than_all_coefficients_add_up_to() -> None:
    """(z^2 - 1/16)^2 has the poles 1/4 and -1/4 twice, and coefficients of 33/256 in all."""
    square = flint.arb_poly([-0.0625, 0.0, 1.0])
    found = spectral_radius(lambda: Triple(Factored(square * square), NOTHING, NOTHING), 0.0, 0.0)
    assert abs(found.value - 0.25) <= found.error < 1e-15


def test_a_ball_that_meets_the_real_axis_may_hold_one_of_a_pair() -> None:
    def ball(real: float, low: float, high: float) -> flint.acb:
        return flint.acb(real, flint.arb((low + high) / 2.0, (high - low) / 2.0))

    far = [flint.acb(0.5), ball(-0.5, -1e-9, 1e-9)]
    assert real_or_not(far) == [(root, True) for root in far]
    pair = [ball(0.25, -0.001, 0.003), ball(0.25, -0.003, -0.0015)]  # at +-0.002i, or one beside
    assert real_or_not([*far, *pair]) is None
    pair = [ball(0.25, 0.001, 0.003), ball(0.25, -0.003, -0.001)]
    told = [(root, root in far) for root in far + pair]
    assert real_or_not(far + pair) == told


def test_a_large_radius_is_between_the_bounds_that_are_halved() -> None:
    """A double pole at 3 beside one next to 0: the last coefficient alone is no bound of it."""
    rising = flint.arb_poly([-3, 1]) ** 2 * flint.arb_poly([flint.arb(-0.125) / 1024, 1])
    triple = Triple(Factored(rising), NOTHING, NOTHING)
    found = spectral_radius(lambda: triple, 0.0, 0.0)
    assert isfinite(found.error)
    assert abs(found.value - 3.0) <= found.error < 1e-15


@pytest.mark.parametrize("power", [0, 3])
def test_without_poles_but_for_those_at_0_the_radius_is_0(power: int) -> None:
    triple = Triple(Factored(flint.arb_poly([2]), power), NOTHING, NOTHING)
    assert spectral_radius(lambda: triple, 0.0, 0.0) == (0.0, 0.0)
    assert rough_radius(lambda: triple, 0.0, 0.0) == 0.0
    assert poles(lambda: triple, 0.0, 0.0).values.tolist() == [0.0] * power
