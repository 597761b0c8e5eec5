"""E7. Gains with margins: pairs that stay stable while the open loop is turned and scaled.

With L = W/D opened at its force, W = W0 + t W1 on a row of gains t, a wish is a set of factors w
that holds 1: a pair is usable if D + w W is stable for all of them. Of the phase they are an arc
|arg w| <= phi, of the gain a segment from l to g, of |S| <= Ms a disk. A pair is judged by its
margins (E5). All t of an interval are usable if one is stable and, for all t and on the whole
circle,

    |S|:    Ms^2 |D + W|^2 - |D|^2 > 0,
    phase:  Re(W conj D) + cos(phi) |W|^2 + m (|D|^2 - |W|^2) > 0,
    gain:   |D|^2 + (l + g) Re(W conj D) + l g |W|^2 + m Im(W conj D) > 0,

m any real function of the angle (lemma E7): where D + w W = 0 with |w| = 1, or with a real w, what
m multiplies is 0, and the rest says that w is not in the set. With m = a + b cos(theta), times
sin(theta) for the gain, each left side is a cosine sum whose coefficients are quadratic in t. Where
all three of its coefficients in the basis of Bernstein are positive (``circle``), it is positive
for all t of an interval; else the interval is halved. The numbers a and b are only suggested, in
float64: by the bounds that the inequality sets to m at some angles.

The ends of a row are found by exchange, from the ends of its stable intervals inwards. Where a t is
not usable, E5 tells at which angle. There the t that miss the wish are known in closed form, and
over the run of neighbouring angles at which they do they fill an interval: it is left out, and the
t beside it is judged next. Angles and runs are float64; an end is where E5 says yes next to it.
"""

from collections.abc import Callable
from functools import partial
from math import inf, isfinite, nan, pi, ulp
from typing import Any, NamedTuple

import numpy as np
from flint import arb, arb_poly
from jaxtyping import Float64

from jaxstab.exact.circle import is_positive
from jaxstab.exact.floats import FloatValues, highest
from jaxstab.exact.line import End, Interval, StableLine
from jaxstab.exact.margins import Reading, readings
from jaxstab.model.balls import Factored
from jaxstab.model.device.parts import FIRST_BITS, decided, working_precision

_BACK = 1e-9  # of a stable interval: how far within an end E5 says yes
_MOST_BOXES = 200  # of an interval
_MOST_CUTS = 30  # from one end

Opened = Callable[[], tuple[Factored, Factored]]


class Wish(NamedTuple):
    """Margins that a pair of gains shall have: those with their default are not asked for.

    Attributes:
        phase: in rad.
        gain: the least and the largest factor of the open loop, <= 1 and >= 1.
        sensitivity: the peak of |S|, > 1.
        delay: in samples.
    """

    phase: float = 0.0
    gain: tuple[float, float] = (1.0, 1.0)
    sensitivity: float = inf
    delay: float = 0.0

    @property
    def limits(self) -> dict[str, tuple[float, int]]:
        """What each reading that is asked for must be, and on which side of it."""
        every = {
            "sensitivity": (self.sensitivity, -1, inf),
            "phase": (self.phase, 1, 0.0),
            "delay": (self.delay, 1, 0.0),
            "largest_gain": (self.gain[1], 1, 1.0),
            "least_gain": (self.gain[0], -1, 1.0),
        }
        return {name: (limit, side) for name, (limit, side, none) in every.items() if limit != none}


class Judgement(NamedTuple):
    """Whether a pair is usable, None if that is not proved, and the margins that it misses."""

    is_usable: bool | None
    missed: dict[str, Reading]

    @property
    def angles(self) -> dict[str, float]:
        """Where they are missed, by the names of ``RowScan``."""
        return {
            "gain" if name.endswith("gain") else name: own.angle
            for name, own in self.missed.items()
        }


