"""Limits of alpha that hold in whole boxes of beta and hands, against exact root counts."""

from itertools import product

import mpmath
import numpy as np
import pytest

from benchmarks import truth
from benchmarks.truth import filtered
from jaxstab import Filter, Velocity, Verdict, boundary_curve, verdict
from jaxstab.boxes.enclosures import LinearModel
from jaxstab.model.filters import known_filters
from jaxstab.proofs.columns import (
    Columns,
    Runs,
    StableColumns,
    Strips,
    _limits,
    _meets,
    column_gaps,
    columns_of,
    distances,
    runs_of,
    stable_columns,
)
from jaxstab.proofs.curve_patches import Domain, Intervals, Patches, curve_patches
from jaxstab.proofs.plant import HandBoxes, plant_models

HAPTIC = (1e-3, 0.015)
SCENES = [  # delay, gamma, delta, widths of the boxes, domain in units of the delay's stable set
    (0.0, (0.0, 0.0), (5e-4, 2e-3), Domain((-0.1, 0.75), (-0.1, 2.1))),
    (1.0, HAPTIC, (5e-4, 2e-3), Domain((-0.02, 0.16), (-0.1, 0.9))),
    (2.3, (0.02, 0.3), (1e-3, 2e-3), Domain((-0.1, 0.1), (-0.4, 0.7))),
    (2.7, HAPTIC, (1e-5, 1e-4), Domain((-0.02, 0.04), (-0.1, 0.5))),
    (0.0, (2.0, 0.1), (1e-2, 1e-2), Domain((-3.0, 1.0), (-1.0, 1.5))),
    (1.0, (np.pi**2 - 0.02, 0.3), (0.02, 1e-2), Domain((-12.0, 5.0), (-5.0, 5.0))),
    (0.2, HAPTIC, (5e-4, 2e-3), Domain((-0.1, 0.6), (-0.1, 3.0))),  # a root at -1 bounds it above
]
CELLS = 96


def boxes(first: tuple[float, float], width: tuple[float, float]) -> HandBoxes:
    """Four boxes of hands, two by two."""
    sides = np.array([0.5, 1.5])
    gamma, delta = np.meshgrid(first[0] + width[0] * sides, first[1] + width[1] * sides)
    half = [np.full(4, 0.5 * w * (1 + 1e-9)) for w in width]
    return HandBoxes(gamma.ravel(), delta.ravel(), *half)


