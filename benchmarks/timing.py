"""Time rivals in turns: all see the same state of the machine.

A turn of a rival is as many calls as fill ``_TURN``, and counts with their median: one call alone
would mostly time how the interpreter and the data come back into the cache. The first is kept apart
(``seconds_after_others``). A turn of 0.02 s gave warm calls to those quicker than that alone.
Where others use the machine, too, long calls wait for them and short ones do not: ``cpu_seconds``,
the mean of a turn over all threads, does not count that.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from time import perf_counter, process_time
from typing import Any

import jax
import numpy as np

from benchmarks import record
from benchmarks.record import Row

_TURN, _TURNS = 0.1, 10  # seconds at most, and fewest turns that the budget should be enough for


@dataclass
class Timing:
    """Run times of one rival in seconds, and the answer of its first call.

    ``seconds`` has the median of each turn's calls, ``first_seconds`` the first call of each turn,
    ``cpu_seconds`` the mean time of all threads.
    """

    answer: Any
    seconds: list[float] = field(default_factory=list)
    first_seconds: list[float] = field(default_factory=list)
    cpu_seconds: list[float] = field(default_factory=list)

    @property
    def median(self) -> float:
        return float(np.median(self.seconds))

    @property
    def cpu_median(self) -> float:
        return float(np.median(self.cpu_seconds))

    def row(self, section: str, method: str, error: float, measure: str, **columns: Any) -> Row:
        """Return a row of a record, with what it says about run time."""
        return record.row(
            section,
            method,
            self.seconds,
            error,
            measure,
            **columns,
            seconds_after_others=float(np.median(self.first_seconds)),
            cpu_seconds=self.cpu_median,
        )


def interleaved(
    calls: Mapping[str, Callable[[], Any]], *, budget: float, least: int = 2, most: int = 50
) -> dict[str, Timing]:
    """Call every rival once to warm it up, then in rounds.

    Args:
        calls: the rivals; the time of a call runs until its result is there.
        budget: seconds after which a rival takes no further turn, once it had the least number.
        least: fewest turns of a rival.
        most: most turns of a rival.
    """
    timings = {name: Timing(jax.block_until_ready(call())) for name, call in calls.items()}
    active, spent = set(calls), dict.fromkeys(calls, 0.0)
    while active:
        for name in [name for name in calls if name in active]:
            timing, start = timings[name], process_time()
            turn = _turn(calls[name], min(_TURN, budget / _TURNS))
            timing.cpu_seconds.append((process_time() - start) / len(turn))
            timing.first_seconds.append(turn[0])
            timing.seconds.append(float(np.median(turn)))
            spent[name] += sum(turn)
            turns = len(timing.seconds)
            if turns >= most or (turns >= least and spent[name] > budget):
                active.remove(name)
    return timings


def _turn(call: Callable[[], Any], length: float) -> list[float]:
    """Return the seconds of each call of one turn."""
    taken: list[float] = []
    while not taken or sum(taken) < length:
        start = perf_counter()
        jax.block_until_ready(call())
        taken.append(perf_counter() - start)
    return taken