def judged(opened: Opened, wish: Wish, delay: Callable[[], Reading] | None = None) -> Judgement:
    """The judgement on a pair of gains that is proved stable, from its D and W.

    ``delay`` reads the margin of the delay, where the loop knows better than whole samples.
    """
    limits = wish.limits
    found = readings(opened, asked=limits.keys())
    if delay and wish.delay:
        found = found._replace(delay=delay())
    answers, missed = list[bool | None](), dict[str, Reading]()
    for name, (limit, side) in limits.items():
        reading = getattr(found, name)
        clear = side * (reading.value - limit)
        answers.append(_is_clear(clear, reading.error))
        if answers[-1] is False:
            missed[name] = reading
    is_usable = False if missed else None if None in answers else True
    return Judgement(is_usable, missed)


def _is_clear(clear: float, error: float) -> bool | None:
    """True if a number is surely positive; one with an infinite error may be larger."""
    if not isfinite(error):
        return True if clear > 0.0 else None
    return True if clear > error else False if clear < -error else None


# --------------------------------------------------------------------------- all t of an interval
class Row(NamedTuple):
    """The open loops (W0 + t W1)/D of a row in balls of the precision that is set."""

    below: Factored
    start: Factored
    along: Factored

    def at(self, t: float) -> tuple[Factored, Factored]:
        """D and W of one t."""
        return self.below, self.start.plus(self.along.scaled(t))


class _Forms(NamedTuple):
    """|D|^2, and Re(W conj D), sin(theta) Im(W conj D) and |W|^2 by their coefficients over t.

    These are three each, in the basis of Bernstein; a form is an array over angles, or the
    ``arb_poly`` of its powers of z from -n to n, times z^n.
    """

    below: Any
    real: list[Any]
    imaginary: list[Any]
    above: list[Any]

    def sums(self, kind: "_Kind") -> "list[tuple[Any, Any]]":
        """What an inequality says without m, and what m multiplies."""
        a, b, c = kind.weights(self.below)
        rest = [a * self.below + b * x + c * y for x, y in zip(self.real, self.above, strict=True)]
        sizes = [self.below - y for y in self.above]
        return [*zip(rest, self.imaginary if kind.name == "gain" else sizes, strict=True)]


class _Kind(NamedTuple):
    """One inequality of a wish."""

    name: str
    numbers: tuple[float, ...]

    @classmethod
    def all_of(cls, wish: Wish) -> "list[_Kind]":
        """Those of a wish; |S| needs no m."""
        kinds = []
        if isfinite(wish.sensitivity):
            kinds.append(cls("sensitivity", (wish.sensitivity,)))
        if wish.phase:
            kinds.append(cls("phase", (wish.phase,)))
        if wish.gain != (1.0, 1.0):
            kinds.append(cls("gain", wish.gain))
        return kinds

    def weights(self, like: Any) -> "tuple[Any, Any, Any]":
        """Of |D|^2, Re(W conj D) and |W|^2, in balls or as numbers."""
        x, *more = map(arb, self.numbers)
        if self.name == "sensitivity":
            a, b, c = x**2 - 1, 2 * x**2, x**2
        elif self.name == "phase":
            a, b, c = arb(0), arb(1), x.cos()
        else:
            a, b, c = arb(1), x + more[0], x * more[0]
        if isinstance(like, arb_poly):
            return a, b, c
        return float(a.mid()), float(b.mid()), float(c.mid())


def _forms_in_balls(row: Row, low: float, high: float) -> tuple[_Forms, int]:
    """The forms of t from low to high, and n."""
    parts = [part.polynomial() for part in row]
    n = max(part.degree() for part in parts) + 1

    def mirrored(p: arb_poly, degree: int) -> arb_poly:
        return arb_poly([p[degree - k] for k in range(degree + 1)])

    (d, w0, w1), half = parts, arb(0.5)
    first, last = w0 + w1 * arb(low), w0 + w1 * arb(high)
    back = mirrored(d, n - 1)
    mixed = [w * back for w in (first, (first + last) * half, last)]
    turned = [(x, mirrored(x, 2 * n - 2)) for x in mixed]
    sine = arb_poly([-0.25, 0, 0.25])  # times i/2
    across = first * mirrored(last, n - 1)
    above = [first * mirrored(first, n - 1), (across + mirrored(across, 2 * n - 2)) * half]
    above.append(last * mirrored(last, n - 1))
    forms = _Forms(
        (d * back).left_shift(1),
        [((x + y) * half).left_shift(1) for x, y in turned],
        [(y - x) * sine for x, y in turned],
        [x.left_shift(1) for x in above],
    )
    return forms, n


