"""Zeros of cosine sums that were chosen, by both ways of isolating them."""

import math
from collections.abc import Callable

import flint
import mpmath
import numpy as np
import pytest

from jaxstab.exact.circle import (
    Zero,
    _as_many_as_counted,
    _by_cells,
    _by_powers,
    _CellModel,
    _Cells,
    _end,
    _guesses,
    _known_place,
    _place,
    _sign_on_cell,
    _sturm_count,
    is_positive,
    zeros,
)
from jaxstab.model.device.parts import decided, working_precision

Isolate = Callable[[list[flint.arb]], list[Zero] | None]


def isolated(cosines: list[flint.arb]) -> list[Zero] | None:
    return zeros(cosines, is_last_try=False)


def in_cells(cosines: list[flint.arb]) -> list[Zero] | None:
    return _by_cells(cosines, is_last_try=False)


def chosen(angles: list[float], others: list[complex]) -> Callable[[], list[flint.arb]]:
    """The cosine sum that vanishes at angles and, in x = 2 cos(theta), at other pairs of roots."""

    def cosines() -> list[flint.arb]:
        sums = [flint.arb(1)]
        for angle in angles:
            sums = times_line(sums, -2 * flint.arb(angle).cos())
        for root in others:  # x^2 - 2 Re x + |root|^2
            shifted = times_line(sums, flint.arb(-root.real))
            squared = times_line(shifted, flint.arb(-root.real))
            padded = sums + [flint.arb(0)] * 2
            square = flint.arb(root.imag) ** 2
            sums = [a + square * b for a, b in zip(squared, padded, strict=True)]
        return sums

    return cosines


def times_line(cosines: list[flint.arb], constant: flint.arb) -> list[flint.arb]:
    """Multiply a cosine sum by 2 cos(theta) + constant."""
    product = [constant * c for c in cosines] + [flint.arb(0)]
    for k, c in enumerate(cosines):
        for power in (k - 1, k + 1):
            product[abs(power)] += c
    return product


@pytest.mark.parametrize("isolate", [isolated, in_cells])
@pytest.mark.parametrize("seed", range(12))
def test_the_zeros_are_those_that_were_chosen(isolate: Isolate, seed: int) -> None:
    rng = np.random.default_rng([5, seed])
    angles = np.sort(rng.uniform(0.0, np.pi, int(rng.integers(0, 14)))).tolist()
    if len(angles) > 1 and seed % 3 == 0:
        angles[1] = angles[0] + 1e-9  # next to each other
    if seed % 4 == 1:
        angles = [1e-6, *angles, np.pi - 1e-6]  # next to the ends
    angles.sort()
    others = [complex(*rng.uniform(-2.5, 2.5, 2)) for _ in range(int(rng.integers(0, 5)))]
    if seed % 2:
        others.append(complex(float(rng.uniform(-2.0, 2.0)), 1e-7))  # a pair next to the axis
    found = decided(lambda: isolate(chosen(angles, others)()))
    assert found is not None
    assert len(found) == len(angles)
    for zero, angle in zip(found, angles, strict=True):
        assert zero.angle.contains(angle)
        assert float(zero.angle.rad()) < 1e-15
    signs = [zero.slope for zero in found]
    assert signs == [(-1) ** (k + 1) for k in range(len(angles))]  # at 0 the sum is positive


@pytest.mark.parametrize("degree", [2, 7, 15, 20])
def test_powers_tell_all_zeros_of_ordinary_sums(degree: int) -> None:
    """Also where guesses are too few or too far, next to 0 and to each other; one root is 2.5."""
    rng = np.random.default_rng([529, degree])
    with flint.ctx.workprec(192):
        for _ in range(20):
            angles = rng.uniform(0.0, np.pi, int(rng.integers(0, degree + 1)))
            angles[:1] = 10.0 ** rng.uniform(-4.0, -1.0)
            angles[1:2] = angles[:1] * (1.0 + 1e-6)
            angles.sort()
            pairs = (degree - len(angles)) // 2
            others = [complex(*rng.uniform(-2.5, 2.5, 2)) for _ in range(pairs)]
            told = _by_powers(times_line(chosen(angles.tolist(), others)(), flint.arb(-2.5)))
            assert told is not None
            for zero, angle in zip(told, angles.tolist(), strict=True):
                assert zero.angle.contains(angle)
                assert float(zero.angle.rad()) < 1e-12


