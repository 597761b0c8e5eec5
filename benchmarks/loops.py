"""Random loops with estimators and filters against balls of python-flint: walls, radii, regions.

Loops are ordinary and hostile ones (``tests/truth/random_loops.py``), of one mass and of
devices with modes, grips and motors, at delays of 0 to 30 samples; some have modes that walls
hardly move, some windows of 42 to 200 samples. Half of the walls lie within 1e-6 of the boundary. A
radius is ``wrong`` where the circle that its bound makes larger does not hold all roots, or the one
that it makes smaller does. Points of regions lie next to outlines, corners and islands, next to
boundaries that eigenvalues find whether the region has them or not, next to where the curve sets
out from theta = 0 and pi or passes an undamped mode, and anywhere; an UNRESOLVED region claims only
what it contains. The judge is the criterion of Schur and Cohn in balls; ``unjudged`` is what their
bits do not tell. Processes, one for each core, share the loops; seconds are those of CPU in the
process that answered. The record is written as answers come: a campaign that is ended leaves one of
what it did.
"""

import math
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from time import process_time
from typing import NamedTuple

import numpy as np

from benchmarks import record
from benchmarks.record import Row
from jaxstab.conventions import Verdict
from jaxstab.region import RegionStatus, StableRegion
from tests.truth.balls import BallLoop
from tests.truth.boundary import Boundary
from tests.truth.random_loops import DeviceLoop, MassLoop, hostile_walls, long_window

LOOPS = 10_000
_PROGRESS = 500  # loops after which the record is written
_AT_ONCE = 10  # loops that a process is given
MEASURE = "share of {} that balls refute"

Loop = MassLoop | DeviceLoop


class Kind(NamedTuple):
    """Random loops: how one is drawn, words for them, how many of all and in a small benchmark."""

    drawn: Callable[[np.random.Generator], Loop]
    words: str
    share: float
    small: int


KINDS = (
    Kind(MassLoop.drawn, "", 0.45, 6),
    Kind(DeviceLoop.drawn, " of devices", 0.45, 6),
    Kind(DeviceLoop.hardly_moved, " of devices with modes that are hardly moved", 0.095, 2),
    Kind(long_window, " with long windows", 0.005, 1),
)

_LONGEST = 30
_WALLS = 100  # of a loop
_RADII = 10
_POINTS_NEAR_ENDS = 16  # of the circle, of which those next to the region are asked
_POINTS_NEAR_MODES = 16
_POINTS = {"outline": 14, "corners": 8, "islands": 10, "boundary": 14, "anywhere": 16}
_DOUBTED = 100  # points of outline and boundary, of which those are asked that are in doubt
_DISTANCES = 10.0 ** -np.arange(3, 10)  # from the boundary, relative to the region


class Tally(NamedTuple):
    """What became of the questions about one loop."""

    asked: int
    wrong: int
    open: int  # undecided walls, radii without a bound, UNRESOLVED regions
    unjudged: int
    seconds: float  # of CPU for all of them
    rival_wrong: int = 0
    rival_seconds: float = 0.0

    @property
    def of_rival(self) -> "Tally":
        """What became of them in the rival's hands."""
        return Tally(self.asked, self.rival_wrong, 0, self.unjudged, self.rival_seconds)


def rows(
    small: bool, points: int = LOOPS, keep: Callable[[list[Row]], object] = lambda rows: None
) -> Iterator[Row]:
    done: list[Row] = []
    known: list[Row] = []
    with ProcessPoolExecutor(1 if small else os.cpu_count(), get_context("spawn")) as pool:
        for kind in KINDS:
            count = kind.small if small else math.ceil(points * kind.share)
            answers: list[list[Tally]] = []
            for answer in pool.map(partial(_judged, kind), range(count), chunksize=_AT_ONCE):
                answers.append(answer)
                if len(answers) % _PROGRESS == 0 or len(answers) == count:
                    print(f"loops{kind.words}: {len(answers)} of {count}", flush=True)
                    known = [*done, *_rows_of(kind.words, *zip(*answers, strict=True))]
                    keep(known)
            done = known
    yield from done