class _Multiplier(NamedTuple):
    """m = a + b (1 - cos(theta))/(c + 1 - cos(theta)), c > 0."""

    a: float
    b: float
    c: float


def _is_positive(
    row: Callable[[], Row], kind: _Kind, low: float, high: float, m: _Multiplier
) -> bool:
    """True if the inequality is proved for all t from low to high."""

    def ask() -> bool | None:
        a, b, c = map(arb, m)
        parts = row()
        if not parts.below.degree > max(part.degree for part in parts[1:]):
            return False  # a factor could move the leading coefficient
        forms, n = _forms_in_balls(parts, low, high)
        below = arb_poly([-0.5, c + 1, -0.5])  # m = above/below
        above = below * a + arb_poly([-b / 2, b, -b / 2])
        for rest, turning in forms.sums(kind):
            total = rest * below
            if kind.name != "sensitivity":
                total += turning * above
            cosines = [total[n + 1], *(2 * term for term in total.coeffs()[n + 2 :])]
            if not (holds := is_positive(cosines)):
                return holds
        return True

    return bool(decided(ask, most=4 * FIRST_BITS))


_STEEPEST = 100.0
_BENDS = 1e6, 10.0, 1.0, 0.1


@np.errstate(all="ignore")
def _suggested(
    forms: _Forms, kind: _Kind, theta: Float64[np.ndarray, " angle"]
) -> _Multiplier | None:
    """The numbers of m with which an inequality holds at some angles, if any are found.

    Where X m + Y > 0 is asked for, m has the bound -Y/X. Several b and c are tried.
    """
    sums = np.array(forms.sums(kind))
    size = forms.below + np.max(forms.above, axis=0)
    rest, turning = sums[:, 0] / size, sums[:, 1] / size
    if kind.name == "sensitivity":
        return _Multiplier(0.0, 0.0, 1.0) if np.all(rest > 0.0) else None
    share = np.sin(theta) if kind.name == "gain" else 1.0
    place = theta[np.argmin(np.max(np.abs(turning / share) + np.abs(rest), axis=0))]
    far, unit = 2.0 * np.sin(0.5 * theta) ** 2, 2.0 * np.sin(0.5 * place) ** 2
    bound = -rest / turning

    def window(shifted: Any) -> tuple[float, float]:
        low = np.max(shifted, where=turning > 0.0, initial=-inf)
        return low, np.min(shifted, where=turning < 0.0, initial=inf)

    scale = max((abs(end) for end in window(bound) if isfinite(end)), default=1.0) or 1.0
    for bend in _BENDS:
        c = bend * unit
        rise = far / (c + far)
        slope = _highest(
            lambda slope, rise=rise: -np.subtract(*window(bound - slope * rise)),  # type: ignore[misc]
            _STEEPEST * scale * (1.0 + bend),
        )
        low, high = window(bound - slope * rise)
        if low < high:
            low, high = max(low, min(high, 0.0) - scale), min(high, max(low, 0.0) + scale)
            aside = 0.25 * (high - low)
            a = min(max(0.0, low + aside), high - aside)
            return _Multiplier(*map(float, (a, slope, c)))
    return None


def _highest(function: Callable[[float], float], most: float) -> float:
    """Where a concave function is largest, 0 if that is good enough."""
    steps = 40
    return 0.0 if function(0.0) > 0.0 else highest(function, -most, most, steps)[1]


