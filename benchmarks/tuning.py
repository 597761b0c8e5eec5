"""Random plants: do the gains of ``minimize_radius`` have their radius, and are they the best?

Hands are weak and stiff, beyond the Nyquist frequency and next to its multiples, a part of them
without damping; delays from 0 to 8, half of them whole. Three judges, none of which shares the
search: certified roots of p at the gains (``not_reached``: they are more than 0.1 % larger than
the radius), the region of all gains with a radius 0.1 % smaller (``region_below``: it is not
empty), and a random descent over the gains with eigenvalues of polynomials of 50 digits
(``beaten``: by more than 0.1 %). ``missed`` counts plants of NO_STABLE_GAINS with a stable region.
``error`` is the largest share by which the descent did better.

Random loops with estimators and filters are judged alike: there the descents stay in the component
of small gains, whose outline matplotlib knows, and what they find is certified. Slow filters of
high order have regions of which float64 proves no wall: none of those is missed.

Walls (K >= 0, B >= 0) of ordinary loops are those of ``HapticLoop.tune("radius")``: descents that
start from them, from their edges and anywhere in the component do better by up to ``error``; the
status SCANNED says how much that was.
"""

from collections.abc import Iterator
from time import process_time
from typing import NamedTuple

import numpy as np
from matplotlib.path import Path

from benchmarks import truth
from benchmarks.record import Row
from benchmarks.truth.filtered import FilteredLoop, average, difference, times
from benchmarks.truth.filtered import low_pass as filtered_low_pass
from benchmarks.truth.random_loops import Filters, MassLoop
from jaxstab import Filter, HapticLoop, Velocity, Verdict, verdict
from jaxstab.model import by_name
from jaxstab.region import StableRegion, stable_region
from jaxstab.tuning import TuningStatus, minimize_radius

MEASURE = "largest share by which a random descent found a smaller radius"

_CLASSES = ((0, 3, 500), (3, 9, 500))  # delays, how many plants
_FILTERED = 300  # loops with estimators and filters
_WALLED = 1000  # ordinary loops of which the best wall is asked
_ALLOWED, _CERTIFIED = 1e-3, 1e-6
_WALLS = 500  # tried for one that is proved
_STEPS, _TRIALS = 60, 60  # of a descent
_SPREADS = (-6.0, 0.3)  # decades of the steps beside the size of the gains

Plant = tuple[float, float, float]


class Tally(NamedTuple):
    """What became of one plant."""

    status: TuningStatus
    not_reached: bool
    region_below: bool
    missed: bool
    gain: float  # the share by which the descent did better
    seconds: float


def rows(small: bool) -> Iterator[Row]:
    for first, stop, count in _CLASSES[:1] if small else _CLASSES:
        rng = np.random.default_rng([20120412, stop])
        plants = [random_plant(rng, first, stop) for _ in range(4 if small else count)]
        yield _row("minimize_radius", stop - 1, [tally(plant, rng) for plant in plants])
    rng = np.random.default_rng([20120412, 0])
    loops = [MassLoop.drawn(rng) for _ in range(2 if small else _FILTERED)]
    tallies = [filtered_tally(loop, rng) for loop in loops]
    yield _row("minimize_radius with filters", max(loop.plant[2] for loop in loops), tallies)
    rng = np.random.default_rng([20120412, 1])
    tallies = [wall_tally(ordinary_loop(rng), rng) for _ in range(4 if small else _WALLED)]
    yield _row("HapticLoop.tune", 3.0, tallies)


def _row(section: str, delay: float, tallies: list[Tally]) -> Row:
    seconds = [one.seconds for one in tallies]
    return {
        "section": section,
        "method": "minimize_radius",
        "delay": delay,
        "points": 1,
        "seconds": float(np.median(seconds)),
        "seconds_quartiles": np.quantile(seconds, (0.25, 0.75)).tolist(),
        "repeats": len(tallies),
        "error": max(0.0, *(one.gain for one in tallies)),
        "error_measure": MEASURE,
        "beaten": sum(one.gain > _ALLOWED for one in tallies),
        **{
            name: sum(getattr(one, name) for one in tallies)
            for name in ("not_reached", "region_below", "missed")
        },
        **{s.name.lower(): sum(one.status == s for one in tallies) for s in TuningStatus},
    }