@pytest.mark.parametrize("seed", range(4))
def test_guesses_are_near_the_roots_that_were_chosen_and_only_one_at_each_is_proved(
    seed: int,
) -> None:
    """In x = 2 cos(theta), beside real roots beyond 2 and pairs that are far from the axis."""
    rng = np.random.default_rng([531, seed])
    angles = np.pi * (np.arange(1, 8) + rng.uniform(-0.3, 0.3, 7)) / 8
    beyond = [2.5, -3.0][: seed % 3]
    pairs = [complex(x, 0.5) for x in rng.uniform(-2.0, 2.0, seed)]
    cosines = chosen(angles.tolist(), pairs)()
    f = flint.arb_poly([1])
    with flint.ctx.workprec(192):
        for root in beyond:
            cosines = times_line(cosines, flint.arb(-root))
            f *= flint.arb_poly([-root, 1])
        for angle in angles.tolist():
            f *= flint.arb_poly([-2 * flint.arb(angle).cos(), 1])
        for pair in pairs:
            f *= flint.arb_poly([abs(pair) ** 2, -2 * pair.real, 1])
        guesses, slope = _guesses(cosines), f.derivative()
        np.testing.assert_allclose(guesses, 2.0 * np.cos(angles), rtol=0.0, atol=1e-9)
        assert _sturm_count(f, slope) == 7
        near = (2.0 * np.cos(angles) + 1e-9).tolist()
        for root, angle in zip(_as_many_as_counted(f, slope, near) or [], angles, strict=True):
            assert (root / 2).acos().contains(float(angle))
            assert root.rel_accuracy_bits() > 150
        for wrong in (near[1:], near[:-1], [near[0], *near[:-1]], [*near, near[-1]], near[::-1]):
            assert _as_many_as_counted(f, slope, wrong) is None


def test_a_chain_with_a_member_that_is_0_at_an_end_is_not_counted() -> None:
    """x^2 - 4x + 1 has one root in (-2, 2), and a slope of 0 at 2."""
    f = flint.arb_poly([1, -4, 1])
    assert _sturm_count(f, f.derivative()) is None


def test_a_sum_with_coefficients_of_0_has_a_guess() -> None:
    assert _guesses([flint.arb(0), flint.arb(1)]) == pytest.approx([0.0], abs=1e-15)


def test_zeros_that_float64_does_not_tell_apart_are_in_order() -> None:
    with flint.ctx.workprec(192):
        sums = [flint.arb(1)]
        for constant in (1e-17, -1e-17, 0.3):
            sums = times_line(sums, flint.arb(constant))
        told = _by_powers(sums) or []
    assert [zero.slope for zero in told] == [-1, 1, -1]
    assert told[0].angle < told[1].angle < told[2].angle


@pytest.mark.parametrize("degree", [3, 17, 40, 41, 60])
def test_zeros_of_random_sums_are_those_of_many_points(degree: int) -> None:
    rng = np.random.default_rng(degree)
    numbers = rng.normal(size=degree + 1).tolist()
    found = decided(lambda: zeros([flint.arb(c) for c in numbers], is_last_try=False))
    assert found is not None
    theta = np.linspace(0.0, np.pi, 20_001)[1:-1]
    values = np.cos(np.outer(theta, np.arange(degree + 1))) @ numbers
    crossings = np.flatnonzero(np.sign(values[1:]) != np.sign(values[:-1]))
    assert len(found) == len(crossings)
    for zero, index in zip(found, crossings.tolist(), strict=True):
        assert theta[index] <= float(zero.angle.mid()) <= theta[index + 1]
        with mpmath.workdps(40):
            middle = mpmath.mpf(float(zero.angle.mid()))
            value = mpmath.fsum(c * mpmath.cos(k * middle) for k, c in enumerate(numbers))
            assert abs(value) < 1e-12


