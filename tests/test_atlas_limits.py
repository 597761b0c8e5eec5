"""Limits of alpha in an atlas: quick verdicts, and the inverse questions."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from atlases import moving_atlas, small_atlas, small_contents, write_cut

from benchmarks import truth
from jaxstab import (
    Atlas,
    AtlasSpec,
    FittedAxis,
    Velocity,
    Verdict,
    build_atlas,
    open_atlas,
    stable_region,
    verdict,
)
from jaxstab.atlas.atlas import checked_range
from jaxstab.atlas.products.table import PRODUCTS
from jaxstab.conventions import AXES
from jaxstab.model import by_name
from jaxstab.results import QueryStatus

DELAYS = (0.0, 1.5)
FEW = 20_000  # points that NumPy computes


@pytest.fixture(scope="module")
def atlas() -> Atlas:
    return small_atlas()


def random_points(atlas: Atlas, delay: float, count: int, rng: np.random.Generator) -> list:
    nodes = atlas.nodes(atlas.delays.tolist().index(delay))
    return [rng.uniform(axis[0], axis[-1], count) for axis in nodes.values()]


@pytest.mark.parametrize("delay", DELAYS)
def test_verdicts_by_limits_are_those_of_the_certified_recursion(
    atlas: Atlas, delay: float, rng: np.random.Generator
) -> None:
    points = random_points(atlas, delay, 100_000, rng)
    answered = atlas.verdict(**by_name(*points, delay))
    assert np.mean(answered != Verdict.UNDECIDED) > 0.9965  # 0.99704 of the box at delay 1.5
    some = [values[:FEW] for values in points]
    answered, computed = answered[:FEW], verdict(**by_name(*some, delay), resolve="exact")
    decided = answered != Verdict.UNDECIDED
    np.testing.assert_array_equal(answered[decided], computed[decided])


def test_one_point_and_many_are_answered_alike(atlas: Atlas, rng: np.random.Generator) -> None:
    points = random_points(atlas, 1.5, 500, rng)
    many = atlas.verdict(**by_name(*points, 1.5))
    np.testing.assert_array_equal(many, atlas.query(**by_name(*points, 1.5)).verdict)
    for index in range(500):
        one = atlas.verdict(**by_name(*(float(values[index]) for values in points), 1.5))
        assert one == many[index]
        assert one.dtype == np.int8
    assert atlas.verdict(np.zeros((0, 3)), 0.3, gamma=0.0, delta=0.0, delay=0).shape == (0, 3)


def test_every_edge_of_a_cell_belongs_to_it(atlas: Atlas) -> None:
    nodes = atlas.nodes(0)
    beta = np.linspace(nodes["beta"][0], nodes["beta"][-1], 193)
    points = np.meshgrid(nodes["alpha"], beta, nodes["gamma"], nodes["delta"])
    answered = atlas.verdict(**by_name(*points, 0.0))
    assert np.mean(answered == Verdict.UNDECIDED) < 0.05  # alpha = -gamma is an edge of the region
    computed = np.asarray(verdict(**by_name(*points, 0.0), resolve="exact"))
    decided = answered != Verdict.UNDECIDED
    np.testing.assert_array_equal(answered[decided], computed[decided])


def test_what_is_left_open_can_be_settled(atlas: Atlas) -> None:
    region = stable_region(gamma=0.0005, delta=0.004, delay=0.0)
    alpha, beta = (float(gain) for gain in region.max_alpha)
    for factor, code in ((1 - 1e-9, Verdict.STABLE), (1 + 1e-9, Verdict.UNSTABLE)):
        point = (alpha * factor, beta, 0.0005, 0.004, 0.0)
        assert atlas.verdict(**by_name(*point)) == Verdict.UNDECIDED
        assert atlas.verdict(**by_name(*point), exact=True) == code
        answer = atlas.query(**by_name(*point), exact=True)
        assert (answer.verdict, answer.status) == (code, QueryStatus.EXACT)
    between = atlas.query(0.05, 0.3, gamma=0.0005, delta=0.004, delay=0.75, exact=True)
    assert (between.verdict, between.status) == (Verdict.STABLE, QueryStatus.EXACT)


@pytest.mark.parametrize("delay", DELAYS)
def test_limits_hold_the_exact_ones(atlas: Atlas, delay: float) -> None:
    for gamma, delta in ((0.0, 0.0), (0.0004, 0.0123), (0.001, 0.005)):
        region = stable_region(gamma=gamma, delta=delta, delay=delay)
        beta = np.linspace(0.05, 0.25, 7)
        found = atlas.alpha_limits(beta, gamma=gamma, delta=delta, delay=delay)
        for index, row in enumerate(beta.tolist()):
            low, high = (float(limit) for limit in region.alpha_limits(row))
            assert abs(found.lower[index] - low) <= found.lower_error[index] + 1e-15
            assert abs(found.upper[index] - high) <= found.upper_error[index] + 1e-15
            assert found.upper_error[index] < 0.01 * high
        largest = atlas.max_alpha(gamma=gamma, delta=delta, delay=delay)
        exact = float(region.max_alpha[0])
        assert largest.alpha <= exact * (1 + 1e-14) <= largest.bound * (1 + 2e-14)
        assert largest.bound - largest.alpha < 0.01 * exact


def test_a_row_without_a_stable_alpha_has_no_limits(atlas: Atlas) -> None:
    beta = atlas.nodes(0)["beta"][-1]
    found = atlas.alpha_limits(beta, gamma=0.0, delta=0.0, delay=0.0)
    assert np.isnan(found.lower)
    assert np.isnan(found.upper)


def test_nothing_is_said_of_alphas_beyond_the_atlas(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    """Surfaces of limits go on beyond the largest alpha of an atlas, where they prove nothing."""
    atlas = open_atlas(write_cut(tmp_path / "cut.h5"))
    ends = atlas.arrays["limit_range"]
    least, most = ends[0, 2:4].tolist()
    gamma, delta, delay = (rng.uniform(0.0, top, 300) for top in (0.001, 0.015, 1.0))
    hands = {"gamma": gamma, "delta": delta, "delay": 0.5 + delay}
    beta = rng.uniform(ends[:, 4].max(), ends[:, 5].min(), 300)
    limits = atlas.alpha_limits(beta, **hands)
    proved = limits.upper - limits.upper_error
    assert np.isinf(proved).any()
    assert np.any(proved < most)
    assert np.all((proved < most) | ~np.isfinite(proved))
    stable_up_to = np.minimum(proved, most) - 1e-9
    holds = np.maximum(limits.lower + limits.lower_error, least) < stable_up_to
    codes = verdict(stable_up_to, beta, **hands, resolve="exact")
    assert np.all(codes[holds] == Verdict.STABLE)
    largest = atlas.max_alpha(**hands)
    early = hands["delay"] < 1.2
    assert np.all((largest.alpha[early] == most) & np.isinf(largest.bound[early]))
    assert np.all(verdict(largest.alpha * (1.0 - 1e-9), largest.beta, **hands) == Verdict.STABLE)
    _, high = atlas.common_alpha_limits(0.4, gamma=(0.0, 0.001), delta=(0.0, 0.015), delay=0.7)
    assert high == most


def random_atlas(rng: np.random.Generator, path: Path) -> Atlas:
    """Hands and delays of all sizes; alphas and betas may end anywhere within the stable set."""
    velocities = [None, Velocity.difference(samples=int(rng.integers(2, 10)))]
    velocity = velocities[rng.integers(2)]
    gamma, delta = 10.0 ** rng.uniform(-6.0, 1.0), 10.0 ** rng.uniform(-4.0, 0.3)
    first = float(rng.choice([0.0, 0.3, 1.0, 2.5]))
    region = stable_region(gamma=0.5 * gamma, delta=0.5 * delta, delay=first, velocity=velocity)
    tops = np.nanmax(np.abs(region.points), axis=0, initial=1e-6)
    ends = tops * 10.0 ** rng.uniform(-0.7, 0.2, 2)
    alpha, beta = (np.linspace(-0.01 * end, end, 8) for end in ends)
    spec = AtlasSpec(
        alpha=alpha,
        beta=beta if rng.random() < 0.7 else FittedAxis(8),
        gamma=[gamma] if rng.random() < 0.3 else [0.0, gamma],
        delta=[delta] if rng.random() < 0.3 else [0.2 * delta, delta],
        delay=[first, first + float(rng.choice([0.2, 0.7, 1.0]))],
        products=["alpha_limits"],
        limit_cells=int(rng.integers(8, 40)),
        delay_cells=int(rng.integers(2, 8)),
        velocity=velocity,
    )
    return build_atlas(spec, path)


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(20))
def test_what_random_atlases_say_of_limits_is_true(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    atlas = random_atlas(rng, tmp_path / "random.h5")
    velocity = atlas.filters[0] if atlas.filters else None
    ends = atlas.arrays["limit_range"]
    delay = float(rng.uniform(ends[0, 0], ends[-1, 1]))
    least, most, low, high = ends[np.searchsorted(ends[:, 0], delay, "right") - 1, 2:]
    nodes = (atlas.arrays[name] for name in ("gamma", "delta"))
    gammas, deltas = (sorted(rng.uniform(along[0], along[-1], 2).tolist()) for along in nodes)
    gamma, delta = (np.append(rng.uniform(*ends, 200), ends) for ends in (gammas, deltas))
    hands = {"gamma": gamma, "delta": delta, "delay": delay}
    box = {"gamma": tuple(gammas), "delta": tuple(deltas), "delay": delay}
    for beta in rng.uniform(low, high, 20).tolist():
        at = atlas.alpha_limits(beta, **hands)  # NaN where nothing is stable
        start = np.maximum(at.lower + at.lower_error, least)
        stop = np.minimum(at.upper - at.upper_error, most)
        exists = start < stop
        start, width = np.where(exists, start, 0.0), np.where(exists, stop - start, 0.0)
        for share in (1e-6, 0.5, 1.0 - 1e-6):
            codes = verdict(start + share * width, beta, **hands, velocity=velocity)
            assert not np.any((codes == Verdict.UNSTABLE) & exists)
        lowest, highest = atlas.common_alpha_limits(beta, **box)
        alpha = lowest + (1.0 - 1e-6) * (highest - lowest) if lowest < highest else 0.0
        codes = verdict(alpha, beta, **hands, velocity=velocity)
        assert lowest >= highest or not np.any(codes == Verdict.UNSTABLE)
    largest = atlas.max_alpha(**hands)
    known = np.isfinite(largest.alpha)
    alpha, beta = (np.where(known, part, 0.0) for part in largest[:2])
    codes = verdict(alpha - 1e-6 * np.abs(alpha), beta, **hands, velocity=velocity)
    assert not np.any((codes == Verdict.UNSTABLE) & known)
    walls = rng.uniform(least, most, 500), rng.uniform(low, high, 500)
    one = {"gamma": gamma[0], "delta": delta[0], "delay": delay, "velocity": velocity}
    stable = walls[0][verdict(*walls, **one) == Verdict.STABLE]
    assert not known[0] or np.all(stable <= largest.bound[0])


def test_the_worst_of_many_hands_decides(atlas: Atlas, rng: np.random.Generator) -> None:
    gamma, delta = (0.0002, 0.0009), (0.001, 0.012)
    low, high = atlas.common_alpha_limits(0.3, gamma=gamma, delta=delta, delay=1.5)
    hands = rng.uniform(*gamma, 2000), rng.uniform(*delta, 2000)
    for alpha in (low + 1e-12, high - 1e-12):
        codes = np.asarray(verdict(alpha, 0.3, **by_name(*hands, 1.5)))
        assert np.all(codes == Verdict.STABLE)
        assert (
            atlas.worst_verdict(alpha, 0.3, gamma=gamma, delta=delta, delay=1.5) == Verdict.STABLE
        )
    assert (
        atlas.worst_verdict(high * 1.05, 0.3, gamma=gamma, delta=delta, delay=1.5)
        == Verdict.UNSTABLE
    )
    worst = min(
        float(stable_region(gamma=g, delta=d, delay=1.5).alpha_limits(0.3)[1])
        for g in gamma
        for d in delta
    )
    assert 0.99 * worst < high <= worst


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda atlas: atlas.alpha_limits(np.nan, gamma=0.0, delta=0.0, delay=0.0), "beta is nan"),
        (
            lambda atlas: atlas.alpha_limits(0.1, gamma=1.0, delta=0.0, delay=0.0),
            "gamma is 1.0, and this atlas",
        ),
        (
            lambda atlas: atlas.alpha_limits(0.1, gamma=0.0, delta=0.0, delay=0.5),
            "delay is 0.5; this atlas has",
        ),
        (
            lambda atlas: atlas.max_alpha(gamma=0.0, delta=-1.0, delay=0.0),
            "delta is -1.0, and this atlas",
        ),
        (
            lambda atlas: atlas.worst_verdict(
                0.1, 0.1, gamma=(0.001, 0.0), delta=(0.0, 0.01), delay=0.0
            ),
            "gamma is .0.001, 0.0.; give its lowest and its highest",
        ),
        (
            lambda atlas: atlas.worst_verdict(
                9.0, 0.1, gamma=(0.0, 0.001), delta=(0.0, 0.01), delay=0.0
            ),
            "alpha is 9.0, and this atlas",
        ),
        (lambda atlas: atlas.verdict(np.nan, 0.1, gamma=0.0, delta=0.0, delay=0.0), "alpha is nan"),
    ],
)
def test_questions_that_cannot_be_answered_are_refused(atlas: Atlas, ask, words: str) -> None:
    with pytest.raises(ValueError, match="^" + words):
        ask(atlas)


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda _: checked_range("gamma", np.int8(0)), "gamma is np.int8.0.; give its lowest"),
        (lambda _: checked_range("gamma", (0.0, 0.1, 0.2)), "gamma is .0.0, 0.1, 0.2.; give its"),
        (
            lambda a: a.query(np.ma.array([0.1], mask=[1]), 0.1, gamma=0, delta=0, delay=0),
            "alpha is a masked array",
        ),
        (
            lambda a: a.verdict(0.1, 0.1, gamma=0, delta=0, delay=10**400),
            "delay is 10000.*; give real numbers",
        ),
    ],
)
def test_what_is_no_number_is_refused_by_its_name(atlas: Atlas, ask, words: str) -> None:
    with pytest.raises(TypeError, match="^" + words):
        ask(atlas)


def test_without_the_product_there_are_verdicts_but_no_limits() -> None:
    arrays, names = small_contents(), set(PRODUCTS["alpha_limits"].names)
    left = {name: own for name, own in arrays.table.variables.items() if name not in names}
    atlas = Atlas(replace(arrays, table=replace(arrays.table, variables=left)))
    point = dict(zip(AXES, (0.1, 0.3, 0.0005, 0.004, 0.0), strict=True))
    assert atlas.verdict(**point) == Verdict.STABLE
    with pytest.raises(ValueError, match="holds no limits of alpha"):
        atlas.max_alpha(gamma=0.0, delta=0.0, delay=0.0)


# -------------------------------------------------------------------------------- between delays


@pytest.fixture(scope="module")
def moving() -> Atlas:
    return moving_atlas()


def points_between(atlas: Atlas, count: int, rng: np.random.Generator) -> list[np.ndarray]:
    """Points of all delays, with many on the edges of cells of delays."""
    ends = atlas.arrays["limit_range"]
    edges = ends[:, :2].ravel()
    beside = [np.nextafter(edges[1:-1], side) for side in (-np.inf, np.inf)]
    at_edges = rng.choice(np.concatenate([edges, *beside]), count)
    delay = np.where(rng.random(count) < 0.5, at_edges, rng.uniform(0.0, 1.5, count))
    row = ends[np.searchsorted(ends[:, 0], delay, "right") - 1]
    alpha, beta = (rng.uniform(*row[:, side].T) for side in ((2, 3), (4, 5)))
    return [alpha, beta, rng.uniform(0.0, 0.001, count), rng.uniform(0.0, 0.015, count), delay]


@pytest.mark.campaign
def test_verdicts_between_delays_are_those_of_the_recursion(
    moving: Atlas, rng: np.random.Generator
) -> None:
    points = points_between(moving, 6000, rng)
    assert np.mean(moving.verdict(**by_name(*points)) != Verdict.UNDECIDED) > 0.99
    at = moving.alpha_limits(**by_name(*(values[:3000] for values in points[1:])))
    with np.errstate(invalid="ignore"):
        beside = rng.choice([at.lower + 1.01 * at.lower_error, at.upper - 1.01 * at.upper_error])
    points[0][:3000] = np.where(np.isfinite(beside), beside, points[0][:3000])
    answered = moving.query(**by_name(*points), outside="undecided").verdict
    exact = np.asarray(verdict(**by_name(*points), resolve="exact"))
    decided = answered != Verdict.UNDECIDED
    np.testing.assert_array_equal(answered[decided], exact[decided])


def test_limits_between_delays_hold_the_exact_ones(moving: Atlas) -> None:
    delays = np.array([0.0, 0.3, 0.999, 1.0, 1.37, 1.5])
    found = moving.alpha_limits(0.3, gamma=0.0004, delta=0.003, delay=delays)
    for index, delay in enumerate(delays.tolist()):
        region = stable_region(gamma=0.0004, delta=0.003, delay=delay)
        low, high = (float(limit) for limit in region.alpha_limits(0.3))
        assert abs(found.lower[index] - low) <= found.lower_error[index] + 1e-15
        assert abs(found.upper[index] - high) <= found.upper_error[index] <= 0.02 * high
        largest = moving.max_alpha(gamma=0.0004, delta=0.003, delay=delay)
        assert largest.alpha <= float(region.max_alpha[0]) <= largest.bound


def test_a_delay_is_a_number_or_an_array(moving: Atlas, rng: np.random.Generator) -> None:
    points = points_between(moving, 300, rng)
    many = moving.verdict(**by_name(*points))
    np.testing.assert_array_equal(many, moving.query(**by_name(*points)).verdict)
    for index, point in enumerate(zip(*(values.tolist() for values in points), strict=True)):
        assert moving.verdict(**by_name(*point)) == many[index]
    status = moving.query(**by_name(*points)).status
    assert set(status.tolist()) <= {QueryStatus.CELL, QueryStatus.UNDECIDED_CELL}
    assert (
        moving.worst_verdict(0.05, 0.3, gamma=(0.0, 0.001), delta=(0.001, 0.01), delay=1.37)
        == Verdict.STABLE
    )
    assert (
        moving.verdict(0.5, 0.3, gamma=0.0, delta=0.0, delay=1.37) == Verdict.UNSTABLE
    )  # lemma B21
    assert truth.spectral_radius(0.5, 0.3, 0.0, 0.0, 1.37)[0] > 1.0
    with pytest.raises(ValueError, match=r"^alpha is 0.5, and this atlas .*; give a value in"):
        moving.worst_verdict(0.5, 0.3, gamma=(0.0, 0.0), delta=(0.0, 0.0), delay=1.37)
    with pytest.raises(ValueError, match=r"^delay is 1.6, and this atlas covers 0.0 to 1.5"):
        moving.alpha_limits(0.3, gamma=0.0, delta=0.0, delay=[0.3, 1.6])
