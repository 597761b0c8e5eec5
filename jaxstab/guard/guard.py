"""A guard: the walls that it lets through, and their share of all stable walls."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import Numbers
from jaxstab.guard.grid import Grid, interpolated
from jaxstab.guard.limits import boundary_of
from jaxstab.model import LoopParameters
from jaxstab.ranges import HandRange

Range = tuple[float, float]

_SAMPLES = 9  # of mass and of delay
_DAMPINGS = 64
_ROUNDED = 1.0 + 1e-12  # the largest damping, however it was summed


@dataclass(frozen=True)
class Guard:
    """Walls that are proved stable for every hand, mass and delay of given ranges.

    Attributes:
        loop: the loop; its own mass, hand and delay are replaced by those of the ranges.
        hands: the range of hands.
        mass: the lowest and the highest mass of the device in kg.
        delay: the shortest and the longest delay in s.
        grid: the proved limits between which the guard interpolates.
        units: steps of stiffness and damping: all numbers of the grid are whole multiples.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
        >>> hands, mass, delay = jaxstab.HandRange(), (0.24, 0.26), (1e-3, 1.1e-3)
        >>> guard = jaxstab.build_guard(loop, hands, mass=mass, delay=delay, cells=(1, 1, 4))
        >>> print(f"{guard.largest_stiffness(20.0, mass=0.25, delay=1e-3):.0f} N/m")
        9692 N/m
    """

    loop: LoopParameters
    hands: HandRange
    mass: Range
    delay: Range
    grid: Grid = field(repr=False)
    units: tuple[float, float] = field(repr=False)

    def largest_stiffness(
        self, damping: Numbers, *, mass: Numbers, delay: Numbers
    ) -> Float64[np.ndarray, "*grid"]:
        """Return the stiffness up to which all walls are proved stable, as the C header does.

        Args:
            damping: B in N s/m, any shape; all broadcast.
            mass: of the device in kg.
            delay: in s.

        Returns:
            Stiffness in N/m; 0 where nothing is proved, as outside the ranges.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
            >>> hands, mass, delay = jaxstab.HandRange(), (0.24, 0.26), (1e-3, 1.1e-3)
            >>> guard = jaxstab.build_guard(loop, hands, mass=mass, delay=delay, cells=(1, 1, 4))
            >>> guard.largest_stiffness([0.0, 20.0], mass=0.25, delay=1.05e-3).round().tolist()
            [0.0, 9430.0]
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
        inside &= (damping_ >= 0.0) & (damping_ <= top * _ROUNDED)
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
        """Return the stiffness at which the first of some hands of the range becomes unstable.

        They are the corners of the range; for a device of its own, three along each quantity.

        Args:
            damping: B in N s/m for each mass and delay.
            mass: of the device in kg.
            delay: in s.

        Returns:
            Stiffness in N/m, good to about 1e-3; 0 where no stiffness is stable.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
            >>> hands, mass, delay = jaxstab.HandRange(), (0.24, 0.26), (1e-3, 1.1e-3)
            >>> guard = jaxstab.build_guard(loop, hands, mass=mass, delay=delay, cells=(1, 1, 4))
            >>> place = {"mass": np.array([0.25]), "delay": np.array([1e-3])}
            >>> exact = guard.exact_stiffness(np.full((1, 1, 1), 20.0), **place)
            >>> print(f"{float(exact[0, 0, 0]):.3g} N/m")
            1.22e+04 N/m
        """
        boundary = boundary_of(self.loop, self.hands, mass, delay / self.loop.sample_time)
        limits = boundary.largest_stiffness(damping)
        inside = damping < boundary.largest_damping()[..., None]
        return np.where(inside & np.isfinite(limits), limits, 0.0)

    @property
    def granted(self) -> float:
        """The mean granted stiffness over the mean stable one, over the whole range.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
            >>> hands, mass, delay = jaxstab.HandRange(), (0.24, 0.26), (1e-3, 1.1e-3)
            >>> guard = jaxstab.build_guard(loop, hands, mass=mass, delay=delay, cells=(1, 1, 4))
            >>> round(guard.granted, 2)
            0.89
        """
        mass, delay = (
            low + (high - low) * (np.arange(_SAMPLES) + 0.5) / _SAMPLES
            for low, high in (self.mass, self.delay)
        )
        boundary = boundary_of(self.loop, self.hands, mass, delay / self.loop.sample_time)
        share = (np.arange(_DAMPINGS) + 0.5) / _DAMPINGS
        damping = boundary.largest_damping()[..., None] * share
        limits = boundary.largest_stiffness(damping)
        exact = np.where(np.isfinite(limits), limits, 0.0)
        own = self.largest_stiffness(damping, mass=mass[:, None, None], delay=delay[:, None])
        return float(np.sum(own) / np.sum(exact))
