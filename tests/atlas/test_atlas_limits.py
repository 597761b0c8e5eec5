"""Limits of atlases and answers between them, against roots, closed forms and exact lines."""

from functools import partial
from itertools import product

import numpy as np
import pytest
from campaign import many
from mpmath import mp, mpf

import jaxstab
from benchmarks.answers import points_of
from jaxstab import AtlasSpec, Velocity, Verdict
from jaxstab.atlas.axis import Axis
from jaxstab.atlas.build import asked_at_random
from jaxstab.atlas.nodes import LimitPlan, joined, table_of
from jaxstab.atlas.table import CLEAR, LimitTable, largest_of_cells
from jaxstab.exact.line import stable_line
from jaxstab.model.balls import ball_triple
from tests.truth import loop as truth


@pytest.fixture(scope="module")
def haptic() -> LimitTable:
    return table_of(AtlasSpec())


@pytest.fixture(scope="module")
def window() -> LimitTable:
    """Loops with islands beside the component of small gains."""
    velocity = Velocity.difference(samples=20)
    axes = {"gamma": [0.0, 0.0005], "delta": [0.0005, 0.001], "delay": [1.0, 1.25]}
    return table_of(AtlasSpec(**axes, rows=33, velocity=velocity))


@mp.workdps(50)
def test_limits_of_a_free_mass_are_those_of_the_closed_form(haptic: LimitTable) -> None:
    """Gamma = delta = 0, whole delay d: beta, alpha = 2 sin h sin (2d+1)h / cos^2 h, ..."""
    for delay in range(4):
        number = int(np.searchsorted(haptic.delay, delay))
        low, high = haptic.beta_limits[0, 0, number]
        last = mp.pi / (4 * (delay + 1))

        def beta(h: mpf, d: int = delay) -> mpf:
            return 2 * mp.sin(h) * mp.sin((2 * d + 1) * h) / mp.cos(h) ** 2

        assert (low, high) == (0.0, pytest.approx(float(beta(last)), rel=4e-15))
        for row in range(1, haptic.row.size - 1, 2):
            goal = mpf(float(low + haptic.row[row] * (high - low)))
            h = mp.findroot(
                lambda h, goal=goal: beta(h) - goal, (last / 9, last), solver="anderson"
            )
            alpha = 4 * mp.tan(h) ** 2 * mp.cos((2 * delay + 2) * h)
            found = haptic.alpha_limits[0, 0, number, row]
            assert found == pytest.approx([0.0, float(alpha)], rel=1e-12, abs=1e-300)


def test_a_limit_parts_stable_walls_from_unstable_ones(
    haptic: LimitTable, rng: np.random.Generator
) -> None:
    """By certified roots of 50 digits on both sides of nodes, 1e-12 of the largest alpha aside."""
    for _ in range(60):
        i, j, k, row = (int(rng.integers(count)) for count in haptic.alpha_limits.shape[:4])
        row = min(max(row, 1), haptic.row.size - 2)
        plant = haptic.gamma[i], haptic.delta[j], float(haptic.delay[k])
        low, high = haptic.beta_limits[i, j, k]
        beta = float(low + haptic.row[row] * (high - low))
        lower, upper = haptic.alpha_limits[i, j, k, row]
        aside = 1e-12 * np.max(haptic.alpha_limits[i, j, k])
        inside = [
            truth.spectral_radius(a, beta, *plant)[0] < 1 for a in (lower + aside, upper - aside)
        ]
        beyond = [
            truth.spectral_radius(a, beta, *plant)[0] > 1 for a in (lower - aside, upper + aside)
        ]
        assert all(inside)
        assert all(beyond)


def test_regions_and_arcs_have_the_same_limits() -> None:
    """The two ways to a table, the second for ranges that are not bounded by an arc."""
    spec = AtlasSpec(gamma=[0.0, 0.001], delta=[0.0, 0.015], delay=[0.0, 0.4], rows=9)
    arcs, regions = LimitPlan(spec, is_arc=True), LimitPlan(spec, is_arc=False)
    assert LimitPlan.of(spec) == arcs
    one = joined(spec, [arcs.computed(run) for run in arcs.runs])
    other = joined(spec, [regions.computed(run) for run in regions.runs])
    np.testing.assert_allclose(one.beta_limits, other.beta_limits, rtol=0, atol=1e-12)
    within = (slice(None),) * 3 + (slice(1, -1),)
    np.testing.assert_allclose(
        one.alpha_limits[within], other.alpha_limits[within], rtol=0, atol=1e-11
    )
    np.testing.assert_allclose(one.alpha_error, other.alpha_error, rtol=1e-3, atol=1e-8)
    assert one.beyond.all()
    assert other.beyond.all()


