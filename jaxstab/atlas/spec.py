"""The specification of an atlas: the nodes of its limits and of its fields, checked at once.

Limits have nodes along gamma, delta, delay and row (``atlas.table``). Fields are given at nodes of
alpha, beta, gamma, delta and delay, which may be others: limits bend along the delay, and need
whole samples among their nodes, while fields take many nodes of alpha and beta.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import reduce
from itertools import pairwise
from os import PathLike
from textwrap import fill
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxstab.atlas.table import PLANT
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
from jaxstab.numbers import checked_count, checked_number, checked_word, require_kind
from jaxstab.shown import shortened
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

LARGEST_SLICE = 2**22  # of these along alpha and beta
_FITTED = ("alpha", "beta")


@dataclass(frozen=True, kw_only=True)
class FieldSpec:
    """The nodes at which an atlas has fields, and the method that finds these.

    Args:
        alpha: nodes, two or more; or how many, at least 8, are fitted to the stable region of each
            delay. So is beta.
        gamma, delta, delay: nodes, one or more; None for those of the limits. Each delay has its
            own nodes of fitted axes.
        where: the nodes that have fields: "near" for corners of cells (in alpha and beta) with a
            stable corner, "all" for all.
        method: of finding the dominant poles: "fast", by powers of the companion matrix, or
            "companion", by its eigenvalues; proved alike.

    Raises: as ``AtlasSpec``.

    Example:
        >>> jaxstab.FieldSpec(delay=(0.0, 1.0)).where
        'near'
    """

    alpha: Nodes | int = 128
    beta: Nodes | int = 112
    gamma: Nodes | None = None
    delta: Nodes | None = None
    delay: Nodes | None = None
    where: str = "near"
    method: str = "fast"

    def __post_init__(self) -> None:
        for name in AXES:
            value = getattr(self, name)
            if name in _FITTED and isinstance(value, int | np.integer):
                count = checked_count(f"{name}.fitted", value, 8, LARGEST_SLICE)
                object.__setattr__(self, name, count)
            elif value is not None:
                object.__setattr__(self, name, _checked_nodes(name, value))
        checked_word("where", self.where, ("near", "all"))
        checked_word("method", self.method, ("fast", "companion"))

    @classmethod
    def from_table(cls, table: Any) -> "FieldSpec":
        """The fields in the table ``fields`` of a specification; errors as of ``AtlasSpec``."""
        if not isinstance(table, Mapping):
            raise TypeError(f"fields is {table!r}; give a table, such as [fields].")
        check_keys("fields", table, [entry.name for entry in fields(cls)])
        axes = {name: _axis_of(name, table[name]) for name in AXES if name in table}
        return cls(**(dict(table) | axes))


@dataclass(frozen=True, kw_only=True)
class AtlasSpec:
    """The contents of an atlas; without arguments, limits for the paper's haptic range (15).

    Args:
        gamma: nodes, one or more; so is delta.
        delay: delays t_d/T in [0, 100], whole or fractional; the whole ones between the first and
            the last are added, for limits bend there. Four nodes from one whole delay to the next
            make the limits cubic there.
        rows: even nodes along the stable interval of beta, >= 2.
        fields: where fields are given, too; None for nowhere.
        velocity: the estimator, in units of one sample; None for the difference over one sample.
        position: the position filter, likewise; None for none.

    Nodes are finite and ascending, and stored as tuples of floats.

    Raises: see ``jaxstab.conventions``; ValueError also for nodes out of order, or a too large
    atlas.

    Example:
        >>> spec = jaxstab.AtlasSpec(delay=(0.0, 0.5, 2.0), fields=jaxstab.FieldSpec())
        >>> spec.delay, jaxstab.AtlasSpec.from_toml(spec.to_toml()) == spec
        ((0.0, 0.5, 1.0, 2.0), True)
        >>> spec = jaxstab.AtlasSpec.from_toml("velocity = {window_samples = 20}")
        >>> str(spec.filters[0])
        'the difference over a window of 20 samples'
        >>> jaxstab.AtlasSpec.from_file("data/specs/window.toml").delay[:3]
        (1.0, 1.125, 1.25)
    """

    gamma: Nodes = (0.0, 1e-3)
    delta: Nodes = tuple(np.linspace(0.0, 0.015, 3).tolist())
    delay: Nodes = tuple(np.linspace(0.0, 3.0, 73).tolist())
    rows: int = 17
    fields: FieldSpec | None = None
    velocity: Velocity | None = None
    position: Filter | None = None

    def __post_init__(self) -> None:
        largest_table = 2**24  # nodes with limits
        for name in PLANT:
            object.__setattr__(self, name, _checked_nodes(name, getattr(self, name)))
        delays = np.array(self.delay)
        whole = np.arange(math.ceil(delays[0]), math.floor(delays[-1]) + 1.0)
        object.__setattr__(self, "delay", tuple(np.union1d(delays, whole).tolist()))
        checked_count("rows", self.rows, 2, largest_table)
        size = self.rows * math.prod(axis.size for axis in self.nodes)
        if size > largest_table:
            raise ValueError(
                f"the limits have {size} nodes; at most {largest_table} are allowed, so give fewer."
            )
        for name, value in as_keywords(known_filters(self.velocity, self.position)).items():
            object.__setattr__(self, name, _as_written(name, value))
        if self.fields is not None:
            require_kind("fields", self.fields, FieldSpec)
            missing = [name for name in PLANT if getattr(self.fields, name) is None]
            given = {name: getattr(self, name) for name in missing}
            object.__setattr__(self, "fields", replace(self.fields, **given))
            largest_fields = 2**38  # nodes with fields
            axes = [getattr(self.fields, name) for name in AXES]
            counts = [axis if isinstance(axis, int) else len(axis) for axis in axes]
            for words, own, most in (
                ("axes", counts, largest_fields),
                ("axes alpha and beta", counts[:2], LARGEST_SLICE),
            ):
                if math.prod(own) > most:
                    raise ValueError(
                        f"the {words} make {math.prod(own)} nodes; at most {most} are allowed, so "
                        "give fewer."
                    )

    @property
    def nodes(self) -> tuple[NDArray[np.float64], ...]:
        """The nodes of the limits along gamma, delta and delay."""
        return tuple(np.array(getattr(self, name), np.float64) for name in PLANT)

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
        ``count`` and perhaps ``spacing`` ("linear" or "geometric"). The table ``fields`` has the
        arguments of ``jaxstab.FieldSpec``, and there an axis of alpha or beta may have ``fitted``,
        a count. The tables ``velocity`` and ``position`` are of ``jaxstab.atlas.spec``.

        Raises: see ``jaxstab.conventions``; ValueError also if it is no TOML, or has an unknown
        name.
        """
        return cls._from_table(parsed(text))

    @classmethod
    def _from_table(cls, table: dict[str, Any]) -> "AtlasSpec":
        check_keys("", table, [entry.name for entry in fields(cls)])
        axes = {name: _axis_of(name, table[name]) for name in PLANT if name in table}
        made = {name: make(table[name]) for name, make in _MADE.items() if name in table}
        return cls(**(table | axes | made))

    @property
    def filters(self) -> Filters | None:
        """The estimator and the filter; None for the difference over one sample alone."""
        return known_filters(self.velocity, self.position)

    def to_toml(self) -> str:
        """Return the text from which ``from_toml`` makes an equal specification."""
        lines = _entries(self)
        if self.fields is not None:
            lines += ["", "[fields]", *_entries(self.fields)]
        return "\n".join(lines) + "\n"