# --------------------------------------------------------------------------------- ends of a row
class RowScan:
    """The t of a row at which a wish is missed, over some angles, in float64."""

    def __init__(self, row: Callable[[], Row], wish: Wish, angles: Any = None) -> None:
        self.wish = wish
        with working_precision(FIRST_BITS):
            parts = row()
            self.sides = [FloatValues(part) for part in parts]
            self.ends = [[float(part.at_end(z).mid()) for part in parts] for z in (1, -1)]
        self.theta = self._angles() if angles is None else angles
        self.values = [side(self.theta) for side in self.sides]

    def _angles(self) -> Float64[np.ndarray, " angle"]:
        """Angles on scales of their own next to 0, pi and roots."""
        angles = [np.geomspace(1e-9, 1e-3, 60), np.geomspace(1e-3, pi, 400)]
        angles += [np.linspace(0.0, pi, 300), pi - np.geomspace(1e-6, 0.1, 60)]
        angles += [own for side in self.sides for own in side.angles()]
        every = np.unique(np.concatenate(angles))
        return every[(every > 0.0) & (every < pi * (1.0 - 1e-9))]

    def learn(self, angle: float) -> None:
        """Add angles next to one, unless it is NaN."""
        aside = np.r_[0.0, np.geomspace(1e-10, 1e-2, 33)]
        new = np.setdiff1d(angle * np.r_[1.0 + aside, 1.0 - aside], self.theta)
        new = new[(new > 0.0) & (new < pi)]
        order = np.argsort(theta := np.r_[self.theta, new])
        self.theta = theta[order]
        self.values = [
            np.r_[old, side(new)][order] for old, side in zip(self.values, self.sides, strict=True)
        ]

    def forms(self, low: float, high: float) -> _Forms:
        """The forms for t from low to high."""
        d, w0, w1 = self.values
        first, last = w0 + low * w1, w0 + high * w1
        mixed = np.stack([first, 0.5 * (first + last), last]) * np.conj(d)
        above = [np.abs(first) ** 2, (first * np.conj(last)).real, np.abs(last) ** 2]
        imaginary = [*(mixed.imag * np.sin(self.theta))]
        return _Forms(np.abs(d) ** 2, [*mixed.real], imaginary, above)

    @np.errstate(all="ignore")
    def missed(self, t: float, share: float = 1.0) -> dict[str, float]:
        """The margins that one t surely misses, each with an angle; there may be others.

        With a ``share`` they are those of that share of W0.
        """
        (d, w0, w1), found, limits = self.values, dict[str, float](), self.wish.limits
        w = share * w0 + t * w1
        at_ends = [(share * own[1] + t * own[2]) / own[0] if own[0] else nan for own in self.ends]
        if "sensitivity" in limits:
            distance = np.r_[np.abs(1.0 + w / d), np.abs(1.0 + np.array(at_ends))]
            k = int(np.nanargmin(distance))
            if distance[k] * self.wish.sensitivity < 1.0:
                found["sensitivity"] = float(np.r_[self.theta, 0.0, pi][k])
        if "phase" in limits or "delay" in limits:
            longer = np.abs(w) > np.abs(d)
            crossed = np.flatnonzero(longer[1:] != longer[:-1])
            lag = np.angle(-w[crossed] / d[crossed])
            late = self.wish.delay * self.theta[crossed] - lag % (2.0 * pi)
            for name, more in (("phase", self.wish.phase - np.abs(lag)), ("delay", late)):
                if name in limits and np.max(more, initial=-1.0) > 0.0:
                    found[name] = float(self.theta[crossed[np.argmax(more)]])
        if "least_gain" in limits or "largest_gain" in limits:
            side = (w * np.conj(d)).imag > 0.0
            real = np.flatnonzero(side[1:] != side[:-1])
            factors = -1.0 / np.r_[(w[real] / d[real]).real, at_ends]
            least, most = self.wish.gain
            is_bad = (factors > least) & (factors < most)
            if np.any(is_bad):
                found["gain"] = float(np.r_[self.theta[real], 0.0, pi][np.argmax(is_bad)])
        return found

    @np.errstate(all="ignore")
    def _curves(self, name: str, theta: Any, values: Any, way: int) -> list[tuple[Any, Any]]:
        """The t of a margin at angles, and >= 0 where the wish is missed there.

        With ``way`` they are the last ones in that direction of those that |S| fills.
        """
        d, w0, w1 = values
        m, n = w0 / w1, d / w1
        if name == "sensitivity":
            square = np.abs(n) ** 2 / self.wish.sensitivity**2 - (m + n).imag ** 2
            return [(way * np.sqrt(square) - (m + n).real, square)]
        if name == "gain":
            t = m.imag * n.real / n.imag - m.real
            factor = -1.0 / ((t + m) / n).real  # L = -1/factor
            return [(t, np.minimum(self.wish.gain[1] - factor, factor - self.wish.gain[0]))]
        root, found = np.sqrt(np.abs(n) ** 2 - m.imag**2), []
        for t in (root - m.real, -root - m.real):
            lag = np.angle(-(t + m) / n)
            late = self.wish.delay * theta - lag % (2.0 * pi)
            found.append((t, self.wish.phase - np.abs(lag) if name == "phase" else late))
        return found

    def cut(self, name: str, angle: float, t: float, way: int) -> tuple[float, float]:
        """How far in one direction the t reach that miss a wish, from one t and its angle on.

        It is the last t and its angle.
        """
        if not 0.0 < angle < pi:
            return self._cut_at_end(name, angle, way), angle
        if not np.any(self.theta == angle):
            self.learn(angle)
        here = int(np.searchsorted(self.theta, angle))
        curves = self._curves(name, self.theta, self.values, way)
        near = [abs(own[here] - t) if missed[here] >= -1e-3 else inf for own, missed in curves]
        branch = int(np.argmin(near))
        if not isfinite(near[branch]):
            return t, angle
        own, missed = curves[branch]
        is_bad = (missed >= 0.0) & np.isfinite(own)
        is_bad[here] = True
        free = np.flatnonzero(~is_bad)
        k = int(np.searchsorted(free, here))
        first, last = free[k - 1] + 1 if k else 0, free[k] if k < len(free) else len(own)
        best, zooms = first + int(np.argmax(way * own[first:last])), 12
        theta, reached = self.theta, way * float(own[best])
        for _ in range(zooms):
            theta = np.linspace(theta[max(best - 1, 0)], theta[min(best + 1, len(theta) - 1)], 33)
            values = [side(theta) for side in self.sides]
            own, missed = self._curves(name, theta, values, way)[branch]
            own = np.where((missed >= 0.0) & np.isfinite(own), way * own, -inf)
            best = int(np.argmax(own))
            gained = float(own[best]) - reached
            if gained > 0.0:
                reached, angle = float(own[best]), float(theta[best])
            if not gained > 1e-14 * abs(reached):
                break
        self.learn(angle)
        return way * reached, angle

    def on_ray(self, t: float, way: int) -> float:
        """A stable end, for both gains in proportion that by which a factor leads to it."""
        if np.any(self.values[1]) or self.wish.gain == (1.0, 1.0):
            return t
        return t / self.wish.gain[1 if way * t < 0.0 else 0]

    def _cut_at_end(self, name: str, angle: float, way: int) -> float:
        """The same at z = 1 or -1, where L is real."""
        d, w0, w1 = self.ends[0 if angle == 0.0 else 1]
        if not w1:
            return way * inf
        if name == "sensitivity":
            return -(w0 + d) / w1 + way * abs(d / w1) / self.wish.sensitivity
        factors = self.wish.gain if name == "gain" else (1.0, 1.0)
        return way * max(way * -(w0 + d / factor) / w1 for factor in factors)


