"""A measured device: 43 limits (K, B) of one haptic paddle beside linear and simulated limits.

`data/measured/epfl_paddle.csv` has, for four velocity estimators and each damping, the largest
stiffness that its authors felt as stable. Sampling, estimators and friction at the motor are known;
inertia, viscous damping, delay, reduction ratio and torque limit are not. They are fitted to one
curve, or to all, by least squares of the limits over the curve's peak; the others are predictions.

- **Linear**: ``HapticLoop.stiffness_limits``, whose unknowns are inertia, damping and delay. The
  ratio would scale the first two alone, so no limit tells it.
- **Simulated**: one-sided walls under friction and saturation (``jaxstab.contact``), with the
  ratio (it scales the motor's friction) and the torque limit as further unknowns. A wall is quiet
  if the angle moves by less than ``_FELT`` at the end; the limit is the first K that is not.

Two of the estimators are not linear, and have a linear one in their place: FOAW its longest window,
a line through 20 samples, Levant's differentiator the difference that it follows if nothing is
noise. The Kalman filter has its steady gain, as the firmware applies it: the corrections of speed
and acceleration see the angle that was corrected already.

Errors are root mean squares over the peak of the measured curve. Gains are in N m/deg and
N m s/deg at the paddle, as in the firmware; a full run writes the page docs/measured.md.
"""

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_are
from scipy.optimize import least_squares
from scipy.signal import savgol_coeffs

import jaxstab
from benchmarks import measured_page, record
from benchmarks.measured_page import ESTIMATORS
from benchmarks.record import Row
from jaxstab import Filter, HapticLoop, Velocity

DATA = Path(__file__).parents[1] / "data" / "measured" / "epfl_paddle.csv"
T, DEGREES = 350e-6, 180.0 / np.pi
_DYNAMIC, _STATIC = 1.1e-3, 1.65e-3  # N m of friction at the motor: the middle of what was measured
_FELT = 1e-4  # rad
_PUSH, _SPEED, _SECONDS = 0.05, 1.0, 0.5  # N m, rad/s: the starts of `jaxstab contact`
_GRID = np.arange(0.2, 10.01, 0.2)  # N m/deg, in the steps of the measurement
_FITS = (
    (("difference_low_pass",), "linear"),
    (("kalman",), "linear"),
    (tuple(ESTIMATORS), "linear"),
    (("difference_low_pass",), "simulated"),
    (("kalman",), "simulated"),
)
_LOW = (1e-6, 1e-5, 1e-6, 1.0, 0.02)
_HIGH = (0.1, 1.0, 5e-3, 60.0, 20.0)
_BEGINNINGS = ((1e-4, 0.02, 1e-4), (2e-3, 0.05, 5e-4))
_MORE = ((2.0, 1.0), (10.0, 0.5))  # ratio, torque
_RATES, _BUZZING = (250.0, 40e3), (325.0, 904.0)  # Hz, N/m: Choi, Tan (2004)

Array = np.ndarray


class Paddle(NamedTuple):
    """What is not known: kg m^2, N m s/rad, s, the ratio of motor and paddle, N m."""

    inertia: float
    damping: float
    delay: float
    ratio: float | None = None
    torque: float | None = None

    def __str__(self) -> str:
        units = "kg m^2", "N m s/rad", "s of delay", "as ratio", "N m at most"
        values = zip(self, units, _LOW, _HIGH, strict=True)
        return ", ".join(
            f"{value:.2g} {unit}{'' if 1.01 * low < value < 0.99 * high else ' (at its bound)'}"
            for value, unit, low, high in values
            if value is not None
        )

    def loop(self, estimator: str) -> HapticLoop:
        velocity, position = filters(estimator)
        return HapticLoop(
            device_mass=self.inertia, device_damping=self.damping, sample_time=T,
            delay=self.delay, velocity=velocity, position=position,
        )  # fmt: skip

    def limits(self, estimator: str, damping: Array) -> Array:
        """The largest quiet stiffness at each damping, 0 where there is none."""
        if self.ratio is None:
            found = self.loop(estimator).stiffness_limits(damping * DEGREES)[:, 1] / DEGREES
            return np.maximum(np.nan_to_num(np.asarray(found)), 0.0)
        friction = self.ratio * _DYNAMIC
        contact = jaxstab.contact(self.loop(estimator),
            _GRID[:, None] * DEGREES, damping * DEGREES,
            friction=friction, static_friction=self.ratio * _STATIC, max_force=self.torque,
            push=max(_PUSH, 2.0 * friction), speed=_SPEED, pulls=True, duration=_SECONDS,
            path=False,
        )  # fmt: skip
        return np.array([_first_loud(column) for column in contact.amplitude.T])


