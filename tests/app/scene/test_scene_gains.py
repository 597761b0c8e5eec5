"""Scenes of simulators, admittance, PID and couplings: what commands answer, and in which words."""

import csv
import json
import math
import re
import tomllib
from decimal import Decimal
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaign import first
from commands import assert_one_sentence, run

import jaxstab
from jaxstab import Verdict
from jaxstab.app.scene import GainScene, any_scene
from jaxstab.exact.boundary import ScaledLoop
from jaxstab.loop import Loop, Region, affine
from jaxstab.region.curve import curve_of
from jaxstab.region.measures import empty_outline
from jaxstab.region.stable_set import region_within
from tests.truth import recursions
from tests.truth.random_scenes import (
    DEVICE,
    JOINT,
    RANDOM,
    ROBOT,
    Tables,
    couple,
    judged,
    loop,
    pid,
)

FOLDER = Path(__file__).parents[3] / "data" / "scenes" / "gains"
KINDS = "simulator", "admittance", "pid", "coupling"

SPRUNG = JOINT | {"damping": 0.5, "stiffness": 20.0}
SLOW = {"delay_samples": 5, "robot": {"factor": 0.1}}
WINDOW = {
    "device": DEVICE["device"],
    "controller": DEVICE["controller"] | {"velocity": {"window_samples": 20}},
}
OTHER, SPRING = {"mass": 0.5, "damping": 0.2}, {"mass": 0.1, "damping": 0.5}


HELD = SPRING | {"hand": {"stiffness": 20.0}}  # 20 N/m hold it
INF = float("inf")
# Of 40 digits, by Newton's method in mpmath on the determinants of recursions.
TRUTHS = {
    "every 4 steps": (loop(JOINT | {"substeps": 4}, at_kd=10.0), "kp", (0.0, 3333.33333333)),
    "late": (
        loop(JOINT | {"substeps": 4, "delay_steps": 2}, at_kd=5.0),
        "kp",
        (0.0, 573.306746431),
    ),
    "outside": (loop(JOINT | {"outside": True}, at_kd=10.0), "kp", (0.0, 90000.0)),
    "kd": (loop(JOINT | {"substeps": 4}, at_kp=100.0), "kd", (0.3, 24.9)),
    "shipped": (
        loop(SPRUNG | {"integrator": "implicit-joint"}, at_kd=10.0),
        "kp",
        (-20.0, 90480.0),
    ),
    "implicit": (loop(SPRUNG | {"integrator": "implicit"}, at_kd=10.0), "kp", (-20.0, INF)),
    "damping": (loop(ROBOT, at_mass=2.0), "damping", (39.515919035, 3995.0)),
    "mass": (loop(ROBOT, at_damping=39.5), "mass", (0.02225, 1.934237439)),
    "backward": (loop(ROBOT | {"rule": "backward"}, at_mass=2.0), "damping", (39.5250081919, INF)),
    "virtual spring": (
        loop(ROBOT | {"stiffness": 1e3}, at_mass=2.0),
        "damping",
        (39.4676599975, 3994.5),
    ),
    "slow robot": (loop(ROBOT | SLOW, at_mass=2.0), "damping", (105.305296453, 4000.26315789)),
    "slow and filtered": (
        loop(ROBOT | SLOW | {"force_filter": {"factor": 0.2}}, at_mass=2.0),
        "damping",
        (130.346545413, 4000.02923977),
    ),
    "kp": (pid({"kd": 50.0}, at_ki=1e5), "kp", (405.297223468, 25486.3735143)),
    "ki": (pid({"kd": 50.0, "rule": "trapezoid"}, at_kp=5e3), "ki", (0.0, 947132.805048)),
    "kd by ki": (pid({"ki": 1e5}, at_kp=5e3), "kd", (12.549777558, 200.179086276)),
    "a window": (pid({"kd": 10.0}, WINDOW, at_ki=1e4), "kp", (166.449488818, 1735.72184324)),
    "two devices": (couple(OTHER, 1.0, 2.0, at_damping=30.0), "stiffness", (0.0, 12779.0591429)),
    "fractions": (couple(OTHER, 1.5, 2.25, at_damping=20.0), "stiffness", (0.0, 7452.67931977)),
    "a hand": (couple(HELD, 2.0, 1.4, at_damping=10.0), "stiffness", (0.0, 4050.9052908)),
}


def answered(tables: Tables, command: str = "limits") -> Any:
    scene = any_scene(tables)
    assert isinstance(scene, GainScene)
    return scene.answer(command)