def test_a_constant_has_no_zeros_and_coefficients_of_1_are_none() -> None:
    with working_precision(192):
        nothing = flint.arb(0, 1e-60)
        assert isolated([flint.arb(0.5), nothing, nothing]) == []
        assert isolated([nothing, nothing]) is None
        (found,) = isolated([flint.arb(0.5), flint.arb(1)]) or []
        assert float(found.angle.mid()) == pytest.approx(2.0 * np.pi / 3.0, rel=1e-15)


def test_what_powers_do_not_tell_apart_is_left_to_the_search() -> None:
    double = chosen([1.0, 1.0], [])
    with flint.ctx.workprec(192):
        assert _by_powers(double()) is None
        assert zeros(double(), is_last_try=False) is None
        (place,) = zeros(double(), is_last_try=True) or []
    assert place.slope == 0
    assert place.angle.contains(1)


def test_a_derivative_is_called_without_zeros_only_if_it_is() -> None:
    """Polynomials of a cell, on intervals with a root of f, f', ... inside, or just outside."""
    rng = np.random.default_rng(11)
    said = np.zeros(6, int)
    for _ in range(2000):
        rising = rng.normal(size=int(rng.integers(6, 9))) * 10.0 ** rng.uniform(-1.0, 2.0, 1)
        part = _CellModel(flint.arb_poly(rising.tolist()), flint.arb(0), 0)
        centre = float(rng.uniform(-0.9, 0.9))
        f = np.polynomial.Polynomial(rising)
        roots = [f.deriv(order).roots() for order in range(5)]
        gaps = [np.abs(r.real - centre)[np.abs(r.imag) < 1e-9] for r in roots]
        nearest = [float(np.min(own, initial=np.inf)) for own in gaps]
        half = min(float(rng.choice(nearest)), 1.0) * float(rng.uniform(0.3, 1.05))
        order = part.on(flint.arb(centre), flint.arb(half))
        said[order] += 1
        assert order == 5 or nearest[order] > half * (1.0 - 1e-9)
    assert np.all(said > 30)


@pytest.mark.parametrize("half", [0.5, 1.0])
def test_what_a_polynomial_misses_may_hide_a_zero_of_a_derivative(half: float) -> None:
    """Of f = t^k/10 + h(t), h of powers from 10 on, the k-th derivative of h may be 10^k |h|."""
    for order in range(3):
        p = flint.arb_poly([0] * order + [0.1])
        said = [
            _CellModel(p, flint.arb(0, share / 10**order), 10).on(flint.arb(0), flint.arb(half))
            for share in (0.099, 0.101)
        ]
        assert said[0] == order != said[1]


@pytest.mark.parametrize("order", [2, 3, 4])
@pytest.mark.parametrize("gap", [0.0, 1e-9, 1e-14])
def test_zeros_that_coincide_are_found_without_halving(order: int, gap: float) -> None:
    """Two more stand beside them; 1,024 bits part those that do not quite coincide."""
    with flint.ctx.workprec(1024):
        angles = [1 + flint.arb(gap) * k for k in range(order)]
        sums = chosen([0.4, *angles, 2.0], [0.3 + 1.0j] * 4)()
        assert bool(_by_cells(sums, is_last_try=False)) == bool(gap)
        found = _by_cells(sums, is_last_try=True)
    assert found is not None
    assert all(any(zero.angle.overlaps(flint.arb(t)) for zero in found) for t in (0.4, 2.0))
    between = found[1:-1]
    if gap:
        assert len(between) == order
        assert all(zero.angle.overlaps(t) for zero, t in zip(between, angles, strict=True))
        assert [zero.slope * found[0].slope for zero in found] == [
            (-1) ** k for k in range(order + 2)
        ]
    else:
        (place,) = between
        assert place.slope == 0
        assert place.angle.contains(1)
        assert place.angle.rad() < 1e-30


