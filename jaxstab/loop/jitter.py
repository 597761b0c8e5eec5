"""One loop whose delay moves from sample to sample: verdicts, margins, limits and sequences.

A wall is STABLE if the small-gain theorem proves it for every sequence of delays of a range (lemma
J1 of docs/proofs.md), and UNSTABLE if one sequence, constant or in turn, is proved to grow (V10).
Between the two it is UNDECIDED.

Delays in turn that make the motion grow are searched for, and proved to (``growing_turn``). A
sequence of N delays that repeats moves the loop by one matrix per turn
(``jaxstab.exact.turns``); the N-th root of its spectral radius is the growth per sample.
Sequences are searched in float64: first all short patterns of the shortest and the longest delay,
then the best of them are changed one delay at a time as long as they grow faster (hill climbing).
The search does not find the largest growth; what it returns is one sequence, and that its motion
grows is proved in balls.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial, reduce
from itertools import groupby, product, takewhile
from math import ceil, inf, isinf, nan
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Int8

from jaxstab.arrays import Array, Numbers, named
from jaxstab.conventions import Range, Verdict
from jaxstab.exact.margins import SmallGainStatus, largest_jitter, small_gain
from jaxstab.exact.roots import wall_verdict
from jaxstab.exact.turns import TransitionMatrices, is_growing, segments_of
from jaxstab.loop.region import TOLERANCE, Limits, region_of_loop
from jaxstab.model import LoopParameters
from jaxstab.model.balls import ball_loop, ball_triple
from jaxstab.model.device.sampling import late_cosines
from jaxstab.model.plant import LONGEST_DELAY, wall_grid
from jaxstab.numbers import checked_count, checked_number, real_numbers, two_ends
from jaxstab.rounding import EPS
from jaxstab.shown import exact_text, shortened

# ----------------------------------------------------------------------------------- delays in turn
Proved = Callable[[float, float], bool]  # of a wall
Turn = tuple[float, ...]  # of delays in samples; infinite for a sample that is lost

_QUICK, _THOROUGH = 4, 7  # the longest patterns
_LONGEST = 48  # turn of hill climbing


class Delays(NamedTuple):
    """Delays between two, in samples, with at most ``lost`` lost samples in a row."""

    low: float
    high: float
    lost: int = 0

    @classmethod
    def between(cls, low: float, high: float, lost: Any) -> "Delays":
        """Return delays between two; ValueError or TypeError: ``lost`` is no count, or too many."""
        lost = checked_count("lost", lost, 0)
        if high + lost > LONGEST_DELAY:
            raise ValueError(
                f"lost is {lost}, of delays to {high:g} samples; give fewer, up to "
                f"{LONGEST_DELAY:g} samples in all."
            )
        return cls(low, high, lost)

    @property
    def jitter(self) -> float:
        """The range of the delay, rounded up; a lost sample is one sample more."""
        return ((self.high - self.low) * (1.0 + 4.0 * EPS) + self.lost) * (1.0 + EPS)

    def allows(self, turn: Turn) -> bool:
        """True if no more samples in a row are lost, around the turn."""
        if all(map(isinf, turn)):
            return False
        rows = groupby((*turn, *turn), isinf)
        return max((len([*row]) for is_lost, row in rows if is_lost), default=0) <= self.lost


class Growth(NamedTuple):
    """A turn of delays and the growth of its motion per sample, in float64."""

    turn: Turn
    per_sample: float


def growing_turn(
    loop: LoopParameters, wall: tuple[float, float], delays: Delays, *, is_thorough: bool
) -> tuple[Growth, bool]:
    """The turn of the fastest growth that a search found, and whether it is proved to grow."""
    exact = TransitionMatrices.from_loop(loop, *wall)
    search = _TurnSearch(exact.rounded(), delays)
    best = search.patterns(_THOROUGH if is_thorough else _QUICK)
    if is_thorough:
        best = search.climbed(best)
    fastest = best[0]._replace(turn=_once(best[0].turn))
    return fastest, fastest.per_sample > 1.0 and is_growing(exact, fastest.turn)


_segments = lru_cache(maxsize=512)(segments_of)


class _TurnSearch:
    """Turns of one wall, each sample's matrix formed once."""

    def __init__(self, loop: TransitionMatrices, delays: Delays) -> None:
        self.delays = delays
        oldest = ceil(delays.high) + delays.lost  # of the forces that may act, in samples
        self._step = cache(lambda segments: loop.step(segments, oldest))

    def growths(self, turns: Sequence[Turn]) -> list[Growth]:
        """Return the growth of turns."""
        with np.errstate(all="ignore"):
            matrices = np.stack([self._matrix(turn) for turn in turns])
            matrices = np.where(np.isfinite(matrices), matrices, 0.0)
            radii = np.abs(np.linalg.eigvals(matrices)).max(axis=-1)
        each = radii ** (1.0 / np.array([*map(len, turns)]))
        return [Growth(turn, float(rate)) for turn, rate in zip(turns, each, strict=True)]

    def patterns(self, longest: int) -> list[Growth]:
        """Return the growth of all patterns of the ends of the range, the fastest first."""
        return sorted(self.growths(_patterns(self.delays, longest)), key=_fastest_first)

    def climbed(self, best: list[Growth]) -> list[Growth]:
        """The fastest turns after hill climbing."""
        levels = 5  # delays of the range that hill climbing tries
        tries = 300  # changes of the best pattern of each length
        effort = 20_000_000  # the most changes times the cube of the states
        gain = 1e-9  # of the growth, that a change must bring
        random = np.random.default_rng(0)
        low, high, lost = self.delays
        letters = [*np.linspace(low, high, levels).tolist(), *[inf] * (lost > 0)]
        turns, states = best[:1], len(self._matrix(best[0].turn))
        for length in range(2, len(max((growth.turn for growth in best), key=len)) + 1):
            growth = next(g for g in best if len(g.turn) == length)
            for _ in range(min(tries, effort // states**3)):
                turn = _changed(growth.turn, letters, random)
                if len(turn) <= _LONGEST and self.delays.allows(turn):
                    other = self.growths([turn])[0]
                    is_better = other.per_sample > growth.per_sample * (1.0 + gain)
                    growth = other if is_better else growth
            turns.append(growth)
        return sorted(turns, key=_fastest_first)

    def _matrix(self, turn: Turn) -> np.ndarray:
        steps = map(self._step, _segments(turn))
        return reduce(lambda total, step: step @ total, steps)


def _once(turn: Turn) -> Turn:
    """Return the shortest turn that a turn repeats."""
    lengths = (length for length in range(1, len(turn) + 1) if len(turn) % length == 0)
    return next(turn[:n] for n in lengths if turn[:n] * (len(turn) // n) == turn)


def _fastest_first(growth: Growth) -> tuple[float, int]:
    return -growth.per_sample, len(growth.turn)


@lru_cache(maxsize=16)
def _patterns(delays: Delays, longest: int) -> list[Turn]:
    """Return all turns of the ends of the range, each once up to rotation and repetition."""
    letters = sorted({delays.low, delays.high}) + [inf] * (delays.lost > 0)
    return [
        turn
        for length in range(1, longest + 1)
        for turn in product(letters, repeat=length)
        if all(turn < turn[k:] + turn[:k] for k in range(1, length)) and delays.allows(turn)
    ]


def _changed(turn: Turn, letters: Sequence[float], random: "np.random.Generator") -> Turn:
    """Return a turn with one delay changed, added or left out."""
    place, kind = int(random.integers(len(turn))), random.random()
    letter = letters[int(random.integers(len(letters)))]
    if kind < 0.6:
        return (*turn[:place], letter, *turn[place + 1 :])
    if kind < 0.8:
        return (*turn[:place], letter, *turn[place:])
    return (*turn[:place], *turn[place + 1 :]) or turn


# ------------------------------------------------------------------------------------------ answers
@dataclass(frozen=True, repr=False)
class WorstDelays:
    """Delays in turn under which the motion grows, or decays most slowly: the worst found.

    Attributes:
        delays: one turn, in s; infinite for a sample that is lost.
        growth: the factor per sample by which the motion grows, below 1 if it decays.
        is_proved: True if it is proved that a motion grows.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=0.05, sample_time=1e-3)
        >>> loop.worst_delays(6669.1, 71.60, delays=(0.0, 1e-3))
        delays of 0, 1, 1, 1 ms in turn: the motion grows by a factor of 1.00916 per sample
    """

    delays: tuple[float, ...]
    growth: float
    is_proved: bool

    def __repr__(self) -> str:
        turn = ", ".join("lost" if isinf(delay) else f"{1e3 * delay:.6g}" for delay in self.delays)
        what = f"delays of {turn} ms in turn" if len(self.delays) > 1 else f"a delay of {turn} ms"
        how = "the motion grows by a factor" if self.is_proved else "the worst found is a factor"
        return f"{what}: {how} of {self.growth:.6g} per sample"


@dataclass(frozen=True, repr=False)
class MovingLimits:
    """The stiffest wall that is proved for every sequence of delays, of those that a search tried.

    Attributes:
        stiffness: K in N/m of the proved wall; NaN if none was found.
        damping: its B in N s/m.
        unstable_stiffness: K in N/m of a wall at the same damping that is proved unstable, the
            lowest found, infinite if none was; between the two nothing is known.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> loop.limits(delays=(0.0, 0.2e-3))
        K = 43665.2086450... N/m at B = 63.093604... N s/m is proved for every sequence of
        delays; K = 44859 N/m there is unstable
    """

    stiffness: float
    damping: float
    unstable_stiffness: float

    def __repr__(self) -> str:
        if not self.stiffness > 0.0:
            return "no wall was found that is proved for every sequence of delays"
        unstable = f"K = {self.unstable_stiffness:.5g} N/m there is unstable"
        if isinf(self.unstable_stiffness):
            unstable = "no unstable wall was found there"
        return (
            f"K = {exact_text(self.stiffness)} N/m at B = {exact_text(self.damping)} N s/m is "
            f"proved for every sequence of delays; {unstable}"
        )


class Jitter(NamedTuple):
    """A loop whose delay moves: with the shortest one; ``ends`` are that and the longest, in s."""

    loop: LoopParameters
    ends: Range
    delays: Delays

    @classmethod
    def from_loop(cls, loop: LoopParameters, delays: Any, lost: Any = 0) -> "Jitter":
        """Return a loop with a range of delays in s and of samples lost in a row."""
        loop = loop.in_floats()
        ends = low, high = two_ends("delays", delays, 0.0, unit="s")
        if low > high:
            raise ValueError(f"delays are from {low:g} to {high:g} s; give the shortest one first.")
        shortest, longest = (replace(loop, delay=delay) for delay in ends)
        samples = Delays.between(float(shortest.delay_samples), float(longest.delay_samples), lost)
        return cls(shortest, ends, samples)

    def late_cosines(self, jitter: float) -> list[Any]:
        """The response of the device to changes that come so many samples late."""
        period = float(self.loop.sample_time)
        return late_cosines(self.loop.held_device, period, self.delays.low, jitter)

    def code(self, stiffness: float, damping: float) -> Verdict:
        """Return the verdict on a wall."""
        status = self._small_gain(stiffness, damping)
        if status == SmallGainStatus.PROVED:
            return Verdict.STABLE
        wall = stiffness, damping
        delays = np.linspace(*self.ends, 5)[1:].tolist()
        triples = (partial(ball_triple, replace(self.loop, delay=delay)) for delay in delays)
        is_unstable = (
            status == SmallGainStatus.UNSTABLE
            or any(wall_verdict(own, *wall).verdict == Verdict.UNSTABLE for own in triples)
            or growing_turn(self.loop, wall, self.delays, is_thorough=False)[1]
        )
        return Verdict.UNSTABLE if is_unstable else Verdict.UNDECIDED

    def is_proved(self, stiffness: float, damping: float) -> bool:
        """True if a wall is proved for every sequence of delays."""
        return self._small_gain(stiffness, damping) == SmallGainStatus.PROVED

    def _small_gain(self, stiffness: float, damping: float) -> SmallGainStatus:
        late = partial(self.late_cosines, self.delays.jitter)
        return small_gain(partial(ball_loop, self.loop), late, stiffness, damping)

    def verdict(self, stiffness: Numbers, damping: Numbers) -> Verdict | Int8[Array, "*grid"]:
        """Return the verdicts on walls: ``HapticLoop.verdict``."""
        return named(each_wall(self.code, np.int8, stiffness, damping), Verdict)

    def worst_delays(self, stiffness: float, damping: float) -> WorstDelays:
        """Return the worst delays that a search found: ``HapticLoop.worst_delays``."""
        gains = checked_number("stiffness", stiffness), checked_number("damping", damping)
        growth, is_proved = growing_turn(self.loop, gains, self.delays, is_thorough=True)
        turn = tuple(delay * float(self.loop.sample_time) for delay in growth.turn)
        return WorstDelays(turn, growth.per_sample, is_proved)

    def limits(self) -> MovingLimits:
        """Return the stiffest proved wall that a search finds: ``HapticLoop.limits``."""
        longest = self._longest()
        best, at = stiffest_proved(self.is_proved, longest.stiffness, longest.at_damping)
        return MovingLimits(best, at, self._lowest_unstable(best, at) if best > 0.0 else nan)

    def stiffest_walls(
        self, stable: Iterable[tuple[float, float]] = ()
    ) -> tuple[Float64[np.ndarray, "_ 2"], Float64[np.ndarray, "_ 2"]]:
        """Stiffest proved walls by damping, those of ``stable`` ones too, and unstable ones."""
        columns, every = 24, 3  # dampings of a picture, and of walls that are unstable
        column = 2e-3  # the same, in a picture
        longest, walls = self._longest(), []
        shares = np.maximum(np.arange(columns), 0.1) / columns  # the first one nearly undamped
        starts = dict.fromkeys((longest.damping * shares).tolist(), 0.0)
        starts |= {damping: stiffness for stiffness, damping in sorted(stable)}
        for damping, stiffness in sorted(starts.items()):
            first = _first(self.is_proved, stiffness, damping, longest.stiffness)
            if first > 0.0:
                walls.append((_raised(self.is_proved, first, damping, column), damping))
        unstable = [(self._lowest_unstable(*wall), wall[1]) for wall in walls[::every]]
        return np.reshape(walls, (-1, 2)), np.reshape(unstable, (-1, 2))

    def softest_walls(
        self, stiffest: Float64[np.ndarray, "_ 2"], stable: Iterable[tuple[float, float]] = ()
    ) -> Float64[np.ndarray, " _"]:
        """The stiffness from which samples up to that of each stiffest wall are proved."""
        shares = 0.8, 0.5, 0.2, 0.05, 1e-3
        known = {damping: stiffness for stiffness, damping in sorted(stable, reverse=True)}
        lowest = []
        for most, damping in stiffest.tolist():
            is_proved = partial(self.is_proved, damping=damping)
            proved = takewhile(is_proved, (share * most for share in shares))
            lowest.append(min([most, *proved, known.get(damping, most)]))
        return np.array(lowest)

    def _longest(self) -> Limits[float]:
        """Return the limits of the longest delay: no wall that it makes unstable is proved."""
        return region_of_loop(replace(self.loop, delay=self.ends[1]), TOLERANCE).limits()

    def _lowest_unstable(self, stiffness: float, damping: float) -> float:
        """Return a stiffness above one that is STABLE, proved UNSTABLE, by bisection."""
        low, high = stiffness, inf
        for _ in range(9):
            tried = min(0.5 * (low + high), 2.0 * low)
            is_unstable = self.code(tried, damping) == Verdict.UNSTABLE
            low, high = (low, tried) if is_unstable else (tried, high)
        return high


def stiffest_proved(is_proved: Proved, most: float, at: float) -> tuple[float, float]:
    """Return the stiffest wall (K, B) that is proved, of those that a search tries; NaN without.

    The search begins around the stiffest wall of constant delays, ``most`` and ``at``. From the
    stiffest of some walls it climbs to dampings at which walls that are a little stiffer are
    proved.
    """
    dampings = 1.0, 2.0, *(0.5 ** np.arange(1, 8))  # of the given one
    steps = 0.5 ** np.arange(1, 11)  # of the damping
    fine, finest = 0.03, 1e-5  # differences of the stiffness that count: of a step, and at last
    best, own = 0.0, nan
    for damping in dict.fromkeys(share * at for share in dampings):
        first = _first(is_proved, best, damping, most)
        best, own = (first, damping) if first > best else (best, own)
    if not best:
        return nan, nan
    for step in steps.tolist():
        for damping in (own, own * (1.0 + step), own / (1.0 + step)):
            raised = _raised(is_proved, best, damping, fine * step)
            best, own = (raised, damping) if raised > best else (best, own)
    return _raised(is_proved, best, own, finest), own


def _first(is_proved: Proved, stiffness: float, damping: float, most: float) -> float:
    """Return the first proved of some stiffnesses below ``most``, above one; else that one."""
    shares = 0.95, 0.8, 0.6, 0.4, 0.2, 0.1, 0.03, 0.01, 1e-3
    tried = (share * most for share in shares)
    return next((k for k in tried if k > stiffness and is_proved(k, damping)), stiffness)


def _raised(is_proved: Proved, stiffness: float, damping: float, share: float) -> float:
    """Return a proved stiffness above a given one, as far as one that is not; else that one."""
    low, step = stiffness, share * stiffness
    while is_proved(low + step, damping):
        low, step = low + step, 2.0 * step
    while step > share * stiffness:
        step *= 0.5
        if is_proved(low + step, damping):
            low += step
    return low


def jitter_margin(
    loop: LoopParameters, stiffness: Numbers, damping: Numbers
) -> Float64[np.ndarray, "*grid"]:
    """The proved range of the delay above the loop's, in s: ``HapticLoop.jitter_margin``."""
    moving = Jitter.from_loop(loop, (float(loop.delay), float(loop.delay)))
    parts, most = partial(ball_loop, moving.loop), LONGEST_DELAY - moving.delays.low

    def samples(stiffness: float, damping: float) -> float:
        if stiffness == damping == 0.0:
            return inf if moving.is_proved(0.0, 0.0) else 0.0
        return largest_jitter(parts, moving.late_cosines, (stiffness, damping), most)

    period = float(moving.loop.sample_time) * (1.0 - 8.0 * EPS)
    return np.asarray(each_wall(samples, np.float64, stiffness, damping) * period)


def each_wall(
    judge: Callable[[float, float], float], kind: type, stiffness: Numbers, damping: Numbers
) -> np.ndarray:
    """The answer for each wall, as numbers of a kind."""
    grid = wall_grid(stiffness=stiffness, damping=damping)
    answers = (judge(*wall) for wall in grid.reshape(-1, 2).tolist())
    return np.fromiter(answers, kind, grid.size // 2).reshape(grid.shape[:-1])


def turn_of(loop: LoopParameters, delays: Any) -> tuple[float, ...]:
    """Return delays in s, in turn, as samples of a loop; infinite for a sample that is lost."""
    given = real_numbers("delays", delays).astype(np.float64)
    if given.ndim != 1 or not given.size:
        raise TypeError(f"delays is {shortened(delays)}; give a sequence of delays in s.")
    finite = given[np.isfinite(given)]
    if np.any(np.isnan(given)) or np.any(given < 0.0) or not finite.size:
        raise ValueError(
            f"delays is {shortened(delays)}; give delays >= 0 s, infinite for a lost sample, one "
            "at least finite."
        )
    samples = {delay: replace(loop, delay=delay).delay_samples for delay in set(finite.tolist())}
    return tuple(samples.get(delay, inf) for delay in given.tolist())
