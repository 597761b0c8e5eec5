"""Velocity estimators and position filters as tables of a file. No JAX.

Scenes and atlases have the same keys; they differ in the unit of the cut-off, and a scene may
give its window in s as well:

    window_samples = 20         the difference (of a position filter: the mean) over 20 samples
    cutoff = 100.0              then a low pass at 100 Hz (an atlas: at a share of the rate)
    polynomial = 2              in place of the difference, the slope of a parabola through them
    acceleration_variance = 100.0, position_variance = 1e-10
                                in place of it, a Kalman filter
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar

from jaxstab.model.filters import (
    HIGHEST_ORDER,
    HIGHEST_POLYNOMIAL,
    LONGEST_WINDOW,
    LOW_PASSES,
    Filter,
    Velocity,
)
from jaxstab.tables import Table, coefficients, key, one_of, quantity, share, whole

WINDOW = "length of the window"  # what that key is

_LOW_PASSES: Mapping[str, Callable[..., Filter]] = {
    section.kind: getattr(Filter, section.maker) for section in LOW_PASSES
}

NO_FILTER: Mapping[str, Any] = {
    "cutoff": 0.0,
    "order": 1,
    "kind": LOW_PASSES[0].kind,
    "factor": 1.0,
    "numerator": None,
    "denominator": None,
}
"""The keys of a table but for the window, with values that filter nothing."""

_ESTIMATOR = "polynomial", "acceleration_variance", "position_variance"  # keys of velocities alone

_NEEDS = {
    "order": "cutoff",
    "kind": "cutoff",
    "polynomial": "window_samples",
    "numerator": "denominator",
    "denominator": "numerator",
    "acceleration_variance": "position_variance",
    "position_variance": "acceleration_variance",
}
"""Keys that mean nothing without another one."""


@dataclass(frozen=True, kw_only=True)
class FilterTable(Table):
    """A window, a low pass and exponential smoothing in a row, or coefficients alone.

    Of a velocity the window may be that of a polynomial, or a Kalman filter in its place.
    """

    window_samples: int | None = key(whole(1, LONGEST_WINDOW), None, words=f"{WINDOW} in samples")
    cutoff: float | None = key(
        quantity("Hz", is_positive=True), None, words="cut-off of the low pass"
    )
    order: int | None = key(whole(1, HIGHEST_ORDER), None)
    kind: str | None = key(one_of(_LOW_PASSES), None)
    factor: float | None = key(share, None)
    polynomial: int | None = key(whole(1, HIGHEST_POLYNOMIAL), None)
    acceleration_variance: float | None = key(quantity("(m/s^2)^2", is_positive=True), None)
    position_variance: float | None = key(quantity("m^2", is_positive=True), None)
    numerator: tuple[float, ...] | None = key(coefficients, None)
    denominator: tuple[float, ...] | None = key(coefficients, None)

    names_besides: ClassVar[tuple[str, ...]] = ()
    """Keys that make no filter."""

    def __post_init__(self) -> None:
        super().__post_init__()
        names = [entry.name for entry in fields(self) if entry.name not in self.names_besides]
        every = {name: getattr(self, name) for name in names}
        given = {name: value for name, value in every.items() if value is not None}
        for name, needed in _NEEDS.items():
            if name in given and needed not in given:
                raise ValueError(f"{name} is {given[name]} without {needed}; give {needed}, too.")
        others = [name for name in given if name not in ("numerator", "denominator")]
        if "numerator" in given and others:
            raise ValueError(f"{others[0]} is given beside numerator; give one of them.")
        if "position_variance" in given and "window_samples" in given:
            raise ValueError("window_samples is given beside position_variance; give one of them.")
        if not given:
            needed, *more = (name for name in every if name not in _NEEDS)
            raise ValueError(
                f"{needed} is missing; give it, or {', '.join(more)}, or numerator and denominator."
            )

    def as_filter(self) -> Filter:
        """Return the filter of a position."""
        for name in _ESTIMATOR:
            if getattr(self, name) is not None:
                raise ValueError(
                    f"{name} is {getattr(self, name):g} for a filter; it makes velocities of "
                    "positions: give it as the first table of velocity."
                )
        if self.numerator is not None and self.denominator is not None:
            return Filter.transfer_function(self.numerator, self.denominator)
        return (Filter.average(**self._length) if self._length else Filter()) * self._smoothing

    def as_velocity(self) -> Velocity:
        """Return the estimator of a velocity."""
        if self.numerator is not None and self.denominator is not None:
            return Velocity.transfer_function(self.numerator, self.denominator)
        return self._difference * self._smoothing

    @property
    def is_other_estimator(self) -> bool:
        """True if the velocity is not a difference, smoothed."""
        return any(getattr(self, name) is not None for name in _ESTIMATOR)

    @property
    def _difference(self) -> Velocity:
        if self.polynomial is not None:
            return Velocity.savitzky_golay(**self._length, order=self.polynomial)
        if self.acceleration_variance is not None and self.position_variance is not None:
            return Velocity.kalman(self.acceleration_variance, self.position_variance)
        return Velocity.difference(**self._length) if self._length else Velocity()

    @property
    def _length(self) -> dict[str, Any]:
        """The length of the window, in samples or in s; empty without one."""
        return {} if self.window_samples is None else {"samples": self.window_samples}

    @property
    def _smoothing(self) -> Filter:
        chain = Filter()
        if self.cutoff is not None:
            chain *= _LOW_PASSES[self.kind or LOW_PASSES[0].kind](
                self.cutoff, order=self.order or 1
            )
        return chain if self.factor is None else chain * Filter.exponential(self.factor)


def below_one(value: Any) -> float:
    """Return a cut-off as a share of the sampling rate."""
    ratio: float = quantity("1", is_positive=True)(value)
    if ratio >= 1.0:
        raise ValueError("give it as a share of the sampling rate, below 1")
    return ratio


@dataclass(frozen=True, kw_only=True)
class SampledTable(FilterTable):
    """The same in units of one sample: the cut-off is a share of the sampling rate."""

    cutoff: float | None = key(below_one, None)
