"""Small atlases for the tests, computed once."""

import functools
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
from footers import image_of, sealed

from jaxstab.atlas import Atlas, AtlasSpec, FittedAxis, build_atlas, file
from jaxstab.atlas import schema as footer
from jaxstab.atlas.schema import VARIABLES, stored_of, table_text
from jaxstab.atlas.write.variables import places_of

SMALL = AtlasSpec(
    alpha=FittedAxis(24),
    beta=FittedAxis(20),
    gamma=[0.0, 0.001],
    delta=[0.0, 0.005, 0.015],
    delay=[0.0, 1.5],
    limit_cells=512,
    delay_cells=0,
)

SMALL_TOML = """
alpha = { fitted = 24 }
beta = { fitted = 20 }
gamma = [0, 0.001]
delta = { values = [0.0, 0.005, 0.015] }
delay = [0, 1.5]
limit_cells = 512
delay_cells = 0
"""


@functools.cache
def small_file() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "small.h5"
        build_atlas(SMALL, path)
        return path.read_bytes()


@functools.cache
def moving_atlas() -> Atlas:
    """Limits of alpha at all delays to 1.5, whole ones inside, and nothing else."""
    spec = AtlasSpec(
        gamma=[0.0, 0.001],
        delta=[0.0, 0.005, 0.015],
        delay=[0.0, 1.5],
        products=["alpha_limits"],
        limit_cells=96,
        delay_cells=16,
    )
    with tempfile.TemporaryDirectory() as folder:
        return build_atlas(spec, Path(folder) / "moving.h5")


def write_cut(path: Path) -> Path:
    """Limits of alpha where the stable set goes on beyond all alphas of the atlas."""
    spec = AtlasSpec(
        alpha=[-0.0005, 0.05, 0.1],
        beta=FittedAxis(8),
        gamma=[0.0, 0.001],
        delta=[0.0, 0.015],
        delay=[0.5, 1.0, 1.5],
        products=["verdict", "alpha_limits"],
        limit_cells=12,
        delay_cells=4,
    )
    build_atlas(spec, path)
    return path


def write_whole(path: Path) -> Path:
    """Limits of alpha on axes that hold all stable walls at most delays."""
    spec = AtlasSpec(
        alpha=FittedAxis(10),
        beta=FittedAxis(8),
        gamma=[0.0, 0.001],
        delta=[0.0, 0.015],
        delay=[0.0, 0.5, 2.0],
        products=["verdict", "alpha_limits"],
        limit_cells=12,
        delay_cells=16,
    )
    build_atlas(spec, path)
    return path


@functools.cache
def small_contents() -> file.PackedArrays:
    with tempfile.TemporaryDirectory() as folder:
        return file.read(write_small(Path(folder)))


def small_image() -> bytes:
    image = image_of(small_file())
    assert image is not None
    return image


def small_atlas() -> Atlas:
    return Atlas(small_contents())


def write_small(folder: Path) -> Path:
    path = folder / "small.h5"
    path.write_bytes(small_file())
    return path


def small_table() -> bytes:
    return small_file()[len(small_image()) : -footer.FOOTER.size]


def edited(edit: Callable[[h5py.File], object], image: bytes | None = None) -> bytes:
    """The small atlas, or another one, after an edit, with the right table and footer."""
    with h5py.File.in_memory(image or small_image()) as opened:
        edit(opened)
        opened.flush()
        held = {name: opened[name] for name in VARIABLES if name in opened}
        variables = [
            replace(stored_of(name, own), places=places_of(own)) for name, own in held.items()
        ]
        words = (opened.attrs[name].decode() for name in ("created_by", "filters"))
        table = table_text(*words, variables)
        return sealed(bytes(opened.id.get_file_image()), table)
