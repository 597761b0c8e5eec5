"""What the default atlas answers, and how quickly, beside computing the same verdicts on the spot.

Random points of its whole range, between its nodes, are asked in one call and one by one: at each
of its delays, at any delay between them, and next to the limits of alpha, to the faces of their
cells and to whole delays. ``error`` is the share of points without a right verdict: undecided, or
wrong by ``verdict(resolve="exact")``.
``undecided_of_cells`` is the share that all cells of limits leave open, in their middles, and
``undecided_at_best_beta``, say, what as many cells would at least leave if their widths along beta
were the best ones.
"""

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

import jaxstab
from benchmarks.record import Row
from benchmarks.timing import Timing, interleaved
from jaxstab.atlas.lookup import undecided_share
from jaxstab.conventions import AXES, Verdict
from jaxstab.model import by_name

MEASURE = "share of random points without a right verdict: undecided or wrong"
SMALL = jaxstab.AtlasSpec(
    alpha=jaxstab.FittedAxis(8),
    beta=jaxstab.FittedAxis(8),
    gamma=[0.0, 1e-3],
    delta=[0.0, 0.015],
    delay=[0.0, 1.0],
    limit_cells=32,
    delay_cells=4,
)

Points = list[np.ndarray]
"""Arrays of alpha, beta, gamma, delta and delay."""

_CALL = 1_000_000  # points
_CALLS = 3  # for each delay
_ONE_BY_ONE = 1000


def rows(small: bool) -> Iterator[Row]:
    spec = SMALL if small else jaxstab.AtlasSpec()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "default.h5"
        atlas = jaxstab.build_atlas(spec, path)
        shared = {"file_bytes": path.stat().st_size} | _opening(path, atlas) | _divisions(atlas)
    rng = np.random.default_rng(20081012)
    points, calls = (2000, 1) if small else (_CALL, _CALLS)
    for delay in atlas.delays.tolist():
        lists = [_random_points(atlas, delay, rng, points) for _ in range(calls)]
        for row in _rows(atlas, f"delay {delay:g}", lists, small):
            yield row | shared
    for place, moved in _PLACES.items():
        lists = [
            _inside(atlas, moved(atlas, rng, _at_any_delay(atlas, rng, points)))
            for _ in range(calls)
        ]
        for row in _rows(atlas, place, lists, small):
            yield row | shared


