"""A guard: the walls that it lets through, their share of all stable walls, its C header."""

import re
from dataclasses import dataclass, field, replace
from importlib.resources import files
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from jaxstab.arrays import Numbers
from jaxstab.guard.grid import Grid, interpolated
from jaxstab.guard.limits import boundary_of
from jaxstab.model import LoopParameters
from jaxstab.ranges import HandRange
from jaxstab.shown import printable, shortened

Range = tuple[float, float]

_SAMPLES = 9  # of mass and of delay
_DAMPINGS = 64
_ROUNDED = 1.0 + 1e-12  # the largest damping, however it was summed
LARGEST_HEADER = 1_000_000
"""Bytes of a header at most."""

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")
_WIDTH = 96
_LINE = ("kg", "N/m", "N s/m")


class Costliest(NamedTuple):
    """The corner of a guard's ranges at which the stiffest wall is the least stiff.

    Attributes:
        mass: of the device in kg.
        delay: in s.
        hand: mass in kg, stiffness in N/m and damping in N s/m of the hand that limits it there.
        granted: the largest stiffness that the guard grants there, in N/m.
        exact: the largest one that is stable for all hands there, good to about 1e-3.
    """

    mass: float
    delay: float
    hand: tuple[float, float, float]
    granted: float
    exact: float


