"""Atlases asked in SI units: by loops, and by scenes, whose specifications they are built from."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import assert_one_sentence, run, run_code, run_process

import jaxstab
from jaxstab import AtlasSpec, FittedAxis, HapticLoop, LoopAtlas, Velocity, Verdict
from jaxstab.scene import Scene
from jaxstab.scene.atlas import atlas_spec, spec_text
from jaxstab.scene.loops import corners_of, loop_of_member

ROOT = Path(__file__).parents[1]
GOLDEN = ROOT / "data" / "golden"
PLAIN, WINDOW = GOLDEN / "atlas-v3.h5", GOLDEN / "atlas-v3-window.h5"

SCENE = """
[device]
mass = 0.2
damping = 0.5
[hand]
mass = [0.0, 0.1]
stiffness = [0.0, 100.0]
damping = [0.0, 1.0]
[controller]
sample_time = 0.001
delay_samples = 1.0
[controller.velocity]
window = 0.005
[walls.soft]
stiffness = 500.0
damping = 5.0
[walls.stiff]
stiffness = 15000.0
damping = 5.0
"""

TURNING = """
[device]
inertia = 1e-3
damping = 1e-3
[hand]
inertia = [0.0, 1e-3]
stiffness = [0.0, 0.5]
[controller]
sample_time = 0.001
delay_samples = 1.0
[controller.velocity]
cutoff = 70.0
[controller.position]
window_samples = 3
[wanted]
mass_tolerance = 0.1
delay_tolerance = 7e-4
"""


def some_view(file: Path, rng: np.random.Generator) -> LoopAtlas:
    """A golden atlas, asked by a loop within it, of any mass and rate."""
    mass, period = 10.0 ** rng.uniform(-3.0, 1.0), 10.0 ** rng.uniform(-4.0, -2.0)
    gamma, delta = rng.uniform(0.0, 9.9e-4), rng.uniform(0.0, 0.0149)
    share, is_plain = rng.uniform(0.1, 0.9), file == PLAIN
    delay = rng.uniform(0.0, 1.49) if is_plain else rng.choice([0.0, 1.0, 1.5])
    loop = HapticLoop(
        device_mass=share * mass,
        hand_mass=(1.0 - share) * mass,
        device_damping=share * delta * mass / period,
        hand_damping=(1.0 - share) * delta * mass / period,
        hand_stiffness=gamma * mass / period**2,
        sample_time=period,
        delay=delay * period,
        velocity=None if is_plain else Velocity.difference(window=5.0 * period),
    )
    return jaxstab.open_atlas(file).for_loop(loop)


@pytest.mark.parametrize("file", [PLAIN, WINDOW])
def test_verdicts_are_those_of_the_loop(file: Path) -> None:
    rng, decided = np.random.default_rng(5), 0
    for _ in range(20):
        view = some_view(file, rng)
        loop = view.loop
        alpha, beta = rng.uniform(-0.009, 0.079, 50), rng.uniform(0.01, 0.5, 50)
        stiffness, damping = loop.stiffness(alpha), loop.damping(beta)
        answer = view.query(stiffness, damping, "undecided")
        codes = view.verdict(stiffness, damping, "undecided")
        assert np.array_equal(answer.verdict, codes)
        known = codes != Verdict.UNDECIDED
        decided += int(known.sum())
        assert np.array_equal(codes[known], loop.verdict(stiffness, damping)[known])
        exact = view.verdict(stiffness[known], damping[known], exact=True)
        assert np.array_equal(exact, codes[known])
    assert decided > 500


@pytest.mark.campaign
@pytest.mark.parametrize("file", [PLAIN, WINDOW])
def test_limits_are_within_those_of_the_loop_and_near(file: Path) -> None:
    rng, near = np.random.default_rng(6), []
    for _ in range(20):
        view = some_view(file, rng)
        damping = view.loop.damping(rng.uniform(0.02, 0.4, 5))
        limits, exact = view.stiffness_limits(damping), view.loop.stiffness_limits(damping)
        known = ~np.isnan(limits[:, 0])
        proved, true = limits[known], exact[known]
        slack = 1e-9 * np.abs(true).max(initial=1.0)
        assert np.all(proved[:, 0] >= true[:, 0] - slack)
        assert np.all(proved[:, 1] <= true[:, 1] + slack)
        for end in np.clip([1e-9, 0.5, 1.0 - 1e-9], 0.0, 1.0):
            inside = proved[:, 0] + end * (proved[:, 1] - proved[:, 0])
            assert np.all(view.verdict(inside, damping[known]) == Verdict.STABLE)
        near += (np.ptp(proved, axis=1) / np.ptp(true, axis=1)).tolist()
    assert len(near) > 20
    assert file != PLAIN or np.median(near) > 0.9


def test_3_no_bound_where_the_stable_set_crosses_an_end_of_beta(tmp_path: Path) -> None:
    """Its counter-example: the bound was 6847.9 N/m, and (10000, 30) is stable."""
    spec = AtlasSpec(
        alpha=np.linspace(0.0, 0.3, 16), beta=np.linspace(0.0, 0.1, 16), gamma=[0.0], delta=[0.015],
        delay=[1.0], products=["alpha_limits"],
    )  # fmt: skip
    atlas = jaxstab.build_atlas(spec, tmp_path / "a.h5")
    loop = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3, delay=1e-3)
    assert loop.verdict(10000.0, 30.0) == Verdict.STABLE
    largest = atlas.for_loop(loop).largest_stiffness()
    assert 6000.0 < largest.stiffness < 6848.0
    assert largest.bound == np.inf
    assert atlas.max_alpha(gamma=0.0, delta=0.015, delay=1.0).bound == np.inf
    wide = replace(spec, beta=np.linspace(-0.05, 1.0, 16))
    whole = jaxstab.build_atlas(wide, tmp_path / "b.h5").for_loop(loop).largest_stiffness()
    assert whole.stiffness <= loop.limits().stiffness * (1.0 + 1e-9)
    assert loop.limits().stiffness <= whole.bound < np.inf


def test_the_largest_stiffness_is_proved_and_so_is_its_bound() -> None:
    rng = np.random.default_rng(7)
    for _ in range(20):
        view = some_view(PLAIN, rng)
        largest, exact = view.largest_stiffness(), view.loop.limits().stiffness
        if np.isnan(largest.stiffness):
            continue
        below = largest.stiffness * (1.0 - 1e-12)
        assert view.verdict(below, largest.damping) == Verdict.STABLE
        assert view.loop.verdict(below, largest.damping) == Verdict.STABLE
        assert largest.stiffness <= exact * (1.0 + 1e-9)
        highest = view.loop.stiffness(0.2)  # of the golden atlas
        assert min(exact, highest) <= largest.bound * (1.0 + 1e-9)


def test_one_wall_and_arrays_have_the_same_answers() -> None:
    view = some_view(PLAIN, np.random.default_rng(8))
    stiffness, damping = view.loop.stiffness(0.05), view.loop.damping(0.3)
    one, many = view.verdict(stiffness, damping), view.verdict([[stiffness]] * 2, damping)
    assert (one.shape, many.shape) == ((), (2, 1))
    assert np.all(many == one)
    assert view.stiffness_limits(damping).shape == (2,)
    assert "for HapticLoop" in repr(view)


MASS = {"device_mass": 0.2, "device_damping": 1.0, "sample_time": 1e-3}


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({**MASS, "device_damping": 10.0}, "delta of the loop is 0.0499"),
        ({**MASS, "hand_stiffness": 1000.0}, "gamma of the loop is 0.005"),
        ({**MASS, "delay": 2e-3}, "delay of the loop is 2.0"),
        ({**MASS, "velocity": Velocity.difference(samples=4)}, "the loop has velocity: "),
        ({"device": jaxstab.Device.modes([], mass=0.2, damping=1.0).with_actuator(100.0),
          "sample_time": 1e-3}, "one mass"),
    ],
)  # fmt: skip
def test_loops_of_which_an_atlas_says_nothing_are_refused(
    given: dict[str, object], words: str
) -> None:
    with pytest.raises((ValueError, TypeError), match=words) as refused:
        jaxstab.open_atlas(PLAIN).for_loop(HapticLoop(**given))  # type: ignore[arg-type]
    assert str(refused.value).count(". ") == 0


def test_other_bad_input_is_refused() -> None:
    window = Velocity.difference(window=0.005)
    loop = HapticLoop(**MASS, delay=0.0005, velocity=window)
    with pytest.raises(ValueError, match=r"delay of the loop is 0\.5 samples, .* only 0, 1, 1\.5"):
        jaxstab.open_atlas(WINDOW).for_loop(loop)
    with pytest.raises(TypeError, match=r"give a jaxstab\.HapticLoop"):
        jaxstab.open_atlas(PLAIN).for_loop((0.1, 0.0))
    view = jaxstab.open_atlas(PLAIN).for_loop(HapticLoop(**MASS))
    for call in (
        lambda: view.verdict(1e9, 1.0),
        lambda: view.query(float("nan"), 1.0),
        lambda: view.stiffness_limits(1e9),
    ):
        with pytest.raises(ValueError, match=r"^(stiffness|damping) is ") as refused:
            call()
        assert "alpha" not in str(refused.value)
    assert view.verdict(1e9, 1.0, "undecided") == Verdict.UNDECIDED


def test_a_loop_asks_an_atlas_without_jax() -> None:
    code = f"""
