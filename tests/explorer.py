"""The explorer's scripts, asked by node, and the loops that node and browsers are asked about."""

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import flint
import numpy as np

import jaxstab
from jaxstab.app.explore import SCRIPTS, script
from tests.truth import filtered

NODE = shutil.which("node")
ANSWERS = (Path(__file__).parent / "explorer.js").read_text(encoding="utf-8")
WITHOUT_PAGE = SCRIPTS[: SCRIPTS.index("state") + 1]

_ROUNDING = 2.0**-50  # of what a few steps in float64 lead to

Setup = dict[str, Any]


def asked_of_node(question: str, cases: list[Setup]) -> Any:
    """What a function of explorer.js answers."""
    source = "\n".join([*map(script, (*WITHOUT_PAGE, "words")), ANSWERS])
    call = f"console.log(JSON.stringify({question}({json.dumps(cases)})));"
    completed = subprocess.run(
        [str(NODE), "-"], input=source + call, capture_output=True, text=True, check=False
    )
    assert completed.returncode == 0, completed.stderr
    return json.loads(completed.stdout)


def random_setup(rng: np.random.Generator) -> Setup:
    """Device, hand and controller as the page has them."""
    period = 10.0 ** rng.uniform(-4.0, -2.5)
    estimator = {
        "window": int(rng.choice([1, 1, 2, 3, 5, 10, 15, 20, 30])),
        "cutoff": float(rng.choice([0.0, 10.0 ** rng.uniform(1.0, np.log10(0.4 / period))])),
        "order": int(rng.integers(1, 4)),
        "kind": str(rng.choice(["low-pass", "butterworth"])),
        "factor": float(rng.choice([1.0, 1.0, rng.uniform(0.1, 1.0)])),
    }
    return {
        "mass": 10.0 ** rng.uniform(-1.5, 0.5),
        "damping": float(rng.choice([0.0, 10.0 ** rng.uniform(-2.0, 0.7)])),
        "handMass": float(rng.choice([0.0, 10.0 ** rng.uniform(-2.0, 0.0)])),
        "handStiffness": float(rng.choice([0.0, 10.0 ** rng.uniform(0.0, 3.0)])),
        "handDamping": float(rng.choice([0.0, 10.0 ** rng.uniform(-1.0, 1.0)])),
        "period": period,
        "delay": float(rng.choice([rng.integers(0, 5), rng.uniform(0.0, 20.0)])),
        "estimator": estimator,
    }


def velocity_of(estimator: dict[str, Any]) -> jaxstab.Velocity:
    """The same estimator from Python."""
    velocity = jaxstab.Velocity.difference(estimator["window"])
    if estimator["cutoff"]:
        is_butterworth = estimator["kind"] == "butterworth"
        make = jaxstab.Filter.butterworth if is_butterworth else jaxstab.Filter.low_pass
        velocity *= make(estimator["cutoff"], order=estimator["order"])
    if estimator["factor"] < 1.0:
        velocity *= jaxstab.Filter.exponential(estimator["factor"])
    return velocity


def loop_of(setup: Setup) -> jaxstab.HapticLoop:
    """The same loop from Python."""
    return jaxstab.HapticLoop(
        device_mass=setup["mass"],
        device_damping=setup["damping"],
        hand_mass=setup["handMass"],
        hand_stiffness=setup["handStiffness"],
        hand_damping=setup["handDamping"],
        sample_time=setup["period"],
        delay=setup["delay"] * setup["period"],
        velocity=velocity_of(setup["estimator"]),
    )


