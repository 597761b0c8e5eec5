"""The velocity estimator and the position filter of a scene, as tables of a file."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from math import inf
from typing import Any

from jaxstab.model import Filter, Velocity
from jaxstab.model.sections import HIGHEST_ORDER
from jaxstab.scene.presets import ASSUMED, Sourced, software_presets
from jaxstab.tables import Table, coefficients, key, one_of, quantity, whole

KINDS = ("low-pass", "butterworth")
MOST_WINDOW = HIGHEST_ORDER  # samples
_NYQUIST = 0.499  # of the sampling rate: a Butterworth filter ends at 0.5
_FASTEST = 100.0  # of the sampling rate: a pole that is 0 in float64 is refused


@dataclass(frozen=True, kw_only=True)
class _Chain(Table):
    """What both have: a window, a low pass and exponential smoothing in a row, or coefficients."""

    window_samples: int | None = key(whole(1, MOST_WINDOW), None)
    window: float | None = key(quantity("s", is_positive=True), None)
    cutoff: float | None = key(quantity("Hz", is_positive=True), None)
    order: int | None = key(whole(1, HIGHEST_ORDER), None)
    kind: str | None = key(one_of(KINDS), None)
    factor: float | None = key(quantity("1", is_positive=True), None)
    numerator: tuple[float, ...] | None = key(coefficients, None)
    denominator: tuple[float, ...] | None = key(coefficients, None)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.window is not None and self.window_samples is not None:
            raise ValueError(f"window is {self.window:g} beside window_samples; give one.")
        for name in ("order", "kind"):
            if getattr(self, name) is not None and self.cutoff is None:
                raise ValueError(
                    f"{name} is {getattr(self, name)} without cutoff; give cutoff in Hz."
                )
        self._check_coefficients()

    def _check_coefficients(self) -> None:
        given = [entry.name for entry in fields(self) if getattr(self, entry.name) is not None]
        parts = {"numerator", "denominator"} & set(given)
        others = [name for name in given if name not in parts and name != "preset"]
        if len(parts) == 1:
            raise ValueError(f"{parts.pop()} stands alone; give numerator and denominator.")
        if parts and others:
            raise ValueError(f"{others[0]} stands beside numerator; give one of them.")
        if not parts and not others:
            raise ValueError(
                "window is missing; give it, or window_samples, cutoff, factor, or numerator and "
                "denominator."
            )

    @property
    def _smoothing(self) -> Filter:
        """What follows after the window."""
        chain = Filter()
        if self.cutoff is not None:
            make = Filter.butterworth if self.kind == "butterworth" else Filter.low_pass
            chain *= make(self.cutoff, self.order or 1)
        return chain if self.factor is None else chain * Filter.exponential(self.factor)


@dataclass(frozen=True, kw_only=True)
class PositionTable(_Chain):
    """The filter of the position that the wall's spring sees."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.made()

    def made(self) -> Filter:
        """Return the filter."""
        if self.numerator is not None and self.denominator is not None:
            return Filter.transfer_function(self.numerator, self.denominator)
        if self.window is None and self.window_samples is None:
            return self._smoothing
        return Filter.average(self.window_samples, window=self.window) * self._smoothing


@dataclass(frozen=True, kw_only=True)
class VelocityTable(_Chain):
    """The estimator of the velocity that the wall's damper sees, or that of a software by name."""

    preset: str | None = key(lambda name: one_of(software_presets())(name), None)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.made()

    @classmethod
    def filled_in(cls, table: Mapping[str, Any]) -> Mapping[str, Any]:
        """Let a preset give what the table does not."""
        preset = software_presets().get(str(table.get("preset")))
        if preset is None:
            return table
        known = preset.values(tuple(entry.name for entry in fields(cls)))
        if "window_samples" in table:
            known.pop("window", None)
        if len(table) == 1 and not known:
            raise ValueError(
                f"preset is {table['preset']!r}, whose estimator its maker does not document; "
                "give window, cutoff or coefficients that you have measured."
            )
        return {**known, **table}

    def made(self) -> Velocity:
        """Return the estimator."""
        if self.numerator is not None and self.denominator is not None:
            return Velocity.transfer_function(self.numerator, self.denominator)
        if self.window is None and self.window_samples is None:
            return Velocity() * self._smoothing
        return Velocity.difference(self.window_samples, window=self.window) * self._smoothing

    @property
    def longest_sample_time(self) -> float:
        """The sample time in s up to which the low pass is one; infinite where there is none."""
        if self.cutoff is None:
            return inf
        return (_NYQUIST if self.kind == "butterworth" else _FASTEST) / self.cutoff

    @property
    def usual_sample_time(self) -> float | None:
        """The sampling period in s for which the preset is meant; None where it does not matter."""
        meant = self._preset_numbers.get("sample_time")
        return meant.value if meant else None

    @property
    def is_assumed(self) -> bool:
        """Whether a number of the preset is assumed, in whole or in part."""
        return any(ASSUMED in number.source for number in self._preset_numbers.values())

    @property
    def _preset_numbers(self) -> Mapping[str, Sourced]:
        return software_presets()[self.preset].numbers if self.preset else {}

    def __str__(self) -> str:
        preset = f" (preset {self.preset}{', assumed in part' if self.is_assumed else ''})"
        return f"{self.made()}{preset if self.preset else ''}"
