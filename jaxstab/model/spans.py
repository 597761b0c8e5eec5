"""Two values of one kind merged into one, whose numbers run from the one to the other."""

from dataclasses import fields, is_dataclass
from typing import Any

from jaxstab.model.device.parts import Span, StateSpace
from jaxstab.model.sections import Section

_REMEDY = "give two loops that differ in numbers alone: masses, springs, cut-offs, the delay"


def merged(first: Any, last: Any) -> Any:
    """Return a value in which each number that differs is the span from the first to the last.

    Raises:
        ValueError: the two differ in more than numbers.
    """
    if type(first) is not type(last) or (_is_whole(first) and first != last):
        raise ValueError(
            f"one loop has {first}, the other {last}: nothing is known between; {_REMEDY}."
        )
    if isinstance(first, float) and first != last:
        return Span(first, last)
    if isinstance(first, tuple):
        if len(first) != len(last):
            raise ValueError(
                f"one loop has {len(first)} and the other {len(last)} parts where only numbers "
                f"may differ; {_REMEDY}."
            )
        return tuple(map(merged, first, last))
    if is_dataclass(first) and not isinstance(first, type) and first != last:
        whole = object.__new__(type(first))  # spans are no numbers to be checked
        for field in fields(first):
            pair = getattr(first, field.name), getattr(last, field.name)
            object.__setattr__(whole, field.name, merged(*pair))
        return whole
    if first != last:
        raise ValueError(
            f"one loop has {first!r}, the other {last!r}: nothing is known between; {_REMEDY}."
        )
    return first


def _is_whole(value: Any) -> bool:
    """Whether nothing is known between this value and another one of its kind."""
    return isinstance(value, StateSpace) or (isinstance(value, Section) and not value.varies)


def value_at(value: Any, share: float) -> Any:
    """Return a value whose spans are numbers, that share of the way from the first to the last."""
    if isinstance(value, Span):
        ends = sorted((value.first, value.last))
        number = value.first + share * (value.last - value.first)
        return value.last if share == 1.0 else min(max(number, ends[0]), ends[1])
    if isinstance(value, tuple):
        return tuple(value_at(part, share) for part in value)
    if not has_spans(value):
        return value
    whole = object.__new__(type(value))
    for field in fields(value):
        object.__setattr__(whole, field.name, value_at(getattr(value, field.name), share))
    return whole


def has_spans(value: Any) -> bool:
    """Return whether a number of a value is a span."""
    if isinstance(value, Span):
        return True
    if is_dataclass(value) and not isinstance(value, type):
        return any(has_spans(getattr(value, field.name)) for field in fields(value))
    return isinstance(value, tuple) and any(map(has_spans, value))