def _first_loud(amplitude: Array) -> float:
    """The stiffness at which the amplitude passes what is felt, in between by its logarithm."""
    loud = amplitude > _FELT
    if not loud.any():
        return float(_GRID[-1])
    first = int(np.argmax(loud))
    if first == 0:
        return 0.0
    low, high = np.log(np.clip(amplitude[first - 1 : first + 1], 1e-2 * _FELT, 1e2 * _FELT))
    share = (np.log(_FELT) - low) / (high - low)
    return float(_GRID[first - 1] + share * (_GRID[first] - _GRID[first - 1]))


def curves() -> dict[str, Array]:
    """Dampings and measured stiffnesses, a row each, by estimator."""
    with DATA.open(encoding="utf-8") as lines:
        rows = list(csv.DictReader(lines))
    columns = "damping", "largest_stiffness"
    return {
        name: np.array(
            [[float(row[c]) for row in rows if row["estimator"] == name] for c in columns]
        )
        for name in ESTIMATORS
    }


def filters(estimator: str) -> tuple[Velocity, Filter | None]:
    """The velocity and the position of an estimator, or of the linear one in its place."""
    smoothing = T / (T + 1.0 / (2.0 * np.pi * 50.0))  # the low pass of the firmware
    if estimator == "kalman":
        return _kalman()
    if estimator == "foaw":
        line = savgol_coeffs(20, 1, pos=19).tolist()
        slope = Velocity.savitzky_golay(20, order=1) * Filter.exponential(smoothing)
        return slope, Filter.transfer_function(line, [1.0] + [0.0] * 19)
    return Velocity.exponential(smoothing), None


def kalman_gain() -> tuple[Array, Array]:
    """The transition of angle, speed and acceleration over T, and the gain as it is applied."""
    step = np.array([[1.0, T, 0.5 * T**2], [0.0, 1.0, T], [0.0, 0.0, 1.0]])
    measured, noise = np.array([[1.0, 0.0, 0.0]]), 4.8e-5
    before = solve_discrete_are(step.T, measured.T, np.diag([0.0, 0.0, 1e5]), np.array([[noise]]))
    gain = before[0] / (before[0, 0] + noise)
    return step, gain * [1.0, 1.0 - gain[0], 1.0 - gain[0]]


def _kalman() -> tuple[Velocity, Filter]:
    step, gain = kalman_gain()
    after = (np.eye(3) - np.outer(gain, [1.0, 0.0, 0.0])) @ step
    below = np.poly(after)
    impulse = np.array([np.linalg.matrix_power(after, k) @ gain for k in range(3)])
    angle, speed = (np.convolve(below, impulse[:, state])[:3] for state in (0, 1))
    speed[-1] = -speed[:-1].sum()  # at rest the speed is 0
    return (
        Velocity.transfer_function([*speed, 0.0], below.tolist()),
        Filter.transfer_function([*angle, 0.0], below.tolist()),
    )


