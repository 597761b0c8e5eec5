"""The stable region against certified root counts, the paper's claims and 50-digit solutions."""

from math import log, sqrt
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mpmath import mp, mpf

import jaxstab.exact.line
import jaxstab.region.pieces
import jaxstab.region.region
from benchmarks.regions import tally
from jaxstab import HapticLoop, limits_of, regions_of
from jaxstab.exact.line import stable_line
from jaxstab.model import by_name
from jaxstab.region import (
    Branch,
    RegionStatus,
    StableRegion,
    boundary_curve,
    stable_region,
)
from jaxstab.region.region import _agree
from tests.truth import loop as truth
from tests.truth.filtered import FilteredLoop, average, difference
from tests.truth.plain import Loop, stiffest_walls
from tests.truth.random_loops import DeviceLoop, long_window

HAPTIC = (1e-3, 0.015)
NYQUIST = np.pi**2


def is_stable(alpha: float, beta: float, region: tuple[float, ...]) -> bool | None:
    """By certified roots; None within 1e-10 of the circle."""
    gamma, delta, delay, radius = region
    lower, upper = truth.spectral_radius(float(alpha), float(beta), gamma, delta, delay)
    if abs(upper - radius) < 1e-10:
        return None
    return bool(upper < radius) if upper < radius or lower > radius else None


def probes(region: StableRegion, rng: np.random.Generator, count: int) -> np.ndarray:
    """Points in and around the region's box, and points close to its outline."""
    outline = region.points
    low, high = outline.min(axis=0), outline.max(axis=0)
    size = high - low
    anywhere = rng.uniform(low - 0.2 * size, high + 0.2 * size, (count, 2))
    scale = size * 10.0 ** rng.uniform(-6, -1, (count, 1))
    close = outline[rng.integers(0, len(outline), count)] + scale * rng.normal(size=(count, 2))
    return np.concatenate([anywhere, close])


def random_slices(rng: np.random.Generator) -> list[tuple[float, ...]]:
    """Stability and decay rates, weak and strong hands, whole and fractional delays."""
    slices = []
    for delay in (0.0, 1.0, 1.5, 3.25):
        for _ in range(4):
            slices.append((12 * rng.uniform() ** 3, rng.uniform(0, 0.6), delay, 1.0))
            slices.append((10 ** rng.uniform(-9, 0), 10 ** rng.uniform(-9, 0), delay, 1.0))
        slices.append((rng.uniform(0, 0.3), rng.uniform(0, 0.3), delay, rng.uniform(0.92, 1)))
        slices.append((rng.uniform(0, 12), 0.0, delay, 1.0))
    return slices


def test_no_point_is_misclassified(rng: np.random.Generator) -> None:
    wrong, decided = [], 0
    for place in random_slices(rng):
        gamma, delta, delay, radius = place
        region = stable_region(gamma=gamma, delta=delta, delay=delay, radius=radius)
        assert region.status == RegionStatus.COMPLETE, place
        points = probes(region, rng, 12)
        for point, inside in zip(points, region.contains(*points.T), strict=True):
            expected = is_stable(*point, place)
            decided += expected is not None
            if expected is not None and expected != bool(inside):
                wrong.append((place, point))
    assert wrong == []
    assert decided > 900


def test_without_hand_and_delay_the_region_is_the_known_one() -> None:
    region = stable_region(gamma=0.0, delta=0.0, delay=0.0)
    np.testing.assert_allclose(region.max_alpha, [12 - 8 * sqrt(2), 2 * sqrt(2) - 2], rtol=1e-14)
    np.testing.assert_allclose(region.max_beta, [0, 2], atol=1e-14)
    np.testing.assert_allclose(region.area, 12 - 16 * log(2), rtol=1e-13)
    beta = np.linspace(0.01, 1.99, 40)
    limits = region.alpha_limits(beta)
    np.testing.assert_allclose(limits[:, 0], 0.0, atol=1e-15)
    np.testing.assert_allclose(limits[:, 1], 2 * beta * (2 - beta) / (beta + 2), rtol=1e-12)
    alpha = np.asarray(limits[:, 1])[:15]
    np.testing.assert_allclose(region.beta_limits(alpha)[:, 0], beta[:15], rtol=1e-12)
    np.testing.assert_allclose(region._intervals_at(1.0, axis=1), [[0.0, 2.0 / 3.0]], atol=1e-15)
    assert region._intervals_at(2.5, axis=1).shape == (0, 2)