@pytest.mark.parametrize("degree", [3, 20, 61])
def test_cells_know_their_sum_and_how_much_its_fourth_derivative_can_be(degree: int) -> None:
    """At the ends and in the middle of cells; sum k^4 |c_k| is reached where all terms agree."""
    rng = np.random.default_rng([524, degree])
    numbers = rng.normal(size=degree + 1)
    cells = _Cells([flint.arb(c) for c in numbers])
    powers = np.arange(degree + 1)
    most = np.sum(powers**4 * np.abs(numbers))
    assert float(cells.fourth.mid()) == pytest.approx(most, rel=1e-12)
    middles = np.pi * (np.arange(cells.count) + 0.5) / cells.count
    cosines, sines = np.cos(np.outer(middles, powers)), -np.sin(np.outer(middles, powers))
    for order, found in enumerate(cells.values):  # derivatives, those from the second on negated
        truth = (sines if order % 2 else cosines) @ (powers**order * numbers)
        assert [float(ball.mid()) for ball in found] == pytest.approx(truth, abs=1e-12 * most)
    parts = cells.polynomials(list(range(cells.count)))
    for cell, part in parts.items():
        for t in (-1.0, 0.0, 1.0):
            angle = float(cells.angle(cell, flint.arb(t)).mid())
            value = np.sum(numbers * np.cos(powers * angle))
            rounding = flint.arb(0, 1e-12 * degree)
            assert (part.value(flint.arb(t)) + part.missed + rounding).contains(flint.arb(value))


@pytest.mark.parametrize("order", [1, 2, 3])
def test_a_cell_with_a_zero_has_no_sign_whichever_derivative_makes_it(order: int) -> None:
    """About the middle the sum is 1 - (t/0.97)^order and little else, t = 1 the cell's end."""
    cell, powers = 5, np.arange(8)
    cells = _Cells([flint.arb(1)] * 8)
    half = float(cells.half.mid())
    middle = np.pi * (cell + 0.5) / cells.count
    rows = [np.cos(powers * middle + np.pi / 2 * k) * powers.astype(float) ** k for k in range(8)]
    wanted = np.zeros(8)
    wanted[0], wanted[order] = 1.0, -math.factorial(order) / (0.97 * half) ** order
    numbers = np.linalg.solve(rows, wanted)
    ends = [np.cos(powers * (middle + side * half)) @ numbers for side in (-1, 1)]
    assert min(ends) < 0.0  # and 1 in the middle
    assert _sign_on_cell(_Cells([flint.arb(c) for c in numbers.tolist()]), cell) == 0


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_a_cell_has_a_sign_where_the_sum_is_little_more_than_it_may_change(order: int) -> None:
    """By h^order/order! times that derivative, h half of the cell."""
    cells = _Cells([flint.arb(1)] * 8)
    nothing, rise = [flint.arb(0)] * cells.count, flint.arb(24)
    derivatives = [[rise] * cells.count if k == order else nothing for k in range(1, 4)]
    cells.fourth = rise if order == 4 else flint.arb(0)
    least = cells.half**order / math.factorial(order) * rise
    for share, sign in ((0.999, 0), (1.001, 1)):
        cells.values = [[share * least] * cells.count, *derivatives]
        assert _sign_on_cell(cells, 5) == sign


def unknown_at(places: list[flint.arb]) -> _CellModel:
    """A sum of which no sign is known at places."""
    product = flint.arb_poly([1])
    for place in places:
        product *= flint.arb_poly([-place, 1])
    return _CellModel(product, flint.arb(0, 1e-30), 32)


@pytest.mark.parametrize("count", [0, 1, 8, 9])
def test_an_end_without_a_sign_is_moved_by_up_to_eight_parts(count: int) -> None:
    with working_precision(192):
        ahead = unknown_at([_place(1, moved) for moved in range(count)])
        moved, sign = _end(1, [0, 0], {0: ahead})
        assert moved == min(count, 8)
        assert sign == ahead.sign(_place(1, moved))
        assert bool(sign) == (count < 9)


