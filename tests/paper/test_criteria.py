"""The simple criteria against the paper, the 50-digit truth and brute force."""

from itertools import product
from math import pi
from pathlib import Path

import numpy as np
import pytest
from campaign import some
from mpmath import mp, mpf

from jaxstab import HapticLoop
from jaxstab.model import by_name
from jaxstab.paper import (
    ValidityStatus,
    linear_alpha_limit,
    linear_condition,
    linear_error,
    linear_validity,
    passive_region,
    routh_hurwitz_condition,
)
from jaxstab.region import boundary_curve
from tests.truth import loop as truth
from tests.truth.validity import first_rise, random_questions

ANCHORS = Path(__file__).parents[2] / "data" / "reference" / "anchors.tsv"
LEVELS = {"linear_error_2_percent": 0.02, "linear_error_5_percent": 0.05}
DELTAS = [0.0, 0.005, 0.01, 0.015]  # Fig. 7


def fig_7_points() -> np.ndarray:
    """Columns level, gamma, delta, delay, theta, alpha, beta of the reference table."""
    lines = ANCHORS.read_text(encoding="utf-8").splitlines()
    rows = [line.split("\t") for line in lines if line.startswith("linear_error")]
    numbers = [[LEVELS[name], *map(float, cells)] for name, *cells in rows]
    return np.delete(np.array(numbers), 5, axis=1).T  # without the radius


# ------------------------------------------------------------------------------- linear condition


def test_routh_hurwitz_is_the_stability_of_the_third_order_model(rng):
    count = 400
    alpha, beta = rng.uniform(-1, 1, (2, count))
    gamma, delta, delay = rng.uniform(0, 1, (3, count)) * [[0.5], [0.5], [3.0]]
    lag = delay + 0.5
    cubic = np.stack([lag, 1 + delta * lag, gamma * lag + delta + beta, gamma + alpha], axis=-1)
    stable = [np.all(np.roots(row).real < 0) for row in cubic]
    assert 0 < sum(stable) < count
    assert np.array_equal(
        routh_hurwitz_condition(alpha, beta, gamma=gamma, delta=delta, delay=delay), stable
    )


def test_linear_condition_is_routh_hurwitz_without_the_small_term(rng):
    alpha, beta = rng.uniform(-0.1, 0.1, (2, 1000))
    gamma, delay = 1e-3, 1.0
    # Without physical damping the small term is zero.
    assert np.array_equal(
        linear_condition(alpha, beta, gamma=gamma, delta=0.0, delay=delay),
        routh_hurwitz_condition(alpha, beta, gamma=gamma, delta=0.0, delay=delay),
    )
    assert not np.array_equal(
        linear_condition(alpha, beta, gamma=gamma, delta=0.05, delay=delay),
        routh_hurwitz_condition(alpha, beta, gamma=gamma, delta=0.05, delay=delay),
    )


@pytest.mark.parametrize("delay", [0.0, 1.0, 2.75])
def test_linear_limit_is_where_the_linear_condition_changes(delay):
    limit = float(linear_alpha_limit(0.2, delta=0.015, delay=delay))
    assert limit == pytest.approx((0.2 + 0.015) / (0.5 + delay), rel=1e-15)
    assert linear_condition(limit * (1 - 1e-15), 0.2, gamma=1e-3, delta=0.015, delay=delay)
    assert not linear_condition(limit * (1 + 1e-15), 0.2, gamma=1e-3, delta=0.015, delay=delay)
    assert not linear_condition(-1e-3, 0.2, gamma=1e-3, delta=0.015, delay=delay)


def test_linear_error_is_24_with_its_sign(rng):
    for alpha, beta, gamma, delta, delay in rng.uniform(0, 1, (20, 5)):
        limit = (mpf(beta) + delta) / (mpf(delay) + mpf(1) / 2)
        expected = (limit - alpha) / (mpf(alpha) + gamma)
        assert float(
            linear_error(alpha, beta, gamma=gamma, delta=delta, delay=delay)
        ) == pytest.approx(float(expected), rel=1e-14, abs=1e-14)


# ---------------------------------------------------------------------- validity: sec. VII, Fig. 7