@pytest.mark.parametrize(("radius", "is_empty"), [(0.3, True), (0.587, True), (0.588, False)])
def test_no_wall_lets_a_free_mass_decay_faster_than_the_known_rate(
    radius: float, is_empty: bool
) -> None:
    """The smallest spectral radius is 4^(1/3) - 1 = 0.5874."""
    region = stable_region(gamma=0.0, delta=0.0, delay=0.0, radius=radius)
    assert region.status == (RegionStatus.EMPTY if is_empty else RegionStatus.COMPLETE)


@pytest.mark.parametrize(("share", "agrees"), [(5e-7, True), (2e-6, False)])
def test_an_outline_agrees_with_a_row_to_a_millionth_of_its_interval(
    share: float, agrees: bool
) -> None:
    beta = 1.999
    top = 2.0 * beta * (2.0 - beta) / (beta + 2.0)  # 0.001
    loop = stable_region(gamma=0.0, delta=0.0, delay=0.0).curve.loop
    row = stable_line(loop.triple, (0.0, beta), (1.0, 0.0))
    drawn = np.array([[0.0, top * (1.0 + share)]])
    assert _agree(row, drawn, 0.0, 1e-6, 1.0) == agrees


@pytest.mark.parametrize(("delay", "largest"), [(1.0, 0.14447), (2.0, 0.06243), (3.0, 0.03478)])
def test_the_largest_stiffness_without_a_hand_is_the_known_one(
    delay: float, largest: float
) -> None:
    assert float(stable_region(gamma=0.0, delta=0.0, delay=delay).max_alpha[0]) == pytest.approx(
        largest, abs=5e-6
    )


def test_the_left_edge_is_at_minus_gamma() -> None:
    for gamma in (0.0, 0.02, 0.3):
        region = stable_region(gamma=gamma, delta=0.1, delay=1.0)
        left = region.points[:-1][region.branch == Branch.Z_PLUS_ONE]
        np.testing.assert_allclose(left[:, 0], -gamma, rtol=1e-14, atol=1e-14)
        assert np.min(region.points[:, 0]) == pytest.approx(-gamma, abs=1e-14)


@pytest.mark.parametrize(("gamma", "delay"), [(NYQUIST / 4, 0.0), (NYQUIST / 16, 1.0)])
def test_some_hands_leave_no_positive_stiffness(gamma: float, delay: float) -> None:
    assert float(stable_region(gamma=gamma, delta=0.0, delay=delay).max_alpha[0]) == pytest.approx(
        0, abs=1e-14
    )


def test_beyond_the_nyquist_frequency_the_region_is_a_triangle() -> None:
    region = stable_region(gamma=NYQUIST + 0.25, delta=1.0, delay=0.0)
    assert len(region.corners) == 3
    assert set(region.branch.tolist()) == set(Branch)
    sides = region.corners - np.roll(region.corners, 1, axis=0)
    triangle = 0.5 * abs(sides[0, 0] * sides[1, 1] - sides[0, 1] * sides[1, 0])
    np.testing.assert_allclose(region.area, triangle, rtol=1e-12)


def undamped_region(gamma: float) -> tuple[float, float, float]:
    """Area, lower and upper corner at delta = delay = 0, by hand from Jury's criterion.

    With k = (1 - c)/gamma and c = cos(sqrt(gamma)) the stable set is
    -gamma < alpha < 2 beta (c - k beta)/(1 + k beta).
    """
    g = mpf(gamma)
    c = mp.cos(mp.sqrt(g))
    k = (1 - c) / g
    low, high = ((1 + c + sign * mp.sqrt((1 + c) ** 2 + 8 * (1 - c))) / (4 * k) for sign in (-1, 1))

    def integral(beta: mpf) -> mpf:
        u = 1 + k * beta
        return 2 / k**2 * ((c + 2) * u - u**2 / 2 - (c + 1) * mp.log(u)) + g * beta

    return float(integral(high) - integral(low)), float(low), float(high)


