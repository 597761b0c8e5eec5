"""The values of a study: lists, and draws from distributions.

Each quantity is drawn from a separate stream of random numbers, set by the seed and the name of the
quantity, so its draws do not depend on what else varies or on how the work is divided. Columns of
one CSV file are drawn row by row: mass and stiffness of a hand stay together.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import inf, isfinite
from typing import Any

import numpy as np
from jaxtyping import Float64

from jaxstab.shown import shortened
from jaxstab.tables import columns_of

Draws = Float64[np.ndarray, " draw"]
_ROUNDS = 200  # of draws in place of those that are not allowed
_MOST_VALUES = 100_000  # of a list between two ends
_FORMS = "normal:MEAN:DEVIATION, uniform:LOW:HIGH, lognormal:MEDIAN:FACTOR or csv:FILE:COLUMN"


class Distribution(ABC):
    """A distribution of a quantity among devices or people."""

    @abstractmethod
    def _draw(self, generator: np.random.Generator, count: int) -> Draws:
        """Return independent draws."""

    @property
    def _stream(self) -> str:
        """The name of the stream of random numbers; empty for that of the quantity."""
        return ""


@dataclass(frozen=True)
class Normal(Distribution):
    """A normal distribution; draws below what a scene allows are drawn again.

    Attributes:
        mean: in the unit of the quantity.
        deviation: the standard deviation, above 0.

    ValueError: a number is not finite, or the deviation not above 0. Source: textbook.

    Example:
        >>> jaxstab.Normal(300.0, 100.0)
        Normal(mean=300.0, deviation=100.0)
    """

    mean: float
    deviation: float

    def __post_init__(self) -> None:
        _require_finite(self)
        if not self.deviation > 0.0:
            raise ValueError(f"deviation is {self.deviation:g}; give a number > 0.")

    def _draw(self, generator: np.random.Generator, count: int) -> Draws:
        return generator.normal(self.mean, self.deviation, count)


@dataclass(frozen=True)
class Uniform(Distribution):
    """A uniform distribution.

    Attributes:
        low, high: its ends, in the unit of the quantity.

    ValueError: an end, or their difference, is not finite, or they are out of order. Source:
    textbook.

    Example:
        >>> jaxstab.Uniform(100.0, 500.0)
        Uniform(low=100.0, high=500.0)
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        _require_finite(self)
        if not self.low < self.high:
            raise ValueError(f"low is {self.low:g} and high {self.high:g}; give low < high.")
        if not isfinite(self.high - self.low):
            raise ValueError(
                f"low is {self.low:g} and high {self.high:g}; give ends of a finite difference."
            )

    def _draw(self, generator: np.random.Generator, count: int) -> Draws:
        return generator.uniform(self.low, self.high, count)


@dataclass(frozen=True)
class LogNormal(Distribution):
    """A log-normal distribution: its logarithm is normal, so all draws are above 0.

    Attributes:
        median: in the unit of the quantity, above 0.
        factor: above 1; 68 % lie between median / factor and median * factor.

    ValueError: a number is out of these. Source: textbook.

    Example:
        >>> jaxstab.LogNormal(300.0, 1.5)
        LogNormal(median=300.0, factor=1.5)
    """

    median: float
    factor: float

    def __post_init__(self) -> None:
        _require_finite(self)
        if not (self.median > 0.0 and self.factor > 1.0):
            raise ValueError(
                f"median is {self.median:g} and factor {self.factor:g}; give a median > 0 and a "
                "factor > 1."
            )

    def _draw(self, generator: np.random.Generator, count: int) -> Draws:
        return generator.lognormal(np.log(self.median), np.log(self.factor), count)


@dataclass(frozen=True)
class Measured(Distribution):
    """Measured values, drawn with replacement; those of one source are drawn row by row.

    Attributes:
        values: in the unit of the quantity.
        source: quantities with the same source, such as the columns of one file, are drawn
            together.

    ValueError: there is no value, or one is not finite. Source: the bootstrap (Efron 1979).

    Example:
        >>> jaxstab.Measured((250.0, 310.0, 420.0)).values
        (250.0, 310.0, 420.0)
    """

    values: tuple[float, ...]
    source: str = ""

    def __post_init__(self) -> None:
        if not self.values or not all(isfinite(value) for value in self.values):
            raise ValueError("measured values are missing or not finite; give finite numbers.")

    def _draw(self, generator: np.random.Generator, count: int) -> Draws:
        rows = generator.integers(len(self.values), size=count)
        return np.asarray(self.values, np.float64)[rows]

    @property
    def _stream(self) -> str:
        """The source, so that its columns are drawn together."""
        return self.source and f"{self.source} of {len(self.values)}"


def distribution_of(text: str) -> Distribution | None:
    """Return the distribution of a text such as ``normal:300:100``; None where it is none.

    ValueError: its numbers are bad, or its file has no such column; OSError: it cannot be read.
    """
    kind, *parts = text.split(":")
    if kind == "csv" and len(parts) >= 2:
        file, column = ":".join(parts[:-1]), parts[-1]
        return Measured(tuple(columns_of(file, [column])[column]), file)
    kinds: dict[str, Any] = {"normal": Normal, "uniform": Uniform, "lognormal": LogNormal}
    if not parts or isinstance(_number_or_text(kind), float):
        return None
    try:
        make, (a, b) = kinds[kind], map(float, parts)
    except (KeyError, ValueError):
        raise ValueError(f"{shortened(text)} is no distribution; give {_FORMS}.") from None
    made: Distribution = make(a, b)
    return made


def values_of(key: str, text: str) -> list[float | str]:
    """Return the values of a text: ``LOW:HIGH:COUNT`` or ``VALUE,VALUE,...``; ValueError."""
    ends = text.split(":")
    if len(ends) == 1 and text:
        return [_number_or_text(value) for value in text.split(",")]
    try:
        low, high, count = float(ends[0]), float(ends[1]), int(ends[2])
        if len(ends) == 3 and 2 <= count <= _MOST_VALUES and isfinite(high - low):
            between = np.linspace(low, high, count)[1:-1].tolist()
            return [low, *(float(f"{value:.15g}") for value in between), high]
    except (ValueError, IndexError):
        pass
    raise ValueError(
        f"{key} is {shortened(text)}; give LOW:HIGH:COUNT with a COUNT from 2 to {_MOST_VALUES}, "
        "or VALUE,VALUE,..."
    )


def _number_or_text(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def draws_of(
    name: str, distribution: Distribution, count: int, seed: int, least: float = -inf
) -> tuple[Draws, int]:
    """Return draws of a quantity that is at least a number, and how many were drawn again.

    ValueError: another distribution than a normal one goes below it, or most of a normal one; or
    draws overflow.
    """
    stream = distribution._stream or name
    generator = np.random.default_rng([seed, *stream.encode()])
    values = distribution._draw(generator, count)
    below = values < least
    again = int(below.sum())
    if again and (not isinstance(distribution, Normal) or distribution.mean < least):
        raise ValueError(
            f"{name} has draws below {least:g}, such as {values.min():g}, which a scene refuses; "
            "give a distribution that stays above, such as a lognormal one."
        )
    for _ in range(_ROUNDS):
        if not below.any():
            break
        values[below] = distribution._draw(generator, int(below.sum()))
        below = values < least
    if not np.isfinite(values).all():
        raise ValueError(f"{name} has draws that overflow float64; give a narrower distribution.")
    return values, again


def _require_finite(numbers: Any) -> None:
    for name, value in vars(numbers).items():
        if not isfinite(value):
            raise ValueError(f"{name} is {value}; give a finite number.")