def test_validity_points_are_those_of_fig_7():
    level, gamma, delta, delay, theta, alpha, beta = fig_7_points()
    found = linear_validity(level, gamma=gamma, delta=delta, delay=delay)
    assert np.all(found.status == ValidityStatus.FOUND)
    # The condition of the problem is about 1 / level.
    for value, expected in [(found.alpha, alpha), (found.beta, beta), (found.theta, theta)]:
        assert np.max(np.abs(value / expected - 1)) < 1e-13


def test_validity_of_a_free_mass_without_delay_is_the_closed_form():
    assert float(linear_validity(0.02, gamma=0.0, delta=0.0, delay=0.0).alpha) == pytest.approx(
        0.038827412153, rel=1e-11
    )
    assert float(linear_validity(0.02, gamma=0.0, delta=0.0, delay=1.0).alpha) == pytest.approx(
        0.0115181557089, rel=1e-11
    )


def test_human_stiffness_moves_the_points_of_fig_7_by_less_than_the_paper_says():
    levels, delays = np.array([0.02, 0.05]), np.array([0.0, 1.0])
    grid = np.meshgrid(levels, [0.0, 1e-3], DELTAS, delays, indexing="ij")
    alpha = np.asarray(linear_validity(grid[0], **by_name(*grid[1:])).alpha)
    assert np.max(np.abs(alpha[:, 1] / alpha[:, 0] - 1)) < 0.002


@pytest.mark.parametrize(
    ("level", "gamma", "delta", "delay"),
    [(0.02, 1e-3, 0.015, 1.0), (0.05, 1e-3, 0.0, 0.0), (0.02, 0.1, 0.3, 2.5), (0.5, 0.0, 0.1, 5.0)],
)
def test_validity_is_the_first_rise_of_the_signed_error(level, gamma, delta, delay):
    found = linear_validity(level, gamma=gamma, delta=delta, delay=delay)

    def signed_error(theta):
        alpha, beta = truth.boundary_point(theta, gamma, delta, delay)
        return ((beta + delta) / (mpf(delay) + mpf(1) / 2) - alpha) / (alpha + gamma)

    theta = float(found.theta)
    assert abs(signed_error(theta) - level) < 1e-12
    before = [signed_error(theta * k / 60) > level for k in range(1, 60)]
    assert not any(up > low for low, up in zip(before, [*before[1:], True][:-1], strict=False))
    assert signed_error(theta * 1.01) > level


def test_the_absolute_error_of_24_also_reaches_2_percent_before_the_point_of_fig_7():
    gamma, delta, delay = 0.0, 0.015, 1.0
    last = float(linear_validity(0.02, gamma=gamma, delta=delta, delay=delay).theta) * (1 - 1e-12)
    theta = np.linspace(1e-3, last, 400)
    error = linear_error(
        *boundary_curve(theta, gamma=gamma, delta=delta, delay=delay),
        gamma=gamma,
        delta=delta,
        delay=delay,
    )
    assert np.sum(np.diff(np.abs(error) > 0.02)) == 1
    assert error[0] < -0.02


@pytest.mark.parametrize(
    "question", [(3.0, 2.0, 0.3, 1.3), (1e-3, 2.0, 0.0, 2.0), (3.0, 1e-3, 0.0, 60.0)]
)
def test_a_point_is_of_the_stable_region_though_less_stiffness_is_not_stable_beside_it(question):
    level, gamma, delta, delay = question
    found = linear_validity(level, **by_name(gamma, delta, delay))
    assert found.status == ValidityStatus.FOUND
    size = 1e-6 * (float(found.alpha) + gamma)
    inwards = np.array([1.0, (1.0 + level) * (0.5 + delay)]) * -size  # where the error is the level
    for aside, is_stable in ((inwards, True), (-inwards, False), (np.array([-size, 0.0]), False)):
        wall = np.array([float(found.alpha), float(found.beta)]) + aside
        moduli = map(abs, truth.roots(*wall.tolist(), gamma, delta, delay))
        assert (max(moduli) < 1) == is_stable


def test_validity_says_where_there_is_none():
    found = linear_validity(0.02, gamma=np.array([9.0, 1e-3]), delta=0.5, delay=0.0)
    assert found.status.tolist() == [ValidityStatus.NEVER, ValidityStatus.FOUND]
    assert np.isnan(found.alpha[0])
    assert "never" in ValidityStatus.NEVER.words