def undamped_limit(gamma: float, beta: float) -> float:
    """The largest alpha of a row of the same region."""
    g, b = mpf(gamma), mpf(beta)
    c = mp.cos(mp.sqrt(g))
    k = (1 - c) / g
    return float(2 * b * (c - k * b) / (1 + k * b))


@pytest.mark.parametrize("share", [0.5, 0.9, 1 - 1e-3, 1 - 1e-5, 1 - 1e-6, 1 + 1e-5])
def test_the_region_of_an_undamped_hand_next_to_the_nyquist_frequency(share: float) -> None:
    gamma = NYQUIST * share**2
    area, *heights = undamped_region(gamma)
    region = stable_region(gamma=gamma, delta=0.0, delay=0.0)
    assert region.status == RegionStatus.COMPLETE
    assert float(region.area) == pytest.approx(area, rel=1e-9)
    # All digits, though a float64 of the angle holds few digits of its distance to pi.
    corners = [(-gamma, height) for height in heights]
    found = region.corners[np.argsort(region.corners[:, 1])]
    np.testing.assert_allclose(found, corners, rtol=5e-15)
    row = 0.999 * heights[1]
    limits = region.alpha_limits(row)
    np.testing.assert_allclose(limits, [-gamma, undamped_limit(gamma, row)], rtol=0, atol=2e-14)


@pytest.mark.parametrize(("gamma", "delay"), [(10.273987542438604, 9.0), (9.813829279222805, 39.0)])
def test_the_row_without_damping_of_an_undamped_hand_has_limits(gamma: float, delay: float) -> None:
    """It begins at the wall without gains, where the hand's own poles are on the circle."""
    region = stable_region(gamma=gamma, delta=0.0, delay=delay)
    low, high = map(float, region.alpha_limits(0.0))
    assert low == pytest.approx(0.0, abs=1e-14)
    assert is_stable(high * (1.0 - 1e-8), 0.0, (gamma, 0.0, delay, 1.0))
    assert not is_stable(high * (1.0 + 1e-8), 0.0, (gamma, 0.0, delay, 1.0))


# Corners with a second root next to the circle; arcs of the curve that are 2e-5 long; two corners
# that are 5e-8 or 4e-9 apart.
@pytest.mark.parametrize(
    ("place", "corners"),
    [
        ((NYQUIST, 1e-3, 1.0), 3),
        ((39.799975315059754, 0.4533140420022334, 4.0), 9),
        ((39.52046, 0.13948, 4.0), 9),
        ((9.882655, 0.0, 4.0), 1),
    ],
)
def test_regions_of_small_margins_are_resolved(
    place: tuple[float, float, float], corners: int, rng: np.random.Generator
) -> None:
    region = stable_region(**by_name(*place))
    assert region.status == RegionStatus.COMPLETE
    assert len(region.corners) == corners
    points = probes(region, rng, 12)
    for point, inside in zip(points, region.contains(*points.T), strict=True):
        expected = is_stable(*point, (*place, 1.0))
        assert expected is None or expected == bool(inside)


# Where the curve crosses itself, or a line, twice between two angles of the scan.
@pytest.mark.parametrize(
    ("place", "theta"),
    [
        ((3.4221236931311325, 9.11095313928446, 6.351107263508205), 0.498),
        ((1.3488207792095845, 0.5590127914668694, 7.0), 0.845),
        ((6.57005961986159, 36.351609338153324, 7.0), 0.808),
        ((11.523438187710303, 0.40536209838398013, 1.0), 2.85),
    ],
)
def test_cuts_between_two_angles_of_the_scan_are_found(
    place: tuple[float, float, float], theta: float
) -> None:
    """The curve at this angle is outside of the region, not on its outline."""
    wall = boundary_curve(theta, **by_name(*place))
    lower, _ = truth.spectral_radius(*map(float, wall), *place)
    assert lower > 1.0 + 1e-7
    region = stable_region(**by_name(*place))
    assert region.status == RegionStatus.COMPLETE
    assert not region.contains(*wall)
    assert float(region.distance(*wall)) < -1e-7


