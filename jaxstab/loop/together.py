"""Batched evaluation of (loop, wall) pairs.

Loops of one mass with the same estimator and filter are points of one array. Any other loop is
evaluated by itself, at all of its walls.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float64, Int8

from jaxstab import motion, point, ranges
from jaxstab.arrays import tree_map
from jaxstab.batches import alike
from jaxstab.loop.loop import HapticLoop
from jaxstab.loop.region import Gains
from jaxstab.model import by_name
from jaxstab.motion import Amplitude, Oscillation, Settling
from jaxstab.motion.settling import SettlingTime, settling_at_levels
from jaxstab.point import SpectralRadius
from jaxstab.ranges import Margins, WallMargins

Answer = TypeVar("Answer")
Column = Float64[np.ndarray, " wall"]


class Rendered(NamedTuple):
    """A wall, and the loop that renders it."""

    loop: HapticLoop
    gains: Gains


Walls = Sequence[Rendered]


class _Points(NamedTuple):
    """Walls of loops of one mass that have the same estimator and filter."""

    numbers: dict[str, Any]  # alpha, beta, gamma, delta, delay, velocity and position
    mass: Column
    period: Column


def verdicts(walls: Walls) -> Int8[np.ndarray, " wall"]:
    """Return ``HapticLoop.verdict`` of each wall."""
    return _batched(walls, lambda points: point.verdict(**points.numbers), HapticLoop.verdict)


def spectral_radii(walls: Walls) -> SpectralRadius:
    """Return ``HapticLoop.spectral_radius`` of each wall."""

    def of_points(points: _Points) -> SpectralRadius:
        return point.spectral_radius(**points.numbers)

    return _batched(walls, of_points, HapticLoop.spectral_radius)


def oscillations(walls: Walls) -> Oscillation:
    """Return ``HapticLoop.oscillation`` of each wall."""

    def of_points(points: _Points) -> Oscillation:
        ratio, frequency = motion.dominant_mode(**points.numbers)
        return Oscillation(ratio, frequency / (2.0 * np.pi * points.period))

    return _batched(walls, of_points, HapticLoop.oscillation)


def boundary_distances(walls: Walls) -> Column:
    """Return ``HapticLoop.boundary_distance`` of each wall: each loop has another boundary."""
    return _batched(walls, None, HapticLoop.boundary_distance)


def wall_margins(walls: Walls) -> Margins:
    """Return ``HapticLoop.margins`` of each wall."""

    def of_points(points: _Points) -> WallMargins:
        margins = ranges.margins(**points.numbers)
        return WallMargins(
            margins.verdict,
            margins.stiffness * (points.mass / points.period**2)[:, None],
            margins.damping * (points.mass / points.period)[:, None],
            margins.stiffness_gain,
            margins.damping_gain,
            points.period * margins.extra_delay,
        )

    return _batched(walls, of_points, HapticLoop.margins)


def settling_times(walls: Walls, levels: Sequence[float], horizon: int) -> list[Settling]:
    """Return ``HapticLoop.settling_time`` of each wall, for each level."""

    def of_points(points: _Points) -> list[Settling]:
        settlings = settling_at_levels(**points.numbers, levels=levels, horizon=horizon)
        return [SettlingTime(count * points.period, status) for count, status in settlings]

    def of_loop(loop: HapticLoop, *gains: Column) -> list[Settling]:
        return [loop.settling_time(*gains, level=level, horizon=horizon) for level in levels]

    return _batched(walls, of_points, of_loop)


def amplitudes(walls: Walls, encoder: Column) -> Amplitude:
    """Return ``HapticLoop.amplitude`` of each wall, each with a resolution of the position in m."""

    def of_points(points: _Points, encoder: Column) -> Amplitude:
        amplitude = motion.amplitude(**points.numbers, encoder=encoder)
        unit = points.mass / points.period**2  # N that are 1 where 1 m is
        return amplitude._replace(
            velocity=amplitude.velocity / points.period,
            force=amplitude.force * unit,
            force_per_count=amplitude.force_per_count * unit,
        )

    return _batched(walls, of_points, HapticLoop.amplitude, encoder=encoder)


def _batched(
    walls: Walls,
    of_points: Callable[..., Answer] | None,
    of_loop: Callable[..., Answer],
    **columns: Column,
) -> Answer:
    """Arrays over the walls, joined from those of groups of walls.

    One function takes points, the other a loop, stiffnesses and dampings; both take columns.
    """
    groups = alike(
        loop if of_points is None or loop.body is None else tuple(loop.filters.values())
        for loop, _ in walls
    )
    answers = []
    for indices in groups:
        group = [walls[index] for index in indices]
        values = {name: column[indices] for name, column in columns.items()}
        loop, gains = group[0].loop, np.array([gains for _, gains in group]).T
        if of_points is None or loop.body is None:
            answers.append(of_loop(loop, *gains, **values))
        else:
            answers.append(of_points(_points(group, *gains), **values))
    order = np.argsort(np.concatenate(groups))
    return tree_map(lambda *parts: np.concatenate(parts)[order], *answers)


def _points(walls: Walls, stiffness: Column, damping: Column) -> _Points:
    plants = {
        loop: (loop.mass, loop.sample_time, *loop.slice.values())
        for loop in dict.fromkeys(loop for loop, _ in walls)
    }
    mass, period, *plant = np.array([plants[loop] for loop, _ in walls]).T
    alpha, beta = stiffness * (period**2 / mass), damping * (period / mass)
    return _Points(by_name(alpha, beta, *plant) | walls[0].loop.filters, mass, period)