# Steps of a search landed on zeros of the error here, and passed the first rise.
PASSED_RISES = [
    ((0.02, 0.0005118216247002568, 0.004262588716555489, 0.0), 0.22310496715124254),
    ((0.02, 0.000798890165164135, 0.002496766153702885, 3.0), None),
    ((0.02, 6.829884567063372e-05, 0.0, 1.0), None),
]


@pytest.mark.parametrize(("question", "theta"), PASSED_RISES)
def test_the_first_rise_is_not_passed(question, theta):
    found = linear_validity(question[0], **by_name(*question[1:]))
    true = first_rise(*question)
    assert found.status == ValidityStatus.FOUND
    assert float(found.theta) == pytest.approx(float(true.theta), rel=1e-13)
    assert float(found.alpha) == pytest.approx(float(true.alpha), rel=1e-12)
    assert float(found.beta) == pytest.approx(float(true.beta), rel=1e-12)
    assert theta is None or float(true.theta) == pytest.approx(theta, rel=1e-14)


def test_rises_of_random_hands_are_the_first_ones(rng):
    questions = random_questions(rng, 40)
    found = linear_validity(questions[0], **by_name(*questions[1:]))
    for number, question in enumerate(questions.T):
        true = first_rise(*question)
        if true is None:
            assert found.status[number] == ValidityStatus.NEVER
        else:
            assert found.status[number] in (ValidityStatus.FOUND, ValidityStatus.OFF_THE_EDGE)
            assert found.theta[number] == pytest.approx(float(true.theta), rel=1e-11)


def test_tiny_levels_of_a_free_mass_are_the_closed_form():
    level = 10.0 ** np.arange(-18.0, 0.0, 3.0)
    found = linear_validity(level, gamma=0.0, delta=0.0, delay=0.0)
    assert np.all(found.status == ValidityStatus.FOUND)
    with mp.workdps(400):
        theta = [float(mp.acos(1 / (1 + mpf(share)))) for share in level]
    assert found.theta == pytest.approx(theta, rel=1e-15)


def test_no_point_is_called_off_the_edge_where_its_side_is_undecided():
    found = linear_validity(1e-200, gamma=0.0, delta=0.0, delay=0.0)
    assert found.status == ValidityStatus.NOT_PROVED
    assert np.isnan(found.theta)


def test_a_question_that_cannot_be_answered_spoils_no_other():
    # So soft a hand has a root within 1e-600 of x = 1, which 3,072 bits do not tell from it.
    found = linear_validity(0.02, gamma=np.array([0.0, 1e-300, 1e-3]), delta=0.0, delay=1.3)
    assert found.status.tolist() == [
        ValidityStatus.FOUND,
        ValidityStatus.NOT_PROVED,
        ValidityStatus.FOUND,
    ]
    assert np.isnan(found.alpha).tolist() == [False, True, False]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.0, 0.0, 0.0, 0.0), "level is"),
        ((float("nan"), 0.0, 0.0, 0.0), "level is"),
        ((0.02, -1.0, 0.0, 0.0), "gamma is -1"),
        ((0.02, 0.0, float("nan"), 0.0), "delta is nan"),
        ((0.02, 0.0, 0.0, -1.0), "delay is -1"),
    ],
)
def test_validity_refuses_bad_input(arguments, message):
    with pytest.raises(ValueError, match=message):
        linear_validity(arguments[0], **by_name(*arguments[1:]))


# ----------------------------------------------------------------------------------- passive region


def needed_damping(alpha, beta, delay, theta, aliases=2000):
    """The damping that a passive wall needs at theta, from the aliased frequencies one by one.

    The largest eigenvalue of the power that the wall feeds into motions sum_n X_n e^(i w_n t),
    w_n = theta + 2 pi n, over the power that a damper of one takes out of them.
    """
    number = np.arange(-aliases, aliases + 1)
    omega = theta + 2 * np.pi * number
    wall = alpha + beta * (1 - np.exp(-1j * theta))
    seen = 1.0 / omega  # what the sampler makes of X_n = 1 / w_n
    acting = np.exp(2j * np.pi * number * (delay % 1.0)) / omega  # what the delayed hold works on
    gain = (1 - np.exp(-1j * theta)) * wall * np.exp(-1j * theta * delay)
    basis, _ = np.linalg.qr(np.stack([seen + 0j, acting.conj()], axis=1))
    power = gain * np.outer(basis.conj().T @ acting.conj(), seen @ basis)
    return np.linalg.eigvalsh(0.5 * (power + power.conj().T))[-1]


