"""Every pair that limits give is one stable pair: in text, JSON and tables, read back.

Each pair goes through the verdict of its loop, and through a recursion of this test, or of
``recursions``, for values of all ranges.
"""

import csv
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaign import many
from commands import run
from scipy.linalg import expm

from jaxstab import Velocity, Verdict
from jaxstab.app.scene import GainScene, Scene, any_scene, check_walls, design_loop, scene_limits
from jaxstab.app.scene import loop_of as scene_loop
from tests.truth.random_scenes import NUMBER, RANDOM, ROBOT, SOFT, judged, loop, random_table

Pair = dict[str, float]
FOLDER = Path(__file__).parents[3] / "data" / "scenes"


def pairs_in(answer: Any, path: str = "") -> Iterator[tuple[str, Pair]]:
    """The pairs of gains in an answer as JSON has it, with their paths; limits of 0 are none."""
    limits = [key for key in answer if key.startswith(("largest_", "least_"))]
    for key, inner in answer.items():
        if isinstance(inner, dict) and key not in ("linear_rule", "inputs", "units"):
            yield from pairs_in(inner, f"{path}{key}.")
    for key in limits:
        own = key.split("_", 1)[1]
        other = next(name for name in answer if name.startswith("at_") and not name.endswith(own))
        if answer[key] is not None and answer[other] is not None:
            names = own, other.removeprefix("at_")
            yield path, dict(zip(names, (answer[key], answer[other]), strict=True))


def assert_one_pair(answer: Any, pairs: list[tuple[str, Pair]]) -> None:
    """All texts have the digits of JSON."""
    paths, told = {path for path, _ in pairs}, {tuple(pair.values()) for _, pair in pairs}
    for path, value, words in answer.leaves():
        outer, _, name = path.rpartition(".")
        if f"{outer}." in paths and name.startswith(("largest_", "least_", "at_")) and value:
            assert float(words.split()[0]) == value, (path, words)
    limits = [line for line in answer.in_short().splitlines() if " at " in line]
    for line in limits:
        if line.startswith(("largest", "least", "for all hands", "island ")):
            (said,) = re.findall(rf" {NUMBER} [^\d,]+ at {NUMBER} ", line)
            assert tuple(map(float, said)) in told, line


def growth(body: Any, period: float, wall: tuple[float, float], ages: list[int]) -> float:
    """The growth per sample of a wall on a mass, whose forces are so many samples old in turn."""
    (mass, damping, stiffness), (k, b), past = body, wall, max(ages) + 1
    rates = np.array([[0, 1, 0], [-stiffness / mass, -damping / mass, 1 / mass], [0, 0, 0]])
    moved = expm(rates * period)
    turn = np.eye(3 + past)  # position, speed, the last position, the last forces
    for age in ages:
        step = np.zeros_like(turn)
        force = np.zeros((past + 1, 3 + past))
        force[0, [0, 2]] = -k - b / period, b / period
        force[1:, 3:] = np.eye(past)
        step[:2] = moved[:2, 2:] * force[age]
        step[:2, :2] += moved[:2, :2]
        step[2, 0] = 1.0
        step[3:] = force[:-1]
        turn = step @ turn
    return float(np.abs(np.linalg.eigvals(turn)).max() ** (1.0 / len(ages)))


def turns(rng: np.random.Generator, low: int, high: int) -> list[list[int]]:
    """Ages in turn: the newest force that has arrived grows older by one sample at most."""
    every = [[age] for age in range(low, high + 1)]
    every.append([*range(low, high + 1)])
    for _ in range(6):
        ages = [low]
        for _ in range(int(rng.integers(2, 12))):
            ages.append(int(rng.integers(low, min(ages[-1] + 1, high) + 1)))
        every.append(ages)
    return every


def random_hands(rng: np.random.Generator, *, moves: bool) -> dict[str, Any]:
    """A mass with a range of hands, behind a delay of whole samples, or one that moves."""
    mass, period = 10.0 ** rng.uniform(-2.0, 0.0), 10.0 ** rng.uniform(-3.3, -2.3)
    low = int(rng.integers(0, 5))
    controller: dict[str, Any] = {"sample_time": period, "delay_samples": float(low)}
    own = mass / period
    if moves:
        high = low + int(rng.integers(1, 5))
        controller = {"sample_time": period, "delay_samples": [float(low), float(high)]}
        controller |= {"delay_is": "moving", "lost_samples": int(rng.integers(0, 3))}
    hand = {
        "mass": [0.0, mass * rng.uniform(0.2, 2.0)],
        "stiffness": [0.0, own / period * 10.0 ** rng.uniform(-5.0, -3.0)],
        "damping": [0.0, own * 10.0 ** rng.uniform(-3.0, -1.5)],
    }
    device = {"mass": mass, "damping": own * 10.0 ** rng.uniform(-3.5, -1.5)}
    return {"device": device, "hand": hand, "controller": controller}


