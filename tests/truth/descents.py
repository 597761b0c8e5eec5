"""Random descents over the gains of a loop, which share nothing with the searches of tuning."""

import numpy as np
from matplotlib.path import Path

from jaxstab import Filter, HapticLoop, Velocity
from jaxstab.tuning import TuningStatus
from tests.truth.filtered import FilteredLoop, average, difference, times
from tests.truth.filtered import low_pass as filtered_low_pass
from tests.truth.random_loops import Filters, MassLoop

_CERTIFIED = 1e-6  # a radius that is smaller by this share is computed in balls
_STEPS, _TRIALS = 60, 60  # of a descent
_SPREADS = (-6.0, 0.3)  # decades of the steps beside the size of the gains


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


def better_wall(loop: MassLoop, rng: np.random.Generator) -> float:
    """By which share descents find a smaller radius than ``tune``, in units of one sample.

    They start from its wall, from the edges and anywhere in the component; infinite where it finds
    no wall and there is one.
    """
    velocity, position, truths = loop.filters
    gamma, delta, delay = loop.plant
    asked = HapticLoop(
        device_mass=1.0, device_damping=delta, hand_stiffness=gamma, sample_time=1.0, delay=delay,
        velocity=velocity, position=position,
    )  # fmt: skip
    exact, main = FilteredLoop(*loop.plant, *truths), loop.region().main
    best = asked.tune("radius")
    if best.status != TuningStatus.SCANNED and best.stiffness > 0.0 < best.damping:
        return 0.0  # the best gains, of which other tests ask
    points = np.empty((0, 2)) if main is None else main.points[np.all(main.points >= 0.0, axis=1)]
    if best.status == TuningStatus.NO_STABLE_GAINS or not len(points):
        return np.inf if len(points) else 0.0
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
    return max(0.0, 1.0 - found / best.radius)


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
