"""Scenes with vibration modes, a motor and a grip: their limits against scipy, and what they say.

Nothing in the simulation knows transfer functions: masses, dampers and springs are matrices of the
displacements of the rigid body, the modes and the arm, and a loop's step is scipy's exponential.
"""

import csv
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaign import many
from commands import run
from numpy.typing import NDArray
from scipy.linalg import expm, matrix_balance

from jaxstab import Device, Hand, HapticLoop, Mode, Velocity
from jaxstab.app.scene import Scene, check_walls, loop_of, scene_limits
from jaxstab.app.scene.loops import OneHand, common_outline, corner_loops, range_of_hands
from jaxstab.boxes.search import spread_hands
from jaxstab.conventions import Verdict

Floats = NDArray[np.float64]

TEXT = """\
[device]
mass = 0.25
damping = 0.1
actuator.bandwidth = 200.0
modes = [{ frequency = 80.0, damping_ratio = 0.02, modal_mass = 1.5 }]
[hand]
mass = 0.3
stiffness = 100.0
damping = 2.0
grip = { stiffness = 2000.0, damping = 4.0 }
[controller]
sample_time = 0.001
delay_samples = 1.0
velocity.window_samples = 5
[walls.soft]
stiffness = 500.0
damping = 5.0
"""
NEXT_TO_IT = 0.01  # of the largest stiffness: how far from it walls are simulated
SQUARINGS = 20  # of a step: 1048576 samples, so that how far a pair of poles has turned is nothing


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "scene.toml"
    path.write_text(TEXT)
    return path


def random_table(rng: np.random.Generator) -> dict[str, Any]:
    """A scene of one hand with some of what makes a device more than one mass."""
    device: dict[str, Any] = {"mass": rng.uniform(0.1, 0.5), "damping": rng.uniform(0.0, 1.0)}
    device["modes"] = [
        {
            "frequency": 10.0 ** rng.uniform(1.0, 2.5),
            "damping_ratio": rng.uniform(0.005, 0.2),
            "modal_mass": 10.0 ** rng.uniform(-1.0, 1.0),
        }
        for _ in range(rng.integers(0, 3))
    ]
    if rng.random() < 0.6:
        device["actuator"] = {"bandwidth": 10.0 ** rng.uniform(1.5, 3.0)}
    hand: dict[str, Any] = {
        "mass": rng.uniform(0.05, 1.0),
        "stiffness": rng.uniform(0.0, 300.0),
        "damping": rng.uniform(0.5, 5.0),
    }
    if rng.random() < 0.6:
        grip = {"stiffness": 10.0 ** rng.uniform(2.0, 4.0), "damping": rng.uniform(0.0, 10.0)}
        hand["grip"] = grip
    return {
        "device": device,
        "hand": hand,
        "controller": {
            "sample_time": 0.001,
            "delay_samples": float(rng.integers(0, 3)),
            "velocity": {"window_samples": int(rng.integers(1, 21))},
        },
    }


def turned(table: dict[str, Any], lever: float) -> dict[str, Any]:
    """The same as a device that turns about an axis, at a distance in m."""
    square = lever**2
    device, hand = table["device"], table["hand"]
    about = {"inertia": device["mass"] * square, "damping": device["damping"] * square}
    about["modes"] = [
        {
            "frequency": mode["frequency"],
            "damping_ratio": mode["damping_ratio"],
            "modal_inertia": mode["modal_mass"] * square,
        }
        for mode in device.get("modes", [])
    ]
    if "actuator" in device:
        about["actuator"] = device["actuator"]
    held = {
        "inertia": hand["mass"] * square,
        "stiffness": hand["stiffness"] * square,
        "damping": hand["damping"] * square,
    }
    if "grip" in hand:
        held["grip"] = {name: value * square for name, value in hand["grip"].items()}
    return {"device": about, "hand": held, "controller": table["controller"]}


# ------------------------------------------------------------------------------------- simulation


