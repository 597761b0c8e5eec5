"""Studies: each answer that of its own loop, draws that repeat, shares, parts, resuming, words."""

import csv
import errno
import json
import os
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray
from campaign import many
from commands import START, assert_one_sentence, run

import jaxstab
from jaxstab import HapticLoop, LogNormal, Measured, Normal, Uniform, Verdict
from jaxstab.pictures.study import study_figure
from jaxstab.results import RegionStatus, Study
from jaxstab.scene import Scene, loop_of
from jaxstab.scene import study as studies
from jaxstab.scene.draws import distribution_of, draws_of
from jaxstab.tiles import processes

LOOP = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3, delay=1e-3)
WALLS = {"soft": (1000.0, 10.0), "stiff": (30000.0, 30.0)}
TABLE: dict[str, Any] = {
    "device": {"mass": 0.25, "damping": 0.1},
    "hand": {"mass": 0.1, "stiffness": 200.0, "damping": 3.0},
    "controller": {"sample_time": 1e-3, "delay": 1e-3, "velocity": {"window_samples": 5}},
    "walls": {
        "soft": {"stiffness": 1000.0, "damping": 10.0},
        "stiff": {"stiffness": 12000.0, "damping": 40.0},
    },
}
MODE = {"frequency": 90.0, "damping_ratio": 0.02, "modal_mass": 0.3}
OVER: dict[str, Any] = {
    "controller.velocity.window_samples": [1, 5],
    "controller.delay": (0.0, 1.5e-3, 2),
    "hand.stiffness": Normal(300.0, 100.0),
    "hand.damping": Uniform(1.0, 5.0),
}
EVERYTHING = tuple(studies.ANSWERS)


def small(path: Path | None = None, **options: Any) -> Study:
    """A study of 240 verdicts; blocks of 20 where ``small_blocks`` is used."""
    over = {"device.mass": [0.1, 0.3], "hand.stiffness": Normal(300.0, 100.0)}
    given = {"answers": ["verdict"], "samples": 60, "store": path}
    return jaxstab.study(TABLE, over, **{**given, **options})


@pytest.fixture
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(studies, "_BLOCK", 20)


@pytest.mark.parametrize("modes", [[], [MODE]])
def test_every_answer_is_that_of_its_own_loop(modes: list[dict[str, float]]) -> None:
    table = {**TABLE, "device": {**TABLE["device"], "modes": modes}} if modes else TABLE
    study = jaxstab.study(table, OVER, answers=EVERYTHING, samples=3, seed=4).open()
    assert study.verdict.dims[-2:] == ("sample", "wall")
    for window in (1, 5):
        for delay in (0.0, 1.5e-3):
            for draw in range(3):
                row = study.sel(
                    controller_velocity_window_samples=window, controller_delay=delay, sample=draw
                )
                values = {
                    "controller.delay": delay,
                    "controller.velocity": {"window_samples": window},
                    "hand.stiffness": row.hand_stiffness.item(),
                    "hand.damping": row.hand_damping.item(),
                }
                assert_row_is_of(row, loop_with(table, values))


def loop_with(table: dict[str, Any], values: dict[str, Any]) -> HapticLoop:
    """The loop of a scene with values in place of its own, by "section.key"."""
    own = {section: {**keys} for section, keys in table.items()}
    for name, value in values.items():
        section, key = name.split(".")
        own[section][key] = value
    return loop_of(Scene.from_table(own))


def assert_row_is_of(row: xarray.Dataset, loop: HapticLoop) -> None:
    gains = row.wall_stiffness.values, row.wall_damping.values
    np.testing.assert_array_equal(row.verdict, loop.verdict(*gains))
    limits = loop.limits()
    assert row.limits_status == limits.status
    np.testing.assert_allclose(row.largest_stiffness, limits.stiffness, rtol=1e-9)
    np.testing.assert_allclose(row.largest_damping, limits.damping, rtol=1e-9)
    np.testing.assert_allclose(row.at_damping, limits.at_damping, rtol=1e-5)
    np.testing.assert_allclose(row.at_stiffness, limits.at_stiffness, rtol=1e-5)
    radius, settling = loop.spectral_radius(*gains), loop.settling_time(*gains)
    np.testing.assert_allclose(row.spectral_radius, radius.value, rtol=1e-12)
    np.testing.assert_allclose(row.settling_time, settling.value, rtol=1e-12)
    np.testing.assert_array_equal(row.settling_status, settling.status)
    margins = loop.margins(*gains)
    for name in ("stiffness_gain", "damping_gain", "extra_delay"):
        np.testing.assert_allclose(row[name], getattr(margins, name), rtol=1e-8)


def test_a_loop_varies_by_its_fields_and_estimators() -> None:
    over = {"device_mass": [0.1, 0.2], "delay_samples": [0.0, 2.0], "sample_time": [1e-3, 5e-4]}
    study = jaxstab.study(LOOP, over, walls=WALLS).open()
    for mass in (0.1, 0.2):
        for period in (1e-3, 5e-4):
            own = HapticLoop(
                device_mass=mass, device_damping=1.5, sample_time=period, delay=2.0 * period
            )
            row = study.sel(device_mass=mass, delay_samples=2.0, sample_time=period)
            np.testing.assert_allclose(row.largest_stiffness, own.limits().stiffness, rtol=1e-9)
            np.testing.assert_array_equal(
                row.verdict, own.verdict(*np.transpose([*WALLS.values()]))
            )


