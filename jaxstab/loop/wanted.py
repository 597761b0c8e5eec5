"""Margins as a wish: what the loop of a pair of gains shall withstand, in the words of users."""

from collections.abc import Mapping
from math import inf, nextafter, radians
from typing import Any, NamedTuple

from jaxstab.exact.usable import Wish
from jaxstab.numbers import checked_number, has_shape
from jaxstab.shown import number_text, shortened


class WantedMargins(NamedTuple):
    """Margins that gains shall have; None for one that does not matter."""

    phase_margin: float | None = None
    gain_margin: tuple[float, float] | None = None
    sensitivity: float | None = None
    delay_margin: float | None = None

    @classmethod
    def checked(
        cls,
        phase_margin: Any = None,
        gain_margin: Any = None,
        sensitivity: Any = None,
        delay_margin: Any = None,
    ) -> "WantedMargins":
        """The margins, refused unless each makes sense; there may be none."""
        if phase_margin is not None:
            phase_margin = checked_number(
                "phase_margin", phase_margin, 0.0, 180.0, is_open=True, unit="degrees"
            )
        if gain_margin is not None:
            is_pair = has_shape(gain_margin, 2)
            ends = gain_margin if is_pair else (1.0, gain_margin)
            least = checked_number("gain_margin", ends[0])
            most = checked_number("gain_margin", ends[1])
            if not 0.0 < least <= 1.0 < most:
                raise ValueError(
                    f"gain_margin is {shortened(gain_margin)}; give a factor above 1 such as 2, or "
                    "the least and the largest factor, such as (1/2, 2)."
                )
            gain_margin = least, most
        if sensitivity is not None:
            sensitivity = checked_number("sensitivity", sensitivity, 1.0, is_open=True)
        if delay_margin is not None:
            delay_margin = checked_number("delay_margin", delay_margin, 0.0, is_open=True, unit="s")
        return cls(phase_margin, gain_margin, sensitivity, delay_margin)

    def wish(self, sample_time: float) -> Wish:
        """The same for ``exact.usable``, no smaller for rounding."""
        phase, delay = self.phase_margin or 0.0, (self.delay_margin or 0.0) / sample_time
        return Wish(
            nextafter(radians(phase), inf) if phase else 0.0,
            self.gain_margin or (1.0, 1.0),
            self.sensitivity or inf,
            nextafter(delay, inf) if delay else 0.0,
        )

    def eased(self, share: float) -> "WantedMargins":
        """The same share of each margin, from 0, no margin at all, to 1; of two digits or so."""
        phase, gain, peak, delay = self
        return WantedMargins(
            phase and float(f"{phase * share:.2g}"),
            gain and (float(f"{gain[0] ** share:.3g}"), float(f"{gain[1] ** share:.3g}")),
            peak and float(f"{1.0 + (peak - 1.0) / share:.3g}"),
            delay and float(f"{delay * share:.2g}"),
        )

    @property
    def texts(self) -> dict[str, str]:
        """Each wish in words, by the name of its keyword."""
        every = {
            "phase_margin": lambda x: f"a phase margin of {x:g} degrees",
            "gain_margin": lambda x: (
                f"a gain margin of {x[1]:g}" if x[0] == 1.0 else f"factors of {x[0]:g} to {x[1]:g}"
            ),
            "sensitivity": lambda x: f"a peak of |S| of {x:g} at most",
            "delay_margin": lambda x: f"a delay margin of {number_text(1e3 * x, 6)} ms",
        }
        asked = {name: value for name, value in self._asdict().items() if value is not None}
        return {name: every[name](value) for name, value in asked.items()}

    @property
    def words(self) -> str:
        """All of them in one phrase."""
        *others, last = self.texts.values()
        return f"{', '.join(others)} and {last}" if others else last


def margins_in_words(margins: Mapping[str, Any]) -> str:
    """Margins, by the names of their keywords, in one phrase."""
    return WantedMargins.checked(**margins).words
