"""What the default atlas answers, and how quickly, beside computing the same verdicts on the spot.

Random points of its whole range, between its nodes, are asked in one call and one by one. ``error``
is the share of points without a right verdict: undecided, or wrong by ``verdict(resolve="exact")``.
"""

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

import jaxstab
from benchmarks.record import Row
from benchmarks.timing import Timing, interleaved
from jaxstab.conventions import UNDECIDED

MEASURE = "share of random points without a right verdict: undecided or wrong"
SMALL = jaxstab.AtlasSpec(
    alpha=jaxstab.FittedAxis(8),
    beta=jaxstab.FittedAxis(8),
    delay=[0.0],
    products=["verdict", "alpha_limits"],
)

_CALL = 1_000_000  # points
_CALLS = 3  # for each delay
_ONE_BY_ONE = 1000


def rows(small: bool) -> Iterator[Row]:
    spec = SMALL if small else jaxstab.AtlasSpec()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "default.h5"
        atlas = jaxstab.build_atlas(spec, path)
        shared = {"file_bytes": path.stat().st_size} | _opening(path, atlas)
    rng = np.random.default_rng(20081012)
    for delay in atlas.delays.tolist():
        for row in _delay_rows(atlas, delay, rng, 2000 if small else _CALL, 1 if small else _CALLS):
            yield row | shared


def _opening(path: Path, atlas: jaxstab.Atlas) -> dict[str, float]:
    """Time an opening, alone and with the first answer, which unpacks what it needs."""
    middle = [along[along.size // 2] for along in atlas.nodes(0).values()]
    point = (*map(float, middle), float(atlas.delays[0]))
    timings = interleaved(
        {
            "opening_seconds": lambda: jaxstab.open_atlas(path),
            "opening_and_verdict_seconds": lambda: jaxstab.open_atlas(path).verdict(*point),
            "opening_and_query_seconds": lambda: jaxstab.open_atlas(path).query(*point),
        },
        budget=1.0,
    )
    return {name: timing.median for name, timing in timings.items()}


def _delay_rows(
    atlas: jaxstab.Atlas, delay: float, rng: np.random.Generator, points: int, calls: int
) -> Iterator[Row]:
    lists = [_random_points(atlas, delay, rng, points) for _ in range(calls)]
    ones = list(zip(*(values[:_ONE_BY_ONE].tolist() for values in lists[0]), strict=True))
    exact = [np.asarray(jaxstab.verdict(*some, delay, resolve="exact")) for some in lists]
    said = [atlas.verdict(*some, delay) for some in lists]
    rivals: dict[str, Callable[[], object]] = {
        "atlas, many points": lambda: atlas.verdict(*lists[0], delay),
        "atlas, one by one": lambda: [atlas.verdict(*point, delay) for point in ones],
        "verdict": lambda: jaxstab.verdict(*lists[0], delay),
    }
    timings = interleaved(rivals, budget=2.0)
    one_by_one = np.array(timings["atlas, one by one"].answer)
    on_the_spot = np.asarray(timings["verdict"].answer)
    yield _row("atlas, many points", delay, timings, points, said, exact)
    yield _row("atlas, one by one", delay, timings, len(ones), [one_by_one], exact)
    yield _row("verdict", delay, timings, points, [on_the_spot], exact)


def _random_points(
    atlas: jaxstab.Atlas, delay: float, rng: np.random.Generator, count: int
) -> list[np.ndarray]:
    nodes = atlas.nodes(atlas.delays.tolist().index(delay))
    return [rng.uniform(along[0], along[-1], count) for along in nodes.values()]


def _row(
    method: str,
    delay: float,
    timings: dict[str, Timing],
    points: int,
    said: list[np.ndarray],
    exact: list[np.ndarray],
) -> Row:
    codes = np.concatenate(said)
    true = np.concatenate([some[: s.size] for some, s in zip(exact, said, strict=False)])
    undecided = codes == UNDECIDED
    wrong = ~undecided & (codes != true)
    return {
        "section": f"delay {delay:g}",
        "method": method,
        "delay": delay,
        "points": points,
        **timings[method].columns(),
        "seconds_per_point": timings[method].median / points,
        "asked": codes.size,
        "error": float(np.mean(undecided | wrong)),
        "error_measure": MEASURE,
        "undecided": float(np.mean(undecided)),
        "wrong": int(wrong.sum()),
    }