def test_the_delay_of_a_loop_varies_in_one_unit() -> None:
    with pytest.raises(ValueError, match="delay is given beside delay_samples; give one"):
        jaxstab.study(LOOP, {"delay": [0.0, 1e-3], "delay_samples": [1.0]})


def test_an_answer_that_is_wanted_twice_is_given_once() -> None:
    study = jaxstab.study(LOOP, {"delay": [0.0, 1e-3]}, answers=["limits", "limits"])
    assert list(study.dimensions) == ["delay"]


def test_a_table_has_named_dimensions_units_codes_and_what_it_is_of() -> None:
    opened = small().open()
    assert dict(opened.sizes) == {"device_mass": 2, "sample": 60, "wall": 2}
    assert opened.device_mass.attrs == {"long_name": "mass of the device", "units": "kg"}
    assert opened.hand_stiffness.dims == ("sample",)
    assert opened.hand_stiffness.attrs["units"] == "N/m"
    assert opened.wall.values.tolist() == ["soft", "stiff"]
    assert opened.wall_stiffness.values.tolist() == [1000.0, 12000.0]
    words = dict(zip(opened.verdict.flag_values, opened.verdict.flag_meanings.split(), strict=True))
    assert words == {verdict.value: verdict.name.lower() for verdict in Verdict}
    assert json.loads(opened.attrs["over"])["hand.stiffness"] == str(Normal(300.0, 100.0))
    assert "'mass': 0.25" in opened.attrs["of"]
    assert opened.attrs["seed"] == "0"


def test_a_device_that_turns_has_its_own_units() -> None:
    table = {
        "device": {"inertia": 2e-3, "damping": 1e-3},
        "controller": {"sample_time": 1e-3},
    }
    study = jaxstab.study(table, {"device.inertia": [1e-3, 2e-3]})
    assert study.units["device_inertia"] == "kg m^2"
    assert study.units["largest_stiffness"] == "N m/rad"


# Draws.


def test_draws_depend_on_seed_and_name_alone() -> None:
    first = small(seed=1).values("hand_stiffness")
    np.testing.assert_array_equal(first, small(seed=1, samples=90).values("hand_stiffness")[:60])
    over = {"hand.damping": Uniform(1.0, 5.0), "hand.stiffness": Normal(300.0, 100.0)}
    other = jaxstab.study(TABLE, over, answers=["verdict"], samples=60, seed=1)
    np.testing.assert_array_equal(first, other.values("hand_stiffness"))
    assert (first != small(seed=2).values("hand_stiffness")).all()
    assert np.corrcoef(first, other.values("hand_damping"))[0, 1] < 0.5


@pytest.mark.parametrize(
    ("distribution", "quantiles"),
    [
        (Normal(300.0, 100.0), (200.0, 300.0, 400.0)),
        (Uniform(2.0, 6.0), (2.6346, 4.0, 5.3654)),
        (LogNormal(300.0, 1.5), (200.0, 300.0, 450.0)),
    ],
)
def test_distributions_have_the_quantiles_of_their_formulas(
    distribution: Any, quantiles: tuple[float, ...]
) -> None:
    draws, again = draws_of("x", distribution, 200_000, 3)
    found = np.quantile(draws, (0.158655, 0.5, 0.841345))
    np.testing.assert_allclose(found, quantiles, rtol=0.01)
    assert again == 0


def test_a_normal_distribution_is_cut_at_what_the_scene_allows_and_says_so(tmp_path: Path) -> None:
    draws, again = draws_of("hand.stiffness", Normal(100.0, 100.0), 100_000, 0, 0.0)
    assert draws.min() >= 0.0
    assert again / 1e5 == pytest.approx(0.1587, abs=0.005)
    scene = tmp_path / "desk.toml"
    scene.write_text("[device]\nmass = 0.1\ndamping = 1.5\n[controller]\nsample_time = 0.001\n")
    over = "hand.stiffness=normal:100:100"
    result = run("study", scene, "--over", over, "--samples", 500, "-o", tmp_path / "a.h5")
    assert "% of the draws were below 0 and drawn again" in result.stderr


def test_ranges_of_a_scene_are_drawn_uniformly_and_it_says_so(tmp_path: Path) -> None:
    table = {
        **TABLE,
        "device": {"mass": [0.1, 0.3], "damping": 0.1},
        "hand": {"mass": [0.2, 0.2], "stiffness": [100.0, 500.0], "damping": 3.0},
    }
    over = {"controller.delay": [0.0, 1e-3]}
    given = {"answers": ["verdict"], "samples": 9}
    study = jaxstab.study(table, over, store=tmp_path / "a.h5", **given)
    assert study.open().attrs["notes"] == (
        "device.mass: drawn uniformly from the range of the scene, 0.1 to 0.3.\n"
        "hand.stiffness: drawn uniformly from the range of the scene, 100 to 500."
    )
    assert set(study.dimensions) == {"controller_delay", "sample", "wall"}
    ranges = {"device.mass": Uniform(0.1, 0.3), "hand.stiffness": Uniform(100.0, 500.0)}
    same = jaxstab.study({**table, "hand": {**table["hand"], "mass": 0.2}}, over | ranges, **given)
    for name in ("device_mass", "hand_stiffness", "verdict"):
        np.testing.assert_array_equal(same.values(name), study.values(name))
    with pytest.raises(ValueError, match=r"hand\.stiffness is \[5.0, 1.0\]; its ends are swapped"):
        jaxstab.study({**table, "hand": {"stiffness": [5.0, 1.0]}}, over, **given)


