"""The specification of an atlas: its axes and products, checked when they are written down."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import partial, reduce
from itertools import pairwise
from os import PathLike
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from jaxstab.atlas.product import (
    LARGEST_ATLAS,
    LARGEST_DELAY,
    LARGEST_SLICE,
    LEAST_SHARE,
    LEAST_SPAN,
)
from jaxstab.atlas.products.fields import FIELDS
from jaxstab.atlas.products.table import PRODUCTS
from jaxstab.conventions import AXES
from jaxstab.model.filter_tables import SampledTable
from jaxstab.model.filters import (
    NO_FILTERS,
    Filter,
    Filters,
    Section,
    Velocity,
    as_keywords,
    known_filters,
)
from jaxstab.numbers import checked_count, checked_number, checked_word
from jaxstab.tables import check_keys, parsed, read_table

# Velocity estimators and position filters as a specification writes them, per sample. No JAX.
#
# Each is one table, or a list of tables of which each follows the one before:
#
#     [velocity]
#     window_samples = 20         the difference over 20 samples
#     cutoff = 0.1                then a low pass at 0.1 of the sampling rate


def velocity_of(entry: Any) -> Velocity:
    """The estimator of a specification's entry ``velocity``; ValueError or TypeError if bad."""
    table, *others = _tables("velocity", entry)
    return table.as_velocity() * _chain(others)


def position_of(entry: Any) -> Filter:
    """The filter of a specification's entry ``position``; ValueError or TypeError if bad."""
    return _chain(_tables("position", entry))


def filters_of(spec: str) -> Filters | None:
    """The estimator and the filter of a specification's text; ValueError or TypeError if bad."""
    table = parsed(spec)
    return known_filters(
        velocity_of(table["velocity"]) if "velocity" in table else None,
        position_of(table["position"]) if "position" in table else None,
    )


def toml_of(filters: Velocity | Filter) -> str:
    """An estimator or a filter as inline tables of TOML, in units of one sample, or ValueError."""
    chain = filters.filter if isinstance(filters, Velocity) else filters
    return "[" + ", ".join(map(_inline, chain.per_sample(1.0).sections)) + "]"


def words_of(filters: Filters | None) -> str:
    """A description of a loop's estimator and filter."""
    velocity, position = filters or NO_FILTERS
    words = f"velocity: {velocity}; position: {position}"
    return words.replace(" Hz", " of the sampling rate")  # the unit per sample


def _tables(name: str, entry: Any) -> list[SampledTable]:
    tables = entry if isinstance(entry, list) else [entry]
    if not tables or not all(isinstance(table, Mapping) and table for table in tables):
        raise TypeError(f"{name} is {entry!r}; give a table, such as window_samples = 20.")
    for table in tables:
        if "window" in table:
            raise ValueError(f"{name}.window is in s, which an atlas has not; give window_samples.")
    return [SampledTable.from_table(table, name) for table in tables]


def _chain(tables: list[SampledTable]) -> Filter:
    return reduce(Filter.__mul__, (table.as_filter() for table in tables), Filter())


def _inline(section: Section) -> str:
    values = (f'"{v}"' if isinstance(v, str) else repr(v) for v in section.toml.values())
    return f"{{ {', '.join(map(' = '.join, zip(section.toml, values, strict=True)))} }}"


Nodes: TypeAlias = ArrayLike | tuple[float, ...]
FEWEST_FITTED = 8
_DELAY_CELLS, _MOST_DELAY_CELLS = 32, 2**16  # to a sample around 1/2
_LIMIT_CELLS = 256, 128  # at delays alone, and between them
_SPACINGS: Mapping[str, Callable[..., Any]] = {"linear": np.linspace, "geometric": np.geomspace}
_OF_FIELDS = {"where": ("near", "all"), "method": ("fast", "companion")}
_RANGE = ("start", "stop", "count", "spacing")
_ENDS = ("least", "most")
_FITTED = ("alpha", "beta")
_LINE_LENGTH = 90


@dataclass(frozen=True)
class FittedAxis:
    """An axis of alpha or beta that is fitted to the stable region of each delay.

    Args:
        count: number of nodes, >= 8.
        least: the first node is not above it; None for that of the stable region alone.
        most: the last node is not below it; likewise.

    Raises: see ``jaxstab.conventions``.

    Example:
        >>> jaxstab.AtlasSpec(alpha=jaxstab.FittedAxis(64)).alpha
        FittedAxis(count=64, least=None, most=None)
    """

    count: int
    least: float | None = None
    most: float | None = None

    def __post_init__(self) -> None:
        checked_count("fitted", self.count, FEWEST_FITTED, LARGEST_SLICE)
        for name in _ENDS:
            if getattr(self, name) is not None:
                value = checked_number(f"{name} of a fitted axis", getattr(self, name))
                object.__setattr__(self, name, value)


