"""What an atlas in memory holds: its arrays, products, delays, nodes and outlines. No JAX."""

from collections.abc import Mapping
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.format import schema
from jaxstab.atlas.read import file
from jaxstab.atlas.read.of_loop import AskedByLoops
from jaxstab.atlas.read.outline import AtlasOutline, outline_at
from jaxstab.atlas.read.points import nodes_of
from jaxstab.atlas.read.xarray_view import to_xarray

Floats = NDArray[np.float64]


class HeldAtlas(AskedByLoops):
    """The contents of an atlas file, as ``jaxstab.Atlas`` holds them."""

    arrays: Mapping[str, NDArray[Any]]
    spec: str
    created_by: str
    filters_in_words: str

    def __init__(self, contents: file.Contents) -> None:
        self.arrays = contents.arrays
        self.spec = b"\n".join(self.arrays[schema.SPEC].tolist()).decode("utf-8") + "\n"
        self.created_by = contents.created_by
        self.filters_in_words = contents.filters

    @property
    def products(self) -> tuple[str, ...]:
        """The products that were computed, of ``jaxstab.atlas.format.schema.PRODUCTS``.

        Example:
            >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
            >>> atlas.products
            ('verdict', 'alpha_limits', 'spectral_radius')
        """
        return tuple(name for name, held in schema.PRODUCTS.items() if held[0] in self.arrays)

    @property
    def delays(self) -> Floats:
        """The delays t_d/T of the atlas, ascending.

        Example:
            >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
            >>> atlas.delays.tolist()
            [0.0, 1.0, 1.5]
        """
        return self.arrays["delay"]

    @cached_property
    def filters(self) -> tuple[Any, Any] | None:
        """The Velocity and the Filter, per sample; None for the one-sample difference alone.

        Example:
            >>> str(jaxstab.open_atlas("data/golden/atlas-v3-window.h5").filters[0])
            'the difference over a window of 5 samples'
        """
        found: tuple[Any, Any] | None = of_filters("filters_of")(self.spec)
        return found

    def nodes(self, delay_number: int) -> dict[str, Floats]:
        """Return the nodes along alpha, beta, gamma and delta at one delay of ``delays``.

        Example:
            >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
            >>> {name: nodes.size for name, nodes in atlas.nodes(0).items()}
            {'alpha': 10, 'beta': 9, 'gamma': 3, 'delta': 3}
        """
        return nodes_of(self.arrays, delay_number)

    def to_xarray(self) -> Any:
        """Return all arrays as an xarray.Dataset; RuntimeError if xarray is not installed.

        Example:
            >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
            >>> atlas.to_xarray()["verdict"].dims
            ('alpha_node', 'beta_node', 'gamma', 'delta', 'delay')
        """
        return to_xarray(self.arrays, self.created_by, self.filters_in_words)

    def outline(self, *, gamma: float, delta: float, delay: float) -> AtlasOutline:
        """Return the boundary of the stable region at a node, with its corners.

        Args:
            gamma: physical stiffness k T^2/m, a node.
            delta: physical damping b T/m, a node.
            delay: time delay t_d/T in samples.

        Raises:
            ValueError: a value is no node, or this holds no outlines.

        Source: ``jaxstab.stable_region``.

        Example:
            >>> from pathlib import Path
            >>> from tempfile import TemporaryDirectory
            >>> axes = {"gamma": (0.0,), "delta": (0.015,), "delay": (1.0,)}
            >>> spec = jaxstab.AtlasSpec(**axes, products=("outline",))
            >>> with TemporaryDirectory() as folder:
            ...     atlas = jaxstab.build_atlas(spec, Path(folder) / "atlas.h5")
            >>> outline = atlas.outline(gamma=0.0, delta=0.015, delay=1.0)
            >>> outline.points.max(axis=0).round(3).tolist()  # alpha, beta
            [0.152, 0.84]
        """
        return outline_at(self.arrays, gamma, delta, delay)


def of_filters(name: str) -> Any:
    """Return a function around filters, by name at run time: few questions are about them."""
    return getattr(import_module("jaxstab.atlas.format.filters"), name)
