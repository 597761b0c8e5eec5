"""E3 against closed forms, exact fractions, mpmath, and formulas of simulators and admittances."""

from fractions import Fraction
from itertools import pairwise

import flint
import numpy as np
import pytest
from flint import fmpq, fmpq_poly

from jaxstab import Device, Filter, HapticLoop, Velocity
from jaxstab.exact.line import (
    Crossing,
    End,
    Interval,
    LineStatus,
    OnCircle,
    StableLine,
    _cosines_of,
    _counts,
    _Found,
    _found,
    _Line,
    is_real_quotient,
    stable_line,
)
from jaxstab.model.balls import Factored, Triple, ball_triple
from tests.truth import filtered
from tests.truth.plain import Loop, is_stable, outside
from tests.truth.random_loops import DeviceLoop, Filters, MassLoop, long_window

NOTHING = Factored(flint.arb_poly([]))
UNIT = {"device_mass": 1.0, "device_damping": 0.0, "sample_time": 1.0}


def row(loop: HapticLoop, damping: float) -> StableLine:
    return stable_line(lambda: ball_triple(loop), (0.0, damping), (1.0, 0.0))


def column(loop: HapticLoop, stiffness: float) -> StableLine:
    return stable_line(lambda: ball_triple(loop), (stiffness, 0.0), (0.0, 1.0))


def of_polynomials(p0: list[float], q: list[float]) -> StableLine:
    """The line p0 + t q of polynomials by their coefficients, lowest first."""
    rising = [fmpq_poly([fmpq(*Fraction(c).as_integer_ratio()) for c in p]) for p in (p0, q)]
    triple = Triple(*[Factored.from_rational(p) if p else NOTHING for p in rising], NOTHING)
    return stable_line(lambda: triple, (0.0, 0.0), (1.0, 0.0))


def ends(line: StableLine) -> list[tuple[float, float]]:
    assert line.status == LineStatus.PROVED
    return [(low.value, high.value) for low, high in line.intervals]


# ----------------------------------------------------------------------------------- closed forms
@pytest.mark.parametrize("beta", [1e-9, 0.1, 0.8284271247461903, 1.5, 1.999999])
def test_a_row_of_a_free_mass_without_delay(beta: float) -> None:
    ((low, high),) = ends(row(HapticLoop(**UNIT), beta))
    assert low == 0.0
    assert high == pytest.approx(2.0 * beta * (2.0 - beta) / (beta + 2.0), rel=4e-16)


@pytest.mark.parametrize("alpha", [1e-9, 0.1, 0.6, 0.686])
def test_a_column_of_a_free_mass_without_delay(alpha: float) -> None:
    ((low, high),) = ends(column(HapticLoop(**UNIT), alpha))
    for beta in (low, high):
        assert 2.0 * beta * (2.0 - beta) / (beta + 2.0) == pytest.approx(alpha, rel=1e-13)


@pytest.mark.parametrize(
    ("samples", "delay", "alpha", "beta"),
    [
        (2, 0.0, 6.0 - 4.0 * 2.0**0.5, 0.4852813742386),
        (2, 1.0, 0.09788910377032, 0.3159942848707),
        (2, 1.5, 0.06568923480709, 0.2697155418987),
        (20, 1.0, 0.008041674306427, 0.05169812538961),
        (20, 2.0, 0.005847257730416, 0.05135450537624),
    ],
)
def test_the_largest_stiffness_of_windows(
    samples: int, delay: float, alpha: float, beta: float
) -> None:
    loop = HapticLoop(**UNIT, delay=delay, velocity=Velocity.difference(samples=samples))
    (low, high), *_ = ends(row(loop, beta))
    assert low == 0.0
    assert high == pytest.approx(alpha, rel=1e-12)
    inside, outside_ = (ends(column(loop, alpha * share)) for share in (1 - 1e-9, 1 + 1e-9))
    assert any(low < beta < high for low, high in inside)
    assert not any(0.9 * beta < low < 1.1 * beta for low, _ in outside_)


def test_all_intervals_of_a_row_islands_included() -> None:
    loop = HapticLoop(
        device_mass=0.25, device_damping=0.1, sample_time=1e-3,
        velocity=Velocity.difference(samples=20),
    )  # fmt: skip
    line = row(loop, 175.0)
    island = line.holding(29000.0)
    assert island is not None
    assert 26000.0 < island.low.value < 28000.0
    assert line.holding(15000.0) is None
    assert all(end.error <= 1.1e-16 * abs(end.value) for pair in line.intervals for end in pair)


