"""Studies: each answer that of its own loop, draws that repeat, shares, parts, words."""

import csv
import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import dask
import numpy as np
import pytest
import xarray
from campaign import first, many
from commands import assert_one_sentence, run, run_code
from scipy import stats

import jaxstab
from jaxstab import HapticLoop, Velocity, Verdict, tables
from jaxstab.app.cli.options import processes
from jaxstab.app.pictures.scene import study_figure
from jaxstab.app.scene import Scene, loop_of
from jaxstab.app.scene.study import source_of
from jaxstab.lab import study as studies
from jaxstab.lab.study import distribution_of, draws_of, values_of
from jaxstab.results import RegionStatus

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
    "hand.stiffness": stats.norm(300.0, 100.0),
    "hand.damping": "uniform:1:5",
}
EVERYTHING = ("limits", *studies.ANSWERS)


def small(**options: Any) -> xarray.Dataset:
    """A study of 240 verdicts; blocks of 20 where ``small_blocks`` is used."""
    over = {"device.mass": [0.1, 0.3], "hand.stiffness": stats.norm(300.0, 100.0)}
    return jaxstab.study(TABLE, over, **{"answers": ["verdict"], "samples": 60, **options})


@pytest.fixture
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(studies, "_BLOCK", 20)


@pytest.mark.parametrize("modes", [[], pytest.param([MODE], marks=pytest.mark.campaign)])
def test_every_answer_is_that_of_its_own_loop(modes: list[dict[str, float]]) -> None:
    table = {**TABLE, "device": {**TABLE["device"], "modes": modes}} if modes else TABLE
    study = jaxstab.study(table, OVER, answers=EVERYTHING, samples=2, seed=4)
    assert study.verdict.dims[-2:] == ("sample", "wall")
    for window in (1, 5):
        for delay in (0.0, 1.5e-3):
            for draw in range(2):
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
    study = jaxstab.study(LOOP, over, walls=WALLS)
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


def test_an_estimator_by_name_takes_the_place_of_the_one_of_the_scene() -> None:
    controller = {"sample_time": 1e-3, "delay": 1e-3, "velocity": {"cutoff": 40.0, "order": 2}}
    table = {"device": TABLE["device"], "controller": controller}
    (limit,) = jaxstab.study(table, {"controller.velocity.preset": ["force-dimension-sdk"]})[
        "largest_stiffness"
    ].values
    assert abs(limit - 2034.5894825819580505) < 1e-9  # of 20 samples, at 50 digits


def test_lists_as_texts_are_lists() -> None:
    for given in ("0.1:0.3:3", "0.1,0.2,0.3", (0.1, 0.3, 3), [0.1, 0.2, 0.3]):
        assert values_of("device.mass", given).tolist() == [0.1, 0.2, 0.3]
    assert values_of("controller.velocity.kind", "butterworth,first") == ["butterworth", "first"]


def test_the_delay_of_a_loop_varies_in_one_unit() -> None:
    with pytest.raises(ValueError, match="delay is given beside delay_samples; give one"):
        jaxstab.study(LOOP, {"delay": [0.0, 1e-3], "delay_samples": [1.0]})


def test_an_answer_that_is_wanted_twice_is_given_once() -> None:
    study = jaxstab.study(LOOP, {"delay": [0.0, 1e-3]}, answers=["limits", "limits"])
    assert list(study.sizes) == ["delay"]


def test_one_answer_needs_no_list() -> None:
    study = jaxstab.study(LOOP, {"delay": [0.0, 1e-3]}, answers="limits")
    assert set(study.data_vars) >= {"largest_stiffness", "largest_damping"}
    with pytest.raises(ValueError, match=r"answers\.limit is unknown; did you mean 'limits'"):
        jaxstab.study(LOOP, {"delay": [0.0, 1e-3]}, answers="limit")


def test_a_table_has_named_dimensions_units_codes_and_what_it_is_of() -> None:
    opened = small()
    assert dict(opened.sizes) == {"device_mass": 2, "sample": 60, "wall": 2}
    assert opened.device_mass.attrs == {"long_name": "mass of the device", "units": "kg"}
    assert opened.hand_stiffness.dims == ("sample",)
    assert opened.hand_stiffness.attrs["units"] == "N/m"
    assert opened.wall.values.tolist() == ["soft", "stiff"]
    assert opened.wall_stiffness.values.tolist() == [1000.0, 12000.0]
    words = dict(zip(opened.verdict.flag_values, opened.verdict.flag_meanings.split(), strict=True))
    assert words == {verdict.value: verdict.name.lower() for verdict in Verdict}
    assert json.loads(opened.attrs["over"])["hand.stiffness"] == "norm(300.0, 100.0)"
    assert "'mass': 0.25" in opened.attrs["of"]
    assert opened.attrs["seed"] == "0"


