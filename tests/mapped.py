"""A small map of contacts in several blocks, for the tests of files and for processes that die."""

from pathlib import Path
from typing import Any

import numpy as np

import jaxstab
from jaxstab import HapticLoop, Velocity, contact_map

LOOP = HapticLoop(
    device_mass=0.25,
    device_damping=0.1,
    sample_time=1e-3,
    delay=1e-3,
    velocity=Velocity.difference(window=0.02),
)
WALLS = np.ix_(np.linspace(500.0, 6000.0, 7), np.linspace(2.0, 40.0, 9), [0.0, 0.1, 0.3])
GIVEN = {"stiffness": WALLS[0], "damping": WALLS[1], "friction": WALLS[2]}
AT_REST: dict[str, Any] = {"push": 1.0, "duration": 0.3}
SIZES = {"_BLOCK": 30 * 300, "_LEAST": 1}  # of jaxstab.loop.contact: blocks of 30 contacts


def mapped(path: Path, **options: Any) -> jaxstab.results.Contact:
    return contact_map(LOOP, **GIVEN, **AT_REST, store=path, **options)