def test_passive_region_without_delay_is_the_triangle_28():
    delta = 0.7
    outline = passive_region(delta=delta).outline
    assert np.allclose(outline, [[0, -delta], [2 * delta, 0], [0, delta]], rtol=2e-12, atol=1e-15)


def test_passive_region_of_one_sample_of_delay_is_a_conic(rng):
    region = passive_region(delta=1.0, delay=1.0)
    alpha, beta = rng.uniform(0, 1, 500), rng.uniform(-1.1, 1.1, 500)
    # alpha (1/2 + c) + beta (1 - 2 c^2) < 1 for all c in [-1, 1]
    peak = np.where(beta > 0, alpha / (4 * np.where(beta > 0, beta, 1.0)), 2.0)
    inner = alpha / 2 + beta + np.where(peak < 1, alpha * peak / 2, 0.0)
    ends = np.maximum(1.5 * alpha - beta, -0.5 * alpha - beta)
    need = np.where(peak < 1, np.maximum(inner, ends), ends)
    assert np.min(np.abs(need - 1)) > 1e-9
    assert 0 < np.sum(need < 1) < 500
    assert np.array_equal(region.contains(alpha, beta), need < 1)


@pytest.mark.parametrize("delay", [0.0, 0.5, 1.25, 2.0])
def test_passive_region_is_that_of_the_aliased_power(delay):
    delta = 0.4
    region = passive_region(delta=delta, delay=delay, tolerance=1e-3)
    thetas = np.linspace(1e-3, pi, 120)
    for alpha, beta in region.outline[:: max(1, len(region.outline) // 8)]:
        need = max(needed_damping(alpha, beta, delay, theta) for theta in thetas)
        # The scan of theta is coarse, and the sum over aliases stops early.
        assert need == pytest.approx(delta, rel=2e-3)


def test_colgates_formula_with_a_fractional_delay_put_in_is_no_criterion():
    def put_in(alpha, beta, delay, theta):
        lag = np.sin((delay + 0.5) * theta) / (2 * np.sin(theta / 2))
        return alpha * lag - beta * np.cos((delay + 1) * theta)

    def gap(theta, alpha, beta, delay):
        return put_in(alpha, beta, delay, theta) - needed_damping(alpha, beta, delay, theta)

    assert abs(gap(0.7, 1.0, 0.3, 2.0)) < 1e-4
    assert gap(0.05, 1.0, 0.0, 0.5) < -0.05
    assert gap(2.5, 0.2, -0.4, 1.3) > 0.05


@pytest.mark.parametrize(
    "delay",
    [
        0.0,
        0.3,
        3.5,
        *(pytest.param(x, marks=pytest.mark.campaign) for x in some((50.0, 1.0, 300.0), 2)),
    ],
)
def test_passive_outline_is_convex_proved_and_tight(delay):
    region = passive_region(delta=0.2, delay=delay)
    outline = region.outline
    edges = np.roll(outline, -1, axis=0) - outline
    following = np.roll(edges, -1, axis=0)
    turn = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    assert np.all(turn > -1e-15)
    assert np.all(region.contains(*outline.T))
    assert not np.any(region.contains(*(outline.T * (1 + 1e-6)))[outline[:, 0] > 1e-12])
    middles = (outline + 0.5 * edges)[:-1]  # the last edge is alpha = 0
    outwards = (edges[:, ::-1] * [1, -1] / np.linalg.norm(edges, axis=1, keepdims=True))[:-1]
    beyond = middles + region.tolerance * region.wall.damper * outwards
    assert not np.any(region.contains(*beyond.T))
    assert tuple(region.stiffest) in map(tuple, outline)


@pytest.mark.parametrize("delay", [0.0, 0.5, 1.0, 2.25])
def test_a_passive_wall_is_stable_for_any_hand(delay, rng):
    delta = 0.5
    walls = passive_region(delta=delta, delay=delay, tolerance=1e-2).outline * (1 - 1e-6)
    for alpha, beta in rng.permutation(walls)[:6]:
        for gamma, more, mass in zip(
            [*rng.uniform(0, 12, 4), pi**2 + delta**2 / 4],
            rng.uniform(0, 1, 5),
            rng.uniform(1, 10, 5),
            strict=True,
        ):
            hand = (gamma / mass, (delta + more) / mass)
            assert truth.unstable_count(alpha / mass, beta / mass, *hand, delay) == 0


@pytest.mark.parametrize("delay", [0.0, 1.0 - 1e-9, 2.3])
def test_vertices_of_passive_regions_need_less_than_the_damping_in_50_digits(delay):
    delta = 3e-3
    whole, fraction = truth.split_delay(delay)

    def need(alpha, beta, theta):
        """What the wall needs at theta, lemma C6."""

        def lagged(k):
            lag = mp.sin((k + mpf(1) / 2) * theta) / (2 * mp.sin(theta / 2))
            return alpha * lag - beta * mp.cos((k + 1) * theta)

        force = alpha + beta * (1 - mp.expj(-theta))
        fold = fraction * (1 - fraction) * abs(force) ** 2 / (4 * mpf(delta))
        return (1 - fraction) * lagged(whole) + fraction * lagged(whole + 1) + fold

    for vertex in passive_region(delta=delta, delay=delay, tolerance=1e-2).outline[::3]:
        alpha, beta = map(mpf, vertex)
        thetas = [mp.pi * k / 400 for k in range(1, 401)]
        assert max(need(alpha, beta, theta) for theta in thetas) < delta


def test_without_physical_damping_no_wall_is_passive():
    region = passive_region(delta=0.0, delay=1.0)
    assert region.outline.shape == (0, 2)
    assert not np.any(region.contains(np.array([0.0, 0.1]), 0.0))
    assert region.stiffest.tolist() == [0.0, 0.0]


def test_a_wall_of_negative_stiffness_is_not_passive():
    assert passive_region(delta=1.0).contains(np.array([0.1, -0.1]), 0.0).tolist() == [True, False]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"delta": -1.0}, "delta is -1"),
        ({"delta": float("nan")}, "delta is nan"),
        ({"delta": 1.0, "delay": -0.5}, "delay is -0.5"),
        ({"delta": 1.0, "tolerance": 0.0}, "tolerance is 0"),
    ],
)
def test_passive_region_refuses_bad_input(arguments, message):
    with pytest.raises(ValueError, match=message):
        passive_region(**arguments)