def test_the_error_of_a_cell_is_what_interpolation_misses(haptic: LimitTable) -> None:
    """At random places of exact lines: hardly ever more than the error, never CLEAR times it."""
    chance, ratios = np.random.default_rng(3), []
    for _ in range(40):
        gamma, delta, delay = (float(chance.uniform(n[0], n[-1])) for n in haptic.axes)
        plant = [np.array([value]) for value in (gamma, delta, delay)]
        low, high = haptic.ends(*plant)[0]
        beta = np.array([low + chance.uniform(0.05, 0.95) * (high - low)])
        limits = haptic.limits(beta, *plant)
        device = {"device_mass": 1.0, "device_damping": delta, "hand_stiffness": gamma}
        loop = jaxstab.HapticLoop(**device, sample_time=1.0, delay=delay)
        line = stable_line(partial(ball_triple, loop), (0.0, float(beta[0])), (1.0, 0.0))
        ((least, most),) = line.intervals
        exact = least.value, most.value
        assert float(limits.lower[0]) == pytest.approx(exact[0], abs=1e-14)
        ratios.append(abs(float(limits.upper[0]) - exact[1]) / float(limits.upper_error[0]))
    assert np.max(ratios) < CLEAR / 1.5
    assert np.max(ratios) > 1e-2  # else nothing was compared


@pytest.mark.parametrize("which", ["haptic", pytest.param("window", marks=pytest.mark.campaign)])
def test_no_answer_of_a_table_contradicts_a_verdict(
    which: str, request: pytest.FixtureRequest
) -> None:
    table: LimitTable = request.getfixturevalue(which)
    filters = AtlasSpec(velocity=Velocity.difference(samples=20)).filters
    found = asked_at_random(table, filters if which == "window" else None, seed=7)
    assert found["tested_wrong"] == found["tested_undecided"] == 0
    assert found["tested_points"] == 100_000
    if which == "haptic":
        assert found["tested_computed"] < 50


@pytest.mark.campaign
@pytest.mark.parametrize("kind", ["random", "near", "faces", "whole"])
def test_millions_of_answers_contradict_no_verdict(kind: str, haptic: LimitTable) -> None:
    """A million points of each kind at full size, by the dense kernel; undecided by balls."""
    chance, total, wrong, clear = np.random.default_rng(11), 0, 0, 0
    while total < many(1_000_000):
        point = points_of(haptic, kind, 50_000, chance)
        codes = haptic.verdicts(*point)
        named = dict(zip(("alpha", "beta", "gamma", "delta", "delay"), point, strict=True))
        exact = np.asarray(jaxstab.verdict(**named, resolve="exact"))
        is_clear = codes != Verdict.UNDECIDED
        wrong += int(np.sum(is_clear & (codes != exact) & (exact != Verdict.UNDECIDED)))
        clear, total = clear + int(is_clear.sum()), total + codes.size
    assert wrong == 0
    assert clear > 0.3 * total


@pytest.mark.parametrize(
    ("nodes", "degrees"),
    [
        ([0.1, 0.2, 0.4, 0.5, 0.9], [3]),
        ([0.0, 0.3, 0.5], [2]),
        ([0.0, 2.0], [1]),
        ([0.5, 0.6, 0.8, 0.9, 1.0, 1.2, 2.0, 3.0, 3.1, 3.4, 3.9, 3.95], [3, 2, 1, 3]),
    ],
)
def test_a_cubic_is_interpolated_exactly_but_not_across_whole_delays(
    nodes: list[float], degrees: list[int], rng: np.random.Generator
) -> None:
    """Each piece has a polynomial of its own, of the degree that its nodes determine."""
    axis = Axis(np.array(nodes), bends_at_integers=len(degrees) > 1)
    firsts = [nodes[0], *range(1, len(degrees))]
    lasts = [*firsts[1:], nodes[-1]]
    for first, last, degree in zip(firsts, lasts, degrees, strict=True):
        polynomial = np.polynomial.Polynomial(rng.normal(size=degree + 1))
        is_inside = (axis.nodes >= first) & (axis.nodes <= last)
        nodal = np.where(is_inside, polynomial(axis.nodes), 1e9)
        values = rng.uniform(first, last, 50)
        found = axis.interpolated(nodal, axis.cell(values), values, 0)
        np.testing.assert_allclose(found, polynomial(values), rtol=0, atol=1e-11)


