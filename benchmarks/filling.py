"""A slice of verdicts that is proved column by column, beside writing its array.

Plain writes are to memory that the process holds but that has left the cache, and to new memory,
the first touch of each page included, in pages as large as NumPy asks for. ``error`` is the share
of sampled nodes, all of them next to the boundary, whose code is not that of certified roots;
``differing`` counts the nodes of the whole slice whose code a verdict of their own does not give.
"""

from collections.abc import Callable, Iterator
from functools import partial
from itertools import cycle
from mmap import MADV_HUGEPAGE, mmap
from typing import Any, NamedTuple

import numpy as np

from benchmarks import truth
from benchmarks.record import Row
from benchmarks.timing import interleaved
from jaxstab import verdict
from jaxstab.atlas.proved import node_verdicts, proved_nodes
from jaxstab.conventions import Verdict
from jaxstab.model import by_name

GAMMA, DELTA = 1e-3, 0.015
MEASURE = "share of sampled nodes next to the boundary with a wrong or no verdict"

_ALL_TURNS = (-4.0, 4.0, -4.0, 4.0)
_BEYOND_CACHE = 2**28  # bytes that are written in turns

Call = Callable[[], Any]


class Slice(NamedTuple):
    """All (alpha, beta) of a grid at one (gamma, delta, delay)."""

    alpha: np.ndarray
    beta: np.ndarray
    gamma: float
    delta: float
    delay: float

    @property
    def shape(self) -> tuple[int, int]:
        return self.alpha.size, self.beta.size

    @property
    def size(self) -> int:
        return self.alpha.size * self.beta.size

    @property
    def arguments(self) -> tuple[Any, ...]:
        hand = np.array([self.gamma]), np.array([self.delta])
        return self.alpha, self.beta, *hand, self.delay

    def dense(self) -> np.ndarray:
        point = (self.alpha[:, None], self.beta, self.gamma, self.delta, self.delay)
        return np.asarray(verdict(**by_name(*point), resolve="exact"))


def rows(small: bool) -> Iterator[Row]:
    side = 64 if small else 4096
    for delay in (1.0,) if small else (0.0, 0.5, 1.0, 5.0, 20.0, 60.0):
        scale = 1.0 / (1.0 + delay)
        around = (-0.05 * scale**2, 1.1 * scale**2, -0.1 * scale, 1.7 * scale)
        for section, ends in (("stable set", around), ("all turns", _ALL_TURNS)):
            alpha, beta = np.linspace(*ends[:2], side), np.linspace(*ends[2:], side)
            yield from _slice_rows(section, Slice(alpha, beta, GAMMA, DELTA, delay), small)


def _slice_rows(section: str, of: Slice, small: bool) -> Iterator[Row]:
    calls = {
        "filled": partial(_filled, of),
        "dense": of.dense,
        "write": _rotating(of),
        "write, new memory": partial(_written, of),
    }
    timings = interleaved(calls, budget=0.1 if small else 2.0, most=30)
    dense = timings["dense"].answer
    judged = _judged(of, dense, 4 if small else 24)
    for method, timing in timings.items():
        codes = dense if method.startswith("write") else timing.answer
        yield {
            "section": section,
            "method": method,
            "delay": of.delay,
            "points": of.size,
            **timing.columns(),
            "error": float(np.mean([codes[node] != code for node, code in judged.items()])),
            "error_measure": MEASURE,
            "evaluated": _open_nodes(of) if method == "filled" else of.size,
            "differing": int(np.sum(codes != dense)),
            "times_write": timing.median / timings["write"].median,
            "times_new_write": timing.median / timings["write, new memory"].median,
        }


def _open_nodes(of: Slice) -> int:
    return int(np.sum(proved_nodes(*of.arguments) == Verdict.UNDECIDED))


def _filled(of: Slice) -> np.ndarray:
    return node_verdicts(*of.arguments)[0]


def _rotating(of: Slice) -> Call:
    """Write arrays in turns: when one is written again, it has left the cache."""
    arrays = cycle([np.zeros(of.shape, np.int8) for _ in range(min(_BEYOND_CACHE // of.size, 64))])
    return lambda: next(arrays).fill(Verdict.STABLE)


def _written(of: Slice) -> None:
    memory = mmap(-1, of.size)
    memory.madvise(MADV_HUGEPAGE)
    np.frombuffer(memory, np.int8).fill(Verdict.STABLE)


def _judged(of: Slice, codes: np.ndarray, count: int) -> dict[tuple[int, int], int]:
    """Return the true codes of random nodes beside which the code changes."""
    rng = np.random.default_rng(20120412)
    changes = np.argwhere(codes[:, 1:] != codes[:, :-1])
    judged = {}
    for i, j in rng.choice(changes, min(count, len(changes)), replace=False).tolist():
        point = float(of.alpha[i]), float(of.beta[j]), of.gamma, of.delta, of.delay
        judged[i, j] = Verdict.UNSTABLE if truth.unstable_count(*point) else Verdict.STABLE
    return judged
