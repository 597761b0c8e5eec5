"""Queries: the table or a computed verdict, for any point; and the same in SI units."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from atlases import small_atlas

import jaxstab
from jaxstab import AtlasSpec, HapticLoop, Velocity, Verdict, build_atlas
from jaxstab.results import Atlas, QueryStatus
from tests.truth import loop as truth

DATA = Path(__file__).resolve().parents[2] / "data"
PLANT = {"gamma": 0.0004, "delta": 0.01, "delay": 1.2}


@pytest.fixture(scope="module")
def atlas(tmp_path_factory: pytest.TempPathFactory) -> Atlas:
    return small_atlas(tmp_path_factory.mktemp("atlas"))


def test_every_point_has_an_answer_that_roots_confirm(
    atlas: Atlas, rng: np.random.Generator
) -> None:
    count = 60
    point = {
        "alpha": rng.uniform(-0.02, 0.3, count),
        "beta": rng.uniform(-0.1, 0.9, count),
        "gamma": rng.uniform(0.0, 0.002, count),  # half of them beyond the nodes
        "delta": rng.uniform(0.0, 0.03, count),
        "delay": rng.uniform(0.0, 3.0, count),
    }
    answer = atlas.query(**point)
    numbers = np.stack(list(point.values()), axis=-1).tolist()
    for own, code in zip(numbers, answer.verdict.tolist(), strict=True):
        radius, _ = truth.spectral_radius(*own)
        assert code == (Verdict.STABLE if radius < 1 else Verdict.UNSTABLE)
    beyond = (point["gamma"] > 0.001) | (point["delta"] > 0.015) | (point["delay"] > 1.5)
    assert (answer.status[beyond] == QueryStatus.COMPUTED).all()
    assert set(answer.status[~beyond].tolist()) >= {QueryStatus.INTERPOLATED}


def test_points_broadcast_and_the_answer_has_their_shape(atlas: Atlas) -> None:
    alpha, beta = np.linspace(-0.01, 0.2, 7), np.linspace(0.0, 0.7, 5)[:, None]
    answer = atlas.query(alpha, beta, **PLANT)
    assert answer.verdict.shape == answer.status.shape == (5, 7)
    assert answer.verdict.dtype == np.int8
    each = [[int(atlas.query(a, b, **PLANT).verdict) for a in alpha] for b in beta[:, 0]]
    np.testing.assert_array_equal(answer.verdict, each)
    assert isinstance(atlas.query(0.05, 0.3, **PLANT).verdict, Verdict)
    assert atlas.query([], 0.3, **PLANT).verdict.shape == (0,)
    assert atlas.query(0.1, 0.3, **PLANT | {"delay": []}).verdict.shape == (0,)


def test_points_on_the_limits_are_computed(atlas: Atlas) -> None:
    limits = atlas.alpha_limits(0.3, **PLANT)
    answer = atlas.query([limits.lower, limits.upper], 0.3, **PLANT)
    assert (answer.status == QueryStatus.COMPUTED).all()
    on_the_line = atlas.query(-PLANT["gamma"], 0.3, **PLANT)
    assert on_the_line.status == QueryStatus.COMPUTED
    assert on_the_line.verdict != Verdict.STABLE


def test_limits_are_those_of_the_region_within_the_error(atlas: Atlas) -> None:
    region = jaxstab.stable_region(**PLANT)
    beta = np.linspace(0.02, 0.5, 9)
    exact, limits = region.alpha_limits(beta), atlas.alpha_limits(beta, **PLANT)
    assert (np.abs(limits.lower - exact[:, 0]) <= 1e-15).all()
    assert (np.abs(limits.upper - exact[:, 1]) <= 2.5 * limits.upper_error).all()
    outside = atlas.alpha_limits([0.3, 9.0, 0.3], gamma=0.0, delta=0.01, delay=[1.0, 1.0, 7.0])
    assert np.isnan(outside.upper).tolist() == [False, True, True]
    assert np.isinf(outside.upper_error).tolist() == [False, True, True]


@pytest.mark.parametrize(
    ("changed", "error"),
    [
        ({"alpha": np.nan}, ValueError),
        ({"delay": np.inf}, ValueError),
        ({"gamma": "a"}, TypeError),
        ({"gamma": -1.0}, ValueError),
        ({"delay": -0.5}, ValueError),
        ({"beta": [0.1, 0.2], "alpha": [0.1, 0.2, 0.3]}, ValueError),
    ],
)
def test_bad_points_are_refused(
    changed: dict[str, object], error: type[Exception], atlas: Atlas
) -> None:
    with pytest.raises(error):
        atlas.query(**({"alpha": 0.05, "beta": 0.3} | PLANT | changed))  # type: ignore[arg-type]


def test_walls_of_a_loop_are_asked_in_si_units(atlas: Atlas) -> None:
    device = {"device_mass": 0.1, "device_damping": 1.0, "hand_mass": 0.05, "hand_stiffness": 40.0}
    loop = HapticLoop(**device, sample_time=1e-3, delay=1.2e-3)
    walls = atlas.for_loop(loop)
    stiffness, damping = np.array([100.0, 6000.0, 40_000.0]), 30.0
    np.testing.assert_array_equal(
        walls.query(stiffness, damping).verdict, loop.verdict(stiffness, damping)
    )
    low, high = walls.stiffness_limits(damping)
    np.testing.assert_allclose([low, high], loop.stiffness_limits(damping), rtol=0.1)
    assert walls.query(stiffness, damping).status[0] == QueryStatus.INTERPOLATED
    with pytest.raises(ValueError, match="stiffness is nan"):
        walls.query(np.nan, 30.0)


def test_a_loop_outside_of_the_atlas_is_computed_and_another_estimator_is_refused(
    atlas: Atlas,
) -> None:
    device = {"device_mass": 0.1, "device_damping": 100.0, "sample_time": 1e-3}
    far = HapticLoop(**device, delay=5e-3)
    answer = atlas.for_loop(far).query(1000.0, 30.0)
    assert (answer.status, answer.verdict) == (QueryStatus.COMPUTED, far.verdict(1000.0, 30.0))
    with pytest.raises(
        ValueError, match="but this atlas was built for velocity: the difference ov"
    ):
        atlas.for_loop(HapticLoop(**device, velocity=Velocity.difference(samples=5)))
    with pytest.raises(TypeError, match=r"give a jaxstab\.HapticLoop"):
        atlas.for_loop("omega")


def test_an_atlas_of_an_estimator_answers_for_its_loops(rng: np.random.Generator) -> None:
    atlas = jaxstab.open_atlas(DATA / "golden" / "atlas-v5-window.h5")
    window = Velocity.difference(window=0.005)
    loop = HapticLoop(
        device_mass=0.2, device_damping=2.0, sample_time=1e-3, delay=1.1e-3, velocity=window
    )
    walls = atlas.for_loop(loop)
    stiffness, damping = rng.uniform(-100, 12_000, 300), rng.uniform(-5, 60, 300)
    answer = walls.query(stiffness, damping)
    np.testing.assert_array_equal(answer.verdict, loop.verdict(stiffness, damping))
    assert np.mean(answer.status == QueryStatus.INTERPOLATED) > 0.5


def test_one_delay_and_one_hand_are_an_atlas_too(tmp_path: Path) -> None:
    spec = AtlasSpec(gamma=[0.0], delta=[0.015], delay=[1.0])
    atlas = build_atlas(spec, tmp_path / "one.h5")
    answer = atlas.query([0.05, 0.3], 0.3, gamma=0.0, delta=0.015, delay=1.0)
    assert answer.verdict.tolist() == [Verdict.STABLE, Verdict.UNSTABLE]
    assert answer.status.tolist() == [QueryStatus.INTERPOLATED] * 2
    assert atlas.query(0.05, 0.3, gamma=1e-9, delta=0.015, delay=1.0).status == QueryStatus.COMPUTED


def test_threads_that_ask_one_atlas_agree(atlas: Atlas, rng: np.random.Generator) -> None:
    asked = [
        {
            "alpha": rng.uniform(0.01, 0.3, 200),
            "beta": rng.uniform(0.1, 0.6, 200),
            "gamma": rng.uniform(0.0, 0.001, 200),
            "delta": rng.uniform(0.0, 0.015, 200),
            "delay": rng.uniform(0.0, 1.5, 200),
        }
        for _ in range(16)
    ]
    alone = [atlas.query(**some) for some in asked]
    with ThreadPoolExecutor(8) as pool:
        together = list(pool.map(lambda some: atlas.query(**some), asked))
    for one, other in zip(alone, together, strict=True):
        np.testing.assert_array_equal(one.verdict, other.verdict)
        np.testing.assert_array_equal(one.status, other.status)
