"""Small atlases for the tests, computed once."""

import functools
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from jaxstab.atlas import Atlas, AtlasSpec, FieldSpec, build_atlas

SMALL = AtlasSpec(
    gamma=[0.0, 0.001],
    delta=[0.0, 0.005, 0.015],
    delay=[0.0, 0.25, 0.5, 1.0, 1.5],
    rows=17,
    fields=FieldSpec(alpha=24, beta=20, delay=[0.0, 1.5]),
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


# Edits of an atlas that a reader refuses, by their names.


def set_to(name: str, value: Any, place: Any = ...) -> Callable[[h5py.File], None]:
    return lambda opened: opened[name].__setitem__(place, value)


def replaced(name: str, values: Any, **options: Any) -> Callable[[h5py.File], None]:
    def edit(opened: h5py.File) -> None:
        del opened[name]
        opened.create_dataset(name, data=values, **options)

    return edit


def attribute(name: str, value: Any) -> Callable[[h5py.File], None]:
    return lambda opened: opened.attrs.__setitem__(name, value)


CHUNKED = {"chunks": True, "fletcher32": True}
UNSOUND = {
    "no limits": lambda opened: opened.__delitem__("alpha_limits"),
    "a negative error": set_to("alpha_error", -1.0, (0, 0, 0, 0, 0)),
    "an error that is NaN": set_to("beta_error", np.nan, (0, 0, 0, 0)),
    "an infinite limit": set_to("alpha_limits", np.inf, (0, 0, 0, 1, 1)),
    "nodes out of order": set_to("delay", [1.5, 0.0, 0.5, 1.0, 2.0]),
    "nodes that are NaN": set_to("gamma", [0.0, np.nan]),
    "a delay beyond all": set_to("delay", 1e9, 4),
    "rows that are not even": set_to("row", np.linspace(0.0, 1.0, 17) ** 2),
    "another code": set_to("beyond", 7, (0, 0, 0)),
    "another type": replaced("gamma", np.array([0, 1]), **CHUNKED),
    "another shape": replaced("beta_limits", np.zeros((2, 3, 4, 2)), **CHUNKED),
    "no checksum": replaced("gamma", np.array([0.0, 0.001]), chunks=True),
    "no chunks": replaced("gamma", np.array([0.0, 0.001])),
    "a link": lambda opened: (
        opened.__delitem__("row"),
        opened.__setitem__("row", h5py.SoftLink("/gamma")),
    ),
    "an external link": lambda opened: (
        opened.__delitem__("row"),
        opened.__setitem__("row", h5py.ExternalLink("/etc/passwd", "/row")),
    ),
    "a filter that expands": replaced("gamma", np.zeros(2), compression="gzip", **CHUNKED),
    "words that are numbers": attribute("filters", 7),
    "no count": lambda opened: opened.attrs.__delitem__("tested_points"),
    "words that are not UTF-8": attribute("created_by", np.bytes_(b"\xff\xfe")),
    "a version that is none": attribute("schema_version", np.bytes_(b"four")),
}