_MADE: Mapping[str, Callable[[Any], Any]] = {
    "velocity": velocity_of,
    "position": position_of,
    "fields": FieldSpec.from_table,
}


def _entries(holder: "AtlasSpec | FieldSpec") -> list[str]:
    given = {name: value for name, value in vars(holder).items() if value is not None}
    given.pop("fields", None)
    return [f"{name} = {_toml(name, value)}" for name, value in given.items()]


def _as_written(name: str, value: Velocity | Filter | None) -> Velocity | Filter | None:
    if value is None or not toml_of(value).strip("[]"):
        return None
    made: Velocity | Filter = _MADE[name](parsed(f"{name} = {toml_of(value)}")[name])
    return made


def _axis_of(name: str, entry: Any) -> Any:
    even = ("start", "stop", "count", "spacing")
    if not isinstance(entry, Mapping):
        return entry
    is_fitted = name in _FITTED
    check_keys(name, entry, ["values", *even, *(("fitted",) if is_fitted else ())])
    if set(entry) == {"fitted"}:
        return entry["fitted"]
    if set(entry) == {"values"}:
        return entry["values"]
    if set(entry) | {"spacing"} != set(even):
        raise ValueError(
            f"axis {name} has {', '.join(entry) or 'nothing'}; give either values, or start, stop "
            f"and count{', or fitted' if is_fitted else ''}."
        )
    return _spaced(name, **entry)


