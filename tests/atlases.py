"""Small atlases for the tests, computed once."""

import functools
import tempfile
from collections.abc import Callable
from pathlib import Path

import h5py

from jaxstab.atlas import Atlas, AtlasSpec, FieldSpec, FittedAxis, build_atlas

SMALL = AtlasSpec(
    gamma=[0.0, 0.001],
    delta=[0.0, 0.005, 0.015],
    delay=[0.0, 0.25, 0.5, 1.0, 1.5],
    rows=17,
    fields=FieldSpec(alpha=FittedAxis(24), beta=FittedAxis(20), delay=[0.0, 1.5]),
)

SMALL_TOML = """
gamma = [0, 0.001]
delta = { values = [0.0, 0.005, 0.015] }
delay = [0, 0.25, 0.5, 1.5]
rows = 17

[fields]
alpha = { fitted = 24 }
beta = { fitted = 20 }
delay = [0, 1.5]
"""


@functools.cache
def small_file() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "small.h5"
        build_atlas(SMALL, path)
        return path.read_bytes()


def write_small(folder: Path) -> Path:
    path = folder / "small.h5"
    path.write_bytes(small_file())
    return path


def small_atlas(folder: Path) -> Atlas:
    return Atlas(write_small(folder))


def edited(path: Path, edit: Callable[[h5py.File], object], data: bytes | None = None) -> Path:
    """Write the small atlas, or another one, after an edit; its checksums are right."""
    with h5py.File.in_memory(data or small_file()) as opened:
        edit(opened)
        opened.flush()
        path.write_bytes(bytes(opened.id.get_file_image()))
    return path
