"""What a loop answers about given walls (K, B), in SI units."""

import numpy as np
from jaxtyping import Bool, Complex128, Int8

from jaxstab import point, ranges
from jaxstab.arrays import Array, Numbers, is_any_traced, named
from jaxstab.conventions import Verdict
from jaxstab.loop.time_domain import LoopInTime
from jaxstab.model import by_name
from jaxstab.motion import Oscillation
from jaxstab.motion.response import mode_of
from jaxstab.numbers import checked_word
from jaxstab.point import SpectralRadius
from jaxstab.point.poles import linear_poles
from jaxstab.point.radius import linear_spectral_radius
from jaxstab.point.verdicts import linear_verdict
from jaxstab.ranges import Margins, WallMargins


class LoopWithWalls(LoopInTime):
    """The answers of ``jaxstab.HapticLoop`` about given walls.

    K is the stiffness in N/m and B the damping in N s/m throughout, of any shape; they broadcast.
    Numbers and NumPy arrays give NumPy arrays, JAX arrays give JAX arrays, under jit and vmap too.
    """

    def verdict(
        self, stiffness: Numbers, damping: Numbers, *, resolve: str | None = None
    ) -> Int8[Array, "*grid"]:
        """Prove whether walls are stable: all roots of p(z) inside the unit circle.

        Args:
            stiffness: K in N/m, any shape; broadcasts with the damping.
            damping: B in N s/m.
            resolve: "exact" decides more of the walls next to the boundary; see
                ``jaxstab.verdict``.

        Returns:
            int8 array of the broadcast shape: Verdict.STABLE, UNSTABLE or UNDECIDED. The first two
            are proofs for the loop's dimensionless numbers, which carry a few roundings. The int8
            of one wall prints its name.

        Raises:
            ValueError: a gain is infinite or NaN, or resolve is unknown.
            RuntimeError: JAX arrays are given without x64.

        Source: Schur-Cohn criterion (Jury 1964) for eq. (9) of Hulin, Preusche, Hirzinger (2008).

        Example:
            >>> window = jaxstab.Velocity.difference(window=0.02)
            >>> device = {"device_mass": 0.25, "device_damping": 0.1}
            >>> loop = jaxstab.HapticLoop(**device, sample_time=1e-3, delay=1e-3, velocity=window)
            >>> loop.verdict(5000.0, 30.0)
            <Verdict.UNSTABLE: 2>
        """
        wall = self._wall(stiffness, damping)
        if self.body is None:
            checked_word("resolve", resolve or "exact", ("exact",))
            return named(linear_verdict(*wall, self.linear), Verdict)
        return point.verdict(*wall, **self.slice, resolve=resolve, **self.filters)

    def is_stable(self, stiffness: Numbers, damping: Numbers) -> Bool[Array, "*grid"]:
        """Return True where ``verdict`` proves that a wall is stable.

        Args:
            stiffness: K in N/m, any shape; broadcasts with the damping.
            damping: B in N s/m.

        Raises:
            ValueError: a gain is infinite or NaN.
            RuntimeError: JAX arrays are given without x64.

        Source: sec. V of Hulin, Preusche, Hirzinger (2008).

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> loop.is_stable([1000.0, 1e6], 10.0).tolist()
            [True, False]
        """
        return self.verdict(stiffness, damping) == Verdict.STABLE

    def spectral_radius(self, stiffness: Numbers, damping: Numbers) -> SpectralRadius:
        """Return the largest modulus of the loop's poles at walls, with a proved error bound.

        Args:
            stiffness: K in N/m, any shape; broadcasts with the damping.
            damping: B in N s/m.

        Returns:
            SpectralRadius per sample, with its bound and status; see ``jaxstab.spectral_radius``.

        Raises:
            ValueError: a gain is infinite or NaN.
            RuntimeError: JAX arrays are given without x64.

        Source: eq. (9) of Hulin, Preusche, Hirzinger (2008).

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> loop.spectral_radius(1000.0, 10.0)
            0.9407239707335... +/- ... (proved)
        """
        wall = self._wall(stiffness, damping)
        if self.body is None:
            return linear_spectral_radius(*wall, self.linear)
        return point.spectral_radius(*wall, **self.slice, **self.filters)

    def poles(self, stiffness: Numbers, damping: Numbers) -> Complex128[Array, "*grid degree"]:
        """Return the poles z of the loop at walls, the one of the largest modulus first.

        Args:
            stiffness: K in N/m, any shape; broadcasts with the damping.
            damping: B in N s/m.

        Returns:
            Array of shape (*grid, degree); see ``jaxstab.closed_loop_poles``.

        Raises:
            ValueError: a gain is infinite or NaN.
            RuntimeError: JAX arrays are given without x64.

        Source: eq. (9) of Hulin, Preusche, Hirzinger (2008).

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> abs(loop.poles(1000.0, 10.0)).round(4).tolist()
            [0.9407, 0.9407, 0.0559]
        """
        wall = self._wall(stiffness, damping)
        if self.body is None:
            return linear_poles(*wall, self.linear)
        return point.closed_loop_poles(*wall, **self.slice, **self.filters)

    def margins(self, stiffness: Numbers, damping: Numbers) -> Margins:
        """Return how far stiffness, damping and delay of the loop at walls may change, each alone.

        Args:
            stiffness: K in N/m, any shape; broadcasts with the damping.
            damping: B in N s/m.

        Returns:
            Margins in N/m, N s/m and s, all proved; see ``jaxstab.margins``, for JAX too. No extra
            delay is proved (NaN) for a device that is not one mass and has poles of a hundred rad
            per sample or more.

        Raises:
            ValueError: a gain is infinite or NaN.
            TypeError: JAX traces gains, and the device is not one mass.
            RuntimeError: JAX arrays are given without x64.

        Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) on the unit circle.

        Example:
            >>> loop = jaxstab.HapticLoop(
            ...     device_mass=0.1, device_damping=1.5, sample_time=1e-3, delay=1.5e-3
            ... )
            >>> float(loop.margins(300.0, 2.0).stiffness_gain)
            5.719...
        """
        sampled = self.sampled
        if sampled is not None:
            if is_any_traced(stiffness, damping):
                raise TypeError(
                    "margins of a device that is not one mass are searched outside of JAX: give "
                    "concrete gains, outside of jit, vmap and grad."
                )
            wall = stiffness, damping
            return ranges.device_margins(
                sampled, *wall, velocity=self.velocity, position=self.position
            )
        plant = self.gamma, self.delta, self.delay_samples  # a delay that is traced may be any
        found = ranges.margins(*self._wall(stiffness, damping), **by_name(*plant), **self.filters)
        return WallMargins(
            found.verdict,
            self.stiffness(found.stiffness),
            self.damping(found.damping),
            found.stiffness_gain,
            found.damping_gain,
            self.sample_time * found.extra_delay,
        )

    def oscillation(self, stiffness: Numbers, damping: Numbers) -> Oscillation:
        """Return damping ratio and frequency in Hz of the slowest mode of the loop at walls.

        Args:
            stiffness: K in N/m, any shape; broadcasts with the damping.
            damping: B in N s/m.

        Returns:
            Oscillation of arrays of the broadcast shape, the frequency in Hz.

        Raises:
            ValueError: a gain is infinite or NaN.
            RuntimeError: JAX arrays are given without x64.

        Source: as ``jaxstab.dominant_mode``; Table I.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> round(float(loop.oscillation(20000.0, 20.0).frequency), 1)  # Hz
            77.5
        """
        mode = mode_of(self.poles(stiffness, damping))
        return Oscillation(mode.damping_ratio, mode.frequency / (2.0 * np.pi * self.sample_time))
