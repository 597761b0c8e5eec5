"""Answers from an atlas in memory: at a node what it holds, elsewhere only what is proved.

NumPy and h5py alone: no JAX, and nothing else that takes time to import.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from itertools import product
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxstab.atlas import file, schema
from jaxstab.conventions import AXES, NOT_COMPUTED, STABLE, UNDECIDED, UNSTABLE

Floats = NDArray[np.float64]
Integers = NDArray[np.intp]
Mask = NDArray[np.bool_]
Numbers = ArrayLike | float | int


class QueryStatus(IntEnum):
    """How an atlas knows what it answers for a point."""

    NODE = 1
    CELL = 2
    UNDECIDED_CELL = 3
    BETWEEN_DELAYS = 4
    OUTSIDE = 5

    @property
    def words(self) -> str:
        """The status in words."""
        return _WORDS[self]


_WORDS = {
    QueryStatus.NODE: "a node: the atlas holds verdict and radius of this very point",
    QueryStatus.CELL: "between nodes: the verdict is proved for the whole cell, the radius is "
    "interpolated and has no error bound",
    QueryStatus.UNDECIDED_CELL: "between nodes: no verdict is proved for the whole cell, the "
    "radius is interpolated and has no error bound",
    QueryStatus.BETWEEN_DELAYS: "between two delays of the atlas: it says nothing here",
    QueryStatus.OUTSIDE: "outside of the atlas: it says nothing here",
}


@dataclass(frozen=True)
class AtlasAnswer:
    """What an atlas says about points; four arrays of the broadcast shape of the query.

    Attributes:
        verdict: int8 codes of ``jaxstab.Verdict``. STABLE and UNSTABLE are proved between nodes;
            at a node they are what the atlas holds, whose interpretation says what is proved.
            UNDECIDED where the atlas cannot decide; NOT_COMPUTED when it holds no verdicts.
        spectral_radius: computed at a node, multilinearly interpolated elsewhere; NaN where the
            atlas holds none.
        radius_error: proved bound of the error of ``spectral_radius``; infinite without one.
        status: int8 codes of ``QueryStatus``: how this is known.
    """

    verdict: NDArray[np.int8]
    spectral_radius: Floats
    radius_error: Floats
    status: NDArray[np.int8]

    def reshaped(self, shape: tuple[int, ...]) -> "AtlasAnswer":
        """Return the same answer with arrays of another shape."""
        return AtlasAnswer(
            self.verdict.reshape(shape),
            self.spectral_radius.reshape(shape),
            self.radius_error.reshape(shape),
            self.status.reshape(shape),
        )


class Atlas:
    """An atlas in memory; ``open_atlas`` makes it.

    Attributes:
        arrays: the variables of the file by name (``jaxstab.atlas.schema`` describes them).
        spec: the TOML text from which the atlas was built.
        created_by: the program and version that built it.
    """

    arrays: Mapping[str, NDArray[Any]]
    spec: str
    created_by: str

    def __init__(self, contents: file.Contents) -> None:
        self.arrays = MappingProxyType(dict(contents.arrays))
        for array in self.arrays.values():
            array.flags.writeable = False
        self.spec = b"\n".join(self.arrays[schema.SPEC].tolist()).decode("utf-8") + "\n"
        self.created_by = contents.created_by

    @property
    def products(self) -> tuple[str, ...]:
        """What was chosen to be computed, of "verdict" and "spectral_radius"."""
        return tuple(name for name in schema.PRODUCTS if name in self.arrays)

    @property
    def delays(self) -> Floats:
        """The delays t_d/T of the atlas, ascending."""
        return self.arrays["delay"]

    def nodes(self, delay_number: int) -> dict[str, Floats]:
        """Return the nodes along alpha, beta, gamma and delta at one delay of ``delays``."""
        return {
            "alpha": self.arrays["alpha"][:, delay_number],
            "beta": self.arrays["beta"][:, delay_number],
            "gamma": self.arrays["gamma"],
            "delta": self.arrays["delta"],
        }

    def decided_fraction(self, delay_number: int) -> float:
        """Return the share of the volume at one delay in which a query between nodes is decided."""
        if schema.CELL_VERDICT not in self.arrays:
            return 0.0
        verdict = self.arrays[schema.CELL_VERDICT][..., delay_number]
        share = ((verdict == STABLE) | (verdict == UNSTABLE)).astype(np.float64)
        for nodes in self.nodes(delay_number).values():
            widths = np.diff(nodes) if nodes.size > 1 else np.ones(1)
            share = np.tensordot(widths / widths.sum(), share, 1)
        return float(share)

    def query(
        self,
        alpha: Numbers,
        beta: Numbers,
        gamma: Numbers,
        delta: Numbers,
        delay: Numbers,
        outside: Literal["error", "undecided"] = "error",
    ) -> AtlasAnswer:
        """Answer for points of any broadcast shape, and never with a guess.

        At a node of the grid the answer is what was computed there. Between nodes the verdict is
        given where it is proved for the whole cell, and is UNDECIDED elsewhere. A delay that is not
        one of ``delays`` is UNDECIDED.

        Args:
            alpha: wall stiffness K T^2/m.
            beta: wall damping B T/m.
            gamma: physical stiffness k T^2/m.
            delta: physical damping b T/m.
            delay: time delay t_d/T in samples.
            outside: "error" to refuse points outside of the atlas, "undecided" to answer so.

        Raises:
            TypeError: an argument is not made of real numbers.
            ValueError: a value is NaN or, unless ``outside`` is "undecided", outside of the atlas.

        Source: the certificates are those of ``jaxstab.atlas.certificate``.
        """
        if outside not in ("error", "undecided"):
            raise ValueError(f"outside is {outside!r}; give 'error' or 'undecided'.")
        values = [
            _checked(name, value)
            for name, value in zip(AXES, (alpha, beta, gamma, delta, delay), strict=True)
        ]
        points = np.broadcast_arrays(*values)
        shape = points[0].shape
        answer = _no_answer(points[0].size, schema.VERDICT in self.arrays)
        where = dict(zip(AXES, (point.reshape(-1) for point in points), strict=True))
        self._find_outside(where, answer.status, refuse=outside == "error")
        for number, delay_node in enumerate(self.delays):
            here = np.flatnonzero(
                (where["delay"] == delay_node) & (answer.status != QueryStatus.OUTSIDE)
            )
            if here.size:
                self._answer_at_delay(number, where, here, answer)
        return answer.reshaped(shape)

    def _find_outside(
        self, where: Mapping[str, Floats], status: NDArray[np.int8], *, refuse: bool
    ) -> None:
        """Mark points outside of the atlas, or refuse the first."""

        def check(name: str, nodes: Floats, members: Mask, at: str = "") -> None:
            beyond = members & ~((where[name] >= nodes[0]) & (where[name] <= nodes[-1]))
            if refuse and np.any(beyond):
                raise ValueError(
                    f"{name} is {float(where[name][beyond][0])!r}, and this atlas reaches from "
                    f"{float(nodes[0])!r} to {float(nodes[-1])!r}{at}; ask inside of it, or with "
                    "outside='undecided'."
                )
            status[beyond] = QueryStatus.OUTSIDE

        everywhere = np.ones(status.shape, bool)
        for name in ("gamma", "delta", "delay"):
            check(name, self.arrays[name], everywhere)
        for number, delay in enumerate(self.delays):
            members = where["delay"] == delay
            for name in ("alpha", "beta"):
                nodes = self.arrays[name][:, number]
                check(name, nodes, members, f" at delay {float(delay):g}")

    def _answer_at_delay(
        self, number: int, where: Mapping[str, Floats], here: Integers, answer: AtlasAnswer
    ) -> None:
        """Fill in the answer for the points numbered ``here``, all at one delay and inside."""
        place = _Place.of(
            [(nodes, where[name][here]) for name, nodes in self.nodes(number).items()]
        )
        status = np.where(place.at_node, QueryStatus.NODE, QueryStatus.UNDECIDED_CELL)
        if schema.VERDICT in self.arrays:
            at_node = self.arrays[schema.VERDICT][..., number][place.node]
            in_cell = self.arrays[schema.CELL_VERDICT][..., number][place.cell]
            answer.verdict[here] = np.where(place.at_node, at_node, in_cell)
            proved = ~place.at_node & ((in_cell == STABLE) | (in_cell == UNSTABLE))
            status[proved] = QueryStatus.CELL
        if schema.SPECTRAL_RADIUS in self.arrays:
            radius = self.arrays[schema.SPECTRAL_RADIUS][..., number]
            error = self.arrays[schema.RADIUS_ERROR][..., number]
            between = place.interpolated(radius)
            answer.spectral_radius[here] = np.where(place.at_node, radius[place.node], between)
            answer.radius_error[here] = np.where(place.at_node, error[place.node], np.inf)
        answer.status[here] = status


def open_atlas(path: str | PathLike[str]) -> Atlas:
    """Load an atlas into memory, all of it checked.

    Raises:
        OSError: the file is missing or unreadable.
        ValueError: it is foreign, truncated, damaged or of another version of the schema.
    """
    return Atlas(file.read(Path(path)))


def _checked(name: str, value: Numbers) -> Floats:
    numbers = np.asarray(value)
    if numbers.dtype.kind not in "iuf":
        raise TypeError(f"{name} is {value!r}; give real numbers.")
    numbers = numbers.astype(np.float64)
    if np.any(np.isnan(numbers)):
        raise ValueError(f"{name} is NaN; give numbers.")
    return numbers


def _no_answer(size: int, has_verdicts: bool) -> AtlasAnswer:
    return AtlasAnswer(
        verdict=np.full(size, UNDECIDED if has_verdicts else NOT_COMPUTED, np.int8),
        spectral_radius=np.full(size, np.nan),
        radius_error=np.full(size, np.inf),
        status=np.full(size, QueryStatus.BETWEEN_DELAYS, np.int8),
    )


@dataclass(frozen=True)
class _Place:
    """Where points are in a grid: index arrays, one for each axis."""

    cell: tuple[Integers, ...]  # nodes[cell] <= point <= nodes[cell + 1]
    node: tuple[Integers, ...]  # the node, where the point is one
    at_node: Mask
    part: tuple[Floats, ...]  # how far through the cell, from 0 to 1

    @classmethod
    def of(cls, axes: Sequence[tuple[Floats, Floats]]) -> "_Place":
        """Find points along each axis, given as its nodes and the points' coordinates."""
        cells, node, at_node, part = [], [], np.ones(axes[0][1].shape, bool), []
        for nodes, points in axes:
            cells_along = max(nodes.size - 1, 1)
            cell = np.clip(np.searchsorted(nodes, points, side="right") - 1, 0, cells_along - 1)
            lower, upper = nodes[cell], nodes[np.minimum(cell + 1, nodes.size - 1)]
            cells.append(cell)
            node.append(cell + ((points == upper) & (upper > lower)))
            at_node &= (points == lower) | (points == upper)
            part.append((points - lower) / np.where(upper > lower, upper - lower, 1.0))
        return cls(tuple(cells), tuple(node), at_node, tuple(part))

    def interpolated(self, values: Floats) -> Floats:
        """Return the multilinear interpolation of values at nodes."""
        total = np.zeros(self.at_node.shape)
        for corner in product((0, 1), repeat=len(self.cell)):
            sides = zip(corner, self.part, strict=True)
            weight = np.prod([part if side else 1.0 - part for side, part in sides], axis=0)
            node = [c + side for side, c in zip(corner, self.cell, strict=True)]
            value = values[tuple(map(np.minimum, node, np.array(values.shape) - 1))]
            total += np.where(weight > 0.0, weight * value, 0.0)
        return total
