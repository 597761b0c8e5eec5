"""Velocity estimators and position filters as a specification writes them, per sample. No JAX.

Each is one table, or a list of tables of which each follows the one before:

    [velocity]
    window_samples = 20         the difference over 20 samples
    cutoff = 0.1                then a low pass at 0.1 of the sampling rate
"""

from collections.abc import Callable, Mapping
from functools import reduce
from typing import Any

from jaxstab.model.filters import Filter, Filters, Velocity, known_filters
from jaxstab.model.sections import Average, Butterworth, Exponential, LowPass
from jaxstab.numbers import checked_number, checked_word
from jaxstab.tables import check_keys, parsed

_KEYS = ["window_samples", "cutoff", "order", "kind", "factor", "numerator", "denominator"]
_KINDS: Mapping[str, Callable[..., Filter]] = {
    "low-pass": Filter.low_pass,
    "butterworth": Filter.butterworth,
}


def velocity_of(entry: Any) -> Velocity:
    """Return the estimator that a specification has for ``velocity``.

    Raises:
        TypeError, ValueError: a key is unknown, missing or has a bad value.
    """
    first, *others = _tables("velocity", entry)
    if "window_samples" in first:
        start = Velocity.difference(first["window_samples"])
        others.insert(0, _without(first, "window_samples"))
    elif "numerator" in first or "denominator" in first:
        start = Velocity.transfer_function(*_coefficients("velocity", first))
        others.insert(0, _without(first, "numerator", "denominator"))
    else:
        start, others = Velocity(), [first, *others]
    return start * _chain("velocity", others)


def position_of(entry: Any) -> Filter:
    """Return the filter that a specification has for ``position``.

    Raises:
        TypeError, ValueError: a key is unknown, missing or has a bad value.
    """
    return _chain("position", _tables("position", entry))


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


def _tables(name: str, entry: Any) -> list[Mapping[str, Any]]:
    tables = entry if isinstance(entry, list) else [entry]
    if not tables or not all(isinstance(table, Mapping) and table for table in tables):
        raise TypeError(f"{name} is {entry!r}; give a table, such as window_samples = 20.")
    for table in tables:
        if "window" in table:
            raise ValueError(f"{name}.window is in s, which an atlas has not; give window_samples.")
        check_keys(name, table, _KEYS)
    return tables


def _chain(name: str, tables: list[Mapping[str, Any]]) -> Filter:
    parts = [part for table in tables for part in _parts(name, table)]
    return reduce(Filter.__mul__, parts, Filter())


def _parts(name: str, table: Mapping[str, Any]) -> list[Filter]:
    """Return the filters that the keys of a table stand for."""
    parts = []
    if "window_samples" in table:
        parts.append(Filter.average(table["window_samples"]))
    if "cutoff" in table:
        _check_share(name, table["cutoff"])
        kind = checked_word(f"{name}.kind", table.get("kind", "low-pass"), _KINDS)
        parts.append(_KINDS[kind](table["cutoff"], table.get("order", 1)))
    elif "order" in table or "kind" in table:
        raise ValueError(f"{name} has order or kind without cutoff; give cutoff, too.")
    if "factor" in table:
        parts.append(Filter.exponential(table["factor"]))
    if "numerator" in table or "denominator" in table:
        parts.append(Filter.transfer_function(*_coefficients(name, table)))
    return parts


def _check_share(name: str, cutoff: Any) -> None:
    """Refuse what is meant in Hz."""
    if checked_number(f"{name}.cutoff", cutoff) >= 1.0:
        raise ValueError(
            f"{name}.cutoff is {cutoff}; give it as a share of the sampling rate, below 1."
        )


def _coefficients(name: str, table: Mapping[str, Any]) -> tuple[list[float], list[float]]:
    both = table.get("numerator"), table.get("denominator")
    if not all(isinstance(part, list) for part in both):
        raise TypeError(f"{name} has {both[0]!r} over {both[1]!r}; give two lists of coefficients.")
    return both  # type: ignore[return-value]


def _without(table: Mapping[str, Any], *keys: str) -> dict[str, Any]:
    return {key: value for key, value in table.items() if key not in keys}


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
