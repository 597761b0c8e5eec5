"""The one checker of numbers that users give: one sentence says what is wrong.

The sentence has the name, the value and the range. Tracers pass: their values are not known.
"""

import sys
from collections.abc import Mapping
from contextlib import suppress
from math import inf, isfinite
from typing import Any

import numpy as np

from jaxstab.arrays import Numbers, is_jax, is_traced
from jaxstab.conventions import Range
from jaxstab.shown import shortened


def require_x64(*values: Numbers) -> None:
    """Raise RuntimeError for JAX arrays or tracers while JAX is in its default single precision."""
    if any(map(is_jax, values)) and not sys.modules["jax"].config.read("jax_enable_x64"):
        raise RuntimeError(
            "jaxstab computes in float64, but JAX's x64 mode is off: call "
            'jax.config.update("jax_enable_x64", True) before the first computation.'
        )


def require_together(**numbers: Numbers) -> tuple[int, ...]:
    """The shape to which numbers broadcast, by name; RuntimeError as ``require_x64``.

    ValueError if they do not broadcast, TypeError for masked arrays.
    """
    require_x64(*numbers.values())
    for name, value in numbers.items():
        require_unmasked(name, value)
    try:
        shapes = {name: np.shape(value) for name, value in numbers.items()}
    except ValueError:
        return ()  # rows of different lengths, which ``checked`` refuses
    try:
        return np.broadcast_shapes(*shapes.values())
    except ValueError:
        words = " and ".join(f"{name} {shape}" for name, shape in shapes.items() if shape)
        raise ValueError(
            f"the shapes {words} do not broadcast; give one shape, or axes of length 1."
        ) from None


def checked(
    name: str,
    value: Numbers,
    low: int | float = -inf,
    high: int | float = inf,
    *,
    is_open: bool = False,
    unit: str = "",
) -> Numbers:
    """Real, finite numbers in [low, high] as float64, in NumPy unless JAX gave them.

    ``name`` and ``unit`` are for the sentence of a TypeError or ValueError, ``is_open`` tells
    whether ``low`` itself is refused.
    """
    if type(value) is float and _is_allowed(value, low, high, is_open):  # most numbers, at once
        return np.array(value)
    if is_traced(value):
        return in_doubles(value)
    floats = real_numbers(name, value).astype(np.float64)
    too_low = floats <= low if is_open else floats < low
    wrong = too_low | (floats > high) | ~np.isfinite(floats)
    if np.any(wrong):
        culprit = float(floats[wrong].flat[0])
        allowed = _allowed(low, high, is_open, unit)
        raise ValueError(f"{name} is {culprit}; allowed are finite values{allowed}.")
    return in_doubles(value) if is_jax(value) else floats


def in_doubles(value: Any) -> Any:
    """Return a JAX array or tracer in float64, and anything else as it is.

    In a lower precision the numbers would be those of another loop: numbers of Python, such as a
    sampling period, do not widen an array of JAX that they multiply.
    """
    is_less = is_jax(value) and value.dtype.kind not in "bc" and value.dtype != np.float64
    return value.astype(float) if is_less else value  # in float32 still, where x64 is off


def real_numbers(name: str, value: Any) -> np.ndarray[Any, np.dtype[Any]]:
    """Return real numbers as NumPy has them, or raise TypeError; NaN is one of them."""
    require_unmasked(name, value)
    with suppress(ValueError):  # of rows of different lengths
        numbers = np.asarray(value)
        if numbers.dtype.kind in "iuf":
            return numbers
    raise TypeError(f"{name} is {shortened(value)}; give real numbers.")


def require_unmasked(name: str, value: Any) -> None:
    """Refuse a masked array, also in lists: others compute with what is masked."""
    if isinstance(value, np.ma.MaskedArray):
        raise TypeError(f"{name} is a masked array; give plain numbers.")
    if isinstance(value, list | tuple):
        for entry in value:
            if type(entry) is not float:  # most entries
                require_unmasked(name, entry)


def require_kind(name: str, value: Any, kind: type, public: str = "") -> None:
    """Refuse what is not of a class of ours, by its public name; TypeError."""
    if not isinstance(value, kind):
        raise TypeError(f"{name} is {shortened(value)}; give a jaxstab.{public or kind.__name__}.")