def test_a_grounded_device_is_stable_down_to_minus_its_stiffness() -> None:
    loop = HapticLoop(
        device_mass=0.25, device_damping=0.1, hand_stiffness=300.0, sample_time=1e-3, delay=0.5e-3
    )
    ((low, _),) = ends(row(loop, 5.0))
    assert low == -300.0


def test_without_stiffness_a_free_device_only_drifts() -> None:
    loop = HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3, delay=1e-3)
    line = column(loop, 0.0)
    assert line.drift == 1
    ((low, high),) = ends(line)
    assert low == pytest.approx(-0.1, rel=1e-12)
    assert 100.0 < high < 300.0


def test_undamped_free_masses_have_two_roots_at_one() -> None:
    line = row(HapticLoop(**UNIT, delay=1.0), 0.0)
    assert ends(line) == []
    assert repr(line).splitlines()[1:] == ["  none"]
    assert 0.0 in [crossing.value for crossing in line.crossings]


def test_a_wall_that_cancels_the_damping_of_the_device_is_no_wrong_answer() -> None:
    loop = HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
    line = row(loop, -0.1)
    assert ends(line) == [] or line.status == LineStatus.UNDECIDED


def test_a_polynomial_that_nothing_moves_is_stable_for_all_t_or_for_none() -> None:
    for constant, expected in ((0.5, [(-np.inf, np.inf)]), (2.0, [])):
        assert ends(of_polynomials([constant, 1], [])) == expected
    # t (z - 1/2): at t = 0 nothing is left of it.
    assert ends(of_polynomials([], [-0.5, 1])) == [(-np.inf, 0.0), (0.0, np.inf)]


# --------------------------------------------------------------------- simulators and admittances
@pytest.mark.parametrize("b", [0.25, 1.0, 1.75])
def test_the_rules_of_simulators(b: float) -> None:
    # p = (z - 1)^2 + a z + b (z - 1): 0 < a < 4 - 2 b.
    assert ends(of_polynomials([1.0 - b, b - 2.0, 1.0], [0, 1])) == [(0.0, 4.0 - 2.0 * b)]
    # (1 + b) z^2 - (2 + b - a) z + 1: 0 < a < 4 + 2 b.
    assert ends(of_polynomials([1.0, -2.0 - b, 1.0 + b], [0, 1])) == [(0.0, 4.0 + 2.0 * b)]


def test_the_slope_of_a_polynomial_on_the_circle_is_bounded_by_no_more_than_it_may_be() -> None:
    """sum k |c_k|, where all terms agree."""
    values = OnCircle.of(Factored(flint.arb_poly([5.0, 1.0, 0.5, 0.25])))
    assert float(values.slope) == pytest.approx(1.0 + 2.0 * 0.5 + 3.0 * 0.25, rel=1e-9)
    assert len(OnCircle.of(Factored(flint.arb_poly([1] * 33))).blocks) == 2


@pytest.mark.parametrize(("at_one", "windows"), [(0, ()), (1, ()), (0, (2,)), (1, (4,)), (2, (3,))])
def test_the_cosine_sum_is_the_imaginary_part_divided_by_what_is_known(
    at_one: int, windows: tuple[int, ...]
) -> None:
    """Its zeros are those of Im(p0 conj q) where sin and cos of theta/2 and windows have none."""
    p0 = Factored(flint.arb_poly([0.3, -1.1, 0.7, 2.0]), 0, at_one)
    q = Factored(flint.arb_poly([1.0, 0.25]), 1, 0, 0, windows)
    angles = np.linspace(0.05, 3.1, 62)
    values = np.array([_imaginary(p0, q, angle) for angle in angles])
    sums = [float(c.mid()) for c in _cosines_of(p0, q)]
    found = np.cos(np.outer(angles, np.arange(len(sums)))) @ sums
    known = np.ones_like(angles) * np.sin(angles / 2) ** at_one
    for n in windows:
        known = known * np.sin(n * angles / 2) / np.sin(angles / 2)
    rest = values / (known * found)
    fits = [rest / (np.sin(angles / 2) ** a * np.cos(angles / 2) ** b) for a, b in _POWERS]
    assert min(np.ptp(fit) / abs(fit).max() for fit in fits) < 1e-10
    assert is_real_quotient(p0, p0.scaled(2.0))
    assert not is_real_quotient(p0, q)


