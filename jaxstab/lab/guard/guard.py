"""A guard: the walls that it lets through, their share of all stable walls, its C header.

Its grid has limits at the nodes, loops over boxes in the cells, and the exact limits.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from importlib.resources import files
from itertools import product
from textwrap import fill
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

import jaxstab
from jaxstab.arrays import Numbers
from jaxstab.boxes import HandRange
from jaxstab.boxes.enclosures import THETA, LinearModel, ParameterBoxes, Rows
from jaxstab.boxes.plant import Arms, DeviceBoxes, Extent, FirstRow, HeldDevice
from jaxstab.boxes.search import arms_over, spread_hands
from jaxstab.conventions import Range
from jaxstab.model import Device, LoopParameters
from jaxstab.model.filters import NO_FILTERS, known_filters
from jaxstab.numbers import real_numbers, require_together
from jaxstab.region.closed_form import responses_at
from jaxstab.shown import printable, shortened

# ----------------------------------------------------------------------------------------- the grid
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
# come from it. Nothing here is a bound; the proof is in ``jaxstab.lab.guard.build``.

Angles = Float64[np.ndarray, " angle"]
Curves = Float64[np.ndarray, "mass delay hand angle"]


class HandBoundaries(NamedTuple):
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
) -> HandBoundaries:
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
    return HandBoundaries(
        np.nan_to_num(alpha[..., :-1] / period**2),
        np.nan_to_num(beta[..., :-1] / period),
        np.signbit(twist[1:-1]) == np.signbit(twist[:-2]),
        (per_alpha * period**2, per_beta * period, total),
    )


# ---------------------------------------------------------------------------------------- the guard
LARGEST_HEADER = 1_000_000
"""Bytes of a header at most."""


class Costliest(NamedTuple):
    """The corner of a guard's ranges at which the stiffest wall is the least stiff.

    Attributes:
        mass: of the device in kg.
        delay: in s; None if it moves.
        hand: mass in kg, stiffness in N/m and damping in N s/m of the hand that limits it there.
        granted: the largest stiffness that the guard grants there, in N/m.
        exact: the largest one that is stable for all hands there, good to about 1e-3.
    """

    mass: float
    delay: float | None
    hand: tuple[float, float, float]
    granted: float
    exact: float


@dataclass(frozen=True)
class Guard:
    """Walls that are proved stable for every hand, mass and delay of given ranges.

    Mass, hand and both gains are constant while the wall is touched. So is the delay, if
    ``is_delay_constant``; otherwise it may change from sample to sample.

    Attributes:
        loop: the loop; its mass, hand and delay are replaced by those of the ranges.
        hands: the range of hands.
        mass: the lowest and the highest mass of the device in kg.
        delay: the shortest and the longest delay in s.
        grid: the proved limits between which the guard interpolates.
        units: steps of stiffness and damping: all numbers of the grid are whole multiples.
        rows: for each cell of mass and delay, the first and the last node of the damping between
            which walls are proved; no wall is granted elsewhere.
        lost: the number of samples in a row that may never arrive.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
        >>> hands, mass, delay = jaxstab.HandRange(), (0.24, 0.26), (1e-3, 1.1e-3)
        >>> ranges = {"mass": mass, "delay": delay, "cells": (1, 1, 4)}
        >>> guard = jaxstab.build_guard(loop, hands, **ranges, constant_delay=True)
        >>> guard.largest_stiffness([0.0, 20.0], mass=0.25, delay=1e-3).round().tolist()
        [0.0, 9692.0]
        >>> place = {"mass": np.array([0.25]), "delay": np.array([1e-3])}
        >>> print(f"{guard.exact_stiffness(np.full((1, 1, 1), 20.0), **place).item():.3g} N/m")
        1.22e+04 N/m
        >>> round(guard.granted, 2), guard.costliest.mass, guard.is_delay_constant
        (0.88, 0.24, True)
        >>> "double omega_guard_largest_stiffness(double damping" in guard.header("omega_guard")
        True
    """

    loop: LoopParameters
    hands: HandRange
    mass: Range
    delay: Range
    grid: Grid = field(repr=False)
    units: tuple[float, float] = field(repr=False)
    rows: Int64[np.ndarray, "mass delay 2"] = field(repr=False)
    lost: int = 0

    @property
    def is_delay_constant(self) -> bool:
        """True if walls are proved for constant delays alone."""
        return not self.grid.jitter

    def largest_stiffness(
        self, damping: Numbers, *, mass: Numbers, delay: Numbers | None = None
    ) -> Float64[np.ndarray, "*grid"]:
        """The stiffness up to which all walls are proved stable, as the C header computes it.

        In N/m; 0 where nothing is proved, as outside the ranges. Arrays of damping in N s/m, mass
        of the device in kg and delay in s have any shape and broadcast. The delay is given if it is
        constant, and only then: TypeError otherwise.
        """
        rounded = 1.0 + 1e-12  # the largest damping, however it was summed
        if self.is_delay_constant and delay is None:
            raise TypeError("the guard is for constant delays; give delay in s.")
        if not self.is_delay_constant and delay is not None:
            raise TypeError("the guard is for a delay that moves; give no delay.")
        late = self.delay[0] if delay is None else delay
        given = {"damping": damping, "mass": mass, "delay": late}
        require_together(**given)
        floats = [real_numbers(*pair).astype(np.float64) for pair in given.items()]
        values = np.broadcast_arrays(*floats)
        damping_, *place = (value.ravel() for value in values)
        low, high = np.transpose([self.mass, self._delays])[..., None]
        counts = np.array(self.grid.cells[:2])[:, None]
        inside = np.all((place >= low) & (place <= high), axis=0)
        steps = (place - low) * (counts / np.where(low < high, high - low, np.inf))
        index = np.where(inside, steps, 0.0)
        top = interpolated(self.grid.top, index)
        cell = tuple(np.minimum(index.astype(int), counts - 1))
        lowest, highest = top * (self.rows[cell].T / self.grid.cells[2])
        inside &= (damping_ >= lowest) & (damping_ <= highest * rounded) & (lowest < highest)
        row = np.where(inside, np.minimum(damping_ / top, 1.0) * self.grid.cells[2], 0.0)
        limits = np.where(inside, interpolated(self.grid.limit, np.vstack([index, row])), 0.0)
        return limits.reshape(values[0].shape)

    def exact_stiffness(
        self,
        damping: Float64[np.ndarray, "mass delay damping"],
        *,
        mass: Float64[np.ndarray, " mass"],
        delay: Float64[np.ndarray, " delay"],
    ) -> Float64[np.ndarray, "mass delay damping"]:
        """The stiffness at which the first of the sampled hands of the range becomes unstable.

        They are the corners of the range; with a ``device``, three along each quantity. In N/m,
        good to about 1e-3; 0 where no stiffness is stable. Units as in ``largest_stiffness``. Where
        the delay moves it is that at the worst of some constant delays, from the given ones up.
        """
        boundary = self._boundary(mass, delay)
        limits = boundary.largest_stiffness(damping)
        inside = damping < boundary.largest_damping()[..., None]
        return np.where(inside & np.isfinite(limits), limits, 0.0)

    @property
    def granted(self) -> float:
        """The mean granted stiffness over the mean stable one, over the whole range.

        Where the delay moves, stable is what some constant delays of the range all allow.
        """
        samples = 9  # of mass and of delay
        mass, delay = (
            low + (high - low) * (np.arange(samples) + 0.5) / samples
            for low, high in (self.mass, self._delays)
        )
        damping, exact = self._stable(mass, delay)
        given = delay[:, None] if self.is_delay_constant else None
        proved = self.largest_stiffness(damping, mass=mass[:, None, None], delay=given)
        return float(np.sum(proved) / np.sum(exact))

    @property
    def costliest(self) -> Costliest:
        """The corner of mass, delay and hand that costs most of the stiffness."""
        mass, delay = np.array(self.mass), np.array(self._delays)
        damping, exact = self._stable(mass, delay)
        row, column = np.unravel_index(np.argmin(exact.max(axis=-1)), (2, 2))
        best = int(np.argmax(exact[row, column]))
        place = {"mass": mass[[row]], "delay": delay[[column]]}
        at = damping[row, column, best].reshape(1, 1, 1)
        ranges = vars(self.hands)
        corners = [dict(zip(ranges, ends, strict=True)) for ends in product(*ranges.values())]
        alone = [
            replace(self, hands=HandRange(**{name: (end, end) for name, end in corner.items()}))
            .exact_stiffness(at, **place)
            .item()
            for corner in corners
        ]
        given = float(delay[column]) if self.is_delay_constant else None
        granted = self.largest_stiffness(damping[row, column], mass=mass[row], delay=given)
        return Costliest(
            float(mass[row]),
            given,
            tuple(corners[int(np.argmin(alone))].values()),
            float(granted.max()),
            float(exact[row, column, best]),
        )

    @property
    def _delays(self) -> Range:
        """The range of delays along the grid: one that moves has but one place there."""
        return self.delay if self.is_delay_constant else (self.delay[0], self.delay[0])

    def _boundary(self, mass: np.ndarray, delay: np.ndarray) -> HandBoundaries:
        samples = delay / self.loop.sample_time
        return boundary_of(self.loop, self.hands, mass, samples, self.grid.jitter)

    def _stable(self, mass: np.ndarray, delay: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return some dampings at each mass and delay, and the largest stiffness there."""
        dampings = 64
        boundary = self._boundary(mass, delay)
        share = (np.arange(dampings) + 0.5) / dampings
        damping = boundary.largest_damping()[..., None] * share
        limits = boundary.largest_stiffness(damping)
        return damping, np.where(np.isfinite(limits), limits, 0.0)

    def header(
        self, name: str, about: str = "", units: tuple[str, str, str] = ("kg", "N/m", "N s/m")
    ) -> str:
        """A C99 header with NAME_clamp and NAME_largest_stiffness.

        Args:
            name: the beginning of all names in the header.
            about: lines that describe the loop of the guard, printable and without "*/".
            units: of mass, stiffness and damping.

        Raises:
            ValueError: the name is not valid in C, ``about`` or a unit would not stay in a comment,
                or the header would be larger than 1 MB.
        """
        checked_name(name)
        for kind, text in (("about", about), *(("units", unit) for unit in units)):
            if "*/" in text or printable(text, "\n") != text:  # it would end the comment
                raise ValueError(f"{kind} is {shortened(text)}; give printable lines without '*/'.")
        grid, (stiffness_step, damping_step) = self.grid, self.units
        kept = slice(None if self.is_delay_constant else 1)  # both nodes of a moving delay are one
        tops, limits, granted = grid.top[:, kept], grid.limit[:, kept], self.rows[:, kept]
        masses, delays, rows = limits.shape
        values: dict[str, object] = {
            "NAME": name,
            "MACRO": name.upper(),
            "VERSION": jaxstab.__version__,
            "ABOUT": "\n".join(f" * {line}".rstrip() for line in about.splitlines()),
            "KG": units[0],
            "STIFFNESS_UNIT": units[1],
            "DAMPING_UNIT": units[2],
            "MASS_LOW": float(self.mass[0]),
            "MASS_HIGH": float(self.mass[1]),
            "DELAY_LOW": float(self.delay[0]),
            "DELAY_HIGH": float(self.delay[1]),
            "PER_MASS": (masses - 1) / (self.mass[1] - self.mass[0]),
            "STIFFNESS": float(grid.limit.max()),
            "DAMPING": float(grid.top.max()),
            "TOP_STEP": damping_step,
            "LIMIT_STEP": stiffness_step,
            "M": masses,
            "D": delays,
            "B": rows,
            "M_CELLS": masses - 1,
            "D_CELLS": granted.shape[1],
            "D_NEXT": min(delays - 1, 1),
            "M_LAST": masses - 2,
            "B_LAST": rows - 2,
            "ROWS": rows - 1,
            "TOP": _table(tops / damping_step),
            "GRANTED": _table(granted),
            "LIMIT": _table(limits / stiffness_step),
        }
        kind = "MOVING"
        values |= dict.fromkeys(("DELAY_PARAMETER", "DELAY", "AND_DELAY"), "")
        if self.is_delay_constant:
            kind = "CONSTANT"
            values |= {
                "DELAY_PARAMETER": ", double delay",
                "DELAY": ", delay",
                "AND_DELAY": " and delay",
                "PER_DELAY": (delays - 1) / (self.delay[1] - self.delay[0]),
                "D_LAST": delays - 2,
            }
        template = files("jaxstab.lab.guard").joinpath("guard.h.in").read_text(encoding="utf-8")
        # Lines that begin with MOVING| or CONSTANT| are of one kind of guard.
        lines = re.sub(rf"(?m)^(?:{kind}\||[A-Z]+\|.*\n)", "", template)
        text = re.sub(r"@([A-Z_]+)@", lambda match: str(values[match[1]]), lines)
        if len(text.encode()) > LARGEST_HEADER:
            raise ValueError(f"the header would have {len(text)} bytes; give fewer cells.")
        return text


def checked_name(name: str) -> str:
    """Return a name that is valid in C, or raise ValueError."""
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,39}", str(name)):
        raise ValueError(
            f"name is {shortened(name)}; give at most 40 letters, digits and underscores, a letter "
            "first."
        )
    return str(name)


def _table(values: np.ndarray) -> str:
    """Whole numbers as an initialiser; each row of the last axis begins a line."""
    if values.ndim > 1:
        return ",\n".join("{" + _table(row) + "}" for row in values)
    return fill(", ".join(map(str, values.astype(int).tolist())), 108).replace(", ", ",")
