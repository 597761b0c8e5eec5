"""Certificates of walls, and the program that confirms them in fractions, without jaxstab."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaign import many
from commands import run

from jaxstab import tables
from jaxstab.app.scene import Scene, check_walls
from jaxstab.app.scene.exports import certificate

READER = Path(__file__).parents[3] / "data" / "check" / "check_wall.py"
SCENE = {
    "device": {"mass": 0.25, "damping": 0.1},
    "hand": {"mass": 0.1, "stiffness": 50.0, "damping": 1.0},
    "controller": {"sample_time": 1e-3, "delay": 1.5e-3, "velocity": {"window_samples": 8}},
    "walls": {"soft": {"stiffness": 500.0, "damping": 5.0}},
}


@pytest.fixture(scope="module")
def reader() -> Any:
    spec = importlib.util.spec_from_file_location("check_wall", READER)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def said_of(reader: Any, claims: dict[str, Any], folder: Path) -> int:
    """The exit code of the program for a file with these claims."""
    file = folder / "wall.json"
    file.write_text(json.dumps(claims))
    return int(reader.main(file))


def scene(seed: int) -> dict[str, Any]:
    """A loop of one mass with a hand, a delay and an estimator, and a wall of any size."""
    rng = np.random.default_rng([56, seed])
    period, mass = 10.0 ** rng.uniform(-4.0, -2.0), 10.0 ** rng.uniform(-2.0, 1.0)
    late = float(rng.integers(0, 6)) + float(rng.choice([0.0, 0.5, rng.uniform()]))
    size = 10.0 ** rng.uniform(-2.0, 0.5)
    estimators: list[dict[str, Any]] = [
        {"window_samples": int(rng.integers(1, 18))},
        {"cutoff": float(rng.uniform(0.005, 0.4)) / period, "order": int(rng.integers(1, 4))},
    ]
    return {
        "device": {"mass": mass, "damping": float(rng.uniform(0.0, 0.1)) * mass / period},
        "hand": {
            "mass": float(rng.uniform(0.0, 1.0)) * mass,
            "stiffness": float(rng.uniform(0.0, 0.01)) * mass / period**2,
            "damping": float(rng.uniform(0.01, 0.1)) * mass / period,
        },
        "controller": {
            "sample_time": period,
            "delay_samples": late,
            "velocity": estimators[int(rng.integers(2))],
        },
        "walls": {
            "one": {
                "stiffness": float(rng.uniform(0.0, 0.1)) * size * mass / period**2,
                "damping": float(rng.uniform(0.0, 0.5)) * size * mass / period,
            }
        },
    }


def test_the_program_is_short_and_imports_the_standard_library_alone() -> None:
    lines = READER.read_text().splitlines()
    imports = [line for line in lines if line.startswith(("import ", "from "))]
    assert len(lines) <= 250
    known = {"contextlib", "fractions", "itertools", "json", "math", "operator", "re", "sys"}
    assert {line.split()[1] for line in imports} <= known


@pytest.mark.parametrize("seed", range(8))
def test_claims_are_confirmed(seed: int, reader: Any, tmp_path: Path) -> None:
    assert said_of(reader, certificate(Scene.from_table(scene(seed))), tmp_path) == 0


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(100, 100 + many(1000, 25)))
def test_claims_are_confirmed_at_large(seed: int, reader: Any, tmp_path: Path) -> None:
    assert said_of(reader, certificate(Scene.from_table(scene(seed))), tmp_path) == 0


def test_both_verdicts_and_unstable_gaps_are_among_the_claims() -> None:
    claims = [certificate(Scene.from_table(scene(seed)))["walls"]["one"] for seed in range(40)]
    assert {claim["verdict"] for claim in claims} == {"stable", "unstable"}


def changed(claims: dict[str, Any], path: str, value: str) -> dict[str, Any]:
    """A copy of claims with one value in it replaced."""
    copy = json.loads(json.dumps(claims))
    *outer, last = path.split(".")
    place = copy
    for key in outer:
        place = place[int(key) if key.isdigit() else key]
    place[int(last) if last.isdigit() else last] = value
    return dict(copy)


def test_what_was_changed_is_refused(
    reader: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    claims = certificate(Scene.from_table(SCENE))
    assert said_of(reader, claims, tmp_path) == 0
    ((low, high),) = claims["walls"]["soft"]["stiffness_intervals"]
    place = "walls.soft.stiffness_intervals.0"
    for path, value in (
        ("walls.soft.verdict", "unstable"),
        (f"{place}.1", repr(float(high) * (1.0 + 3e-9))),
        (f"{place}.1", repr(float(high) * (1.0 - 3e-9))),
        (f"{place}.0", repr(float(low) + 3e-9 * float(high))),
        (f"{place}.0", repr(float(low) - 3e-9 * float(high))),
        ("walls.soft.loop.mass", "1/3"),
        ("walls.soft.loop.damping", "1"),
        ("walls.soft.loop.stiffness", "51"),
        ("walls.soft.loop.sample_time", "1/999"),
        ("walls.soft.loop.delay_samples", "8/5"),
        ("walls.soft.loop.velocity.0.0", "1/7"),
        ("walls.soft.loop.position", [["99/100"], ["1"]]),
    ):
        assert said_of(reader, changed(claims, path, value), tmp_path) == 1, path
        assert "REFUSED" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("format", "other"),
        ("format", "jaxstab wall 1"),
        ("walls.soft.verdict", "maybe"),
        ("walls.soft.loop.mass", "0"),
        ("walls.soft.stiffness_intervals.0", ["2", "1"]),
        ("walls.soft.stiffness_intervals.0", "12"),
        ("walls.soft.stiffness", "much"),
        # Claims that would not be read.
        ("proved", "for every hand"),
        ("walls.soft.damping_intervals", [["0", "1"]]),
        ("walls.soft.loop.friction", "1"),
        ("walls.soft: stable: confirmed\nsoft", {}),
        # What a number is not.
        ("walls.soft.stiffness", True),
        ("walls.soft.stiffness", 500.0),
        ("walls.soft.loop.delay_samples", True),
        ("walls.soft.loop.delay_samples", "1e400"),
        ("walls.soft.loop.delay_samples", "1_0"),
        ("walls.soft.loop.damping", "1e400"),
        ("walls.soft.damping", "1e999999999"),
        ("walls.soft.damping", "1e9_999_999_99"),
        ("walls.soft.stiffness_intervals.0", ["0", "1e-999999999"]),
        # Loops of another kind, about which the claims say nothing.
        ("walls.soft.loop.velocity", {"butterworth": "1"}),
        ("walls.soft.loop.velocity", [["1"], ["0", "1"]]),
        ("walls.soft.loop.velocity", [[], ["1"]]),
        ("walls.soft.loop.velocity", ["1", "1"]),
        ("walls.soft.loop.velocity", [["1"] * 503, ["1"]]),
        ("walls.soft.loop.mass", "-1/4"),
        ("walls.soft.loop.sample_time", "-1/1000"),
        ("walls.soft.loop.delay_samples", "-1"),
    ],
)
def test_a_file_that_cannot_be_read_is_named(
    path: str, value: Any, reader: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    claims = certificate(Scene.from_table(SCENE))
    assert said_of(reader, changed(claims, path, value), tmp_path) == 2
    assert "wall.json: " in capsys.readouterr().err
    assert reader.main(tmp_path / "absent.json") == 2
    (tmp_path / "deep.json").write_text("[" * 100_000)
    assert reader.main(tmp_path / "deep.json") == 2
    (tmp_path / "other.json").write_text('{"format": "jaxstab wall 2"}')
    assert reader.main(tmp_path / "other.json") == 2
    said = capsys.readouterr().err
    assert said.endswith("has not the keys format, walls alone\n")
    assert "Error: " not in said


def test_a_key_that_is_given_twice_is_refused(
    reader: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """JSON readers take the last one: who reads the first sees other claims."""
    text = json.dumps(certificate(Scene.from_table(SCENE)))
    (tmp_path / "twice.json").write_text(text.replace('"walls":', '"walls": {}, "walls":'))
    assert reader.main(tmp_path / "twice.json") == 2
    assert "given twice" in capsys.readouterr().err


def test_the_order_of_the_keys_says_nothing(reader: Any, tmp_path: Path) -> None:
    claims = certificate(Scene.from_table(SCENE))
    wall = claims["walls"]["soft"]
    wall["loop"] = dict(sorted(wall["loop"].items()))
    claims["walls"]["soft"] = dict(sorted(wall.items()))
    assert said_of(reader, claims, tmp_path) == 0


def test_a_damper_on_a_device_that_nothing_holds_is_confirmed(reader: Any, tmp_path: Path) -> None:
    """Its p(z) has a root at 1, which no number of bits tells from one inside."""
    free = {"walls": {"damper": {"stiffness": 0.0, "damping": 5.0}}, "hand": {}}
    assert said_of(reader, certificate(Scene.from_table(SCENE | free)), tmp_path) == 0


def test_the_program_says_what_it_is_asked_with() -> None:
    for given, code in ((["--help"], 0), ([], 2), (["a.json", "b.json"], 2)):
        asked = [sys.executable, str(READER), *given]
        said = subprocess.run(asked, capture_output=True, text=True, check=False)
        assert said.returncode == code
        assert "python check_wall.py wall.json" in said.stdout


def test_check_writes_a_certificate(reader: Any, tmp_path: Path) -> None:
    phantom = READER.parents[1] / "scenes" / "phantom.toml"
    file = tmp_path / "wall.json"
    done = run("check", phantom, "--certificate", file)
    assert done.exit_code == 1  # one of its walls is unstable
    assert [*json.loads(file.read_text())["walls"]] == ["passive", "chai3d", "too_stiff"]
    assert reader.main(file) == 0


# Walls next to the end of the stable ones. The proof is of the pole of the low pass in float64, not
# of the number that the cut-off makes it.
NEXT_TO_THE_END = {
    "device": {"mass": 0.1, "damping": 0.3},
    "controller": {"sample_time": 1e-4, "delay": 1e-4, "velocity": {"cutoff": 7.7}},
    "walls": {"end": {"stiffness": 4112.56001091101, "damping": 7.36}},
}


def test_the_loop_is_that_of_the_proof(reader: Any, tmp_path: Path) -> None:
    own, verdicts = NEXT_TO_THE_END, set()
    for above in range(-4, 5):
        stiffness = own["walls"]["end"]["stiffness"] * (1.0 + above * 2.0**-52)
        walls = {"end": own["walls"]["end"] | {"stiffness": stiffness}}
        claims = certificate(Scene.from_table(own | {"walls": walls}))
        verdicts.add(claims["walls"]["end"]["verdict"])
        assert said_of(reader, claims, tmp_path) == 0
    assert verdicts == {"stable", "unstable"}


@pytest.mark.parametrize(
    "filters",
    [
        {"velocity": {"cutoff": 30.0, "kind": "butterworth", "order": 3}},
        {"velocity": {"factor": 0.3}},
        {"velocity": {"polynomial": 2, "window_samples": 9}},
        {"velocity": {"window": 0.004}, "position": {"cutoff": 200.0, "order": 2}},
    ],
)
def test_every_estimator_and_filter_is_confirmed(
    filters: dict[str, Any], reader: Any, tmp_path: Path
) -> None:
    controller = {"controller": {"sample_time": 1e-3, "delay": 1.5e-3} | filters}
    assert said_of(reader, certificate(Scene.from_table(SCENE | controller)), tmp_path) == 0


@pytest.mark.parametrize("file", sorted((READER.parents[1] / "scenes").glob("*.toml")))
def test_scenes_that_are_shipped_are_confirmed(
    file: Path, reader: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = {"wanted": {"measures": []}}
    scene = Scene.from_table(tables.read_table(file, "scene") | asked)
    assert said_of(reader, certificate(scene), tmp_path) == 0
    said = capsys.readouterr().out
    for name, wall in check_walls(scene).walls.items():
        hand = f" with {wall.worst_hand.in_words(scene.units)}" if wall.worst_hand else ""
        assert f"{name}{hand}: {wall.verdict.name.lower()}: confirmed" in said


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"device": {"mass": 0.1, "damping": 0.1, "actuator": {"bandwidth": 90.0}}}, "actuator"),
        ({"hand": {"mass": 0.1, "grip": {"stiffness": 2e3}}}, "leave out modes"),
        ({"controller": {"sample_time": 1e-3, "delay": [1e-3, 2e-3]}}, "one constant delay"),
        ({"walls": {}}, "at least one wall"),
    ],
)
def test_what_the_program_cannot_follow_is_refused(table: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        certificate(Scene.from_table(SCENE | table))
