"""Usable gains: those with a margin of phase, gain or delay, or a bound on the peak of |S|.

A pair of gains is judged by its proved margins (lemma E5), a row of one gain by the proof of whole
intervals (E7, ``exact.usable``). The largest gain with the margins is searched: the uppermost
usable gain of some rows, then Brent's search between the best of them. The pair that is found is
proved, in the digits that are printed; that none is larger is not.
"""

from collections.abc import Callable, Sequence
from functools import partial
from math import inf, isfinite, nan
from typing import Any, NamedTuple

import numpy as np

from jaxstab.conventions import Verdict
from jaxstab.exact.line import LineStatus, StableLine
from jaxstab.exact.margins import Reading
from jaxstab.exact.usable import Judgement, Row, RowScan, RowSearch, Wish, judged
from jaxstab.loop.gains import by_gain
from jaxstab.loop.margins import delay_reading
from jaxstab.loop.wanted import WantedMargins
from jaxstab.model.device.parts import remembered
from jaxstab.model.gain import Gain
from jaxstab.shown import number_text, stable_pair


class UsableLimits(NamedTuple):
    """The largest usable value of each gain, as far as a search finds it; NaN if none is usable.

    Each pair is proved to have the margins with the digits that are printed. That no usable pair
    has a larger gain is searched, not proved. Gains are >= 0. Each value has a name of the gains,
    too, as in ``Limits``: ``stiffness`` and ``at_damping`` of a wall.

    Attributes:
        first: the largest value found of the first gain.
        at_second: the second gain there.
        second, at_first: the same of the second gain.
        wanted: the margins in words.
        names: those of the gains, and their units.
        attained: where no gains have them, the margins in words that some have.

    Example:
        >>> limits = jaxstab.simulated_pd(0.1, step=2e-3, substeps=4).limits(sensitivity=1.5)
        >>> limits
        UsableLimits: a peak of |S| of 1.5 at most
          largest kp = 383.099 N m/rad at kd = 7.63745 N m s/rad
          largest kd = 8.3333... N m s/rad at kp = ...
        >>> limits.kp == limits.first, limits.at_kd == limits.at_second
        (True, True)
    """

    first: float
    at_second: float
    second: float
    at_first: float
    wanted: str
    names: tuple[Gain, Gain]
    attained: str = ""

    def __getattr__(self, name: str) -> float:
        """The largest value of a gain, or the gain at that of the other one, by its name."""
        one, two = (gain.name for gain in self.names)
        values = one, f"at_{two}", two, f"at_{one}"
        value: float = by_gain(self, name, dict(zip(values, self[:4], strict=True)))
        return value

    @property
    def none_in_words(self) -> str:
        """That no gains have the margins, and which ones some have.

        Example:
            >>> device = jaxstab.HapticLoop(
            ...     device_mass=0.25, device_damping=0.1, sample_time=1e-3, delay=1e-3
            ... )
            >>> jaxstab.pid(device, kd=50.0).limits(sensitivity=1.05).none_in_words
            'no gains with a peak of |S| of 1.05 at most were found; some have a peak of |S| of ...'
        """
        some = f"; some have {self.attained}" if self.attained else ""
        return f"no gains with {self.wanted} were found{some}"

    def __repr__(self) -> str:
        if not isfinite(self.first) and not isfinite(self.second):
            return f"UsableLimits: {self.none_in_words}"
        lines = [f"UsableLimits: {self.wanted}"]
        one, two = self.names
        of_each = (one, self.first, two, self.at_second), (two, self.second, one, self.at_first)
        for own, largest, other, at in of_each:
            value = number_text(largest, 6, unit=own.unit)
            lines.append(
                f"  largest {own.name} = {value} at {other.name} = "
                f"{number_text(at, 6, unit=other.unit)}"
            )
        return "\n".join(lines)


def judgement(loop: Any, pair: tuple[float, float], wanted: WantedMargins) -> Judgement:
    """The judgement on a pair of gains: one that is not proved stable has no margins."""
    verdict = loop._verdict(*pair)
    if verdict != Verdict.STABLE:
        return Judgement(False if verdict == Verdict.UNSTABLE else None, {})
    delay = partial(delay_reading, loop._held, *pair) if loop._held else None
    return judged(partial(loop._opened, *pair), wanted.wish(loop.sample_time), delay)


def missed_margins(loop: Any, pair: tuple[float, float], wanted: WantedMargins) -> list[str] | None:
    """The margins in words that a stable pair of gains misses; None where that is not told."""
    names = {"phase": "phase_margin", "delay": "delay_margin", "sensitivity": "sensitivity"}
    found = judgement(loop, pair, wanted)
    if found.is_usable is None:
        return None
    missed = [names.get(name, "gain_margin") for name in found.missed]
    return [wanted.texts[name] for name in dict.fromkeys(missed)]