def _rows_of(
    words: str, of_walls: Sequence[Tally], of_radii: Sequence[Tally], of_regions: Sequence[Tally]
) -> Iterator[Row]:
    yield _row("walls" + words, "verdict", of_walls, "undecided")
    yield _row("walls" + words, "numpy eigvals", [one.of_rival for one in of_walls], "undecided")
    yield _row("radii" + words, "spectral_radius", of_radii, "unbounded")
    yield _row("points of regions" + words, "stable_region", of_regions, "unresolved")


def _judged(kind: Kind, index: int) -> list[Tally]:
    """Answers about one loop, judged: its truth is computed once for all.

    It can be repeated alone.
    """
    rng = np.random.default_rng([20121120, index])
    loop = kind.drawn(rng)
    drawn = rng.bit_generator.state
    tallies = []
    for judge in _JUDGES:
        rng.bit_generator.state = drawn  # as if it were the only question
        tallies.append(judge(loop, rng))
        if tallies[-1].wrong:
            print(f"{judge.__name__} {index}: {tallies[-1].wrong} wrong at {loop}", flush=True)
        if judge is region and tallies[-1].open:
            print(f"region {index}: UNRESOLVED at {loop}", flush=True)
    return tallies


def _row(section: str, method: str, tallies: Sequence[Tally], word: str) -> Row:
    asked, wrong = (sum(getattr(one, name) for one in tallies) for name in ("asked", "wrong"))
    unjudged = sum(one.unjudged for one in tallies)
    own = {"judged": asked - unjudged, "wrong": wrong, "unjudged": unjudged}
    return record.row(
        section,
        method,
        [one.seconds for one in tallies],
        wrong / asked,
        MEASURE.format(section),
        delay=_LONGEST,
        points=asked // len(tallies),
        **own,
        **{word: sum(one.open for one in tallies)},
    )


def walls(loop: Loop, rng: np.random.Generator) -> Tally:
    """Judge verdicts of walls, and eigenvalues of the same polynomials in float64."""
    balls = loop.balls
    points = hostile_walls(rng, balls, _WALLS)
    start = process_time()
    codes = loop.verdict(*points.T)
    middle = process_time()
    radii = Boundary(balls).largest_roots(points)
    end = process_time()
    truths = [balls.is_stable(*point) for point in points.tolist()]
    known = np.array([one is not None for one in truths])
    stable = np.array([bool(one) for one in truths])
    wrong = known & (codes != Verdict.UNDECIDED) & ((codes == Verdict.STABLE) != stable)
    return Tally(
        asked=len(points),
        wrong=int(wrong.sum()),
        open=int(np.sum(codes == Verdict.UNDECIDED)),
        unjudged=int(np.sum(~known)),
        seconds=middle - start,
        rival_wrong=int(np.sum(known & ((radii < 1.0) != stable))),
        rival_seconds=end - middle,
    )


def radii(loop: Loop, rng: np.random.Generator) -> Tally:
    """Judge the bounds of spectral radii."""
    balls = loop.balls
    points = hostile_walls(rng, balls, _RADII)
    start = process_time()
    answer = loop.spectral_radius(*points.T)
    seconds = process_time() - start
    wrong = unjudged = 0
    for point, value, error in zip(points.tolist(), answer.value, answer.error, strict=True):
        if np.isfinite(error):
            inside = balls.is_stable(*point, float(np.nextafter(value + error, np.inf)))
            beyond = balls.is_stable(*point, float(np.nextafter(value - error, -np.inf)))
            wrong += inside is False or beyond is True
            unjudged += inside is None or beyond is None
    return Tally(len(points), wrong, int(np.sum(~np.isfinite(answer.error))), unjudged, seconds)