@dataclass(frozen=True, kw_only=True)
class AtlasSpec:
    """The axes and products of an atlas; without arguments, the paper's haptic range (15).

    Args:
        alpha: nodes, two or more, or a FittedAxis for each delay; so is beta.
        gamma: nodes, one or more; so is delta.
        delay: delays t_d/T in [0, 100], whole or fractional; each has its own grid.
        products: what to compute, of "verdict", "alpha_limits", "fields", "outline" and
            "summary"; by default the first three.
        limit_cells: number of even cells along beta in which the limits of alpha are given; 0 for
            128 where they are given between delays, too, and else 256.
        delay_cells: how finely they are given between the delays, in cells (delay + 1/2) /
            delay_cells long; 0 for these delays alone. None means 32, or 0 for loops with an
            estimator or a filter.
        where: which nodes have fields: "near" for corners of cells (in alpha and beta) with a
            stable corner, "all" for all.
        method: how the dominant poles of fields are found: "fast", by powers of the companion
            matrix, or "companion", by its eigenvalues; proved alike.

    Nodes are finite and ascending, and stored as tuples of floats.

    Raises: see ``jaxstab.conventions``; ValueError also for nodes out of order, or a too large
    atlas.

    Example:
        >>> spec = jaxstab.AtlasSpec(delay=(0.0, 0.5, 1.0), products=("verdict", "alpha_limits"))
        >>> spec.delay, jaxstab.AtlasSpec.from_toml(spec.to_toml()) == spec
        ((0.0, 0.5, 1.0), True)
        >>> spec = jaxstab.AtlasSpec.from_toml("velocity = {window_samples = 20}")
        >>> str(spec.filters[0]), spec.delay_cells
        ('the difference over a window of 20 samples', 0)
        >>> jaxstab.AtlasSpec.from_file("data/specs/window.toml").delay
        (1.0, 2.0, 3.0)
    """

    alpha: Nodes | FittedAxis = field(default_factory=partial(FittedAxis, 128))
    beta: Nodes | FittedAxis = field(default_factory=partial(FittedAxis, 112))
    gamma: Nodes = tuple(np.linspace(0.0, 1e-3, 3).tolist())
    delta: Nodes = tuple(np.linspace(0.0, 0.015, 9).tolist())
    delay: Nodes = (0.0, 1.0, 2.0, 3.0)
    products: Sequence[str] = ("verdict", "alpha_limits", FIELDS)
    limit_cells: int = 0
    delay_cells: int | None = None
    where: str = "near"
    method: str = "fast"
    velocity: Velocity | None = None
    position: Filter | None = None

    def __post_init__(self) -> None:
        for name in AXES:
            value = getattr(self, name)
            if not (name in _FITTED and isinstance(value, FittedAxis)):
                object.__setattr__(self, name, _checked_nodes(name, value))
        object.__setattr__(self, "products", _checked_products(self.products))
        if self.delay_cells is None:
            object.__setattr__(self, "delay_cells", 0 if self.filters else _DELAY_CELLS)
        checked_count("delay_cells", self.delay_cells, 0, _MOST_DELAY_CELLS)
        if not checked_count("limit_cells", self.limit_cells, 0, LARGEST_SLICE):
            between = bool(self.delay_cells) and np.size(self.delay) > 1
            object.__setattr__(self, "limit_cells", _LIMIT_CELLS[between])
        for name, allowed in _OF_FIELDS.items():
            word = checked_word(name, getattr(self, name), allowed)
            object.__setattr__(self, name, word if FIELDS in self.products else allowed[0])
        for name, value in as_keywords(known_filters(self.velocity, self.position)).items():
            object.__setattr__(self, name, _as_written(name, value))
        axes = (getattr(self, name) for name in AXES)
        check_size([axis.count if isinstance(axis, FittedAxis) else len(axis) for axis in axes])

    @classmethod
    def from_file(cls, path: str | PathLike[str]) -> "AtlasSpec":
        """Read a TOML file.

        Raises: as ``from_toml``, with the name of the file; OSError if it cannot be read.
        """
        table = read_table(path, "specification")
        try:
            return cls._from_table(table)
        except (TypeError, ValueError) as error:
            raise type(error)(f"{path}: {error}") from error

    @classmethod
    def from_toml(cls, text: str) -> "AtlasSpec":
        """Read a specification in TOML; missing keys have their defaults.

        An axis is a list of nodes, or a table with ``values``, or one with ``start``, ``stop``,
        ``count`` and perhaps ``spacing`` ("linear" or "geometric"). For alpha and beta it may have
        ``fitted``, a count, and perhaps ``least`` and ``most``. The tables ``velocity`` and
        ``position`` are of ``jaxstab.atlas.spec``.

        Raises: see ``jaxstab.conventions``; ValueError also if it is no TOML, or has an unknown
        name.
        """
        return cls._from_table(parsed(text))

    @classmethod
    def _from_table(cls, table: dict[str, Any]) -> "AtlasSpec":
        check_keys("", table, [entry.name for entry in fields(cls)])
        axes: dict[str, Any] = {name: _axis_of(name, table[name]) for name in AXES if name in table}
        filters = {name: make(table[name]) for name, make in _FILTERS.items() if name in table}
        return cls(**(table | axes | filters))

    @property
    def filters(self) -> Filters | None:
        """The estimator and the filter; None for the difference over one sample alone."""
        return known_filters(self.velocity, self.position)

    def to_toml(self) -> str:
        """Return the text from which ``from_toml`` makes an equal specification."""
        values = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        left_out = () if FIELDS in self.products else _OF_FIELDS
        given = {n: value for n, value in values.items() if value is not None and n not in left_out}
        entries = (f"{name} = {_toml(value)}" for name, value in given.items())
        return "\n".join(entries) + "\n"


