"""Boxes that hold a root on the circle, and whether they are called free of roots."""

from math import pi

import numpy as np
import pytest

from jaxstab import Filter, Velocity
from jaxstab.proofs.exclusion import Loops, exclude
from jaxstab.region import boundary_curve


def smoothed(z):
    """The difference over one sample behind a pole at 0.6."""
    return (1 - 1 / z) * 0.4 / (1 - 0.6 / z)


@pytest.mark.parametrize(
    ("velocity", "response"),
    [
        (Velocity(), lambda z: 1 - 1 / z),
        (Velocity.difference(samples=7), lambda z: (1 - z**-7) / 7),
        (Velocity.exponential(0.4), smoothed),
    ],
    ids=["difference", "window of 7", "smoothed"],
)
def test_no_box_that_holds_a_root_is_called_free(rng, velocity, response):
    count = 20_000
    gamma = rng.uniform(0, 12, count) * rng.choice([0, 1e-3, 0.1, 1], count)
    delta = rng.uniform(0, 3, count) * rng.choice([0, 0.01, 1], count)
    delay = np.where(rng.random(count) < 0.3, rng.integers(0, 4, count), rng.uniform(0, 4, count))
    theta = rng.uniform(0, pi, count)
    alpha, beta = (
        np.asarray(v) for v in boundary_curve(theta, gamma=gamma, delta=delta, delay=delay)
    )
    z = np.exp(1j * theta)
    wall, by_velocity = alpha + beta * (1 - 1 / z), response(z)
    beta = wall.imag / by_velocity.imag
    alpha = wall.real - beta * by_velocity.real
    loops = np.stack([alpha, beta, gamma, delta, delay, theta])
    loops = loops[:, np.abs(loops[:2]).max(axis=0) < 50]
    count = loops.shape[1]
    size = 10.0 ** rng.uniform(-6, 0.5, count)
    radius = rng.uniform(0, 1, (6, count)) * size * rng.choice([0, 0.01, 1], (6, count))
    center = loops + radius * rng.uniform(-1, 1, (6, count))
    center[2:5] = np.maximum(center[2:5], 0.0)
    radius = np.maximum(radius, np.abs(center - loops) * (1 + 1e-12))
    filters = None if velocity == Velocity() else (velocity, Filter())
    away = center + np.array([[5.0], [0], [0], [0], [0], [0]])
    with np.errstate(invalid="ignore"):  # beyond the angles at which filters are known
        is_free = exclude(Loops(*center), Loops(*radius), filters).free
        is_clear = exclude(Loops(*away), Loops(*(1e-3 * radius)), filters).free
    assert not np.any(is_free)
    assert np.mean(is_clear) > 0.5
