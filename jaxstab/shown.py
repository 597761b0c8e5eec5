"""Answers printed for people: numbers with as many digits as are known, and tables.

The printed text claims no more than what was computed: limits are rounded to a given side, two
gains so that the wall that is printed is stable, and the rounding of a value is added to its
printed error. Standard library only.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN, Context, Decimal
from itertools import chain, product
from math import floor, isfinite, isnan, log10
from reprlib import Repr
from typing import Any

MOST_DIGITS = 17  # of a float64: more say nothing
_WRITTEN_OUT = range(-4, 9)  # powers of ten of the first digit
_EXACT = Context(prec=1100)  # every float64, and differences of them


def printable(text: str, besides: str = "") -> str:
    """Return a text in which nothing commands a terminal: such characters are written out."""
    return "".join(c if c.isprintable() or c in besides else repr(c)[1:-1] for c in text)


class _Short(Repr):
    """The ends of a repr, in one line; Python writes out no whole number of 4,301 digits."""

    def repr(self, x: Any) -> str:
        return " ".join(super().repr(x).split())

    def repr_int(self, x: int, level: int) -> str:
        longest = 4000  # bits
        long = x.bit_length() > longest
        return "a whole number of thousands of digits" if long else super().repr_int(x, level)


shortened = _Short().repr


def rounded_text(
    value: Any, digits: int, rounding: str = ROUND_HALF_EVEN, *, factor: int = 1
) -> str:
    """A number times a factor in significant digits, without zeros at the end; see ``decimal``."""
    # 2999.9999999999 is 3000 but for rounding, if few digits are asked for.
    exact = Context(prec=max(11, digits + 4)).multiply(Decimal(value), factor)
    rounded = exact.normalize(Context(prec=digits, rounding=rounding))
    if not rounded:
        return "0"
    power = rounded.adjusted()
    if power in _WRITTEN_OUT:
        return format(rounded, "f")
    return f"{rounded.scaleb(-power):f}e{power:+03d}"


class Printed(float):
    """A number that is printed by a text of its own."""

    text: str

    def __new__(cls, value: float, text: str = "") -> "Printed":
        """Return the number, unchanged in value."""
        number = super().__new__(cls, value)
        number.text = text
        return number

    @property
    def shown(self) -> "Printed":
        """The number that the text says."""
        return Printed(float(self.text), self.text)


def exact_text(value: float) -> str:
    """Return a number with all of its digits, the fewest that tell it from its neighbours."""
    if not isfinite(value):
        return number_text(value, MOST_DIGITS)
    return rounded_text(Decimal(repr(float(value))), MOST_DIGITS)


def stable_pair(
    limit: float,
    other: float,
    digits: tuple[int, int],
    is_stable: Callable[[float, float], Any],
    row: Callable[[float], Iterable[Any]] = lambda _: (),
    way: str = ROUND_FLOOR,
) -> tuple[float, float]:
    """Two gains, the first one a largest one, to be printed as a pair that is stable.

    The first is rounded down (a least one, by its ``way``, up). Where ``is_stable`` (of the two
    gains) denies the pair, as in a narrow corner, the second is rounded to either side, the first
    is moved inwards by units of its last digit, or has the digits that the intervals of a ``row``
    of the second need, or the second has more digits. Without such a pair both
    are printed as other numbers.
    """
    if not (isfinite(limit) and isfinite(other)):
        return limit, other
    inwards = -1 if way == ROUND_FLOOR else 1
    unit = Decimal(inwards).scaleb(Decimal(limit).adjusted() + 1 - digits[0])
    counts = (0, 1, 2, 5) if limit else (0,)  # 0 has no last digit to move
    lowered = [_EXACT.add(Decimal(limit), count * unit) for count in counts]
    limits = [rounded_text(value, digits[0], way) for value in lowered]
    limits = [text for text in limits if (float(text) < 0.0) == (limit < 0.0)]
    for count in range(digits[1], MOST_DIGITS + 1):
        ways = ROUND_HALF_EVEN, ROUND_FLOOR, ROUND_CEILING
        others = dict.fromkeys(rounded_text(other, count, way) for way in ways)
        pairs = chain(
            product(limits, others),
            ((text, own) for own in others for text in _within(row(float(own)), digits[0])),
        )
        for first, second in pairs:
            if is_stable(float(first), float(second)):
                return Printed(limit, first), Printed(other, second)
    return limit, other


def _within(intervals: Iterable[Any], digits: int) -> Iterator[str]:
    """Yield the upper end of each interval, rounded down with as many digits as stay inside."""
    for low, high in intervals:
        for count in range(digits, MOST_DIGITS + 1) if high > low else ():
            text = rounded_text(high, count, ROUND_FLOOR)
            if float(text) > low:
                yield text
                break


def text_with_bound(value: float, error: float) -> str:
    """Return a number with its error bound, such as "0.8380204612 +/- 2.4e-11".

    The printed bound holds for the printed digits: it includes their rounding. It has two digits
    and is rounded up.
    """
    if not isfinite(value) or not isfinite(error):
        return f"{value:.10g}"
    exact = Decimal(value)
    places = exact.adjusted() + 1 - MOST_DIGITS
    if error > 0.0:
        places = max(places, floor(log10(error)) - 1)
    rounded = exact.quantize(Decimal(1).scaleb(places), context=_EXACT)
    bound = _EXACT.add(Decimal(error), abs(_EXACT.subtract(rounded, exact)))
    shown = rounded if bound else rounded.normalize(_EXACT)
    digits = format(shown, "f" if exact.adjusted() in _WRITTEN_OUT or not exact else "e")
    return f"{digits} +/- {bound.normalize(Context(prec=2, rounding=ROUND_CEILING)):.2g}"


def call_text(name: str, arguments: Mapping[str, Any]) -> str:
    """Return the call that makes an object, with the arguments by their names."""
    return f"{name}({', '.join(f'{key}={value!r}' for key, value in arguments.items())})"


def table_text(rows: Sequence[Sequence[str]]) -> str:
    """Return rows of cells, each printable, as lines with aligned columns."""
    rows = [[*map(printable, row)] for row in rows]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    )


def number_text(value: float, digits: int, rounding: str = ROUND_HALF_EVEN, unit: str = "") -> str:
    """Return a number with its unit; infinite numbers and NaN are spelled out."""
    if isnan(value):
        return "none"
    if not isfinite(value):
        return "unlimited"
    text = value.text if isinstance(value, Printed) else rounded_text(value, digits, rounding)
    return f"{text} {unit}".rstrip()