@pytest.mark.parametrize("name", TRUTHS)
def test_stable_values_of_a_gain_are_those_of_40_digits(name: str) -> None:
    tables, gain, expected = TRUTHS[name]
    ((at, value),) = tables["wanted"].items()
    row = answered(tables).as_json()[at.replace("at_", "at_given_")]
    assert row[at] == value
    low, high = row[f"{gain}_limits"]
    assert (low, INF if high is None else high) == pytest.approx(expected, rel=2e-11, abs=1e-9)


# ---------------------------------------------------------------------- printed numbers are stable


def printed_pairs(text: str) -> list[dict[str, Fraction]]:
    """The pairs of gains that an answer prints as limits: a largest or least one, and where."""
    found, lines = list[dict[str, Fraction]](), text.splitlines()
    for line, following in pairwise(lines):
        words, place = line.split(), following.split()
        if words[0] in ("largest", "least"):
            assert place[0] == "at"
            found.append({words[1]: Fraction(Decimal(words[2])), place[1]: Fraction(place[2])})
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_limits_are_stable_as_they_are_printed(kind: str) -> None:
    """In exact fractions, or numbers of 60 digits: by the recursion of software and device."""
    rng = np.random.default_rng(54)
    for _ in range(8):
        tables = RANDOM[kind](rng)
        tables["wanted"] = {"safety": 0.7} if rng.random() < 0.3 else {}
        answer = answered(tables)
        pairs = printed_pairs(str(answer))
        assert len(pairs) == 2, str(answer)
        assert answer.all_stable
        for pair in pairs:
            assert judged(tables, pair, tables["loop"].get("environment", 0.0)), (tables, pair)


@pytest.mark.parametrize("kind", ["simulator", "admittance"])
def test_no_gains_are_stable_beyond_the_limits(kind: str) -> None:
    rng = np.random.default_rng(55)
    for _ in range(8):
        tables = RANDOM[kind](rng)
        scene, wall = any_scene(tables), tables["loop"].get("environment", 0.0)
        assert isinstance(scene, GainScene)
        numbers = scene.answer("limits").as_json()
        for own, other in (scene.loop.gains, scene.loop.gains[::-1]):
            limit = numbers[own.name][f"{own.sense}_{own.name}"]
            if limit == 0.0:  # of a mass, with a rule that needs none
                continue
            beyond = limit * (1.02 if own.sense == "largest" else 0.98)
            near = numbers[own.name][f"at_{other.name}"]
            most = numbers[other.name].get(f"largest_{other.name}", 100.0 * near)
            for at in np.linspace(0.0, 1.5 * most, 7) + near:
                assert not judged(
                    tables, {own.name: Fraction(beyond), other.name: Fraction(at)}, wall
                )


def test_masses_that_are_all_stable_have_a_least_one_of_zero() -> None:
    """Tustin's rule: with a mass of 0 a root is at -1, with any mass above it is inside."""
    table = ROBOT | {"environment": 5e3, "sample_time": 2e-3, "rule": "trapezoid"}
    for safety in (1.0, 0.5):
        answer = answered(loop(table, safety=safety))
        assert re.search(r"least mass +above 0 kg\n +at damping +none", str(answer))
        assert "least mass     above 0 kg, 0 itself is not stable\n" in answer.in_short() + "\n"
        assert answer.all_stable
    mass = answer.as_json()["mass"]
    assert (mass["least_mass"], mass["at_damping"]) == (0.0, None)
    for mass, is_stable in ((Fraction(0), None), (Fraction(1, 10**9), True)):  # on the circle
        pair = {"mass": mass, "damping": Fraction(100)}
        assert judged({"loop": table}, pair, 5e3) is is_stable


