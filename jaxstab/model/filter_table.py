"""A velocity estimator or a position filter as a table of a file. No JAX.

Scenes and atlases have the same keys; they differ in the unit of the cut-off, and a scene may give
its window in s as well:

    window_samples = 20         the difference (of a position filter: the mean) over 20 samples
    cutoff = 100.0              then a low pass at 100 Hz (an atlas: at a share of the rate)
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar

from jaxstab.model.filters import Filter, Velocity
from jaxstab.model.sections import HIGHEST_ORDER, LONGEST_WINDOW
from jaxstab.tables import Table, coefficients, key, one_of, quantity, share, whole

_LOW_PASSES: Mapping[str, Callable[..., Filter]] = {
    "low-pass": Filter.low_pass,
    "butterworth": Filter.butterworth,
}
_BESIDE = ("order", "kind")  # keys of a low pass that need its cut-off
_FRACTION = ("numerator", "denominator")


@dataclass(frozen=True, kw_only=True)
class FilterTable(Table):
    """A window, a low pass and exponential smoothing in a row, or coefficients alone."""

    window_samples: int | None = key(whole(1, LONGEST_WINDOW), None)
    cutoff: float | None = key(quantity("Hz", is_positive=True), None)
    order: int | None = key(whole(1, HIGHEST_ORDER), None)
    kind: str | None = key(one_of(_LOW_PASSES), None)
    factor: float | None = key(share, None)
    numerator: tuple[float, ...] | None = key(coefficients, None)
    denominator: tuple[float, ...] | None = key(coefficients, None)

    names_besides: ClassVar[tuple[str, ...]] = ()
    """Keys that make no filter."""

    def __post_init__(self) -> None:
        super().__post_init__()
        given = self._given()
        for name in _BESIDE:
            if name in given and self.cutoff is None:
                raise ValueError(
                    f"{name} is {getattr(self, name)} without cutoff; give cutoff, too."
                )
        fraction = [name for name in given if name in _FRACTION]
        others = [name for name in given if name not in _FRACTION]
        if len(fraction) == 1:
            raise ValueError(f"{fraction[0]} stands alone; give numerator and denominator.")
        if fraction and others:
            raise ValueError(f"{others[0]} stands beside numerator; give one of them.")
        if not given:
            first, *rest = (name for name in self._known() if name not in (*_BESIDE, *_FRACTION))
            raise ValueError(
                f"{first} is missing; give it, or {', '.join(rest)}, or numerator and denominator."
            )

    def as_filter(self) -> Filter:
        """Return the filter of a position."""
        if self.numerator is not None and self.denominator is not None:
            return Filter.transfer_function(self.numerator, self.denominator)
        return (Filter.average(**self._length) if self._length else Filter()) * self._smoothing

    def as_velocity(self) -> Velocity:
        """Return the estimator of a velocity."""
        if self.numerator is not None and self.denominator is not None:
            return Velocity.transfer_function(self.numerator, self.denominator)
        start = Velocity.difference(**self._length) if self._length else Velocity()
        return start * self._smoothing

    @property
    def _length(self) -> dict[str, Any]:
        """The length of the window, in samples or in s; empty without one."""
        return {} if self.window_samples is None else {"samples": self.window_samples}

    @property
    def _smoothing(self) -> Filter:
        """What follows after the window."""
        chain = Filter()
        if self.cutoff is not None:
            chain *= _LOW_PASSES[self.kind or "low-pass"](self.cutoff, order=self.order or 1)
        return chain if self.factor is None else chain * Filter.exponential(self.factor)

    def _given(self) -> list[str]:
        return [name for name in self._known() if getattr(self, name) is not None]

    @classmethod
    def _known(cls) -> list[str]:
        return [entry.name for entry in fields(cls) if entry.name not in cls.names_besides]


def below_one(value: Any) -> float:
    """Return a cut-off as a share of the sampling rate."""
    number: float = quantity("1", is_positive=True)(value)
    if number >= 1.0:
        raise ValueError("give it as a share of the sampling rate, below 1")
    return number


@dataclass(frozen=True, kw_only=True)
class SampledTable(FilterTable):
    """The same in units of one sample: the cut-off is a share of the sampling rate."""

    cutoff: float | None = key(below_one, None)