def assert_stable_for_all(
    tables: dict[str, Any], wall: tuple[float, float], rng: np.random.Generator, *, is_lowest: bool
) -> None:
    """No hand and no sequence of delays of a scene makes a wall grow."""
    device, hand, controller = tables["device"], tables["hand"], tables["controller"]
    delays = np.ravel(controller["delay_samples"]).astype(int)
    low, high = int(delays[0]), int(delays[-1]) + controller.get("lost_samples", 0)
    for _ in range(1 if is_lowest else 8):
        mass, stiffness, damping = (
            ends[0] if is_lowest else float(rng.choice([*ends, rng.uniform(*ends)]))
            for ends in (hand["mass"], hand["stiffness"], hand["damping"])
        )
        body = device["mass"] + mass, device["damping"] + damping, stiffness
        for ages in turns(rng, low, high):
            rate = growth(body, controller["sample_time"], wall, ages)
            assert rate < 1.0 + 1e-10, (tables, wall, body, ages, rate)


def assert_walls(tables: dict[str, Any], rng: np.random.Generator) -> int:
    """All pairs of a scene of walls are stable."""
    scene = Scene.from_table(tables)
    answer = scene_limits(scene)
    pairs = [*pairs_in(answer.as_json())]
    assert_one_pair(answer, pairs)
    soft = SOFT * max((pair["stiffness"] for _, pair in pairs), default=0.0)
    for path, pair in pairs:
        wall = pair["stiffness"], pair["damping"]
        is_lowest = path == "best." and scene.controller.moves
        if path == "all_hands." or is_lowest:
            asked = {**tables, "walls": {"a": pair}, "wanted": {"measures": []}}
            if is_lowest:
                asked["hand"] = {name: ends[0] for name, ends in tables["hand"].items()}
            found = check_walls(Scene.from_table(asked)).walls["a"]
            assert found.verdict == Verdict.STABLE, (tables, path, pair)
            assert_stable_for_all(tables, wall, rng, is_lowest=is_lowest)
            continue
        own = scene_loop(scene)
        if path.startswith("windows."):
            velocity = Velocity.difference(int(path.split(".")[1]))
            own = replace(own, velocity=velocity)
        assert own.verdict(wall[0] or soft, wall[1]) == Verdict.STABLE, (tables, path, pair)
    return len(pairs)


def assert_gains(tables: dict[str, Any]) -> int:
    """All pairs of a scene of other gains are stable, for each of its environments."""
    scene = any_scene(tables)
    assert isinstance(scene, GainScene)
    answer = scene.answer("limits")
    pairs = [*pairs_in(answer.as_json())]
    assert_one_pair(answer, pairs)
    low, high = scene.environment
    for path, pair in pairs:
        if not all(map(np.isfinite, pair.values())):
            continue
        own = {gain.name: pair[gain.name] for gain in scene.loop.gains}
        assert scene.stable.verdict(*own.values()) == Verdict.STABLE, (tables, path, pair)
        exact = {name: Fraction(value) for name, value in own.items()}
        for wall in np.geomspace(low, high, 1 if low == high else 9).tolist():
            assert judged(tables, exact, wall), (tables, pair, wall)
    return len(pairs)


def random_range(rng: np.random.Generator) -> dict[str, Any]:
    low = float(10 ** rng.uniform(1.0, 4.0))
    table = {**ROBOT, "environment": [low, low * float(10 ** rng.uniform(0.1, 2.0))]}
    table |= {"sample_time": float(10 ** rng.uniform(-3.5, -2.0))}
    table |= {"delay_samples": int(rng.integers(0, 6))}
    return loop(table | {"rule": str(rng.choice(["forward", "explicit", "backward"]))})


KINDS = (*RANDOM, "environments", "walls", "hands", "moving")


def assert_pairs(kind: str, seed: int) -> int:
    rng = np.random.default_rng([83, KINDS.index(kind), seed])
    if kind in ("walls", "hands", "moving"):
        tables = random_table(rng) if kind == "walls" else random_hands(rng, moves=kind == "moving")
        safe = {"safety": float(rng.uniform(0.5, 1.0))} if rng.random() < 0.3 else {}
        return assert_walls({**tables, "wanted": safe}, rng)
    tables = random_range(rng) if kind == "environments" else RANDOM[kind](rng)
    if rng.random() < 0.3:
        tables["wanted"] = {"safety": float(rng.uniform(0.5, 1.0))}
    return assert_gains(tables)


@pytest.mark.parametrize("kind", KINDS)
def test_pairs_of_limits_are_stable_in_text_and_json(kind: str) -> None:
    assert assert_pairs(kind, 0) > 0


@pytest.mark.campaign
@pytest.mark.parametrize("kind", KINDS)
def test_pairs_of_limits_of_many_scenes_are_stable_in_text_and_json(kind: str) -> None:
    count = many(64, small=4)  # of eight kinds
    assert sum(assert_pairs(kind, seed) for seed in range(1, 1 + count)) > count


