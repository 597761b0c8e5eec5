"""Small atlases for the tests, computed once."""

import functools
from pathlib import Path

from jaxstab.atlas import Atlas, AtlasSpec, FittedAxis, file
from jaxstab.atlas.build import compute

SMALL = AtlasSpec(
    alpha=FittedAxis(24),
    beta=FittedAxis(20),
    gamma=[0.0, 0.001],
    delta=[0.0, 0.005, 0.015],
    delay=[0.0, 1.5],
)

SMALL_TOML = """
alpha = { fitted = 24 }
beta = { fitted = 20 }
gamma = [0, 0.001]
delta = { values = [0.0, 0.005, 0.015] }
delay = [0, 1.5]
"""


@functools.cache
def small_contents() -> file.Contents:
    return file.Contents(compute(SMALL, lambda done, total: None), "jaxstab test")


@functools.cache
def small_image() -> bytes:
    return file.encode(small_contents())


def small_atlas() -> Atlas:
    return Atlas(small_contents())


def write_small(folder: Path) -> Path:
    path = folder / "small.h5"
    file.write(small_contents(), path)
    return path
