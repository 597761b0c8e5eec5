"""Delays that change in turn and make the motion grow: searched for, and proved to.

A sequence of N delays that repeats moves the loop by one matrix per turn
(``jaxstab.exact.turns``); the N-th root of its spectral radius is the growth per sample.
Sequences are searched in float64: first all short patterns of the shortest and the longest delay,
then the best of them are changed one delay at a time as long as they grow faster (hill climbing).
The search does not find the largest growth; what it returns is one sequence, and that its motion
grows is proved in balls.
"""

from collections.abc import Sequence
from functools import cache, lru_cache, reduce
from itertools import groupby, product
from math import ceil, inf, isinf
from typing import Any, NamedTuple

import numpy as np

from jaxstab.exact.turns import PeriodicLoop, is_growing, segments_of
from jaxstab.model import LoopParameters
from jaxstab.model.plant import LONGEST_DELAY
from jaxstab.numbers import checked_count
from jaxstab.rounding import EPS

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
    exact = PeriodicLoop.from_loop(loop, *wall)
    search = _Search(exact.rounded(), delays)
    best = search.patterns(_THOROUGH if is_thorough else _QUICK)
    if is_thorough:
        best = search.climbed(best)
    fastest = best[0]._replace(turn=_once(best[0].turn))
    return fastest, fastest.per_sample > 1.0 and is_growing(exact, fastest.turn)


_segments = lru_cache(maxsize=512)(segments_of)


class _Search:
    """Turns of one wall, each sample's matrix formed once."""

    def __init__(self, loop: PeriodicLoop, delays: Delays) -> None:
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
