"""The grid of a guard: limits at its nodes, its loops over boxes in cells, and the exact limits."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from jaxstab.boxes import HandRange
from jaxstab.boxes.enclosures import THETA, LinearModel, ParameterBoxes, Rows
from jaxstab.boxes.hands import arms_over, spread_hands
from jaxstab.boxes.plant import Arms, DeviceBoxes, Extent, FirstRow, HeldDevice
from jaxstab.model import Device, LoopParameters
from jaxstab.model.filters import NO_FILTERS, known_filters
from jaxstab.region.closed_form import responses_at

Ends = Float64[np.ndarray, "axis box"]  # in cells

CELL_AXES = "mass", "delay", "damping"  # the axes that are in cells
_SLACK = 1e-9  # of the largest value: more than the arithmetic of the header rounds


class Grid(NamedTuple):
    """Limits at nodes, between which a guard interpolates linearly in mass, delay and damping.

    The nodes of mass in kg and of delay in samples are evenly spaced. ``top`` is the largest
    damping in N s/m, ``limit`` the largest stiffness in N/m at evenly spaced dampings from 0 to
    that one. Where the delay moves, both nodes of the delay are the shortest one, and ``jitter`` is
    by how many samples a delay may be longer.
    """

    mass: Float64[np.ndarray, " mass"]
    delay: Float64[np.ndarray, " delay"]
    top: Float64[np.ndarray, "mass delay"]
    limit: Float64[np.ndarray, "mass delay damping"]
    jitter: float = 0.0

    @property
    def cells(self) -> tuple[int, int, int]:
        """The number of cells along mass, delay and damping."""
        masses, delays, dampings = (size - 1 for size in self.limit.shape)
        return masses, delays, dampings


def grid_boxes(device: Device, loop: LoopParameters, hands: HandRange, grid: Grid) -> DeviceBoxes:
    """The loops of boxes, each in a cell of a grid, whose walls are those up to its limits.

    The first three axes are in cells; lemma B20 of docs/proofs.md. Errors: as ``DeviceBoxes``.
    """
    count = grid.cells[2]
    begins = np.max(cell_corners(grid.limit[:, :, 0], 2), axis=0)
    period = float(loop.sample_time)

    def limits(boxes: ParameterBoxes, last: Rows) -> tuple[LinearModel, LinearModel]:
        """The largest stiffness and damping, the damping of the boxes between ``last``."""
        (mass, by_mass), (delay, by_delay) = (boxes.ends(name) for name in CELL_AXES[:2])
        low = np.stack([mass - by_mass, delay - by_delay, last[0]])
        high = np.stack([mass + by_mass, delay + by_delay, last[1]])
        top = _model(grid.top, low[:2], high[:2], boxes.axes)
        top = replace(top, rest=top.rest + _SLACK * top.centre)
        limit = _model(grid.limit, low, high, boxes.axes)  # from above, without a rest
        most = limit.centre + limit.rest + _SLACK * float(np.max(grid.limit))
        limit = replace(limit, centre=most, rest=np.zeros_like(limit.rest))
        return limit * period**2, top * period

    def extent(boxes: ParameterBoxes) -> Extent:
        mass, delay = (
            boxes.along(axis, float(nodes[-1] - nodes[0]) / (len(nodes) - 1), float(nodes[0]))
            for axis, nodes in (("mass", grid.mass), ("delay", grid.delay))
        )
        center, half = boxes.ends("damping")
        limit, top = limits(boxes, np.stack([center - half, center + half]))
        arm = arms_over(boxes, hands, period)
        damping = boxes.along("damping", 1.0 / count) * top
        return Extent(mass, delay, arm, limit, damping, boxes.along(THETA))

    def is_first(boxes: ParameterBoxes) -> Bool[np.ndarray, " box"]:
        column = tuple(np.floor(boxes.ends(name)[0]).astype(int) for name in CELL_AXES[:2])
        is_at_0: Bool[np.ndarray, " box"] = boxes.ends("damping")[0] < 1.0
        return is_at_0 & (begins[column] == 0.0)

    def whole_walls(boxes: ParameterBoxes) -> tuple[LinearModel, LinearModel]:
        limit, top = limits(boxes, np.ones((2, boxes.index.size)))
        return limit, top * (1.0 / count)

    mass = float(grid.mass[0]), float(grid.mass[-1])
    arm = hands.stiffness[1], hands.damping[0]
    return DeviceBoxes(
        device, loop, mass, arm, extent, FirstRow(is_first, whole_walls), grid.jitter
    )


def cell_corners(nodes: np.ndarray, axes: int) -> list[np.ndarray]:
    """Return the values at each corner of the cells along the first axes."""
    return [
        nodes[tuple(slice(k, size - 1 + k) for k, size in zip(corner, nodes.shape, strict=False))]
        for corner in np.ndindex(*(2,) * axes)
    ]


def interpolated(nodes: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Return values between nodes at places in cells, (axis, place)."""
    return _at_corners(nodes, (index, index))[0]


def _model(
    nodes: np.ndarray, low: np.ndarray, high: np.ndarray, axes: tuple[str, ...]
) -> LinearModel:
    """Return the model of the interpolation over boxes within one cell."""
    corners = _at_corners(nodes, (low, high))
    signs = np.indices((2,) * len(low)).reshape(len(low), -1) * 2.0 - 1.0
    moves = signs @ corners / corners.shape[0]
    centre = corners.mean(axis=0)
    # Linear in each variable, it is farthest from its model at a corner.
    error = np.max(np.abs(corners - centre - signs.T @ moves), axis=0)
    slope = np.zeros((len(axes), centre.size))
    for name, move in zip(CELL_AXES, moves, strict=False):
        slope[axes.index(name)] = move
    return LinearModel(centre, slope, error)


