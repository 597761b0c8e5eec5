"""One good call of each public function or method that computes, and what it answers as a text.

A call is a list of arguments, with a dict of keywords at its end where there are some; "loop" is
for a HapticLoop, "held" for one with a hand's spring, "loops" for several, "hands" for a HandRange,
"function" for one that is evaluated on a grid.
"""

import re
import sys
from collections.abc import Callable, Iterator
from operator import attrgetter
from typing import Any

import numpy as np

import jaxstab
from jaxstab.arrays import leaves

PUBLIC = (
    *jaxstab.__all__,
    *(f"paper.{name}" for name in jaxstab.paper.__all__),
    *(f"results.{name}" for name in jaxstab.results.__all__),
)
"""Every public name, as an attribute of the package."""

COMPUTING_CALLS: dict[str, list[Any]] = {
    "boundary_curve": [1.0, {"gamma": 0.001, "delta": 0.015, "delay": 1.0}],
    "paper.minus_line": [0.1, {"gamma": 0.001, "delta": 0.015, "delay": 1.0}],
    "paper.plus_line": [0.1, {"gamma": 0.001, "delta": 0.015, "delay": 1.0}],
    "stable_region": [{"gamma": 0.001, "delta": 0.015, "delay": 1.0}],
    "paper.plant_coefficients": [{"gamma": 0.001, "delta": 0.015}],
    "characteristic_polynomial": [0.1, 0.2, {"gamma": 0.001, "delta": 0.015, "delay": 1.0}],
    "companion_matrix": [[1.0, -0.5, 0.25]],
    "is_schur": [[1.0, -0.5, 0.25]],
    "radius": [[1.0, -0.5, 0.25]],
    "closed_loop_poles": [0.1, 0.2, {"gamma": 0.001, "delta": 0.015, "delay": 1.0}],
    "spectral_radius": [0.1, 0.2, {"gamma": 0.001, "delta": 0.015, "delay": 1.0}],
    "evaluate_grid": ["function", 0.1, 0.2, {"gamma": 0.001, "delta": 0.015, "delay": 1.0}],
    "verdict": [0.1, 0.2, {"gamma": 0.001, "delta": 0.015, "delay": 1.0}],
    "settling_samples": [0.1, 0.2, {"gamma": 0.001, "delta": 0.015, "delay": 1.0}],
    "amplitude": [
        0.1,
        0.2,
        {"gamma": 0.001, "delta": 0.015, "delay": 1.0, "encoder": 1.0, "friction": 0.01},
    ],
    "dominant_mode": [0.1, 0.2, {"gamma": 0.001, "delta": 0.015, "delay": 1.0}],
    "minimize_radius": [{"gamma": 0.001, "delta": 0.015, "delay": 1.0}],
    "minimize_settling": [{"gamma": 0.001, "delta": 0.015, "delay": 1.0}],
    "margins": [0.1, 0.2, {"gamma": 0.001, "delta": 0.015, "delay": 1.0}],
    "paper.linear_alpha_limit": [0.2, {"delta": 0.015, "delay": 1.0}],
    "paper.linear_condition": [0.1, 0.2, {"gamma": 0.001, "delta": 0.015, "delay": 1.0}],
    "paper.linear_error": [0.1, 0.2, {"gamma": 0.001, "delta": 0.015, "delay": 1.0}],
    "paper.linear_validity": [0.02, {"gamma": 0.001, "delta": 0.015, "delay": 1.0}],
    "paper.passive_region": [{"delta": 0.015, "delay": 1.0}],
    "robust_region": [
        {"gamma": (0.0, 0.001), "delta": (0.01, 0.015), "delay": 1.0, "tolerance": 0.1}
    ],
    "paper.routh_hurwitz_condition": [0.1, 0.2, {"gamma": 0.001, "delta": 0.015, "delay": 1.0}],
    "trace_boundary": [
        ("gamma", "delta"),
        ((0.0, 1.0), (0.0, 1.0)),
        {"alpha": 0.1, "beta": 0.2, "delay": 1.0},
    ],
    "HapticLoop.verdict": ["loop", 1000.0, 10.0],
    "HapticLoop.spectral_radius": ["loop", 1000.0, 10.0],
    "HapticLoop.poles": ["loop", 1000.0, 10.0],
    "HapticLoop.margins": ["loop", 1000.0, 10.0],
    "HapticLoop.frequency_margins": ["loop", 1000.0, 10.0],
    "HapticLoop.is_usable": ["loop", 1000.0, 10.0, {"phase_margin": 30.0}],
    "HapticLoop.is_passive": ["loop", 10.0, 0.0],
    "HapticLoop.passive_region": ["loop"],
    "HapticLoop.one_sided": ["held", 1000.0, 10.0],
    "HapticLoop.one_sided_limit": ["held", {"damping": 10.0}],
    "HapticLoop.jitter_margin": ["loop", 1000.0, 10.0],
    "HapticLoop.worst_delays": ["loop", 1000.0, 10.0, {"delays": (0.0, 1e-3)}],
    "HapticLoop.settling_time": ["loop", 1000.0, 10.0],
    "HapticLoop.amplitude": ["loop", 1000.0, 10.0, {"encoder": 1e-5, "force_step": 0.01}],
    "HapticLoop.oscillation": ["loop", 1000.0, 10.0],
    "HapticLoop.simulate": ["loop", 1000.0, 10.0, {"force": 1.0}],
    "contact": ["loop", 1000.0, 10.0, {"push": 1.0, "friction": 0.1, "duration": 1}],
    "HapticLoop.region": ["loop"],
    "HapticLoop.limits": ["loop"],
    "HapticLoop.boundary": ["loop"],
    "HapticLoop.intervals": ["loop", {"damping": 10.0}],
    "HapticLoop.stiffness_limits": ["loop", 10.0],
    "HapticLoop.damping_limits": ["loop", 1000.0],
    "HapticLoop.stiffness_intervals": ["loop", 10.0],
    "HapticLoop.damping_intervals": ["loop", 1000.0],
    "HapticLoop.range_of": [
        "loop",
        {"quantity": "delay", "stiffness": 1000.0, "damping": 10.0, "count": 50},
    ],
    "HapticLoop.boundary_distance": ["loop", 1000.0, 10.0],
    "HapticLoop.tune": ["loop"],
    "HapticLoop.worst_hand": ["loop", "hands", 1000.0, 10.0],
    "HapticLoop.robust_limit": ["loop", "hands"],
    "tune_for_all": ["loops"],
    "limits_of": ["loops"],
    "regions_of": ["loops"],
}