def test_text_json_and_tables_have_one_proved_pair(tmp_path: Path) -> None:
    """The shipped admittance, of all environments: 0.01585 kg alone is not stable at 1e4 N/m."""
    file = FOLDER / "gains" / "admittance.toml"
    found = json.loads(run("limits", file, "--json").stdout)
    text, table = run("limits", file).stdout, tmp_path / "limits.csv"
    run("limits", file, "--csv", table)
    (row,) = csv.DictReader(table.read_text(encoding="utf-8").splitlines())
    for name, other in (("mass", "damping"), ("damping", "mass")):
        pair = found[name][f"least_{name}"], found[name][f"at_{other}"]
        assert [*pair] == [float(row[f"{name}.{key}"]) for key in (f"least_{name}", f"at_{other}")]
        assert f"{pair[0]:g} " in text
        assert f" at {pair[1]:g} " in text
        gains = {name: Fraction(pair[0]), other: Fraction(pair[1])}
        for wall in (1e3, 2e3, 5e3, 1e4):
            assert judged({"loop": {**ROBOT}}, gains, wall)


def test_limits_of_far_environments_are_proved_for_both_ends() -> None:
    """0.1037 kg at 109.379 N s/m grows by 2.92 per sample at the soft end; 0.226 kg is stable."""
    ends = 2110.75, 28864.88
    table = {"kind": "admittance", "environment": [*ends], "sample_time": 3.789e-3}
    tables = loop(table | {"delay_samples": 1})
    mass = any_scene(tables).answer("limits").as_json()["mass"]
    assert mass["least_mass"] <= 0.22617
    assert mass["certainty"] == "proved for every environment"
    assert assert_gains(tables) == 2
    refuted = {"mass": Fraction("0.1037"), "damping": Fraction("109.379")}
    assert not judged(tables, refuted, ends[0])


def test_a_damping_that_is_stable_above_0_only_is_called_so() -> None:
    """Without a delay the product of the roots is 1 for every mass at a damping of 0."""
    answer = any_scene(loop(ROBOT | {"delay_samples": 0})).answer("limits")
    assert "least damping  above 0 N s/m, 0 itself is not stable" in answer.in_short()
    damping = answer.as_json()["damping"]
    assert (damping["least_damping"], damping["at_mass"]) == (0.0, None)
    for value, is_stable in ((Fraction(0), None), (Fraction(1, 1000), True)):
        gains = {"mass": Fraction(1), "damping": value}
        assert judged(loop(ROBOT | {"delay_samples": 0}), gains, 1e4) is is_stable


LOST = {
    "device": {"mass": 0.1, "damping": 0.5},
    "hand": {"mass": [0.0, 0.2], "stiffness": [0.0, 400.0], "damping": [0.0, 2.0]},
    "controller": {"sample_time": 2e-3, "delay": [8e-3, 16e-3], "lost_samples": 1},
}


def test_design_is_for_every_hand() -> None:
    """The lightest hand allows longer delays than the scene's hand of 400 N/m."""
    controller = {"sample_time": 1e-3, "delay_samples": 1.0}
    tables = {**LOST, "controller": controller, "wanted": {"stiffness": 3000.0}}
    tables["hand"] = {"mass": [0.0, 0.5], "stiffness": [0.0, 400.0], "damping": [0.0, 5.0]}
    answer = design_loop(Scene.from_table(tables)).as_json()
    assert answer["certainty"] == "proved for every hand"
    period, at = answer["sample_time"]["largest_sample_time"], answer["sample_time"]["at_damping"]
    rates = {  # of the last digit, and of 2 % more
        share: max(
            growth((0.1 + mass, 0.5 + b, k), share * period, (3000.0, at), [1])
            for mass in (0.0, 0.1, 0.5)
            for k in (0.0, 200.0, 400.0)
            for b in (0.0, 5.0)
        )
        for share in (1.0, 1.02)
    }
    assert rates[1.0] < 1.0 < rates[1.02]


@pytest.mark.parametrize("longest", [12e-3, 16e-3])
def test_a_limit_for_all_hands_counts_lost_samples(longest: float) -> None:
    """A hand of 400 N/m makes 67.69 N/m at 2.317 N s/m, once called that of 16 ms, grow."""
    stiff = (0.1, 0.5, 400.0), 2e-3, (67.69, 2.317)
    assert max(growth(*stiff, ages) for ages in turns(np.random.default_rng(8), 4, 9)) > 1.002
    tables = {**LOST, "controller": {**LOST["controller"], "delay": [8e-3, longest]}}
    answer = scene_limits(Scene.from_table(tables))
    assert answer.all_hands.certainty == "proved for every hand and every sequence of delays"
    wall = answer.all_hands.largest_stiffness, answer.all_hands.at_damping
    assert 0.0 < wall[0] < answer.best.largest_stiffness
    period, rng = LOST["controller"]["sample_time"], np.random.default_rng(8)
    samples = [round(delay / period) for delay in tables["controller"]["delay"]]
    counted = {"sample_time": period, "delay_samples": samples, "lost_samples": 1}
    assert_stable_for_all({**tables, "controller": counted}, wall, rng, is_lowest=False)
