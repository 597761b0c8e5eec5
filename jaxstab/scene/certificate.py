"""The claims about a scene's walls, for a reader that does not trust them: ``check_wall.py``.

The file has the numbers of one loop as exact fractions, and of each wall its verdict and between
which stiffnesses, at its damping, walls are stable: proved here (``exact``), and confirmed by a
program of 250 lines without jaxstab, data/check/check_wall.py. It reads loops of one mass with the
difference over a window or first-order low passes, which is what most software has.
"""

from fractions import Fraction
from typing import Any

from jaxstab.conventions import Verdict
from jaxstab.loop import Gains, HapticLoop
from jaxstab.model import Velocity
from jaxstab.scene.limits import stable_intervals
from jaxstab.scene.loops import hands_of, loop_of, walls_of
from jaxstab.scene.scene import Scene

FORMAT = "jaxstab wall 1"


def certificate(scene: Scene) -> dict[str, Any]:
    """The claims about the walls of a scene; ValueError for one that the reader cannot follow."""
    scene.require_walls()
    scene.controller.require_one_delay("a certificate")
    loop = loop_of(scene)
    if loop.body is None or hands_of(scene) is not None or loop.position is not None:
        raise ValueError(
            "a certificate is of one mass and one hand without a position filter; leave out modes, "
            "actuator, grip, ranges and filter."
        )
    numbers = {
        "mass": Fraction(float(loop.device_mass)) + Fraction(float(loop.hand_mass)),
        "damping": Fraction(float(loop.device_damping)) + Fraction(float(loop.hand_damping)),
        "stiffness": Fraction(float(loop.hand_stiffness)),
        "sample_time": Fraction(float(loop.sample_time)),
        "delay_samples": Fraction(float(loop.delay_samples)),
    }
    return {
        "format": FORMAT,
        "loop": {
            **{name: str(number) for name, number in numbers.items()},
            "velocity": _estimator(loop),
        },
        "walls": {name: _claims(loop, wall) for name, wall in walls_of(scene).items()},
    }


def _estimator(loop: HapticLoop) -> dict[str, str]:
    """The keys of the estimator as in scenes, a cut-off in cycles per sample."""
    sections = (loop.velocity or Velocity()).filter.per_sample(loop.sample_time).sections
    keys = {**sections[0].toml} if sections else {"window_samples": 1}
    if len(sections) > 1 or {*keys} not in ({"window_samples"}, {"cutoff", "order"}):
        raise ValueError(
            f"velocity is {loop.velocity}; a certificate is of a difference or a low pass."
        )
    return {name: str(Fraction(value)) for name, value in keys.items()}


def _claims(loop: HapticLoop, wall: Gains) -> dict[str, Any]:
    verdict = Verdict(int(loop.verdict(*wall)))
    if verdict == Verdict.UNDECIDED:
        raise ValueError(f"the wall {tuple(wall)} is not decided; there is nothing to certify.")
    intervals = stable_intervals(loop.stiffness_intervals(wall.damping), 1.0, wall.stiffness)
    return {
        "stiffness": str(Fraction(wall.stiffness)),
        "damping": str(Fraction(wall.damping)),
        "verdict": verdict.name.lower(),
        "stiffness_intervals": [[repr(low), repr(high)] for low, high in intervals if low < high],
    }
