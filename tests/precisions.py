"""Every answer of a process whose python-flint has another precision: python precisions.py BITS.

Prints JSON: the public calls, the methods of each kind of loop, and what scenes are asked, each as
a text of all bits, with the precision that it leaves behind. With "short" behind BITS the answers
that take half of the time are left out.
"""

import json
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import flint
from calls import COMPUTING_CALLS, as_text, outcome
from commands import run

import jaxstab

SCENES = Path(__file__).resolve().parents[1] / "data" / "scenes"
WITHOUT_BALLS = {"contact_map", "evaluate_grid", "trace_boundary"}  # and they take long
LONG = "robust_region", "tune", "design", "worst_delays"  # as their names begin


def loops() -> dict[str, tuple[Any, tuple[float, float]]]:
    """A loop of each kind, and a stable pair of its gains."""
    mass = jaxstab.Device.mass_spring_damper(mass=0.25, damping=0.1)
    vibration = jaxstab.Mode(frequency=80.0, damping_ratio=0.05, modal_mass=1.5)
    modes = jaxstab.Device.modes(vibration, mass=0.25, damping=1.0)
    arm = jaxstab.Hand.mass_spring_damper(0.3, damping=2.0, stiffness=200.0)
    gripped = arm.with_grip(stiffness=2e3, damping=4.0)
    of_modes = modes.with_actuator(bandwidth=200.0).held_by(gripped)
    low_pass = jaxstab.Velocity.low_pass(100.0)
    timing = {"sample_time": 1e-3, "delay": 1.5e-3}
    held = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, velocity=low_pass, **timing)
    base, first, second = [1.0, -1.9, 0.9], [0.1, 0.05], [1.0, -1.0]
    return {
        "held mass": (held, (200.0, 3.0)),
        "modes": (jaxstab.HapticLoop(device=of_modes, **timing), (200.0, 1.0)),
        "simulator": (jaxstab.simulated_pd(0.1, step=2e-3, substeps=4), (300.0, 10.0)),
        "admittance": (jaxstab.admittance(2e3, sample_time=1e-3, delay_samples=4), (2.0, 60.0)),
        "pid": (jaxstab.pid(held, kd=10.0), (300.0, 1e3)),
        "coupling": (jaxstab.coupling(mass, modes, sample_time=1e-3), (500.0, 5.0)),
        "coefficients": (
            jaxstab.Loop.from_coefficients(base=base, first=first, second=second, sample_time=1e-3),
            (0.1, 0.3),
        ),
    }


def questions() -> Iterator[tuple[str, Callable[[], Any]]]:
    for kind, (loop, pair) in loops().items():
        first, second = (gain.name for gain in loop.gains)
        gains = dict(zip((first, second), pair, strict=True))
        of_pairs = "verdict", "spectral_radius", "poles", "margins", "frequency_margins"
        asked: dict[str, dict[str, Any]] = dict.fromkeys(of_pairs, gains)
        asked |= {"settling_time": gains, "oscillation": gains, "simulate": gains}
        asked |= {"limits": {}, "region": {}, "boundary": {}, "tune": {}}
        asked |= {f"intervals at a {name}": {name: gain} for name, gain in gains.items()}
        if isinstance(loop, jaxstab.HapticLoop):
            asked["simulate"] = gains | {"force": 1.0}
            asked["amplitude"] = gains | {"encoder": 1e-5, "force_step": 0.01}
            asked["jitter_margin"] = gains
            asked["worst_delays"] = gains | {"delays": (1e-3, 2e-3)}
            asked["range_of"] = gains | {"quantity": "delay", "count": 20}
        for name, given in asked.items():
            yield f"{name} of {kind}", partial(getattr(loop, name.split()[0]), **given)
    for file in ("phantom.toml", "teleoperation.toml", "gains/pid.toml", "gains/admittance.toml"):
        for name in ("limits", "check", "design"):
            yield f"{name} {file}", partial(said_of, name, SCENES / file)


def said_of(command: str, file: Path) -> str:
    return str(run(command, file, "--json").output)


def main(bits: int, *, is_short: bool) -> None:
    flint.ctx.prec = bits
    calls = {name: partial(outcome, name) for name in COMPUTING_CALLS.keys() - WITHOUT_BALLS}
    answers = {}
    for name, question in {**calls, **dict(questions())}.items():
        if not (is_short and name.removeprefix("HapticLoop.").startswith(LONG)):
            answer = question()
            text = answer if isinstance(answer, str) else as_text(answer)
            answers[name] = text, flint.ctx.prec
    sys.stdout.write(json.dumps(answers))


if __name__ == "__main__":
    main(int(sys.argv[1]), is_short="short" in sys.argv)
