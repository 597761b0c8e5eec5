"""Dense slices, whose rows are cut where they meet the boundary, against certified roots."""

from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest
from campaign import first
from mpmath import mp

from benchmarks.hard_loops import points_near_the_boundary, random_plants
from jaxstab import Verdict, verdict
from jaxstab.exact import rows
from jaxstab.rounding import UNIT
from tests.truth import loop as truth
from tests.truth.balls import ExactPlant

LENGTH = 1500  # of rows and of columns: enough for rows to pay
HAPTIC = {"gamma": 1e-3, "delta": 0.015}
SIZES = {0.5: (0.8, 1.0), 1.0: (0.6, 0.8), 5.0: (0.04, 0.2), 20.0: (0.003, 0.05)}  # alpha, beta


def is_right(
    code: int, plant: ExactPlant, wall: tuple[float, float], gamma: float, delay: float
) -> bool:
    return code in (Verdict.UNDECIDED, plant.code(*wall, gamma, delay))


def spread(rng: np.random.Generator, near: np.ndarray) -> np.ndarray:
    """So many gains, of the size of some and of all sizes below, with these, in any order."""
    size, count = np.median(np.abs(near)), LENGTH - near.size
    even = rng.uniform(-0.2, 2.0, count) * size
    small = 10.0 ** rng.uniform(-6.0, 1.0, count) * size
    return rng.permutation(np.concatenate([near, np.where(rng.random(count) < 0.5, even, small)]))


@pytest.mark.parametrize("delay", first((0.0, 1.0, 5.0, 2.75, 0.25, 1.5, 8.0, 20.0, 33.0), 4))
def test_no_verdict_of_a_dense_slice_is_wrong_however_close_to_the_boundary(
    delay: float, rng: np.random.Generator
) -> None:
    for gamma, delta in [(0.0, 0.0), *random_plants(rng, 2)]:
        near = points_near_the_boundary(rng, gamma, delta, delay, 40)
        is_finite = np.all(np.isfinite(near), axis=0)
        near_alpha, near_beta = (gains[is_finite] for gains in near)
        alpha = spread(rng, np.append(near_alpha, [-gamma, 0.0]))
        beta = np.sort(spread(rng, np.append(near_beta, [near_beta[0], 0.0])))
        codes = verdict(alpha[:, None], beta, gamma=gamma, delta=delta, delay=delay)
        changes = np.argwhere(codes[:, 1:] != codes[:, :-1])
        row, column = rng.choice(changes, 10).T
        walls = [
            *zip(near_alpha, near_beta, strict=True),
            *zip(alpha[row], beta[column], strict=True),
            *zip(alpha[row], beta[column + 1], strict=True),
            *zip(rng.choice(alpha, 10), rng.choice(beta, 10), strict=True),
        ]
        plant, by_alpha = ExactPlant.of(gamma, delta, delay), np.argsort(alpha)
        for wall in walls:
            index = by_alpha[np.searchsorted(alpha[by_alpha], wall[0])]
            code = codes[index, np.searchsorted(beta, wall[1])]
            assert is_right(code, plant, wall, gamma, delay), (wall, gamma, delta, delay)


def test_all_walls_of_a_slice_that_is_known_are_right() -> None:
    # 0 < alpha < 2 beta (2 - beta) / (beta + 2), 0 < beta < 2; rows touch its top, too.
    beta = np.linspace(-0.1, 2.1, LENGTH)
    top = 12.0 - 8.0 * np.sqrt(2.0)
    touching = top * (1.0 + np.array([-1e-6, -1e-9, -1e-12, -(2.0**-52), 0.0, 2.0**-52, 1e-12]))
    alpha = np.concatenate([np.linspace(-0.1, 0.8, LENGTH - touching.size), touching])[:, None]
    codes = verdict(alpha, beta, gamma=0.0, delta=0.0, delay=0.0)
    limit = 2.0 * beta * (2.0 - beta) / (beta + 2.0)
    is_stable = (alpha > 0.0) & (alpha < limit)
    is_close = np.abs(alpha - limit) < 1e-14
    assert np.all((codes == Verdict.STABLE) == is_stable, where=~is_close)
    assert not np.any(codes == Verdict.UNDECIDED, where=~is_close)
    for i, j in np.argwhere(is_close):
        a, b = Fraction(alpha[i, 0]), Fraction(beta[j])
        margin = 2 * b * (2 - b) - a * (b + 2)
        true = Verdict.STABLE if margin > 0 else Verdict.UNSTABLE
        assert codes[i, j] in ((true, Verdict.UNDECIDED) if margin else (Verdict.UNDECIDED,))


