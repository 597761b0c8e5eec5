"""The open loop of any two gains in mpmath, from recursions and equations of motion, and its truth.

L = W/D - 1 on the circle, W and D the characteristic polynomials with gains and without: 60 digits,
and nothing of jaxstab's. A claim about the largest or least of a function is judged on a grid that
is dense next to the claimed angle and next to the closed loop's poles.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial, reduce
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from mpmath import mp, mpc, mpf

import jaxstab
from jaxstab.results import AtFrequency, FrequencyMargins
from tests.truth.affine_kinds import KINDS, polynomial_exactly
from tests.truth.plain import Loop, is_stable_in_digits
from tests.truth.random_loops import DeviceLoop, MassLoop

DIGITS = 60
Falling = list[mpf]


def horner(falling: Falling, z: mpc) -> mpc:
    """The value of a polynomial, the highest power first."""
    return reduce(lambda value, c: value * z + c, falling)


class OpenLoop(NamedTuple):
    """D and W, the highest power first, of one degree; the period, and W of a later loop."""

    below: Falling
    whole: Falling
    period: float
    later: Callable[[float], Falling] | None

    def at(self, angle: Any) -> tuple[mpc, mpc]:
        """D and N."""
        z = mp.expj(angle)
        below, whole = (horner(side, z) for side in self[:2])
        return below, whole - below

    def times(self, factor: mpf) -> Falling:
        """D + t N."""
        pairs = zip(self.below, self.whole, strict=True)
        return [d + factor * (w - d) for d, w in pairs]


class Asked(NamedTuple):
    """What jaxstab answers about a pair of gains, and the truth."""

    margins: FrequencyMargins
    truth: OpenLoop
    words: str


def of_kind(kind: str, rng: np.random.Generator) -> Asked:
    """Random stable gains of a random loop of a kind of ``affine_kinds``."""
    while True:
        case = KINDS[kind](rng)
        pair = _stable_pair(rng, case.intervals, case.gains, case.scale)
        if pair is None:
            continue
        nothing = (1e90, 0.0) if kind == "admittance" else (0.0, 0.0)
        is_pid = kind in ("kp-ki", "kp-kd", "ki-kd")
        opened = {"is_open": True} if is_pid else {}  # the given gain, too
        with mp.workdps(120):
            below, whole = (
                polynomial_exactly(case.matrix(*g, exact=True, **own))
                for g, own in ((nothing, opened), (pair, {}))
            )
        gains = dict(zip(case.gains, pair, strict=True))

        def later(extra: float, matrix: Any = case.matrix, pair: Any = pair) -> Falling:
            bodies, (delay, other), *rest = matrix.args
            late = partial(matrix.func, bodies, [delay + extra, other], *rest)
            return _plain(polynomial_exactly(late(*pair, exact=True)))

        is_held = isinstance(case.loop, jaxstab.HapticLoop)
        period = float(case.loop.sample_time)
        truth = OpenLoop(below, whole, period, later if is_held else None)
        return Asked(case.loop.frequency_margins(**gains), truth, f"{case.loop!r} {gains}")


def of_drawn(draw: Callable[[Any], MassLoop | DeviceLoop], rng: np.random.Generator) -> Asked:
    """Random stable walls of a random device, with an estimator, a filter and any delay."""
    while True:
        drawn = draw(rng)
        own = Loop.of(drawn)

        def intervals(loop: Any = own.loop, **gain: float) -> Any:
            ask = loop.stiffness_intervals if "damping" in gain else loop.damping_intervals
            return ask(*gain.values())

        wall = _stable_pair(rng, intervals, ("stiffness", "damping"), (1.0, 1.0))
        if wall is None:
            continue

        def later(extra: float, drawn: Any = drawn, wall: Any = wall) -> Falling:
            if isinstance(drawn, MassLoop):
                *hand, delay = drawn.plant
                return Loop.of(replace(drawn, plant=(*hand, delay + extra))).polynomial(*wall)
            device = drawn.device._replace(delay=drawn.device.delay + extra)
            return Loop.of(replace(drawn, device=device)).polynomial(*wall)

        with mp.workdps(DIGITS):
            k, b = map(mpf, wall)
            triple = zip(*own[1:], strict=True)
            whole = [x + k * y + b * z for x, y, z in triple]
        truth = OpenLoop(own.base, whole, float(own.loop.sample_time), later)
        return Asked(own.loop.frequency_margins(*wall), truth, f"{own.loop!r} {wall}")


def _stable_pair(
    rng: np.random.Generator,
    intervals: Callable[..., Any],
    names: tuple[str, str],
    scale: tuple[float, float],
) -> tuple[float, float] | None:
    """A pair inside of the stable set, if a row or a column has one."""
    for _ in range(6):
        axis = int(rng.integers(2))
        given = float(scale[1 - axis] * 10 ** rng.uniform(-2.5, 0.0))
        found = intervals(**{names[1 - axis]: given}).intervals
        ends = [(max(low.value, 0.0), high.value) for low, high in found if high.value > 0.0]
        if ends:
            low, high = ends[int(rng.integers(len(ends)))]
            own = low + (min(high, low + 10.0 * scale[axis]) - low) * float(rng.uniform(0.05, 0.95))
            return (own, given) if axis == 0 else (given, own)
    return None


# ------------------------------------------------------------------------------------------ truth
def wrong(asked: Asked, grid: int = 250) -> Iterator[str]:
    """What the truth denies of the claims."""
    margins, truth, _ = asked
    if np.isnan([own.value for own in margins[1:]]).any():
        yield "not proved"
        return
    with mp.workdps(DIGITS):
        poles = np.angle(np.roots([float(c) for c in truth.whole]))
        found = [2 * np.pi * truth.period * float(own.frequency) for own in margins[1:]]
        near = np.abs(np.array([*poles, *(angle for angle in found if angle == angle)]))
        spread = 1.0 + np.array([0.0, 1e-9, 1e-6, 1e-4, 1e-3, 1e-2, 0.1])
        angles = [np.geomspace(1e-7, np.pi, grid), np.linspace(1e-3, np.pi, grid)]
        angles += [near * by for by in (*spread, *(1.0 / spread))]
        every = np.unique(np.clip(np.concatenate(angles), 1e-9, np.pi))
        values = [(angle, *truth.at(angle)) for angle in every.tolist()]
        yield from _wrong_peaks(margins, truth, values)
        yield from _wrong_crossovers(margins, truth, values)
        yield from _wrong_gains(margins, truth)


def _angle(own: AtFrequency, truth: OpenLoop) -> float:
    return min(2.0 * np.pi * float(own.frequency) * truth.period, np.pi)


def _wrong_peaks(margins: Any, truth: OpenLoop, values: Any) -> Iterator[str]:
    functions: dict[str, Callable[[Any, Any], Any]] = {
        "sensitivity": lambda d, n: abs(d / (d + n)),
        "complementary": lambda d, n: abs(n / (d + n)),
        "disk": lambda d, n: -2 * abs((d + n) / (d - n)),
    }
    for name, function in functions.items():
        own = getattr(margins, name)
        value = mpf(float(own.value)) * (-1 if name == "disk" else 1)
        largest = max(function(d, n) for _, d, n in values if d != n)
        if largest > value + mpf(float(own.error)):
            yield f"{name}: {own} but {mp.nstr(largest, 20)}"
        there = _largest_near(lambda t, f=function: f(*truth.at(t)), _angle(own, truth))
        if abs(there - value) > mpf(float(own.error)) + abs(value) * mpf(10) ** -30:
            yield f"{name}: {own} but {mp.nstr(there, 20)} there"


def _largest_near(function: Callable[[Any], Any], angle: float) -> Any:
    """The largest value within 1e-12 of an angle, by thirds; at 0 and pi the value there."""
    if angle in (0.0, np.pi):
        return function(mp.pi if angle else mpf(0))
    low, high = mpf(angle) * (1 - mpf(10) ** -12), min(mpf(angle) * (1 + mpf(10) ** -12), mp.pi)
    for _ in range(75):
        third = (high - low) / 3
        left, right = function(low + third), function(high - third)
        low, high = (low + third, high) if left < right else (low, high - third)
    return max(left, right)


def _wrong_crossovers(margins: Any, truth: OpenLoop, values: Any) -> Iterator[str]:
    def height(angle: Any) -> Any:
        d, n = truth.at(angle)
        return abs(n) - abs(d)

    heights = [(angle, abs(n) - abs(d)) for angle, d, n in values]
    phases, delays = [], []
    for (low, a), (high, b) in pairwise(heights):
        if a * b < 0:
            angle = mp.findroot(height, (low, high), solver="anderson", tol=1e-45, verify=False)
            d, n = truth.at(angle)
            lag = mp.pi + mp.arg(n / d)
            phases.append(min(lag, 2 * mp.pi - lag) * 180 / mp.pi)
            delays.append(lag / angle * truth.period)
    if truth.later is None and heights[-1][1] >= 0:
        delays.append(mpf(truth.period))
    claims = [("phase", margins.phase, phases)]
    claims += [("delay", margins.delay, delays)] if truth.later is None else []
    for name, own, every in claims:
        value, error = float(own.value), float(own.error)
        if every and not abs(min(every) - value) <= error + 1e-300:
            yield f"{name}: {own} but {[mp.nstr(each, 20) for each in every]}"
        if not every and value != np.inf:
            yield f"{name}: {own} but none"
    if truth.later is not None:
        yield from _wrong_delay(margins.delay, truth)


def _wrong_delay(own: AtFrequency, truth: OpenLoop) -> Iterator[str]:
    """Of a device between samples: stable up to the margin, unstable beyond."""
    assert truth.later is not None
    extra = float(own.value) / truth.period
    most = min(extra, 40.0)
    for share in (0.1, 0.4, 0.7, 0.9, 1.0 - 1e-8):
        if is_stable_in_digits(truth.later(share * most)) is False:
            yield f"delay: {own} but unstable at {share} of it"
    if np.isfinite(own.error) and np.isfinite(extra) and extra < 400.0:
        beyond = extra + max(1.01 * float(own.error) / truth.period, 1e-9 * extra)
        if is_stable_in_digits(truth.later(beyond)):
            yield f"delay: {own} but stable beyond"


def _wrong_gains(margins: Any, truth: OpenLoop) -> Iterator[str]:
    low, high = float(margins.least_gain.value), float(margins.largest_gain.value)
    inside = [0.999 + 0.001 * low, 0.5 + 0.5 * low, 1.0 - (1.0 - 1e-9) * (1.0 - low)] * (low > -1e6)
    inside += [1.0 + share * (min(high, 1e6) - 1.0) for share in (0.001, 0.5, 1.0 - 1e-9)]
    inside = [t for t in inside if t > -1e3]
    if any(is_stable_in_digits(_plain(truth.times(mpf(t)))) is False for t in inside):
        yield f"gains: {margins.least_gain}, {margins.largest_gain} but unstable between"
    for own, sign in ((margins.least_gain, -1.0), (margins.largest_gain, 1.0)):
        value = float(own.value)
        if np.isfinite(value):
            beyond = value + sign * max(1e-9, float(own.error), 1e-9 * abs(value))
            if is_stable_in_digits(_plain(truth.times(mpf(beyond)))):
                yield f"gains: {own} but stable beyond"


def _plain(falling: Falling) -> Falling:
    """Without roots at 0."""
    while falling[-1] == 0:
        falling = falling[:-1]
    return falling


def drawn(index: int, seed: int) -> Asked:
    """One of many loops, of all kinds in turn."""
    rng, kinds = np.random.default_rng([seed, index]), [*KINDS, MassLoop.drawn, DeviceLoop.drawn]
    kind: Any = kinds[index % len(kinds)]
    return of_kind(kind, rng) if isinstance(kind, str) else of_drawn(kind, rng)