def motion_of(table: dict[str, Any]) -> tuple[Floats, Floats, Floats]:
    """Return A, B and C of x' = A x + B f and the position C x, from masses, dampers, springs."""
    device, hand = table["device"], table["hand"]
    inertias, rates, springs = [device["mass"]], [device["damping"]], [0.0]
    for mode in device.get("modes", []):
        mass, speed = mode["modal_mass"], 2.0 * math.pi * mode["frequency"]
        inertias.append(mass)
        rates.append(2.0 * mode["damping_ratio"] * speed * mass)
        springs.append(mass * speed**2)
    at_handle = np.ones(len(inertias))
    grip = hand.get("grip")
    arm = hand["mass"], hand["damping"], hand["stiffness"]
    matrices = [np.diag(values) for values in (inertias, rates, springs)]
    if grip is None:  # all that is at the handle moves the arm
        matrices = [
            matrix + own * np.outer(at_handle, at_handle)
            for matrix, own in zip(matrices, arm, strict=True)
        ]
        sees = at_handle
    else:  # the arm is a displacement of its own
        sees = np.append(at_handle, 0.0)
        between = np.append(at_handle, -1.0)
        bonds = 0.0, grip["damping"], grip["stiffness"]
        matrices = [
            np.pad(matrix, ((0, 1), (0, 1)))
            + own * np.outer(np.eye(len(sees))[-1], np.eye(len(sees))[-1])
            + bond * np.outer(between, between)
            for matrix, own, bond in zip(matrices, arm, bonds, strict=True)
        ]
    masses, dampers, stiffness = matrices
    count = len(sees)
    inverse = np.linalg.inv(masses)
    a = np.block(
        [[np.zeros((count, count)), np.eye(count)], [-inverse @ stiffness, -inverse @ dampers]]
    )
    b = np.append(np.zeros(count), inverse @ sees)
    c = np.append(sees, np.zeros(count))
    if "actuator" in device:
        rate = 2.0 * math.pi * device["actuator"]["bandwidth"]
        a = np.block([[a, b[:, None]], [np.zeros((1, len(a))), np.array([[-rate]])]])
        b = np.append(np.zeros(len(b)), rate)
        c = np.append(c, 0.0)
    return a, b, c


def grows(table: dict[str, Any], stiffness: float, damping: float) -> bool:
    """True if positions grow over 1048576 samples: the step of a sample, squared."""
    controller = table["controller"]
    period, delay = controller["sample_time"], int(controller["delay_samples"])
    window = controller["velocity"]["window_samples"]
    a, b, c = motion_of(table)
    order = len(a)
    held: Any = expm(np.block([[a, b[:, None]], [np.zeros((1, order + 1))]]) * period)
    size = order + window + delay  # states, the positions before, the forces on their way
    force = np.zeros(size)
    force[:order] = -(stiffness + damping / (window * period)) * c
    force[order + window - 1] = damping / (window * period)
    step = np.zeros((size, size))
    step[:order, :order] = held[:order, :order]
    step[order, :order] = c
    step[order + 1 : order + window, order : order + window - 1] = np.eye(window - 1)
    if delay:
        step[order + window, :] = force
        step[order + window + 1 :, order + window : -1] = np.eye(delay - 1)
        step[:order, -1] = held[:order, order]
    else:
        step[:order] += np.outer(held[:order, order], force)
    apart, power, sizes = 0.0, matrix_balance(step)[0], [0.0, 0.0]
    for _ in range(SQUARINGS):  # logarithms of norms are kept apart, so that nothing overflows
        norm = float(np.linalg.norm(power))
        apart, power = 2.0 * (apart + math.log(norm)), (power / norm) @ (power / norm)
        sizes.append(apart + math.log(float(np.linalg.norm(power))))
    return sizes[-1] > sizes[-2]


def judge(seed: int, count: int) -> int:
    """Simulate walls on either side of random scenes' limits; return how many were judged."""
    rng, judged = np.random.default_rng(seed), 0
    for _ in range(count):
        table = random_table(rng)
        scene = Scene.from_table(table)
        loop = loop_of(scene)
        region = loop.region()
        if region.main is None or region.status.name == "UNRESOLVED":
            continue
        damping = float(rng.uniform(0.1, 0.9) * region.main.most_damped.damping)
        for _, top in region.main.stiffness_intervals(np.array([damping]))[0]:
            if not top > 0.0:
                continue
            for share, is_unstable in ((1.0 - NEXT_TO_IT, False), (1.0 + NEXT_TO_IT, True)):
                stiffness = share * float(top)
                code = int(loop.verdict(stiffness, damping))
                assert code != Verdict.UNDECIDED
                if (code == Verdict.UNSTABLE) != is_unstable:
                    continue  # the next interval begins there, or this one does
                assert grows(table, stiffness, damping) == is_unstable, (table, stiffness, damping)
                judged += 1
    return judged


@pytest.mark.campaign
def test_walls_next_to_the_limits_of_modes_motors_and_grips_come_to_rest_or_grow() -> None:
    assert judge(seed=16, count=2) > 2