def test_columns_of_one_file_are_drawn_row_by_row(tmp_path: Path) -> None:
    file = tmp_path / "hands.csv"
    file.write_text("name,k,b\na,100,1\nb,200,2\nc,400,4\n", encoding="utf-8")
    over = {
        "hand.stiffness": distribution_of(f"csv:{file}:k"),
        "hand.damping": distribution_of(f"csv:{file}:b"),
    }
    study = jaxstab.study(TABLE, over, answers=["verdict"], samples=50)
    np.testing.assert_array_equal(
        study.values("hand_stiffness"), 100.0 * study.values("hand_damping")
    )
    assert set(study.values("hand_damping")) == {1.0, 2.0, 4.0}


def test_a_row_that_is_drawn_again_is_computed_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    over = {
        "device.mass": [0.1, 0.3],
        "hand.stiffness": Measured((100.0, 200.0, 400.0), "hands"),
        "hand.damping": Measured((1.0, 5.0, 2.0), "hands"),
    }
    real, counts = studies.limits_of, list[int]()

    def counted(loops: Any) -> Any:
        counts.append(len(loops))
        return real(loops)

    monkeypatch.setattr(studies, "limits_of", counted)
    study = jaxstab.study(TABLE, over, samples=90).open()
    assert counts == [6]
    for draw in (0, 7, 89):
        row = study.isel(device_mass=1, sample=draw)
        hand = {"mass": 0.1, "stiffness": row.hand_stiffness.item()}
        own = loop_with(
            {**TABLE, "hand": hand},
            {"device.mass": 0.3, "hand.damping": row.hand_damping.item()},
        )
        np.testing.assert_allclose(row.largest_stiffness, own.limits().stiffness, rtol=1e-9)
        gains = row.wall_stiffness.values, row.wall_damping.values
        np.testing.assert_array_equal(row.verdict, own.verdict(*gains))
    plan = studies.plan_of(studies.study_dataset(TABLE, over, tmp_path / "a.h5", samples=90))
    assert "180 loops (of 3 different draws, each computed once in a block)" in plan


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a,k\n1,2\n", "hands.csv has no column 'b'; its columns are 'a, k'"),
        ("a,b\n1,2\n1,x\n", "hands.csv, line 3: b is 'x'; give a finite number"),
        ("a,b\n1\n", "hands.csv, line 2: b is None; give a finite number"),
        ("a,b\n", "measured values are missing or not finite"),
        ("a,b\n1,nan\n", "hands.csv, line 2: b is 'nan'; give a finite number"),
    ],
)
def test_a_file_that_is_no_column_of_numbers_is_refused(
    text: str, words: str, tmp_path: Path
) -> None:
    (tmp_path / "hands.csv").write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=words):
        distribution_of(f"csv:{tmp_path / 'hands.csv'}:b")


# Shares and quantiles.


def test_shares_count_the_verdicts() -> None:
    study = small(samples=500)
    shares = study.shares()
    codes = study.values("verdict")
    np.testing.assert_array_equal(shares.share, (codes == Verdict.STABLE).mean(axis=1))
    np.testing.assert_array_equal(shares.undecided, (codes == Verdict.UNDECIDED).sum(axis=1))
    assert (shares.draws, shares.confidence) == (500, 0.95)
    wider = study.shares(confidence=0.999)
    assert (wider.low <= shares.low).all()
    assert (shares.high <= wider.high).all()


def test_undecided_draws_widen_the_interval_on_both_sides(monkeypatch: pytest.MonkeyPatch) -> None:
    def third_undecided(alpha: Any, beta: Any, **loop: Any) -> Any:
        codes = np.full(
            np.broadcast_shapes(np.shape(alpha), np.shape(loop["gamma"])), np.int8(Verdict.STABLE)
        )
        codes[::3] = Verdict.UNDECIDED
        return codes

    monkeypatch.setattr(jaxstab.point, "verdict", third_undecided)
    over = {"hand.stiffness": Normal(300.0, 100.0)}
    shares = jaxstab.study(TABLE, over, answers=["verdict"], samples=300).shares()
    assert shares.undecided.tolist() == [100, 100]
    np.testing.assert_allclose(shares.share, 2.0 / 3.0)
    assert (shares.low < 2.0 / 3.0 - 0.05).all()
    np.testing.assert_array_equal(shares.high, 1.0)