def region(loop: Loop, rng: np.random.Generator) -> Tally:
    """Judge what a region contains."""
    balls = loop.balls
    start = process_time()
    answer = loop.region()
    seconds = process_time() - start
    points = probes(answer, balls, rng)
    contained = np.asarray(answer.contains(*points.T))
    is_open = RegionStatus(int(answer.status)) == RegionStatus.UNRESOLVED
    wrong = unjudged = 0
    for point, inside in zip(points.tolist(), contained.tolist(), strict=True):
        truth = balls.is_stable(*point)
        unjudged += truth is None
        wrong += truth is not None and truth != inside and (inside or not is_open)
    return Tally(len(points), wrong, int(is_open), unjudged, seconds)


def probes(answer: StableRegion, balls: BallLoop, rng: np.random.Generator) -> np.ndarray:
    """Return points (n, 2) anywhere, next to what a region has, and to what it may have missed.

    Half of those next to outline and boundary are where region and eigenvalues agree least.
    """
    boundary = Boundary(balls)
    found = boundary.points(rng)
    outline = answer.points if len(answer.points) else found
    islands = [island.points for island in answer.islands] or [outline]
    corners = answer.corners if len(answer.corners) else outline
    size = np.ptp(outline, axis=0)
    island = islands[rng.integers(len(islands))]
    anywhere = rng.uniform(-0.2, 1.2, (_POINTS["anywhere"], 2)) * size + outline.min(axis=0)
    here, share = rng.integers(0, len(outline), _DOUBTED), rng.choice([0.0, 0.5], (_DOUBTED, 1))
    edges = outline[here] + share * (np.roll(outline, -1, axis=0) - outline)[here]
    edges = edges[np.isfinite(edges).all(axis=1)]
    found = found[rng.integers(0, len(found), _DOUBTED)]
    edges = _at_largest(edges, boundary.largest_roots(edges))
    found = _at_largest(found, np.abs(np.asarray(answer.distance(*found.T))))
    near = np.concatenate(
        [
            some[rng.integers(0, len(some), _POINTS[name])]
            for name, some in (
                ("outline", edges), ("corners", corners), ("islands", island), ("boundary", found)
            )
        ]
    )  # fmt: skip
    away = rng.choice(_DISTANCES, (len(near), 1)) * rng.normal(size=near.shape)
    low, high = outline.min(axis=0) - 1e-3 * size, outline.max(axis=0) + 1e-3 * size
    ends = np.array([balls.wall_with_roots_at(theta) for theta in _angles_near_ends(rng)])
    ends = ends[np.all((ends > low) & (ends < high), axis=1)]
    walls = np.concatenate([ends, _walls_near_modes(balls, rng)])
    aside = rng.choice(_DISTANCES, (len(walls), 1)) * rng.normal(size=walls.shape)
    sizes = size if len(answer.points) else np.abs(walls)
    return np.concatenate([anywhere, near + size * away, walls + sizes * aside])


def _at_largest(points: np.ndarray, doubts: np.ndarray) -> np.ndarray:
    """Return these points and, as often as all of them, the one with the largest doubt."""
    return np.concatenate([points, np.tile(points[np.argmax(doubts)], (len(points), 1))])


def _walls_near_modes(balls: BallLoop, rng: np.random.Generator) -> np.ndarray:
    """Return walls with roots next to undamped modes, from where small gains move them to far."""
    modes = balls.modes()
    if not modes:
        return np.empty((0, 2))
    count = _POINTS_NEAR_MODES
    chosen = rng.integers(0, len(modes), count)
    away = rng.choice([-1.0, 1.0], count) * 10.0 ** rng.uniform(-20.0, -1.0, count)
    pairs = zip(chosen.tolist(), away.tolist(), strict=True)
    walls = np.array([balls.wall_with_roots_at(modes[k] + x) for k, x in pairs])
    return walls[np.isfinite(walls).all(axis=1)]


def _angles_near_ends(rng: np.random.Generator) -> list[float]:
    """Angles near 0 and pi, where the curve stands still and may turn as soon as it sets out."""
    angles = 10.0 ** rng.uniform(-4.0, -1.0, _POINTS_NEAR_ENDS)
    half = _POINTS_NEAR_ENDS // 2
    return [*angles[:half].tolist(), *(np.pi - angles[half:]).tolist()]


_JUDGES: tuple[Callable[..., Tally], ...] = walls, radii, region