import sys, jaxstab
loop = jaxstab.HapticLoop(device_mass=0.2, device_damping=1.0, sample_time=1e-3)
view = jaxstab.open_atlas({str(PLAIN)!r}).for_loop(loop)
view.verdict(100.0, 1.0), view.largest_stiffness(), view.stiffness_limits(1.0)
assert not {{"jax", "h5py", "matplotlib"}} & set(sys.modules)
"""
    assert run_code(code, ROOT).stderr == ""


# ------------------------------------------------------------------------------------------ scenes


def scene_file(folder: Path, text: str) -> Path:
    path = folder / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("text", [SCENE, TURNING, ""])
def test_a_specification_is_of_the_ranges_of_its_scene(tmp_path: Path, text: str) -> None:
    path = scene_file(tmp_path, text) if text else ROOT / "data" / "scenes" / "omega.toml"
    scene = Scene.from_file(path)
    printed = run("atlas", "spec", "--scene", path)
    assert printed.exit_code == 0, printed.stderr
    assert printed.stdout == spec_text(scene, str(path))
    spec = AtlasSpec.from_toml(printed.stdout)
    assert spec == atlas_spec(scene)
    for corner in corners_of(scene):
        loop = loop_of_member(scene, corner)
        values = {"gamma": loop.gamma, "delta": loop.delta, "delay": loop.delay_samples}
        for name, value in values.items():
            nodes = getattr(spec, name)
            assert nodes[0] <= value <= nodes[-1]
        assert AtlasSpec(**loop.filters).filters == spec.filters


@pytest.mark.campaign
def test_a_specification_of_a_scene_is_planned(tmp_path: Path) -> None:
    spec = atlas_spec(Scene.from_file(scene_file(tmp_path, TURNING)))
    axes = {"alpha": FittedAxis(12), "beta": FittedAxis(12), "gamma": spec.gamma[-1:]}
    small = replace(spec, **axes, delta=spec.delta[-1:], limit_cells=8, delay=spec.delay[-1:])
    planned = run("atlas", "plan", scene_file(tmp_path, small.to_toml()))
    assert planned.exit_code == 0, planned.stderr
    assert "verdict: 144 values" in planned.stdout


def test_tolerances_widen_the_ranges_and_whole_delays_are_nodes() -> None:
    scene = Scene.from_file(ROOT / "data" / "scenes" / "omega.toml")
    wide = run(
        *("atlas", "spec", "--scene", ROOT / "data" / "scenes" / "omega.toml"),
        *("--mass-tolerance", "0.1", "--delay-tolerance", "0.0005"),
    )
    spec, narrow = AtlasSpec.from_toml(wide.stdout), atlas_spec(scene)
    assert spec.delay == (0.5, 1.0, 1.5)
    assert narrow.delay == (1.0,)
    assert (narrow.delay_cells, spec.delay_cells) == (0, 32)
    assert spec.gamma[-1] == pytest.approx(narrow.gamma[-1] / 0.9)  # type: ignore[index]
    assert "mass of the device: 0.225 to 0.275 kg" in wide.stdout


def test_the_walls_of_a_scene_are_asked_at_each_corner(tmp_path: Path) -> None:
    path = scene_file(tmp_path, SCENE)
    scene = Scene.from_file(path)
    asked = run("atlas", "query", WINDOW, "--scene", path, "--exact")
    assert asked.exit_code == 1, asked.stderr
    rows = list(csv.DictReader(asked.stdout.splitlines()))
    corners = corners_of(scene)
    assert len(rows) == 2 * len(corners) == 16
    for row, corner in zip(rows, corners * 2, strict=True):
        assert float(row["hand_mass"]) == corner.hand.mass
        wall = float(row["stiffness"]), float(row["damping"])
        truth = Verdict(int(loop_of_member(scene, corner).verdict(*wall)))
        assert row["verdict"] == truth.name.lower()
    assert {row["wall"] for row in rows} == {"soft", "stiff"}
    assert {row["verdict"] for row in rows} == {"stable", "unstable"}
    stiff = run("atlas", "query", WINDOW, "--scene", path, "--stiffness", "1e9", "--damping", "1")
    assert stiff.stdout.count("unstable,cell") == len(corners)  # lemma B21
    loops = [loop_of_member(scene, corner) for corner in corners]
    assert {int(loop.verdict(1e9, 1.0)) for loop in loops} == {Verdict.UNSTABLE}
    far = run("atlas", "query", WINDOW, "--scene", path, "--stiffness", "1", "--damping", "1e9")
    assert far.stdout.count("undecided,outside") == len(corners)
    wall = "--stiffness", "500", "--damping", "5", "--format", "json"
    (one, *_) = json.loads(run("atlas", "query", WINDOW, "--scene", path, *wall).stdout)["points"]
    assert (one["wall"], one["stiffness"], one["mass"]) == ("", 500.0, 0.2)
    turning = scene_file(tmp_path, SCENE.replace("mass", "inertia"))
    table = json.loads(run("atlas", "query", WINDOW, "--scene", turning, *wall).stdout)
    assert (table["points"][0]["inertia"], table["points"][0]["hand_inertia"]) == (0.2, 0.0)
    inputs, units = table["inputs"], table["units"]  # issue 31, 19
    assert (inputs["delay_samples"], inputs["hand_inertia"]) == (1.0, [0.0, 0.1])
    assert (units["inertia"], units["stiffness"], units["delay"]) == ("kg m^2", "N m/rad", "s")
    numbers = inputs | table["points"][0]
    assert units.keys() == {name for name in numbers if not isinstance(numbers[name], str)}


@pytest.mark.parametrize(
    "others",
    [
        ["--scene", "S", "--alpha", "0.1"],
        ["--scene", "S", "--csv", "points.csv"],
        ["--scene", "S", "--stiffness", "100"],
        ["--scene", "S", "--stiffness", "nan", "--damping", "1"],
        ["--scene", "S", "--stiffness", "1", "--damping", "1e9", "--outside", "error"],
        ["--scene", "missing.toml"],
        ["--stiffness", "100", "--damping", "1"],
    ],
)
def test_bad_questions_are_refused_in_one_sentence(tmp_path: Path, others: list[str]) -> None:
    path = str(scene_file(tmp_path, SCENE))
    answer = run_process("atlas", "query", WINDOW, *(path if o == "S" else o for o in others))
    assert answer.returncode != 0
    assert answer.stdout == ""
    assert_one_sentence(answer.stderr)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("window = 0.005", "window = 0.004"),  # another estimator
        ("stiffness = [0.0, 100.0]", "stiffness = [0.0, 1e4]"),
        ("[hand]", "[device.actuator]\nbandwidth = 100.0\n[hand]"),
    ],
)
def test_scenes_of_which_an_atlas_says_nothing_are_refused(
    tmp_path: Path, old: str, new: str
) -> None:
    path = scene_file(tmp_path, SCENE.replace(old, new))
    answer = run_process("atlas", "query", WINDOW, "--scene", path)
    assert answer.returncode != 0
    assert_one_sentence(answer.stderr)


@pytest.mark.campaign
def test_scenes_without_an_atlas_are_refused(tmp_path: Path) -> None:
    general = SCENE.replace("[hand]", "[device.actuator]\nbandwidth = 100.0\n[hand]")
    answer = run_process("atlas", "spec", "--scene", scene_file(tmp_path, general))
    assert answer.returncode == 2
    assert_one_sentence(answer.stderr)
    late = SCENE.replace("delay_samples = 1.0", "delay_samples = 200.0")
    answer = run_process("atlas", "spec", "--scene", scene_file(tmp_path, late))
    assert answer.returncode == 2
    assert_one_sentence(answer.stderr)
