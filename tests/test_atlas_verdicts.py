"""Verdicts of nodes are those of dense computation; those of cells hold at all their points."""

import itertools
from collections.abc import Iterator
from typing import Any, NamedTuple

import flint
import numpy as np
import pytest

from benchmarks import truth
from jaxstab import Verdict, characteristic_polynomial, verdict
from jaxstab.atlas import proved as verdicts
from jaxstab.atlas.proved import cell_verdicts, node_verdicts, proved_nodes
from jaxstab.proofs.columns import ColumnGaps, column_gaps
from jaxstab.proofs.plant import HandBoxes

DELAYS = (0.0, 0.5, 1.0, 5.0)
MORE_DELAYS = (2.3, 20.0, 41.7, 60.0)  # for the campaign: XLA compiles for each
SLICES = 12  # of each delay
LONGEST = 2**13

# Corners of the parameter space: no spring or damper, haptic, resonant, strongly damped.
CELLS = [
    ((0.0, 0.0005), (0.0, 0.002)),
    ((0.0005, 0.001), (0.01, 0.015)),
    ((2.4, 2.5), (0.0, 0.01)),
    ((9.8, 9.81), (0.9, 0.91)),
]
CELL_DELAYS = [0.0, 1.0, 3.0, 0.25, 2.5]


