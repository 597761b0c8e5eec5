"""All loops between two: walls that each of them renders stably, proved."""

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Int8

from jaxstab.arrays import Numbers
from jaxstab.conventions import UNDECIDED, Verdict
from jaxstab.loop.loop import HapticLoop
from jaxstab.model import checked_gain
from jaxstab.model.device.family import LoopFamily
from jaxstab.model.spans import merged, value_at
from jaxstab.numbers import checked_number
from jaxstab.ranges import RobustLimit
from jaxstab.ranges.families import family_verdicts, first_roots

_TRIED, _FINER = 17, 4  # loops of which the worst is looked for, and rounds around it

Wall = tuple[float, float]


class WorstLoop(NamedTuple):
    """What is known of a wall for all loops between two, and the worst of those tried.

    Attributes:
        verdict: STABLE is proved for every loop between the two, UNSTABLE for ``loop``.
        loop: the loop of the largest spectral radius of those that were tried.
        share: where it is on the way from the first loop (0) to the last (1).
        radius: its spectral radius.

    Example:
        >>> light = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> heavy = jaxstab.HapticLoop(device_mass=0.2, device_damping=1.5, sample_time=1e-3)
        >>> worst = jaxstab.LoopsBetween(light, heavy).worst_loop(10_000.0, 20.0)
        >>> worst.verdict.name, worst.share
        ('STABLE', 1.0)
    """

    verdict: Verdict
    loop: HapticLoop
    share: float
    radius: float


