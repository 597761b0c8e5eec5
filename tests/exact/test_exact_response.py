"""E4: sums of responses and settling against 50 digits, chosen motions and coincident poles."""

import math
from fractions import Fraction
from functools import cache

import flint
import numpy as np
import pytest
from mpmath import mp, mpf

from jaxstab import Device, HapticLoop, Velocity
from jaxstab.exact.response import (
    ModalTerms,
    WallResponses,
    _WallPolynomials,
    disturbed_responses,
    settled_after,
)
from jaxstab.model.device.parts import working_precision
from jaxstab.model.loop import unit_loop
from tests.truth import impulse

CASES = {
    "plain": ((0.004, 0.06, 1e-3, 0.015, 0.0), None, [impulse.difference(1)]),
    "late": ((0.01, 0.1, 0.1, 0.3, 2.5), None, [impulse.difference(1)]),
    "window": (
        (0.004, 0.05, 0.0, 0.01, 1.0),
        Velocity.difference(samples=20),
        [impulse.difference(20)],
    ),
}
LONG = 2600  # samples: what comes later is below 1e-9 of the sums
TRIPLE = 4.0 ** (1 / 3) - 1.0  # the smallest radius of the loop without a hand


@cache
def exact_sums(case: str, cause: str) -> list[mpf]:
    numbers, _, taps = CASES[case]
    return impulse.ExactLoop(*numbers, taps).sums(LONG, **{cause: 1.0})


@pytest.mark.parametrize("by_powers", [False, True])
@pytest.mark.parametrize("case", CASES)
def test_sums_are_those_of_50_digits(case: str, by_powers: bool) -> None:
    """By residues, and by powers of x mod p, which serve where poles coincide."""
    numbers, velocity, _ = CASES[case]
    loop = unit_loop(*numbers[2:], velocity, None)
    if by_powers:
        with working_precision(384):
            wall = _WallPolynomials.from_loop(loop, *numbers[:2])
            found = wall.by_powers(wall.disturbed((True, True, False)), 1)
    else:
        found = disturbed_responses(loop, *numbers[:2], (True, True, False))
    assert found is not None
    assert (found.modes is None) == by_powers
    if by_powers:  # x^m mod p tells terms from those before once the numerator has ended
        assert found.late > wall.whole.degree()
    sums = found.sums(np.eye(4), np.eye(2))  # position, another state, acting and arriving force
    for of_input, cause in zip(sums, ("error", "pushed"), strict=True):
        expected = exact_sums(case, cause)
        with mp.workdps(50):
            assert 0 <= mpf(float(of_input[0])) / expected[0] - 1 < 2e-9
            assert 0 <= mpf(float(of_input[2])) / expected[2] - 1 < 2e-9
        assert of_input[3] == pytest.approx(of_input[2], rel=1e-9)


@pytest.mark.parametrize("excitation", ["force", "impact"])
def test_a_triple_pole_settles_as_its_recursion(excitation: str) -> None:
    alpha, beta = 6.0 * TRIPLE**2 - 2.0, 2.0 * TRIPLE**3
    x, v, last = -1.0, 0.0, -1.0  # from rest, by a force that moves it by 1
    if excitation == "impact":
        x, v, last = 0.0, 1.0, 0.0
    positions = []
    for k in range(200):
        positions.append(x)
        force = -alpha * x - beta * (x - last if k or excitation == "impact" else 0.0)
        x, v, last = x + v + force / 2.0, v + force, x
    size = np.abs(positions)
    level = 0.02 * (size.max() if excitation == "impact" else 1.0)
    loop = unit_loop(0.0, 0.0, 0.0, None, None)
    expected = np.flatnonzero(size > level)[-1] + 1
    assert settled_after(loop, alpha, beta, excitation, 0.02, 1000) == expected


def test_poles_that_coincide_exactly_are_summed_and_settle() -> None:
    """A free, critically damped mass: x = 1 - (1 + w t) exp(-w t), and all of it is positive."""
    w = 0.0625
    loop = unit_loop(w**2, 2.0 * w, 0.0, None, None)
    found = disturbed_responses(loop, 0.0, 0.0, (False, False, True))
    assert found is not None
    assert found.modes is None
    times = np.arange(400)
    deviation = (1.0 + w * times) * np.exp(-w * times)
    expected = np.flatnonzero(deviation > 0.02)[-1] + 1
    assert settled_after(loop, 0.0, 0.0, "force", 0.02, 1000) == expected
    # From position 1 at rest it returns likewise; the sum of (1 + w k) q^k, q = exp(-w).
    q = math.exp(-w)
    total = 1.0 / (1.0 - q) + w * q / (1.0 - q) ** 2
    there = np.linalg.solve([[1.0, 0.0], [-2.0 * w, 1.0]], [1.0, 0.0])  # position 1, velocity 0
    sums = found.sums(np.eye(4)[:1], there[None])
    assert 0.0 <= sums[0, 0] / total - 1.0 < 1e-8