@pytest.mark.parametrize(
    "place",
    [
        (8.416954640942166, 5.189279770319287, 22.0),
        (39.45784151884654, 0.09757097589868004, 17.00000009328043),
        (39.054645212842246, 1.7450258156957736, 15.0),
    ],
)
def test_boundaries_of_many_narrow_arcs_are_followed_from_arc_to_arc(
    place: tuple[float, float, float],
) -> None:
    """Of about 30 arcs a first scan finds 3 to 13. The second and the third were UNRESOLVED."""
    found = tally((*place, 1.0), np.random.default_rng(7))
    assert (found.status, found.wrong) == (RegionStatus.COMPLETE, 0)
    assert found.judged > 0


@pytest.mark.parametrize(
    ("place", "wall"),
    [
        ((8.96714647846678, 0.4172049856745317, 10.0), (8.967487660388567, -4.489331680361163)),
        ((10.994880833830576, 0.41194201500209277, 15.0), (10.9377527623, -5.4620106383)),
        ((4.372295367227223, 10.204221895823999, 36.0), (-0.0654512511, -10.9480871018)),
        ((7.30719892238767, 95.57187589010753, 47.99993924102788), (-0.0281708880, -96.2215504999)),
    ],
)
def test_dents_between_two_angles_of_the_scan_are_found(
    place: tuple[float, float, float], wall: tuple[float, float]
) -> None:
    """Many roots move alike: the scan has few angles where the outline has hundreds of edges."""
    lower, _ = truth.spectral_radius(*wall, *place)
    assert lower > 1.0 + 1e-8
    region = stable_region(**by_name(*place))
    assert region.status == RegionStatus.COMPLETE
    assert not region.contains(*wall)


def test_corners_that_other_arcs_cut_off_are_not_taken_for_corners() -> None:
    """Arcs whose ends are 1e-6 from where they would meet: a third one lies between."""
    place = 88.83540206421945, 0.49043601580164486, 13.0
    walls = [(-88.8332312321222, 49.83736469051329), (-88.83537838122415, 49.837969998446034)]
    balls = FilteredLoop(*place, difference(1), average(1)).balls()
    region = stable_region(**by_name(*place))
    assert region.status == RegionStatus.COMPLETE
    for wall in walls:
        assert balls.is_stable(*wall) is False
        assert not region.contains(*wall)


@pytest.mark.parametrize(
    ("draw", "seed"),
    [
        (DeviceLoop.drawn, (20261126, 3)),
        (DeviceLoop.drawn, (20261126, 20)),  # a corner that float64 misses by 2e-10
        pytest.param(  # a tip: rows beyond it are empty
            DeviceLoop.drawn, (20261126, 30), marks=pytest.mark.campaign
        ),
        (DeviceLoop.drawn, (20261126, 38)),  # a tip that float64 has beyond it
        (DeviceLoop.drawn, (20261126, 288)),  # a tip as thin as a rounding
        (DeviceLoop.hardly_moved, (20261130, 4)),  # slopes that cancel in float64
        (DeviceLoop.hardly_moved, (20261130, 31)),  # 1e-9 of the region's size, no corner
    ],
)
def test_the_largest_gains_are_those_of_60_digits(draw: Any, seed: tuple[int, int]) -> None:
    drawn = draw(np.random.default_rng(seed))
    loop, base, *gains = Loop.of(drawn)
    limits = drawn.loop.limits()
    for wall, parts, name in (
        ((limits.stiffness, limits.at_damping), gains, "damping"),
        ((limits.damping, limits.at_stiffness), gains[::-1], "stiffness"),
    ):
        known = [largest for largest, _ in stiffest_walls(Loop(loop, base, *parts), *wall)]
        assert any(abs(true / wall[0] - 1) < 1e-13 for true in known)
        row = drawn.loop.intervals(**{name: wall[1]})  # it is the end of what is proved
        ends = [high.value for _, high in row.intervals]
        assert any(abs(end / wall[0] - 1.0) < 1e-15 for end in ends) or wall[1] == 0.0


