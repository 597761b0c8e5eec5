"""Margins as a table for people: limits rounded inwards, and 0 if they are 0 but for rounding."""

from decimal import ROUND_CEILING, ROUND_FLOOR
from typing import NamedTuple

import numpy as np

from jaxstab.arrays import Numbers, are_numbers
from jaxstab.conventions import Verdict
from jaxstab.numbers import without_noise
from jaxstab.shown import number_text, table_text

_DIGITS = 5
_MOST_ROWS = 8  # of many walls


class MarginNames(NamedTuple):
    """What the rows of a table of margins are called, with their units."""

    stiffness: str
    damping: str
    delay: str


DIMENSIONLESS = MarginNames("alpha", "beta", "extra delay (samples)")
IN_SI_UNITS = MarginNames("K (N/m)", "B (N s/m)", "extra delay (s)")


def margins_text(margins: tuple[Numbers, ...], names: MarginNames) -> str:
    """Return the table: of one wall a row for each quantity, of many a row for each wall.

    Args:
        margins: the fields of a ``Margins``.
        names: of the rows.
    """
    if not are_numbers(margins):
        return f"Margins{tuple(margins)}"
    verdict, stiffness, damping, stiffness_gain, damping_gain, extra_delay = margins
    codes = [Verdict(int(code)).name.lower() for code in np.ravel(verdict)]
    delays = [
        "not known" if code == "stable" and np.isnan(delay) else _largest(delay)
        for code, delay in zip(codes, np.ravel(extra_delay), strict=True)
    ]
    limits = [
        [(*_interval(low, high), _largest(gain)) for (low, high), gain in pairs]
        for pairs in (
            zip(np.reshape(stiffness, (-1, 2)), np.ravel(stiffness_gain), strict=True),
            zip(np.reshape(damping, (-1, 2)), np.ravel(damping_gain), strict=True),
        )
    ]
    if np.ndim(verdict) == 0:
        rows = [
            (f"Margins: {codes[0]}", "least", "largest", "factor"),
            (names.stiffness, *limits[0][0]),
            (names.damping, *limits[1][0]),
            (names.delay, "", delays[0], ""),
        ]
        return table_text(rows)
    heads = [(name, "to", "factor") for name in (names.stiffness, names.damping)]
    table = [("verdict", *heads[0], *heads[1], names.delay)]
    walls = zip(codes, *limits, delays, strict=True)
    table += [(code, *first, *second, delay) for code, first, second, delay in walls]
    more = f"\n... and {len(codes) - _MOST_ROWS} more" if len(codes) > _MOST_ROWS else ""
    return f"Margins of {len(codes)} walls\n{table_text(table[: 1 + _MOST_ROWS])}{more}"


def _interval(low: float, high: float) -> tuple[str, str]:
    extent = float(high) - float(low)
    least, largest = without_noise((low, high), extent).tolist()
    return _least(least), _largest(largest)


def _least(value: float) -> str:
    return number_text(float(value), _DIGITS, ROUND_CEILING).replace("unlimited", "-unlimited")


def _largest(value: float) -> str:
    return number_text(float(value), _DIGITS, ROUND_FLOOR)