@pytest.mark.parametrize("excitation", ["force", "impact"])
def test_a_sample_next_to_the_tolerance_is_on_its_side_of_it(excitation: str) -> None:
    """A free oscillator: a level one float above and below a sample, of 50 digits."""
    gamma, delta, sample = 0.09, 0.06, 74 if excitation == "force" else 79
    with mp.workdps(50):
        g, d = mpf(gamma), mpf(delta)
        w = mp.sqrt(g - d * d / 4)

        def moved(k: int) -> mpf:
            if excitation == "impact":
                return abs(mp.exp(-d * k / 2) * mp.sin(w * k))
            return abs(mp.exp(-d * k / 2) * (mp.cos(w * k) + d / 2 / w * mp.sin(w * k)))

        largest = max(map(moved, range(400))) if excitation == "impact" else mpf(1)
        size = moved(sample) / largest
        assert all(moved(k) / largest < size for k in range(sample + 1, 400))
        level = float(size)
        above = level if mpf(level) >= size else np.nextafter(level, 1.0)
        below = np.nextafter(above, 0.0)
        assert mpf(float(below)) < size <= mpf(float(above))
        before = max(k for k in range(sample) if moved(k) / largest > mpf(float(above))) + 1
    loop = unit_loop(gamma, delta, 0.0, None, None)
    assert settled_after(loop, 0.0, 0.0, excitation, float(above), 1000) == before
    assert settled_after(loop, 0.0, 0.0, excitation, float(below), 1000) == sample + 1


@pytest.mark.parametrize("excitation", ["force", "impact"])
@pytest.mark.parametrize("slow", [0.0625, 0.001])
def test_poles_that_coincide_settle_as_late_as_they_do(slow: float, excitation: str) -> None:
    """Critically damped, so that powers bound what is left; 7 or 400 samples, or thousands."""
    loop = unit_loop(slow**2, 2.0 * slow, 0.0, None, None)
    times = slow * np.arange(20000)
    size = (1.0 + times if excitation == "force" else times) * np.exp(-times)
    expected = np.flatnonzero(size > 0.02 * size.max())[-1] + 1
    assert settled_after(loop, 0.0, 0.0, excitation, 0.02, 20000) == expected


def test_an_impact_does_not_move_the_actuator() -> None:
    """Of a free device the motion is exp(-d t/2) sin(w t)/w over the mass, in closed form."""
    mass, damping, stiffness, period = 0.25, 5.0, 300.0, 1e-3
    device = Device.mass_spring_damper(mass, damping=damping, stiffness=stiffness)
    loop = HapticLoop(device=device.with_actuator(100.0), sample_time=period)
    rate, times = damping / mass, period * np.arange(100)
    w = np.sqrt(stiffness / mass - rate**2 / 4.0)
    truth = np.exp(-rate * times / 2.0) * np.sin(w * times) / w
    with working_precision(384):
        wall = _WallPolynomials.from_loop(loop, 0.0, 0.0)
        found = wall.by_powers(wall.begun(is_impact=True), 100)
        assert found is not None
    moved = found.head[0, 0, :100]
    np.testing.assert_allclose(moved / moved[1], truth / truth[1], rtol=1e-9, atol=1e-9)


def test_a_force_arrives_a_sample_before_it_acts_and_brings_back() -> None:
    """Of an error of the position, of the force, and of friction: position 1, and velocity 1."""
    found = disturbed_responses(unit_loop(0.0, 0.1, 1.0, None, None), 0.01, 0.1, (True,) * 3)
    assert found is not None
    acting, arriving = found.head[:, 2], found.head[:, 3]
    np.testing.assert_array_equal(acting[:, 1:], arriving[:, :-1])
    moved = -math.expm1(-0.1) / 0.1  # in a sample, by the velocity
    first = [-0.11, 1.0, -0.11, 0.0], [0.1, 0.0, 0.0, -0.11 * moved]  # a wall of 0.01 and 0.1
    np.testing.assert_allclose(arriving[:, 1], first[0], rtol=1e-15)
    np.testing.assert_allclose(arriving[[0, 3], 2], [first[1][0], first[1][3]], rtol=1e-15)