@pytest.mark.campaign
def test_an_unresolved_region_claims_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jaxstab.region.region._contradictions", lambda *_: None)
    region = stable_region(gamma=39.52046, delta=0.13948, delay=4.0)
    assert region.status == RegionStatus.UNRESOLVED
    assert not region.is_empty
    assert not region.rows_are_intervals
    assert region.points.shape == region.corners.shape == (0, 2)
    assert not bool(region.contains(0.0, 0.0))
    numbers = (region.area, region.max_alpha, region.alpha_limits(0.1), region.distance(0.0, 0.0))
    assert all(np.all(np.isnan(number)) for number in numbers)


def test_an_undamped_hand_at_the_nyquist_frequency_in_float64_has_a_triangle() -> None:
    """pi^2 in float64 leaves a root 1e-32 beside -1: for these numbers a triangle is stable."""
    region = stable_region(gamma=NYQUIST, delta=0.0, delay=0.0)
    assert -NYQUIST < -5.0 < undamped_limit(NYQUIST, 1.0)
    assert region.status == RegionStatus.COMPLETE
    assert bool(region.contains(-5.0, 1.0))
    assert float(region.area) == pytest.approx(NYQUIST**2, rel=1e-12)
    corners = [-NYQUIST, -NYQUIST / 2.0], [-NYQUIST, NYQUIST / 2.0]
    np.testing.assert_allclose(np.sort(region.corners, axis=0), corners, 1e-12)


@pytest.mark.parametrize("gamma", [5e-324, 1e-200, 1e-100, 1e-20])
def test_a_hand_that_is_next_to_nothing_has_the_region_of_none(gamma: float) -> None:
    """The plant's numerator is a quotient by gamma: of fewer bits it is nothing but rounding."""
    region = stable_region(gamma=gamma, delta=0.0, delay=0.0)
    assert region.status == RegionStatus.COMPLETE
    assert float(region.max_alpha[0]) == pytest.approx(12.0 - 8.0 * np.sqrt(2.0), rel=1e-12)


def test_with_a_delay_it_is_not_called_empty_either() -> None:
    region = stable_region(gamma=NYQUIST, delta=0.0, delay=1.0)
    assert region.status == RegionStatus.UNRESOLVED
    assert not bool(region.contains(-5.0, 1.0))
    assert np.isnan(float(region.area))


def test_a_region_without_stable_walls_is_empty() -> None:
    """A device with modes that nothing damps, behind a slow filter."""
    loop = DeviceLoop.drawn(np.random.default_rng([20121120, 861]))
    region = loop.region()
    assert region.is_empty
    assert region.loops == 0
    assert region.points.shape == (0, 2)
    assert len(region.corners) == len(region.branch) == 0
    assert np.all(np.isnan(region.max_alpha))
    assert np.all(np.isnan(region.alpha_limits(0.1)))
    assert not bool(region.contains(0.0, 0.0))
    assert float(region.distance(0.0, 0.0)) == -np.inf
    assert float(region.area) == 0.0
    sizes = 10.0 ** np.arange(-8.0, 2.0).repeat(20)[:, None]
    walls = sizes * np.random.default_rng(5).normal(size=(200, 2))
    assert not any(loop.balls.is_stable(*wall) for wall in walls.tolist())


@pytest.mark.parametrize(
    "place", [(*HAPTIC, 1.0), (0.3, 0.1, 2.5), (20.0, 0.5, 3.0), (0.1, 0.1, 50.0)]
)
def test_the_outline_is_closed_counter_clockwise_and_within_the_tolerance(
    place: tuple[float, float, float],
) -> None:
    tolerance = 1e-5
    region = stable_region(**by_name(*place), tolerance=tolerance)
    x, y = region.points.T
    polygon = 0.5 * float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))
    np.testing.assert_array_equal(region.points[0], region.points[-1])
    assert len(region.branch) == len(region.points) - 1
    assert region.loops == 1
    assert region.rows_are_intervals
    diameter = np.hypot(np.ptp(x), np.ptp(y))
    perimeter = np.sum(np.hypot(np.diff(x), np.diff(y)))
    assert polygon > 0.0
    assert abs(polygon - float(region.area)) < tolerance * diameter * perimeter