@dataclass(frozen=True)
class Guard:
    """Walls that are proved stable for every hand, mass and delay of given ranges.

    Mass, hand, delay and both gains are constant while the wall is touched.

    Attributes:
        loop: the loop; its mass, hand and delay are replaced by those of the ranges.
        hands: the range of hands.
        mass: the lowest and the highest mass of the device in kg.
        delay: the shortest and the longest delay in s.
        grid: the proved limits between which the guard interpolates.
        units: steps of stiffness and damping: all numbers of the grid are whole multiples.
        rows: for each cell of mass and delay, the first and the last node of the damping between
            which walls are proved; no wall is granted elsewhere.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
        >>> hands, mass, delay = jaxstab.HandRange(), (0.24, 0.26), (1e-3, 1.1e-3)
        >>> guard = jaxstab.build_guard(loop, hands, mass=mass, delay=delay, cells=(1, 1, 4))
        >>> guard.largest_stiffness([0.0, 20.0], mass=0.25, delay=1.05e-3).round().tolist()
        [0.0, 9430.0]
        >>> place = {"mass": np.array([0.25]), "delay": np.array([1e-3])}
        >>> print(f"{guard.exact_stiffness(np.full((1, 1, 1), 20.0), **place).item():.3g} N/m")
        1.22e+04 N/m
        >>> round(guard.granted, 2), guard.costliest.mass, guard.costliest.delay
        (0.88, 0.24, 0.0011)
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

    def largest_stiffness(
        self, damping: Numbers, *, mass: Numbers, delay: Numbers
    ) -> Float64[np.ndarray, "*grid"]:
        """The stiffness up to which all walls are proved stable, as the C header computes it.

        In N/m; 0 where nothing is proved, as outside the ranges. Arrays of damping in N s/m, mass
        of the device in kg and delay in s have any shape and broadcast.
        """
        values = np.broadcast_arrays(
            *(np.asarray(value, np.float64) for value in (damping, mass, delay))
        )
        damping_, *place = (value.ravel() for value in values)
        index = np.stack(
            [
                (value - low) * (count / (high - low))
                for value, (low, high), count in zip(
                    place, (self.mass, self.delay), self.grid.cells[:2], strict=True
                )
            ]
        )
        ends = zip(place, (self.mass, self.delay), strict=True)
        inside = np.all([(value >= low) & (value <= high) for value, (low, high) in ends], axis=0)
        index = np.where(inside, index, 0.0)
        top = interpolated(self.grid.top, index)
        last = np.array(self.grid.cells[:2])[:, None] - 1
        cell = tuple(np.minimum(index.astype(int), last))
        lowest, highest = top * (self.rows[cell].T / self.grid.cells[2])
        inside &= (damping_ >= lowest) & (damping_ <= highest * _ROUNDED) & (lowest < highest)
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
        good to about 1e-3; 0 where no stiffness is stable. Units as in ``largest_stiffness``.
        """
        boundary = boundary_of(self.loop, self.hands, mass, delay / self.loop.sample_time)
        limits = boundary.largest_stiffness(damping)
        inside = damping < boundary.largest_damping()[..., None]
        return np.where(inside & np.isfinite(limits), limits, 0.0)

    @property
    def granted(self) -> float:
        """The mean granted stiffness over the mean stable one, over the whole range."""
        mass, delay = (
            low + (high - low) * (np.arange(_SAMPLES) + 0.5) / _SAMPLES
            for low, high in (self.mass, self.delay)
        )
        boundary = boundary_of(self.loop, self.hands, mass, delay / self.loop.sample_time)
        share = (np.arange(_DAMPINGS) + 0.5) / _DAMPINGS
        damping = boundary.largest_damping()[..., None] * share
        limits = boundary.largest_stiffness(damping)
        exact = np.where(np.isfinite(limits), limits, 0.0)
        proved = self.largest_stiffness(damping, mass=mass[:, None, None], delay=delay[:, None])
        return float(np.sum(proved) / np.sum(exact))

    @property
    def costliest(self) -> Costliest:
        """The corner of mass, delay and hand that costs most of the stiffness."""
        mass, delay = np.array(self.mass), np.array(self.delay)
        boundary = boundary_of(self.loop, self.hands, mass, delay / self.loop.sample_time)
        share = (np.arange(_DAMPINGS) + 0.5) / _DAMPINGS
        damping = boundary.largest_damping()[..., None] * share
        exact = self.exact_stiffness(damping, mass=mass, delay=delay)
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
        granted = self.largest_stiffness(damping[row, column], mass=mass[row], delay=delay[column])
        return Costliest(
            float(mass[row]),
            float(delay[column]),
            tuple(corners[int(np.argmin(alone))].values()),
            float(granted.max()),
            float(exact[row, column, best]),
        )

    def header(self, name: str, about: str = "", units: tuple[str, str, str] = _LINE) -> str:
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
        masses, delays, rows = grid.limit.shape
        values = {
            "NAME": name,
            "MACRO": name.upper(),
            "VERSION": _version(),
            "ABOUT": "\n".join(f" * {line}".rstrip() for line in about.splitlines()),
            "KG": units[0],
            "STIFFNESS_UNIT": units[1],
            "DAMPING_UNIT": units[2],
            "MASS_LOW": repr(float(self.mass[0])),
            "MASS_HIGH": repr(float(self.mass[1])),
            "DELAY_LOW": repr(float(self.delay[0])),
            "DELAY_HIGH": repr(float(self.delay[1])),
            "PER_MASS": repr((masses - 1) / (self.mass[1] - self.mass[0])),
            "PER_DELAY": repr((delays - 1) / (self.delay[1] - self.delay[0])),
            "STIFFNESS": repr(float(grid.limit.max())),
            "DAMPING": repr(float(grid.top.max())),
            "TOP_STEP": repr(damping_step),
            "LIMIT_STEP": repr(stiffness_step),
            "M": str(masses),
            "D": str(delays),
            "B": str(rows),
            "M_CELLS": str(masses - 1),
            "D_CELLS": str(delays - 1),
            "M_LAST": str(masses - 2),
            "D_LAST": str(delays - 2),
            "B_LAST": str(rows - 2),
            "ROWS": str(rows - 1),
            "TOP": _table(grid.top / damping_step),
            "GRANTED": _table(self.rows),
            "LIMIT": _table(grid.limit / stiffness_step),
        }
        template = files("jaxstab.guard").joinpath("guard.h.in").read_text(encoding="utf-8")
        text = re.sub(r"@([A-Z_]+)@", lambda match: values[match[1]], template)
        if len(text.encode()) > LARGEST_HEADER:
            raise ValueError(f"the header would have {len(text)} bytes; give fewer cells.")
        return text


def checked_name(name: str) -> str:
    """Return a name that is valid in C, or raise ValueError."""
    if not _NAME.fullmatch(name):
        raise ValueError(
            f"name is {shortened(name)}; give at most 40 letters, digits and underscores, a letter "
            "first."
        )
    return name


def _version() -> str:
    import jaxstab

    return jaxstab.__version__


def _table(values: np.ndarray) -> str:
    """Return whole numbers as an initialiser; each row of the last axis begins a line."""
    if values.ndim > 1:
        return ",\n".join("{" + _table(row) + "}" for row in values)
    lines, line = [], ""
    for number in values:
        word = f"{int(number)},"
        if len(line) + len(word) > _WIDTH:
            lines.append(line)
            line = ""
        line += word
    return "\n".join([*lines, line]).rstrip(",")