# ------------------------------------------------------------------------- the paper's other claims


def test_remark_4_nyquist_frequency_needs_987_kilonewton_per_metre():
    mass, damping, sample_time = 0.1, 1.5, 1e-3
    stiffness = pi**2 * mass / sample_time**2 + damping**2 / (4 * mass)
    assert stiffness == pytest.approx(987.0e3, rel=1e-4)
    loop = HapticLoop(
        device_mass=mass,
        device_damping=damping,
        sample_time=sample_time,
        hand_stiffness=stiffness,
    )
    assert loop.gamma - loop.delta**2 / 4 == pytest.approx(pi**2, rel=1e-14)  # eq. (27)


def test_at_nyquist_frequency_with_damping_the_stable_region_is_a_triangle(rng):
    # The plant turns by half a circle in each sample: one pole stays at -exp(-delta/2), and Jury's
    # three conditions on the other two are straight lines.
    delta = 1.0
    gamma = pi**2 + delta**2 / 4
    fixed = mp.exp(-mpf(delta) / 2)
    n1 = truth.plant(gamma, delta).n2
    counts = []
    for alpha, beta in rng.uniform(-12, 12, (150, 2)):
        linear, constant = fixed + n1 * (mpf(alpha) + beta), -n1 * mpf(beta)
        jury = 1 + linear + constant > 0 and 1 - linear + constant > 0 and constant < 1
        counts.append(jury)
        assert (truth.unstable_count(alpha, beta, gamma, delta, 0.0) == 0) == jury
    assert 0 < sum(counts) < len(counts)


@pytest.mark.parametrize(("gamma", "delay"), [(pi**2 / 4, 0.0), (pi**2 / 16, 1.0)])
def test_undamped_regions_have_moved_to_negative_stiffness(gamma, delay, rng):
    for alpha, beta in product([1e-6, 1e-3, 0.1, 0.5], [-0.5, -1e-3, 0.0, 1e-3, 0.2, 0.5, 1.0]):
        assert truth.unstable_count(alpha, beta, gamma, 0.0, delay) != 0
    stable = [
        truth.unstable_count(alpha, beta, gamma, 0.0, delay) == 0
        for alpha, beta in rng.uniform([-gamma, -0.5], [0, 1], (60, 2))
    ]
    assert any(stable)
