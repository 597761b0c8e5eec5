"""Time rivals in turns, one call of each per round: all see the same state of the machine."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import jax
import numpy as np


@dataclass
class Timing:
    """Run times of one rival in seconds, and the answer of its first call."""

    answer: Any
    seconds: list[float] = field(default_factory=list)

    @property
    def median(self) -> float:
        return float(np.median(self.seconds))

    def columns(self) -> dict[str, Any]:
        """What a row of a record says about run time."""
        low, high = np.quantile(self.seconds, (0.25, 0.75))
        return {
            "seconds": self.median,
            "seconds_quartiles": [float(low), float(high)],
            "repeats": len(self.seconds),
        }


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
    active = set(calls)
    while active:
        for name in [name for name in calls if name in active]:
            start = perf_counter()
            jax.block_until_ready(calls[name]())
            taken = timings[name].seconds
            taken.append(perf_counter() - start)
            if len(taken) >= most or (len(taken) >= least and sum(taken) > budget):
                active.remove(name)
    return timings