class LikelyUsable:
    """Which stable walls seem usable, in float64: a scan over angles that learns where it erred."""

    def __init__(self, loop: Any, wanted: WantedMargins) -> None:
        self.loop, self.wanted = loop, wanted
        wish, more = wanted.wish(loop.sample_time), 1.0 + 1e-6  # a little to spare
        low, high = wish.gain
        spare = Wish(
            wish.phase * more,
            wish.gain if high == 1.0 else (low / more, high * more),
            1.0 + (wish.sensitivity - 1.0) / more,
            wish.delay * more,
        )
        self._scan = RowScan(_row(loop, (1.0, 0.0), (0.0, 1.0)), spare)

    def __call__(self, stiffness: np.ndarray, damping: np.ndarray) -> np.ndarray:
        """True where no margin is missed at an angle of the scan."""
        pairs = zip(damping.tolist(), stiffness.tolist(), strict=True)
        return np.array([not self._scan.missed(*pair) for pair in pairs], bool)

    def confirms(self, stiffness: float, damping: float) -> bool:
        """True if a wall is proved usable; else the scan learns the angles of what it misses."""
        found = judgement(self.loop, (stiffness, damping), self.wanted)
        for angle in found.angles.values():
            self._scan.learn(angle)
        return bool(found.is_usable)


def usable_line(
    loop: Any, start: tuple[float, float], along: tuple[float, float], wanted: WantedMargins
) -> StableLine:
    """The usable gains start + t along, with the crossings of the stable ones."""
    if wanted.delay_margin is not None:
        raise ValueError(
            f"delay_margin is {wanted.delay_margin:g}, which is not proved for whole intervals; "
            "ask limits, or is_usable for one pair."
        )
    line = loop._line(start, along)
    found = _search(loop, start, along, wanted).intervals(line)
    is_known = line.status == LineStatus.PROVED
    return line._replace(
        intervals=tuple(found), status=LineStatus.USABLE if is_known else line.status
    )


def _search(
    loop: Any,
    start: tuple[float, float],
    along: tuple[float, float],
    wanted: WantedMargins,
    angles: Any = None,
) -> RowSearch:
    if loop._only_few:
        names = " and ".join(gain.name for gain in loop.gains)
        raise ValueError(
            f"{names} move the leading coefficient of p(z), so that the open loop is not affine in "
            "them; margins of whole rows and limits with margins are not available, ask is_usable "
            "for one pair."
        )

    def delay(t: float) -> Reading:
        return delay_reading(loop._held, *_pair(start, along, t))

    row, wish = _row(loop, start, along), wanted.wish(loop.sample_time)
    return RowSearch(row, wish, delay if loop._held else None, angles)


def _row(loop: Any, start: tuple[float, float], along: tuple[float, float]) -> Callable[[], Row]:
    """The open loops of the gains start + t along, in the precision that is set."""

    @remembered()
    def row() -> Row:
        (below, given), (_, first), (_, step) = (
            loop._opened(*own) for own in ((0.0, 0.0), start, along)
        )
        return Row(below, first, step if given.is_zero else step.plus(given.scaled(-1)))

    return row


def _pair(start: tuple[float, float], along: tuple[float, float], t: float) -> tuple[float, float]:
    return start[0] + t * along[0], start[1] + t * along[1]


# -------------------------------------------------------------------------------------- the largest
_ROWS = 9  # on a scale of numbers, and fewer on one of logarithms
_MANY = 65  # where these find nothing
_PEAKS = 2  # that are searched


def usable_limits(loop: Any, wanted: WantedMargins) -> UsableLimits:
    """The largest usable gains of the component that holds small gains, or of all."""
    region = loop.region()
    main = region.main or region
    if not main.components:
        return UsableLimits(nan, nan, nan, nan, wanted.words, loop.gains)
    first, second = (_Tops(loop, axis, main, wanted) for axis in (0, 1))
    found = first.largest()
    places = [found[0] * 10.0**-k for k in range(3)] if isfinite(found[0]) else []
    limits = UsableLimits(*found, *second.largest(places), wanted.words, loop.gains)
    if isfinite(limits.first) or isfinite(limits.second):
        return limits
    return limits._replace(attained=_attained(loop, main, wanted))


def _attained(loop: Any, main: Any, wanted: WantedMargins) -> str:
    """Nearly the largest share of some margins that gains have, in words; "" if none is found."""
    low, high, best = 0.0, 1.0, ""
    while high - low > 1.0 / 64.0:
        eased = wanted.eased(0.5 * (low + high))
        if isfinite(_Tops(loop, 0, main, eased).largest()[0]):
            low, best = 0.5 * (low + high), eased.words
        else:
            high = 0.5 * (low + high)
    return best


