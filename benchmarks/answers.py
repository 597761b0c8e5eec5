"""What the table of the default atlas answers, and how often a computed verdict contradicts it.

Points of its whole range: at random, next to its interpolated limits, on faces of its cells, and at
whole delays or next to them; a million a call. ``error`` is the share of wrong answers, by
``verdict(resolve="exact")``; ``computed`` the share that is left to be computed.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np

import jaxstab
from benchmarks.record import Row
from benchmarks.timing import interleaved
from jaxstab.atlas.nodes import table_of
from jaxstab.atlas.table import LimitTable
from jaxstab.conventions import AXES, Verdict

MEASURE = "share of wrong answers"
KINDS = {"random": 15, "near": 3, "faces": 3, "whole": 3}  # and how many calls of each
SMALL = jaxstab.AtlasSpec(delay=[0.0, 0.5, 1.0], rows=17)

_CALL = 1_000_000  # points


def rows(small: bool, points: int | None = None) -> Iterator[Row]:
    table = table_of(SMALL if small else jaxstab.AtlasSpec())
    rng = np.random.default_rng(20081012)
    size = 2000 if small else points or _CALL
    for kind, calls in KINDS.items():
        wrong = computed = total = 0
        seconds = np.inf
        for _ in range(1 if small else calls):
            point = points_of(table, kind, size, rng)
            call = partial(table.verdicts, *point)
            timing = interleaved({"table": call}, budget=0.0, most=1)["table"]
            codes = timing.answer
            exact = np.asarray(
                jaxstab.verdict(**dict(zip(AXES, point, strict=True)), resolve="exact")
            )
            clear = codes != Verdict.UNDECIDED
            wrong += int(np.sum(clear & (codes != exact) & (exact != Verdict.UNDECIDED)))
            computed, total = computed + int(np.sum(~clear)), total + codes.size
            seconds = min(seconds, *timing.cpu_seconds)
        yield timing.row(
            kind,
            "table",
            wrong / total,
            MEASURE,
            delay=3.0,
            points=size,
            seconds_per_point=seconds / size,
            asked=total,
            wrong=wrong,
            computed=computed / total,
        )


def points_of(
    table: LimitTable, kind: str, count: int, chance: np.random.Generator
) -> list[np.ndarray]:
    """Points at random, next to interpolated limits, on faces of cells, or at whole delays."""
    gamma, delta, delay = (chance.uniform(nodes[0], nodes[-1], count) for nodes in table.axes)
    if kind == "faces":
        gamma, delta, delay = (
            np.where(chance.random(count) < 0.5, chance.choice(nodes, count), own)
            for nodes, own in zip(table.axes, (gamma, delta, delay), strict=True)
        )
    if kind == "whole":
        aside = chance.choice([0.0, 1e-15, -1e-15, 1e-9, -1e-9], count)
        delay = np.clip(np.round(delay) + aside, table.delay[0], table.delay[-1])
    low, high = table.ends(gamma, delta, delay).T
    beta = low + chance.uniform(-0.08, 1.1, count) * (high - low)
    top = 0.9 * np.tan(np.pi / 4.0 / (delay + 1.0)) ** 2
    alpha = chance.uniform(-0.05, 1.1, count) * top
    if kind == "near":
        limits = table.limits(beta, gamma, delta, delay)
        side = chance.random(count) < 0.5
        limit = np.where(side, limits.lower, limits.upper)
        error = np.where(side, limits.lower_error, limits.upper_error)
        aside = chance.uniform(-8.0, 8.0, count) * error + chance.normal(size=count) * 1e-15
        alpha = np.where(np.isnan(limit), alpha, limit + np.where(np.isinf(error), 0.0, aside))
    return [alpha, beta, gamma, delta, delay]
