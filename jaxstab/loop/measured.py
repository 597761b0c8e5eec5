"""Walls on a device that was measured: turns of 1 + L, counted from sample to sample.

L(e^(i theta)) = (K P + B V) G is known at the measured frequencies. Let G have r of the poles 0, 1
and 2 at z = 1 that a spring, a damper and a mass give it, which its phase at the lowest frequency
tells, and no pole outside. Then 1 + L starts on a small arc around z = 1 at the angle -r pi/2, and
by the argument principle the loop has as many poles outside as 1 + L, from there to theta = pi,
makes half turns. A turn is known where 1 + L goes from one frequency to the next by less than 90
degrees: -1 is then outside of the circle that has the piece of L between them as its diameter. With
a relative error e each value of 1 + L may be asin(e |L|/|1 + L|) further; what is left below 90
degrees holds for every response within it. A resonance between two frequencies turns G by up to 180
degrees, on a circle through 0, which 1 + L need not show: where G turns by an angle a of 90 or
more, the diameter of the circle of L, |L_2 - L_1|/sin a, must be below 1. Before the first
frequency |L| must be above 1, so that 1 + L turns as L does, or the device rests on a spring; after
the last one, where that is not half of the sampling rate, |L| must stay below 1 with a G that is no
larger. All else is UNDECIDED.

That the response does between its frequencies what they suggest is not proved, so no answer is.

The walls of a line, start + t along, at which 1 + L is 0 have t = -(1/G + C_start)/C_along, C = K P
+ B V: where the polygon of these values crosses the real axis. Between two of them some walls are
judged, and the ends are halved down to where the judgement changes; ``error`` of an end is how far
behind it a wall is called unstable.
"""

from functools import partial
from math import inf, nan, pi
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64, Int8

from jaxstab.arrays import Array, Numbers, named
from jaxstab.conventions import Code, Verdict
from jaxstab.exact.line import End, Interval, LineStatus, StableLine
from jaxstab.loop.margins import AtFrequency, FrequencyMargins
from jaxstab.loop.region import WallLimits
from jaxstab.model import LoopParameters
from jaxstab.model.device.discrete import MeasuredResponse
from jaxstab.model.filters import NO_FILTERS, known_filters
from jaxstab.model.plant import wall_grid
from jaxstab.numbers import without_noise
from jaxstab.region import RegionStatus
from jaxstab.region.closed_form import responses_at

_FULL = 0.98  # of half of the sampling rate: a response up to there has no rest
_WHOLE = 1e-9  # of a sample
_SHARES = np.array([1e-3, 0.01, 0.05, 0.15, 0.3, 0.5, 0.7, 0.85, 0.95, 0.99, 0.999])
_HALVINGS = 40  # of a gap between walls that were tried
_GAPS = 6  # that gains are turned up through to a limit

Values = Complex128[np.ndarray, " frequency"]
Wall = Float64[np.ndarray, "2"]
Places = Float64[np.ndarray, "..."]


class MeasuredVerdict(Code):
    """A verdict from measured data, not proved; its numbers are those of ``Verdict``.

    UNDECIDED: the data do not tell, by their error or because frequencies are missing.

    Example:
        >>> jaxstab.results.MeasuredVerdict(3)
        <MeasuredVerdict.UNDECIDED: 3>
    """

    STABLE = 1
    UNSTABLE = 2
    UNDECIDED = 3