@pytest.mark.campaign
def test_many_walls_next_to_the_limits_come_to_rest_or_grow() -> None:
    assert judge(seed=2012, count=many(200)) > 1.5 * many(200)


# ------------------------------------------------------------------------- what a scene is made of


def test_a_scene_is_the_loop_of_its_modes_motor_and_grip(file: Path) -> None:
    arm = Hand.mass_spring_damper(mass=0.3, stiffness=100.0, damping=2.0)
    mode = Mode(frequency=80.0, damping_ratio=0.02, modal_mass=1.5)
    device = Device.modes([mode], mass=0.25, damping=0.1).with_actuator(200.0)
    loop = HapticLoop(
        device=device.held_by(arm.with_grip(stiffness=2000.0, damping=4.0)),
        sample_time=1e-3,
        delay=1e-3,
        velocity=Velocity.difference(samples=5),
    )
    assert loop_of(Scene.from_file(file)) == loop
    best = scene_limits(Scene.from_file(file)).best
    limits = loop.limits()
    assert 0.999 * limits.stiffness < best.largest_stiffness <= limits.stiffness
    assert best.at_damping == pytest.approx(limits.at_damping, rel=1e-5)


def test_a_scene_that_turns_has_the_limits_of_one_that_moves_along_a_line() -> None:
    rng = np.random.default_rng(3)
    for lever in (0.05, 0.2):
        table = random_table(rng)
        line, about = (Scene.from_table(one) for one in (table, turned(table, lever)))
        limits, turning = (loop_of(scene).limits() for scene in (line, about))
        np.testing.assert_allclose(turning[:4], lever**2 * np.array(limits[:4]), rtol=1e-6)
        assert "N m/rad" in str(scene_limits(about))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("modes = 3", "device.modes is 3; give a list."),
        ("modes = [3]", "device.modes.0 is 3; give a table, such as { frequency = 3 }."),
        ("modes.frequency = 80.0", "device.modes is {'frequency': 80.0}; give a list."),
        (
            "modes = [{ frequency = 0.0, damping_ratio = 0.1, modal_mass = 1.0 }]",
            "device.modes.0.frequency is 0.0; give a finite number > 0 in Hz.",
        ),
        (
            "modes = [{ frequency = 80.0, damping_ratio = 0.1 }]",
            "device.modes.0.modal_mass and modal_inertia are missing; give modal_mass in kg, or ",
        ),
        (
            "modes = [{ frequency = 80.0, damping_ratio = 0.1, modal_mass = 0.0 }]",
            "device.modes.0.modal_mass is 0.0; give a finite number in kg, not 0.",
        ),
        (
            "modes = [{ frequency = 80.0, damping_ratio = 0.1, modal_inertia = 1.0 }]",
            "device.modes.0.modal_inertia is 1 beside mass; give modal_mass.",
        ),
        (
            "actuator.bandwith = 3.0",
            "device.actuator.bandwith is unknown; did you mean 'bandwidth'?",
        ),
        (
            "actuator.bandwidth = -1.0",
            "device.actuator.bandwidth is -1.0; give a finite number > 0 in Hz.",
        ),
        (
            "actuator.bandwidth = 1.0\n[hand.grip]\nstiffness = 0.0",
            "hand.grip.stiffness and damping are 0; give a grip that holds something.",
        ),
        (
            "[hand.grip]\ndamping = 3.0",
            "hand.grip.stiffness is missing; give it in N/m.",
        ),
        (
            "modes = [{ frequency = 35.0, damping_ratio = 0.05, modal_mass = -0.0008 }]\n"
            "[hand]\ndamping = [0.0, 0.005]",
            "device.modes.0.modal_mass is -0.0008 beside a hand: such a mode moves motor and ",
        ),
    ],
)
def test_bad_tables_are_refused_in_one_sentence(given: str, words: str, tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    file.write_text(
        f"[controller]\nsample_time = 0.001\n[device]\nmass = 0.2\ndamping = 0.1\n{given}\n"
    )
    result = run("limits", file)
    assert result.exit_code == 2
    assert result.stderr.startswith(f"jaxstab: {file}: {words}")
    assert result.stderr.count("\n") == 1


def test_a_mode_whose_frequency_is_given_in_other_units_is_unusual() -> None:
    table = random_table(np.random.default_rng(0))
    mode = {"frequency": 5e4, "damping_ratio": 3.0, "modal_mass": 1e-5}
    table["device"] |= {"modes": [mode], "actuator": {"bandwidth": 0.2}}
    table["hand"]["grip"] = {"stiffness": 1e7}
    assert Scene.from_table(table).unusual() == [
        "device.modes.0.frequency is 50000 Hz, usual are 0.1 to 10000 Hz",
        "device.modes.0.damping_ratio is 3, usual are 0 to 1",
        "device.modes.0.modal_mass is 1e-05 kg, usual are 0.001 to 5000 kg",
        "device.actuator.bandwidth is 0.2 Hz, usual are 1 to 100000 Hz",
        "hand.grip.stiffness is 1e+07 N/m, usual are 0 to 1e+06 N/m",
    ]


# ----------------------------------------------------------------------------------------- answers


@pytest.mark.campaign
def test_answers_say_first_what_moves_beside_the_mass(file: Path) -> None:
    words = "modes at 80 Hz; an actuator of 200 Hz; a grip of 2000 N/m, 4 N s/m"
    for command in ("limits", "check"):
        velocity, delay, mechanics, *_ = run(command, file).stdout.splitlines()
        assert velocity.startswith("velocity")
        assert delay.startswith("delay")
        assert re.match(rf"mechanics +{words}$", mechanics)
    assert json.loads(run("limits", file, "--json").stdout)["inputs"]["mechanics"] == words


def test_the_model_is_explained_with_its_modes_motor_and_grip(file: Path) -> None:
    text = run("scene", "explain", file).stdout
    for line in (
        r"mode 1 +80 Hz, damping ratio 0\.02, 1\.5 kg",
        r"actuator +a first-order lag of 200 Hz of the force",
        r"grip +2000 N/m, 4 N s/m, between device and hand",
        r"outside +vibration modes other than these$",
    ):
        assert re.search(line, text, re.MULTILINE), line
    plain = "[device]\nmass = 0.25\ndamping = 0.1\n[controller]\nsample_time = 0.001\n"
    file.write_text(plain)
    text = run("scene", "explain", file).stdout
    assert re.search(r"outside +vibration modes, bandwidth of motor and amplifier$", text, re.M)


def test_hands_of_one_range_are_proved(file: Path) -> None:
    file.write_text(TEXT.replace("mass = 0.3", "mass = [0.1, 0.4]"))
    scene = Scene.from_file(file)
    wall = check_walls(scene).walls["soft"]
    assert wall.verdict == Verdict.STABLE
    assert wall.hands_are is None
    assert wall.worst_hand is not None
    assert (wall.worst_hand.stiffness, wall.worst_hand.damping) == (100.0, 2.0)
    limits = scene_limits(scene)
    assert limits.all_hands is not None
    assert limits.all_hands.certainty == "proved for every hand"
    most, damping = limits.all_hands.largest_stiffness, limits.all_hands.at_damping
    for hand in spread_hands(range_of_hands(scene), 9).tolist():
        loop = loop_of(scene, OneHand(*hand))
        assert loop.verdict(most, damping) == Verdict.STABLE
    higher = file.with_name("higher.toml")
    higher.write_text(
        file.read_text().replace("stiffness = 500.0", f"stiffness = {1.05 * most}")
        .replace("damping = 5.0\n", f"damping = {damping}\n")
    )  # fmt: skip
    assert check_walls(Scene.from_file(higher)).walls["soft"].verdict == Verdict.UNSTABLE


@pytest.mark.campaign
def test_hands_of_several_ranges_are_proved(file: Path) -> None:
    text = TEXT.replace("mass = 0.3", "mass = [0.1, 0.4]").replace("= 100.0", "= [90.0, 110.0]")
    file.write_text(text)
    scene = Scene.from_file(file)
    wall = check_walls(scene).walls["soft"]
    assert wall.verdict == Verdict.STABLE
    assert wall.hands_are is None


def test_walls_of_the_common_outline_are_stable_for_each_corner(file: Path) -> None:
    file.write_text(TEXT.replace("mass = 0.3", "mass = [0.0, 0.4]").replace("= 100.0", "= [0, 99]"))
    scene = Scene.from_file(file)
    loops = corner_loops(scene)
    outline = common_outline(loops)
    middle = outline.mean(axis=0)
    inside = middle + 0.999 * (outline - middle)  # it is star-shaped about its middle
    for loop in loops:
        codes = np.asarray(loop.verdict(*inside.T))
        assert np.all(codes == Verdict.STABLE)


@pytest.mark.campaign
def test_an_encoder_is_bounded_and_the_best_walls_are_found_for_modes_too(file: Path) -> None:
    file.write_text(TEXT.replace("damping = 0.1\n", "damping = 0.1\nencoder.resolution = 1e-5\n"))
    scene = Scene.from_file(file)
    chatter = check_walls(scene).walls["soft"].chatter_at_most
    loop = loop_of(scene)
    assert chatter == loop.amplitude(500.0, 5.0, encoder=1e-5).position
    best = json.loads(run("tune", file, "--json").stdout)["least_settling"]
    wall = best["stiffness"], best["damping"]
    assert best["settling_time_2_percent"] == loop.settling_time(*wall).value
    assert best["chatter_at_most"] == loop.amplitude(*wall, encoder=1e-5).position


def test_a_number_of_a_mode_varies_in_a_study(file: Path) -> None:
    given = ["study", file, "--answer", "limits", "--csv", "-"]
    text = run(*given, "--over", "device.modes.0.frequency=60:100:3").stdout
    stiffest = [float(row["largest_stiffness"]) for row in csv.DictReader(text.splitlines())]
    single = json.loads(run("limits", file, "--json").stdout)["best"]["largest_stiffness"]
    assert 0.999 * stiffest[1] < single <= stiffest[1]  # which is proved as it is printed
    assert len(set(stiffest)) == 3
    refused = run(*given, "--over", "device.modes.3.frequency=60:100:2")
    assert refused.exit_code == 2
    assert "device.modes.3.frequency is not in the scene; that list has 1 entries" in refused.stderr


@pytest.mark.campaign
def test_a_scene_of_a_general_device_has_a_picture(file: Path, tmp_path: Path) -> None:
    picture = tmp_path / "scene.svg"
    result = run("check", file, "--plot", picture)
    assert result.exit_code == 0, result.stderr
    assert "modes at 80 Hz" in re.sub(r"<!-- | -->", "", picture.read_text())


def test_what_holds_a_device_still_is_its_static_stiffness() -> None:
    arm = Hand.mass_spring_damper(mass=0.3, stiffness=300.0, damping=2.0)
    mass = Device.mass_spring_damper(0.25, damping=0.1)
    assert mass.static_stiffness() == 0.0
    assert mass.held_by(arm).with_actuator(30.0).static_stiffness() == 300.0
    held = mass.held_by(arm.with_grip(stiffness=600.0, damping=4.0)).static_stiffness()
    assert held == pytest.approx(200.0, rel=1e-15)
    assert Device.transfer_function([1.0, 0.0], [1.0, 2.0, 3.0]).static_stiffness() == math.inf
    loop = HapticLoop(
        device=mass.held_by(arm.with_grip(stiffness=600.0, damping=4.0)), sample_time=1e-3
    )
    pushed = loop.simulate(400.0, 5.0, samples=5000, force=1.0)
    assert float(pushed.position[-1]) == pytest.approx(1.0 / (400.0 + held), rel=1e-6)


def test_a_device_whose_mass_varies_needs_no_hand() -> None:
    device = {"mass": [0.2, 0.4], "damping": 0.1, "actuator": {"bandwidth": 100.0}}
    wall, period = {"stiffness": 300.0, "damping": 5.0}, 1e-3
    controller = {"sample_time": period, "velocity": {"window_samples": 1}}
    tables = {"device": device, "controller": controller, "walls": {"a": wall}}
    wanted = {"measures": ["radius", "oscillation"]}
    found = check_walls(Scene.from_table(tables | {"wanted": wanted})).walls["a"]
    assert found.verdict == Verdict.STABLE
    roots = []
    for mass in (0.2, 0.4):
        lag = 2.0 * math.pi * 100.0
        motion = np.zeros((4, 4))  # position, velocity, the motor's force and what it is asked for
        motion[0, 1], motion[1, 1:3], motion[2, 2:] = 1.0, (-0.1 / mass, 1.0 / mass), (-lag, lag)
        step = expm(period * motion)
        loop = np.zeros((4, 4))  # and the last position
        law = np.array([-300.0 - 5.0 / period, 0.0, 0.0, 5.0 / period])
        loop[:3, :3], loop[3, 0] = step[:3, :3], 1.0
        loop[:3] += np.outer(step[:3, 3], law)
        roots.append(np.linalg.eigvals(loop))
    radii = [np.max(np.abs(own)) for own in roots]
    assert found.spectral_radius == pytest.approx(max(radii), abs=1e-9)
    ratios = [np.min(-np.log(own).real / np.abs(np.log(own))) for own in roots]
    assert found.damping_ratio == pytest.approx(min(ratios), rel=1e-6)
    least = found.least_damped_hand
    assert (least.device_mass, least.mass) == ((0.2, 0.4)[int(np.argmin(ratios))], 0.0)