_FILTERS: Mapping[str, Callable[[Any], Velocity | Filter]] = {
    "velocity": velocity_of,
    "position": position_of,
}


def check_size(counts: Sequence[int]) -> None:
    """Raise ValueError for more nodes along the axes than an atlas may have."""
    for axes, size, most in (
        ("axes", math.prod(counts), LARGEST_ATLAS),
        ("axes alpha and beta", math.prod(counts[:2]), LARGEST_SLICE),
    ):
        if size > most:
            raise ValueError(
                f"the {axes} make {size} nodes; at most {most} are allowed, so give fewer."
            )


def _as_written(name: str, value: Velocity | Filter | None) -> Velocity | Filter | None:
    if value is None or not toml_of(value).strip("[]"):
        return None
    return _FILTERS[name](parsed(f"{name} = {toml_of(value)}")[name])


def _axis_of(name: str, entry: Any) -> Any:
    if not isinstance(entry, Mapping):
        return entry
    is_fitted = name in _FITTED
    check_keys(name, entry, ["values", *_RANGE, *((*_ENDS, "fitted") if is_fitted else ())])
    if "fitted" in entry and set(entry) <= {"fitted", *_ENDS}:
        return FittedAxis(entry["fitted"], entry.get("least"), entry.get("most"))
    if set(entry) == {"values"}:
        return entry["values"]
    if set(entry) | {"spacing"} != set(_RANGE):
        raise ValueError(
            f"axis {name} has {', '.join(entry) or 'nothing'}; give either values, or start, stop "
            f"and count{', or fitted' if is_fitted else ''}."
        )
    return _spaced(name, **entry)


def _spaced(name: str, start: Any, stop: Any, count: Any, spacing: Any = "linear") -> list[float]:
    checked_count(f"count of {name}", count, 2, LARGEST_SLICE)
    ends = [checked_number(f"{end} of {name}", v) for end, v in (("start", start), ("stop", stop))]
    checked_word(f"spacing of {name}", spacing, _SPACINGS)
    if spacing == "geometric" and min(ends) <= 0.0:
        raise ValueError(f"axis {name} is geometric from {ends[0]} to {ends[1]}; give ends > 0.")
    nodes: list[float] = _SPACINGS[spacing](*ends, count).tolist()
    return nodes


def _checked_nodes(name: str, values: Any) -> tuple[float, ...]:
    if isinstance(values, str | Mapping | FittedAxis) or not isinstance(
        values, Sequence | np.ndarray
    ):
        raise TypeError(f"axis {name} is {values!r}; give a list of numbers.")
    limits = {"alpha": (-math.inf, math.inf), "beta": (-math.inf, math.inf)}
    lower, upper = limits.get(name, (0.0, LARGEST_DELAY if name == "delay" else math.inf))
    nodes = tuple(checked_number(f"axis {name}", value, lower, upper) for value in values)
    if len(nodes) < (2 if name in limits else 1):
        fewest = "two" if name in limits else "one"
        raise ValueError(f"axis {name} has {len(nodes)} node(s); give at least {fewest}.")
    for node, following in pairwise(nodes):
        if not node < following:
            raise ValueError(
                f"axis {name} has {following} after {node}; give ascending values, each once."
            )
    least = max(LEAST_SPAN, LEAST_SHARE * max(abs(nodes[0]), abs(nodes[-1])))
    if name in limits and nodes[-1] - nodes[0] < least:
        raise ValueError(
            f"axis {name} is {nodes[-1] - nodes[0]} long; make it {least:g} long at least."
        )
    return nodes


def _checked_products(products: Any) -> tuple[str, ...]:
    if isinstance(products, str) or not isinstance(products, Sequence):
        raise TypeError(f"products is {products!r}; give a list of names.")
    check_keys("products", map(str, products), list(PRODUCTS))
    if not products:
        raise ValueError(f"products is empty; give at least one of {', '.join(PRODUCTS)}.")
    return tuple(name for name in PRODUCTS if name in products)


def _toml(value: Any) -> str:
    if isinstance(value, FittedAxis):
        ends = {name: getattr(value, name) for name in _ENDS}
        given = [f", {name} = {end!r}" for name, end in ends.items() if end is not None]
        return f"{{ fitted = {value.count}{''.join(given)} }}"
    if isinstance(value, Velocity | Filter):
        return toml_of(value)
    if not isinstance(value, tuple):
        return repr(value)
    items = ["'" + item + "'" if isinstance(item, str) else repr(item) for item in value]
    lines = [""]
    for item in items:
        if len(lines[-1]) + len(item) > _LINE_LENGTH:
            lines.append("  ")
        lines[-1] += f"{item}, "
    return "[" + "\n".join(lines).rstrip(", ") + "]"