class MeasuredMargins(FrequencyMargins):
    """The margins of ``FrequencyMargins``, from measured data; errors are NaN, they are not known.

    With an ``error`` of the response they are those of the worst response within it, where log L
    goes straight from one frequency to the next: with few frequencies next to a crossing, margins
    may be a little too large.

    Example:
        >>> hertz = np.linspace(1.0, 500.0, 500)
        >>> held = 1.0 / (300.0 + 5.0 * 2j * np.pi * hertz - 0.25 * (2.0 * np.pi * hertz) ** 2)
        >>> late = held * np.exp(-2j * np.pi * hertz * 1.5e-3)
        >>> device = jaxstab.Device.from_response(hertz, late)
        >>> loop = jaxstab.HapticLoop(device=device, sample_time=1e-3)
        >>> print(loop.frequency_margins(1000.0, 5.0))
        Frequency margins: stable                         at
        least gain factor               0
        gain margin                     29.825 (29.4 dB)  107 Hz
        phase margin (degrees)          33.175            11.55 Hz
        delay margin (s)                0.0079787         11.55 Hz
        peak sensitivity                1.8905            13 Hz
        peak complementary sensitivity  1.774             11 Hz
        disk margin                     0.58925           12 Hz
        from measured data, not proved
    """

    __slots__ = ()

    def __repr__(self) -> str:
        return f"{super().__repr__()}\nfrom measured data, not proved"