_POWERS = [(a, b) for a in (0, 1) for b in (0, 1)]


def _imaginary(p0: Factored, q: Factored, angle: float) -> float:
    z = flint.acb(0, angle).exp()
    value = p0.polynomial()(z) * q.polynomial()(z).conjugate()
    return float(value.imag.mid())


def test_a_part_of_a_cosine_sum_that_is_not_0_is_no_real_quotient() -> None:
    """Im(conj(z^2)) = -2 sin(theta) cos(theta): nothing, and a part of cos(theta)."""
    parts = [Factored(flint.arb_poly(rising)) for rising in ([1.0], [0.0, 0.0, 1.0])]
    assert not is_real_quotient(*parts)


def test_a_ray_is_stable_to_infinity() -> None:
    # z^2 + t z^2 + 1/2: |1 + t| > 1/2, through infinity.
    line = of_polynomials([0.5, 0, 1], [0, 0, 1])
    assert ends(line) == [(-np.inf, -1.5), (-0.5, np.inf)]
    assert [text.strip()[:8] for text in repr(line).splitlines()[1:]] == ["-inf to ", "-0.50000"]
    low, high = line.intervals[0].low, line.intervals[1].high
    assert low._replace(angle=0.0) == (-np.inf, 0.0, 0.0, False, 0.0, None)
    assert high._replace(angle=0.0) == (np.inf, 0.0, 0.0, False, 0.0, None)
    assert [end.is_shared for pair in line.intervals for end in pair] == [False, True, False, False]


@pytest.mark.parametrize(
    ("environment", "period", "late", "mass", "least", "most"),
    [
        (1e3, 2e-3, 10, 10.0, 19.8705717619, 9999.0),
        (1e4, 1e-3, 4, 2.0, 39.515919035, 3995.0),
        (1e5, 8e-3, 3, 20.0, 1885.37212481, 5400.0),
    ],
)
def test_the_damping_of_an_admittance(
    environment: float, period: float, late: int, mass: float, least: float, most: float
) -> None:
    # z^w ((z - 1)^2 M/T + (z - 1) D) + Ke T z
    p0 = [0.0] * (late + 3)
    for power, factor in enumerate((1.0, -2.0, 1.0)):
        p0[late + power] = mass / period * factor
    p0[1] += environment * period
    ((low, high),) = ends(of_polynomials(p0, [0.0] * late + [-1.0, 1.0]))
    assert low == pytest.approx(least, rel=2e-11)
    assert high == pytest.approx(most, rel=1e-11)


# --------------------------------------------------------------------------------- exact fractions
def assert_fractions_agree(p0: list[int], q: list[int]) -> None:
    """Judge walls on a grid, and both sides of all crossings."""
    line = of_polynomials(p0, q)
    if line.status == LineStatus.UNDECIDED or line.drift:
        return
    known = [Fraction(end.value) for end in line.crossings]
    tried = [Fraction(k, 16) + Fraction(1, 12345) for k in range(-100, 101)]
    tried += [end + side * Fraction(1, 10**9) for end in known for side in (-1, 1)]
    for t in tried:
        if any(abs(t - end) < Fraction(1, 10**10) for end in known):
            continue
        rising = [Fraction(c) for c in p0]
        for power, factor in enumerate(q):
            rising[power] += t * factor
        expected = is_stable(rising[::-1])
        if expected is not None:
            assert (line.holding(float(t)) is not None) == expected, (p0, q, t)


@pytest.mark.parametrize("seed", range(40))
def test_lines_of_small_integers_and_all_their_accidents(seed: int) -> None:
    rng = np.random.default_rng([525, seed])
    for _ in range(4):
        degree = int(rng.integers(1, 7))
        p0 = [*rng.integers(-4, 5, degree).tolist(), int(rng.choice([1, 2, 3, 5]))]
        q = rng.integers(-3, 4, int(rng.integers(1, degree + 2))).tolist()
        if any(q):
            assert_fractions_agree(p0, q)