class Slice(NamedTuple):
    alpha: np.ndarray
    beta: np.ndarray
    gamma: float
    delta: float
    delay: float

    def codes(self) -> np.ndarray:
        return node_verdicts(self.alpha, self.beta, *self.hand, self.delay)[0]

    def undecided(self) -> int:
        codes = proved_nodes(self.alpha, self.beta, *self.hand, self.delay)
        return int(np.sum(codes == Verdict.UNDECIDED))

    @property
    def hand(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array([self.gamma]), np.array([self.delta])


class Box(NamedTuple):
    lowest: tuple[float, float]
    highest: tuple[float, float]


def random_box(rng: np.random.Generator, delay: float) -> Box:
    """Around the stable set, over all turns of the curve, or anywhere of any size."""
    scale = 1 / (1 + delay)
    kind = rng.integers(3)
    if kind == 0:
        return Box((-0.2 * scale**2, -0.2 * scale), (1.2 * scale**2, 2 * scale))
    if kind == 1:
        return Box((-4.0, -4.0), (4.0, 4.0))
    low = rng.uniform(-1, 1, 2) * 10 ** rng.uniform(-6, 2, 2)
    high = low + 10 ** rng.uniform(-6, 2, 2)
    return Box(tuple(low.tolist()), tuple(high.tolist()))


def random_axis(
    rng: np.random.Generator, low: float, high: float, count: int, special: float
) -> np.ndarray:
    """Even nodes, or uneven ones and one on a line of the boundary."""
    if rng.random() < 0.5:
        return np.linspace(low, high, count)
    return np.unique(np.append(rng.uniform(low, high, count), special))


def random_slice(rng: np.random.Generator, delay: float) -> Slice:
    gammas = [0.0, 1e-3, np.pi**2, 10 ** rng.uniform(-12, 2), rng.uniform(0, 12)]
    deltas = [0.0, 0.015, 10 ** rng.uniform(-12, 1), rng.uniform(0, 0.6)]
    gamma, delta = float(rng.choice(gammas)), float(rng.choice(deltas))
    (alpha_low, beta_low), (alpha_high, beta_high) = random_box(rng, delay)
    counts = rng.integers(2, 90, 2).tolist()
    alpha = random_axis(rng, alpha_low, alpha_high, counts[0], -gamma)
    beta = random_axis(rng, beta_low, beta_high, counts[1], 0.0)
    return Slice(alpha, beta, gamma, delta, delay)


def dense(of: Slice) -> np.ndarray:
    """Every node by a verdict of its own; all in lists of one length, compiled once."""
    alpha, beta = (gain.ravel() for gain in np.meshgrid(of.alpha, of.beta, indexing="ij"))
    listed = np.resize(alpha, LONGEST), np.resize(beta, LONGEST)
    codes = np.asarray(
        verdict(*listed, gamma=of.gamma, delta=of.delta, delay=of.delay, resolve="exact")
    )
    return codes[: alpha.size].reshape(of.alpha.size, of.beta.size)


# -------------------------------------------------------------------------------------------- nodes


@pytest.mark.parametrize(
    "delay", [*DELAYS, *(pytest.param(delay, marks=pytest.mark.campaign) for delay in MORE_DELAYS)]
)
def test_slices_equal_dense_ones_bit_for_bit(delay: float, rng: np.random.Generator) -> None:
    for _ in range(SLICES):
        of = random_slice(rng, delay)
        codes = of.codes()
        assert codes.dtype == np.int8
        np.testing.assert_array_equal(codes, dense(of), err_msg=str(of[2:]))


COARSE = list(itertools.product((6, 9, 14), (7, 8, 9, 14), (0.2, 0.4, 0.6)))


@pytest.mark.parametrize("delay", [0.0, 2.0])
@pytest.mark.parametrize(
    "grids", [COARSE[::7], pytest.param(COARSE, marks=pytest.mark.campaign)], ids=["some", "all"]
)
def test_coarse_grids_past_which_the_curve_runs_to_infinity(
    grids: list[tuple[int, int, float]], delay: float
) -> None:
    """Without spring and damper N(-1) is 0, so the curve has no end.

    Wide columns leave more nodes open than narrow ones: up to 28 % of these 42 to 196.
    """
    for alphas, betas, top in grids:
        nodes = np.linspace(-0.01, top, alphas), np.linspace(-0.0764743, 2.0779526, betas)
        of = Slice(*nodes, 0.0, 0.0, delay)
        np.testing.assert_array_equal(of.codes(), dense(of))
        assert of.undecided() < 0.3 * alphas * betas


@pytest.mark.parametrize("delay", [0.0, 3.0, 20.0, 59.5])
def test_a_slice_has_the_roots_of_the_truth(delay: float, rng: np.random.Generator) -> None:
    gamma, delta, scale = 1e-3, 0.015, 1 / (1 + delay)
    alpha = np.linspace(-0.05 * scale**2, 1.1 * scale**2, 300)
    beta = np.linspace(-0.1 * scale, 1.7 * scale, 300)
    codes = Slice(alpha, beta, gamma, delta, delay).codes()
    assert set(np.unique(codes)) == {Verdict.STABLE, Verdict.UNSTABLE}
    changes = np.argwhere(codes[:, 1:] != codes[:, :-1])
    for i, j in rng.choice(changes, 12, axis=0):
        for beside in (j, j + 1):
            point = float(alpha[i]), float(beta[beside]), gamma, delta, delay
            unstable = truth.unstable_count(*point)
            assert codes[i, beside] == (Verdict.UNSTABLE if unstable else Verdict.STABLE)


@pytest.mark.parametrize(
    "delay",
    [0.0, 20.0, *(pytest.param(d, marks=pytest.mark.campaign) for d in (0.5, 1.0, 5.0, 60.0))],
)
@pytest.mark.parametrize("side", ["the stable set", "many turns"])
def test_a_slice_of_4096_squared_evaluates_less_than_a_percent(side: str, delay: float) -> None:
    """Around the stable set next to nothing; far outside, at long delays, where gaps are thin."""
    scale = 1 / (1 + delay)
    ends = {
        "the stable set": [-0.05 * scale**2, 1.1 * scale**2, -0.1 * scale, 1.7 * scale],
        "many turns": [-4, 4, -4, 4],
    }[side]
    alpha, beta = np.linspace(*ends[:2], 4096), np.linspace(*ends[2:], 4096)
    is_thin = side == "many turns" and delay >= 20.0
    most = 0.003 * alpha.size * beta.size if is_thin else 5000
    assert Slice(alpha, beta, 1e-3, 0.015, delay).undecided() < most


class Recorder:
    """The nodes whose verdicts are computed."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.points: list[tuple[float, float]] = []
        monkeypatch.setattr(verdicts, "verdict", self.verdict)

    def verdict(self, alpha: np.ndarray, beta: np.ndarray, **keywords: Any) -> object:
        self.points += zip(alpha.tolist(), beta.tolist(), strict=True)
        return verdict(alpha, beta, **keywords)


def test_without_a_gap_each_node_is_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    of = Slice(np.linspace(-0.1, 1, 40), np.linspace(0, 1, 41), 1e-3, 0.015, 0.0)
    recorder, expected = Recorder(monkeypatch), of.codes()
    np.testing.assert_array_equal(expected, dense(of))
    assert len(recorder.points) == of.undecided() < 20

    def nothing_known(*arguments: object) -> ColumnGaps:
        gaps = column_gaps(*arguments)
        return gaps._replace(verdict=np.full_like(gaps.verdict, Verdict.UNDECIDED))

    monkeypatch.setattr(verdicts, "column_gaps", nothing_known)
    recorder.points.clear()
    np.testing.assert_array_equal(of.codes(), expected)
    assert len(set(recorder.points)) == len(recorder.points) == 40 * 41


def test_nodes_on_the_line_of_a_root_at_one_are_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    of = Slice(np.linspace(-1.0, 1.0, 21), np.linspace(0.1, 1.0, 10), 0.0, 0.0, 0.0)
    assert of.alpha[10] == 0.0
    recorder = Recorder(monkeypatch)
    assert np.all(of.codes()[10] == Verdict.UNSTABLE)
    assert {(0.0, beta) for beta in of.beta.tolist()} <= set(recorder.points)


def test_hands_computed_together_are_those_computed_alone() -> None:
    gamma, delta = np.array([0.0, 0.001, 2.4]), np.array([0.015, 0.0, 0.3])
    nodes = np.linspace(-2.5, 1.0, 30), np.linspace(-0.5, 1.5, 20)
    together = node_verdicts(*nodes, gamma, delta, 1.5)
    for hand, codes in enumerate(together):
        alone = node_verdicts(*nodes, gamma[hand : hand + 1], delta[hand : hand + 1], 1.5)[0]
        np.testing.assert_array_equal(codes, alone)


# ------------------------------------------------------------------------- verdicts far from stable


def test_unstable_loops_of_a_long_delay_are_decided_by_a_root_where_the_recursion_is_lost(
    rng: np.random.Generator,
) -> None:
    alpha, beta = rng.uniform(-4, 4, (2, 400))
    at = {"gamma": 69.9, "delta": 0.015, "delay": 100.0}
    quick = np.asarray(verdict(alpha, beta, **at))
    exact = np.asarray(verdict(alpha, beta, **at, resolve="exact"))
    assert np.mean(quick == Verdict.UNDECIDED) > 0.2
    assert np.all(exact != Verdict.UNDECIDED)
    coefficients = np.asarray(characteristic_polynomial(alpha, beta, **at))
    for index in rng.choice(np.flatnonzero(quick == Verdict.UNDECIDED), 10):
        with flint.ctx.workprec(300):
            balls = flint.acb_poly(coefficients[index, ::-1].tolist()).roots()
            assert exact[index] == Verdict.UNSTABLE
            assert any(abs(ball) > 1 for ball in balls)


def test_a_recursion_that_breaks_down_leaves_unstable_loops_decided() -> None:
    # gamma = delta = 0 without delay: p(0) = beta / 2, so a coefficient of reflection is exactly 1.
    codes = verdict(
        np.array([0.1, 0.5, 1.5]), 2.0, gamma=0.0, delta=0.0, delay=0.0, resolve="exact"
    )
    assert np.all(codes == Verdict.UNSTABLE)


# -------------------------------------------------------------------------------------------- cells


def cells_of(
    alpha: np.ndarray,
    beta: np.ndarray,
    gamma: tuple[float, float],
    delta: tuple[float, float],
    delay: float,
) -> np.ndarray:
    """The verdicts of all cells between nodes, over one box of hands."""
    sides = np.array([gamma, delta])
    half = 0.5 * np.diff(sides)[:, 0] * (1 + 1e-9)
    hands = HandBoxes(*sides.mean(axis=1)[:, None], *half[:, None])
    return cell_verdicts(alpha, beta, hands, delay)[0]


@pytest.mark.parametrize("count", [6, pytest.param(40, marks=pytest.mark.campaign)])
@pytest.mark.parametrize("delay", CELL_DELAYS)
@pytest.mark.parametrize(("gamma", "delta"), CELLS)
def test_a_proved_cell_has_its_verdict_at_each_of_its_points(
    gamma: tuple[float, float],
    delta: tuple[float, float],
    delay: float,
    count: int,
    rng: np.random.Generator,
) -> None:
    """Cells of random size around the closed-form boundary, where a false proof would be."""
    proved = 0
    for _ in range(count):
        gains = truth.boundary_point(rng.uniform(0.01, 3.1), np.mean(gamma), np.mean(delta), delay)
        alpha, beta = map(float, gains)
        width = 10.0 ** rng.uniform(-2.5, 0.3) * np.array([1 + abs(alpha), 1 + abs(beta)])
        start = np.array([alpha, beta]) - width * rng.uniform(-2.0, 3.0, 2)
        ends = np.stack([start, start + width])
        (code,) = cells_of(*ends.T, gamma, delta, delay).ravel()
        if code != Verdict.UNDECIDED:
            proved += 1
            for point in points_of_cell(ends, gamma, delta, rng):
                unstable = truth.unstable_count(*point, delay)
                assert code == (Verdict.UNSTABLE if unstable else Verdict.STABLE)
    assert proved >= (3 if count >= 40 else 1)


def points_of_cell(
    ends: np.ndarray,
    gamma: tuple[float, float],
    delta: tuple[float, float],
    rng: np.random.Generator,
) -> Iterator[tuple[float, ...]]:
    box = [tuple(ends[:, 0]), tuple(ends[:, 1]), gamma, delta]
    corners = list(itertools.product(*box))
    for corner in rng.choice(len(corners), 4, replace=False):
        yield tuple(map(float, corners[corner]))
    yield tuple(float(rng.uniform(*side)) for side in box)


@pytest.mark.parametrize("count", [20, pytest.param(40, marks=pytest.mark.campaign)])
@pytest.mark.parametrize("delay", CELL_DELAYS)
def test_a_cell_that_holds_a_point_of_the_boundary_is_never_proved_stable(
    delay: float, count: int, rng: np.random.Generator
) -> None:
    """Nor unstable, but below alpha = -gamma, where the curve bounds nothing."""
    for theta in rng.uniform(1e-4, 3.14, count):
        hand = rng.uniform(0, 0.001), rng.uniform(0, 0.015)
        gains = [float(gain) for gain in truth.boundary_point(theta, *hand, delay)]
        width = 10.0 ** rng.uniform(-9, -1, 4)
        sides = [
            np.array([value - part * size, value + (1 - part) * size])
            for value, part, size in zip(
                [*gains, *hand], rng.uniform(0.01, 0.99, 4), width, strict=True
            )
        ]
        alpha, beta, *hands = sides
        (code,) = cells_of(alpha, beta, *(np.maximum(side, 0.0) for side in hands), delay).ravel()
        assert code != Verdict.STABLE
        assert code == Verdict.UNDECIDED or alpha[1] < -max(hands[0][0], 0.0)


def test_cells_beside_the_line_of_a_real_root_at_one_are_proved_and_those_on_it_not() -> None:
    alpha = np.array([-0.002, -0.00101, -0.00099, 0.00001, 0.002])
    codes = cells_of(alpha, np.array([0.4, 0.41]), (0.0, 0.001), (0.005, 0.0051), 0.0)
    assert codes[:, 0].tolist() == [
        Verdict.UNSTABLE,
        Verdict.UNDECIDED,
        Verdict.UNDECIDED,
        Verdict.STABLE,
    ]


@pytest.mark.parametrize("delay", [0.0, 1.5, 12.0])
@pytest.mark.parametrize("delta", [(0.015, 0.015), (0.015, 0.016)])
def test_all_cells_but_those_at_the_boundary_are_proved(
    delay: float, delta: tuple[float, float], rng: np.random.Generator
) -> None:
    scale = 1 / (1 + delay)
    alpha = np.linspace(-0.05 * scale**2, 1.1 * scale**2, 131)
    beta = np.linspace(-0.1 * scale, 1.7 * scale, 104)
    codes = cells_of(alpha, beta, (1e-3, 1e-3), delta, delay)
    assert np.mean(codes != Verdict.UNDECIDED) > 0.85
    i, j = rng.integers(0, 130, 2000), rng.integers(0, 103, 2000)
    part = rng.choice([0.0, 0.5, 1.0], (3, 2000))
    gains = (
        nodes[cell] + share * np.diff(nodes)[cell]
        for nodes, cell, share in zip((alpha, beta), (i, j), part, strict=False)
    )
    exact = verdict(
        *gains,
        gamma=1e-3,
        delta=delta[0] + part[2] * (delta[1] - delta[0]),
        delay=delay,
        resolve="exact",
    )
    assert not np.any((codes[i, j] != Verdict.UNDECIDED) & (codes[i, j] != exact))
