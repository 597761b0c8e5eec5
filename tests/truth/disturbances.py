"""Random loops with estimators, driven by the worst signals and by simulated encoders and forces.

Each loop is driven by the worst signals of errors, forces and friction that are known, and by a
quantised encoder and a quantised force from many starts and phases of the encoder, of which the
furthest are varied.
"""

from typing import Any

import numpy as np

from jaxstab import Filter, Velocity, amplitude, stable_region
from jaxstab.model import by_name
from jaxstab.point import spectral_radius
from tests.truth.disturbed import Disturbance, Disturbed, largest, worst_signals
from tests.truth.march import Taps, butterworth_taps, difference_taps, low_pass_taps

_SLOWEST = 0.99  # spectral radius: runs are long enough to come to rest
_DECAYED = 1e-6  # of a start: how long runs are
_FAR = 30.0  # encoder counts: the largest position at the start
_ROUNDS = 5  # of a search

Case = tuple[dict[str, Any], Disturbed]


def excess_of_signals(filters: dict[str, Any], loop: Disturbed) -> tuple[float, float]:
    """The largest share of a bound that a signal reaches, and the bound over it for the position.

    Encoder, force and friction each alone, and all at once.
    """
    samples = _samples(filters, loop)
    causes = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.02, 0.003)
    excess, tight = 0.0, []
    for error, push, rub in causes:
        bound = np.array(
            amplitude(
                *loop.wall, **by_name(*loop.plant),
                encoder=2.0 * error, force_step=2.0 * push, friction=rub,
                **filters,
            )[:3]
        )  # fmt: skip
        reached = worst_signals(loop, samples, (error, push, rub)).max(axis=0)
        excess = max(excess, float((reached / bound).max()))
        tight.append(float(bound[0] / reached[0]))
    return excess, max(tight)


def excess_of_runs(
    filters: dict[str, Any], loop: Disturbed, runs: int, rng: np.random.Generator
) -> tuple[float, float]:
    """The largest share of a bound that runs reach, and the bound over it for the position.

    Half of the runs search with an encoder alone: after some at random those that went furthest are
    varied. The other half has a quantised force, too.
    """
    both = loop.wall[0] * 10.0 ** rng.uniform(-2.0, 1.0)
    alone, share = _searched(filters, loop, runs // 2, 0.0, rng)
    together, _ = _searched(filters, loop, runs - runs // 2, float(both), rng)
    return max(alone, together), share


def _searched(
    filters: dict[str, Any], loop: Disturbed, runs: int, step: float, rng: np.random.Generator
) -> tuple[float, float]:
    samples = _samples(filters, loop)
    proved = amplitude(*loop.wall, **by_name(*loop.plant), encoder=1.0, force_step=step, **filters)
    bound = np.array(proved[:3])
    count = runs // _ROUNDS
    states = _random_starts(loop, count, rng)
    worst, best = np.zeros(3), (np.zeros(0), np.zeros((3, 0)))
    for _ in range(_ROUNDS):
        disturbance = Disturbance(phase=states[2], force_step=step)
        reached = largest(loop, disturbance, states[:2], samples)
        worst = np.maximum(worst, reached.max(axis=1))
        known = np.append(best[0], reached[0]), np.append(best[1], states, axis=1)
        order = np.argsort(known[0])[-max(3, count // 10) :]
        best = known[0][order], known[1][:, order]
        varied = best[1][:, rng.integers(order.size, size=count)]
        states = varied * (
            1.0 + 10.0 ** rng.uniform(-4.0, 0.0, count) * rng.normal(size=(3, count))
        )
    return float(np.max(worst / bound)), float(bound[0] / worst[0])


def _random_starts(loop: Disturbed, count: int, rng: np.random.Generator) -> np.ndarray:
    """Positions, velocities and phases of the encoder."""
    starts = rng.uniform(-1.0, 1.0, (3, count))
    starts[:2] *= 10.0 ** rng.uniform(-1.0, np.log10(_FAR), count)
    starts[1] *= np.sqrt(loop.wall[0])
    starts[2] *= 0.5
    return starts


def _samples(filters: dict[str, Any], loop: Disturbed) -> int:
    """How many samples a start takes to decay."""
    radius = float(spectral_radius(*loop.wall, **by_name(*loop.plant), **filters).value)
    return round(np.log(_DECAYED) / np.log(radius)) + 50


def random_case(rng: np.random.Generator) -> Case:
    """A stable loop with an estimator, perhaps a filter, that comes to rest soon enough."""
    while True:
        filters, velocity, position = _random_filters(rng)
        gamma = float(rng.choice([0.0, 10.0 ** rng.uniform(-6.0, -1.0)]))
        delta = 10.0 ** rng.uniform(-4.0, -1.0)
        delay = float(rng.choice([0.0, 1.0, 2.0, rng.uniform(0.0, 2.5)]))
        region = stable_region(gamma=gamma, delta=delta, delay=delay, **filters)
        if region.is_empty or not np.isfinite(region.max_alpha[0]):
            continue
        stiffest = region.max_alpha
        wall = stiffest[0] * rng.uniform(0.05, 0.98), stiffest[1] * rng.uniform(0.5, 1.3)
        radius = spectral_radius(*wall, gamma=gamma, delta=delta, delay=delay, **filters).value
        if radius < _SLOWEST:
            plant = gamma, delta, delay
            return filters, Disturbed((float(wall[0]), float(wall[1])), plant, velocity, position)


def _random_filters(rng: np.random.Generator) -> tuple[dict[str, Any], list[Taps], list[Taps]]:
    kind = rng.choice(["window", "low pass", "Butterworth", "exponential", "chain"])
    samples, cutoff = int(rng.integers(1, 25)), float(rng.uniform(0.02, 0.3))
    if kind == "window":
        velocity, taps = Velocity.difference(samples=samples), [difference_taps(samples)]
    elif kind == "low pass":
        order = int(rng.integers(1, 3))
        velocity = Velocity.low_pass(cutoff, order=order)
        taps = [difference_taps(1), *[low_pass_taps(cutoff)] * order]
    elif kind == "Butterworth":
        order = int(rng.integers(1, 5))
        velocity = Velocity.butterworth(cutoff, order=order)
        taps = [difference_taps(1), *butterworth_taps(cutoff, order)]
    elif kind == "exponential":
        factor = float(rng.uniform(0.1, 0.9))
        velocity = Velocity.exponential(factor)
        taps = [difference_taps(1), ([factor, 0.0], [1.0, factor - 1.0])]
    else:
        velocity = Velocity.difference(samples=samples) * Filter.low_pass(cutoff)
        taps = [difference_taps(samples), low_pass_taps(cutoff)]
    filters: dict[str, Any] = {"velocity": velocity}
    position: list[Taps] = []
    if rng.uniform() < 0.25:
        cutoff = float(rng.uniform(0.1, 0.4))
        filters["position"], position = Filter.low_pass(cutoff), [low_pass_taps(cutoff)]
    return filters, [_padded(one) for one in taps], position


def _padded(taps: Taps) -> Taps:
    length = max(map(len, taps))
    above, below = ([*one, *[0.0] * (length - len(one))] for one in taps)
    return above, below
