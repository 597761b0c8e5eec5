"""The values of a study: lists, and draws from distributions.

A distribution is a frozen one of ``scipy.stats``, or a column of a CSV file, whose rows are drawn
with replacement: the columns of one file together, so that mass and stiffness of a hand stay
together (the bootstrap, Efron 1979). Each key is drawn by the inverse of its distribution from a
stream of random numbers of its own, set by the seed and the name of the key. Its draws do not
depend on what else varies, on how many follow or on how the work is divided.
"""

from dataclasses import dataclass
from math import inf, isfinite, log
from typing import Any

import numpy as np
from jaxtyping import Float64

from jaxstab.shown import shortened
from jaxstab.tables import columns_of


@dataclass(frozen=True)
class Column:
    """A column of a CSV file."""

    file: str
    name: str
    values: tuple[float, ...]


def is_distribution(given: Any) -> bool:
    """True if values can be drawn from it."""
    return isinstance(given, Column) or hasattr(given, "ppf")


def words_of(given: Any) -> str:
    """A variation in words: a distribution with its parameters, or some of the values."""
    if isinstance(given, Column):
        return f"csv:{given.file}:{given.name}"
    if is_distribution(given):
        pairs = (f"{name}={value}" for name, value in given.kwds.items())
        return f"{given.dist.name}({', '.join([*map(str, given.args), *pairs])})"
    return shortened(given)


def values_of(key: str, given: Any) -> Any:
    """Return the distribution or the values that are given for a key, checked.

    A list, ``(low, high, count)``, a distribution, or one of these as a text: ``VALUE,VALUE,...``,
    ``LOW:HIGH:COUNT``, ``normal:300:100``. ValueError: it is none of these, or not finite; OSError:
    a file cannot be read.
    """
    if isinstance(given, tuple) and len(given) == 3 and isinstance(given[2], int):
        given = ":".join(map(str, given))
    given = distribution_of(given) or listed(key, given) if isinstance(given, str) else given
    if is_distribution(given):
        return given
    if not np.ndim(given):
        raise ValueError(
            f"{key} is {shortened(given)}; give a list of values, (low, high, count), or a "
            "distribution such as scipy.stats.norm(300.0, 100.0)."
        )
    values = list(given)
    if not values:
        raise ValueError(f"{key} is an empty list; give at least one value.")
    if all(isinstance(value, str) for value in values):
        return values
    try:
        numbers = np.array(values, np.float64)
    except (TypeError, ValueError):
        raise ValueError(
            f"{key} is {shortened(values)}; give numbers, or texts, not both."
        ) from None
    if not np.isfinite(numbers).all():
        raise ValueError(f"{key} is {shortened(numbers.tolist())}; give finite numbers.")
    return numbers


def distribution_of(text: str) -> Any:
    """Return the distribution of a text such as ``normal:300:100``; None where it is none.

    ValueError: its numbers are bad, or its file has no such column; OSError: it cannot be read.
    """
    from scipy import stats

    kind, *parts = text.split(":")
    if kind == "csv" and len(parts) >= 2:
        file, column = ":".join(parts[:-1]), parts[-1]
        values = tuple(columns_of(file, [column])[column])
        if not values:
            raise ValueError(f"{file} has no rows below its names; give measured values.")
        return Column(file, column, values)
    if not parts or isinstance(_number_or_text(kind), float):
        return None
    try:
        a, b = map(float, parts)
        match kind:
            case "normal":
                return stats.norm(a, b)
            case "uniform":
                return stats.uniform(a, b - a)
            case "lognormal" if b > 1.0:
                return stats.lognorm(log(b), scale=a)
    except ValueError:
        pass
    raise ValueError(
        f"{shortened(text)} is no distribution; give normal:MEAN:DEVIATION, uniform:LOW:HIGH, "
        "lognormal:MEDIAN:FACTOR with a FACTOR above 1, or csv:FILE:COLUMN."
    )


def listed(key: str, text: str) -> list[float | str]:
    """Return the values of a text: ``LOW:HIGH:COUNT`` or ``VALUE,VALUE,...``; ValueError.

    Spaced ones have 15 digits: 0.2, not 0.20000000000000001.
    """
    ends, most = text.split(":"), 100_000
    if len(ends) == 1 and text:
        return [_number_or_text(value) for value in text.split(",")]
    try:
        low, high, count = float(ends[0]), float(ends[1]), int(ends[2])
        if len(ends) == 3 and 2 <= count <= most and isfinite(high - low):
            between = np.linspace(low, high, count)[1:-1].tolist()
            return [low, *(float(f"{value:.15g}") for value in between), high]
    except (ValueError, IndexError):
        pass
    raise ValueError(
        f"{key} is {shortened(text)}; give LOW:HIGH:COUNT with a COUNT from 2 to {most}, "
        "or VALUE,VALUE,..."
    )


def _number_or_text(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def draws_of(
    key: str, given: Any, count: int, seed: int, least: float = -inf
) -> tuple[Float64[np.ndarray, " draw"], float]:
    """Return draws of a quantity that is at least a number, and the share that is cut off below it.

    ValueError: the distribution begins below that number, or most of it lies there; or its
    parameters make no draws.
    """
    stream = f"{given.file} of {len(given.values)}" if isinstance(given, Column) else key
    uniform = np.random.default_rng([seed, *stream.encode()]).random(count)
    if isinstance(given, Column):
        draws = np.array(given.values)[(uniform * len(given.values)).astype(np.int64)]
        low, below = draws.min(), 0.0
    else:
        with np.errstate(all="ignore"):  # parameters may be anything
            low, _ = given.support()
            if np.ndim(low):
                raise ValueError(f"{key} is {words_of(given)}; give a distribution of one number.")
            below = float(given.cdf(np.nextafter(least, -inf)))
            draws = np.asarray(given.ppf(below + (1.0 - below) * uniform), np.float64)
    if -inf < low < least or below > 0.5:
        raise ValueError(
            f"{key} has draws below {least:g}, which a scene refuses; give a distribution that "
            "stays above, such as a lognormal one."
        )
    if not np.isfinite(draws).all():
        raise ValueError(
            f"{key} has draws that are not finite; correct the parameters of {words_of(given)}."
        )
    return draws, below