def random_walls(
    loop: jaxstab.HapticLoop, rng: np.random.Generator, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Walls in and around the region of a loop, and as many next to its boundary."""
    outline = loop.region().outline
    low, high = outline.min(axis=0), outline.max(axis=0)
    anywhere = low + (high - low) * rng.uniform(-0.1, 1.1, (count, 2))
    shift = 1.0 + 10.0 ** rng.uniform(-13.0, -2.0, (count, 1)) * rng.choice([-1.0, 1.0], (count, 1))
    walls = np.concatenate([anywhere, outline[rng.integers(0, len(outline), count)] * shift])
    return walls[:, 0], walls[:, 1]


def setups_with_walls(
    rng: np.random.Generator, loops: int, walls: int
) -> list[tuple[jaxstab.HapticLoop, Setup, np.ndarray, np.ndarray]]:
    """Loops with a region, the setup with its walls for the page, and the walls' K and B."""
    found: list[Any] = []
    while len(found) < loops:
        setup = random_setup(rng)
        loop = loop_of(setup)
        if loop.region().status != jaxstab.results.RegionStatus.COMPLETE:
            continue
        stiffness, damping = random_walls(loop, rng, walls // 2)
        pairs = zip(stiffness.tolist(), damping.tolist(), strict=True)
        setup["walls"] = [{"stiffness": k, "damping": b} for k, b in pairs]
        found.append((loop, setup, stiffness, damping))
    return found


def hostile_state(rng: np.random.Generator) -> dict[str, Any]:
    """What a link may say: numbers of any size, of which most are refused."""
    sizes = ("mass", "damping", "handMass", "handStiffness", "handDamping", "period", "cutoff")
    state: dict[str, Any] = {key: 10.0 ** rng.uniform(-12.0, 12.0) for key in sizes}
    if rng.random() < 0.8:
        state |= random_setup(rng)
        state |= state.pop("estimator")
    gains = (rng.choice([-1.0, 1.0], 4) * 10.0 ** rng.uniform(-6.0, 12.0, 4)).tolist()
    state["delay"] = float(rng.choice([state.get("delay", 0.0), rng.uniform(0.0, 200.0)]))
    state["order"] = int(rng.integers(1, 9))
    state |= {key: 10.0 ** rng.uniform(-12.0, 12.0) for key in ("friction", "push", "encoder")}
    state["contact"] = str(rng.choice(["off", "on"]))
    state["view"] = str(rng.choice(["near", "all", "sample"]))
    state["cursorStiffness"], state["cursorDamping"] = gains[:2]
    state["walls"] = [{"name": "</b>&", "stiffness": gains[2], "damping": gains[3]}]
    return state


def curve_cases(rng: np.random.Generator, count: int, angles: int) -> list[Setup]:
    """Loops in numbers without units, and angles between 0 and pi, half of them close to an end."""
    cases = []
    for _ in range(count):
        close = 10.0 ** rng.uniform(-6.0, 0.0, angles // 4)
        theta = np.concatenate([close, np.pi - close, rng.uniform(0.0, np.pi, angles // 2)])
        case = {
            "gamma": float(rng.choice([0.0, 10.0 ** rng.uniform(-7.0, 0.5)])),
            "delta": float(rng.choice([0.0, 10.0 ** rng.uniform(-6.0, 0.0)])),
            "delay": float(rng.choice([rng.integers(0, 8), rng.uniform(0.0, 8.0)])),
            "estimator": random_setup(rng)["estimator"] | {"window": int(rng.integers(1, 30))},
            "theta": theta.tolist(),
        }
        # Of the rate; far below, what exp rounds its pole to matters, which differs by the library.
        cutoff = float(rng.choice([0.0, 10.0 ** rng.uniform(-2.5, -0.4)]))
        case["estimator"]["cutoff"] = cutoff
        cases.append(case)
    return cases


def true_curve(case: Setup) -> tuple[np.ndarray, np.ndarray]:
    """The same points in balls, and how far they move by one rounding of the angles and of both
    sides of alpha + beta V = W: next to angles at which V is real that is far.
    """
    angles = np.array(case["theta"])
    gains, sides = _in_balls(case, angles.tolist())
    moved, _ = _in_balls(case, (angles * (1.0 + _ROUNDING)).tolist())
    estimate, plant = sides.T
    of_beta = np.abs(plant) + np.abs(gains[:, 1] * estimate)
    of_beta *= _ROUNDING / np.abs(estimate.imag)
    of_alpha = _ROUNDING * np.abs(plant) + of_beta * np.abs(estimate)
    return gains, np.abs(moved - gains) + np.stack([of_alpha, of_beta], axis=1)


def _in_balls(case: Setup, angles: list[float], bits: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Points (alpha, beta) that solve the two real equations of p = 0, and V and W there."""
    estimator = case["estimator"]
    parts = [filtered.difference(estimator["window"])]
    if estimator["cutoff"]:
        is_butterworth = estimator["kind"] == "butterworth"
        make = filtered.butterworth if is_butterworth else filtered.low_pass
        parts.append(make(estimator["cutoff"], order=estimator["order"]))
    if estimator["factor"] < 1.0:
        parts.append(filtered.exponential(estimator["factor"]))
    loop = filtered.FilteredLoop(
        case["gamma"], case["delta"], case["delay"], filtered.times(*parts), filtered.times()
    )
    balls = loop.balls(bits)
    gains, sides = [], []
    with flint.ctx.workprec(bits):
        for angle in angles:
            z = flint.acb(0, flint.arb(angle)).exp()
            base, stiffness, damping = (part(z) for part in balls[:3])
            estimate, plant = damping / stiffness, -base / stiffness
            beta = plant.imag / estimate.imag
            gains.append([float((plant.real - beta * estimate.real).mid()), float(beta.mid())])
            sides.append([complex(estimate), complex(plant)])
    return np.array(gains), np.array(sides)
