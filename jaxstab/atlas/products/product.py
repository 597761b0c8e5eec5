"""What a product of an atlas is to the rest of the package: one object that answers for all of it.

An atlas holds products: verdicts, limits of alpha, fields, outlines, summaries. All
that is particular to one is in its module, as a subclass of ``Product`` beside the lookups in it:

- its variables, which values of them a reader accepts, and how they fit together;
- ``compute``: what a tile of a build holds of it, and ``known_before``: what no tile holds;
- ``part``: a small part of it, from which a plan tells its cost;
- ``checks``: how ``jaxstab atlas verify`` compares a file with a new computation.

Format, build, plan and verification go through ``products.table.PRODUCTS`` and ask each object. So
a new product is a new module and a line in that table.

Readers load these modules, without JAX, HDF5 or anything else that takes time to import: what
computes is imported inside the methods that builds, plans and verification call.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import prod
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.variables import SLICE, Variable

if TYPE_CHECKING:
    from jaxstab.atlas.atlas import Atlas
    from jaxstab.atlas.plan import Grid, Plan, Tile
    from jaxstab.model.filters import Filters

Array = NDArray[Any]
Arrays = Mapping[str, Array]
Floats = NDArray[np.float64]
Place = Sequence[int]  # numbers along gamma, delta and delay
_SLICES = 16  # that are verified


class Check(NamedTuple):
    """One check: its name, whether it passed, and its finding."""

    name: str
    passed: bool
    words: str

    def __str__(self) -> str:
        return f"{self.name}: {'ok' if self.passed else 'WRONG'}, {self.words}"


@dataclass(frozen=True)
class Stored:
    """A file under verification: its datasets by name, its filters as keywords, and the sample.

    ``sample`` is about how many points are computed again, ``chance`` chooses them.
    """

    datasets: Mapping[str, Any]
    filters: Mapping[str, Any]
    sample: int
    chance: np.random.Generator

    def places(self, counts: Sequence[int]) -> list[Place]:
        """Return some of the slices, each once."""
        slices = prod(counts)
        chosen = self.chance.choice(slices, min(_SLICES, self.sample, slices), replace=False)
        places: list[Place] = np.stack(np.unravel_index(chosen, counts), axis=-1).tolist()
        return places

    def loop(self, place: Place) -> tuple[float, float, float]:
        """Return gamma, delta and delay of a slice."""
        gamma, delta, delay = (
            float(self.datasets[name][number]) for name, number in zip(SLICE, place, strict=True)
        )
        return gamma, delta, delay


class Product:
    """A product, with the defaults of most.

    Attributes:
        name: in a specification.
        variables: in the order of the file.
        gridded: the variables of which a plan counts the points.
        known: the variables that no tile holds, for they follow from the specification.
        rows: the one of them that has cells of delays with their ends of alpha and beta, if any.
        strung: variables of counts, and the dimension along which these places are strung.
        lengths: the lengths of dimensions that no atlas may change.
        unit: the dimensions of what its cost is proportional to.
    """

    name: ClassVar[str]
    variables: ClassVar[tuple[Variable, ...]]
    gridded: ClassVar[tuple[str, ...]] = ()
    known: ClassVar[tuple[str, ...]] = ()
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
        """Return the variables of ``known``."""
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

    def part(self, grid: "Grid", place: Floats) -> "Grid":
        """Return the grid of a part, where delay, gamma, delta and beta are at shares of ranges."""
        delay, gamma, delta, _ = place.tolist()
        return grid.slice_at(delay, gamma, delta, boxes=0)

    def checks(self, stored: Stored) -> Iterator[Check]:
        """Compare a file with a new computation."""
        yield from ()

    def checks_of_answers(
        self, atlas: "Atlas", sample: int, chance: np.random.Generator
    ) -> Iterator[Check]:
        """Compare the answers of an atlas with a new computation."""
        yield from ()