OBJECTS: dict[str, Callable[[], Any]] = {
    "loop": lambda: jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3),
    "held": lambda: jaxstab.HapticLoop(
        device_mass=0.1, device_damping=1.5, hand_stiffness=100.0, sample_time=1e-3
    ),
    "loops": lambda: [
        jaxstab.HapticLoop(device_mass=mass, device_damping=1.5, sample_time=1e-3)
        for mass in (0.1, 0.12)
    ],
    "hands": lambda: jaxstab.HandRange(mass=(0.0, 1.0)),
    "function": lambda: jaxstab.verdict,
}


def as_text(answer: Any) -> str:
    """Every bit of an answer: two answers with the same text are the same."""
    answer = list(answer) if isinstance(answer, Iterator) else answer
    with np.printoptions(threshold=sys.maxsize, floatmode="unique"):
        parts = [f"{np.asarray(leaf).dtype}{np.asarray(leaf)!r}" for leaf in leaves(answer)]
    return re.sub(r" at 0x[0-9a-f]+", "", "\n".join(parts))  # where functions lie in memory


def outcome(name: str, array: Callable[[Any], Any] | None = None) -> str:
    """What a call answers, or the error that it ends with; array makes arrays of its numbers."""
    try:
        given = [
            OBJECTS[value]() if isinstance(value, str) else value for value in COMPUTING_CALLS[name]
        ]
        options = given.pop() if isinstance(given[-1], dict) else {}
        if array is not None:
            given = [array(value) if _are_numbers(value) else value for value in given]
            options = {k: array(v) if _are_numbers(v) else v for k, v in options.items()}
        return as_text(attrgetter(name)(jaxstab)(*given, **options))
    except Exception as error:  # noqa: BLE001
        return f"{type(error).__name__}: {error}"


def _are_numbers(value: Any) -> bool:
    return isinstance(value, float | list) and np.asarray(value).dtype.kind == "f"