def answers(
    columns: StableColumns, box: np.ndarray, cell: np.ndarray, point: tuple[np.ndarray, ...]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What is said of points (alpha, ..., delay), and a limit near each of them."""
    alpha, *rest = point
    delay = rest[-1]
    moved = (delay * value for value in (delay, *rest[:-1]))
    terms = np.stack([np.ones_like(alpha), *rest, *moved], axis=-1)
    (low, low_error), (high, high_error) = (
        (np.sum(planes[box, cell, :-1] * terms, axis=-1), planes[box, cell, -1])
        for planes in (columns.lower, columns.upper)
    )
    is_unstable = (alpha < low - low_error) | (alpha > high + high_error)
    is_stable = (alpha > low + low_error) & (alpha < high - high_error)
    nearest = np.where(np.abs(alpha - low) < np.abs(alpha - high), low, high)
    return is_stable, is_unstable, nearest


@pytest.mark.parametrize(
    ("first_delay", "first", "width", "domain", "delay_width"),
    [
        pytest.param(*scene, width, marks=[pytest.mark.campaign] * (width == 1 / 4 and k == 5))
        for k, scene in enumerate(SCENES)
        for width in (0.0, 1 / 64, 1 / 4)
    ],
)
def test_what_is_said_of_a_column_is_true_of_every_point(
    first_delay: float,
    first: tuple[float, float],
    width: tuple[float, float],
    domain: Domain,
    delay_width: float,
    rng: np.random.Generator,
) -> None:
    """In the middle of cells and on their edges, along the delay up to the next whole sample."""
    hands = boxes(first, width)
    edges = np.linspace(*domain.beta, CELLS + 1)
    count = 2**12
    sides = min(first_delay, np.floor(first_delay) + 1.0 - delay_width) + np.array([0, delay_width])
    half_delay = 0.5 * np.ptp(sides)
    columns = stable_columns(edges, hands, sides.mean(), domain, half_delay=half_delay)
    delay = np.clip(sides.mean() + rng.choice([-1.0, 0.3, 1.0], count) * half_delay, *sides)
    box, cell = rng.integers(0, 4, count), rng.integers(0, CELLS, count)
    beta = edges[cell] + rng.choice([0.0, 0.3, 0.7, 1.0], count) * (edges[1] - edges[0])
    within = rng.choice([-1.0, 1.0, 0.2], (2, count)) / (1 + 1e-9)
    gamma = np.maximum(hands.gamma[box] + within[0] * hands.half_gamma[box], 0.0)
    delta = np.maximum(hands.delta[box] + within[1] * hands.half_delta[box], 0.0)
    alpha = rng.uniform(*domain.alpha, count)
    nearest = answers(columns, box, cell, (alpha, beta, gamma, delta, delay))[2]
    close = (rng.random(count) < 0.5) & (np.abs(nearest) < np.max(np.abs(domain.alpha)))
    alpha = np.where(close, nearest * (1 + rng.choice([-1e-3, 1e-3, 1e-2], count)), alpha)
    alpha = np.clip(alpha, *domain.alpha)

    is_stable, is_unstable, _ = answers(columns, box, cell, (alpha, beta, gamma, delta, delay))
    codes = np.asarray(verdict(alpha, beta, gamma=gamma, delta=delta, delay=delay, resolve="exact"))
    assert np.all(codes[is_stable] == Verdict.STABLE)
    assert not np.any(codes[is_unstable] == Verdict.STABLE)
    assert np.mean(is_stable | is_unstable) > (0.6 if delay_width < 0.1 else -1.0)
    known = np.flatnonzero(is_stable | is_unstable)
    for k in rng.choice(known, 8) if known.size else ():
        point = (float(v[k]) for v in (alpha, beta, gamma, delta, delay))
        unstable = truth.unstable_count(*point)
        assert is_stable[k] == (unstable == 0)


@pytest.mark.parametrize("edges", ["even", "uneven"])
@pytest.mark.parametrize(("delay", "first", "width", "domain"), SCENES)
def test_what_is_said_of_a_gap_is_true_of_every_point(
    delay: float,
    first: tuple[float, float],
    width: tuple[float, float],
    domain: Domain,
    edges: str,
    rng: np.random.Generator,
) -> None:
    """At random points of gaps and close to their ends, on the edges of columns and within."""
    hands = boxes(first, width)
    beta = np.linspace(*domain.beta, CELLS + 1)
    if edges == "uneven":
        beta[1:-1] = np.sort(rng.uniform(*domain.beta, CELLS - 1))
    gaps = column_gaps(beta, hands, delay, domain)
    is_gap = (gaps.low < gaps.high) & np.isin(gaps.verdict, (Verdict.STABLE, Verdict.UNSTABLE))
    assert {Verdict.STABLE, Verdict.UNSTABLE} <= set(gaps.verdict[is_gap].tolist())
    some = rng.choice(np.argwhere(is_gap), 2**12)
    low, high, code = (part[tuple(some.T)] for part in gaps)
    share = rng.choice([1e-9, 1e-6, 0.5, 1 - 1e-6, 1 - 1e-9], len(some))
    alpha = np.clip(low + share * (high - low), np.nextafter(low, high), np.nextafter(high, low))
    box, cell, _ = some.T
    at = beta[cell] + rng.choice([0.0, 0.3, 0.7, 1.0], len(some)) * np.diff(beta)[cell]
    within = rng.choice([-1.0, 1.0, 0.2], (2, len(some))) / (1 + 1e-9)
    gamma = np.maximum(hands.gamma[box] + within[0] * hands.half_gamma[box], 0.0)
    delta = np.maximum(hands.delta[box] + within[1] * hands.half_delta[box], 0.0)
    exact = np.asarray(verdict(alpha, at, gamma=gamma, delta=delta, delay=delay, resolve="exact"))
    assert not np.any((exact != code) & (exact != Verdict.UNDECIDED))
    widths = np.where(
        is_gap, np.clip(gaps.high, *domain.alpha) - np.clip(gaps.low, *domain.alpha), 0
    )
    share = np.average(widths.sum(axis=2), weights=np.tile(np.diff(beta), (4, 1)))
    assert share > 0.6 * np.ptp(domain.alpha)


def test_the_haptic_range_leaves_less_than_a_thousandth_undecided(rng: np.random.Generator) -> None:
    hands = boxes((0.0, 0.0), (5e-4, 1.875e-3))
    domain = Domain((-0.02, 0.7), (-0.05, 2.05))
    edges = np.linspace(*domain.beta, 513)
    columns = stable_columns(edges, hands, 0.0, domain)
    spread = np.minimum(columns.lower[..., -1] + columns.upper[..., -1], 0.72)
    assert 2 * spread.mean() / 0.72 < 1e-3


@pytest.mark.parametrize(("delay", "first", "width", "domain"), SCENES)
def test_every_column_has_limits(
    delay: float, first: tuple[float, float], width: tuple[float, float], domain: Domain
) -> None:
    """Where patches above the line alpha = -gamma leave a gap undecided, those apart from it do."""
    columns = stable_columns(
        np.linspace(*domain.beta, CELLS + 1), boxes(first, width), delay, domain
    )
    assert np.all(np.isfinite(columns.lower[..., -1]) & np.isfinite(columns.upper[..., -1]))


def test_where_no_hand_is_stable_all_alphas_are_unstable() -> None:
    hands = boxes(HAPTIC, (1e-4, 1e-4))
    columns = stable_columns(np.linspace(5, 6, 9), hands, 0.0, Domain((-1.0, 1.0), (5.0, 6.0)))
    assert np.all(columns.lower[..., 0] == np.inf)


def test_a_stable_set_that_leaves_the_domain_is_open_there() -> None:
    hands = boxes(HAPTIC, (1e-4, 1e-4))
    columns = stable_columns(np.linspace(0.5, 1, 9), hands, 0.0, Domain((0.1, 0.3), (0.5, 1.0)))
    assert np.all(columns.upper[..., 0] == np.inf)
    assert np.all(columns.lower[..., 2] == -1.0)  # the line alpha = -gamma, still below


def test_patches_hold_the_curve_of_every_hand(rng: np.random.Generator) -> None:
    """At corners of some patches more than half of the bounds is attained."""
    hands = boxes(HAPTIC, (5e-4, 2e-3))
    patches = curve_patches(hands, 2.5, Domain((-0.1, 0.1), (-0.1, 0.7)), (1e-2, 1e-2))
    count = 2**12
    k = rng.integers(0, patches.box.size, count)
    place = rng.uniform(-1, 1, (3, count))
    place[:, : count // 2] = np.sign(place[:, : count // 2])
    half = patches.alpha.half[:, k]
    theta = 0.5 * (patches.start + patches.end)[k] + place[0] * half[0] * (1 - 1e-12)
    box = patches.box[k]
    gamma, delta = hands.gamma[box] + place[1] * half[1], hands.delta[box] + place[2] * half[2]
    curve = boundary_curve(np.clip(theta, 0, np.pi), gamma=gamma, delta=delta, delay=2.5)
    for gain, model in zip(curve, (patches.alpha, patches.beta), strict=True):
        linear = model.centre[k] + np.sum(model.slope[:, k] * half * place, axis=0)
        away = np.abs(np.asarray(gain) - linear)
        assert np.all(away <= model.rest[k])
        assert np.any(away > 0.5 * model.rest[k])


def test_parts_of_intervals_leave_nothing_out() -> None:
    """Each interval is cut into 2^halvings parts with common edges; for 0 there are none."""
    edges = np.sort(np.random.default_rng(3).uniform(0.0, np.pi, 41))
    whole = Intervals(np.arange(40) // 8, edges[:-1], edges[1:])
    halvings = np.arange(40) % 5
    owner, parts = whole.parts(halvings)
    assert np.array_equal(parts.box, whole.box[owner])
    for number, halved in enumerate(halvings):
        first, last = parts.start[owner == number], parts.end[owner == number]
        assert first.size == (2**halved if halved else 0)
        if halved:
            assert (first[0], last[-1]) == (whole.start[number], whole.end[number])
            assert np.array_equal(first[1:], last[:-1])
            assert np.all(first < last)


@pytest.mark.parametrize("fraction", [0.0, 0.3])
def test_models_of_the_plant_hold_at_the_corners(fraction: float) -> None:
    hands = boxes((0.3, 0.2), (0.2, 0.1))
    models = plant_models(hands, fraction)
    for box, signs in product(range(4), product((-1, 1), repeat=2)):
        gamma = float(hands.gamma[box] + signs[0] * hands.half_gamma[box])
        delta = float(hands.delta[box] + signs[1] * hands.half_delta[box])
        exact = truth.plant(gamma, delta, fraction)
        for name in ("d1", "d0", "n2", "n1", "n0"):
            model: LinearModel = getattr(models, name)
            linear = model.centre + model.slope[0] * model.half[0] * signs[0]
            linear = (linear + model.slope[1] * model.half[1] * signs[1])[box]
            assert abs(mpmath.mpf(linear) - getattr(exact, name)) <= model.rest[box]


@pytest.mark.parametrize(
    ("gamma", "delta", "fraction"),
    [
        ((24 * np.pi) ** 2, 5e-324, 0.0),  # N nearly vanishes: most of its digits are lost
        ((4 * np.pi) ** 2, 0.0, 0.0),
        ((29 * np.pi) ** 2, 1e-200, 0.3),
        (246.7, 847.2, 1e-12),  # e^-delta is flushed to zero
        (1.3e-6, 5e-324, 0.0),
        (0.0, 0.0, 0.0),
    ],
)
def test_models_of_a_plant_that_is_hard_to_compute_hold(
    gamma: float, delta: float, fraction: float
) -> None:
    models = plant_models(HandBoxes(*(np.array([v]) for v in (gamma, delta, 0.0, 0.0))), fraction)
    with mpmath.workdps(700):
        exact = truth.sampled_plant(gamma, delta, fraction if fraction else 0)
        for name in ("d1", "d0", "n2", "n1", "n0", "sum", "difference"):
            model: LinearModel = getattr(models, name)
            assert abs(mpmath.mpf(float(model.centre[0])) - getattr(exact, name)) <= model.rest[0]


def test_arithmetic_with_models_bounds_what_it_leaves(rng: np.random.Generator) -> None:
    half = np.full((2, 1), 0.1)
    x = LinearModel(np.array([0.7]), np.array([[1.0], [0.0]]), np.zeros(1), half)
    y = LinearModel(np.array([-0.4]), np.array([[0.0], [1.0]]), np.zeros(1), half)
    model = (x * y - 2.0 * x + 0.5) * (1.0 - y).reciprocal()
    for dx, dy in rng.uniform(-0.1, 0.1, (1000, 2)):
        u, v = 0.7 + dx, -0.4 + dy
        exact = (u * v - 2 * u + 0.5) / (1 - v)
        linear = model.centre[0] + model.slope[0, 0] * dx + model.slope[1, 0] * dy
        assert abs(exact - linear) <= model.rest[0]
    assert np.all(np.isinf((x - 0.65).reciprocal().rest))


FILTERED_BOXES = {  # filters, those of the truth; a box of hands; delay; domain of alpha and beta
    "a window with islands": (
        (Velocity.difference(samples=20), Filter()),
        (filtered.difference(20), filtered.average(1)),
        (5e-4, 2e-3, 5e-5, 2e-4),
        0.0,
        Domain((-0.02, 0.15), (-0.5, 0.9)),
    ),
    "poles, and zeros at -1": (
        (Velocity.low_pass(0.1), Filter.butterworth(0.2, order=2)),
        (
            filtered.times(filtered.difference(1), filtered.low_pass(0.1, order=1)),
            filtered.butterworth(0.2, order=2),
        ),
        (0.05, 0.1, 1e-3, 1e-3),
        1.5,
        Domain((-0.1, 0.1), (-0.2, 0.3)),
    ),
}


@pytest.mark.parametrize("name", FILTERED_BOXES)
def test_gaps_of_columns_with_filters_have_the_verdicts_of_certified_roots(
    name: str, rng: np.random.Generator
) -> None:
    filters, (velocity, position), box, delay, domain = FILTERED_BOXES[name]
    beta = np.linspace(*domain.beta, 17)
    hands = HandBoxes(*(np.array([value]) for value in box))
    gaps = column_gaps(beta, hands, delay, domain, filters)
    low, high, verdict = (part[0] for part in gaps)
    known = (low < high) & (verdict != Verdict.UNDECIDED)
    share = np.sum(
        np.where(known, np.minimum(high, domain.alpha[1]) - np.maximum(low, domain.alpha[0]), 0.0)
    )
    assert share > 0.8 * 16 * np.ptp(domain.alpha)
    assert (verdict[known] == Verdict.STABLE).any()
    column, gap = np.nonzero(known)
    for number in rng.choice(column.size, 24):
        k, n = column[number], gap[number]
        gamma, delta = (
            middle + half * rng.uniform(-1.0, 1.0)
            for middle, half in zip(box[:2], box[2:], strict=True)
        )
        loop = filtered.FilteredLoop(gamma, delta, delay, velocity, position)
        part = rng.choice([1e-6, 1.0 - 1e-6, rng.uniform()])
        wall = low[k, n] + part * (high[k, n] - low[k, n]), rng.uniform(beta[k], beta[k + 1])
        assert loop.code(*wall) == verdict[k, n]


def test_columns_refuse_a_position_filter_that_passes_nothing_at_rest() -> None:
    high_pass = Filter.transfer_function([1.0, -1.0], [1.0, -0.5])
    hands = HandBoxes(*(np.array([value]) for value in (0.1, 0.1, 0.0, 0.0)))
    with pytest.raises(ValueError, match="gain at z = 1 is 0"):
        column_gaps(
            np.array([0.0, 1.0]),
            hands,
            0.0,
            Domain((0.0, 1.0), (0.0, 1.0)),
            (Velocity(), high_pass),
        )


@pytest.mark.campaign
def test_a_curve_of_which_nothing_is_known_is_a_few_patches() -> None:
    """All intervals were halved ten times, and 65,536 patches were in each of the columns."""
    hand = HandBoxes(*(np.array([value]) for value in (40.0, 0.3, 0.05, 0.01)))
    filters, domain = known_filters(Velocity.difference(7), None), ((-60.0, 20.0), (-8.0, 8.0))
    patches = curve_patches(hand, 1.854, Domain(*domain), (0.3, 0.2), filters, 0.146)
    assert patches.box.size < 4000
    np.testing.assert_array_equal(patches.start[1:], patches.end[:-1])  # and none is left out


@pytest.mark.parametrize("half_delay", [0.0, 0.4])
def test_distances_of_patches_from_surfaces_hold_at_every_point(
    half_delay: float, rng: np.random.Generator
) -> None:
    """Models of alpha and beta drawn at random; most points are at the ends of all variables."""
    count, variables = 300, 8 if half_delay else 3
    half = rng.uniform(0.2, 1.0, (3, count))
    if half_delay:
        most = np.full(count, half_delay)
        half = np.stack([*half, most, 0.5 * most**2, *(most * half)])
    alpha, beta = (
        LinearModel(
            rng.normal(size=count),
            rng.normal(size=half.shape) * rng.choice([0.0, 0.1, 1.0], count),
            rng.choice([0.0, 0.1], count),
            half,
        )
        for _ in range(2)
    )
    index = np.arange(count)
    patches = Patches(index, index + 0.0, index + 0.9, alpha, beta, np.zeros(count, bool))
    centre = np.zeros((count, variables))
    centre[:, 0] = beta.centre + rng.normal(size=count)
    of_column = np.concatenate([rng.uniform(0.2, 2.0, (1, count)), half[1:3]])
    if half_delay:
        of_column = np.stack([*of_column, half[3], half[4], *(half_delay * of_column)])
    columns = Columns(centre, of_column.T, 0.5, half_delay)
    middle, slope = rng.normal(size=count), rng.normal(size=(count, variables))
    low, high = distances(patches, columns, Runs(index, index, index, index), middle, slope)

    share = np.where(rng.random((400, 4, count)) < 0.7, rng.choice([-1.0, 1.0], (400, 4, count)),
                     rng.uniform(-1.0, 1.0, (400, 4, count)))  # fmt: skip
    x, t = share[:, :3] * half[:3], share[:, 3:] * half_delay
    terms = [x, t, t**2 - 0.5 * half_delay**2, t * x] if half_delay else [x]
    terms = np.concatenate(terms, axis=1)
    at_alpha, at_beta = (
        m.centre + np.sum(m.slope * terms, axis=1) + m.rest * rng.choice([-1, 1], (400, count))
        for m in (alpha, beta)
    )
    away = at_beta - centre[:, 0]
    of_surface = np.stack([away, x[:, 1], x[:, 2]], axis=1)
    if half_delay:
        square = t**2 - 0.5 * half_delay**2
        of_surface = np.concatenate([of_surface, t, square, t * of_surface], axis=1)
    distance = at_alpha - middle - np.sum(slope.T * of_surface, axis=1)
    is_inside = np.abs(away) <= of_column[0]
    assert is_inside.sum() > 10_000
    assert np.all(((low <= distance) & (distance <= high))[is_inside])
    # Some of the bounds are attained, almost.
    nearest = np.min(np.where(is_inside, np.minimum(distance - low, high - distance), np.inf), 0)
    assert np.sum(nearest < 0.02 * (high - low)) > 30


def test_a_run_follows_the_curve_through_one_column_without_a_gap() -> None:
    """So a run that does not turn holds one root for each beta (lemma B8).

    The curve leaves the domain at its top, and comes back through the same column.
    """
    hands, domain = boxes((0.0, 0.0), (5e-4, 2e-3)), Domain((-0.1, 0.2), (-0.1, 2.1))
    patches = curve_patches(hands, 0.0, domain, (2e-3, 0.5))
    for cells in (1, 12):
        runs = runs_of(patches, np.linspace(*domain.beta, cells + 1))
        follows = np.diff(runs.run) == 0
        one, other = runs.patch[:-1], runs.patch[1:]
        is_next = (np.diff(runs.column) == 0) & (other == one + 1)
        assert np.array_equal(follows, is_next & (patches.start[other] == patches.end[one]))
        assert np.array_equal(runs.start, np.flatnonzero(np.append(True, ~follows)))
        assert np.any(is_next & ~follows) == (cells == 1)


def test_a_gap_that_meets_the_domain_at_one_corner_of_its_column_meets_it(
    rng: np.random.Generator,
) -> None:
    """Strips drawn at random; gaps are between them, below and above."""
    hand = HandBoxes(*(np.array([value]) for value in (0.1, 0.1, 0.05, 0.05)))
    columns, domain = columns_of(np.linspace(0.0, 1.0, 301), hand, 0.0), Domain((-1, 1), (0, 1))
    centre = np.sort(rng.uniform(-1.5, 1.5, (300, 3)), axis=1)
    slope = rng.normal(size=(300, 3, 3)) * rng.choice([0.1, 10.0, 200.0], (300, 1, 1))
    strips = Strips(centre, slope, np.full((300, 3), 0.05), np.zeros((300, 3), bool))
    low, high = strips.ends(columns)
    outer = np.full((*low.shape[:2], 1), np.inf)
    # The first strip is the line of a root at 1, above which the others begin.
    begins = np.concatenate([-outer, np.maximum(high, high[..., :1])], axis=-1)
    ends = np.concatenate([low, outer], axis=-1)
    meets = (begins < ends) & (np.maximum(begins, -1.0) < np.minimum(ends, 1.0))
    assert np.all(_meets(strips, columns, domain) >= meets.any(axis=0))
    assert np.sum(meets.any(axis=0) & ~meets.all(axis=0)) > 50


def test_several_stable_gaps_are_spanned_by_one_flat_limit() -> None:
    """From the strip below the first of them to the one above the last (lemma B8)."""
    hand = HandBoxes(*(np.array([value]) for value in (0.1, 0.1, 0.0, 0.0)))
    columns, domain = columns_of(np.array([0.0, 1.0]), hand, 0.0), Domain((-1, 9), (0, 1))
    centre = np.array([[0.0, 1.0, 2.0, 3.0, 4.0]])
    nothing = np.zeros((1, 5, 3))
    strips = Strips(centre, nothing, np.full((1, 5), 0.25), np.zeros((1, 5), bool))
    stable, unstable = Verdict.STABLE, Verdict.UNSTABLE
    codes = np.array([[unstable, stable, unstable, stable, unstable, unstable]], np.int8)
    for limit in _limits(strips, codes, columns, domain):
        assert limit[0, :-1] == pytest.approx([1.5, *[0.0] * 8])  # from -0.25 to 3.25
        assert limit[0, -1] == pytest.approx(1.75)