@pytest.mark.parametrize("late_steps", [1, 3, 4, 6])
def test_forces_arrive_between_the_steps_of_a_simulated_mass(late_steps: int) -> None:
    """Of four steps a sample; Euler's method step by step, after a force of 1 for a sample."""
    step, mass, drag, stiffness, damping = 2.5e-4, 0.2, 3.0, 800.0, 4.0
    device = Device.simulated(mass, damping=drag, step=step, integrator="semi-implicit")
    loop = HapticLoop(device=device, sample_time=4 * step, delay=late_steps * step)
    found = disturbed_responses(loop, stiffness, damping, (False, True, False))
    assert found is not None
    x = v = last = 0.0
    forces, positions = [0.0] * late_steps, []
    for k in range(8):
        positions.append(x)
        force = float(k == 0) - stiffness * x - damping * (x - last) / (4 * step)
        last, forces = x, forces + [force] * 4
        for now in forces[:4]:
            v += step * (now - drag * v) / mass
            x += step * v
        forces = forces[4:]
    start = np.flatnonzero(found.head[0, 0])[0] - np.flatnonzero(positions)[0]
    moved = found.head[0, 0, start:][: len(positions)]
    np.testing.assert_allclose(moved, positions, rtol=1e-12, atol=1e-18)


@pytest.mark.parametrize("excitation", ["force", "impact"])
def test_a_wall_that_settles_at_the_horizon_has_settled(excitation: str) -> None:
    loop = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3, delay=1e-3)
    settled = settled_after(loop, 1000.0, 20.0, excitation, 0.02, 1000)
    for horizon, expected in ((settled, settled), (settled - 1, math.nan)):
        found = settled_after(loop, 1000.0, 20.0, excitation, 0.02, int(horizon))
        assert found == pytest.approx(expected, nan_ok=True)


def test_what_is_not_stable_or_no_number_has_no_sums() -> None:
    loop = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
    for wall, settled in (((1e6, 20.0), math.inf), ((0.0, 10.0), math.inf)):
        assert disturbed_responses(loop, *wall, (True, True, True)) is None
        assert settled_after(loop, *wall, "force", 0.02, 1000) == settled
    assert math.isnan(settled_after(loop, math.nan, 20.0, "force", 0.02, 1000))
    assert math.isnan(settled_after(loop, 1000.0, 20.0, "force", 0.02, 60))
    assert settled_after(loop, 1000.0, 20.0, "force", 0.02, 69) == 69.0


def modes_of(poles: list[Fraction], error: float = 0.0) -> ModalTerms:
    """Real poles, each with the residue 1, which may be wrong by an error."""
    values, ones = np.array(poles, float), np.ones((1, 1, len(poles)))
    balls = [(flint.acb(value), flint.acb(1)) for value in values.tolist()]
    sizes, errors, gaps = ones * (1.0 + error), ones * error, 1.0 - abs(values)
    return ModalTerms(values + 0j, ones + 0j, sizes, errors, abs(values), gaps, balls)


@pytest.mark.parametrize("share", [Fraction(-1, 2**41), Fraction(0), Fraction(1, 2**39)])
def test_a_bound_has_fallen_to_a_limit_where_fractions_have_it(share: Fraction) -> None:
    """Of a half to the power of t: a limit a little below that of 10 is met by 11 alone."""
    limit = float(Fraction(1, 2**10) * (1 + share))
    found = modes_of([Fraction(1, 2)]).terms_above(limit, 1000)
    assert Fraction(1, 2**found) <= Fraction(limit)
    assert found == (10 if share > 0 else 11)
    assert modes_of([Fraction(1, 2)]).terms_above(limit, 8) == 9  # none of so few


@pytest.mark.parametrize("error", [0.0, 2.0**-30])
@pytest.mark.parametrize("count", [1, 40])
def test_terms_from_poles_are_those_of_fractions_but_for_a_bound_that_falls(
    count: int, error: float
) -> None:
    poles = [Fraction(k + 1, 2 * count) * (-1) ** k for k in range(count)]
    modes = modes_of(poles, error)
    values, wrong = modes.values(256)
    poles = [Fraction(pole) for pole in modes.poles.real.tolist()]  # as they were rounded
    assert len(values) >= 256
    for t in (0, 1, 15, 16, 17, 100, 255):
        exact = (1 + Fraction(error)) * sum(pole**t for pole in poles)
        assert abs(Fraction(float(values[t])) - exact) <= Fraction(float(wrong[t]))
    late = np.arange(len(values)) // 16 * 16
    assert np.all(wrong <= (1e-13 + 2.0 * error) * count * 0.5**late)