def test_polynomials_that_are_their_own_mirror_are_undecided() -> None:
    line = of_polynomials([3, -1, 3], [0, -3])
    assert line[:5] == ((), (), 0, 0.0, LineStatus.UNDECIDED)  # complete nowhere


def test_a_wall_at_infinity_is_farther_out_than_any_that_was_looked_for() -> None:
    """q has a pair on the circle at cos(theta) = 1/4: there no t has a root, however large."""
    line = of_polynomials([0.125, 0.0, 1.0, 0.0, 1.0], [1.0, -0.5, 1.0])
    assert line.status == LineStatus.PROVED
    assert 1e30 < line.horizon < np.inf


def test_real_roots_cross_the_circle_at_its_ends() -> None:
    """z - 1/2 + t."""
    crossings = of_polynomials([-0.5, 1.0], [1.0]).crossings
    assert [(end.value, end.angle) for end in crossings] == [(-0.5, 0.0), (1.5, np.pi)]


def test_a_pair_on_the_circle_that_no_t_moves_leaves_nothing_stable() -> None:
    """(z^2 - z + 1) (z - 1/2 + t): whole numbers have the pair as a common factor."""
    line = of_polynomials([-0.5, 1.5, -1.5, 1.0], [1.0, -1.0, 1.0])
    assert line.status == LineStatus.PROVED
    assert not line.intervals


def test_a_root_that_only_touches_the_circle_is_a_crossing_without_an_angle_of_its_own() -> None:
    # z^3 - 2 z^2 + 2 z + t: Im is sin(theta) (2 cos(theta) - 1)^2. At t = -1 a pair touches the
    # circle at pi/3, and a root passes z = 1.
    touching = of_polynomials([0, 2, -2, 1], [1])
    assert touching.status == LineStatus.PROVED
    assert -1.0 in [pytest.approx(end.value, abs=1e-9) for end in touching.crossings]
    assert_fractions_agree([0, 2, -2, 1], [1])


# ------------------------------------------------------------------------------------------ mpmath
def start_of(along: tuple[float, float]) -> tuple[float, float]:
    return (0.0, 0.5) if along == (1.0, 0.0) else (0.125, 0.0)


def assert_mpmath_agrees(truth: Loop, line: StableLine, along: tuple[float, float]) -> None:
    """Judge both sides of each crossing, and the middle of each gap."""
    known = [end.value for end in line.crossings]
    tried = [(low + high) / 2.0 for low, high in pairwise(known)]
    for value, error, *_ in line.crossings:
        aside = max(1e-9 * abs(value), 4.0 * error)
        tried += [value - aside, value + aside]
    judged = 0
    for t in tried:
        wall = [a + t * b for a, b in zip(start_of(along), along, strict=True)]
        expected = truth.is_stable(*wall)
        if expected is not None and t not in known:
            assert (line.holding(t) is not None) == expected, (truth.loop, t)
            judged += 1
    assert judged > 0


@pytest.mark.parametrize("along", [(1.0, 0.0), (0.0, 1.0)], ids=["row", "column"])
@pytest.mark.parametrize("draw", [MassLoop.drawn, DeviceLoop.drawn, DeviceLoop.hardly_moved])
@pytest.mark.parametrize("seed", range(3))
def test_rows_and_columns_of_random_loops(
    draw: object, seed: int, along: tuple[float, float]
) -> None:
    truth = Loop.of(draw(np.random.default_rng([526, seed])))  # type: ignore[operator]
    line = stable_line(lambda: ball_triple(truth.loop), start_of(along), along)
    assert line.status == LineStatus.PROVED
    assert_mpmath_agrees(truth, line, along)


@pytest.mark.parametrize("samples", [2, 3, 4, 7, 20])
@pytest.mark.parametrize("delay", [0.0, 0.5, 1.0])
def test_columns_of_windows_have_the_directions_right(samples: int, delay: float) -> None:
    truths = filtered.difference(samples), filtered.average(1)
    filters = Filters(Velocity.difference(samples=samples), Filter(), truths)
    truth = Loop.of(MassLoop((0.0, 0.0, delay), filters))
    line = column(truth.loop, 0.125)
    assert line.status == LineStatus.PROVED
    assert_mpmath_agrees(truth, line, (0.0, 1.0))


