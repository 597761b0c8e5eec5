"""What variables and products of an atlas are, and the variables that every atlas has.

A file holds one HDF5 image, a table of its chunks (``atlas.schema``) and a footer. The image holds
its variables in the root group, with dimension scales. All numbers are dimensionless. Each variable
says here what its numbers mean, of which type they are and which values are allowed; readers refuse
anything else. The variables of a product are with the product (``atlas.products``), those of all
atlases below: the axes and the specification.

An atlas holds products: verdicts, limits of alpha, fields, outlines, summaries. All that is
particular to one is in its module, as a subclass of ``Product``: one object that answers for

- its variables, which values of them a reader accepts, and how they fit together;
- ``compute``: what a tile of a build holds of it, and ``known_before``: what no tile holds;
- ``small_grid``: the grid of a small part of it, from which a plan tells its cost;
- ``checks``: how ``jaxstab atlas verify`` compares a file with a new computation.

Format, build, plan and verification go through ``products.table.PRODUCTS`` and ask each object. So
a new product is a new module and a line in that table.

Readers load these modules, without JAX, HDF5 or anything else that takes time to import: what
computes is imported inside the methods that builds, plans and verification call.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf, prod
from typing import TYPE_CHECKING, Any, ClassVar, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.conventions import Verdict

if TYPE_CHECKING:
    from jaxstab.atlas.plan import Grid, Plan, Tile
    from jaxstab.model.filters import Filters


LARGEST_UNASKED: Final = 2 * 10**8  # bytes
LARGEST_ARRAY: Final = 2**31  # bytes that are read into memory at once
LARGEST_ATLAS: Final = 2**38  # nodes
LARGEST_SLICE: Final = 2**22  # nodes along alpha and beta
LARGEST_DELAY: Final = 100.0
LEAST_SPAN: Final = 1e-300  # of alpha and beta: cells to it do not overflow
LEAST_SHARE: Final = 2.0**-24  # of the larger of its ends: rounding swallows no cell of a span
SPEC: Final = "spec"
NODE: Final = ("alpha_node", "beta_node", "gamma", "delta", "delay")
CELL: Final = ("alpha_cell", "beta_cell", "gamma_cell", "delta_cell", "delay")
SLICE: Final = ("gamma", "delta", "delay")
FLAG_VALUES: Final = tuple(int(code) for code in Verdict)
FLAG_MEANINGS: Final = " ".join(code.name.lower() for code in Verdict)
CODES: Final = (min(FLAG_VALUES), max(FLAG_VALUES))


@dataclass(frozen=True)
class Variable:
    """One dataset: its type, its dimensions (itself for an axis), what it means and its range.

    ``attributes`` are those of the dataset that are not the same for all.
    """

    name: str
    dtype: str
    dimensions: tuple[str, ...]
    long_name: str
    interpretation: str
    lowest: float | int = -inf
    highest: float | int = inf
    has_nan: bool = False
    attributes: tuple[tuple[str, str], ...] = ()

    @property
    def is_packed(self) -> bool:
        """Whether its chunks are shuffled and deflated; those of others are plain numbers."""
        return self.dimensions in (NODE, CELL)

    @property
    def is_axis(self) -> bool:
        """Whether this is the coordinate of the dimension of its name (an HDF5 dimension scale)."""
        return self.dimensions == (self.name,)

    @property
    def holds_verdicts(self) -> bool:
        """Whether the values are codes of ``jaxstab.Verdict``."""
        return self.dtype == "int8"


def _axis(name: str, long_name: str, interpretation: str, highest: float = inf) -> Variable:
    return Variable(name, "float64", (name,), long_name, interpretation, 0.0, highest)


def numbers(name: str, interpretation: str) -> Variable:
    """Return the axis of a dimension without a coordinate: 0, 1, 2 ..."""
    return Variable(name, "int32", (name,), f"number along {name}", interpretation, 0)


def _cells(axis: str, nodes: str) -> Variable:
    return numbers(f"{axis}_cell", f"cell i lies between {nodes} i and i + 1; of one node, at it")


AXIS_VARIABLES: Final = (
    _axis("delay", "time delay", "t_d/T, in sampling periods T", LARGEST_DELAY),
    _axis("gamma", "physical stiffness", "k T^2/m, k of device and hand"),
    _axis("delta", "physical damping", "b T/m, b of device and hand"),
    numbers("alpha_node", "node i at delay k is at alpha[i, k]"),
    numbers("beta_node", "node i at delay k is at beta[i, k]"),
    _cells("alpha", "alpha_node"),
    _cells("beta", "beta_node"),
    _cells("gamma", "gamma"),
    _cells("delta", "delta"),
    Variable(
        "alpha",
        "float64",
        ("alpha_node", "delay"),
        "stiffness of the virtual wall",
        "K T^2/m; one column of ascending nodes for each delay",
    ),
    Variable(
        "beta",
        "float64",
        ("beta_node", "delay"),
        "damping of the virtual wall",
        "B T/m; one column of ascending nodes for each delay",
    ),
)

SPEC_VARIABLES: Final = (
    numbers("spec_line", "line of the specification"),
    Variable(
        SPEC,
        "S",
        ("spec_line",),
        "specification of this atlas",
        "the lines of a TOML file from which the same atlas can be built",
    ),
)


# What a product of an atlas is to the rest of the package.

Array = NDArray[Any]
Arrays = Mapping[str, Array]
Floats = NDArray[np.float64]
SliceIndex = Sequence[int]  # numbers along gamma, delta and delay
_SLICES = 16  # that are verified


class Check(NamedTuple):
    """One check: its name, whether it passed, and its finding."""

    name: str
    passed: bool
    words: str

    def __str__(self) -> str:
        return f"{self.name}: {'ok' if self.passed else 'WRONG'}, {self.words}"


@dataclass(frozen=True)
class Inspection:
    """A file under verification: its datasets by name, its filters as keywords, and the sample.

    ``sample`` is about how many points are computed again, ``chance`` chooses them.
    """

    datasets: Mapping[str, Any]
    filters: Mapping[str, Any]
    sample: int
    chance: np.random.Generator

    def places(self, counts: Sequence[int]) -> list[SliceIndex]:
        """Return some of the slices, each once."""
        slices = prod(counts)
        chosen = self.chance.choice(slices, min(_SLICES, self.sample, slices), replace=False)
        places: list[SliceIndex] = np.stack(np.unravel_index(chosen, counts), axis=-1).tolist()
        return places

    def loop(self, place: SliceIndex) -> tuple[float, float, float]:
        """Return gamma, delta and delay of a slice."""
        gamma, delta, delay = (
            float(self.datasets[name][index]) for name, index in zip(SLICE, place, strict=True)
        )
        return gamma, delta, delay


class Product:
    """A product, with the defaults of most.

    Attributes:
        name: in a specification.
        variables: in the order of the file.
        gridded: the variables of which a plan counts the points.
        fixed: the variables that no tile holds, for they follow from the specification.
        rows: the one of them that has cells of delays with their ends of alpha and beta, if any.
        strung: variables of counts, and the dimension along which these places are strung.
        lengths: the lengths of dimensions that no atlas may change.
        unit: the dimensions of what its cost is proportional to.
    """

    name: ClassVar[str]
    variables: ClassVar[tuple[Variable, ...]]
    gridded: ClassVar[tuple[str, ...]] = ()
    fixed: ClassVar[tuple[str, ...]] = ()
    rows: ClassVar[str] = ""
    strung: ClassVar[Mapping[str, str]] = {}
    lengths: ClassVar[Mapping[str, int]] = {}
    unit: ClassVar[tuple[str, ...]] = SLICE

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the variables."""
        return tuple(variable.name for variable in self.variables)

    def compute(self, plan: "Plan", tile: "Tile") -> dict[str, Array]:
        """Return what a tile holds, each array of the shape ``plan.shape``."""
        raise NotImplementedError

    def known_before(self, grid: "Grid", filters: "Filters | None") -> dict[str, Array]:
        """Return the variables of ``fixed``."""
        return {}

    def attributes(self, datasets: Mapping[str, Any]) -> dict[str, Any]:
        """Return attributes of a file with this product; the one of its name describes it."""
        return {}

    def are_values(self, name: str, values: Array) -> bool:
        """Whether values, each in the range of its variable, may be those of a variable."""
        return True

    def fit_together(self, arrays: Arrays, lengths: Mapping[str, int]) -> bool:
        """Whether the arrays of a file that are unpacked so far fit to each other."""
        return all(
            int(arrays[counts].sum(dtype=np.int64)) == lengths[dimension]
            for counts, dimension in self.strung.items()
            if counts in arrays
        )

    def small_grid(self, grid: "Grid", place: Floats) -> "Grid":
        """Return the grid of a part, where delay, gamma, delta and beta are at shares of ranges."""
        delay, gamma, delta, _ = place.tolist()
        return grid.slice_at(delay, gamma, delta, boxes=0)

    def checks(self, stored: Inspection) -> Iterator[Check]:
        """Compare a file with a new computation."""
        yield from ()
