"""Margins and ranges of hands, at random and hostile loops, against certified root counts.

Hands are haptic ones, stiff and undamped ones, and ones next to multiples of the Nyquist frequency;
delays are whole and fractional; walls lie anywhere in the stable region, half of them next to its
boundary. A margin is ``wrong`` where a wall within it is unstable, and ``short`` where the wall is
stable farther by a millionth of the way and more, p(z) on the circle being larger than 1e-12 of its
terms for each sample of delay; ``shortest`` is the largest share of the way that was missing. A
limit is ``wrong`` where the proved wall is unstable for a hand, or a stiffer one stable for all.
Loops with filters and devices are those of ``filtered_ranges``.
"""

from collections.abc import Iterator
from dataclasses import replace
from time import process_time
from typing import NamedTuple

import numpy as np

from benchmarks import filtered_ranges, truth
from benchmarks.record import Row
from benchmarks.rivals import largest_modulus
from jaxstab.boxes import HandRange, RobustLimit
from jaxstab.conventions import Verdict
from jaxstab.loop import HapticLoop
from jaxstab.loop.margins import WAYS, first_crossings
from jaxstab.model import by_name, characteristic_polynomial, companion_matrix
from jaxstab.region import RegionStatus, stable_region

_WALLS, _SMALL_WALLS = 400, 6
_RANGES, _SMALL_RANGES = 400, 2
_PARTS = (0.3, 0.9, 1.0 - 1e-9)  # of the way, judged
_FARTHER = (1e-6, 1e-4, 1e-2, 0.13)
_ROUNDING = 1e-12
_FARTHEST = 20.0  # a way without an end is judged so far
_HANDS, _FEW = 200, 6  # of a range, for which a proved wall and many stiffer ones are looked at
_STIFFER = 1.0 + np.geomspace(1e-3, 4.0, 24)
_DAMPINGS = np.linspace(-1.0, 3.0, 81)  # in units of m/T
_CLEAR = 1e-6  # a radius that is as much below 1
_LIKELY = 4  # stiffer walls of a range that are judged

Wall = tuple[float, ...]


def rows(small: bool) -> Iterator[Row]:
    rng = np.random.default_rng(20121)
    yield _margins(rng, _SMALL_WALLS if small else _WALLS)
    yield _limits(rng, _SMALL_RANGES if small else _RANGES)
    for name, campaign in (
        ("margins_filtered", filtered_ranges.margins),
        ("margins_devices", filtered_ranges.device_margins),
    ):
        tally, seconds = campaign(rng, _SMALL_WALLS if small else _WALLS)
        yield _row(name, tally.wrong / max(tally.judged, 1), seconds, **tally._asdict())


class Judged(NamedTuple):
    """How many margins of a wall were judged, are too long, too short, and by which share."""

    judged: int
    wrong: int
    short: int
    shortest: float


def judged_margins(wall: Wall, steps: np.ndarray) -> Judged:
    """Judge the steps of a wall, one for each of ``WAYS``."""
    wrong, missing = 0, []
    for (axis, sign), step in zip(WAYS, steps, strict=True):
        way = sign * min(abs(step), _FARTHEST)
        wrong += sum(not _is_stable(wall, axis, part * way) for part in _PARTS)
        missing.append(_missing(wall, axis, step) if 0.0 < abs(step) < np.inf else 0.0)
    count = len(WAYS) * len(_PARTS)
    return Judged(count, wrong, int(np.count_nonzero(missing)), max(missing, default=0.0))


def is_limit_wrong(
    loop: HapticLoop, hands: HandRange, answer: RobustLimit, rng: np.random.Generator
) -> bool:
    """Whether a hand refutes the proved wall, or a wall the limit."""
    choices = [[*ends, rng.uniform(*ends)] for ends in vars(hands).values() for _ in range(_HANDS)]
    drawn = np.array([rng.choice(ends) for ends in choices]).reshape(3, -1).T
    sample = [answer.loop, *(_held(loop, hand) for hand in drawn)]
    if answer.is_proved:
        gains = np.array([[answer.stiffness]]), np.array([answer.damping])
        one = sample[int(np.argmax([_radii(one, *gains).item() for one in sample]))]
        wall = one.alpha(answer.stiffness), one.beta(answer.damping)
        if not _is_stable((*wall, one.gamma, one.delta, one.delay_samples)):
            return True
    if not answer.limit > 0.0:
        return False
    stiffness, damping = answer.limit * _STIFFER[:, None], loop.damping(_DAMPINGS)
    corners = np.unique(
        np.stack(np.meshgrid(*vars(hands).values()), axis=-1).reshape(-1, 3), axis=0
    )
    few = [*sample[:_FEW], *(_held(loop, corner) for corner in corners)]
    tops = [one.limits() for one in few]
    walls = [((1.0 - _CLEAR) * top.stiffness, top.at_damping) for top in tops]
    if any(
        loop.worst_hand(hands, *wall).verdict == Verdict.STABLE
        for wall in walls
        if wall[0] > answer.limit
    ):
        return True
    radii = np.max([_radii(one, stiffness, damping) for one in few], axis=0)
    likely = np.argsort(radii, axis=None)[:_LIKELY]
    for row, column in zip(*np.unravel_index(likely, radii.shape), strict=True):
        if radii[row, column] < 1.0 - _CLEAR:
            wall = float(stiffness[row, 0]), float(damping[column])
            if loop.worst_hand(hands, *wall).verdict == Verdict.STABLE:
                return True
    return False