def test_a_device_that_turns_has_its_own_units() -> None:
    table = {
        "device": {"inertia": 2e-3, "damping": 1e-3},
        "controller": {"sample_time": 1e-3},
    }
    study = jaxstab.study(table, {"device.inertia": [1e-3, 2e-3]})
    assert study.device_inertia.units == "kg m^2"
    assert study.largest_stiffness.units == "N m/rad"


# Draws.


def test_draws_depend_on_seed_and_name_alone() -> None:
    first = small(seed=1).hand_stiffness
    np.testing.assert_array_equal(first, small(seed=1, samples=90).hand_stiffness[:60])
    over = {"hand.damping": stats.uniform(1.0, 4.0), "hand.stiffness": "normal:300:100"}
    other = jaxstab.study(TABLE, over, answers=["verdict"], samples=60, seed=1)
    np.testing.assert_array_equal(first, other.hand_stiffness)
    assert (first != small(seed=2).hand_stiffness).all()
    assert np.corrcoef(first, other.hand_damping)[0, 1] < 0.5


def test_rng_is_a_seed_or_a_generator_in_place_of_the_seed() -> None:
    def drawn(**chosen: Any) -> Any:
        return jaxstab.study(TABLE, OVER, answers=["verdict"], samples=5, **chosen).hand_stiffness

    first = drawn(rng=7)
    np.testing.assert_array_equal(first, drawn(rng=np.random.default_rng(7)))
    np.testing.assert_array_equal(first, drawn(seed=3, rng=7))
    assert (first != drawn(rng=8)).all()
    chance = np.random.default_rng(7)
    drawn(rng=chance)
    assert (first != drawn(rng=chance)).all()  # it is drawn from, so it goes on


@pytest.mark.parametrize(
    ("text", "quantiles"),
    [
        ("normal:300:100", (200.0, 300.0, 400.0)),
        ("uniform:2:6", (2.6346, 4.0, 5.3654)),
        ("lognormal:300:1.5", (200.0, 300.0, 450.0)),
    ],
)
def test_distributions_have_the_quantiles_of_their_formulas(
    text: str, quantiles: tuple[float, ...]
) -> None:
    draws, below = draws_of("x", distribution_of(text), 200_000, 3)
    found = np.quantile(draws, (0.158655, 0.5, 0.841345))
    np.testing.assert_allclose(found, quantiles, rtol=0.01)
    assert below == 0.0


@pytest.mark.parametrize(
    "frozen",
    [stats.gamma(2.0, scale=150.0), stats.t(4.0, 300.0, 20.0), stats.randint(1, 21)],
    ids=lambda frozen: frozen.dist.name,
)
def test_any_frozen_distribution_of_scipy_is_drawn(frozen: Any) -> None:
    """Against its own ``rvs``, which draws in another way: the test of Kolmogorov and Smirnov."""
    draws, _ = draws_of("x", frozen, 20_000, 5)
    own = frozen.rvs(20_000, random_state=6)
    assert stats.ks_2samp(draws, own).pvalue > 1e-3


def test_what_a_distribution_has_below_0_is_left_out_and_the_command_says_so(
    tmp_path: Path,
) -> None:
    draws, below = draws_of("hand.stiffness", stats.norm(100.0, 100.0), 100_000, 0, 0.0)
    assert draws.min() >= 0.0
    assert below == pytest.approx(0.158655, abs=1e-6)
    whole = stats.norm(100.0, 100.0).rvs(200_000, random_state=1)
    assert stats.ks_2samp(draws, whole[whole >= 0.0]).pvalue > 1e-3
    scene = tmp_path / "desk.toml"
    scene.write_text("[device]\nmass = 0.1\ndamping = 1.5\n[controller]\nsample_time = 0.001\n")
    over = "hand.stiffness=normal:100:100"
    result = run("study", scene, "--over", over, "--samples", 9, "-o", tmp_path / "a.h5")
    assert "hand.stiffness: 16 % of the distribution, below 0, is left out" in result.stderr


