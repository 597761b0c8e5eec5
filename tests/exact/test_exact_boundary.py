"""The curve's parts by closed forms, and lines of the boundary whose root is known, by products."""

import math
from collections import Counter
from fractions import Fraction
from itertools import product

import flint
import numpy as np
import pytest
from mpmath import mp, mpc, mpf

from jaxstab import Device, Filter, HapticLoop, Velocity, pid
from jaxstab.exact.boundary import (
    ScaledLoop,
    _has_digits,
    _Kept,
    _start_and_along,
    _without,
    curve_around,
    curve_parts,
    others_inside,
    root_lines,
    undamped_modes,
)
from jaxstab.exact.line import _cosines_of
from jaxstab.model.balls import Factored
from jaxstab.model.loop import unit_loop

DIVISORS = [
    Factored(flint.arb_poly([1]), at_one=1),
    Factored(flint.arb_poly([1]), at_minus_one=1),
    Factored(flint.arb_poly([1.0, -1.25, 1.0])),
]


@pytest.mark.parametrize("at_one", [0, 1, 2])
@pytest.mark.parametrize("at_minus_one", [0, 1])
@pytest.mark.parametrize("windows", [(), (4,)])
@pytest.mark.parametrize("divisor", DIVISORS, ids=["z - 1", "z + 1", "pair"])
@pytest.mark.parametrize("is_known", [True, False])
def test_a_part_without_its_root_times_the_root_is_the_part(
    at_one: int, at_minus_one: int, windows: tuple[int, ...], divisor: Factored, is_known: bool
) -> None:
    """The divisor is counted among the structure, or hidden in the coefficients."""
    rest = flint.arb_poly([0.5, -2.0, 3.0, 1.0])
    quotient = Factored(rest, 1, at_one, at_minus_one, windows)
    product = quotient.times(divisor)
    if not is_known:
        product = Factored(quotient.rest * divisor.polynomial(), *quotient[1:])
    found = [float(c.mid()) for c in _without(product, divisor).polynomial().coeffs()]
    truth = [float(c.mid()) for c in quotient.polynomial().coeffs()]
    np.testing.assert_allclose(found, truth, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("gamma", [0.0, 1e-100])
def test_the_parts_of_a_free_mass_are_its_closed_form(gamma: float) -> None:
    """A delay of 1: z^2 (z - 1)^2 + (z + 1)/2 ((alpha + beta) z - beta); a hand of next to 0."""
    parts = curve_parts(ScaledLoop(unit_loop(gamma, 0.0, 1.0, None, None), (1.0, 1.0)))
    base, plant, stiffness, damping = [0, 0, 1, -2, 1], [0.5, 0.5], [0, 1], [-1, 1]
    about_one = [0, 0, 1, 2, 1], [1, 0.5], [1, 1], [0, 1]
    about_minus_one = [4, 12, 13, 6, 1], [0, -0.5], [-1, -1], [-2, -1]
    whole = [base[::-1], [0, 0, 0.5, 0.5, 0], [0, 0, 0.5, 0, -0.5]]
    straight = base, plant, stiffness, damping
    for found, truth in (
        (parts.triple, whole),
        (parts.straight, straight),
        (parts.shifted[0], about_one),
        (parts.shifted[1], about_minus_one),
        (parts.ends, ([0, 1, 0], [4, 0, 0])),
    ):
        padded = [[*row, *[0] * (found.shape[1] - len(row))] for row in truth]
        np.testing.assert_allclose(found, padded, rtol=1e-15, atol=1e-90)


@pytest.mark.parametrize("radius", [0.5, 2.0])
def test_the_parts_of_another_circle_are_monic_too(radius: float) -> None:
    """p(r z)/r^n of the same mass, and its values at 1 and -1."""
    loop = unit_loop(0.0, 0.0, 1.0, None, None)
    plain, found = (curve_parts(ScaledLoop(loop, (1.0, 1.0), r)) for r in (1.0, radius))
    truth = plain.triple / radius ** np.arange(5)
    np.testing.assert_allclose(found.triple, truth, rtol=1e-15)
    np.testing.assert_allclose(found.ends, [truth.sum(axis=1), truth @ [1, -1, 1, -1, 1]])


def test_a_long_filter_has_the_digits_of_float64_about_one() -> None:
    """(z - 1) (z - q)^40 with q next to 1: in powers of z - 1 the terms of z cancel by 200 bits."""
    loop = HapticLoop(
        device_mass=0.25, device_damping=0.1, sample_time=1.0,
        position=Filter.low_pass(0.01, order=40),
    )  # fmt: skip
    q = Fraction(float(np.exp(-2.0 * np.pi * 0.01)))  # of the filter that runs
    truth = [float(math.comb(40, k) * (1 - q) ** (40 - k)) for k in range(41)]
    found = curve_parts(ScaledLoop(loop, (1.0, 1.0))).shifted[0][3]
    np.testing.assert_allclose(found[1:42], truth, rtol=4e-16)


def test_digits_are_those_of_every_coefficient_beside_the_largest() -> None:
    wide, narrow, nothing = flint.arb(1, 1e-48), flint.arb(1, 1e-55), flint.arb(0, 1e-50)
    for rising, expected in (
        ([narrow, narrow], True),
        ([wide, narrow], False),
        ([narrow, wide], False),
        ([nothing, narrow], False),
        ([nothing, 100 * narrow], True),
        ([], True),
    ):
        assert _has_digits(Factored(flint.arb_poly(rising))) == expected


@pytest.mark.parametrize("angle", [0.3, 3.0])
def test_series_about_an_angle_are_those_of_the_closed_form(angle: float) -> None:
    """A free mass with a delay of 1: sums of sin(k theta), whose derivatives are known."""
    loop = ScaledLoop(unit_loop(0.0, 0.0, 1.0, None, None), (1.0, 1.0))
    (found,) = curve_around(loop, [(angle, 1e-20)])
    base, a, b = [0, 0, 1, -2, 1], [0, 0.5, 0.5], [-0.5, 0, 0.5]  # times N, but for the first
    of_curve = (base, b, 1), (base, a, -1), (b, a, 1)  # Im(left(z) conj(right(z)))
    for series, (left, right, sign) in zip(found, of_curve, strict=True):
        sines: Counter[int] = Counter()
        for (j, c), (k, d) in product(enumerate(left), enumerate(right)):
            sines[j - k] += sign * c * d
        with mp.workdps(40):
            turn = mpf(angle) + mpf(1e-20)
            for order, term in enumerate(series.tolist()):
                turned = (c * mpc(0, k) ** order * mp.expj(k * turn) for k, c in sines.items())
                exact = mp.fsum(turned).imag / mp.factorial(order)
                assert abs(term - exact) <= 1e-15 * max(abs(exact), mpf(1e-20))


@pytest.mark.parametrize("samples", [2, 3, 6, 7])
def test_the_poles_of_a_window_are_the_angles_at_which_it_is_real(samples: int) -> None:
    """The imaginary part of (1 - z^-n)/n is sin(n theta)/n."""
    loop = unit_loop(0.0, 0.0, 1.0, Velocity.difference(samples=samples), None)
    poles = curve_parts(ScaledLoop(loop, (1.0, 1.0))).poles
    np.testing.assert_allclose(poles, np.pi / samples * np.arange(1, samples), rtol=1e-15)


def test_the_third_root_of_a_free_mass_is_inside_below_a_right_angle() -> None:
    """Without delay p = (z^2 - 2 cos(theta) z + 1) (z - r) has r = tan(theta/2)^2."""
    loop = ScaledLoop(unit_loop(0.0, 0.0, 0.0, None, None), (1.0, 1.0))
    angles, low = np.array([0.01, 1.0, np.pi / 2, np.pi / 2, 1.6, 3.1]), np.zeros(6)
    low[2:4] = -1e-20, 1e-16  # the float64 is 6e-17 below a right angle
    found = others_inside(loop, angles, low)
    assert found.tolist() == [True, True, True, False, False, False]


@pytest.mark.parametrize(
    ("delay", "samples", "gamma", "angles"),
    [
        (1.0, 3, 0.0, [0, 2 / 3]),  # W = 4 z^(3/2) sin(theta/2)^2/cos(theta/2) is real there
        (0.5, 4, 0.0, [0, 1]),
        (2.0, 10, 0.1, [0, 2 / 5, 4 / 5]),
    ],
)
def test_lines_keep_a_root_and_are_stable_where_all_others_are_inside(
    delay: float, samples: int, gamma: float, angles: list[float]
) -> None:
    """Undamped hands; beside a line its root goes to the other side where the line turns."""
    loop = unit_loop(gamma, 0.0, delay, Velocity.difference(samples=samples), None)
    question = ScaledLoop(loop, (1.0, 1.0))
    parts = curve_parts(question)

    def roots(alpha: float, beta: float) -> np.ndarray:
        return np.roots(np.array([1.0, alpha, beta]) @ parts.triple)

    lines = root_lines(question)
    assert [line.angle for line in lines] == pytest.approx(np.pi * np.array(angles))
    for line in lines:
        z = np.exp(1j * line.angle)
        for t in (-3.0, 0.1, 0.4, 2.0):
            known = roots(*line.wall(t))
            is_kept = np.minimum(abs(known - z), abs(known - z.conj())) < 1e-7
            assert is_kept.sum() == (1 if abs(z.imag) < 1e-9 else 2)
            expected = np.all(abs(known[~is_kept]) < 1.0)
            assert (line.line.holding(t) is not None) == expected
        if abs(z.imag) > 1e-9:
            moved = []
            for side in (-0.1, 0.1):
                near = roots(*(line.wall(line.turn + side) + np.array([1e-6, 0.0])))
                moved.append(abs(near[np.argmin(abs(near - z))]) - 1.0)
            assert moved[0] * moved[1] < 0.0
    if delay == 1.0:
        assert lines[1].start == pytest.approx([-6.0, 0.0])


def test_a_line_of_two_roots_at_one_counts_where_gains_beside_it_are_stable() -> None:
    """Without kp the gains ki = 0 leave two roots at 1; on one side of it both go inside."""
    plant = HapticLoop(device_mass=0.75, device_damping=2.5, sample_time=1e-3)
    gains = pid(plant, kp=0.0)
    question = ScaledLoop(gains._chart, gains._scale)
    assert [line.angle for line in root_lines(question)] == pytest.approx([0.0, np.pi])
    triple = curve_parts(question).triple
    for side in (-1.0, 1.0):
        roots = np.roots(np.array([1.0, 0.01 * side, 2.0]) @ triple)
        assert np.all(abs(roots) < 1.0) == (side > 0.0)


def test_roots_of_the_plant_are_found_once_however_close_to_one() -> None:
    """Those of slow and of fast poles, in powers of z - 1 and of z."""
    chosen = [0.05, 0.6, 0.8, 1.0 - 1e-9]
    device = Device.transfer_function([1.0], np.poly(np.log(chosen)))
    loop = HapticLoop(device=device, sample_time=1.0)
    found = curve_parts(ScaledLoop(loop, (1.0, 1.0))).roots
    assert np.sort(found.real) == pytest.approx(chosen, rel=1e-9)
    assert 1.0 - found.real.max() == pytest.approx(1e-9, rel=1e-6)


def test_a_position_that_is_0_at_an_angle_leaves_a_line_of_all_stiffnesses() -> None:
    """Mean of four positions: at i p = (z - 1)^2 + B (z + 1) (z - 1)/(2 z) = 0 for B = 2."""
    loop = HapticLoop(
        device_mass=1.0, device_damping=0.0, sample_time=1.0, position=Filter.average(4)
    )
    (line,) = (one for one in root_lines(ScaledLoop(loop, (1.0, 1.0))) if one.angle == np.pi / 2)
    assert line.start == pytest.approx([0.0, 2.0])
    assert line.along == pytest.approx([1.0, 0.0])


def test_a_cosine_sum_of_parts_with_one_phase_is_0() -> None:
    """(z - 1)^2/z is real on all of the circle."""
    one = flint.arb_poly([1])
    parts = Factored(one, at_one=2), Factored(one, power=1)
    assert all(c == 0 for c in _cosines_of(*parts))


def test_modes_that_gains_hardly_move_are_known_to_more_digits_than_a_float_has() -> None:
    """z = e^(i sqrt(gamma)) of an undamped hand; a gain moves it by N A over the slope of base."""
    loop = ScaledLoop(unit_loop(0.1, 0.0, 1.0, None, None), (1.0, 1.0))
    base, plant, stiffness, _ = curve_parts(loop).straight
    near = np.array([np.exp(0.31j)])  # 0.316 is the mode
    with mp.workdps(50):
        truth = mp.sqrt(mpf(0.1))
        value = np.polynomial.polynomial.polyval
        z = complex(mp.expj(truth))
        moved = abs(value(z, plant) * value(z, stiffness))
        moved /= abs(value(z, np.polynomial.polynomial.polyder(base)))
        ((angle, low),) = undamped_modes(loop, near, 1.001 * moved)
        assert abs(mpf(angle) + mpf(low) - truth) < mpf(10) ** -31
    assert undamped_modes(loop, near, 0.999 * moved) == []


@pytest.mark.parametrize(
    ("kept", "by"), [((3.0, 2.0, 5.0), 1), ((3.0, 0.0, 5.0), 1), ((3.0, 2.0, 0.0), 0)]
)
def test_all_walls_of_a_line_keep_its_root(kept: tuple[float, float, float], by: int) -> None:
    """b + alpha s + beta r = 0; without s and r there is no line."""
    b, s, r = map(flint.arb, kept)
    start, along = _start_and_along(_Kept(b, s, r, DIVISORS[0]), by) or ((), ())
    assert 0 in start  # on an axis
    for t in (-2.0, 0.0, 0.5):
        alpha, beta = (at + t * slope for at, slope in zip(start, along, strict=True))
        assert (b + alpha * s + beta * r).contains(0)
    assert _start_and_along(_Kept(b, flint.arb(0), flint.arb(0), DIVISORS[0]), by) == ()
    wide = flint.arb(0, 1)
    assert _start_and_along(_Kept(b, wide, r, DIVISORS[0]), 0) is None
    assert _start_and_along(_Kept(b, flint.arb(0), wide, DIVISORS[0]), 1) is None
