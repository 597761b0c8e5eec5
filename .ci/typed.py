"""What type checkers know of an installed jaxstab: mypy --strict and pyright find no fault."""

from typing import Any, assert_type

import jaxstab

loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
limits = loop.limits()
assert_type(limits.stiffness, float)
assert_type(limits.islands, tuple[jaxstab.results.Limits[float], ...])
assert_type(loop.region().main, jaxstab.results.Region | None)
best = loop.tune("radius")
assert_type(best.status, jaxstab.results.TuningStatus)
hands = jaxstab.HandRange(mass=(0.0, 1.0))
assert_type(loop.worst_hand(hands, 1000.0, 10.0).verdict, jaxstab.Verdict)
window = jaxstab.Velocity.difference(window=0.02)
assert_type(window, jaxstab.Velocity)
region = jaxstab.stable_region(gamma=0.0, delta=0.015, delay=1.0, velocity=window.per_sample(1e-3))
assert_type(region, jaxstab.results.StableRegion)
radius: Any = jaxstab.spectral_radius(0.1, 0.2, gamma=0.0, delta=0.015, delay=1.0).value
atlas = jaxstab.open_atlas("atlas.h5")
assert_type(atlas.query(0.1, 0.2, gamma=0.0, delta=0.015, delay=1.0), jaxstab.results.AtlasAnswer)
assert_type(jaxstab.paper.passive_region(delta=1.0), jaxstab.results.PassiveRegion)
