"""What a variable of an atlas file is, and the variables that every atlas has.

A file holds one HDF5 image, a table of its chunks (``atlas.schema``) and a footer. The image holds
its variables in the root group, with dimension scales. All numbers are dimensionless. Each variable
says here what its numbers mean, of which type they are and which values are allowed; readers refuse
anything else. The variables of a product are with the product (``atlas.products``), those of all
atlases below: the axes and the specification.
"""

from dataclasses import dataclass
from math import inf
from typing import Final

from jaxstab.conventions import Verdict

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