def random_plant(rng: np.random.Generator, first: int, stop: int) -> Plant:
    """Return gamma, delta and a delay from first to below stop."""
    nyquist = (np.pi * rng.integers(1, 4)) ** 2
    gamma = rng.choice(
        [
            0.0,
            10 ** rng.uniform(-6, 0),
            10 ** rng.uniform(0, 2),
            nyquist * (1 + rng.choice([-1, 1]) * 10 ** rng.uniform(-4, -1)),
        ]
    )
    delta = rng.choice(
        [0.0, 10 ** rng.uniform(-5, 0), 10 ** rng.uniform(-1, 1)], p=[0.15, 0.6, 0.25]
    )
    delay = rng.choice([float(rng.integers(first, stop)), rng.uniform(first, stop - 1)])
    return float(gamma), float(delta), float(delay)


def tally(plant: Plant, rng: np.random.Generator) -> Tally:
    """Judge one plant."""
    start = process_time()
    best = minimize_radius(**by_name(*plant))
    seconds = process_time() - start
    status, value = TuningStatus(int(best.status)), float(best.value)
    if status == TuningStatus.NO_STABLE_GAINS:
        missed = not stable_region(**by_name(*plant)).is_empty
        return Tally(status, False, False, missed, 0.0, seconds)
    gains = np.array([float(best.alpha), float(best.beta)])
    reached = float(truth.spectral_radius(*gains.tolist(), *plant)[1])
    below = stable_region(**by_name(*plant), radius=value * (1.0 - _ALLOWED))
    found = min(
        descent(family(plant), start, rng)[0]
        for start in (gains, np.zeros(2), rng.normal(size=2) * max(1.0, plant[0], *abs(gains)))
    )
    too_large = reached > value * (1.0 + _ALLOWED)
    return Tally(status, too_large, len(below.points) > 0, False, 1.0 - found / value, seconds)


def filtered_tally(loop: MassLoop, rng: np.random.Generator) -> Tally:
    """Judge one loop with an estimator and a filter."""
    velocity, position, truths = loop.filters
    exact = FilteredLoop(*loop.plant, *truths)
    region = loop.region()
    start = process_time()
    best = minimize_radius(**by_name(*loop.plant), velocity=velocity, position=position)
    seconds = process_time() - start
    status, value = TuningStatus(int(best.status)), float(best.value)
    main = region.main
    if status == TuningStatus.NO_STABLE_GAINS:
        missed = main is not None and _has_a_proved_wall(loop, main, rng)
        return Tally(status, False, False, missed, 0.0, seconds)
    gains = np.array([float(best.alpha), float(best.beta)])
    too_large = float(exact.radius(*gains.tolist()).mid()) > value * (1.0 + _ALLOWED)
    if main is None:  # an island, or a region that is not resolved: nothing is claimed
        return Tally(status, too_large, False, False, 0.0, seconds)
    walls = [(0, 0), (1, 0), (0, 1)]
    base, alpha, beta = (
        np.array([float(c.mid()) for c in exact.polynomial(*wall)]) for wall in walls
    )
    parts, points = np.stack([base, alpha - base, beta - base]), main.points
    starts = gains, 0.1 * gains, 0.9 * points[rng.integers(len(points))]
    descents = [descent(parts, start, rng, Path(points)) for start in starts]
    certified = [
        float(exact.radius(*found.tolist()).mid())
        for least, found in descents
        if least < value * (1.0 - _ALLOWED)
    ]
    return Tally(status, too_large, False, False, 1.0 - min([value, *certified]) / value, seconds)


def ordinary_loop(rng: np.random.Generator) -> MassLoop:
    """A hand, a delay of up to 3 samples and filters as devices have them."""
    plant = (
        float(rng.choice([0.0, 10 ** rng.uniform(-6, -1)])),
        float(10 ** rng.uniform(-4, -0.5)),
        float(rng.choice([float(rng.integers(4)), rng.uniform(0, 3)])),
    )
    cutoff, order, samples = 10 ** rng.uniform(-1.7, -0.6), int(rng.integers(1, 3)), rng.integers(5)
    length = int(rng.integers(1, 11))
    velocity, truth_of_it = (
        (Velocity.difference(length), difference(length)),
        (
            Velocity.low_pass(cutoff, order=order),
            times(difference(1), filtered_low_pass(cutoff, order)),
        ),
    )[rng.integers(2)]
    position = Filter.average(2 + int(samples)) if samples < 2 else Filter()
    whole = average(2 + int(samples)) if samples < 2 else average(1)
    return MassLoop(plant, Filters(velocity, position, (truth_of_it, whole)))