# ------------------------------------------------------------------------------------------- rows
class UsableEnd(NamedTuple):
    """An end of usable t, one next to it that is usable, and its angle."""

    end: float
    inner: float
    angle: float


class RowSearch:
    """The usable t of a row, from the ends of its stable intervals inwards."""

    def __init__(
        self,
        row: Callable[[], Row],
        wish: Wish,
        delay: Callable[[float], Reading] | None = None,
        angles: Any = None,
    ) -> None:
        self.row, self.wish, self.delay = row, wish, delay
        self.scan, self.kinds = RowScan(row, wish, angles), _Kind.all_of(wish)

    def intervals(self, line: StableLine) -> list[Interval]:
        """Usable intervals, as far as found, from left to right: all t within errors, proved."""
        found = list[Interval]()
        for low, high in line.intervals if not line.drift else ():
            ends = self.ends(low, high, is_sure=False)
            if ends and self._all_usable(ends[0].inner, ends[1].inner):
                found.append(_interval(*ends))
            elif ends := self.ends(low, high):
                found += self._parts(*ends)
        return found

    def ends(
        self, low: End, high: End, *, is_sure: bool = True
    ) -> tuple[UsableEnd, UsableEnd] | None:
        """The outermost usable t of a stable interval; not ``is_sure`` E5 is not asked."""
        first = self.walked(low, 1, high.value, is_sure=is_sure)
        last = first and self.walked(high, -1, first.inner, is_sure=is_sure)
        return (first, last) if first and last else None

    def walked(
        self, start: End, way: int, stop: float, *, is_sure: bool = True
    ) -> UsableEnd | None:
        """The first usable t from one on in one direction."""
        t, angle = self.scan.on_ray(start.value + way * start.error, way), start.angle
        self.scan.learn(angle)
        least = step = _BACK * abs(stop - t)
        for _ in range(_MOST_CUTS):
            inner = t + way * step
            if not way * (stop - inner) > 0.0:
                return None
            missed = self.scan.missed(inner)
            if not missed:
                found = self.judged(inner) if is_sure else Judgement(is_usable=True, missed={})
                if found.is_usable:
                    return UsableEnd(t, inner, angle)
                missed = found.angles
            t = inner
            for name, place in missed.items():
                reached, at = self.scan.cut(name, place, inner, way)
                if way * (reached - t) > 0.0:
                    t, angle = reached, at
            step = step * 4.0 if t == inner else least
        return None

    def judged(self, t: float) -> Judgement:
        """The judgement on one t of a stable interval."""
        delay = self.delay and partial(self.delay, t)
        return judged(lambda: self.row().at(t), self.wish, delay)

    def _parts(self, first: UsableEnd, last: UsableEnd) -> list[Interval]:
        """Proved intervals between two usable t."""
        todo, done = [(first, last)], list[Interval]()
        shortest = 4.0 * _BACK * (last.inner - first.inner)
        for _ in range(_MOST_BOXES):
            if not todo:
                break
            # The widest first: next to an end proofs may need boxes without end.
            left, right = todo.pop(max(range(len(todo)), key=lambda k: _width(*todo[k])))
            middle = 0.5 * (left.inner + right.inner)
            if self._all_usable(left.inner, right.inner):
                done.append(_interval(left, right))
            elif right.inner - left.inner > shortest:
                found, here = self.judged(middle), End(middle, 0.0, nan)
                if found.is_usable:
                    place = UsableEnd(middle, middle, nan)
                    todo += [(place, right), (left, place)]
                elif found.is_usable is False:
                    below = self.walked(here, -1, left.inner)
                    above = self.walked(here, 1, right.inner)
                    todo += [(above, right)] if above else []
                    todo += [(left, below)] if below else []
        return _joined(done)

    def _all_usable(self, low: float, high: float) -> bool:
        with working_precision(FIRST_BITS):
            forms = self.scan.forms(low, high)
            found = [(kind, _suggested(forms, kind, self.scan.theta)) for kind in self.kinds]
        return all(m is not None for _, m in found) and all(
            _is_positive(self.row, kind, low, high, m) for kind, m in found if m is not None
        )


def _width(low: UsableEnd, high: UsableEnd) -> float:
    return high.inner - low.inner


def _interval(low: UsableEnd, high: UsableEnd) -> Interval:
    first, last = (
        End(end, abs(inner - end) + 2.0 * ulp(max(abs(inner), abs(end))) * (inner != end), angle)
        for end, inner, angle in (low, high)
    )
    return Interval(first, last)


def _joined(parts: list[Interval]) -> list[Interval]:
    """Intervals of which the one begins where the other ends as one."""
    joined: list[Interval] = []
    for part in sorted(parts, key=lambda part: part.low.value):
        if joined and part.low.value == joined[-1].high.value:
            part = Interval(joined.pop().low, part.high)
        joined.append(part)
    return joined