def _spaced(name: str, start: Any, stop: Any, count: Any, spacing: Any = "linear") -> list[float]:
    spacings: Mapping[str, Callable[..., Any]] = {"linear": np.linspace, "geometric": np.geomspace}
    checked_count(f"count of {name}", count, 2, LARGEST_SLICE)
    ends = [checked_number(f"{end} of {name}", v) for end, v in (("start", start), ("stop", stop))]
    checked_word(f"spacing of {name}", spacing, spacings)
    if spacing == "geometric" and min(ends) <= 0.0:
        raise ValueError(f"axis {name} is geometric from {ends[0]} to {ends[1]}; give ends > 0.")
    nodes: list[float] = spacings[spacing](*ends, count).tolist()
    return nodes


def _checked_nodes(name: str, values: Any) -> tuple[float, ...]:
    least_share = 2.0**-24  # of the larger of its ends: rounding swallows no cell of a span
    least_span = 1e-300  # of alpha and beta: cells to it do not overflow
    is_list = isinstance(values, Sequence | np.ndarray) and not isinstance(values, str)
    if not is_list or getattr(values, "ndim", 1) != 1:
        raise TypeError(f"axis {name} is {shortened(values)}; give a list of numbers.")
    limits = {"alpha": (-math.inf, math.inf), "beta": (-math.inf, math.inf)}
    lower, upper = limits.get(name, (0.0, 100.0 if name == "delay" else math.inf))
    nodes = tuple(checked_number(f"axis {name}", value, lower, upper) for value in values)
    if len(nodes) < (2 if name in limits else 1):
        fewest = "two" if name in limits else "one"
        raise ValueError(f"axis {name} has {len(nodes)} node(s); give at least {fewest}.")
    for node, following in pairwise(nodes):
        if not node < following:
            raise ValueError(
                f"axis {name} has {following} after {node}; give ascending values, each once."
            )
    least = max(least_span, least_share * max(abs(nodes[0]), abs(nodes[-1])))
    if name in limits and nodes[-1] - nodes[0] < least:
        raise ValueError(
            f"axis {name} is {nodes[-1] - nodes[0]} long; make it {least:g} long at least."
        )
    return nodes


def _toml(name: str, value: Any) -> str:
    if name in _FITTED and isinstance(value, int):
        return f"{{ fitted = {value} }}"
    if isinstance(value, Velocity | Filter):
        return toml_of(value)
    whole: Any = {"break_long_words": False, "break_on_hyphens": False}
    return fill(json.dumps(value), 92, subsequent_indent="  ", **whole)


HAPTIC = AtlasSpec(
    fields=FieldSpec(
        gamma=(0.0, 5e-4, 1e-3),
        delta=np.linspace(0.0, 0.015, 9).tolist(),
        delay=(0.0, 1.0, 2.0, 3.0),
    )
)
"""What is built without a specification: the paper's haptic range (15), with fields."""