@pytest.mark.parametrize("seed", [1, pytest.param(0, marks=pytest.mark.campaign)])
def test_the_crossings_of_long_windows_are_complete(seed: int) -> None:
    truth = Loop.of(long_window(np.random.default_rng([527, seed])))
    line = stable_line(lambda: ball_triple(truth.loop), (0.0, 0.5), (1.0, 0.0))
    assert line.status == LineStatus.PROVED
    for t in (0.3 * line.crossings[-1].value, 1.7 * line.crossings[0].value + 1e-3):
        expected = outside(truth.polynomial(t, 0.5))
        assert (line.holding(t) is not None) == (expected == 0)


def test_a_device_that_is_one_mass_gives_the_answers_of_its_numbers() -> None:
    device = Device.mass_spring_damper(0.25, damping=0.1)
    fields = {"sample_time": 1e-3, "delay": 1.5e-3}
    one = row(HapticLoop(device=device, **fields), 10.0)
    other = row(HapticLoop(device_mass=0.25, device_damping=0.1, **fields), 10.0)
    assert one == other


def test_directions_between_stiffness_and_damping() -> None:
    loop = HapticLoop(**UNIT)
    ((low, high),) = ends(stable_line(lambda: ball_triple(loop), (0.0, 0.0), (1.0, 1.0)))
    # 0 < t < 2 t (2 - t)/(t + 2): t = 2/3
    assert low == 0.0
    assert high == pytest.approx(2.0 / 3.0, rel=1e-15)


@pytest.mark.parametrize("changes", [[0, 1], [1, 0], [2, 0], [0, 2], [0, 1, 1], [0, 2, 2]])
def test_counts_in_gaps_that_contradict_their_changes_are_no_counts(changes: list[int]) -> None:
    """z - t has its root inside, on the circle and outside: walls at t = 0.5, 2 and 3."""
    p0, q = Factored.from_rational(fmpq_poly([0, 1])), Factored.from_rational(fmpq_poly([-1]))
    walls = [flint.arb(t) for t in (0.5, 2.0, 3.0)[: len(changes)]]
    truth = [0, 1, 1][: len(changes)]
    is_right = len({own - count for own, count in zip(changes, truth, strict=True)}) == 1
    crossings = [Crossing(flint.arb(1), flint.arb(0), more) for more in np.diff(changes).tolist()]
    found = _Found(crossings, walls, np.inf, 0, 128)
    assert _counts(lambda: _Line(p0, q, 0), found) == (truth if is_right else None)


@pytest.mark.parametrize("degree", [3, 40, 200])
def test_values_on_the_circle_are_those_of_the_polynomial(degree: int) -> None:
    rng = np.random.default_rng([525, degree])
    p = Factored(flint.arb_poly(rng.normal(size=degree + 1).tolist()), 2, 1, 1, (4,))
    rising = [float(c.mid()) for c in p.polynomial().coeffs()]
    for angle in (0.1, 1.3, 2.9):
        value = complex(OnCircle.of(p).at(flint.arb(angle)).mid())
        truth = np.polynomial.polynomial.polyval(np.exp(1j * angle), rising)
        assert value == pytest.approx(truth, rel=1e-9)


def test_ends_that_are_not_known_to_a_float_are_no_ends() -> None:
    """z^2 - 4/3 z + 1/3 + t z: t is 0 and 8/3, by 40 bits and by 192."""
    rising = [fmpq_poly([fmpq(1, 3), fmpq(-4, 3), 1]), fmpq_poly([0, 1])]
    with flint.ctx.workprec(40):
        assert _found(_Line.of(*(Factored(flint.arb_poly(p)) for p in rising))) is None
    with flint.ctx.workprec(192):
        found = _found(_Line.of(*(Factored(flint.arb_poly(p)) for p in rising)))
        assert found is not None
        low, high = (crossing.t for crossing in found.crossings)
        assert low.contains(0)
        assert low.rad() < flint.arb(2) ** -100
        assert high.contains(fmpq(8, 3))


def test_an_interval_holds_what_is_beyond_the_errors_of_its_ends() -> None:
    ends = End(0.0, 0.25, 0.1), End(2.0, 0.5, 0.2)
    line = StableLine((Interval(*ends),), ends, 0, np.inf, LineStatus.PROVED, 192)
    held = [line.holding(t) is not None for t in (-0.1, 0.2, 0.25, 0.3, 1.4, 1.5, 1.7, 2.2)]
    assert held == [False, False, False, True, True, False, False, False]
