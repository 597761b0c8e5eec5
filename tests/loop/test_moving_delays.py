"""Delays that move: what a proof for every constant delay does not cover."""

import re
from pathlib import Path

import numpy as np
import pytest

import jaxstab
from jaxstab import HandRange, HapticLoop, Verdict
from jaxstab.loop.hands import HandFamily

ROOT = Path(__file__).parents[2]
WALL = (6669.1, 71.60)  # N/m, N s/m
MASS, DAMPING, T = 0.1, 0.05, 1e-3  # kg, N s/m, s
CLAIM = "constant while the wall is touched"
STATED = ("README.md", "docs/model.md", "docs/guide.md", "docs/which.md")


def _largest(delays: list[int], seconds: float) -> float:
    """Largest position in m from 1 mm on, with the force of the newest sample that has arrived.

    Delays are whole samples, repeated in turn. The mass moves exactly between the samples: its
    velocity decays with b/m, and the force is constant.
    """
    rate = DAMPING / MASS
    decay = np.exp(-rate * T)
    x, v = 1e-3, 0.0
    positions, largest = [x, x], 0.0
    for k in range(round(seconds / T)):
        newest = k - delays[k % len(delays)]
        at = newest + 1  # positions[0] is that of sample -1
        speed = (positions[at] - positions[at - 1]) / T if newest >= 0 else 0.0
        force = -WALL[0] * positions[max(at, 0)] - WALL[1] * speed
        end = force / DAMPING  # the speed at which the damper balances the force
        x, v = x + end * T + (v - end) * (1.0 - decay) / rate, end + (v - end) * decay
        positions.append(x)
        largest = max(largest, abs(x))
    return largest


def test_a_wall_stable_at_every_constant_delay_grows_with_a_delay_that_moves() -> None:
    loop = HapticLoop(device_mass=MASS, device_damping=DAMPING, sample_time=T)
    constant = HandFamily(loop, HandRange(), delay=(0.0, T))
    assert constant.worst(*WALL).verdict == Verdict.STABLE
    assert _largest([0], 2.0) < 2e-3
    assert _largest([1], 2.0) < 1e-2
    assert _largest([1, 1, 1, 0], 2.0) > 10.0


@pytest.mark.parametrize("page", STATED)
def test_pages_say_that_the_loop_is_constant_during_contact(page: str) -> None:
    text = " ".join((ROOT / page).read_text(encoding="utf-8").split())
    assert CLAIM in text


def test_the_public_claims_over_ranges_say_so_too() -> None:
    header = (ROOT / "jaxstab/lab/guard/guard.h.in").read_text(encoding="utf-8")
    claims = (
        HapticLoop.worst_hand.__doc__,
        jaxstab.results.Guard.__doc__,
        jaxstab.build_guard.__doc__,
        *(
            " ".join(re.findall(rf"(?m)^{kind}\| \* (.*)", header))
            for kind in ("MOVING", "CONSTANT")
        ),
    )
    for text in claims:
        assert CLAIM in " ".join(str(text).split())