def fitted(names: Sequence[str], model: str, evaluations: int) -> Paddle:
    """The paddle whose limits come closest to the measured curves of these estimators."""
    measured = curves()

    def misfit(logarithms: Array) -> Array:
        paddle = Paddle(*np.exp(logarithms).tolist())
        parts = [
            (paddle.limits(name, damping) - stiffness) / stiffness.max()
            for name, (damping, stiffness) in ((name, measured[name]) for name in names)
        ]
        return np.concatenate(parts)

    beginnings: list[tuple[float, ...]] = list(_BEGINNINGS)
    if model == "simulated":
        linear = fitted(names, "linear", evaluations)[:3]
        beginnings = [(*begin, *more) for begin in (linear, *_BEGINNINGS) for more in _MORE]
    size = len(beginnings[0])
    low, high = np.log(_LOW[:size]), np.log(_HIGH[:size])
    found = [
        least_squares(
            misfit, np.clip(np.log(begin), low + 1e-6, high - 1e-6), bounds=(low, high),
            diff_step=1e-3 if model == "linear" else 0.05, max_nfev=evaluations,
        )
        for begin in beginnings
    ]  # fmt: skip
    return Paddle(*np.exp(min(found, key=lambda one: one.cost).x).tolist())


def rows(small: bool) -> Iterator[Row]:
    """Fit one curve or all, predict each; a full run writes docs/measured.md as well."""
    fits, evaluations = (_FITS[:1], 2) if small else (_FITS, 15)
    found = [row for fit in fits for row in _fit(*fit, evaluations)] + list(_update_rates())
    if not small:
        measured_page.write(found)
    yield from found


def _fit(names: Sequence[str], model: str, evaluations: int) -> Iterator[Row]:
    start = perf_counter()
    paddle = fitted(names, model, evaluations)
    seconds = perf_counter() - start
    words = "all four" if len(names) > 1 else ESTIMATORS[names[0]]
    for name, (damping, stiffness) in curves().items():
        limits, samples = paddle.limits(name, damping), paddle.delay / T
        row = _row(model, f"{words}: {name}", samples, seconds, limits, damping, stiffness)
        own = {field: value for field, value in paddle._asdict().items() if field != "delay"}
        yield row | own | {"fitted_to": words, "estimator": name, "paddle": str(paddle)}


def _update_rates() -> Iterator[Row]:
    """The stiffest walls without damping at two rates: of the preset; damping and delay fitted."""
    start, measured = perf_counter(), np.array(_BUZZING)

    def stiffest(damping: float, delay: float) -> Array:
        known: dict[str, Any] = {"device_mass": 0.1, "device_damping": damping, "delay": delay}
        loops = (HapticLoop(sample_time=1.0 / rate, **known) for rate in _RATES)
        return np.array([loop.stiffness_limits(0.0)[1] for loop in loops])

    fit = least_squares(
        lambda x: stiffest(*np.exp(x)) / measured - 1.0, np.log([1.5, 1e-3]), diff_step=1e-4
    )
    for name, numbers in {"as preset": (1.5, 0.0), "fitted": np.exp(fit.x).tolist()}.items():
        limits, words = stiffest(*numbers), "{:.3g} N s/m, delay {:.3g} s".format(*numbers)
        seconds = perf_counter() - start
        yield _row("rate", f"{name}: {words}", numbers[1], seconds, limits, _RATES, measured)


def _row(
    section: str, method: str, delay: float, seconds: float, limits: Array, *points: Any
) -> Row:
    at, measured = (np.array(column) for column in points)
    return record.row(
        section,
        method,
        [seconds],  # of the fit
        float(np.sqrt(np.mean((limits - measured) ** 2)) / measured.max()),
        "root mean square over the largest measured limit",
        delay=delay,  # in samples; of rates in s
        points=len(measured),
        at=" ".join(map(str, at.tolist())),  # dampings, or Hz
        measured=" ".join(map(str, measured.tolist())),
        limits=" ".join(f"{limit:.4g}" for limit in limits),
    )