def test_ranges_of_a_scene_are_drawn_uniformly_and_it_says_so() -> None:
    table = {
        **TABLE,
        "device": {"mass": [0.1, 0.3], "damping": 0.1},
        "hand": {"mass": [0.2, 0.2], "stiffness": [100.0, 500.0], "damping": 3.0},
    }
    over = {"controller.delay": [0.0, 1e-3]}
    given = {"answers": ["verdict"], "samples": 9}
    study = jaxstab.study(table, over, **given)
    assert study.attrs["notes"] == (
        "device.mass: drawn from the range of the scene, uniform:0.1:0.3.\n"
        "hand.stiffness: drawn from the range of the scene, uniform:100.0:500.0."
    )
    assert set(study.sizes) == {"controller_delay", "sample", "wall"}
    ranges = {"device.mass": "uniform:0.1:0.3", "hand.stiffness": "uniform:100:500"}
    same = jaxstab.study({**table, "hand": {**table["hand"], "mass": 0.2}}, over | ranges, **given)
    for name in ("device_mass", "hand_stiffness", "verdict"):
        np.testing.assert_array_equal(same[name], study[name])
    with pytest.raises(ValueError, match=r"hand\.stiffness is \[5.0, 1.0\]; its ends are swapped"):
        jaxstab.study({**table, "hand": {"stiffness": [5.0, 1.0]}}, over, **given)


def test_columns_of_one_file_are_drawn_row_by_row(tmp_path: Path) -> None:
    file = tmp_path / "hands.csv"
    file.write_text("name,k,b\na,100,1\nb,200,2\nc,400,4\n", encoding="utf-8")
    over = {
        "hand.stiffness": f"csv:{file}:k",
        "hand.damping": f"csv:{file}:b",
    }
    study = jaxstab.study(TABLE, over, answers=["verdict"], samples=50)
    np.testing.assert_array_equal(study.hand_stiffness, 100.0 * study.hand_damping)
    assert set(study.hand_damping.values) == {1.0, 2.0, 4.0}


def test_a_row_that_is_drawn_again_is_computed_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "hands.csv"
    file.write_text("k,b\n100,1\n200,5\n400,2\n", encoding="utf-8")
    over = {
        "device.mass": [0.1, 0.3],
        "hand.stiffness": f"csv:{file}:k",
        "hand.damping": f"csv:{file}:b",
    }
    real, counts = studies.limits_of, list[int]()

    def counted(loops: Any) -> Any:
        counts.append(len(loops))
        return real(loops)

    monkeypatch.setattr(studies, "limits_of", counted)
    study = jaxstab.study(TABLE, over, samples=90)
    assert counts == [6]
    assert study["sample"].values.tolist() == [*range(90)]
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
    plan = studies.plan_study(source_of(TABLE), over, samples=90)[1][-1]
    assert plan.startswith("2 device_mass x 90 sample x 2 wall: 6 loops, about ")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a,k\n1,2\n", "hands.csv has no column 'b'; its columns are 'a, k'"),
        ("a,b\n1,2\n1,x\n", "hands.csv, line 3: b is 'x'; give a finite number"),
        ("a,b\n1\n", "hands.csv, line 2: b is ''; give a finite number"),
        ("a,b\n", "hands.csv has no rows below its names"),
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
    shares = jaxstab.shares(study)
    codes = study.verdict.values
    np.testing.assert_array_equal(shares.share, (codes == Verdict.STABLE).mean(axis=1))
    np.testing.assert_array_equal(shares.undecided, (codes == Verdict.UNDECIDED).sum(axis=1))
    assert shares.attrs == {"draws": 500, "confidence": 0.95}
    wider = jaxstab.shares(study, confidence=0.999)
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
    over = {"hand.stiffness": "normal:300:100"}
    study = jaxstab.study(TABLE, over, answers=["verdict"], samples=300)
    shares = jaxstab.shares(study)
    assert shares.undecided.values.tolist() == [100, 100]
    np.testing.assert_allclose(shares.share, 2.0 / 3.0)
    assert (shares.low < 2.0 / 3.0 - 0.05).all()
    np.testing.assert_array_equal(shares.high, 1.0)


def test_intervals_cover_the_share_among_all_hands_in_95_of_100_small_studies() -> None:
    over = {"device.mass": "uniform:0.1:0.3", "hand.stiffness": "lognormal:300:1.4"}
    walls = {"x": (12000.0, 40.0)}
    study = jaxstab.study(TABLE, over, answers=["verdict"], walls=walls, samples=40_000)
    truth = (study.verdict == Verdict.STABLE).mean().item()
    assert 0.1 < truth < 0.9
    codes = study.verdict.values.reshape(200, 200)
    shares = jaxstab.shares(xarray.Dataset({"verdict": (("study", "sample"), codes)}))
    covered = ((shares.low <= truth) & (truth <= shares.high)).mean()
    assert 0.9 <= covered <= 0.99