def _row(name: str, error: float, seconds: list[float], **extra: int | float) -> Row:
    return {
        "section": name,
        "method": name,
        "delay": 8.0,
        "points": 1,
        "repeats": len(seconds),
        "seconds": float(np.median(seconds)),
        "seconds_quartiles": np.quantile(seconds, (0.25, 0.75)).tolist(),
        "error": error,
        "error_measure": "share of answers that are wrong, by certified root counts",
        **extra,
    }


def _margins(rng: np.random.Generator, count: int) -> Row:
    seconds: list[float] = []
    tallies: list[Judged] = []
    while len(tallies) < count:
        wall = _random_wall(rng)
        start = process_time()
        code, *found = first_crossings(np.array([wall]))[0]
        seconds.append(process_time() - start)
        if code == Verdict.STABLE:
            tallies.append(
                judged_margins(wall, filtered_ranges.steps_to(found[::2], np.array(wall)))
            )
    judged, wrong, short = (sum(column) for column in list(zip(*tallies, strict=True))[:3])
    shortest = max(tally.shortest for tally in tallies)
    counts = {"judged": judged, "wrong": wrong, "short": short, "shortest": shortest}
    return _row("margins", wrong / judged, seconds, **counts)


def _limits(rng: np.random.Generator, count: int) -> Row:
    seconds, wrong, proved = [], 0, 0
    for _ in range(count):
        loop, hands = _random_range(rng)
        start = process_time()
        answer = loop.robust_limit(hands)
        seconds.append(process_time() - start)
        proved += answer.is_proved
        wrong += is_limit_wrong(loop, hands, answer, rng)
    return _row("robust_limit", wrong / count, seconds, judged=count, wrong=wrong, proved=proved)


def _is_stable(point: Wall, axis: int = 0, step: float = 0.0) -> bool:
    """Whether no root is outside; where that cannot be told, on the circle, it is not stable."""
    moved = [value + step * (number == axis) for number, value in enumerate(point)]
    return truth.unstable_count(*map(float, moved)) == 0


def _missing(wall: Wall, axis: int, step: float) -> float:
    """The largest share of the way by which it could be longer, if rounding does not hide it."""
    missing = 0.0
    for part in _FARTHER:
        if not _is_stable(wall, axis, (1.0 + part) * step):
            break
        farther = [v + (1.0 + part) * step * (n == axis) for n, v in enumerate(wall)]
        if _smallest_on_circle(farther) > _ROUNDING * (1.0 + wall[-1]):
            missing = part
    return missing


def _smallest_on_circle(point: list[float]) -> float:
    """The smallest |p(z)| on the circle, in terms of the largest coefficient."""
    coefficients = np.array([float(part) for part in truth.polynomial(*point)])
    low, high = 0.0, np.pi
    for _ in range(5):
        theta = np.linspace(low, high, 2001)
        values = np.abs(np.polyval(coefficients, np.exp(1j * theta)))
        best, width = theta[np.argmin(values)], (high - low) / 500
        low, high = max(best - width, 0.0), min(best + width, np.pi)
    return float(values.min() / np.abs(coefficients).max())


def _radii(loop: HapticLoop, stiffness: np.ndarray, damping: np.ndarray) -> np.ndarray:
    plant = loop.gamma, loop.delta, loop.delay_samples
    walls = characteristic_polynomial(loop.alpha(stiffness), loop.beta(damping), **by_name(*plant))
    return largest_modulus(np.linalg.eigvals(companion_matrix(walls)))


def _random_wall(rng: np.random.Generator) -> Wall:
    """A loop with a wall in its stable region, or near the region's boundary."""
    nyquist = (np.pi * rng.integers(1, 5)) ** 2
    hands = 10 ** rng.uniform(-6, 0), nyquist * rng.uniform(0.99, 1.01), rng.uniform(0, 20)
    gamma = float(rng.choice(hands))
    delta = float(rng.choice([10 ** rng.uniform(-4, 0), rng.uniform(0, 2)]))
    delay = float(rng.choice([rng.integers(0, 8), rng.uniform(0, 8)]))
    region = stable_region(gamma=gamma, delta=delta, delay=delay)
    edge = region.points[np.isfinite(region.points[:, 0])]
    if region.status != RegionStatus.COMPLETE or len(edge) < 2:
        return _random_wall(rng)
    one, other = edge[rng.integers(len(edge), size=2)]
    part = rng.choice([rng.uniform(), 10 ** rng.uniform(-9, -1)])
    alpha, beta = one + part * (other - one)
    return float(alpha), float(beta), gamma, delta, delay


def _random_range(rng: np.random.Generator) -> tuple[HapticLoop, HandRange]:
    loop = HapticLoop(
        device_mass=1.0,
        device_damping=float(10 ** rng.uniform(-2, 0)),
        sample_time=1.0,
        delay=float(rng.choice([0.0, 0.5, 1.0, rng.uniform(0, 3)])),
    )
    stiffest = rng.choice([10 ** rng.uniform(-3, 0), rng.uniform(1, 12)])
    ends = rng.uniform(0, 3), stiffest, rng.uniform(0, 1)
    ranges = [(0.0, float(end * rng.integers(0, 2))) for end in ends]
    return loop, HandRange(mass=ranges[0], stiffness=ranges[1], damping=ranges[2])


def _held(loop: HapticLoop, hand: np.ndarray | list[float]) -> HapticLoop:
    mass, stiffness, damping = map(float, hand)
    return replace(loop, hand_mass=mass, hand_stiffness=stiffness, hand_damping=damping)
