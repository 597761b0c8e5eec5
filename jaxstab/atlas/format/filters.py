"""Velocity estimators and position filters as a specification writes them, per sample. No JAX.

Each is one table, or a list of tables of which each follows the one before:

    [velocity]
    window_samples = 20         the difference over 20 samples
    cutoff = 0.1                then a low pass at 0.1 of the sampling rate
"""

from collections.abc import Mapping
from functools import reduce
from typing import Any

from jaxstab.model.filters import Filter, Filters, SampledTable, Velocity, known_filters
from jaxstab.model.sections import Average, Butterworth, Exponential, LowPass
from jaxstab.tables import parsed


def velocity_of(entry: Any) -> Velocity:
    """Return the estimator that a specification has for ``velocity``.

    Raises:
        TypeError, ValueError: a key is unknown, missing or has a bad value.
    """
    first, *others = _tables("velocity", entry)
    return first.as_velocity() * _chain(others)


def position_of(entry: Any) -> Filter:
    """Return the filter that a specification has for ``position``.

    Raises:
        TypeError, ValueError: a key is unknown, missing or has a bad value.
    """
    return _chain(_tables("position", entry))


def filters_of(spec: str) -> Filters | None:
    """Return the estimator and the filter of a specification's text.

    Raises:
        TypeError, ValueError: the text is no TOML, or it has others than are allowed.
    """
    table = parsed(spec)
    return known_filters(
        velocity_of(table["velocity"]) if "velocity" in table else None,
        position_of(table["position"]) if "position" in table else None,
    )


def toml_of(filters: Velocity | Filter) -> str:
    """Return an estimator or a filter as inline tables of TOML, in units of one sample.

    Raises:
        ValueError: a window, a cut-off or a transfer function does not go with such units.
    """
    chain = filters.filter if isinstance(filters, Velocity) else filters
    return "[" + ", ".join(map(_inline, chain.per_sample(1.0).sections)) + "]"


def words_of(filters: Filters | None) -> str:
    """Return in words what a loop makes of the sampled positions."""
    velocity, position = filters or (Velocity(), Filter())
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


def _inline(section: Any) -> str:
    if isinstance(section, Average):
        return f"{{ window_samples = {section.length} }}"
    if isinstance(section, LowPass):
        return f"{{ cutoff = {section.cutoff!r}, order = {section.order} }}"
    if isinstance(section, Butterworth):
        return f'{{ cutoff = {section.cutoff!r}, order = {section.order}, kind = "butterworth" }}'
    if isinstance(section, Exponential):
        return f"{{ factor = {section.factor!r} }}"
    numerator = [number * getattr(section, "period", 1.0) for number in section.numerator]
    return f"{{ numerator = {numerator}, denominator = {list(section.denominator)} }}"