def _opening(path: Path, atlas: jaxstab.Atlas) -> dict[str, float]:
    """Time an opening, alone and with the first answer, which unpacks what it needs."""
    middle = [along[along.size // 2] for along in atlas.nodes(0).values()]
    point = by_name(*map(float, middle), float(atlas.delays[0]))
    timings = interleaved(
        {
            "opening_seconds": lambda: jaxstab.open_atlas(path),
            "opening_and_verdict_seconds": lambda: jaxstab.open_atlas(path).verdict(**point),
            "opening_and_query_seconds": lambda: jaxstab.open_atlas(path).query(**point),
        },
        budget=1.0,
    )
    return {name: timing.median for name, timing in timings.items()}


def _divisions(atlas: jaxstab.Atlas) -> dict[str, float]:
    """Return what the cells of limits leave open, and what the best division along each axis would.

    What a limit leaves open is taken to fall with the square of the width w of cells, as fast as
    a curve nears a line: k(x) w(x)^2. Of all divisions into n cells, those with 1/w of integral n,
    the one with the same k w^3 everywhere leaves least: the cube of the integral of the cubic root
    of k, over n^2.
    """
    early, late, least, most, low, high = atlas.arrays["limit_range"].T
    gamma, delta = (atlas.arrays[name] for name in ("gamma", "delta"))
    cells = atlas.arrays["alpha_limits"].shape[0]
    place = (np.arange(cells).reshape(-1, 1, 1, 1) + 0.5) / cells
    limits = atlas.alpha_limits(
        low + place * (high - low),
        gamma=(0.5 * (gamma[1:] + gamma[:-1])).reshape(-1, 1, 1),
        delta=(0.5 * (delta[1:] + delta[:-1])).reshape(-1, 1),
        delay=0.5 * (early + late),
    )
    left = np.where(np.isnan(limits.lower), 0.0, undecided_share(limits, least, most))
    ends = np.linspace(0.0, 1.0, cells + 1), gamma, delta, np.append(early, late[-1])
    widths = dict(zip(AXES[1:], (np.diff(end) / np.ptp(end) for end in ends), strict=True))
    found = {}
    for axis, (name, width) in enumerate(widths.items()):
        along = np.moveaxis(left, axis, 0)
        for weights in reversed([w for other, w in widths.items() if other != name]):
            along = along @ weights
        found["undecided_of_cells"] = float(along @ width)
        best = (np.cbrt(along / width**2) @ width) ** 3 / width.size**2
        found[f"undecided_at_best_{name}"] = float(best)
    return found


def _rows(atlas: jaxstab.Atlas, section: str, lists: list[Points], small: bool) -> Iterator[Row]:
    """Ask lists of points of one length; the first one is timed."""
    points = lists[0][0].size
    each = zip(*(values[:_ONE_BY_ONE].tolist() for values in lists[0]), strict=True)
    ones = [by_name(*point) for point in each]
    exact = [np.asarray(jaxstab.verdict(**by_name(*some), resolve="exact")) for some in lists]
    said = [atlas.verdict(**by_name(*some)) for some in lists]
    rivals: dict[str, Callable[[], Any]] = {
        "atlas, many points": lambda: atlas.verdict(**by_name(*lists[0])),
        "atlas, one by one": lambda: [atlas.verdict(**point) for point in ones],
        "verdict": lambda: jaxstab.verdict(**by_name(*lists[0])),
    }
    timings = interleaved(rivals, budget=0.1 if small else 2.0)
    one_by_one = np.array(timings["atlas, one by one"].answer)
    on_the_spot = np.asarray(timings["verdict"].answer)
    place = section, float(lists[0][4].max())
    yield _row(*place, "atlas, many points", timings, points, said, exact)
    yield _row(*place, "atlas, one by one", timings, len(ones), [one_by_one], exact)
    yield _row(*place, "verdict", timings, points, [on_the_spot], exact)


def _random_points(
    atlas: jaxstab.Atlas, delay: float, rng: np.random.Generator, count: int
) -> Points:
    nodes = atlas.nodes(atlas.delays.tolist().index(delay))
    walls = [rng.uniform(along[0], along[-1], count) for along in nodes.values()]
    return [*walls, np.full(count, delay)]


def _at_any_delay(atlas: jaxstab.Atlas, rng: np.random.Generator, count: int) -> Points:
    """Return points at delays between the first and the last, within the ends of the limits."""
    ends, hands = atlas.arrays["limit_range"], atlas.nodes(0)
    delay = rng.uniform(ends[0, 0], ends[-1, 1], count)
    _, _, *walls = _ends_at(atlas, delay)
    others = (rng.uniform(hands[name][0], hands[name][-1], count) for name in ("gamma", "delta"))
    return [rng.uniform(*walls[:2]), rng.uniform(*walls[2:]), *others, delay]


def _ends_at(atlas: jaxstab.Atlas, delay: np.ndarray) -> np.ndarray:
    """Return the lowest and the highest delay, alpha and beta of the cells of delays."""
    ends = atlas.arrays["limit_range"]
    return ends[np.searchsorted(ends[:, 0], delay, "right") - 1].T


def _beside_limits(atlas: jaxstab.Atlas, rng: np.random.Generator, points: Points) -> Points:
    """Move alpha next to the lower or the upper limit, as far as its error, or less, or more."""
    alpha, *others = points
    limits = atlas.alpha_limits(**by_name(*others))
    is_upper = rng.random(alpha.size) < 0.5
    limit = np.where(is_upper, limits.upper, limits.lower)
    error = np.where(is_upper, limits.upper_error, limits.lower_error)
    known = np.isfinite(limit) & np.isfinite(error)
    way = rng.normal(size=alpha.size) * np.maximum(error, 1e-12)
    return [
        np.where(known, np.where(known, limit, 0.0) + np.where(known, way, 0.0), alpha),
        *others,
    ]


def _beside_faces(atlas: jaxstab.Atlas, rng: np.random.Generator, points: Points) -> Points:
    """Move beta, gamma, delta or the delay next to a face of its cell, or onto it."""
    alpha, beta, gamma, delta, delay = points
    early, late, _, _, low, high = _ends_at(atlas, delay)
    cells = atlas.arrays["alpha_limits"].shape[0]
    face = low + np.round((beta - low) / (high - low) * cells) / cells * (high - low)
    edge = np.where(rng.random(delay.size) < 0.5, early, late)
    gammas, deltas = (atlas.arrays[name] for name in ("gamma", "delta"))
    moved = [
        _near(face, rng, low, high),
        _near(_nearest(gamma, gammas), rng, gammas[0], gammas[-1]),
        _near(_nearest(delta, deltas), rng, deltas[0], deltas[-1]),
        _near(edge, rng, early, late),
    ]
    which = rng.integers(len(moved), size=alpha.size)
    there = zip(moved, (beta, gamma, delta, delay), strict=True)
    return [alpha, *(np.where(which == n, new, old) for n, (new, old) in enumerate(there))]


def _nearest(values: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    return nodes[np.abs(values[:, None] - nodes).argmin(axis=1)]


def _beside_whole_delays(atlas: jaxstab.Atlas, rng: np.random.Generator, points: Points) -> Points:
    """Move the delay next to a whole one, on either side."""
    *others, delay = points
    ends = atlas.arrays["limit_range"]
    return [*others, _near(np.round(delay), rng, ends[0, 0], ends[-1, 1])]


def _inside(atlas: jaxstab.Atlas, points: Points) -> Points:
    """Return points whose alpha and beta do not leave the atlas where their delay was moved."""
    alpha, beta, gamma, delta, delay = points
    _, _, *walls = _ends_at(atlas, delay)
    return [np.clip(alpha, *walls[:2]), np.clip(beta, *walls[2:]), gamma, delta, delay]


def _near(
    values: np.ndarray, rng: np.random.Generator, low: np.ndarray | float, high: np.ndarray | float
) -> np.ndarray:
    """Return values moved by 1e-16 to 1e-3 of their range, within it; a tenth stays."""
    way = 10.0 ** rng.uniform(-16.0, -3.0, values.size) * rng.choice([-1.0, 1.0], values.size)
    way *= rng.random(values.size) > 0.1
    return np.clip(values + way * (np.asarray(high) - low), low, high)


_PLACES: dict[str, Callable[[jaxstab.Atlas, np.random.Generator, Points], Points]] = {
    "any delay": lambda atlas, rng, points: points,
    "next to limits": _beside_limits,
    "next to faces": _beside_faces,
    "next to whole delays": _beside_whole_delays,
}


def _row(
    section: str,
    delay: float,
    method: str,
    timings: dict[str, Timing],
    points: int,
    said: list[np.ndarray],
    exact: list[np.ndarray],
) -> Row:
    codes = np.concatenate(said)
    true = np.concatenate([some[: s.size] for some, s in zip(exact, said, strict=False)])
    undecided = codes == Verdict.UNDECIDED
    wrong = ~undecided & (codes != true) & (true != Verdict.UNDECIDED)
    return {
        "section": section,
        "method": method,
        "delay": delay,
        "points": points,
        **timings[method].columns(),
        "seconds_per_point": float(np.median(timings[method].cpu_seconds)) / points,
        "asked": codes.size,
        "error": float(np.mean(undecided | wrong)),
        "error_measure": MEASURE,
        "undecided": float(np.mean(undecided)),
        "wrong": int(wrong.sum()),
        "unjudged": int(np.sum(true == Verdict.UNDECIDED)),
    }