class MeasuredLoop(NamedTuple):
    """A loop at the frequencies of its device's response, in Hz: its response, error, P and V.

    ``order`` is r, ``resting`` the K at which the loop leaves rest; ``most`` are the largest |P|
    and |V| above the last frequency, 0 where nothing is missing there.
    """

    frequency: Float64[np.ndarray, " frequency"]
    response: Values
    error: Float64[np.ndarray, " frequency"]
    filters: tuple[Values, Values]
    order: int
    resting: float
    most: tuple[float, float]

    @classmethod
    def from_loop(cls, loop: LoopParameters, device: MeasuredResponse) -> "MeasuredLoop":
        """The loop of a measured device; ValueError if their sampling differs."""
        period, delay = float(loop.sample_time), float(loop.delay_samples)
        hertz, response, error = map(np.array, (device.frequency, device.response, device.error))
        half = 0.5 / period
        if hertz[-1] > half * (1.0 + _WHOLE) or abs(delay - round(delay)) > _WHOLE:
            raise ValueError(
                f"the response reaches {hertz[-1]:g} Hz and the delay beside it is {delay:g} "
                f"samples; give frequencies up to half of the sampling rate, {half:g} Hz, and a "
                "delay of whole samples."
            )
        points = np.concatenate([hertz, [0.0], np.linspace(hertz[-1], half, 64)])
        filters = known_filters(**loop.filters) or NO_FILTERS
        smooth, rates = responses_at(filters, 2.0 * pi * period * points)
        order = int(np.argmax((response[0] * 1j ** np.arange(3)).real))
        count, is_full = len(hertz), hertz[-1] >= _FULL * half
        sizes = [0.0 if is_full else float(abs(own[count:]).max()) for own in (smooth, rates)]
        rest = 0.0 if order else -1.0 / abs(response[0])
        return cls(
            hertz,
            response * np.exp(-2j * pi * period * round(delay) * hertz),
            error,
            (smooth[:count], rates[:count] / period),
            order,
            float(rest / smooth[count].real),
            (sizes[0], sizes[1] / period),
        )

    def opened(self, walls: Float64[np.ndarray, "wall 2"]) -> Complex128[np.ndarray, "wall point"]:
        """L of some walls."""
        return (walls @ np.array(self.filters)) * self.response

    def codes(self, walls: Float64[np.ndarray, "wall 2"]) -> Int8[np.ndarray, " wall"]:
        """Verdicts on some walls, block by block."""
        blocks = np.array_split(walls, 1 + walls.shape[0] * len(self.frequency) // 2_000_000)
        return np.concatenate([self._codes(block) for block in blocks])

    def _codes(self, walls: Float64[np.ndarray, "wall 2"]) -> Int8[np.ndarray, " wall"]:
        opened = self.opened(walls)
        below, size = 1.0 + opened, abs(opened)
        wrong, more = np.arcsin(self.error), self.error * size
        turned = abs(np.angle(self.response[1:] / self.response[:-1])) + wrong[1:] + wrong[:-1]
        across = abs(np.diff(opened)) + more[:, 1:] + more[:, :-1]
        is_passed = (turned >= 0.5 * pi) & (across >= np.sin(np.minimum(turned, pi)))
        with np.errstate(all="ignore"):
            spread = np.arcsin(np.minimum(self.error * size / abs(below), 1.0))
            steps = np.angle(below[:, 1:] / below[:, :-1])
            quarter = 0.5 * pi * self.order
            lag = np.angle(self.response[0] * np.exp(1j * quarter)) - quarter
            control = np.angle(opened[:, 0] / self.response[0])
            first = lag + control + np.angle(below[:, 0] / opened[:, 0])
        is_known = size[:, 0] * (1.0 - self.error[0]) > 1.0
        if not self.order:
            near = np.angle(below[:, 0])
            first = np.where(is_known, first, near)
            is_known |= abs(near) + spread[:, 0] < 0.5 * pi
        half_turns = (first + steps.sum(axis=1)) / pi
        count = np.rint(half_turns)
        last = pi * abs(half_turns - count) + spread[:, -1]
        widest = np.max(abs(steps) + spread[:, 1:] + spread[:, :-1], axis=1)
        rest = abs(walls) @ self.most * abs(self.response[-1]) * (1.0 + self.error[-1])
        is_known &= (np.maximum(widest, last) < 0.5 * pi) & (rest < 1.0)
        is_known &= ~is_passed.any(axis=1)
        is_known &= walls[:, 0] > self.resting
        codes = np.where(count == 0.0, Verdict.STABLE, Verdict.UNSTABLE)
        return np.where(is_known, codes, Verdict.UNDECIDED).astype(np.int8)

    def verdict(self, stiffness: Numbers, damping: Numbers) -> Int8[Array, "*grid"]:
        """Codes of walls, as ``HapticLoop.verdict``."""
        grid = wall_grid(stiffness=stiffness, damping=damping)
        codes = self.codes(grid.reshape(-1, 2)).reshape(grid.shape[:-1])
        return named(codes, MeasuredVerdict)

    def line(
        self, start: tuple[float, float], along: tuple[float, float], *also: float
    ) -> StableLine:
        """The stable walls of a line, as ``exact.stable_line``; some t are tried also."""
        origin, way = np.array(start), np.array(along)
        tried, codes = self._tried(origin, way, also=also)
        last = partial(self._last, origin, way)

        def end(k: int, step: int) -> End:
            """The end of the stable walls on one side of a tried one."""
            if not 0 <= k + step < len(tried):
                return End(step * inf, 0.0, nan)
            found = last(Verdict.STABLE, tried[k], tried[k + step])
            value = float(without_noise(found, abs(tried[k] - tried[k + step])))
            bad = np.flatnonzero(codes[k::step] == Verdict.UNSTABLE)
            if not len(bad):
                return End(value, inf, nan)
            unstable = last(Verdict.UNSTABLE, tried[k + step * bad[0]], value)
            return End(value, abs(unstable - value), nan)

        edges = np.flatnonzero(np.diff(np.pad(codes == Verdict.STABLE, 1))).reshape(-1, 2)
        found = [Interval(end(k, -1), end(j - 1, 1)) for k, j in edges.tolist()]
        return StableLine(tuple(found), (), 0, inf, LineStatus.MEASURED, 0)

    def _crossings(self, origin: Wall, way: Wall) -> Places:
        """The t at which 1 + L is 0, and 0, from the least to the largest."""
        with np.errstate(all="ignore"):
            both = np.array(self.filters)
            values = -(1.0 / self.response + origin @ both) / (way @ both)
            now, after = values[:-1], values[1:]
            share = now.imag / (now.imag - after.imag)
            crossed = now.real + share * (after.real - now.real)
            crossed = crossed[(share >= 0.0) & (share <= 1.0)]
            extra = [0.0, values[-1].real, (self.resting - origin[0]) / way[0]]
        found = np.concatenate([crossed, extra])
        return np.unique(found[np.isfinite(found)])

    def _tried(
        self, origin: Wall, way: Wall, most: int | None = None, also: Any = ()
    ) -> tuple[Places, Any]:
        """Some t and their verdicts; of the first ``most`` gaps above 0, or of all of the line."""
        places = self._crossings(origin, way)
        if most:
            places = np.append(0.0, places[places > 0.0])[: most + 1]
        wide = float(np.max(abs(places), initial=1e-300))
        gaps = places[:-1, None] + np.diff(places)[:, None] * (_SHARES[1::2] if most else _SHARES)
        beyond = wide * np.array([1e-3, 0.1, 1.0])
        below: Any = [] if most else places[:1] - beyond[::-1]
        tried = np.unique(np.concatenate([below, gaps.ravel(), places[-1:] + beyond, also]))
        return tried, self.codes(origin + tried[:, None] * way)

    def _last(self, origin: Wall, way: Wall, code: Verdict, inside: Any, outside: Any) -> float:
        """The last t, from one inside towards one outside, whose wall still has a verdict."""
        for _ in range(_HALVINGS):
            middle = 0.5 * (inside + outside)
            is_so = self.codes((origin + middle * way)[None])[0] == code
            inside, outside = (middle, outside) if is_so else (inside, middle)
        return float(inside)

    def limits(self) -> WallLimits:
        """The stiffest and the most damped wall that is reached by turning both gains up."""
        from scipy.optimize import minimize_scalar

        ratios: Any = np.log(np.geomspace(0.1, 1e6, 32) / (2.0 * pi * self.frequency[-1]))
        walls = np.array([self._reached(ratio) for ratio in ratios])
        found = []
        for axis in (0, 1):
            best = int(np.argmax(walls[:, axis]))
            if np.isinf(walls[best, axis]):
                found.append(walls[best])
                continue
            ends = ratios[np.clip([best - 1, best + 1], 0, len(ratios) - 1)]

            def less(ratio: float, axis: int = axis) -> float:
                return -float(self._reached(ratio)[axis])

            near = self._reached(minimize_scalar(less, bounds=ends, options={"maxiter": 16}).x)
            found.append(max(near, walls[best], key=lambda wall: wall[axis]))
        if not found[0][0] > 0.0:
            return WallLimits(nan, nan, nan, nan, RegionStatus.MEASURED, is_reachable=False)
        (stiffest, beside), (at, damped) = np.array(found).tolist()
        return WallLimits(stiffest, beside, damped, at, RegionStatus.MEASURED, is_reachable=True)

    def _reached(self, ratio: Any) -> Wall:
        """The last wall (K, B) with log(B/K) = ratio of the first stable ones; 0 if none is."""
        origin, way = np.zeros(2), np.array([1.0, np.exp(ratio)])
        tried, codes = self._tried(origin, way, _GAPS)
        stable = np.flatnonzero(codes == Verdict.STABLE)
        if not len(stable) or np.any(codes[: stable[0]] == Verdict.UNSTABLE):
            return origin
        other = np.flatnonzero(codes[stable[0] :] != Verdict.STABLE) + stable[0]
        if not len(other):
            is_all = np.sum(self._crossings(origin, way) > 0.0) <= _GAPS
            return way * (inf if is_all else tried[-1])
        return way * self._last(origin, way, Verdict.STABLE, *tried[other[0] - 1 : other[0] + 1])

    def frequency_margins(self, stiffness: Numbers, damping: Numbers) -> MeasuredMargins:
        """The margins of walls, as ``HapticLoop.frequency_margins``."""
        grid = wall_grid(stiffness=stiffness, damping=damping)
        codes = self.codes(grid.reshape(-1, 2))
        found = np.full((7, 3, codes.size), nan)  # values, errors and frequencies
        for k in np.flatnonzero(codes == Verdict.STABLE):
            found[:, ::2, k] = self._margins(grid.reshape(-1, 2)[k])
        rows = found.reshape(7, 3, *grid.shape[:-1])
        verdicts = named(codes.reshape(grid.shape[:-1]), MeasuredVerdict)
        return MeasuredMargins(verdicts, *(AtFrequency(*own) for own in rows))

    def _margins(self, wall: Wall) -> list[tuple[float, float]]:
        (opened,), hertz = self.opened(wall[None]), self.frequency
        more, size = self.error * abs(opened), abs(opened)
        line = self.line((0.0, 0.0), (float(wall[0]), float(wall[1])), 1.0)
        low, high = next(x for x in line.intervals if x.low.value <= 1.0 <= x.high.value)
        below = np.maximum(abs(1.0 + opened) - more, 0.0)
        with np.errstate(all="ignore"):
            peaks = 1.0 / below, (size + more) / below, 2.0 * below / (abs(1.0 - opened) + more)
        lags, spread, places = self._at_one(opened)
        least = _least(np.degrees(np.minimum(lags, 2.0 * pi - lags) - spread), places)
        delay = _least((lags - spread) / (2.0 * pi * places), places)
        tops = [(float(own[k]), float(hertz[k])) for own in peaks[:2] for k in [np.argmax(own)]]
        ends = [(end.value, nan) for end in (low, high)]
        for k, (factor, _) in enumerate(ends):
            if np.isfinite(factor):
                ends[k] = factor, float(hertz[np.argmin(abs(1.0 + factor * opened))])
        return [*ends, least, delay, *tops, _least(peaks[2], hertz)]

    def _at_one(self, opened: Values) -> tuple[Places, Places, Places]:
        """Where |L| may be 1: by how much L leads -1, by how much it may lag more, and where.

        The disc of radius e r around L, r = |L|, meets the circle at angles from that of L with the
        cosine (1/r + r (1 - e^2))/2: first at r (1 + e) = 1, widest at r^2 (1 - e^2) = 1. There, at
        r = 1 and in steps of a 16th of a frequency they are taken; log L goes straight from one
        frequency to the next.
        """
        with np.errstate(all="ignore"):
            logs, sides = np.log(opened), (np.log1p(self.error), np.log1p(-self.error))
            turned = np.log(opened[1:] / opened[:-1])
            ways = [logs.real + own for own in (0.0, *sides, 0.5 * (sides[0] + sides[1]))]
            shares = np.array([own[:-1] / (own[:-1] - own[1:]) for own in ways])
        at, parts, last = np.nonzero((shares >= 0.0) & (shares < 1.0)), 16, len(opened) - 2
        index = np.concatenate([at[1], np.repeat(np.arange(last + 1), parts), [last]])
        share = np.concatenate([shares[at], np.tile(np.arange(parts) / parts, last + 1), [1.0]])
        point = logs[index] + share * turned[index]
        error, places = (
            own[index] + share * (own[index + 1] - own[index])
            for own in (self.error, self.frequency)
        )
        size, close = np.exp(point.real), 1e-12
        cosine = 0.5 * (1.0 / size + size * (1.0 - error**2))
        meets = cosine < 1.0 + close
        lags = (point.imag + pi) % (2.0 * pi)
        return lags[meets], np.arccos(np.clip(cosine, -1.0, 1.0))[meets], places[meets]


def measured(loop: LoopParameters) -> MeasuredLoop | None:
    """The loop of a measured device, in numbers; None for one that has a model."""
    if loop.device is None or not isinstance(loop.device.mechanism, MeasuredResponse):
        return None
    return MeasuredLoop.from_loop(loop.in_floats(), loop.device.mechanism)


def _least(values: Places, places: Places) -> tuple[float, float]:
    """The least of some values and its place; infinite if there is none."""
    return min(zip(values.tolist(), places.tolist(), strict=True), default=(inf, nan))