@pytest.mark.parametrize("place", [(*HAPTIC, 1.0), (0.3, 0.1, 2.5), (20.0, 0.5, 3.0)])
def test_a_corner_has_two_kinds_of_roots_on_the_circle(place: tuple[float, float, float]) -> None:
    corners = stable_region(**by_name(*place)).corners
    assert len(corners) > 0
    for alpha, beta in corners:
        moduli = [abs(root) for root in truth.roots(float(alpha), float(beta), *place)]
        on_circle = [modulus for modulus in moduli if abs(modulus - 1) < 1e-7]
        assert len(on_circle) >= 2
        assert max(moduli) < 1 + 1e-7


def test_each_piece_names_the_root_on_the_circle() -> None:
    place = (NYQUIST + 0.25, 1.0, 0.0)
    region = stable_region(**by_name(*place), tolerance=1e-3)
    signs = {Branch.Z_PLUS_ONE: 1, Branch.Z_MINUS_ONE: -1}
    for first, last, branch in zip(region.points, region.points[1:], region.branch, strict=False):
        middle = map(float, 0.5 * (first + last))
        if branch != Branch.CURVE:
            nearest = min(abs(r - signs[Branch(branch)]) for r in truth.roots(*middle, *place))
            assert nearest < 1e-13


def test_a_long_delay_has_a_small_region() -> None:
    region = stable_region(gamma=0.0, delta=0.0, delay=50.0)
    assert region.status == RegionStatus.COMPLETE
    alpha, beta = map(float, region.max_alpha)
    assert is_stable(alpha - 1e-6, beta, (0.0, 0.0, 50.0, 1.0))
    assert not is_stable(alpha + 1e-6, beta, (0.0, 0.0, 50.0, 1.0))


def test_the_distance_is_that_to_the_known_curve(rng: np.random.Generator) -> None:
    region = stable_region(gamma=0.0, delta=0.0, delay=0.0)
    beta = np.linspace(0, 2, 200_001)
    curve = np.stack([2 * beta * (2 - beta) / (beta + 2), beta])
    alpha, damping = rng.uniform([-0.2, -0.2], [0.9, 2.2], (40, 2)).T
    signed = np.asarray(region.distance(alpha, damping))
    for a, b, distance in zip(alpha, damping, signed, strict=True):
        to_curve = np.min(np.hypot(curve[0] - a, curve[1] - b))
        to_edge = np.hypot(a, b - np.clip(b, 0, 2))
        inside = 0 < b < 2 and 0 < a < 2 * b * (2 - b) / (b + 2)
        expected = min(to_curve, to_edge) * (1 if inside else -1)
        assert distance == pytest.approx(expected, abs=1e-9)


def test_lines_beside_the_region_have_no_limits() -> None:
    region = stable_region(**by_name(*HAPTIC, 1.0))
    assert np.all(np.isnan(region.alpha_limits(np.array([[-1.0, 2.0]]))))
    assert region.alpha_limits(np.array([[-1.0, 2.0]])).shape == (1, 2, 2)
    assert np.all(np.isnan(region.beta_limits(0.2)))


# Slices under JAX are loops of 1 kg that are sampled once a second: K is alpha, and B is beta.
DELAY = 1.0
UNIT = HapticLoop(device_mass=1.0, device_damping=0.1, sample_time=1.0, delay=DELAY)
PLACES = [(0.05, 0.1), (1e-3, 0.015), (0.1, 0.0), (0.3, 0.2)]


@pytest.mark.campaign
def test_many_slices_at_once_are_the_single_ones() -> None:
    def largest_alpha_and_area(gamma: Any, delta: Any) -> Any:
        regions = regions_of(UNIT, hand_stiffness=gamma, device_damping=delta)
        return jnp.max(regions.outline[:, 0]), regions.limits.stiffness, regions.area

    numbers = jnp.asarray(PLACES).T
    for mapped in (jax.jit(jax.vmap(largest_alpha_and_area)),):
        tops, stiffest, areas = mapped(*numbers)
        for index, place in enumerate(PLACES):
            single = stable_region(**by_name(*place, DELAY))
            assert float(stiffest[index]) == pytest.approx(single.max_alpha[0], rel=1e-13)
            assert single.max_alpha[0] * (1 - 1e-3) < tops[index] <= single.max_alpha[0]
            assert float(areas[index]) == pytest.approx(float(single.area), rel=1e-6)