@pytest.mark.parametrize("gap", [3e-6, 1e-6, 2e-7])
def test_millions_of_products_are_wrong_by_less_than_is_said(gap: float) -> None:
    (pole,) = modes_of([Fraction(1.0 - gap)]).poles.real.tolist()
    values, wrong = modes_of([Fraction(pole)]).values(1 << 20)
    with mp.workdps(40):
        error = abs(float(values[-1]) - mpf(pole) ** (len(values) - 1))
        assert values[-1] * 2.0**-48 < error <= wrong[-1]
    assert 2.0**-40 < wrong[-1] / values[-1] < 2.0**-39.9  # 4 units for each of 2048 powers


def test_sums_of_many_small_terms_are_no_less_than_those_of_fractions() -> None:
    """Beside 1 each of them is lost by float64, and 15 of 127 where eight sums run side by side."""
    head = np.full(128, 2.0**-53)
    head[0] = 1.0
    found = WallResponses(head[None, None], flint.arb_poly([])).sums(np.eye(1), np.eye(1))
    exact = 1 + 127 * Fraction(1, 2**53)
    assert 0 <= Fraction(float(found[0, 0])) - exact < Fraction(1, 2**43)


@pytest.mark.parametrize(
    ("level", "expected"), [(0.25, 3.0), (0.0625, None), (0.125 * (1.0 - 2.0**-51), None)]
)
def test_without_poles_all_of_the_last_terms_must_be_small(
    level: float, expected: float | None
) -> None:
    """1, 0, 1/2, 0, 1/4, 0, 1/8: later terms are no larger than the last two in the head."""
    head = [2.0 ** -(k // 2) if k % 2 == 0 else 0.0 for k in range(7)]
    found = WallResponses(np.array(head)[None, None], flint.arb_poly(head), late=5)
    assert found.settled(level, 10, is_impact=False) == expected


@pytest.mark.parametrize("delta", [2e-17, 2e-40])
def test_a_mode_that_is_next_to_the_circle_is_summed(delta: float) -> None:
    """A swing that loses half as much a sample: |cos| is 2/pi in the mean, and 1 at most."""
    found = disturbed_responses(
        unit_loop(0.09, delta, 0.0, None, None), 0.0, 0.0, (False, False, True)
    )
    assert found is not None
    (total,) = found.sums(np.eye(4)[:1], np.array([[1.0, 0.0]]))
    assert 2.0 / np.pi * (2.0 / delta) * 0.999 < total < 2.0 / delta * 1.2
    assert found.modes is not None
    (modulus,), (gap,) = found.modes.moduli.tolist(), found.modes.gaps.tolist()
    with mp.workdps(60):
        truth = mp.exp(-mpf(delta) / 2)
        assert truth <= mpf(modulus) < truth * (1 + 4e-15)
        assert (1 - truth) * (1 - 4e-15) < mpf(gap) <= 1 - truth


def test_the_filter_of_a_gain_that_is_0_leaves_modes_told_apart() -> None:
    """Its double pole is none of the loop, which is too close to the circle for powers."""
    loop = unit_loop(0.09, 1e-8, 0.0, Velocity.low_pass(0.1, order=2), None)
    assert disturbed_responses(loop, 1e-9, 0.0, (True, False, False)) is not None


@pytest.mark.parametrize("growth", [0.0, 0.9])
def test_sums_allow_for_what_rows_and_columns_may_be_wrong_by(growth: float) -> None:
    """By 2^-150 of the largest entry, which a series of 2^150 makes as large as the other's 1."""
    head = np.array([[[1.0], [2.0**150]]])
    for values, side in ((head, 0), (head.reshape(2, 1, 1), 1)):
        sides = [np.eye(1), np.eye(1)]
        sides[side] = np.array([[1.0, 0.0]])
        found = WallResponses(values, flint.arb_poly([]), growth=growth).sums(*sides)
        assert 2.0 <= found[0, 0] / (1.0 + growth) < 3.0


@pytest.mark.parametrize("error", [0.0, 2.0**-10])
def test_sums_allow_for_what_residues_may_be_wrong_by(error: float) -> None:
    """A half to the power of t, times 1 or as much more as is allowed: their sum is 2."""
    modes = modes_of([Fraction(1, 2)], error)
    found = WallResponses(np.zeros((1, 1, 1)), flint.arb_poly([]), modes).sums(np.eye(1), np.eye(1))
    assert 0.0 <= found[0, 0] / (2.0 * (1.0 + error)) - 1.0 < 1e-11


@pytest.mark.parametrize(("horizon", "expected"), [(30, math.nan), (36, math.nan), (37, 0.0)])
def test_what_is_not_known_up_to_twice_the_horizon_is_not_settled(
    horizon: int, expected: float
) -> None:
    """0.9001^t - 0.9^t is below 1e-3 from the first on, its bound, the sum, from 73 on."""
    poles = [Fraction(9001, 10000), Fraction(9, 10)]
    modes = modes_of(poles)
    (first, one), (second, _) = modes.balls
    modes = modes._replace(
        residues=np.array([[[1.0, -1.0]]], complex), balls=[(first, one), (second, -one)]
    )
    found = WallResponses(np.zeros((1, 1, 1)), flint.arb_poly([]), modes)
    assert found.settled(1e-3, horizon, is_impact=False) == pytest.approx(expected, nan_ok=True)
    assert found.settled(2.5, horizon, is_impact=False) == 0.0  # the bound is 2 at first


def test_the_largest_term_is_looked_for_among_all_that_may_be_it() -> None:
    """The second is larger by 2^-60, and smaller in values that are wrong by 2^-52."""
    values, wrong = np.array([1.0, 1.0 - 2.0**-53, 0.5]), np.full(3, 2.0**-52)
    with working_precision(192):
        more = 1 + flint.arb(2) ** -60
        found = WallResponses(values[None, None], flint.arb_poly([1, more, 0.5]))
        assert found._largest_ball(values, wrong) == more


def test_after_a_blow_half_of_the_largest_term_is_no_less_than_half_by_rounding() -> None:
    """0.5 and 2^-60 more, which its float64 does not have."""
    with working_precision(192):
        more = flint.arb(0.5) + flint.arb(2) ** -60
        for second, expected in ((flint.arb(0.5), 1.0), (more, 2.0)):
            head = np.array([[[1.0, 0.5, 0.0]]])
            found = WallResponses(head, flint.arb_poly([1, second, 0]), late=2)
            assert found.settled(0.5, 10, is_impact=True) == expected


def test_after_a_blow_terms_are_looked_at_down_to_a_share_of_the_largest() -> None:
    """A half, and 1/2, 1/4, 1/8, ... behind it: the last one above a twentieth is 1/16."""
    modes = modes_of([Fraction(1, 2)])
    ((pole, one),) = modes.balls
    halves = 0.5 * modes.residues, 0.5 * modes.sizes
    modes = modes._replace(residues=halves[0], sizes=halves[1], balls=[(pole, one / 2)])
    found = WallResponses(np.array([[[0.5]]]), flint.arb_poly([0.5]), modes)
    assert found.settled(0.1, 100, is_impact=True) == 5.0


def test_a_ball_that_is_wider_than_a_small_level_is_not_below_it() -> None:
    head = np.array([[[1.0, 0.9e-25]]])
    with working_precision(192):
        balls = flint.arb_poly([1, flint.arb(0.9e-25, 0.9e-24)])
        modes = modes_of([Fraction(1, 2)])
        ((pole, one),) = modes.balls
        modes = modes._replace(
            residues=1e-26 * modes.residues, sizes=1e-26 * modes.sizes, balls=[(pole, one * 1e-26)]
        )
        found = WallResponses(head, balls, modes)
        assert found.settled(1e-25, 10, is_impact=True) == 2.0


def test_after_a_blow_the_level_is_a_share_of_the_largest_deviation() -> None:
    """A tenth of 0.5; 0.15 is above it, and below a tenth over 0.5."""
    head = [0.5, 0.15, 0.01, 0.0]
    found = WallResponses(np.array(head)[None, None], flint.arb_poly(head), late=2)
    assert found.settled(0.1, 10, is_impact=True) == 2.0
    assert found.settled(0.1, 10, is_impact=False) == 2.0
    assert found.settled(0.2, 10, is_impact=False) == 1.0
