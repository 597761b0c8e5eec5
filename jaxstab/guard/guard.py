"""A guard: the walls that it lets through, their share of all stable walls, its C header."""

import re
from dataclasses import dataclass, field, replace
from importlib.resources import files
from itertools import product
from textwrap import fill
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

import jaxstab
from jaxstab.arrays import Numbers
from jaxstab.boxes import HandRange
from jaxstab.conventions import Range
from jaxstab.guard.grid import Boundary, Grid, boundary_of, interpolated
from jaxstab.model import LoopParameters
from jaxstab.numbers import real_numbers, require_together
from jaxstab.shown import printable, shortened

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

    def _boundary(self, mass: np.ndarray, delay: np.ndarray) -> Boundary:
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
        template = files("jaxstab.guard").joinpath("guard.h.in").read_text(encoding="utf-8")
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
