"""The truth of lemma J1: what a late or early force leaves, by sums over aliases."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np


def late_energy(
    above: Sequence[float],
    below: Sequence[float],
    period: float,
    theta: float,
    delay: float,
    jitter: float,
    turns: int = 4000,
) -> float:
    """Return J times the integral of N |Y|^2 over a sample (lemma J1), by sums over aliases.

    Y is the transform of the samples after an impulse of force at a time; ``above`` and ``below``
    are the coefficients of position over force in s, highest power first, delay and jitter in
    samples.
    """
    angles = theta + 2.0 * np.pi * np.arange(-turns, turns + 1)
    gains = np.polyval(above, 1j * angles / period) / np.polyval(below, 1j * angles / period)
    nodes, weights = np.polynomial.legendre.leggauss(24)
    whole, total = int(jitter), 0.0
    ends = sorted({delay, delay + jitter - whole, np.floor(delay) + 1.0, delay + 1.0})  # kinks
    for first, last in pairwise(ends):
        times = 0.5 * (first + last) + 0.5 * (last - first) * nodes
        impulses = np.exp(-1j * np.outer(times, angles)) @ gains
        changes = whole + (last <= delay + jitter - whole)
        total += changes * 0.5 * (last - first) * float(weights @ np.abs(impulses) ** 2)
    return jitter * total
