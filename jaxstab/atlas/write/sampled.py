"""What an atlas is like that is not built yet, by a sample of its parts.

No more of them are looked at than show what is asked.
"""

import itertools
from collections.abc import Callable, Sequence
from math import prod
from time import process_time
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxstab.atlas.compute.layout import Grid, Reach
from jaxstab.atlas.compute.plan import Plan
from jaxstab.atlas.format.schema import ALPHA_LIMITS, LIMIT_RANGE, LIMIT_WHOLE, LIMITS, SPEC
from jaxstab.atlas.read.atlas import Atlas
from jaxstab.atlas.read.file import Contents
from jaxstab.atlas.write.parts import LimitPart, cell_parts, limit_parts, radius_errors
from jaxstab.model import by_name

Floats = Float64[np.ndarray, "..."]

_MOST = 0.95  # of the limits keep the error that is said
_DRAWS = 50  # of samples of a sample, for its spread
_TABLE = 2**24  # numbers of limits at most, among which queries are timed: 64 MB
_QUERIES, _REPEATS = 2**16, 4
_ENOUGH = 0.05  # of a value: a spread that needs no more places
_AT_ONCE = 6  # places between looks at the spread


class Measured(NamedTuple):
    """A value from a sample, and its standard error."""

    value: float
    spread: float


class Timed(NamedTuple):
    """How many tiles of limits of alpha were computed, with how many columns, in which CPU time."""

    calls: int = 0
    columns: int = 0
    seconds: float = 0.0


class Sample(NamedTuple):
    """What an atlas is like, by a sample of its cells; NaN for what was not asked, or is not held.

    Attributes:
        limit_error: that 95 % of the places with a stable alpha keep.
        undecided: share of random points.
        radius_error: that half of the stable points keep.
        query_seconds: of CPU time of a verdict, of many.
        timed: what computing its limits of alpha took.
    """

    limit_error: Measured = Measured(np.nan, np.nan)
    undecided: Measured = Measured(np.nan, np.nan)
    radius_error: Measured = Measured(np.nan, np.nan)
    query_seconds: float = np.nan
    timed: Timed = Timed()


Enough = Callable[[Sample], bool]
"""Says whether a sample shows what is asked."""


def has_small_spreads(sample: Sample) -> bool:
    """Whether the shares and errors of limits of alpha are known well."""
    known = sample.limit_error, sample.undecided
    return all(spread <= _ENOUGH * value or not value < np.inf for value, spread in known)


def sample_of_limits(
    plan: Plan, reach: Reach, count: int, enough: Enough = has_small_spreads
) -> Sample:
    """Compute some limits of alpha of an atlas and ask them.

    Args:
        plan: of an atlas with limits of alpha.
        reach: of its regions.
        count: how many parts of the range are computed, at most.
        enough: says of fewer whether they will do.
    """
    drawn = limit_parts(plan, reach, count)
    parts: list[LimitPart] = []
    sample = Sample()
    while some := list(itertools.islice(drawn, _AT_ONCE)):
        parts += some
        sample = Sample(
            limit_error=_quantile([part.error for part in parts], _MOST),
            undecided=_mean([float(part.undecided.mean()) for part in parts]),
        )
        if enough(sample):
            break
    computed = [part for part in parts if part.seconds]
    columns, seconds = sum(len(part.terms) for part in computed), sum(p.seconds for p in computed)
    return sample._replace(
        query_seconds=_query_seconds(plan.grid, parts),
        timed=Timed(len(computed), columns, seconds),
    )


def sample_of_cells(plan: Plan, count: int) -> Sample:
    """Compute some cells of the verdicts of an atlas and ask them between nodes.

    Args:
        plan: of an atlas with verdicts and without limits of alpha.
        count: how many places of the range.
    """
    parts = list(cell_parts(plan, count))
    return Sample(
        undecided=_mean([part.undecided for part in parts]),
        query_seconds=float(np.median([part.query_seconds for part in parts])),
    )


def sample_of_radii(plan: Plan, count: int) -> Sample:
    """Compute some cells of radii of an atlas and ask them.

    Args:
        plan: of an atlas with spectral radii.
        count: how many places of the range.
    """
    return Sample(radius_error=_quantile(list(radius_errors(plan, count)), 0.5))


def _query_seconds(grid: Grid, parts: Sequence[LimitPart]) -> float:
    """Return the time of a verdict: in a table as large as the atlas's, of the columns of parts."""
    shape = [*(grid.lengths[name] for name in LIMITS)]
    shape[0] = max(1, min(shape[0], _TABLE // prod(shape[1:])))
    terms = np.resize(np.concatenate([part.terms for part in parts]), shape)
    arrays = {"gamma": grid.gamma, "delta": grid.delta, "delay": grid.delay, SPEC: np.array([b""])}
    arrays |= {ALPHA_LIMITS: terms, LIMIT_RANGE: grid.limit_range}
    arrays |= {LIMIT_WHOLE: np.zeros(len(grid.limit_range), np.int32)}
    atlas = Atlas(Contents(arrays, "", ""))
    rng = np.random.default_rng(shape[0])
    row = grid.limit_range[rng.integers(len(grid.limit_range), size=_QUERIES)].T
    hands = (rng.uniform(nodes[0], nodes[-1], _QUERIES) for nodes in (grid.gamma, grid.delta))
    walls = (rng.uniform(row[2], row[3]), rng.uniform(row[4], row[5]))
    points = *walls, *hands, rng.uniform(row[0], row[1])
    taken = []
    for _ in range(_REPEATS):
        begin = process_time()
        atlas.verdict(**by_name(*points))
        taken.append(process_time() - begin)
    return min(taken) / _QUERIES


def _quantile(parts: Sequence[Floats], share: float) -> Measured:
    """Return a quantile of all values, and its spread by drawing the parts again."""
    kept = [part for part in parts if part.size]
    if not kept:
        return Measured(np.nan, np.nan)
    rng = np.random.default_rng(len(kept))
    drawn = rng.integers(len(kept), size=(_DRAWS, len(kept)))
    values = [_at_share(np.concatenate([kept[i] for i in some]), share) for some in drawn]
    known = np.isfinite(values)
    spread = float(np.std(np.array(values)[known])) if known.all() else np.inf
    return Measured(_at_share(np.concatenate(kept), share), spread)


def _at_share(values: Floats, share: float) -> float:
    """Return the value that a share of all is not above; it may be infinite."""
    return float(np.quantile(values, share, method="higher"))


def _mean(values: Sequence[float]) -> Measured:
    spread = np.std(values, ddof=1) / len(values) ** 0.5 if len(values) > 1 else np.nan
    return Measured(float(np.mean(values)), float(spread))