@pytest.mark.parametrize("is_resolved", [True, False])
def test_a_region_that_is_not_resolved_leaves_the_intervals_of_each_gain(
    is_resolved: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without kp: where ki = 0 two roots stay at 1, and only some of the walls beside are stable.

    p = z^(n + 1) (z - 1) D + N (ki T z^n + kd (z^n - 1) (z - 1)/(n T)), of a free mass a
    sample late, the velocity by a window of n.
    """
    kd, period, n = 47.0, 1e-3, 20
    tables = pid({"kp": 0.0, "rule": "forward"}, of=WINDOW, at_kd=kd)
    if not is_resolved:
        nothing = empty_outline(resolved=False)

        def given_up(loop: Loop, _: float) -> Region:
            source = ScaledLoop(loop._chart, loop._scale)
            return Region(loop, region_within(curve_of(source), nothing))

        monkeypatch.setattr(affine, "region_of_loop", given_up)
    answer = answered(tables)
    assert ("was not resolved" in str(answer)) is not is_resolved
    assert answer.all_stable is is_resolved
    low, high = answer.as_json()["at_given_kd"]["ki_limits"]
    rate = 0.1 / 0.25 * period
    slow = np.exp(-rate)
    below = np.polymul([1.0, -1.0], [1.0, -slow])
    above = np.array([rate - 1.0 + slow, 1.0 - slow - rate * slow]) * period**2 / rate**2 / 0.25

    def radius(ki: float) -> float:
        window = np.append(np.append(1.0, np.zeros(n - 1)), -1.0) * kd / (n * period)
        gains = np.polymul(window, [1.0, -1.0]) + np.append([0.0, ki * period], np.zeros(n))
        p = np.polyadd(np.polymul(below, [1.0, -1.0] + [0.0] * (n + 1)), np.polymul(above, gains))
        return float(np.abs(np.roots(p)).max())

    assert low == 0.0
    assert radius(0.999 * high) < 1.0 < radius(1.001 * high)


def test_a_safety_moves_all_limits_to_the_stable_side() -> None:
    for tables in (loop(JOINT | {"substeps": 4}), loop(ROBOT)):
        plain = answered(tables).as_json()
        careful = answered(tables | {"wanted": {"safety": 0.8}}).as_json()
        for name in ("kp", "kd", "mass", "damping"):
            for key, value in plain.get(name, {}).items():
                factor = {"largest": 0.8, "least": 1.25}.get(key.split("_")[0])
                assert factor is None or careful[name][key] == pytest.approx(factor * value, 2e-3)


# ------------------------------------------------------------------------- a range of environments
def test_a_range_of_environments_is_proved_for_all_of_it() -> None:
    """Gains that are called stable are so with each of 25 environments, in exact fractions."""
    rng, seen = np.random.default_rng(56), set()
    for _ in range(12):
        low, high = sorted((10 ** rng.uniform(2, 5, 2)).tolist())
        table = ROBOT | {"environment": [low, high], "delay_samples": int(rng.integers(0, 6))}
        least = high * 1e-3 * table["delay_samples"]
        pair = {
            "mass": float(10 ** rng.uniform(-2, 1)),
            "damping": float(least * rng.uniform(0.7, 2.0) + 1.0),
        }
        tables = {"loop": table, "gains": {"own": pair}}
        answer = answered(tables, "check")
        walls = [Fraction(wall) for wall in np.geomspace(low, high, 25)[1:-1]]
        walls += [Fraction(low), Fraction(high)]
        exact = {name: Fraction(value) for name, value in pair.items()}
        own = [bool(judged(tables, exact, wall)) for wall in walls]
        verdict = answer.as_json()["gains"]["own"]["verdict"]
        assert (verdict == "stable") == all(own) == answer.all_stable
        seen.add(verdict)
    assert seen == {"stable", "unstable"}


def test_check_says_by_what_both_gains_may_be_multiplied_or_that_none_are_stable() -> None:
    """A semi-implicit step: 0 < b < 2 and 0 < a < 4 - 2 b, so b to 2 - a/2, both to 4/(a + 2 b)."""
    given = ["--set", "loop.kind=simulator", "--set", "loop.inertia=1.0", "--set", "loop.step=1.0"]
    pair = ["--set", "gains.own.kp=0.5", "--set", "gains.own.kd=0.25"]
    result = run("check", *given, *pair)
    assert result.exit_code == 0, result.stderr
    text = result.stdout
    assert "gains own       kp = 0.5 N m/rad and kd = 0.25 N m s/rad: stable\n" in text
    assert "kp by 0 to 7, kd by 0 to 7, both by 0 to 4\n" in text
    none = ["data/scenes/gains/pid.toml", "--set", "loop.kd=5000.0"]
    limits = run("limits", *none)
    assert (limits.exit_code, limits.stderr) == (1, "")
    assert "there are no stable gains" in limits.stdout
    assert "no kp at ki = 100000 N/(m s); no ki at kp = 5000 N/m\n" in run("check", *none).stdout


@pytest.mark.parametrize("mass", [0.1, 1.0, 1000.0])
def test_a_sample_late_the_least_damping_of_a_range_is_that_of_its_stiffest(mass: float) -> None:
    """One sample late it is D > Ke T for every mass (if D < 2 M/T)."""
    table = ROBOT | {"environment": [1.0, 1e4], "delay_samples": 1}
    pairs = {name: {"mass": mass, "damping": d} for name, d in (("on", 10.001), ("off", 9.999))}
    found = answered({"loop": table, "gains": pairs}, "check").as_json()["gains"]
    assert (found["on"]["verdict"], found["off"]["verdict"]) == ("stable", "unstable")


def test_limits_of_a_range_of_environments_are_those_of_the_stiffest_one_and_proved() -> None:
    ranged = answered(loop(ROBOT | {"environment": [10.0, 1e4]})).as_json()
    assert ranged["inputs"]["loop"] == "admittance control against 10 to 10000 N/m"
    stiffest = answered(loop(ROBOT)).as_json()
    for name in ("mass", "damping"):
        assert ranged[name].pop("certainty") == "proved for every environment"
        least = stiffest[name][f"least_{name}"]
        assert least <= ranged[name][f"least_{name}"] <= 1.002 * least


def test_margins_over_frequency_are_those_of_one_environment() -> None:
    tables = {"loop": ROBOT | {"environment": [10.0, 1e4]}, "wanted": {"frequency": True}}
    with pytest.raises(ValueError, match="frequency are asked for beside a range of environments"):
        answered(tables | {"gains": {"own": {"mass": 1.0, "damping": 50.0}}}, "check")


# ---------------------------------------------------------------------------------------- commands
def file_of(folder: Path, tables: Tables) -> Path:
    """A scene as a file, in inline tables."""

    def text(value: Any) -> str:
        if isinstance(value, dict):
            return "{" + ", ".join(f"{key} = {text(own)}" for key, own in value.items()) + "}"
        return json.dumps(value)

    file = folder / "scene.toml"
    lines = (f"{name} = {text(table)}" for name, table in tables.items())
    file.write_text("\n".join(lines), encoding="utf-8")
    return file


@pytest.mark.parametrize("kind", first(KINDS, 2))
def test_the_scenes_that_come_along_are_answered(kind: str, tmp_path: Path) -> None:
    file = FOLDER / f"{kind}.toml"
    scene = any_scene(tomllib.loads(file.read_text(encoding="utf-8")))
    assert isinstance(scene, GainScene)
    assert scene.unusual() == []
    for command, code in (("limits", 1), ("check", 1), ("tune", 0), ("design", 0)):
        done = run(command, file)
        assert (done.exit_code, done.stderr) == (code, ""), done.stdout
        assert done.stdout.splitlines()[0].split(maxsplit=1) == ["loop", scene.loop.words]
        printed = json.loads(run(command, file, "--json").stdout)
        assert printed["units"].keys() & {gain.name for gain in scene.loop.gains}
    explained = run("scene", "explain", file).stdout
    assert all(f"{gain.name} in {gain.unit}" in explained for gain in scene.loop.gains)
    assert run("scene", "init", "--kind", kind).stdout == file.read_text(encoding="utf-8")
    picture = tmp_path / "region.png"
    assert run("limits", file, "--plot", picture).exit_code == 1
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_check_of_stable_gains_has_the_factors_of_each_and_of_both() -> None:
    """PD by semi-implicit Euler: kp h^2/J < 4 - 2 kd h/J, 0 < kd h/J < 2."""
    tables = loop(JOINT) | {"gains": {"a": {"kp": 1e4, "kd": 20.0}, "b": {"kp": 1e5, "kd": 20.0}}}
    answers = GainScene.from_table(tables).answer("check").values
    alpha, beta, found = 0.4, 0.4, answers["gains"]["a"].as_json()
    assert found["kp_factors"] == pytest.approx([0.0, (4.0 - 2.0 * beta) / alpha])
    assert found["kd_factors"] == pytest.approx([0.0, min(2.0, (4.0 - alpha) / 2.0) / beta])
    assert found["both_factors"] == pytest.approx([0.0, 4.0 / (alpha + 2.0 * beta)])
    assert "both factors" in str(answers["gains"]["a"])
    assert "factors" not in str(answers["gains"]["b"])


def test_the_least_factor_is_told_where_the_largest_is_as_good_as_unlimited() -> None:
    """At D = Ke T w every larger mass is stable, but for the rounding of T."""
    period, environment, late, damping = 1e-3, 1e4, 3, 30.0
    loop = {"environment": environment, "sample_time": period, "delay_samples": late}
    tables = {"loop": {"kind": "admittance", **loop}}
    tables["gains"] = {"a": {"mass": 1.0, "damping": damping}}
    found = GainScene.from_table(tables).answer("check").values["gains"]["a"]
    least, largest = found.values["mass_factors"]
    assert largest > 1e12
    printed = str(jaxstab.admittance(**loop).margins(mass=1.0, damping=damping))
    assert re.search(r"mass \(kg\) +0\.0125 .* 0\.0125 to ", printed)
    for mass, is_stable in ((least * 1.001, True), (least * 0.999, False)):
        motion = np.polymul([mass / period, damping - mass / period], [1.0, -1.0])
        poles = np.roots(np.polyadd([*motion, *[0.0] * late], [environment * period, 0.0]))
        assert (np.abs(poles).max() < 1.0) == is_stable


def test_a_check_has_verdict_radius_and_all_stable_values() -> None:
    """A device of 25 g, a window of 11: two intervals of kp at this ki, by a recursion as well."""
    controller = {"sample_time": 1e-3, "velocity": {"window_samples": 11}}
    light = {"device": {"mass": 0.025, "damping": 5.0}, "controller": controller}
    pairs = {f"at {kp:g}": {"kp": kp, "ki": 1500.0} for kp in (1000.0, 4500.0, 9000.0)}
    answer = answered(pid({"kd": 13.5}, light) | {"gains": pairs}, "check")
    plant = recursions.HeldMass(0.025, 5.0, 0.0, 1e-3, 0.0)
    for name, found in answer.as_json()["gains"].items():
        gains = {"plant": plant, "period": 1e-3, "rule": "backward", "window": 11, "kd": 13.5}
        radius = recursions.radius(recursions.pid(**pairs[name], **gains))
        assert found["spectral_radius"] == pytest.approx(radius, rel=1e-9)
        assert (found["verdict"] == "stable") == (radius < 1.0)
        (low, high), other = found["kp_limits"], found["other_kp"]["1"]
        assert len(found["other_kp"]) == 1
        assert (low < found["kp"] < high) == (radius < 1.0)
        assert ("kp_factors" in found) == (radius < 1.0)
        if radius < 1.0:
            assert found["kp_factors"] == pytest.approx(
                [max(low, 0.0) / found["kp"], high / found["kp"]]
            )
        assert other[1] < low or high < other[0]
    assert "other kp 1" in str(answer)


@pytest.mark.parametrize(
    ("command", "pair", "code"),
    [
        ("check", {"kp": 3333.0, "kd": 10.0}, 0),
        ("check", {"kp": 3334.0, "kd": 10.0}, 1),
        ("limits", {"kp": 3333.0, "kd": 10.0}, 0),
        ("limits", {"kp": 3334.0, "kd": 10.0}, 1),
    ],
)
def test_the_exit_code_is_that_of_the_verdicts(
    command: str, pair: dict[str, float], code: int, tmp_path: Path
) -> None:
    """The largest kp is 2 kd/((n - 1) h) = 3333.3."""
    file = file_of(tmp_path, {"loop": JOINT | {"substeps": 4}, "gains": {"own": pair}})
    assert run(command, file).exit_code == code


def test_limits_say_in_short_what_is_largest_and_where_each_pair_stands(tmp_path: Path) -> None:
    """Of semi-implicit Euler every 4 steps, kp < 2 kd/(3 h) and kd + kp h/2 < 2 J/(4 h)."""
    pairs = {"soft": {"kp": 3333.0, "kd": 10.0}, "hard": {"kp": 3334.0, "kd": 10.0}}
    tables = loop(JOINT | {"substeps": 4}, at_kd=10.0, safety=1.0) | {"gains": pairs}
    lines = dict(
        re.split(r"  +", line, maxsplit=1)
        for line in run("limits", file_of(tmp_path, tables)).stdout.splitlines()
    )
    kp, kd = (re.match(r"(\d+\.?\d*) N m", lines[f"largest {name}"]) for name in ("kp", "kd"))
    assert kp is not None
    assert kd is not None
    assert 6240.0 < float(kp[1]) <= 6250.0
    assert 24.9 < float(kd[1]) <= 25.0
    stable = "stable range of 0 to 3333 N m/rad"
    assert lines["stable kp"] == "0 to 3333 N m/rad at 10 N m s/rad"
    assert lines["gains soft"] == f"3333 N m/rad at 10 N m s/rad, within the {stable}"
    assert lines["gains hard"] == f"3334 N m/rad at 10 N m s/rad, outside the {stable}"


def test_options_replace_what_a_file_says(tmp_path: Path) -> None:
    file = file_of(tmp_path, loop(JOINT | {"substeps": 10}))
    given = ["--set", "loop.substeps=4", "--set", "wanted.at_kd=10", "--json"]
    limits = json.loads(run("limits", file, *given).stdout)["at_given_kd"]["kp_limits"]
    assert limits == pytest.approx([0.0, 3333.33333333])
    words = [f"--set=loop.{key}={value}" for key, value in (JOINT | {"substeps": 4}).items()]
    alone = run("limits", *words, "--set", "wanted.at_kd=10", "--json").stdout
    assert json.loads(alone)["at_given_kd"]["kp_limits"] == limits
    file = file_of(tmp_path, pid({"kd": 50.0}))
    heavy = json.loads(run("limits", file, "--mass", "0.5", "--json").stdout)
    device = DEVICE | {"device": {"mass": 0.5, "damping": 0.1}}
    own = answered(pid({"kd": 50.0}, device)).as_json()
    assert heavy["ki"] == own["ki"]
    assert heavy["inputs"]["device"]["mass"] == [0.5, 0.5]


def test_several_scenes_are_compared(tmp_path: Path) -> None:
    files = [FOLDER / f"{kind}.toml" for kind in KINDS]
    done = run("limits", *files, "--csv", "-")
    rows = list(csv.DictReader(done.stdout.splitlines()))
    assert float(rows[0]["kp.largest_kp"]) == pytest.approx(6407.9, abs=1.0)
    assert rows[1]["gains.heavy.verdict"] == "stable"
    table = run("limits", *files, FOLDER.parent / "phantom.toml").stdout
    assert "largest kp" in table.splitlines()[0]
    assert run("limits", *files, "--plot", tmp_path / "a.png").exit_code == 2


def test_what_turns_has_units_of_rotation(tmp_path: Path) -> None:
    device = {"device": {"inertia": 0.01, "damping": 0.01}, "controller": DEVICE["controller"]}
    text = run("limits", file_of(tmp_path, pid({"kd": 1.0}, device))).stdout
    assert "N m/rad" in text
    assert "N m/(rad s)" in text


# ----------------------------------------------------------------------------------------- design
@pytest.mark.parametrize(
    ("tables", "name"),
    first(
        [
            (loop(JOINT | {"substeps": 4}, kp=5000.0), "step"),
            (loop(ROBOT, damping=100.0), "sample_time"),
            (loop(JOINT | {"substeps": 4}, kp=500.0), "delay_steps"),
            (loop(ROBOT, mass=0.1), "delay_samples"),
            (pid({"kd": 50.0}, kp=20000.0), "sample_time"),
            (couple(OTHER, 1.0, 2.0, stiffness=10000.0), "delay_samples"),
        ],
        2,
    ),
)
def test_design_gives_the_largest_value_that_allows_a_gain(tables: Tables, name: str) -> None:
    answer = answered(tables, "design").as_json()[name]
    largest, ((gain, goal),) = answer[f"largest_{name}"], tables["wanted"].items()
    section = "controller" if "device" in tables else "loop"
    is_whole = "delay" in name and section == "loop"

    def limit(value: float) -> float:
        changed = tables[section] | {name: int(value) if is_whole else value}
        found = answered(tables | {section: changed, "wanted": {}}).as_json()[gain]
        value = next(found[key] for key in found if key.startswith(("largest", "least")))
        return (
            value / goal
            if gain not in ("mass",) and "admittance" not in str(tables)
            else goal / value
        )

    assert limit(largest) >= 1.0 - 1e-3  # of a limit of four digits
    assert limit(largest + 1 if is_whole else 1.003 * largest) < 1.0


def test_the_largest_step_of_a_simulator_is_the_closed_one() -> None:
    """Inside the step kp h^2/J < 4 - 2 kd h/J: at kd = 0 the largest step is 2 (J/kp)^(1/2)."""
    answer = answered(loop(JOINT, kp=1000.0), "design")
    assert answer.as_json()["step"]["largest_step"] == 0.01999
    (pair,) = [line for line in str(answer).splitlines() if "largest step" in line]
    assert pair.split() == ["largest", "step", "19.99", "ms"]


def test_tune_says_where_gains_do_not_move_the_slowest_root() -> None:
    """Of two devices with one b/m it is exp(-T b/m), that of both together, for all gains."""
    coupled, simulated = (
        run("tune", FOLDER / f"{kind}.toml").stdout for kind in ("coupling", "simulator")
    )
    assert f"spectral radius                 {math.exp(-4e-4):.4g}" in coupled
    assert "do not move the slowest root" in coupled
    assert "slowest root" not in simulated


def test_tune_finds_the_deadbeat_gains_of_a_simulator() -> None:
    """z^2 = (z-1)^2 + a z + b (z-1) at a = b = 1: kp = J/h^2, kd = J/h."""
    best = answered(loop(JOINT), "tune").as_json()["least_radius"]
    assert (best["kp"], best["kd"]) == pytest.approx((25000.0, 50.0), rel=1e-3)
    assert best["verdict"] == "stable"
    assert best["spectral_radius"] < 0.02


# ------------------------------------------------------------------------------------------ study
def test_a_study_has_the_limits_and_verdicts_of_its_loops(tmp_path: Path) -> None:
    file, table = FOLDER / "simulator.toml", tmp_path / "table.csv"
    over = ["--over", "loop.inertia=0.05,0.2", "--over", "loop.substeps=1,4"]
    done = run("study", file, *over, "--csv", table, "--answer", "limits", "--answer", "verdict")
    assert done.exit_code == 0, done.stderr
    rows = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
    assert len(rows) == 8
    for row in rows:
        tables = tomllib.loads(file.read_text(encoding="utf-8"))
        tables["loop"] |= {
            "inertia": float(row["loop_inertia"]),
            "substeps": int(float(row["loop_substeps"])),
        }
        answer = answered(tables).as_json()
        assert 0.0 <= float(row["largest_kp"]) / answer["kp"]["largest_kp"] - 1.0 < 2e-3
        assert row["verdict"] == answer["gains"][row["gains"]]["verdict"]


def test_a_study_draws_environments_from_a_range() -> None:
    tables = loop(ROBOT | {"environment": [1e3, 1e4]})
    tables["gains"] = {"own": {"mass": 2.0, "damping": 30.0}}
    study = jaxstab.study(tables, {"loop.delay_samples": [2, 4]}, samples=20)
    assert dict(study.sizes) == {"loop_delay_samples": 2, "sample": 20, "gains": 1}
    walls = study.loop_environment.values
    late = study.verdict.sel(loop_delay_samples=4, gains="own").values
    loops = [jaxstab.admittance(wall, sample_time=1e-3, delay_samples=4) for wall in walls]
    expected = [int(loop.verdict(mass=2.0, damping=30.0)) for loop in loops]
    assert late.tolist() == expected
    assert set(expected) == {Verdict.STABLE, Verdict.UNSTABLE}
    low, median, high = jaxstab.quantiles(study, "least_damping").sel(loop_delay_samples=4).values
    assert 0.0 < low < median < high


# --------------------------------------------------------------------------------------- refusals
WALLS: Tables = {"device": DEVICE["device"], "controller": {"sample_time": 1e-3}}
REFUSED = [
    (loop({"inertia": 0.1}), "loop.kind is missing; give one of simulator, "),
    (loop({"kind": "simulater"}), "loop.kind is 'simulater'; did you mean 'simulator'?"),
    (
        loop({"kind": "simulator", "step": 1e-3}),
        "loop.inertia is missing; give it in kg m^2 (--set loop.inertia=...).",
    ),
    (loop(JOINT | {"substep": 4}), "loop.substep is unknown; did you mean 'substeps'?"),
    (
        loop(JOINT | {"inertia": -1.0}),
        "loop: inertia is -1.0; allowed are finite values > 0 kg m^2.",
    ),
    (loop(JOINT | {"integrator": "rk4"}), "not affine in the gains"),
    (loop(JOINT, at_mass=1.0), "wanted.at_mass is unknown"),
    (loop(JOINT) | {"device": WALLS["device"]}, "device is unknown"),
    (
        loop(JOINT) | {"walls": {}},
        "walls is unknown; give [gains.NAME] beside [loop] (--set gains.NAME.KEY=VALUE), and no "
        "--wall.",
    ),
    (loop(JOINT) | {"gains": {"a": {"kp": 1.0}}}, "gains.a.kd is missing; give it in N m s/rad."),
    (
        loop(JOINT) | {"gains": {"a": {"kp": 1.0, "kd": -1.0}}},
        "gains.a.kd is -1.0; give a finite number >= 0 in N m s/rad.",
    ),
    (
        loop(ROBOT | {"environment": [1e4, 1e3]}),
        "loop.environment is [10000.0, 1000.0]; its ends are swapped, so give [1000, 10000].",
    ),
    (loop(ROBOT | {"environment": [1e3, 1e4], "stiffness": 1.0}), "without a virtual spring"),
    (loop(ROBOT | {"environment": [1e3, 1e4]}, at_mass=1.0), "give one environment"),
    (loop(ROBOT | {"rule": "exact"}), "rule is"),
    (pid({}), "give one of kp, ki and kd"),
    (pid({"kp": 1.0, "ki": 1.0}), "give one of kp, ki and kd"),
    (pid({"kd": 1.0}, {**DEVICE, "hand": {"mass": [0.0, 1.0]}}), "is a range"),
    (couple({"mass": 0.5}, 1.0, 0.0), "loop.second.damping is missing; give it in N s/m."),
    (couple({"inertia": 0.5, "damping": 0.1}, 1.0, 0.0), "moves in another way"),
    # Keys of other loops in a scene of walls.
    ({**WALLS, "controller": {"sample_time": 1e-3, "ki": 1.0}}, '[loop] with kind = "pid"'),
    (
        {**WALLS, "controller": {"sample_time": 1e-3, "kp": 1.0}},
        "give the stiffness or the damping of a wall",
    ),
    ({**WALLS, "controller": {"rate": 1000.0}}, "controller.rate is unknown; give sample_time"),
    ({**WALLS, "walls": {"a": {"kp": 1.0}}}, "walls.a.kp is unknown; give stiffness."),
    (
        {**WALLS, "controller": {"sample_time": 1e-3, "velocity": {"time_constant": 1.0}}},
        "controller.velocity.time_constant is unknown; give cutoff, which is 1/(2 pi",
    ),
    ({**WALLS, "velocity": {"time_constant": 1.0}}, "give [controller.velocity]"),
    ({**WALLS, "gains": {}}, "gains is unknown; give [walls.NAME]"),
]


@pytest.mark.parametrize(("tables", "words"), REFUSED, ids=lambda value: str(value)[-40:])
def test_what_is_wrong_is_said_in_one_sentence(tables: Tables, words: str, tmp_path: Path) -> None:
    done = run("limits", file_of(tmp_path, tables))
    assert done.exit_code == 2
    assert done.stdout == ""
    assert_one_sentence(done.stderr)
    assert words in done.stderr


@pytest.mark.parametrize(
    "given",
    [["--mass", "3"], ["--rate", "500"], ["--hand-stiffness", "3"], ["--wall", "a", "3", "1"]],
)
def test_an_option_that_is_not_of_the_loop_is_named(given: list[str], tmp_path: Path) -> None:
    done = run("check", file_of(tmp_path, loop(JOINT)), *given)
    assert done.exit_code == 2
    assert_one_sentence(done.stderr)
    assert given[0] in done.stderr


@pytest.mark.parametrize(
    "command",
    [
        ["explore"],
        ["guard", "-o", "guard.h"],
        ["contact"],
        ["contact", "-o", "map.h5"],
        ["atlas", "spec", "--scene"],
    ],
    ids=" ".join,
)
def test_commands_for_walls_refuse_and_name_what_serves(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = run(*command, FOLDER / "simulator.toml")
    assert done.exit_code == 2
    assert_one_sentence(done.stderr)
    assert "limits, check, tune, design" in done.stderr
    assert not list(tmp_path.iterdir())


def test_other_answers_say_what_they_need(tmp_path: Path) -> None:
    file = file_of(tmp_path, loop(JOINT))
    assert "[gains.NAME] with kp and kd" in run("check", file).stderr
    assert "wanted has 0 of kp and kd" in run("design", file).stderr
    nothing = run("design", file_of(tmp_path, loop(JOINT, kp=0.0)))
    assert nothing.exit_code == 2
    assert "wanted.kp is 0.0; give a finite number > 0 in N m/rad." in nothing.stderr
    unbounded = file_of(tmp_path, loop(JOINT | {"integrator": "implicit"}, at_kd=10.0))
    limits = run("limits", unbounded)
    assert limits.exit_code == 0
    assert "largest kp                      unlimited\n" in run("limits", unbounded, "--all").stdout
    assert re.search(r"^largest kp +unlimited$", limits.stdout, re.MULTILINE)
    assert "0 to unlimited" in limits.stdout
    assert "ever larger ones decay ever faster" in run("tune", unbounded).stdout
    late = DEVICE | {"controller": {"sample_time": 1e-3, "velocity": {"window": 0.02}}}
    assert (
        "give a whole number of them"
        in run("design", file_of(tmp_path, pid({"kd": 5.0}, late, kp=100.0))).stderr
    )
