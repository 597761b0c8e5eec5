"""Random scenes of all kinds, and the recursions of those of other gains, in exact numbers."""

from fractions import Fraction
from typing import Any

import mpmath
import numpy as np

from tests.truth import affine_kinds, recursions

Tables = dict[str, Any]

JOINT = {"kind": "simulator", "inertia": 0.1, "step": 2e-3}

ROBOT = {"kind": "admittance", "environment": 1e4, "sample_time": 1e-3, "delay_samples": 4}

DEVICE = {
    "device": {"mass": 0.25, "damping": 0.1},
    "controller": {"sample_time": 1e-3, "delay_samples": 1.0},
}


def loop(table: Tables, **wanted: float) -> Tables:
    return {"loop": table, "wanted": wanted}


def pid(gains: Tables, of: Tables = DEVICE, **wanted: float) -> Tables:
    return of | loop({"kind": "pid", **gains}, **wanted)


def couple(second: Tables, first_late: float, late: float, **wanted: float) -> Tables:
    controller = {"sample_time": 1e-3, "delay_samples": first_late}
    second = second | {"delay_samples": late}
    table = loop({"kind": "coupling", "second": second}, **wanted)
    return table | {"device": DEVICE["device"], "controller": controller}


def held_mass(numbers: tuple[float, ...], late: float) -> recursions.HeldMass:
    return affine_kinds._held(*numbers, 1e-3, late, exact=True)


def judged(tables: Tables, pair: dict[str, Fraction], wall: float = 0.0) -> bool | None:
    """True if exact gains are stable in the recursion of a scene, in exact numbers."""
    own, exact = {**tables["loop"]}, {"one": Fraction(1)}
    match own.pop("kind"):
        case "simulator":
            timing = {name: own.pop(name, default) for name, default in TIMING.items()}
            inside = not own.pop("outside", False) and timing == TIMING
            engine = {"damping": 0.0, "stiffness": 0.0, "integrator": "semi-implicit"} | own
            numbers = {k: v if k == "integrator" else Fraction(v) for k, v in engine.items()}
            matrix = recursions.simulated(**pair, inside=inside, **timing, **numbers, **exact)
        case "admittance":
            own = {"rule": "forward", "stiffness": 0.0} | own | {"environment": wall}
            kept = "rule", "delay_samples"
            numbers = {k: v if k in kept else Fraction(v) for k, v in own.items()}
            matrix = recursions.admittance(**pair, **numbers, **exact)
        case "pid":
            plant = held_mass((0.25, 0.1, 0.0), 1.0)
            gains = {name: mpf(value) for name, value in pair.items()}
            gains |= {name: mpf(own[name]) for name in ("kp", "ki", "kd") if name in own}
            matrix = recursions.pid(
                **gains, plant=plant, period=mpf(1e-3), rule="backward", window=1, one=mpf(1)
            )
        case _:
            second = own["second"]
            bodies = (0.25, 0.1, 0.0), (second["mass"], second["damping"], 0.0)
            lates = tables["controller"]["delay_samples"], second["delay_samples"]
            plants = [held_mass(*both) for both in zip(bodies, lates, strict=True)]
            gains = {name: mpf(value) for name, value in pair.items()}
            matrix = recursions.coupling(
                **gains, first=plants[0], second=plants[1], period=mpf(1e-3), drift=1, one=mpf(1)
            )
    with mpmath.workdps(60):
        return affine_kinds.is_stable_exactly(matrix)


TIMING = {"substeps": 1, "delay_steps": 0}


def mpf(number: Any) -> Any:
    with mpmath.workdps(60):
        exact = Fraction(number)
        return mpmath.mpf(exact.numerator) / exact.denominator


RANDOM = {
    "simulator": lambda rng: loop(
        JOINT
        | {
            "inertia": float(10 ** rng.uniform(-4, 0)),
            "damping": float(rng.choice([0.0, 0.01])),
            "integrator": str(rng.choice(["semi-implicit", "implicit-joint"])),
            "substeps": int(rng.integers(1, 5)),
            "delay_steps": int(rng.integers(0, 6)),
        }
    ),
    "admittance": lambda rng: loop(
        ROBOT
        | {
            "environment": float(10 ** rng.uniform(2, 5)),
            "delay_samples": int(rng.integers(1, 6)),
            "rule": str(rng.choice(["forward", "explicit", "backward"])),
        }
    ),
    "pid": lambda rng: pid({"kd": float(rng.uniform(5.0, 100.0))}),
    "coupling": lambda rng: couple(
        {"mass": float(10 ** rng.uniform(-1, 1)), "damping": 0.2},
        1.0,
        float(rng.choice([0.0, 2.5])),
    ),
}


SOFT = 1e-7  # of the largest stiffness: what stands for a wall without a spring, a limit

NUMBER = r"(-?[\d.]+(?:e[-+]?\d+)?)"


def random_table(rng: np.random.Generator) -> dict[str, Any]:
    """A scene of one mass or with a mode, along a line or turning, with any estimator and hand."""
    turns = rng.random() < 0.4
    mass = 10.0 ** (rng.uniform(-6.0, -1.0) if turns else rng.uniform(-2.0, 0.7))
    period = 10.0 ** rng.uniform(-4.0, -2.3)
    own = mass / period  # N s/m that stop it within a sample
    moved = "inertia" if turns else "mass"
    damping = float(rng.choice([0.0, own * 10.0 ** rng.uniform(-5.0, -1.0)]))
    device: dict[str, Any] = {moved: mass, "damping": damping}
    if rng.random() < 0.15:
        mode = {"frequency": rng.uniform(0.02, 0.3) / period, "damping_ratio": 0.03}
        device["modes"] = [{**mode, f"modal_{moved}": mass * rng.uniform(0.5, 5.0)}]
    estimators: list[dict[str, Any]] = [
        {"window_samples": int(rng.integers(1, 30))},
        {"cutoff": rng.uniform(0.02, 0.4) / period, "order": int(rng.integers(1, 4))},
        {"window_samples": 1, "factor": rng.uniform(0.1, 0.9)},
    ]
    controller: dict[str, Any] = {"sample_time": period, "delay_samples": rng.uniform(0.0, 6.0)}
    if rng.random() < 0.5:
        controller["delay_samples"] = float(rng.integers(0, 6))
    if rng.random() < 0.7:
        controller["velocity"] = estimators[rng.integers(3)]
    if rng.random() < 0.1:
        controller["position"] = {"window_samples": int(rng.integers(2, 5))}
    table: dict[str, Any] = {"device": device, "controller": controller}
    if rng.random() < 0.6:
        table["hand"] = {
            moved: mass * rng.uniform(0.0, 2.0),
            "stiffness": float(rng.choice([0.0, own / period * 10.0 ** rng.uniform(-6.0, -1.5)])),
            "damping": own * 10.0 ** rng.uniform(-5.0, -1.5),
        }
    return table