def _at_corners(nodes: np.ndarray, ends: tuple[Ends, Ends]) -> np.ndarray:
    """Return the interpolation at the corners of boxes within one cell, (corner, box)."""
    low, high = ends
    count = np.array(nodes.shape)[:, None] - 1
    cell = np.clip(np.floor(0.5 * (low + high)).astype(int), 0, count - 1)
    values = np.stack(
        [nodes[tuple(cell + np.array(corner)[:, None])] for corner in np.ndindex(*(2,) * len(cell))]
    ).reshape(*(2,) * len(cell), -1)
    for axis in range(len(cell)):
        lower, upper = np.moveaxis(values, axis, 0)
        parts = [lower + (upper - lower) * (end[axis] - cell[axis]) for end in ends]
        values = np.moveaxis(np.stack(parts), 0, axis)
    corners: np.ndarray = values.reshape(2 ** len(cell), -1)
    return corners


# Where the stable walls of a loop end, for many devices, hands and delays at once. The closed form
# of the boundary is taken at some angles and joined by straight lines; the first nodes of a guard
# come from it. Nothing here is a bound; the proof is in ``jaxstab.guard.build``.

Angles = Float64[np.ndarray, " angle"]
Curves = Float64[np.ndarray, "mass delay hand angle"]


class Boundary(NamedTuple):
    """Walls with a root on the unit circle, for each mass, delay and corner of the hands.

    ``stiffness`` in N/m and ``damping`` in N s/m are of walls with a pair of roots; two consecutive
    points are on one branch where ``joined``. ``line``: the coefficients of K and B of walls with a
    root at -1, and their sum.
    """

    stiffness: Curves
    damping: Curves
    joined: np.ndarray
    line: tuple[Any, Any, np.ndarray]

    def largest_damping(self) -> Float64[np.ndarray, "mass delay"]:
        """Return the damping at which, without stiffness, the first hand becomes unstable."""
        # A hand on a spring that nothing damps is on the circle without a wall: there, both gains
        # change their sign.
        is_damped = self.damping > 0.0
        joined = self.joined & is_damped[..., :-1] & is_damped[..., 1:]
        per_stiffness, per_damping, total = self.line
        line: Any = per_damping, per_stiffness, total
        return _first_gain(self.damping, self.stiffness, joined, line)(np.zeros(joined.shape[:2]))

    def largest_stiffness(
        self, damping: Float64[np.ndarray, "mass delay damping"]
    ) -> Float64[np.ndarray, "mass delay damping"]:
        """Return the stiffness at which, from 0 upwards, the first hand becomes unstable."""
        first = _first_gain(self.stiffness, self.damping, self.joined, self.line)
        return np.stack([first(row) for row in np.moveaxis(damping, -1, 0)], axis=-1)


def _first_gain(
    gain: Curves, other: Curves, joined: np.ndarray, line: tuple[Any, Any, np.ndarray]
) -> Callable[[np.ndarray], np.ndarray]:
    """The least positive gain on the boundary at a value of the other gain, of any hand."""
    run, rise = np.diff(other, axis=-1), np.diff(gain, axis=-1)
    run, (per_gain, per_other, total) = np.where(run == 0.0, np.nan, run), line

    def first(value: Float64[np.ndarray, "mass delay"]) -> Float64[np.ndarray, "mass delay"]:
        here = value[..., None]
        share = (here[..., None] - other[..., :-1]) / run
        crossed = gain[..., :-1] + share * rise
        meets = joined & (share >= 0.0) & (share <= 1.0) & (crossed > 0.0)
        curve = np.min(np.where(meets, crossed, np.inf), axis=-1)
        straight = (total - per_other * here) / np.where(per_gain == 0.0, np.inf, per_gain)
        lowest: np.ndarray = np.minimum(curve, np.where(straight > 0.0, straight, np.inf))
        return lowest.min(axis=-1)

    return first


def boundary_of(
    loop: LoopParameters,
    hands: HandRange,
    mass: Float64[np.ndarray, " mass"],
    delay: Float64[np.ndarray, " delay"],
    jitter: float = 0.0,
) -> Boundary:
    """The boundary for devices of some masses, at delays in samples.

    With ``jitter`` each hand is taken with some delays up to so many samples longer, too.
    """
    # Devices have resonances, and behind a grip the worst hand need not be at a corner.
    angles, each = (800, 2) if loop.device is None else (1200, 3)
    bend = 1.5  # angles are closer to each other near 0
    period, late = loop.sample_time, np.linspace(0.0, jitter, 5 if jitter else 1)
    device = HeldDevice.from_device(loop.held_device, period)
    moved, springs, dampers = spread_hands(hands, each).T
    arms = Arms(moved, springs * period**2, dampers * period)
    lags = np.add.outer(late, delay).ravel()

    theta = np.pi * (np.arange(1, angles + 1) / angles) ** bend  # the last one is pi
    held = np.stack([device.response(body, arms, lags, theta) for body in mass])
    wanted = -1.0 / np.concatenate(np.split(held, late.size, axis=1), axis=2)
    position, velocity = responses_at(known_filters(**loop.filters) or NO_FILTERS, theta)
    twist = np.imag(np.conj(position) * velocity)
    with np.errstate(divide="ignore", invalid="ignore"):
        alpha = np.imag(np.conj(velocity) * wanted) / -twist
        beta = np.imag(np.conj(position) * wanted) / twist
    per_alpha, per_beta, total = (x[..., -1].real for x in (position, velocity, wanted))
    return Boundary(
        np.nan_to_num(alpha[..., :-1] / period**2),
        np.nan_to_num(beta[..., :-1] / period),
        np.signbit(twist[1:-1]) == np.signbit(twist[:-2]),
        (per_alpha * period**2, per_beta * period, total),
    )