def test_intervals_cover_the_share_among_all_hands_in_95_of_100_small_studies() -> None:
    over = {"device.mass": Uniform(0.1, 0.3), "hand.stiffness": LogNormal(300.0, 1.4)}
    walls = {"x": (12000.0, 40.0)}
    study = jaxstab.study(TABLE, over, answers=["verdict"], walls=walls, samples=200_000)
    codes = study.values("verdict")[:, 0] == Verdict.STABLE
    truth = codes.mean()
    assert 0.1 < truth < 0.9
    counts = codes.reshape(1000, 200).sum(axis=1)
    low, high = studies._score_interval(counts, 200, 0.95)
    covered = ((low <= truth) & (truth <= high)).mean()
    assert 0.93 <= covered <= 0.97


def test_quantiles_are_those_of_the_draws_and_nothing_stable_counts_as_0() -> None:
    over = {"device.mass": Uniform(0.1, 0.3), "controller.delay_samples": [1.0, 3.0]}
    study = jaxstab.study(TABLE, over, answers=["limits"], samples=40)
    values = np.sort(study.values("largest_stiffness"), axis=1)
    np.testing.assert_array_equal(study.quantiles(at=[0.0, 0.5, 1.0]), values[:, [0, 19, 39]].T)
    assert "wall" not in study.dimensions