class _Tops:
    """The uppermost gains of an axis that seem usable, over the other gain."""

    def __init__(self, loop: Any, axis: int, main: Any, wanted: WantedMargins) -> None:
        self.loop, self.axis, self.main, self.wanted = loop, axis, main, wanted
        self.is_sure = False
        self.most = float(np.max(main.outline[:, 1 - axis]))
        self.angles = _search(loop, *self.line(0.5 * self.most), wanted).scan.theta

    def line(self, at: float) -> tuple[tuple[float, float], tuple[float, float]]:
        """Where a row starts, and along which gain it goes."""
        return ((0.0, at), (1.0, 0.0)) if self.axis == 0 else ((at, 0.0), (0.0, 1.0))

    def __call__(self, at: float) -> float:
        """The uppermost gain >= 0 of a row; -inf if there is none."""
        start, along = self.line(at)
        line, search = self.loop._line(start, along), None
        for low, high in reversed(line.intervals if not line.drift else ()):
            least = max(low.value, 0.0)
            if not least < high.value < inf or not self.holds(0.5 * (least + high.value), at):
                continue
            search = search or _search(self.loop, start, along, self.wanted, self.angles)
            place = search.walked(high, -1, least, is_sure=self.is_sure)
            if place:
                return place.inner
        return -inf

    def holds(self, value: float, at: float) -> bool:
        """True if the component holds a pair."""
        pair = zip((gain.name for gain in self.loop.gains), self.pair(value, at), strict=True)
        return bool(self.main.contains(**dict(pair)))

    def pair(self, value: float, at: float) -> tuple[float, float]:
        """Both gains, in the order of the loop."""
        return (value, at) if self.axis == 0 else (at, value)

    def largest(self, places: Sequence[float] = ()) -> tuple[float, float]:
        """The largest gain that is found, and proved, and the other one there.

        Some ``places`` of the other one are tried first.
        """
        most = self.most
        tried = np.r_[np.geomspace(1e-3 * most, 0.1 * most, 4), np.linspace(0.0, most, _ROWS)]
        tried = np.r_[places, tried]
        many = np.linspace(0.0, most, _MANY)  # a small set may lie between the rows
        # E5 is asked in every row where the scan misses angles.
        for self.is_sure, rows in ((False, tried), (True, tried), (False, many)):
            value, at = _best(self, np.unique(rows).tolist())
            for back in (0.0, 1e-9, 1e-8, 1e-7) if isfinite(value) else ():
                pair = value * (1.0 - back), at
                if self._is_usable(*pair):
                    return stable_pair(*pair, (6, 6), self._is_usable)
        return nan, nan

    def _is_usable(self, value: float, at: float) -> bool:
        return bool(judgement(self.loop, self.pair(value, at), self.wanted).is_usable)


def _best(top: Callable[[float], float], places: list[float]) -> tuple[float, float]:
    """The largest value of a function, from the best of some places on, and where it is."""
    values = [top(place) for place in places]
    last = len(places) - 1
    peaks = [
        k
        for k in sorted(range(last + 1), key=lambda k: -values[k])
        if isfinite(values[k]) and values[k] >= max(values[max(k - 1, 0)], values[min(k + 1, last)])
    ]
    found = [(-inf, 0.0)]
    for k in peaks[:_PEAKS]:
        if values[k] > 0.5 * values[peaks[0]]:
            ends = places[max(k - 1, 0)], places[min(k + 1, last)]
            found.append(_climbed(top, ends, places[k], values[k]))
    return max(found)


def _climbed(
    top: Callable[[float], float], ends: tuple[float, float], x: float, value: float
) -> tuple[float, float]:
    """Brent's search for a maximum between two places, from one between them on."""
    most, share, close = 60, 0.3819660112501051, 1e-8
    a, c = ends
    short = 1e-6 * (c - a)
    w, v, at_w, at_v = x, x, value, value
    step = before = 0.0
    for _ in range(most):
        middle, least = 0.5 * (a + c), close * abs(x) + short
        if abs(x - middle) <= 2.0 * least - 0.5 * (c - a):
            break
        r, q = (x - w) * (value - at_v), (x - v) * (value - at_w)
        p, q = (x - v) * q - (x - w) * r, 2.0 * (q - r)
        p, q = (-p, q) if q > 0.0 else (p, -q)
        is_parabola = abs(p) < abs(0.5 * q * before) and q * (a - x) < p < q * (c - x)
        if is_parabola:
            before, step = step, p / q
        else:
            before = (a if x >= middle else c) - x
            step = share * before
        u = x + (step if abs(step) >= least else least if step > 0.0 else -least)
        at_u = top(u)
        if at_u >= value:
            a, c = (x, c) if u >= x else (a, x)
            v, at_v, w, at_w, x, value = w, at_w, x, value, u, at_u
        else:
            a, c = (u, c) if u < x else (a, u)
            if at_u >= at_w or w == x:
                v, at_v, w, at_w = w, at_w, u, at_u
            elif at_u >= at_v or v in (x, w):
                v, at_v = u, at_u
    return value, x