@dataclass(frozen=True)
class LoopsBetween:
    """All loops between two that differ in numbers alone, such as one mass or one cut-off.

    Each number that differs runs straight from its value in the first loop to that in the last, all
    of them together: an interval of one parameter, or a line through the space of several, and not
    the box of all their combinations. Whatever a device, a hand, its grip, an actuator, a low pass
    and a delay are made of may differ; the sampling period, windows, orders, state spaces and
    transfer functions in z may not. ``jaxstab.common_region`` takes it in place of a list.

    What is proved holds for every loop between the two, both included, the numbers being exact and
    constant while the wall is touched: a delay that moves within the interval is not covered. A
    filter whose cut-off differs has the exact coefficients that belong to each cut-off, and a part
    of the device that the position does not show for one of the values counts as part of the loop.

    Args:
        first: a loop of concrete numbers.
        last: another one of the same sampling period and of the same parts.

    Raises:
        TypeError: one of them is no HapticLoop, or JAX traces it.
        ValueError: they differ in more than numbers.

    Source: sec. VIII of Hulin, Preusche, Hirzinger (2008) for ranges of hands; lemma B17 of
    docs/proofs.md.

    Example:
        >>> from dataclasses import replace
        >>> mode = jaxstab.Mode(frequency=80.0, damping_ratio=0.01, modal_mass=0.5)
        >>> soft = jaxstab.Device.modes([mode], mass=0.25, damping=0.1)
        >>> other = replace(mode, frequency=90.0)
        >>> stiff = jaxstab.Device.modes([other], mass=0.25, damping=0.1)
        >>> ends = [jaxstab.HapticLoop(device=one, sample_time=1e-3) for one in (soft, stiff)]
        >>> jaxstab.Verdict(jaxstab.LoopsBetween(*ends).verdict(1000.0, 1.0)).name
        'STABLE'
    """

    first: HapticLoop
    last: HapticLoop

    def __post_init__(self) -> None:
        for name in ("first", "last"):
            if not isinstance(getattr(self, name), HapticLoop):
                raise TypeError(f"{name} is {getattr(self, name)!r}; give a jaxstab.HapticLoop.")
            object.__setattr__(self, name, getattr(self, name).in_floats())
        _ = self.family, self._merged

    @cached_property
    def family(self) -> LoopFamily:
        """The mathematics of it."""
        return LoopFamily.between(self.first, self.last)

    @cached_property
    def _merged(self) -> dict[str, Any]:
        return {
            one.name: merged(getattr(self.first, one.name), getattr(self.last, one.name))
            for one in fields(self.first)
        }

    def loop(self, share: float) -> HapticLoop:
        """Return the loop that a share of the way is between the two, its numbers rounded.

        Args:
            share: 0 for the first loop, 1 for the last.

        Raises:
            TypeError: the share is no number.
            ValueError: it is not in [0, 1].

        Example:
            >>> light = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> heavy = jaxstab.HapticLoop(device_mass=0.2, device_damping=1.5, sample_time=1e-3)
            >>> jaxstab.LoopsBetween(light, heavy).loop(0.25).device_mass
            0.125
        """
        share = checked_number("share", share, 0.0, 1.0)
        return HapticLoop(**{name: value_at(one, share) for name, one in self._merged.items()})

    def verdict(self, stiffness: Numbers, damping: Numbers) -> Int8[np.ndarray, "*grid"]:
        """Return proved codes of ``Verdict`` for walls and all of the loops.

        Args:
            stiffness: K in N/m, any shape; broadcasts with the damping.
            damping: B in N s/m.

        Returns:
            STABLE where a wall is proved stable in every loop between the two, UNSTABLE where one
            of them is proved to have a root on the unit circle or outside, UNDECIDED else.

        Raises:
            ValueError: a gain is infinite or NaN.

        Source: lemmas B4, B5 and B17 of docs/proofs.md.

        Example:
            >>> light = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> heavy = jaxstab.HapticLoop(device_mass=0.2, device_damping=1.5, sample_time=1e-3)
            >>> jaxstab.LoopsBetween(light, heavy).verdict([1e4, 1e5], 20.0).tolist()
            [1, 2]
        """
        gains = (checked_gain("stiffness", stiffness), checked_gain("damping", damping))
        grid = np.stack(np.broadcast_arrays(*(np.asarray(g, np.float64) for g in gains)), axis=-1)
        return family_verdicts(self.family, grid.reshape(-1, 2)).reshape(grid.shape[:-1])

    def worst_loop(self, stiffness: float, damping: float) -> WorstLoop:
        """Return whether a wall is stable in all of the loops, and the worst that was found.

        Args:
            stiffness: K in N/m.
            damping: B in N s/m.

        Returns:
            WorstLoop; UNDECIDED where all loops that were tried are stable, but not all others
            could be proved.

        Raises:
            TypeError: a gain is not one real number.
            ValueError: a gain is infinite or NaN.

        Source: lemmas B4, B5 and B17 of docs/proofs.md.

        Example:
            >>> light = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> heavy = jaxstab.HapticLoop(device_mass=0.2, device_damping=1.5, sample_time=1e-3)
            >>> worst = jaxstab.LoopsBetween(light, heavy).worst_loop(1e5, 20.0)
            >>> worst.verdict.name, round(worst.loop.device_mass, 3)
            ('UNSTABLE', 0.1)
        """
        wall = (checked_number("stiffness", stiffness), checked_number("damping", damping))
        radii: dict[float, float] = {}
        self._try(radii, np.linspace(0.0, 1.0, _TRIED), wall)
        for _ in range(_FINER):
            shares = sorted(radii)
            best = max(range(len(shares)), key=lambda number: radii[shares[number]])
            low, high = shares[max(best - 1, 0)], shares[min(best + 1, len(shares) - 1)]
            self._try(radii, np.linspace(low, high, 5)[1:-1], wall)
        code = int(self.verdict(*wall))
        if code == Verdict.UNSTABLE and max(radii.values()) < 1.0:
            roots = first_roots(self.family, np.array([wall]))
            if roots is not None:
                after = roots.low[0] + np.append(0.0, 2.0 ** -np.arange(4.0, 40.0))
                self._try(radii, after[after <= 1.0], wall)
        share = max(radii, key=lambda share: radii[share])
        loop = self.loop(share)
        if code != Verdict.STABLE:
            own = int(loop.verdict(*wall))
            code = own if own == Verdict.UNSTABLE else UNDECIDED
        return WorstLoop(Verdict(code), loop, share, radii[share])

    def robust_limit(self) -> RobustLimit:
        """Return the largest stiffness, and its damping, that all of the loops allow.

        Returns:
            RobustLimit: with ``is_proved`` the wall is proved stable in every loop between the two.
            Its ``limit`` is that of the exact regions of the loops that were tried: computed, and
            no proof.

        Source: sec. VIII of Hulin, Preusche, Hirzinger (2008); lemma B17 of docs/proofs.md.

        Example:
            >>> light = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> heavy = jaxstab.HapticLoop(device_mass=0.2, device_damping=1.5, sample_time=1e-3)
            >>> found = jaxstab.LoopsBetween(light, heavy).robust_limit()
            >>> found.is_proved, round(found.limit)
            (True, 70643)
        """
        from jaxstab.loop.tried_loops import robust_limit

        return robust_limit(self)

    def _try(
        self, radii: dict[float, float], shares: Float64[np.ndarray, " share"], wall: Wall
    ) -> None:
        """Add the spectral radii of loops that have none yet."""
        for share in map(float, shares):
            if share not in radii:
                radii[share] = float(self.loop(share).spectral_radius(*wall).value)