def test_islands_are_answered_by_no_table(window: LimitTable) -> None:
    """Window 20, delay 1: an island at (0.0687, -0.381); see docs of ``stable_region``."""
    region = jaxstab.stable_region(
        gamma=0.0, delta=0.0005, delay=1.0, velocity=Velocity.difference(samples=20)
    )
    assert region.islands
    assert not window.beyond.any()
    alpha, beta = (region.islands[0].points.mean(axis=0)[k] for k in (0, 1))
    assert region.contains(alpha, beta)
    codes = window.verdicts(*(np.array([v]) for v in (alpha, beta, 0.0, 0.0005, 1.0)))
    assert codes.tolist() == [Verdict.UNDECIDED]
    main = region.main
    assert main is not None
    np.testing.assert_allclose(
        window.beta_limits[0, 0, 0],
        [main.points[:, 1].min(), main.points[:, 1].max()],
        rtol=0,
        atol=1e-14,
    )


def test_wide_ranges_of_hands_are_computed_more_and_never_wrong() -> None:
    """Stable sets with corners that the table cannot follow: large errors, and regions' limits."""
    spec = AtlasSpec(gamma=[4.0, 5.0], delta=[0.3, 0.4], delay=[0.25, 0.5], rows=17)
    plan = LimitPlan.of(spec)
    assert not plan.is_arc
    table = table_of(spec)
    found = asked_at_random(table, None, seed=5)
    assert found["tested_wrong"] == 0
    assert 0.1 < found["tested_computed"] / found["tested_points"] < 0.99


def test_what_is_unknown_in_a_cell_is_answered_by_no_table() -> None:
    """A row with a limit that is NaN, as of two intervals, and no plant beside it is relied on."""
    spec = AtlasSpec(gamma=[0.0], delta=[0.01], delay=[0.0, 0.5, 1.0], rows=9)
    whole = table_of(spec)
    arrays = whole.arrays | {"alpha_limits": whole.alpha_limits.copy()}
    arrays["alpha_limits"][0, 0, 1, 4] = np.nan
    arrays["alpha_error"] = whole.alpha_error.copy()
    arrays["alpha_error"][0, 0, :, 2:6] = np.inf  # a cubic has two nodes on each side
    table = LimitTable(**arrays)
    rows = np.linspace(0.01, 0.99, 99)
    for delay in (0.1, 0.5, 0.9):
        plant = [np.array([v]) for v in (0.0, 0.01, delay)]
        low, high = whole.ends(*plant)[0]
        beta = low + rows * (high - low)
        for alpha in (-0.1, 0.01, 5.0):
            codes = table.verdicts(np.full(99, alpha), beta, *plant)
            inner, outer = np.abs(rows - 0.5) < 0.245, np.abs(rows - 0.5) > 0.255
            assert (codes[inner] == Verdict.UNDECIDED).all()
            known = whole.verdicts(np.full(99, alpha), beta, *plant)
            np.testing.assert_array_equal(codes[outer], known[outer])


def test_points_outside_of_the_nodes_and_nan_are_not_answered(haptic: LimitTable) -> None:
    inside = {"alpha": 0.05, "beta": 0.3, "gamma": 0.0005, "delta": 0.004, "delay": 1.0}
    one = [np.array([value]) for value in inside.values()]
    assert haptic.verdicts(*one).tolist() == [Verdict.STABLE]
    for name, value in product(inside, (np.nan, np.inf, -np.inf, 1e300)):
        point = [np.array([v]) for v in (inside | {name: value}).values()]
        is_beyond = name in ("alpha", "beta") and not np.isnan(value)
        expected = Verdict.UNSTABLE if is_beyond else Verdict.UNDECIDED
        assert haptic.verdicts(*point).tolist() == [expected], (name, value)
    assert np.isnan(haptic.limits(*(np.array([v]) for v in (9.0, 0.0, 0.0, 1.0))).upper).all()


def test_shared_plants_are_answered_as_others(haptic: LimitTable, rng: np.random.Generator) -> None:
    alpha, beta = rng.uniform(-0.02, 0.2, 20_000), rng.uniform(-0.1, 0.8, 20_000)
    shared = [np.array([v]) for v in (0.0004, 0.003, 1.3)]
    each = [np.repeat(v, alpha.size) for v in shared]
    np.testing.assert_array_equal(
        haptic.verdicts(alpha, beta, *shared), haptic.verdicts(alpha, beta, *each)
    )


def test_the_largest_value_of_a_cell_is_that_of_its_corners() -> None:
    values = np.arange(12.0).reshape(2, 1, 6)
    np.testing.assert_array_equal(largest_of_cells(values)[0, 0], np.arange(7.0, 12.0))