def exact_largest(gamma: mpf, delta: mpf, guess: float) -> mpf:
    """The largest alpha, in 50-digit arithmetic."""
    step = mpf(10) ** -12
    theta = mp.findroot(
        lambda t: (
            (
                truth.boundary_point(t + step, gamma, delta, DELAY)[0]
                - truth.boundary_point(t - step, gamma, delta, DELAY)[0]
            )
            / step
        ),
        mpf(guess),
    )
    return truth.boundary_point(theta, gamma, delta, DELAY)[0]


def angle_near(alpha: float, beta: float, gamma: float, delta: float) -> float:
    theta = np.linspace(0.01, 1.5, 3000)
    curve = boundary_curve(theta, gamma=gamma, delta=delta, delay=DELAY)
    return float(theta[np.argmin(np.hypot(curve[0] - alpha, curve[1] - beta))])


@pytest.mark.campaign
@pytest.mark.parametrize("derivative", [jax.jacfwd, jax.jacrev])
def test_the_largest_alpha_has_the_derivatives_of_50_digits(derivative: Any) -> None:
    def largest(gamma: Any, delta: Any) -> Any:
        return limits_of(UNIT, hand_stiffness=gamma, device_damping=delta).stiffness

    step = mpf(10) ** -15
    for place in PLACES[:2]:
        guess = angle_near(*map(float, stable_region(**by_name(*place, DELAY)).max_alpha), *place)
        start = exact_largest(mpf(place[0]), mpf(place[1]), guess)
        slopes = jax.jit(derivative(largest, (0, 1)))(*map(jnp.asarray, place))
        for slope, moved in zip(slopes, ((step, 0), (0, step)), strict=True):
            ahead = exact_largest(mpf(place[0]) + moved[0], mpf(place[1]) + moved[1], guess)
            assert float(slope) == pytest.approx(float((ahead - start) / step), abs=1e-9)


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"gamma": -1.0}, "gamma"),
        ({"delta": float("nan")}, "delta"),
        ({"delay": -1.0}, "delay"),
        ({"radius": 1.2}, "radius"),
        ({"radius": -0.5}, "radius"),
        ({"tolerance": 0.0}, "tolerance"),
    ],
)
def test_bad_input_is_refused_by_name(arguments: dict[str, float], name: str) -> None:
    with pytest.raises(ValueError, match=rf"^{name} is [^\n]*\.$"):
        stable_region(**{"gamma": 0.0, "delta": 0.0, "delay": 0.0} | arguments)


def test_a_plain_region_and_its_limits_ask_little(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two lines at 1 and -1, three compared, one more limit; of angles, a scan and the middles."""
    asked = {"_found": 0, "others_inside": 0}

    def counting(room: Any, name: str) -> None:
        own = getattr(room, name)

        def counted(*given: Any, **named: Any) -> Any:
            asked[name] += 1
            return own(*given, **named)

        monkeypatch.setattr(room, name, counted)

    counting(jaxstab.exact.line, "_found")
    counting(jaxstab.region.pieces, "others_inside")
    monkeypatch.setattr(jaxstab.region.region, "others_inside", jaxstab.region.pieces.others_inside)
    loop = HapticLoop(device_mass=0.11, device_damping=0.7, sample_time=1e-3)
    loop.region().limits()
    assert asked == {"_found": 6, "others_inside": 2}


def test_a_region_that_may_take_minutes_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before balls count at thousands of angles, where float64 leaves a loop open."""
    loop = long_window(np.random.default_rng([20261126, 45])).loop
    followed = jaxstab.region.region._followed

    def without_balls(*args: Any, with_balls: bool) -> Any:
        if with_balls:
            raise InterruptedError
        return followed(*args, with_balls=with_balls)

    monkeypatch.setattr(jaxstab.region.region, "_followed", without_balls)
    with (
        pytest.warns(UserWarning, match="degree 118 may take minutes"),
        pytest.raises(InterruptedError),
    ):
        loop.region()