def test_quantiles_are_those_of_the_draws_and_nothing_stable_counts_as_0() -> None:
    over = {"device.mass": "uniform:0.1:0.3", "controller.delay_samples": [1.0, 3.0]}
    study = jaxstab.study(TABLE, over, answers=["limits"], samples=11)
    values = np.sort(study.largest_stiffness.values, axis=1)
    found = jaxstab.quantiles(study, at=[0.0, 0.5, 1.0])
    assert found.dims == ("quantile", "controller_delay_samples")
    np.testing.assert_array_equal(found, values[:, [0, 5, 10]].T)
    assert "wall" not in study.sizes


def test_where_no_wall_is_stable_the_largest_stiffness_counts_as_0(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    real = studies.limits_of

    def first_empty(*given: Any, **fields: Any) -> Any:
        limits = real(*given, **fields)
        limits.stiffness[0], limits.status[0] = np.nan, RegionStatus.EMPTY
        return limits

    monkeypatch.setattr(studies, "limits_of", first_empty)
    study = jaxstab.study(TABLE, {"device.mass": "uniform:0.1:0.3"}, answers=["limits"], samples=9)
    assert jaxstab.quantiles(study, at=[0.0]) == [0.0]


# Any division of the work gives the same.


def test_blocks_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = small()
    monkeypatch.setattr(studies, "_BLOCK", 20)
    assert studies.plan_study(source_of(TABLE), {"device.mass": [0.1, 0.2]})[0].chunks
    assert small().identical(whole)


def test_costly_loops_come_in_small_blocks() -> None:
    over = {"hand.stiffness": "uniform:100:300"}
    table = {**TABLE, "device": {**TABLE["device"], "modes": [MODE]}}
    for answers, most in ((["verdict"], 8192), (["margins"], 20)):
        planned, _ = studies.plan_study(source_of(table), over, answers=answers, samples=10_000)
        assert max(planned.chunks["sample"]) <= most


def test_threads_compute_the_same(small_blocks: None) -> None:
    whole = small()
    with dask.config.set(scheduler="threads", num_workers=2):
        assert small().identical(whole)


def stored(path: Path, **options: Any) -> Path:
    small(**options).to_netcdf(path, engine="h5netcdf")
    return path


def test_parts_are_smaller_studies_and_make_the_whole(tmp_path: Path) -> None:
    whole = small()
    parts = [stored(tmp_path / f"{k}.h5", part=(k, 3)) for k in (1, 2, 3)]
    first = xarray.load_dataset(parts[0], engine="h5netcdf")
    assert first.verdict.sizes["sample"] == 20
    assert jaxstab.shares(first).draws == 20
    assert studies.merged(parts[::-1]).identical(whole)
    together = {"data_vars": "minimal", "coords": "minimal", "compat": "override", "join": "exact"}
    with xarray.open_mfdataset(parts, engine="h5netcdf", **together) as opened:
        assert opened.equals(whole)


def test_parts_are_of_the_longest_list_where_nothing_is_drawn(tmp_path: Path) -> None:
    over = {"device.mass": [0.1, 0.3], "controller.velocity.window_samples": [20, 1, 5]}
    given = {"answers": ["verdict"]}
    parts = []
    for k in (1, 2):
        parts.append(tmp_path / f"{k}.h5")
        jaxstab.study(TABLE, over, part=(k, 2), **given).to_netcdf(parts[-1], engine="h5netcdf")
    assert studies.merged(parts).identical(jaxstab.study(TABLE, over, **given))


@pytest.mark.campaign
def test_parts_have_the_verdicts_of_the_whole_and_its_limits_to_1e_9() -> None:
    """One program computes most of the whole, and its parts are computed loop by loop."""
    over, given = {"device.mass": (0.1, 0.5, 300)}, {"answers": ["verdict", "limits"]}
    whole = jaxstab.study(TABLE, over, **given)
    parts = [jaxstab.study(TABLE, over, part=(k, 3), **given) for k in (1, 2, 3)]
    verdicts = np.concatenate([part.verdict for part in parts])
    np.testing.assert_array_equal(verdicts, whole.verdict)
    for name in ("largest_stiffness", "at_damping", "largest_damping", "at_stiffness"):
        merged = np.concatenate([part[name] for part in parts])
        np.testing.assert_allclose(merged, whole[name], rtol=1e-9)


def test_study_writes_no_table_over_one_that_appears_meanwhile(
    desk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of two tasks of an array with one --csv, the second one says that it writes nothing."""
    table = desk.with_name("table.csv")
    compute = tables.computed

    def slow(planned: Any) -> Any:
        table.write_text("of another task")
        return compute(planned)

    monkeypatch.setattr(tables, "computed", slow)
    asked = "--over", "device.mass=0.1,0.2", "--answer", "verdict", "--csv", table
    result = run("study", desk, *asked)
    assert result.exit_code == 2
    assert "table.csv: another process has written it meanwhile" in result.stderr
    assert table.read_text() == "of another task"


def test_parts_that_do_not_go_together_are_refused(tmp_path: Path) -> None:
    one, two = (stored(tmp_path / f"{k}.h5", part=(k, 3)) for k in (1, 2))
    other = stored(tmp_path / "other.h5", part=(3, 3), seed=5)
    whole, text = stored(tmp_path / "whole.h5"), tmp_path / "text.h5"
    text.write_text("no part")
    for parts, words in (
        ([one, text], r"text\.h5 is not a netCDF-4 file, or is damaged"),
        ([one, two], "part 3 of 3 is missing"),
        ([one, two, one], r"1\.h5 and .*1\.h5 are the same part"),
        ([one, two, other], r"other\.h5 and .*1\.h5 are parts of different studies"),
        ([one, two, whole], r"whole\.h5 is no part of a study"),
        ([], "no file is given; give those of all parts"),
    ):
        with pytest.raises(ValueError, match=words):
            studies.merged(parts)
    with pytest.raises(FileNotFoundError, match=r"cannot read .*none\.h5: No such file"):
        studies.merged([one, tmp_path / "none.h5"])


@pytest.mark.parametrize(
    "missing",
    first(["xarray", "dask", "h5netcdf"], 1),
)
def test_what_is_not_installed_is_named_in_a_sentence(missing: str, tmp_path: Path) -> None:
    code = (
        f"import sys; sys.modules[{missing!r}] = None\n"
        "from jaxstab.app.cli.main import main\n"
        "main(['study', 'scene.toml', '--over', 'device.mass=0.1,0.2'])\n"
    )
    (tmp_path / "scene.toml").write_text(
        "[device]\nmass = 0.1\ndamping = 0.1\n[controller]\nsample_time = 0.001\n"
    )
    done = run_code(code, tmp_path)
    assert done.returncode == 2
    assert_one_sentence(done.stderr)
    assert "is missing: python -m pip install 'jaxstab[study]'" in done.stderr


@pytest.mark.campaign
def test_random_studies_have_the_answers_of_single_loops() -> None:
    rng = np.random.default_rng(35)
    for _ in range(many(20, 1)):
        table = random_table(rng)
        over = {
            "device.mass": stats.lognorm(np.log(2.0), scale=table["device"]["mass"]),
            "hand.stiffness": "uniform:0:2000",
            "controller.delay_samples": [0.0, float(rng.integers(1, 12)), rng.uniform(0.0, 6.0)],
        }
        walls = {"a": (10 ** rng.uniform(2, 4.5), 10 ** rng.uniform(0, 2)), "b": (500.0, 5.0)}
        study = jaxstab.study(
            table, over, walls=walls, samples=many(170, 20), seed=int(rng.integers(1000))
        )
        for delay in range(3):
            for draw in range(study.sizes["sample"]):
                row = study.isel(controller_delay_samples=delay, sample=draw)
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
def test_processes_and_dask_workers_compute_the_same_though_one_is_killed() -> None:
    from distributed import Client, LocalCluster

    given = {"answers": ["spectral_radius"], "samples": 20_000}
    whole = small(**given)
    with (
        processes(2) as pool,
        dask.config.set(scheduler="processes", pool=pool, chunksize=1),
    ):
        assert small(**given).identical(whole)
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        assert small(**given).identical(whole)
        first = next(iter(client.run(os.getpid).values()))
        killer = subprocess.Popen([sys.executable, "-c", KILL, str(first)])
        assert small(**given).identical(whole)
        assert killer.wait() == 0


KILL = "import os, sys, time; time.sleep(0.5); os.kill(int(sys.argv[1]), 9)"


def test_a_safety_that_is_not_applied_is_said() -> None:
    table = {**TABLE, "wanted": {"safety": 0.8}}
    _, notes = studies.plan_study(source_of(table), {"device.mass": [0.1, 0.2]})
    assert notes[0] == "wanted.safety is 0.8: limits are given without it."


# Bad input: one sentence each, before anything is computed.


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("velocity", "velocity cannot vary in a study of a loop; give a scene"),
        ("device", "or ask limits_of for a list of loops"),
        ("mode", "mode is unknown; known are device_mass, .*, sample_time"),
    ],
)
def test_keys_of_a_loop_that_are_no_numbers_are_refused(key: str, words: str) -> None:
    loop = HapticLoop(device_mass=0.2, device_damping=0.1, sample_time=1e-3)
    with pytest.raises(ValueError, match=words):
        jaxstab.study(loop, {key: [Velocity.difference(samples=3)]})


@pytest.mark.parametrize(
    ("over", "options", "words"),
    [
        ({"hand.stifness": [1.0]}, {}, "hand.stifness is unknown; did you mean 'stiffness'"),
        ({"device.mass": [0.1, -0.2]}, {}, "device.mass is -0.2; give a finite number > 0 in kg"),
        ({"device.mass": []}, {}, "device.mass is an empty list"),
        ({"device.mass": 0.1}, {}, "device.mass is 0.1; give a list of values"),
        ({"device.mass": [0.1, "a"]}, {}, "give numbers, or texts, not both"),
        ({"device.mass": (0.1, 0.2, 1)}, {}, "with a COUNT from 2 to 100000"),
        ({}, {}, "over is empty"),
        (
            {"walls.soft.damping": [1.0]},
            {},
            "walls.soft.damping cannot vary in a study; give a wall",
        ),
        ({"wanted.safety": [0.5]}, {}, "wanted.safety cannot vary in a study; leave it out"),
        ({"hand.stiffness": "uniform:-5:9"}, {}, "hand.stiffness has draws below 0"),
        ({"hand.stiffness": stats.norm(-5.0, 1.0)}, {}, "hand.stiffness has draws below 0"),
        (
            {"hand.stiffness": stats.norm(5.0, -1.0)},
            {},
            "draws that are not finite; correct the para",
        ),
        (
            {"hand.stiffness": stats.norm([1.0, 2.0], 1.0)},
            {},
            "hand.stiffness is norm.*give a distr",
        ),
        (
            {"device.mass": [0.1]},
            {"answers": ["limit"]},
            "answers.limit is unknown; did you mean .limits",
        ),
        ({"device.mass": [0.1]}, {"answers": ["verdict"], "walls": {}}, "is of walls; give walls"),
        ({"hand.stiffness": stats.norm}, {}, "hand.stiffness is <scipy.*such as scipy.stats.norm"),
        ({"device.mass": [0.1]}, {"seed": -1}, "seed is -1; give a whole number from 0 to"),
        (
            {"device.mass": [0.1]},
            {"samples": 0},
            r"samples is 0; give a whole number from 1 to 10,000,000",
        ),
        (
            {"device.mass": [0.1]},
            {"part": (1, 2)},
            "the longest dimension, device_mass, has 1 values",
        ),
        ({"device.mass": [0.1]}, {"part": (3, 2)}, "part is 3/2; give 1/2 to 2/2"),
        (
            {"device.mass": [0.1]},
            {"walls": {"a": (np.nan, 1.0)}},
            "the stiffness of wall a is nan; allowed are finite",
        ),
        ({"controller.delay": [0.1], "controller.delay_samples": [1.0]}, {}, "delay_samples"),
    ],
)
def test_what_makes_no_sense_is_refused_in_a_sentence(
    over: dict[str, Any], options: dict[str, Any], words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        jaxstab.study(TABLE, over, **options)


@pytest.mark.parametrize(
    "text",
    ["normal:1", "csv:x", "lognormal:1:-2", "lognormal:1:0.5", "lognormal:1:1", "weibull:1:2"],
)
def test_bad_distributions_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=rf"'{text}' is no distribution; give normal:MEAN"):
        distribution_of(text)


def test_a_study_says_what_it_does_not_have() -> None:
    study = jaxstab.study(LOOP, {"delay": [0.0, 1e-3]})
    with pytest.raises(ValueError, match="the study has no verdicts; give walls"):
        jaxstab.shares(study)
    with pytest.raises(ValueError, match="largest_stiffness has no draws; let a quantity"):
        jaxstab.quantiles(study)
    with pytest.raises(KeyError, match="radius is no variable of the study; it has"):
        jaxstab.quantiles(study, "radius")
    with pytest.raises(ValueError, match="confidence is 1; give a number between 0 and 1"):
        jaxstab.shares(study, confidence=1.0)
    with pytest.raises(ValueError, match=r"at is 2\.0; allowed are finite values from 0 to 1"):
        jaxstab.quantiles(study, at=[2.0])
    drawn = jaxstab.study(LOOP, {"delay": "uniform:0:0.002"}, walls={"a": (100.0, 1.0)}, samples=3)
    for name in ("verdict", "limits_status"):  # 1.5 would be between stable and unstable
        with pytest.raises(ValueError, match=f"{name} has codes, not numbers"):
            jaxstab.quantiles(drawn, name)
    with pytest.raises(KeyError, match="limits_status is no variable of the study; it has"):
        jaxstab.quantiles(drawn[["largest_stiffness"]])  # which tells where nothing is stable
    for ask in (jaxstab.shares, jaxstab.quantiles):
        with pytest.raises(ValueError, match="has no draws; let a quantity"):
            ask(drawn.isel(sample=slice(0)))


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
        20,
        "-o",
        output,
    ]
    result = run(*given, "--plot", plot)
    assert result.exit_code == 0
    assert "20 sample x 1 wall: 20 loops, about 1 s of CPU time" in result.stderr
    lines = [" ".join(line.split()) for line in result.stdout.splitlines()]
    assert lines[:2] == [
        "largest stiffness in N/m, over 20 draws:",
        "5th percentile median 95th percentile",
    ]
    low, median, high = map(float, lines[2].removeprefix("20 draws ").split())
    assert low < median < high
    assert lines[3:] == [
        "proved stable in % of 20 draws, with the 95 % confidence interval:",
        "wall stable low high undecided",
        "soft 100 83.8875 100 0",
    ]
    assert plot.read_bytes()[:4] == b"\x89PNG"
    before = output.read_bytes()
    assert xarray.load_dataset(output, engine="h5netcdf").verdict.shape == (20, 1)
    again = run(*given)
    assert (again.exit_code, again.stdout) == (2, "")
    assert_one_sentence(again.stderr, f"{output} exists")
    assert output.read_bytes() == before
    table = output.with_name("a.csv")
    table.write_text("mine")
    again = run(*given[:-2], "--csv", table)
    assert_one_sentence(again.stderr, f"{table} exists")
    assert table.read_text() == "mine"


def test_the_plan_counts_what_it_was_given_and_draws_what_takes_a_minute() -> None:
    over = {"device.mass": [0.1, 0.2], "hand.stiffness": "uniform:100:300"}
    for modes, answers, samples, words in (
        ([], ["verdict"], 10_000, "2 device_mass x 10000 sample x 2 wall: 20,000 loops, about 1 s"),
        ([MODE], ["verdict"], 3_750, "2 device_mass x 3750 sample x 2 wall: 7,500 loops, about 60"),
        (
            [MODE],
            ["margins"],
            37,
            "2 device_mass x 37 sample x 2 wall: 74 loops, about 59 s of CPU",
        ),
    ):
        table = {**TABLE, "device": {**TABLE["device"], "modes": modes}}
        planned, notes = studies.plan_study(source_of(table), over, answers=answers)
        assert planned.sizes["sample"] == samples
        assert notes[-1].startswith(words), notes
    _, notes = studies.plan_study(source_of(table), over, answers=["margins"], samples=9000)
    assert "18,000 loops, about 4 h of CPU time" in notes[-1]


@pytest.mark.parametrize(
    ("over", "words"),
    [
        ("device.mass=uniform:-1e308:1e308", "device.mass has draws that are not finite"),
        ("device.mass=uniform:0:1e308", "mass/T^2 of device and hand is"),
        ("device.mass=1e-300,0.2", "damping T/mass of device and hand is"),
        ("device.mass=normal:0.1:1e308", "mass/T^2 of device and hand is inf"),
        ("hand.stiffness=lognormal:1:1e300", "hand.stiffness has draws that are not finite"),
        (
            "controller.velocity.window_samples=lognormal:9:1e300",
            "give a whole number from 1 to 200",
        ),
        ("controller.sample_time=nan,1", "controller.sample_time is [nan, 1.0]; give finite"),
        ("device.mass=0.1,inf", "device.mass is [0.1, inf]; give finite numbers"),
        ("controller.sample_time=1e20,1", "damping T/mass of device and hand is"),
    ],
)
def test_values_that_overflow_are_refused_in_one_sentence(
    over: str, words: str, tmp_path: Path
) -> None:
    path = tmp_path / "bare.toml"
    path.write_text("[device]\nmass = 0.25\ndamping = 0.1\n[controller]\nsample_time = 0.001\n")
    done = run("study", path, "--over", over, "--samples", 20)
    assert done.exit_code == 2
    assert_one_sentence(done.stderr)
    assert words in done.stderr


def test_ends_too_far_apart_are_refused_from_python() -> None:
    with pytest.raises(ValueError, match=r"delay is .*give LOW:HIGH:COUNT"):
        jaxstab.study(LOOP, {"delay": (-1e308, 1e308, 3)})


def test_a_study_that_another_one_finished_meanwhile_is_kept(
    desk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two studies begin at the same time and write the same file: both end, and one says so."""
    output, real = desk.with_name("a.h5"), tables.computed

    def slower(planned: xarray.Dataset) -> xarray.Dataset:
        output.write_bytes(b"of another one")
        return real(planned)

    monkeypatch.setattr("jaxstab.tables.computed", slower)
    result = run("study", desk, "--over", "device.mass=0.1,0.2", "-o", output)
    assert (result.exit_code, result.stdout) == (2, "")
    assert "a.h5: another process has written it meanwhile; remove that file" in result.stderr
    assert output.read_bytes() == b"of another one"
    assert sorted(entry.name for entry in desk.parent.iterdir()) == ["a.h5", "desk.toml"]


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
    for line, row in zip(table[1:7], rows, strict=True):  # rounded down, as a stable one has to be
        shown, found = float(line.split()[4]), float(row["largest_stiffness"])
        assert found * (1.0 - 1e-5) < shown <= found
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
        assert result.exit_code == 0, result.stderr
    result = run("study", "--merge", *parts, "-o", desk.with_name("all.h5"))
    assert "soft: stable for 6 of 6 loops, 0 undecided" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--over", "hand.stiffness=normal:1"], "'normal:1' is no distribution"),
        (["--over", "device.mass"], "'device.mass' is not KEY=VALUES, such as device.mass=0.1"),
        (["--over", "=1:2:3"], "'=1:2:3' is not KEY=VALUES"),
        (["--set", "x"], "'x' is not KEY=VALUE, such as device.mass=0.25."),
        (["--over", "device.mass=1:2"], "device.mass is '1:2'; give LOW:HIGH:COUNT"),
        (["--over", "device.mass=1:2:0.5"], "device.mass is '1:2:0.5'; give LOW:HIGH:COUNT"),
        (["--over", "device.mass=1:2:1"], "with a COUNT from 2 to 100000"),
        (["--over", "device.mass=1,2", "--over", "device.mass=1,2"], "device.mass is given twice"),
        (["--over", "device.mass=1,2", "--part", "3of2"], "'3of2' is no part; give NUMBER/COUNT"),
        (["--over", "device.mass=1,2", "--merge"], "--over is given beside --merge"),
        *(
            (["--merge", *ignored], f"{ignored[0]} is given beside --merge, but nothing is")
            for ignored in (
                ["--part", "1/2"],
                ["--samples", "3"],
                ["--seed", "7"],
                ["--answer", "limits"],
                ["--set", "device.mass=1"],
                ["--sample-time", "0.01"],
                ["--workers", "2"],
            )
        ),
        (["--over", "device.mass=1,2", "--samples", "9"], "--samples is 9, but nothing is drawn"),
        (["--over", "hand.stiffness=csv:none.csv:k"], "none.csv"),
        (["--over", "hand.stiffness=nomal:1:2"], "'nomal:1:2' is no distribution; give normal:"),
        (["--over", "device.mass=0.1kg,0.2kg"], "device.mass is '0.1kg'; give a finite number > 0"),
        (["--over", "device.mass.x=1,2"], "device.mass.x is not in the scene, which has 0.25"),
        (["--over", "controller.velocity.window_samples=1:20:4"], "is 7.333"),
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
    first(
        [
            ({"hand.stiffness": "normal:300:100"}, "limits", "% of the draws that allow it"),
            ({"device.mass": [0.1, 0.2], "hand.damping": "uniform:1:4"}, "verdict", "95 % confid"),
            ({"device.mass": [0.1, 0.2], "hand.damping": "uniform:1:4"}, "limits", "5th to 95th"),
            (
                {"device.mass": [0.1, 0.2], "hand.damping": [1.0, 2.0]},
                "limits",
                "largest stiffness",
            ),
            (
                {"device.mass": [0.1, 0.2], "hand.damping": (1.0, 4.0, 8)},
                "limits",
                "damping of the",
            ),
            ({"device.mass": [0.1, 0.2]}, "verdict", "verdict"),
        ],
        2,
    ),
)
def test_pictures_name_their_axes(over: dict[str, Any], answers: str, shown: str) -> None:
    figure = study_figure(jaxstab.study(TABLE, over, answers=[answers], samples=9))
    words = " ".join(panel.get_ylabel() + panel.get_xlabel() for panel in figure.axes)
    assert shown in words
    assert all(panel.get_xlabel() or panel.get_ylabel() for panel in figure.axes)


def test_a_picture_of_three_lists_is_refused() -> None:
    over = {"device.mass": [0.1], "hand.damping": [1.0], "hand.stiffness": [100.0]}
    with pytest.raises(ValueError, match=r"the study has 3 lists .*, and a picture shows two"):
        study_figure(jaxstab.study(TABLE, over))