def test_where_no_wall_is_stable_the_largest_stiffness_counts_as_0(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    real = studies.limits_of

    def first_empty(*given: Any, **fields: Any) -> Any:
        limits = real(*given, **fields)
        limits.stiffness[0], limits.status[0] = np.nan, RegionStatus.EMPTY
        return limits

    monkeypatch.setattr(studies, "limits_of", first_empty)
    study = jaxstab.study(TABLE, {"device.mass": Uniform(0.1, 0.3)}, answers=["limits"], samples=9)
    assert study.quantiles(at=[0.0]) == [0.0]


# The file: any division of the work gives the same.


def test_it_continues_after_ctrl_c_and_costs_nothing_when_done(
    tmp_path: Path, small_blocks: None
) -> None:
    def stop(done: int, _: int) -> None:
        if done == 4:
            raise KeyboardInterrupt

    whole = small(tmp_path / "whole.h5")
    with pytest.raises(KeyboardInterrupt):
        small(tmp_path / "a.h5", progress=stop)
    told: list[int] = []
    again = small(tmp_path / "a.h5", progress=lambda done, _: told.append(done))
    assert told == [*range(4, 13)]
    assert again.path.read_bytes() == whole.path.read_bytes()
    told.clear()
    small(tmp_path / "a.h5", progress=lambda done, _: told.append(done))
    assert told == [12]


def test_parts_put_together_are_the_whole(tmp_path: Path, small_blocks: None) -> None:
    whole = small(tmp_path / "whole.h5").open()
    parts = [tmp_path / f"{k}.h5" for k in (1, 2, 3)]
    for number, path in enumerate(parts, 1):
        part = small(path, part=(number, 3))
        assert (part.values("verdict") != Verdict.NOT_COMPUTED).sum() == 80
    for question in (Study.shares, Study.quantiles):
        with pytest.raises(
            ValueError, match=r"1\.h5 is a part of a study; merge all parts first\."
        ):
            question(jaxstab.open_study(parts[0]))
    made = jaxstab.merge_studies(parts[::-1], tmp_path / "made.h5")
    assert made.open().identical(whole)
    told: list[int] = []
    small(made.path, progress=lambda done, _: told.append(done))
    assert told == [12]


def test_loops_of_other_parts_have_the_status_not_computed(
    tmp_path: Path, small_blocks: None
) -> None:
    part = small(tmp_path / "1.h5", part=(1, 3), answers=["limits"]).open().limits_status
    words = dict(zip(part.flag_values, part.flag_meanings.split(), strict=True))
    statuses = [words[code] for code in part.values.ravel()]
    assert {one: statuses.count(one) for one in words.values() if one in statuses} == {
        "not_computed": 80,
        "complete": 40,
    }


def test_parts_that_do_not_go_together_are_refused(tmp_path: Path, small_blocks: None) -> None:
    one, two, other, whole = (tmp_path / f"{name}.h5" for name in ("one", "two", "other", "whole"))
    small(one, part=(1, 3))
    small(two, part=(2, 3))
    small(other, part=(3, 3), seed=5)
    small(whole)
    (tmp_path / "text.h5").write_text("no part")
    for parts, words in (
        ([one, tmp_path / "text.h5"], r"text\.h5 is not an HDF5 file, or is damaged"),
        ([one, two], "part 3 of 3 is missing"),
        ([one, two, one], r"one\.h5 and .*one\.h5 are the same part"),
        ([one, two, other], r"other\.h5 and .*one\.h5 are parts of different studies"),
        ([one, two, whole], r"whole\.h5 is no part of a study"),
        ([], "no part is given"),
    ):
        with pytest.raises(ValueError, match=words):
            jaxstab.merge_studies(parts, tmp_path / "made.h5")
        assert not (tmp_path / "made.h5").exists()
    with pytest.raises(FileNotFoundError, match=r"cannot read .*none\.h5: No such file"):
        jaxstab.merge_studies([one, tmp_path / "none.h5"], tmp_path / "made.h5")
    with pytest.raises(FileExistsError, match=r"whole\.h5 exists; remove it"):
        jaxstab.merge_studies([one, two], whole)


def test_a_file_of_another_study_is_left_alone(tmp_path: Path) -> None:
    small(tmp_path / "a.h5")
    before = (tmp_path / "a.h5").read_bytes()
    for other in ({"seed": 1}, {"answers": ["spectral_radius"]}, {"walls": {"x": (1.0, 1.0)}}):
        with pytest.raises(FileExistsError, match=r"a\.h5 exists, and holds something else"):
            small(tmp_path / "a.h5", **other)
    assert (tmp_path / "a.h5").read_bytes() == before


@pytest.mark.campaign
def test_random_studies_have_the_answers_of_single_loops() -> None:
    rng = np.random.default_rng(35)
    for _ in range(many(20, 1)):
        table = random_table(rng)
        over = {
            "device.mass": LogNormal(table["device"]["mass"], 2.0),
            "hand.stiffness": Uniform(0.0, 2000.0),
            "controller.delay_samples": [0.0, float(rng.integers(1, 12)), rng.uniform(0.0, 6.0)],
        }
        walls = {"a": (10 ** rng.uniform(2, 4.5), 10 ** rng.uniform(0, 2)), "b": (500.0, 5.0)}
        study = jaxstab.study(table, over, walls=walls, samples=170, seed=int(rng.integers(1000)))
        opened = study.open()
        for delay in range(3):
            for draw in range(170):
                row = opened.isel(controller_delay_samples=delay, sample=draw)
                values = {
                    "device.mass": row.device_mass.item(),
                    "hand.stiffness": row.hand_stiffness.item(),
                    "controller.delay_samples": row.controller_delay_samples.item(),
                }
                loop = loop_with(table, values)
                gains = row.wall_stiffness.values, row.wall_damping.values
                np.testing.assert_array_equal(row.verdict, loop.verdict(*gains))
                limits = loop.limits()
                assert row.limits_status == limits.status
                np.testing.assert_allclose(row.largest_stiffness, limits.stiffness, rtol=1e-9)
                np.testing.assert_allclose(row.largest_damping, limits.damping, rtol=1e-9)


def random_table(rng: np.random.Generator) -> dict[str, Any]:
    velocities = (
        {"window_samples": int(rng.integers(1, 21))},
        {"cutoff": 10 ** rng.uniform(1.3, 2.4)},
        {"window": 0.002 * int(rng.integers(1, 11))},
    )
    return {
        "device": {"mass": 10 ** rng.uniform(-1.3, 0.0), "damping": 10 ** rng.uniform(-3, 0.5)},
        "hand": {"damping": rng.uniform(0.0, 8.0)},
        "controller": {
            "sample_time": float(rng.choice([1e-3, 5e-4, 2e-3])),
            "velocity": velocities[rng.integers(3)],
        },
    }


@pytest.mark.campaign
def test_processes_and_dask_workers_make_the_same_file(tmp_path: Path) -> None:
    from distributed import Client, LocalCluster

    whole = small(tmp_path / "whole.h5", samples=20_000)
    with processes(2) as executor:
        two = small(tmp_path / "two.h5", samples=20_000, executor=executor)
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        dask = small(tmp_path / "dask.h5", samples=20_000, executor=client.get_executor())
    assert two.path.read_bytes() == dask.path.read_bytes() == whole.path.read_bytes()


@pytest.mark.campaign
def test_a_study_that_is_killed_again_and_again_equals_an_uninterrupted_one(
    tmp_path: Path,
) -> None:
    scene, samples = tmp_path / "desk.toml", many(330_000, 66_000)
    scene.write_text("[device]\nmass = 0.1\ndamping = 1.5\n[controller]\nsample_time = 0.001\n")
    varied = ["--over", "hand.stiffness=lognormal:300:1.5", "--samples", str(samples)]
    wall = ["--answer", "spectral_radius", "--wall", "a", "9000", "20"]
    command = ["study", str(scene), *varied, *wall]
    start = [sys.executable, "-c", START, *command, "-o"]
    rng = np.random.default_rng(50)

    def done() -> int:
        return len([*tmp_path.glob(".a.h5.*.tiles/*.tile")])

    for number in range(many(50, 4)):
        before, most = done(), rng.uniform(0.0, 1.5)  # s: every second one at any time
        process = subprocess.Popen(
            [*start, str(tmp_path / "a.h5")], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        began = time.monotonic()
        while done() <= before and (number % 2 == 0 or time.monotonic() < began + most):
            assert process.poll() is None
            time.sleep(0.02)
        process.kill()
        assert process.wait() == -signal.SIGKILL
        assert not (tmp_path / "a.h5").exists()
    for name in ("a.h5", "whole.h5"):
        subprocess.run([*start, str(tmp_path / name)], check=True, capture_output=True)
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "whole.h5").read_bytes()


# Bad input: one sentence each, before anything is computed.


@pytest.mark.parametrize(
    ("over", "options", "words"),
    [
        ({"hand.stifness": [1.0]}, {}, "hand.stifness is unknown; did you mean 'stiffness'"),
        ({"device.mass": [0.1, -0.2]}, {}, "device.mass is -0.2; give a finite number > 0 in kg"),
        ({"device.mass": []}, {}, "device.mass is an empty list"),
        ({"device.mass": 0.1}, {}, "device.mass is 0.1; give a list of values"),
        ({"device.mass": [0.1, "a"]}, {}, "give numbers, or texts, not both"),
        ({"device.mass": (0.1, 0.2, 1)}, {}, "with a count >= 2"),
        ({}, {}, "over is empty"),
        (
            {"walls.soft.damping": [1.0]},
            {},
            "walls.soft.damping cannot vary in a study; give a wall",
        ),
        ({"hand.stiffness": Uniform(-5.0, 9.0)}, {}, "hand.stiffness has draws below 0"),
        ({"hand.stiffness": Normal(-5.0, 1.0)}, {}, "hand.stiffness has draws below 0"),
        ({"device.mass": [0.1]}, {"answers": ["limit"]}, "answers has 'limit'; did you mean 'lim"),
        ({"device.mass": [0.1]}, {"answers": ["verdict"], "walls": {}}, "is of walls; give walls"),
        (
            {"device.mass": [0.1]},
            {"samples": 0},
            r"samples is 0; give a whole number from 1 to 10,000,000",
        ),
        ({"device.mass": [0.1]}, {"part": (1, 2)}, "part is given without store"),
        ({"device.mass": [0.1]}, {"part": (3, 2), "store": "a.h5"}, "part is 3/2; give 1/2 to 2/2"),
        ({"device.mass": [0.1]}, {"walls": {"a": (np.nan, 1.0)}}, "wall a is .*give finite"),
        ({"controller.delay": [0.1], "controller.delay_samples": [1.0]}, {}, "delay_samples"),
    ],
)
def test_what_makes_no_sense_is_refused_in_a_sentence(
    over: dict[str, Any], options: dict[str, Any], words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        jaxstab.study(TABLE, over, **options)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Normal(1.0, 0.0), "deviation is 0; give a number > 0"),
        (lambda: Normal(np.nan, 1.0), "mean is nan; give a finite number"),
        (lambda: Uniform(2.0, 1.0), "low is 2 and high 1; give low < high"),
        (lambda: LogNormal(-1.0, 2.0), "give a median > 0 and a factor > 1"),
        (lambda: Measured(()), "measured values are missing"),
        (lambda: distribution_of("normal:1"), "'normal:1' is no distribution; give normal:MEAN"),
        (lambda: distribution_of("csv:x"), "'csv:x' is no distribution"),
    ],
)
def test_bad_distributions_are_refused(make: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        make()


def test_a_study_says_what_it_does_not_have() -> None:
    study = jaxstab.study(LOOP, {"delay": [0.0, 1e-3]})
    with pytest.raises(ValueError, match="the study has no verdicts; give walls"):
        study.shares()
    with pytest.raises(ValueError, match="largest_stiffness has no draws; let a quantity"):
        study.quantiles()
    with pytest.raises(KeyError, match="radius is no variable of the study; it has"):
        study.values("radius")
    with pytest.raises(ValueError, match="confidence is 1; give a number between 0 and 1"):
        study.shares(confidence=1.0)


# The command.


@pytest.fixture
def desk(tmp_path: Path) -> Path:
    path = tmp_path / "desk.toml"
    path.write_text(
        "[device]\nmass = 0.25\ndamping = 0.1\n[hand]\nstiffness = 200.0\ndamping = 3.0\n"
        "[controller]\nsample_time = 0.001\ndelay = 0.001\n[walls.soft]\nstiffness = 1000.0\n"
        "damping = 10.0\n"
    )
    return path


def test_the_command_says_the_plan_the_quantiles_and_the_shares(desk: Path) -> None:
    output, plot = desk.with_name("a.h5"), desk.with_name("a.png")
    given = [
        "study",
        desk,
        "--over",
        "hand.stiffness=normal:300:100",
        "--samples",
        80,
        "-o",
        output,
    ]
    result = run(*given, "--plot", plot)
    assert result.exit_code == 0
    assert "80 sample x 1 wall: 80 loops, about 1 s of CPU time" in result.stderr
    assert "largest stiffness in N/m: 5 % below  half below  95 % below" in result.stdout
    assert "soft: stable for 100 % of 80 draws (95 % confidence: 95.42 to 100 %;" in result.stdout
    assert plot.read_bytes()[:4] == b"\x89PNG"
    assert jaxstab.open_study(output).values("verdict").shape == (80, 1)
    assert run(*given).stdout == result.stdout


def test_51_13_the_plan_counts_what_it_was_given(desk: Path) -> None:
    """A wall on a device with a mode takes 5 to 800 times as long as on one mass."""
    seconds = {}
    for name, modes in (("mass", []), ("mode", [MODE])):
        table = {**TABLE, "device": {**TABLE["device"], "modes": modes}}
        over = {"hand.stiffness": Uniform(100.0, 300.0)}
        dataset = studies.study_dataset(table, over, desk.with_name("a.h5"), answers=["verdict"])
        plan = studies.plan_of(dataset)
        assert plan.startswith("10000 sample x 2 wall: 10,000 loops, about "), plan
        assert "one mass" not in plan
        seconds[name] = plan.split("about ")[1].split(" of CPU")[0]
    assert seconds == {"mass": "1 s", "mode": "2 min"}


@pytest.mark.parametrize(
    ("over", "words"),
    [
        ("device.mass=uniform:-1e308:1e308", "low is -1e+308 and high 1e+308; give ends of a"),
        ("device.mass=uniform:0:1e308", "mass/T^2 of device and hand is"),
        ("device.mass=1e-300,0.2", "damping T/mass of device and hand is"),
        ("device.mass=normal:0.1:1e308", "device.mass has draws that overflow float64"),
        ("hand.stiffness=lognormal:1:1e300", "hand.stiffness has draws that overflow float64"),
        ("controller.velocity.window_samples=lognormal:9:1e300", "draws that overflow float64"),
        ("controller.sample_time=nan,1", "controller.sample_time is [nan, 1.0]; give finite"),
        ("device.mass=0.1,inf", "device.mass is [0.1, inf]; give finite numbers"),
        ("controller.sample_time=1e20,1", "damping T/mass of device and hand is"),
    ],
)
def test_51_14_values_that_overflow_are_refused_in_one_sentence(
    over: str, words: str, tmp_path: Path
) -> None:
    path = tmp_path / "bare.toml"
    path.write_text("[device]\nmass = 0.25\ndamping = 0.1\n[controller]\nsample_time = 0.001\n")
    done = run("study", path, "--over", over, "--samples", 20)
    assert done.exit_code == 2
    assert_one_sentence(done.stderr)
    assert words in done.stderr


def test_51_ends_too_far_apart_are_refused_from_python() -> None:
    with pytest.raises(ValueError, match=r"delay is .*give finite numbers"):
        jaxstab.study(LOOP, {"delay": (-1e308, 1e308, 3)})


# ------------------------------------------------------------- what others finished meanwhile


@pytest.mark.parametrize("has_links", [True, False])
def test_51_a_study_that_another_one_finished_meanwhile_is_kept(
    has_links: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two studies of different answers begin at the same time and write the same file."""
    path, whole = tmp_path / "a.h5", list[bytes]()
    over, options = {"device_mass": [0.1, 0.2]}, {"walls": WALLS, "store": path}
    if not has_links:

        def refuse(*_: object, **__: object) -> None:
            raise OSError(errno.EPERM, "no links here")

        monkeypatch.setattr(os, "link", refuse)

    def rival(done: int, total: int) -> None:
        if not whole:
            whole.append(b"")
            jaxstab.study(LOOP, over, answers=["verdict"], **options)
            whole[0] = path.read_bytes()

    with pytest.raises(FileExistsError, match=r"cannot write .*a\.h5: another process has written"):
        jaxstab.study(LOOP, over, answers=["limits"], progress=rival, **options)
    assert path.read_bytes() == whole[0] != b""
    path.unlink()  # the tiles of the one that was refused are kept
    told: list[tuple[int, int]] = []
    jaxstab.study(
        LOOP, over, answers=["limits"], progress=lambda *done: told.append(done), **options
    )
    assert told == [(1, 1)]
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.h5"]


def test_a_grid_is_printed_and_written_as_csv(desk: Path) -> None:
    given = ["study", desk, "--over", "device.mass=0.1:0.3:3", "--over", "controller.delay=0,0.001"]
    table = run(*given).stdout.splitlines()
    assert table[0].startswith("device mass (kg)  controller delay (s)  wall  verdict")
    assert [line.split()[:4] for line in table[3:5]] == [
        ["0.2", "0", "soft", "stable"],
        ["0.2", "0.001", "soft", "stable"],
    ]
    assert table[7:] == ["soft: stable for 6 of 6 loops, 0 undecided"]
    rows = list(csv.DictReader(run(*given, "--csv", "-").stdout.splitlines()))
    assert [row["device_mass"] for row in rows] == ["0.1", "0.1", "0.2", "0.2", "0.3", "0.3"]
    values = {"device.mass": 0.2, "controller.delay": 1e-3}
    own = loop_with(tomllib.loads(desk.read_text()), values).limits()
    assert float(rows[3]["largest_stiffness"]) == pytest.approx(own.stiffness, rel=1e-9)
    file = desk.with_name("a.csv")
    assert run(*given, "--csv", file).stdout.splitlines() == table
    assert list(csv.DictReader(file.read_text().splitlines())) == rows


def test_what_does_not_exist_is_an_empty_cell_of_csv(desk: Path) -> None:
    given = ["--answer", "margins", "--answer", "settling_time", "--wall", "hard", "90000", "10"]
    text = run("study", desk, "--over", "device.mass=0.2,0.3", *given, "--csv", "-").stdout
    row = list(csv.DictReader(text.splitlines()))[1]
    assert (row["wall"], row["settling_status"]) == ("hard", "unstable")
    assert row["stiffness_gain"] == row["settling_time"] == ""


def test_csv_of_more_rows_than_a_spreadsheet_has_is_refused(desk: Path) -> None:
    given = ["--over", "device.mass=0.1:0.3:1001", "--over", "controller.delay=0:0.001:1100"]
    result = run("study", desk, *given, "--csv", "-")
    assert (result.exit_code, result.stdout) == (2, "")
    assert "the CSV file would have 1,101,100 rows; give --output" in result.stderr


def test_a_part_needs_a_file(desk: Path) -> None:
    result = run("study", desk, "--over", "device.mass=0.1,0.2", "--part", "1/2")
    assert result.exit_code == 2
    assert "--merge and --part are given without --output; give the file" in result.stderr


def test_likely_slips_of_units_are_warned_of(desk: Path) -> None:
    result = run("study", desk, "--over", "device.mass=100,250", "--answer", "limits")
    assert result.exit_code == 0
    assert "jaxstab: warning: device.mass is 250 kg" in result.stderr


def test_the_command_computes_parts_and_merges_them(desk: Path) -> None:
    parts = [desk.with_name(f"{k}.h5") for k in (1, 2)]
    given = ["study", desk, "--over", "device.mass=0.1,0.2", "--over", "hand.damping=1:3:3"]
    for number, part in enumerate(parts, 1):
        result = run(*given, "--answer", "verdict", "--part", f"{number}/2", "-o", part)
        assert f"part {number} of 2; --merge puts all together" in result.stdout
    result = run("study", "--merge", *parts, "-o", desk.with_name("all.h5"))
    assert "soft: stable for 6 of 6 loops, 0 undecided" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--over", "hand.stiffness=normal:1"], "'normal:1' is no distribution"),
        (["--over", "device.mass"], "'device.mass' is not KEY=VALUES, such as device.mass=0.1"),
        (["--over", "=1:2:3"], "'=1:2:3' is not KEY=VALUES"),
        (["--over", "device.mass=1:2"], "device.mass is '1:2'; give LOW:HIGH:COUNT"),
        (["--over", "device.mass=1:2:0.5"], "device.mass is '1:2:0.5'; give LOW:HIGH:COUNT"),
        (["--over", "device.mass=1:2:1"], "with a COUNT from 2 to 100000"),
        (["--over", "device.mass=1,2", "--over", "device.mass=1,2"], "device.mass is given twice"),
        (["--over", "device.mass=1,2", "--part", "3/2"], "'3/2' is no part; give NUMBER/COUNT"),
        (["--over", "device.mass=1,2", "--merge"], "--merge is given beside --over"),
        (["--over", "hand.stiffness=csv:none.csv:k"], "none.csv"),
        (["--over", "hand.stiffness=nomal:1:2"], "'nomal:1:2' is no distribution; give normal:"),
        (["--over", "device.mass=0.1kg,0.2kg"], "device.mass is '0.1kg'; give a finite number > 0"),
        (["--over", "device.mass.x=1,2"], "device.mass.x is not in the scene, which has 0.25"),
        (["--over", "controller.velocity.window_samples=1:20:4"], "is 7.333"),
        (["--over", "device.mass=1,2", "--merge", "--csv", "a.csv"], "--merge is given beside"),
        (["--over", "device.mass=1,2", "desk.toml"], "a study is for one scene; give one FILE"),
        ([], "over is empty"),
    ],
)
def test_the_command_refuses_in_a_sentence(arguments: list[str], words: str, desk: Path) -> None:
    result = run("study", desk, *arguments, "-o", desk.with_name("a.h5"))
    assert result.exit_code == 2
    assert_one_sentence(result.stderr)
    assert words in result.stderr
    assert not desk.with_name("a.h5").exists()


@pytest.mark.parametrize(
    ("over", "answers", "shown"),
    [
        ({"hand.stiffness": Normal(300.0, 100.0)}, "limits", "% of the draws that allow it"),
        ({"device.mass": [0.1, 0.2], "hand.damping": Uniform(1.0, 4.0)}, "limits", "5 to 95 %"),
        ({"device.mass": [0.1, 0.2], "hand.damping": [1.0, 2.0]}, "limits", "largest stiffness"),
        ({"device.mass": [0.1, 0.2], "hand.damping": (1.0, 4.0, 8)}, "limits", "damping of the"),
        ({"device.mass": [0.1, 0.2], "hand.damping": Uniform(1.0, 4.0)}, "verdict", "95 % confid"),
        ({"device.mass": [0.1, 0.2]}, "verdict", "% of the draws for which the wall is stable"),
    ],
)
def test_pictures_name_their_axes(over: dict[str, Any], answers: str, shown: str) -> None:
    figure = study_figure(jaxstab.study(TABLE, over, answers=[answers], samples=20))
    words = " ".join(panel.get_ylabel() + panel.get_xlabel() for panel in figure.axes)
    assert shown in words
    assert all(panel.get_xlabel() or panel.get_ylabel() for panel in figure.axes)


def test_a_picture_of_three_lists_is_refused() -> None:
    over = {"device.mass": [0.1], "hand.damping": [1.0], "hand.stiffness": [100.0]}
    with pytest.raises(ValueError, match=r"the study has 3 lists .*, and a picture shows two"):
        study_figure(jaxstab.study(TABLE, over))
