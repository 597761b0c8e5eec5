"""The two gains of a loop as data: what users call them, and which value they look for."""

from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR
from math import isfinite
from typing import Literal

from jaxstab.arrays import fixed, pytree
from jaxstab.shown import number_text


@pytree
@dataclass(frozen=True)
class Gain:
    """A gain of a loop: its name, its unit, and whether users look for its largest value.

    ``symbol`` and ``word`` are what answers call it and its limit, where these have own words.

    Example:
        >>> jaxstab.simulated_pd(0.1, step=2e-3).gains[0].label
        'kp (N m/rad)'
    """

    name: str = fixed()
    unit: str = fixed("")
    sense: Literal["largest", "least"] = fixed("largest")
    symbol: str = fixed("")
    word: str = fixed("")

    @property
    def label(self) -> str:
        """Its symbol and unit, as at an axis of a picture."""
        return f"{self.symbol or self.name} ({self.unit})".removesuffix(" ()")


def limit_text(own: Gain, value: float, other: Gain, at: float, digits: int) -> str:
    """The limit of a gain, rounded to the side where gains are stable, and the other gain there."""
    rounding = ROUND_FLOOR if own.sense == "largest" else ROUND_CEILING
    text = f"{own.symbol or own.name} = {number_text(value, digits, rounding, own.unit)}"
    if not isfinite(value):
        return text
    return f"{text} at {other.symbol or other.name} = {number_text(at, digits, unit=other.unit)}"


WALL = (
    Gain("stiffness", "N/m", symbol="K", word="stiffest"),
    Gain("damping", "N s/m", symbol="B", word="most damped"),
)
"""The gains of a wall."""

ALPHA_BETA = (
    Gain("stiffness", symbol="alpha", word="stiffest"),
    Gain("damping", symbol="beta", word="most damped"),
)
"""The same in dimensionless numbers."""