def _is_allowed(value: float, low: float, high: float, is_open: bool) -> bool:
    """True for a finite number in the range; False for one that a closer look may refuse."""
    return -inf < value < inf and (low < value if is_open else low <= value) and value <= high


def checked_number(
    name: str,
    value: Any,
    low: int | float = -inf,
    high: int | float = inf,
    *,
    is_open: bool = False,
    unit: str = "",
) -> float:
    """One real, finite, concrete number in [low, high] as a Python float; see ``checked``."""
    if type(value) is float and _is_allowed(value, low, high, is_open):  # most numbers, at once
        return value
    if is_traced(value):
        raise TypeError(f"{name} is traced; give a concrete number, outside of jit, vmap and grad.")
    require_x64(value)
    numbers = checked(name, value, low, high, is_open=is_open, unit=unit)
    if np.size(numbers) != 1:
        raise TypeError(f"{name} has shape {np.shape(numbers)}; give a single number.")
    return float(np.asarray(numbers).item())


def two_ends(name: str, ends: Any, low: int | float = -inf, *, unit: str = "") -> Range:
    """The ends of a range as numbers from ``low`` on; TypeError unless it has two."""
    if not has_shape(ends, 2):
        raise TypeError(f"{name} is {shortened(ends)}; give its lowest and its highest value.")
    first, last = (checked_number(name, end, low, unit=unit) for end in ends)
    return first, last


def has_shape(value: Any, *shape: int) -> bool:
    """True for values in a shape; rows of different lengths have none."""
    try:
        return np.shape(value) == shape
    except ValueError:
        return False


def without_noise(values: Numbers, extent: int | float) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Coordinates along one axis, with 0 for those below 1e-9 of a finite extent; NaN stays."""
    coordinates = np.asarray(values, np.float64)
    noise = 1e-9 * extent if extent < inf else 0.0
    return np.where(np.abs(coordinates) <= noise, 0.0, coordinates)


def checked_count(name: str, value: Any, least: int, most: int = 10**8) -> int:
    """A whole number in [least, most]; TypeError for others (True and 3.0), ValueError outside."""
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | np.integer):
        raise TypeError(f"{name} is {shortened(value)}; give a whole number.")
    count = int(value)  # NumPy compares no int8 with larger numbers
    if not least <= count <= most:
        given = f"from {least} to {most:,}"
        raise ValueError(f"{name} is {shortened(value)}; give a whole number {given}.")
    return count


def checked_word(name: str, value: Any, allowed: Mapping[str, Any] | tuple[str, ...]) -> str:
    """One of some words, else ValueError."""
    if not isinstance(value, str) or value not in allowed:
        words = ", ".join(f'"{word}"' for word in allowed)
        raise ValueError(f"{name} is {shortened(value)}; give one of {words}.")
    return str(value)


def _allowed(low: int | float, high: int | float, is_open: bool, unit: str) -> str:
    of_unit = f" {unit}" if unit else ""
    if high == inf:
        return "" if low == -inf else f" {'>' if is_open else '>='} {low:g}{of_unit}"
    return f" {'above' if is_open else 'from'} {low:g} to {high:g}{of_unit}"


# Lists of values as a text.


def listed(key: str, text: str) -> list[float | str]:
    """Return the values of a text: ``LOW:HIGH:COUNT`` or ``VALUE,VALUE,...``; ValueError.

    Spaced ones have 15 digits: 0.2, not 0.20000000000000001.
    """
    ends, kinds, most = text.split(":"), (float, float, int), 100_000
    if len(ends) == 1 and text:
        return [number_or_text(value) for value in text.split(",")]
    with suppress(ValueError):
        low, high, count = (kind(end) for kind, end in zip(kinds, ends, strict=True))
        if 2 <= count <= most and isfinite(high - low):
            between = np.linspace(low, high, count)[1:-1].tolist()
            return [low, *(float(f"{value:.15g}") for value in between), high]
    raise ValueError(
        f"{key} is {shortened(text)}; give LOW:HIGH:COUNT with a COUNT from 2 to {most}, "
        "or VALUE,VALUE,..."
    )


def number_or_text(text: str) -> float | str:
    """Return the number that a text is, or the text."""
    try:
        return float(text)
    except ValueError:
        return text