@pytest.mark.parametrize("count", [0, 1, 4, 5])
def test_an_interval_is_parted_at_one_of_five_places_about_its_middle(count: int) -> None:
    places = [flint.arb(k) / 16 for k in range(6, 6 + count)]
    with working_precision(192):
        part = unknown_at(places)
        place, sign = _known_place(part, flint.arb(0), flint.arb(1))
        assert float(place) == (6 + min(count, 4)) / 16
        assert bool(sign) == (count < 5)


def test_a_zero_that_may_be_at_an_end_is_not_left_out() -> None:
    """2 - 2 cos(1e-30) is less than 192 bits tell of it."""
    next_to_zero = chosen([1e-30], [])
    with flint.ctx.workprec(192):
        assert _by_powers(next_to_zero()) is None
    (found,) = decided(lambda: zeros(next_to_zero(), is_last_try=False)) or []
    assert found.angle.contains(1e-30)


@pytest.mark.parametrize("height", [1e-35, 0.5])
def test_a_sum_is_positive_however_close_to_0_it_comes(height: float) -> None:
    above = chosen([], [complex(1.0, height)])
    assert decided(lambda: is_positive(above())) is True
    assert decided(lambda: is_positive([-c for c in above()])) is False
    assert decided(lambda: is_positive(chosen([1.0], [])())) is False


@pytest.mark.parametrize("others", [0, 20])  # by powers, and by cells
def test_a_sum_that_touches_0_is_not_called_positive(others: int) -> None:
    with working_precision(192):
        touching = chosen([1.0, 1.0], [complex(0.1 * k - 1.0, 0.7) for k in range(others)])()
        assert is_positive(touching) is None


def test_each_coefficient_counts_for_a_positive_sum() -> None:
    """Without its second one this is negative at 0: 1.01 + 0.3 cos - cos 2 - 0.3 cos 3."""
    cosines = [1.01, 0.3, -1.0, -0.3]
    angles = np.linspace(0.0, np.pi, 10_001)
    assert sum(c * np.cos(k * angles) for k, c in enumerate(cosines)).min() > 0.0
    assert cosines[0] + sum(cosines[2:]) < 0.0
    assert is_positive([flint.arb(c) for c in cosines])


def test_cells_meet_at_their_ends_wherever_these_are_moved_to() -> None:
    cells = _Cells([flint.arb(1)] * 4)
    for number in range(1, cells.count):
        for moved in (0, 1, 8):
            left = cells.angle(number - 1, _place(1, moved))
            right = cells.angle(number, _place(-1, moved))
            truth = np.pi * (number / cells.count + moved / 128 / cells.count)
            assert left.overlaps(right)
            assert float(left.mid()) == pytest.approx(truth, rel=1e-15)
            assert _place(1, moved) <= 1


@pytest.mark.parametrize("n", [3, 5])
@pytest.mark.parametrize("bits", [192, 384, 768])
def test_double_zeros_are_places_at_every_precision(n: int, bits: int) -> None:
    """sin(n theta) sin(n theta/2) over those of theta and theta/2: zeros at k pi/n, even k twice.

    With 384 bits Taylor's rest hid the signs next to a double zero: an admittance without damping,
    with a mean of five forces, took 40 s.
    """
    terms = [0] * ((3 * n - 1) // 2)
    for up in range(n):
        for down in range(n):
            turn = n - 1 - 2 * up + (n - 1) // 2 - down
            if turn >= 0:
                terms[turn] += 2 if turn else 1
    with working_precision(bits):
        found = zeros([flint.arb(c) for c in terms], is_last_try=True)
        assert found is not None
        assert [zero.slope for zero in found] == [(0, -1, 0, 1)[k % 4] for k in range(1, n)]
        for k, zero in enumerate(found, start=1):
            assert zero.angle.overlaps(flint.arb.pi() * k / n)
            assert zero.angle.rad() < 1e-15
