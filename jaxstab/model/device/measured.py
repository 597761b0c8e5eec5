"""Devices that were measured: position over force on the circle, at some frequencies.

``response`` is what a loop meets from the force that it commands at a sample to the position that
it reads: hold, amplifier, transport, motor, hand and encoder are in it. Between the frequencies,
and below and above them, nothing is known. There is no model, so all that asks for one is refused
by ``ports``; what can be asked is in ``loop.measured``.
"""

from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np

from jaxstab.model.device.parts import Part, Ports
from jaxstab.numbers import checked
from jaxstab.tables import columns_of

_FEWEST = 8  # frequencies
_SIGN = 70.0  # degrees from those of a mass, a damper and a spring: the axis has the other sign


@dataclass(frozen=True)
class MeasuredResponse(Part):
    """Frequencies in Hz, the response there in m/N, and its relative error."""

    frequency: tuple[float, ...]
    response: tuple[complex, ...]
    error: tuple[float, ...]

    def call(self, kind: str) -> str:
        """The call that makes a device of it, in short."""
        return f"{kind}.from_response(<{len(self.frequency)} frequencies>)"

    def __str__(self) -> str:
        low, high = self.frequency[0], self.frequency[-1]
        return f"a response measured at {len(self.frequency)} frequencies, {low:g} to {high:g} Hz"

    def ports(self) -> Ports:
        """There are none: ValueError."""
        raise ValueError(
            f"the device ({self}) has no model to answer this: ask verdict, limits, "
            "stiffness_intervals, damping_intervals or frequency_margins, measure with hand and "
            "actuator, or fit a model with jaxstab.identify."
        )


def checked_response(frequency: Any, response: Any, error: Any) -> MeasuredResponse:
    """A response in the order of its frequencies; ``frequency`` may be a file with all columns."""
    if isinstance(frequency, str | PathLike):
        frequency, response, read = _columns(frequency)
        error = read if error is None else error
    frequencies = np.ravel(checked("frequency", frequency, 0.0, is_open=True, unit="Hz"))
    values = np.ravel(np.asarray(response, np.complex128))
    checked("response", np.stack([values.real, values.imag]))
    errors = np.ravel(checked("error", 0.0 if error is None else error, 0.0, 1.0))
    if len(values) != len(frequencies) or len(errors) not in (1, len(values)):
        raise ValueError(
            f"response has {len(values)} values and error {len(errors)}, but frequency has "
            f"{len(frequencies)}; give one value for each frequency, and one error or as many."
        )
    order = np.argsort(frequencies)
    frequencies, values = frequencies[order], values[order]
    errors = np.broadcast_to(errors, values.shape)[order]
    if len(values) < _FEWEST or not np.all(np.diff(frequencies) > 0.0) or not np.all(values):
        raise ValueError(
            f"the response has {len(values)} frequencies, or one twice, or is 0; give at least "
            f"{_FEWEST}, each once, that move the device."
        )
    phase = float(np.degrees(np.angle(values[0])))
    if _SIGN < phase < 180.0 - _SIGN:
        raise ValueError(
            f"the phase at {frequencies[0]:g} Hz is {phase:.0f} degrees, but a device follows "
            "slow forces by 0 (a spring) to -180 degrees (a mass); give force and position of one "
            "sign, and begin with lower frequencies."
        )
    return MeasuredResponse(*(tuple(each.tolist()) for each in (frequencies, values, errors)))


def _columns(file: "str | PathLike[str]") -> tuple[Any, Any, Any]:
    """Frequencies, responses and errors, if there are some, of a CSV file."""
    parts = "real", "imaginary", "gain", "phase", "error"
    table = {name: np.array(own) for name, own in columns_of(file, ["frequency"], parts).items()}
    if {"real", "imaginary"} <= table.keys():
        response = table["real"] + 1j * table["imaginary"]
    elif {"gain", "phase"} <= table.keys():
        response = table["gain"] * np.exp(1j * np.radians(table["phase"]))
    else:
        raise ValueError(
            f"{file} has no columns real and imaginary (m/N), nor gain (m/N) and phase (degrees), "
            "beside frequency (Hz); give one of the two pairs."
        )
    return table["frequency"], response, table.get("error")
