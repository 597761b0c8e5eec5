"""How answers about motions print themselves: the numbers of one loop, the ranges of many."""

from collections.abc import Sequence
from decimal import ROUND_HALF_EVEN
from typing import NamedTuple

import numpy as np

from jaxstab.arrays import Numbers, are_numbers
from jaxstab.conventions import Status
from jaxstab.shown import rounded_text

_DIGITS = 4


class Column(NamedTuple):
    """A field of an answer: its label, the unit, the factor to that unit, the rounding."""

    label: str
    unit: str = ""
    factor: int = 1
    rounding: str = ROUND_HALF_EVEN


def answer_text(
    name: str,
    values: Sequence[Numbers],
    columns: Sequence[Column],
    codes: Numbers = None,
    kind: type[Status] | None = None,
) -> str:
    """One line: a name, the values of one loop or the ranges of many, and the status, if any.

    ``values`` are an array for each column; infinite and NaN values are left out.
    """
    fields = (*values,) if kind is None else (*values, codes)
    if not are_numbers(fields):
        return f"{name}{fields}"
    count, is_one = np.size(fields[-1]), np.ndim(fields[-1]) == 0
    words = ", ".join(filter(None, map(_range_text, values, columns)))
    if kind is not None:
        flat = np.ravel(codes)
        of_kind = {one: np.count_nonzero(flat == one) for one in kind}
        names = (
            f"{'' if is_one else f'{number} '}{one.name.lower().replace('_', ' ')}"
            for one, number in of_kind.items()
            if number
        )
        status = ", ".join(names) if words or not is_one else kind(int(flat[0])).words
        words = f"{words} ({status})" if words else status
    head = name if is_one or kind is None else f"{name} of {count} loops"
    return f"{head}: {words}"


def _range_text(value: Numbers, column: Column) -> str:
    """Return a number with label and unit, the range of several, "" where none is finite."""
    flat = np.ravel(value)
    finite = flat[np.isfinite(flat)]
    if not finite.size:
        return ""
    ends = (
        rounded_text(float(end), _DIGITS, column.rounding, factor=column.factor)
        for end in (finite.min(), finite.max())
    )
    return f"{column.label} {' to '.join(dict.fromkeys(ends))} {column.unit}".strip()
