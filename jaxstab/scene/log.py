"""A log of a device as a CSV file, and what is identified from it as a scene."""

from dataclasses import dataclass
from math import sqrt
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64

from jaxstab.scene.answers import Quantity
from jaxstab.scene.draws import columns_of
from jaxstab.scene.scene import Units
from jaxstab.shown import printable

if TYPE_CHECKING:
    from jaxstab.scene.identify import Estimate, Identified

_UNEQUAL = 0.1  # of a sample: the most that a time step may differ from the mean
_EXPLAINED = 0.05  # of a velocity: an estimator with a larger error is only a comment


@dataclass(frozen=True)
class Log:
    """The columns of a log in SI units, and its sampling period in s."""

    sample_time: float
    force: Float64[np.ndarray, " row"]
    position: Float64[np.ndarray, " row"]
    velocity: Float64[np.ndarray, " row"] | None


def read_log(
    file: str, names: dict[str, str], sample_time: float | None, needs_velocity: bool
) -> Log:
    """Read a log by the names of its columns; ValueError if it is bad or its time steps differ."""
    needed = ["force", "position", *(["time"] if sample_time is None else [])]
    optional = [] if needs_velocity else [names["velocity"]]
    needed += ["velocity"] if needs_velocity else []
    table = columns_of(file, [names[key] for key in needed], optional)
    columns = {key: np.array(table[name]) for key, name in names.items() if name in table}
    if sample_time is None:
        steps = np.diff(columns["time"])
        sample_time = float(np.mean(steps)) if len(steps) else 0.0
        odd = np.flatnonzero(~(abs(steps - sample_time) <= _UNEQUAL * sample_time))
        if len(odd) or not sample_time > 0.0:
            line = int(odd[0]) + 3 if len(odd) else 3
            raise ValueError(
                f"{file}, line {line}: the time does not grow by the mean step of "
                f"{sample_time:.6g} s; give a log with equal steps, or --sample-time if no row is "
                "missing."
            )
    return Log(sample_time, columns["force"], columns["position"], columns.get("velocity"))


def identified_text(device: "Identified", units: Units) -> str:
    """Return the identified quantities, one on each line, with units."""
    period, length = device.sample_time, Quantity("m", digits=3)
    rounding = length.words((device.resolution or 0.0) / sqrt(12.0), units)
    explained = f" (encoder rounding alone: {rounding})" if device.resolution else ""
    lines = {
        units.moved: f"{device.mass} {units.kilogram}",
        "damping": f"{device.damping} {units.damping}",
        "friction": f"{device.friction} {units.force}",
        "constant force": f"{device.offset} {units.force}",
        "spring": f"{device.stiffness} {units.stiffness}" if device.stiffness.value else "",
        "delay": f"{device.delay.times(1e3)} ms; in samples {device.delay.times(1.0 / period)}",
        "residual": f"{length.words(device.residual, units)} rms{explained}",
        "velocity": f"{device.velocity}; {_unexplained(device)}" if device.velocity else "",
    }
    shown = [f"{name:16}{words}" for name, words in lines.items() if words]
    return "\n".join([*shown, "in brackets: 95 % confidence intervals, if the model holds"])


def _unexplained(device: "Identified") -> str:
    percent = 100.0 * device.unexplained
    return f"{f'{percent:.2g}' if percent >= 1e-3 else '< 0.001'} % rms unexplained"


def identified_scene(device: "Identified", units: Units, source: str) -> str:
    """Return the text of a scene: intervals as ranges where it takes them, else as comments.

    The delay becomes a range in which it may vary, because those proofs cover ranges of mass, too.
    """
    period, resolution, velocity = device.sample_time, device.resolution, _velocity_key(device)
    remarks = [f"Warning: {device.warning}."] if device.warning else []
    if device.stiffness.value:
        remarks.append(
            f"The device has a spring of {device.stiffness} {units.stiffness}: add it to the "
            "stiffness of the hand."
        )
    lines = [
        f"# From {printable(source)} by jaxstab identify. In brackets and as ranges: 95 %",
        "# confidence intervals, if the model holds.",
        *(f"# {remark}" for remark in remarks),
        "",
        "[device]",
        f"{units.moved} = {_range(device.mass)}  # {units.kilogram}; best {device.mass.value:.7g}",
        f"damping = {device.damping.value:.6g}  # {units.damping}; {device.damping}",
        f"friction = {device.friction.value:.6g}  # {units.force}; {device.friction}",
        *([f"encoder.resolution = {resolution:.6g}  # {units.length}"] if resolution else []),
        "",
        "[controller]",
        f"sample_time = {period:.9g}  # s",
        f"delay = {_range(device.delay)}  # s; in samples {device.delay.times(1.0 / period)}",
        *velocity,
    ]
    if device.friction.value:
        speed = float(np.std(np.diff(device.fitted, axis=1))) / period
        words = f"{units.length}/s, of simulated contacts; that of the log"
        lines += ["", "[contact]", f"speed = {speed:.2g}  # {words}"]
    return "\n".join([*lines, ""])


def _range(estimate: "Estimate") -> str:
    return f"[{max(estimate.low, 0.0):.7g}, {max(estimate.high, 0.0):.7g}]"


def _velocity_key(device: "Identified") -> list[str]:
    """Return the key of the velocity's estimator, as a comment if it explains too little."""
    if device.velocity is None:
        return []
    (section,) = device.velocity.filter.sections
    name, value = next(
        (name, getattr(section, own))
        for name, own in (("window_samples", "samples"), ("cutoff", "cutoff"))
        if hasattr(section, own)
    )
    mark = "" if device.unexplained <= _EXPLAINED else "# not explained: "
    return [f"{mark}velocity.{name} = {value:.6g}  # {_unexplained(device)}"]