@pytest.mark.parametrize("delay", first((1.0, 5.0, 0.5, 20.0), 2))
def test_rows_that_touch_the_boundary_are_right(delay: float) -> None:
    def gains(theta: mp.mpf) -> tuple[mp.mpf, mp.mpf]:
        return truth.boundary_point(theta, delay=delay, **HAPTIC)

    with mp.workdps(40):
        top = mp.findroot(
            lambda t: gains(t + mp.mpf(10) ** -12)[0] - gains(t - mp.mpf(10) ** -12)[0],
            0.75 / (delay + 1.0),
        )
        touching, column = map(float, gains(top))
    distance = 10.0 ** np.arange(-16.0, -4.0)
    alpha = touching * (1.0 + np.concatenate([-distance, [0.0], distance]))
    beta = np.sort(column * (1.0 + np.concatenate([np.linspace(-1, 1, LENGTH), 1e-3 * distance])))
    fill = np.linspace(0.0, 2.0 * touching, LENGTH)
    codes = verdict(np.append(alpha, fill)[:, None], beta, **HAPTIC, delay=delay)
    plant, middle = ExactPlant.of(**HAPTIC, delay=delay), np.searchsorted(beta, column)
    for wall, own in zip(alpha, codes, strict=False):
        for j in (0, *range(middle - 8, middle + 8), LENGTH):
            assert is_right(own[j], plant, (wall, beta[j]), HAPTIC["gamma"], delay)


def slice_of(delay: float) -> tuple[np.ndarray, np.ndarray]:
    alpha, beta = (np.linspace(-0.1 * size, 2.0 * size, LENGTH) for size in SIZES[delay])
    return alpha[:, None], beta


@pytest.mark.parametrize("delay", SIZES)
def test_few_walls_of_a_dense_slice_are_asked(delay: float) -> None:
    alpha, beta = slice_of(delay)
    asked = []

    def codes_of(*walls: np.ndarray) -> np.ndarray:
        asked.append(walls[0].size)
        return verdict(*walls, **HAPTIC, delay=delay)

    plant = tuple(map(np.asarray, (*HAPTIC.values(), delay)))
    codes = rows.row_codes((alpha, beta, *plant), codes_of)
    assert codes is not None
    assert sum(asked) < 0.01 * codes.size
    assert 0.01 < np.mean(codes == Verdict.STABLE) < 0.9


@pytest.mark.parametrize(
    "change",
    [
        lambda a, b: (a, b[::-1]),
        lambda a, b: (a.T, b[:, None]),
        lambda a, b: (a[:, :1] + 0.0 * b, b),
    ],
    ids=["falling", "columns", "meshed"],
)
def test_other_grids_are_left_to_single_walls(
    change: Callable[..., tuple[np.ndarray, np.ndarray]],
) -> None:
    alpha, beta = slice_of(1.0)
    plant = tuple(map(np.asarray, (*HAPTIC.values(), 1.0)))
    assert rows.row_codes((*change(alpha, beta), *plant), pytest.fail) is None


@pytest.mark.parametrize(("dtype", "shape"), [(np.float32, ()), (np.float64, (1, 1))])
def test_a_dense_slice_is_an_array_of_its_own(dtype: type, shape: tuple[int, ...]) -> None:
    alpha, beta = (gains.astype(dtype) for gains in slice_of(1.0))
    plant = {name: np.full(shape, value) for name, value in HAPTIC.items()}
    codes = verdict(alpha, beta, **plant, delay=1)
    assert codes.shape == (LENGTH, LENGTH)
    assert codes.dtype == np.int8
    assert codes.flags.writeable
    falling = verdict(alpha, beta[::-1], **plant, delay=1)[:, ::-1]
    assert np.array_equal(codes, falling)
    alpha[3] = np.nan
    with pytest.raises(ValueError, match="alpha"):
        verdict(alpha, beta, **plant, delay=1)


def test_bounds_of_the_curve_hold_its_exact_values(rng: np.random.Generator) -> None:
    """At a place of float64, and at those that this may stand for."""
    for order in (1, 5, 40):
        cosines = rng.uniform(-1.0, 1.0, (3, order + 1))
        cosines[2, 0] = 2.0 + np.sum(np.abs(cosines[2]))
        x = np.concatenate([2.0 * np.cos(rng.uniform(0.0, np.pi, 20)), [-2.0, 2.0]])
        low, high = rows._values(cosines, x)
        assert np.all(high - low < 1e-11)
        for place, *bounds in zip(x, low.T, high.T, strict=True):
            for near in (0, -1, 1):
                exact = Fraction(place) + 4 * near * Fraction(UNIT)
                a, b, m = (value_of(row, min(max(exact, -2), 2)) for row in cosines)
                for k, value in enumerate((a / m, b / m)):
                    assert bounds[0][k] <= value <= bounds[1][k]


def value_of(cosines: np.ndarray, x: Fraction) -> Fraction:
    """A cosine sum at x = 2 cos(theta), in fractions."""
    total, cosine, following = Fraction(0), Fraction(1), x / 2
    for c in cosines:
        total += Fraction(c) * cosine
        cosine, following = following, x * following - cosine
    return total


@pytest.mark.campaign
@pytest.mark.parametrize("delay", [1.0, 5.0, 20.0])
def test_the_verdicts_of_16_million_walls_are_those_of_single_walls(delay: float) -> None:
    length = 4000
    alpha, beta = (np.linspace(-0.1 * size, 2.0 * size, length) for size in SIZES[delay])
    codes = verdict(alpha[:, None], beta, **HAPTIC, delay=delay)
    single = verdict(alpha[:, None], beta[::-1], **HAPTIC, delay=delay)[:, ::-1]
    assert np.array_equal(codes, single)
