"""What is identified from a log: its values with intervals, as text and as a scene.

A scene takes mass and delay as ranges: the ends of their intervals. Where a warning says that the
model lacks something, intervals do not hold, and the scene has the values alone.
"""

from dataclasses import dataclass
from math import floor, inf, log10, sqrt
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.model import Velocity
from jaxstab.scene.answers import Quantity
from jaxstab.scene.scene import Units
from jaxstab.shown import printable

Rows = Float64[np.ndarray, " row"]
Segments = Float64[np.ndarray, "segment sample"]


class Estimate(NamedTuple):
    """A value and the ends of its 95 % confidence interval, which holds if the model does.

    Example:
        >>> print(jaxstab.results.Estimate(0.25012, 0.2493, 0.2509))
        0.25012 (0.24930 to 0.25090)
        >>> print(jaxstab.results.Estimate(0.25012, 0.2493, 0.2509).times(1e3))
        250.12 (249.30 to 250.90)
    """

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        half = 0.5 * (self.high - self.low)
        places = max(0, 1 - floor(log10(half))) if half > 0.0 else 6
        value, low, high = (f"{end:.{places}f}" for end in self)
        return f"{value} ({low} to {high})"

    def times(self, factor: float, least: float = -inf) -> "Estimate":
        """Return the estimate in another unit, all three values at least ``least``."""
        return Estimate(*(max(factor * end, least) for end in self))


@dataclass(frozen=True, repr=False)
class Identified:
    """A device as identified from a log, in SI units; see ``jaxstab.identify``.

    Attributes:
        mass, damping, friction, offset, stiffness, delay: estimates in kg, N s/m, N, N, N/m and s
            (kg m^2, N m s/rad, N m, N m, N m/rad and s if it turns). The offset is a constant
            force against the command, at the mean position. The stiffness of the device's spring is
            0 unless one was fitted.
        sample_time: in s.
        resolution: the step of the encoder in m or rad; None where positions are not multiples of
            one.
        residual: the rms of measured minus fitted positions in m or rad.
        warning: a sentence if the residual contradicts the model; empty otherwise.
        velocity: the estimator that fits the logged velocity best; None without one.
        unexplained: the rms of the logged minus the estimated velocity, over that of the velocity.
        measured, fitted: positions in m or rad, (segment, sample), from row 100 of the log on.

    Example:
        >>> push = np.repeat(np.random.default_rng(1).choice([-1.0, 1.0], 200), 10)
        >>> speed = np.cumsum(push) * 1e-3 / 0.25  # of 0.25 kg, without friction and delay
        >>> place = np.cumsum(speed - push * 0.5e-3 / 0.25) * 1e-3
        >>> found = jaxstab.identify(
        ...     force=push, position=np.append(0.0, place[:-1]), sample_time=1e-3
        ... )
        >>> print(f"{found.mass.value:.4f} kg")
        0.2500 kg
    """

    mass: Estimate
    damping: Estimate
    friction: Estimate
    offset: Estimate
    stiffness: Estimate
    delay: Estimate
    sample_time: float
    resolution: float | None
    residual: float
    warning: str
    velocity: Velocity | None
    unexplained: float
    measured: Segments
    fitted: Segments

    def __repr__(self) -> str:
        return f"Identified(mass={self.mass}, damping={self.damping}, delay={self.delay})"


def doubt_of(
    residual: Segments, is_stepped: bool, size: float, extent: float, period: float
) -> str:
    """Return a warning with the residual's main frequency if rounding does not explain it."""
    window = np.hanning(residual.shape[1])
    power = np.mean(abs(np.fft.rfft(window * residual, axis=1)) ** 2, axis=0)[2:]
    peak = int(np.argmax(power))
    times = float(np.sqrt(12.0 * np.mean(residual**2)))
    noise = 1e-6  # of the motion: a smaller residual causes no warning
    odd, sharp = 1.5, 20.0  # a residual in roundings, its peak in medians of the spectrum
    is_sharp = power[peak] > sharp * np.median(power) and size > noise * extent
    is_odd = times > odd if is_stepped else is_sharp
    if not is_odd:
        return ""
    of_rounding = f", {times:.3g} times that of the encoder's rounding" if is_stepped else ""
    return (
        f"the residual is {size:.3g} rms{of_rounding}, with its largest peak at "
        f"{(peak + 2) / (residual.shape[1] * period):.3g} Hz: the model lacks something, such as a "
        "vibration mode, a hand on the handle or a varying delay"
    )


def identified_text(device: Identified, units: Units) -> str:
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
    doubt = "; by the warning it does not" if device.warning else ""
    return "\n".join([*shown, f"in brackets: 95 % confidence intervals, if the model holds{doubt}"])


def _unexplained(device: Identified) -> str:
    percent = 100.0 * device.unexplained
    return f"{f'{percent:.2g}' if percent >= 1e-3 else '< 0.001'} % rms unexplained"


def identified_scene(device: Identified, units: Units, source: str) -> str:
    """Return the text of a scene: intervals as ranges where it takes them, else as comments.

    The delay becomes a range in which it may vary, because those proofs cover ranges of mass, too.
    With a warning there is no range: what the model lacks moves estimates out of their intervals.
    """
    period, resolution, velocity = device.sample_time, device.resolution, _velocity_key(device)
    remarks, taken, ranges = [], _range, " and as ranges"
    if device.warning:
        remarks = [f"Warning: {device.warning}. So mass and delay have no range here."]
        taken, ranges = _best, ""
    if device.stiffness.value:
        remarks.append(
            f"The device has a spring of {device.stiffness} {units.stiffness}: add it to the "
            "stiffness of the hand."
        )
    lines = [
        f"# From {printable(source)} by jaxstab identify. In brackets{ranges}: 95 %",
        "# confidence intervals, if the model holds.",
        *(f"# {remark}" for remark in remarks),
        "",
        "[device]",
        f"{units.moved} = {taken(device.mass)}  # {units.kilogram}; {device.mass}",
        f"damping = {device.damping.value:.6g}  # {units.damping}; {device.damping}",
        f"friction = {device.friction.value:.6g}  # {units.force}; {device.friction}",
        *([f"encoder.resolution = {resolution:.6g}  # {units.length}"] if resolution else []),
        "",
        "[controller]",
        f"sample_time = {period:.9g}  # s",
        f"delay = {taken(device.delay)}  # s; in samples {device.delay.times(1.0 / period)}",
        *velocity,
    ]
    if device.friction.value:
        speed = float(np.std(np.diff(device.fitted, axis=1))) / period
        words = f"{units.length}/s, of simulated contacts; that of the log"
        lines += ["", "[contact]", f"speed = {speed:.2g}  # {words}"]
    return "\n".join([*lines, ""])


def _range(estimate: Estimate) -> str:
    return f"[{max(estimate.low, 0.0):.7g}, {max(estimate.high, 0.0):.7g}]"


def _best(estimate: Estimate) -> str:
    return f"{max(estimate.value, 0.0):.7g}"


def _velocity_key(device: Identified) -> list[str]:
    """Return the key of the velocity's estimator, as a comment if it explains too little."""
    if device.velocity is None:
        return []
    (section,) = device.velocity.filter.sections
    name, value = next(
        (name, getattr(section, own))
        for name, own in (("window_samples", "samples"), ("cutoff", "cutoff"))
        if hasattr(section, own)
    )
    explained = 0.05  # of a velocity: an estimator with a larger error is only a comment
    mark = "" if device.unexplained <= explained else "# not explained: "
    return [f"{mark}velocity.{name} = {value:.6g}  # {_unexplained(device)}"]
