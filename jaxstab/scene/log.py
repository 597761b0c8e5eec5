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

_UNEQUAL = 0.1  # of a sample: how far steps of the time may be from their mean
_EXPLAINED = 0.05  # of a velocity: an estimator that leaves more is not taken


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
    """Read a log whose columns are named; ValueError for a bad one, or unequal steps of time."""
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
                f"{file}, line {line}: the time does not grow by {sample_time:.6g} s, the mean "
                "step; give a log with equal steps, or the period as --sample-time if no row is "
                "missing."
            )
    return Log(sample_time, columns["force"], columns["position"], columns.get("velocity"))


def identified_text(found: "Identified", units: Units) -> str:
    """Return what was identified, a line each."""
    period, length = found.sample_time, Quantity("m", digits=3)
    rounding = length.words((found.resolution or 0.0) / sqrt(12.0), units)
    explained = f", where the encoder's rounding explains {rounding}" if found.resolution else ""
    lines = {
        units.moved: f"{found.mass} {units.kilogram}",
        "damping": f"{found.damping} {units.damping}",
        "friction": f"{found.friction} {units.force}",
        "constant force": f"{found.offset} {units.force}",
        "spring": f"{found.stiffness} {units.stiffness}" if found.stiffness.value else "",
        "delay": f"{found.delay.times(1e3)} ms; in samples {found.delay.times(1.0 / period)}",
        "residual": f"{length.words(found.residual, units)} rms{explained}",
        "velocity": f"{found.velocity}, which {_left(found)}" if found.velocity else "",
    }
    shown = [f"{name:16}{words}" for name, words in lines.items() if words]
    return "\n".join([*shown, "in brackets: 95 % confidence intervals, if the model holds"])


def _left(found: "Identified") -> str:
    percent = 100.0 * found.unexplained
    return f"leaves {f'{percent:.2g}' if percent >= 1e-3 else '< 0.001'} % (rms)"


def identified_scene(found: "Identified", units: Units, source: str) -> str:
    """Return the text of a scene: intervals where it takes ranges, the others as comments.

    The delay becomes a range in which it moves, for proofs of these hold for all masses, too.
    """
    period, resolution, velocity = found.sample_time, found.resolution, _velocity_key(found)
    remarks = [f"Warning: {found.warning}."] if found.warning else []
    if found.stiffness.value:
        remarks.append(
            f"The device has a spring of {found.stiffness} {units.stiffness}: add it to the "
            "stiffness of the hand."
        )
    lines = [
        f"# From {printable(source)} by jaxstab identify. In brackets and as ranges: 95 %",
        "# confidence intervals, which hold if the model does.",
        *(f"# {remark}" for remark in remarks),
        "",
        "[device]",
        f"{units.moved} = {_range(found.mass)}  # {units.kilogram}; best {found.mass.value:.7g}",
        f"damping = {found.damping.value:.6g}  # {units.damping}; {found.damping}",
        f"friction = {found.friction.value:.6g}  # {units.force}; {found.friction}",
        *([f"encoder.resolution = {resolution:.6g}  # {units.length}"] if resolution else []),
        "",
        "[controller]",
        f"sample_time = {period:.9g}  # s",
        f"delay = {_range(found.delay)}  # s; in samples {found.delay.times(1.0 / period)}",
        *velocity,
    ]
    if found.friction.value:
        speed = float(np.std(np.diff(found.fitted, axis=1))) / period
        words = f"{units.length}/s, of simulated contacts; that of the log"
        lines += ["", "[contact]", f"speed = {speed:.2g}  # {words}"]
    return "\n".join([*lines, ""])


def _range(estimate: "Estimate") -> str:
    return f"[{max(estimate.low, 0.0):.7g}, {max(estimate.high, 0.0):.7g}]"


def _velocity_key(found: "Identified") -> list[str]:
    """Return the key of the velocity's estimator, as a comment if it explains too little."""
    if found.velocity is None:
        return []
    (section,) = found.velocity.filter.sections
    name, value = next(
        (name, getattr(section, own))
        for name, own in (("window_samples", "samples"), ("cutoff", "cutoff"))
        if hasattr(section, own)
    )
    mark = "" if found.unexplained <= _EXPLAINED else "# not explained: "
    return [f"{mark}velocity.{name} = {value:.6g}  # {_left(found)}"]
