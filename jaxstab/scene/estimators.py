"""The velocity estimator and the position filter of a scene, as tables of a file."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from math import inf
from typing import Any, ClassVar

from jaxstab.model.filter_table import FilterTable
from jaxstab.scene.presets import ASSUMED, Sourced, software_presets
from jaxstab.tables import key, one_of, quantity

_NYQUIST = 0.499  # of the sampling rate: a Butterworth filter ends at 0.5
_FASTEST = 100.0  # of the sampling rate: a pole that is 0 in float64 is refused


@dataclass(frozen=True, kw_only=True)
class _TimedTable(FilterTable):
    """The keys of a filter, and the window in s."""

    window: float | None = key(quantity("s", is_positive=True), None)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.window is not None and self.window_samples is not None:
            raise ValueError(f"window is {self.window:g} beside window_samples; give one.")

    @property
    def _length(self) -> dict[str, Any]:
        return super()._length if self.window is None else {"window": self.window}


@dataclass(frozen=True, kw_only=True)
class PositionTable(_TimedTable):
    """The filter of the position that the wall's spring sees."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.as_filter()


@dataclass(frozen=True, kw_only=True)
class VelocityTable(_TimedTable):
    """The estimator of the velocity that the wall's damper sees, or that of a software by name."""

    preset: str | None = key(lambda name: one_of(software_presets())(name), None)

    names_besides: ClassVar[tuple[str, ...]] = ("preset",)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.as_velocity()

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
        return f"{self.as_velocity()}{preset if self.preset else ''}"
