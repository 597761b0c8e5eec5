"""Answers about one loop in balls, on random loops of all kinds, judged in mpmath.

Loops are those of ``loops``: of one mass, of devices with modes, grips and motors, with modes that
walls hardly move, with long windows; and loops that are late by up to 500 samples. Each is asked
for verdicts next to the boundary, radii, a row and a column of walls, the largest stiffness, and
some for margins. ``open`` counts what is left undecided. The verdicts, both sides of each end
1e-12 from it, the radii and the largest stiffness are judged in mpmath, for a share of the loops of
high degree: ``wrong`` of ``judged``; ``error`` is how far a number is from 60 digits, or a gain
from the end of its row. The last rows are times by degree, warm.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from math import inf, isfinite
from time import process_time
from typing import Any

import numpy as np

from benchmarks import record
from benchmarks.record import Row
from jaxstab import Device, HapticLoop, Velocity
from jaxstab.conventions import Verdict
from jaxstab.exact.line import LineStatus, StableLine, stable_line
from jaxstab.exact.roots import spectral_radius, wall_verdict
from jaxstab.model.balls import ball_triple
from jaxstab.region.stable_set import RegionStatus
from tests.truth.plain import Loop, stiffest_walls
from tests.truth.plain import radius as true_radius
from tests.truth.random_loops import DeviceLoop, MassLoop, hostile_walls, long_window

_LOOPS, _SMALL = 2000, 10
_WALLS = 10  # of a loop
_JUDGED, _MARGINS = 25, 5  # one of so many loops, of high degree; of all
_RARE = 0.05  # share of kinds of high degree: mpmath takes minutes to judge one
_SAME = 1e-12  # relative: numbers that are right
_TIMED = (1, 0), (1, 6), (20, 3), (40, 20), (100, 1), (200, 3), (200, 283)
_LATEST = 30.0  # samples: limits and margins take seconds beyond

Drawn = MassLoop | DeviceLoop


def rows(small: bool, points: int | None = None) -> Iterator[Row]:
    count = points or (_SMALL if small else _LOOPS)
    for name, (draw, share) in KINDS.items():
        tallies = {question: Tally() for question in QUESTIONS}
        for index in range(max(1, round(count * share))):
            rng = np.random.default_rng([20261126, index])
            is_judged = share > _RARE or (index % _JUDGED == 0 and not small)
            _ask(draw(rng), rng, tallies, index, is_judged=is_judged)
        for question, tally in tallies.items():
            if tally.asked:
                yield tally.row(f"{question} {name}")
    for samples, delay in _TIMED[: 3 if small else None]:
        yield from _times(samples, delay)


def late(rng: np.random.Generator) -> Drawn:
    """A loop that is late by 50 to 500 samples."""
    drawn = MassLoop.drawn(rng)
    gamma, delta, delay = drawn.plant
    more = float(np.exp(rng.uniform(np.log(50.0), np.log(470.0))).round())
    return MassLoop((gamma, delta, min(delay + more, 500.0)), drawn.filters)


KINDS: dict[str, tuple[Callable[[np.random.Generator], Drawn], float]] = {
    "of masses": (MassLoop.drawn, 0.45),
    "of devices": (DeviceLoop.drawn, 0.4),
    "of devices with modes that are hardly moved": (DeviceLoop.hardly_moved, 0.1),
    "with long windows": (long_window, 0.03),
    "that are late": (late, 0.02),
}
QUESTIONS = "walls", "radii", "rows", "columns", "limits", "margins"


@dataclass
class Tally:
    """What became of one kind of questions."""

    asked: int = 0
    open: int = 0
    judged: int = 0
    wrong: int = 0
    error: float = 0.0
    seconds: list[float] = field(default_factory=list)

    def row(self, section: str) -> Row:
        return record.row(
            section,
            "exact",
            self.seconds,
            self.error,
            "largest relative error of a number",
            points=self.asked,
            slowest=max(self.seconds),
            open=self.open,
            judged=self.judged,
            wrong=self.wrong,
        )

    def ask(self, question: Callable[[], Any], is_open: Callable[[Any], bool]) -> Any:
        """Return the answer, timed and counted."""
        start = process_time()
        answer = question()
        self.seconds.append(process_time() - start)
        self.asked += 1
        self.open += is_open(answer)
        return answer

    def judge(self, is_right: bool, words: object) -> None:
        self.judged += 1
        if not is_right:
            self.wrong += 1
            print(f"wrong: {words}", flush=True)

    def compare(self, difference: float, words: object) -> None:
        """Count a number that should be another."""
        self.error = max(self.error, difference)
        self.judge(difference <= _SAME, words)


def _ask(
    drawn: Drawn,
    rng: np.random.Generator,
    tallies: dict[str, Tally],
    index: int,
    *,
    is_judged: bool,
) -> None:
    truth = Loop.of(drawn) if is_judged else None
    loop = drawn.loop
    units = loop.alpha(1.0), loop.beta(1.0)
    walls = (hostile_walls(rng, drawn.balls, _WALLS) / units).tolist()
    triple = partial(ball_triple, loop)
    tally = tallies["walls"]
    for wall in walls:
        found = tally.ask(partial(wall_verdict, triple, *wall), _is_undecided)
        if truth is not None and not _is_undecided(found):
            _judge_wall(tally, truth, wall, found.verdict == Verdict.STABLE)
    for wall in walls[:2]:
        _radius(tallies["radii"], triple, truth, wall)
    lines = {"rows": ((0.0, walls[1][1]), (1.0, 0.0)), "columns": ((walls[1][0], 0.0), (0.0, 1.0))}
    for name, (start, along) in lines.items():
        tally = tallies[name]
        line = tally.ask(partial(stable_line, triple, start, along), _is_not_proved)
        if truth is not None:
            _judge_line(tally, truth, line, start, along)
    if loop.delay_samples <= _LATEST:
        _limits(tallies["limits"], loop, truth)
        if index % _MARGINS == 0:
            _margins(tallies["margins"], loop, walls)


def _is_undecided(answer: Any) -> bool:
    return answer.verdict == Verdict.UNDECIDED


def _is_not_proved(line: StableLine) -> bool:
    return line.status != LineStatus.PROVED


def _judge_wall(tally: Tally, truth: Loop, wall: Any, is_stable: bool) -> None:
    expected = truth.is_stable(*wall)
    if expected is not None:
        tally.judge(expected == is_stable, f"{wall} on {truth.loop} is stable: {expected}")


def _radius(tally: Tally, triple: Any, truth: Loop | None, wall: list[float]) -> None:
    question = partial(spectral_radius, triple, *wall)
    radius = tally.ask(question, lambda found: not isfinite(found.error))
    if truth is not None and isfinite(radius.error):
        try:
            exact = true_radius(truth.polynomial(*wall))
        except ArithmeticError:  # roots that coincide
            return
        words = f"radius {radius} of {wall} on {truth.loop} is {exact}"
        true_to = 1e-40  # its iteration ends there; a root at 1 is known exactly
        tally.error = max(tally.error, float(abs(radius.value - exact) / exact))
        tally.judge(abs(radius.value - exact) <= radius.error + true_to, words)


def _judge_line(
    tally: Tally,
    truth: Loop,
    line: StableLine,
    start: tuple[float, float],
    along: tuple[float, float],
) -> None:
    """Judge both sides of all crossings, and the middles of gaps."""
    if _is_not_proved(line) or line.drift:
        return
    known = [end.value for end in line.crossings]
    tried = [(low + high) / 2.0 for low, high in pairwise(known)]
    ends = [end for interval in line.intervals for end in interval if isfinite(end.value)]
    tally.error = max(tally.error, *(end.error / abs(end.value) for end in ends if end.value), 0.0)
    for value, error, *_ in line.crossings:
        aside = max(_SAME * abs(value), 4.0 * error)
        tried += [value - aside, value + aside]
    for t in tried:
        if t not in known and abs(t) < line.horizon:
            wall = [a + t * b for a, b in zip(start, along, strict=True)]
            _judge_wall(tally, truth, wall, line.holding(t) is not None)


def _limits(tally: Tally, loop: HapticLoop, truth: Loop | None) -> None:
    """The largest stiffness is that of 60 digits, or at a damping that is: K may be that steep."""
    limits = tally.ask(loop.limits, lambda found: found.status == RegionStatus.UNRESOLVED)
    wall = limits.stiffness, limits.at_damping
    if truth is None or not 0.0 < wall[0] < inf:
        return
    tally.compare(next(_errors(truth, wall), inf), (loop, wall))


def _errors(truth: Loop, wall: tuple[float, float]) -> Iterator[float]:
    near = 1e-9
    for known in stiffest_walls(truth, *wall):
        apart = [abs(float(a / b - 1)) if b else inf for a, b in zip(known, wall, strict=True)]
        if apart[0] < near and min(apart) <= _SAME:
            yield min(apart)


def _margins(tally: Tally, loop: HapticLoop, walls: list[list[float]]) -> None:
    triple = partial(ball_triple, loop)
    wall = next((w for w in walls if wall_verdict(triple, *w).verdict == Verdict.STABLE), None)
    if wall is None or wall[0] <= 0.0:
        return
    proved = float(loop.margins(*wall).stiffness_gain)
    row = partial(stable_line, triple, (0.0, wall[1]), (1.0, 0.0))
    line = tally.ask(row, lambda line: line.holding(wall[0]) is None)
    interval = line.holding(wall[0])
    if interval is not None and isfinite(proved):
        gain = interval.high.value / wall[0]
        tally.compare(max(proved / gain - 1.0, 0.0), (loop, wall))  # a lower bound


def _times(samples: int, delay: int) -> Iterator[Row]:
    device = Device.mass_spring_damper(0.25, damping=0.1)
    loop = HapticLoop(
        device=device, sample_time=1e-3, delay=delay * 1e-3,
        velocity=Velocity.difference(samples=samples),
    )  # fmt: skip
    triple = partial(ball_triple, loop)
    high = stable_line(triple, (0.0, 1.0), (1.0, 0.0)).intervals[0].high.value
    wall = 0.5 * high, 1.0
    questions: dict[str, Callable[[], Any]] = {
        "wall_verdict": partial(wall_verdict, triple, *wall),
        "spectral_radius": partial(spectral_radius, triple, *wall),
        "row": partial(stable_line, triple, (0.0, 1.0), (1.0, 0.0)),
        "column": partial(stable_line, triple, (wall[0], 0.0), (0.0, 1.0)),
    }
    degree = samples + delay + 2
    for name, question in questions.items():
        question()
        tally = Tally()
        while len(tally.seconds) < 3 or sum(tally.seconds) < 0.2:
            tally.ask(question, lambda _: False)
        measure = "none: times alone"
        yield record.row(f"degree {degree}", name, tally.seconds, 0.0, measure, delay=float(delay))