def wall_tally(loop: MassLoop, rng: np.random.Generator) -> Tally:
    """Judge the wall of the smallest radius of one loop, in units of one sample and of the mass."""
    velocity, position, truths = loop.filters
    gamma, delta, delay = loop.plant
    asked = HapticLoop(
        device_mass=1.0, device_damping=delta, hand_stiffness=gamma, sample_time=1.0, delay=delay,
        velocity=velocity, position=position,
    )  # fmt: skip
    exact, main = FilteredLoop(*loop.plant, *truths), loop.region().main
    start = process_time()
    best = asked.tune("radius")
    seconds = process_time() - start
    if best.status != TuningStatus.SCANNED and best.stiffness > 0.0 < best.damping:
        return Tally(best.status, False, False, False, 0.0, seconds)  # judged above
    points = np.empty((0, 2)) if main is None else main.points[np.all(main.points >= 0.0, axis=1)]
    if best.status == TuningStatus.NO_STABLE_GAINS or not len(points):
        return Tally(best.status, False, False, len(points) > 0, 0.0, seconds)
    walls = [(0, 0), (1, 0), (0, 1)]
    base, alpha, beta = (
        np.array([float(c.mid()) for c in exact.polynomial(*wall)]) for wall in walls
    )
    parts, gains = np.stack([base, alpha - base, beta - base]), np.array(best[:2])
    anywhere = 0.9 * points[rng.integers(len(points), size=3)]
    starts = [gains, gains * [0.0, 1.0], gains * [1.0, 0.0], *anywhere, *(anywhere * [0.0, 1.0])]
    outline = Path(main.points)
    least, wall = min(
        (descent(parts, each, rng, outline, lowest=0.0) for each in starts), key=lambda one: one[0]
    )
    found = best.radius
    if least < found * (1.0 - _CERTIFIED):
        found = float(exact.radius(*wall.tolist()).mid())
    return Tally(best.status, False, False, False, max(0.0, 1.0 - found / best.radius), seconds)


def _has_a_proved_wall(loop: MassLoop, main: StableRegion, rng: np.random.Generator) -> bool:
    low, high = main.points.min(axis=0), main.points.max(axis=0)
    walls = (low + (high - low) * rng.random((_WALLS, 2))).T
    velocity, position, _ = loop.filters
    codes = verdict(*walls, **by_name(*loop.plant), velocity=velocity, position=position)
    return bool(np.any(main.contains(*walls) & (codes == Verdict.STABLE)))


def family(plant: Plant) -> np.ndarray:
    """Return p without a wall, and what a unit of alpha and of beta adds."""
    walls = [(0, 0), (1, 0), (0, 1)]
    base, alpha, beta = (np.array(truth.polynomial(*wall, *plant)) for wall in walls)
    return np.stack([base, alpha - base, beta - base]).astype(float)


def descent(
    polynomials: np.ndarray,
    start: np.ndarray,
    rng: np.random.Generator,
    outline: Path | None = None,
    lowest: float = -np.inf,
) -> tuple[float, np.ndarray]:
    """Return the smallest radius of a random walk, and its gains, inside of an outline."""
    gains, least = start, np.inf
    size = max(*np.abs(start), 0.1 / polynomials.shape[1] ** 2)
    for step in range(_STEPS + 1):
        spread = 10 ** rng.uniform(*_SPREADS, (_TRIALS, 1)) * (step > 0)
        trials = np.maximum(gains + size * spread * rng.normal(size=(_TRIALS, 2)), lowest)
        values = radii(polynomials, trials)
        if outline is not None:
            values[~outline.contains_points(trials, radius=1e-12)] = np.inf
        if values.min() < least:
            gains, least = trials[np.argmin(values)], values.min()
    return float(least), gains


def radii(polynomials: np.ndarray, gains: np.ndarray) -> np.ndarray:
    """Return the largest modulus of the eigenvalues for gains (n, 2)."""
    coefficients = polynomials[0] + gains @ polynomials[1:]
    size = coefficients.shape[1] - 1
    companion = np.tile(np.eye(size, k=-1), (len(gains), 1, 1))
    companion[:, 0, :] = -coefficients[:, 1:]
    return np.max(np.abs(np.linalg.eigvals(companion)), axis=1)
