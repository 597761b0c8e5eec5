"""What a loop answers about given walls (K, B), in SI units."""

import numpy as np
from jaxtyping import Bool, Complex128, Int8

from jaxstab import motion, point, ranges
from jaxstab.arrays import Array, Numbers, is_any_traced
from jaxstab.conventions import Verdict
from jaxstab.model import LoopParameters, checked_gain, require_x64
from jaxstab.motion import Amplitude, Oscillation, Response, Settling
from jaxstab.motion.oscillation import mode_of
from jaxstab.motion.settling import HORIZON, Excitation
from jaxstab.numbers import checked, checked_word
from jaxstab.point import SpectralRadius
from jaxstab.point.poles import linear_poles
from jaxstab.point.radius.door import linear_spectral_radius
from jaxstab.point.verdict.linear import linear_verdict
from jaxstab.ranges import Margins


class LoopWithWalls(LoopParameters):
    """The answers of ``jaxstab.HapticLoop`` about given walls.

    In all of them K is the stiffness in N/m and B the damping in N s/m, of any shape; they
    broadcast. Numbers and NumPy arrays are answered by NumPy arrays, JAX arrays by JAX arrays, also
    under jit and vmap.
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
            are proofs for the dimensionless numbers, which are right to some roundings.

        Raises:
            ValueError: a gain is infinite or NaN, or resolve is unknown.
            RuntimeError: JAX arrays are given without x64.

        Source: Schur-Cohn criterion (Jury 1964) for eq. (9) of Hulin, Preusche, Hirzinger (2008).

        Example:
            >>> window = jaxstab.Velocity.difference(window=0.02)
            >>> device = {"device_mass": 0.25, "device_damping": 0.1}
            >>> loop = jaxstab.HapticLoop(**device, sample_time=1e-3, delay=1e-3, velocity=window)
            >>> jaxstab.Verdict(loop.verdict(5000.0, 30.0))
            <Verdict.UNSTABLE: 2>
        """
        wall = self._wall(stiffness, damping)
        if self.body is None:
            checked_word("resolve", resolve or "exact", ("exact",))
            return linear_verdict(*wall, self.linear)
        return point.verdict(*wall, *self.slice, resolve=resolve, **self.filters)

    def is_stable(self, stiffness: Numbers, damping: Numbers) -> Bool[Array, "*grid"]:
        """Return True where ``verdict`` proves that a wall is stable.

        Args:
            stiffness: K in N/m, any shape; broadcasts with the damping.
            damping: B in N s/m.

        Raises:
            ValueError: a gain is infinite or NaN.
            RuntimeError: JAX arrays are given without x64.

        Source: sec. V of Hulin, Preusche, Hirzinger (2008).
        """
        return self.verdict(stiffness, damping) == Verdict.STABLE

    def spectral_radius(self, stiffness: Numbers, damping: Numbers) -> SpectralRadius:
        """Return the largest modulus of a pole of the loop at walls, with a proved error bound.

        Args:
            stiffness: K in N/m, any shape; broadcasts with the damping.
            damping: B in N s/m.

        Returns:
            SpectralRadius per sample, with its bound and status; see ``jaxstab.spectral_radius``.

        Raises:
            ValueError: a gain is infinite or NaN.
            RuntimeError: JAX arrays are given without x64.

        Source: eq. (9) of Hulin, Preusche, Hirzinger (2008).
        """
        wall = self._wall(stiffness, damping)
        if self.body is None:
            return linear_spectral_radius(*wall, self.linear)
        return point.spectral_radius(*wall, *self.slice, **self.filters)

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
        """
        wall = self._wall(stiffness, damping)
        if self.body is None:
            return linear_poles(*wall, self.linear)
        return point.closed_loop_poles(*wall, *self.slice, **self.filters)

    def margins(self, stiffness: Numbers, damping: Numbers) -> Margins:
        """Return how far stiffness, damping and delay of the loop at walls may change, each alone.

        Args:
            stiffness: K in N/m, any shape; broadcasts with the damping.
            damping: B in N s/m.

        Returns:
            Margins in N/m, N s/m and s, all proved; see ``jaxstab.margins``, also for JAX. Of a
            device that is not one mass the extra delay is not looked for: it is NaN.

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
            3.8...
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
        found = ranges.margins(*self._wall(stiffness, damping), *plant, **self.filters)
        return found._replace(
            stiffness=self.stiffness(found.stiffness),
            damping=self.damping(found.damping),
            extra_delay=self.sample_time * found.extra_delay,
        )

    def settling_time(
        self,
        stiffness: Numbers,
        damping: Numbers,
        *,
        level: float = 0.02,
        excitation: Excitation = "force",
        horizon: int = HORIZON,
    ) -> Settling:
        """Return the time in s until the position stays within a tolerance of its final value.

        It is ``jaxstab.settling_samples`` times the sample time; see there for the tolerance. A
        count of samples jumps between constants, so it has no derivative: that of
        ``spectral_radius`` tells how the decay changes.

        Args:
            stiffness: K in N/m, any shape; broadcasts with the damping.
            damping: B in N s/m.
            level: the tolerance, between 0 and 1; 0.02 is the usual one.
            excitation: "force", a constant push, or "impact", a velocity at the wall.
            horizon: samples after which a loop that is not proved to have settled is given up.

        Returns:
            Settling with ``value`` in s and ``status``, a SettlingStatus.

        Raises:
            ValueError: an argument is outside its range, infinite or NaN, or the excitation is
                unknown.
            TypeError: a filter is traced, or the horizon is not a whole number.
            NotImplementedError: the device is not one mass.
            RuntimeError: JAX arrays are given without x64.

        Source: the loop of eqs. (1)-(5), Table I.
        """
        self._refuse_tracers("settling_time")
        self._refuse_general_devices("settling_time")
        samples = motion.settling_samples(
            *self._wall(stiffness, damping),
            *self.slice,
            level,
            excitation=excitation,
            horizon=horizon,
            **self.filters,
        )
        return Settling(samples.value * self.sample_time, samples.status)

    def amplitude(
        self,
        stiffness: Numbers,
        damping: Numbers,
        *,
        encoder: Numbers = 0.0,
        force_step: Numbers = 0.0,
        friction: Numbers = 0.0,
        noise: Numbers = 0.0,
    ) -> Amplitude:
        """Bound what a quantised encoder, a quantised force, friction and noise do at walls.

        Beside the loop stands the same one without any of these, started alike and pushed alike.
        How far the two are apart is bounded at all times; and as the other one comes to rest under
        a constant push, so is the chatter of the hand in the long run. See ``jaxstab.amplitude``.

        Args:
            stiffness: K in N/m, any shape; like all arguments it broadcasts.
            damping: B in N s/m.
            encoder: resolution of the position in m, as it is rounded to the nearest multiple.
            force_step: resolution of the force in N, as it is rounded to the nearest multiple.
            friction: largest Coulomb friction of the device in N, taken for any bounded force.
            noise: largest error of the position in m, beside that of the resolution.

        Returns:
            Amplitude in m, m/s and N; infinite where nothing is proved, which is so at the boundary
            of stability and beyond.

        Raises:
            ValueError: an argument is negative, infinite or NaN, or nothing disturbs the loop.
            TypeError: a filter is traced.
            NotImplementedError: the device is not one mass.
            RuntimeError: JAX arrays are given without x64.

        Source: the l1 norm of a linear system (Vidyasagar 1986) for the loop of eqs. (1)-(5);
        lemmas M3 to M8 of docs/proofs.md.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> found = loop.amplitude(1000.0, 20.0, encoder=1e-5)
            >>> f"{found.position:.1e} m, {found.force:.2f} N"
            '6.3e-06 m, 0.24 N'
        """
        self._refuse_tracers("amplitude")
        self._refuse_general_devices("amplitude")
        unit = self.mass / self.sample_time**2  # N that are 1 where 1 m is
        found = motion.amplitude(
            *self._wall(stiffness, damping),
            *self.slice,
            encoder=checked("encoder", encoder, 0.0),
            force_step=checked("force_step", force_step, 0.0) / unit,
            friction=checked("friction", friction, 0.0) / unit,
            noise=checked("noise", noise, 0.0),
            **self.filters,
        )
        return found._replace(
            velocity=found.velocity / self.sample_time,
            force=found.force * unit,
            force_per_count=found.force_per_count * unit,
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
        """
        mode = mode_of(self.poles(stiffness, damping))
        return Oscillation(mode.damping_ratio, mode.frequency / (2.0 * np.pi * self.sample_time))

    def simulate(
        self,
        stiffness: Numbers,
        damping: Numbers,
        *,
        samples: int = 200,
        force: Numbers = 0.0,
        initial_velocity: Numbers = 0.0,
        initial_position: Numbers = 0.0,
        between: int = 0,
        unilateral: bool = False,
    ) -> Response:
        """Simulate the device, held by the hand, against a virtual wall at position 0.

        Mass, damper and the hand's spring move in continuous time. At every sample the wall
        computes -K x - B v with the position x, filtered if there is a filter, and the estimated
        velocity v; this force acts after the delay and is held for one sample. Before time 0 the
        device stood where it starts, and no force was on its way.

        Args:
            stiffness: K in N/m, any shape; broadcasts with the four other arrays.
            damping: B in N s/m.
            samples: how many samples to simulate, from time 0 on.
            force: a step in N, from time 0 on: the hand begins to push.
            initial_velocity: in m/s at time 0: an impact on the wall, or a blow of this times the
                mass.
            initial_position: in m at time 0, the penetration if positive.
            between: how many equidistant points to return between two samples.
            unilateral: the wall pushes or pulls only while the sampled position is positive
                (Remark 1); otherwise it holds the device from both sides, as in the rest of the
                paper.

        Returns:
            Response at samples * (between + 1) times; exact up to rounding at each of them, and
            differentiable in all arrays.

        Raises:
            ValueError: a gain is infinite or NaN, nothing moves the device, or a count is too
                small.
            NotImplementedError: the device is not one mass.
            RuntimeError: JAX arrays are given without x64.

        Source: eqs. (1)-(5) and Fig. 2 of Hulin, Preusche, Hirzinger (2008); Remark 1.
        """
        self._refuse_tracers("simulate")
        self._refuse_general_devices("simulate")
        return motion.simulate(
            self,
            stiffness,
            damping,
            samples=samples,
            force=force,
            initial_velocity=initial_velocity,
            initial_position=initial_position,
            between=between,
            unilateral=unilateral,
        )

    def _wall(self, stiffness: Numbers, damping: Numbers) -> tuple[Array, Array]:
        """Return alpha and beta of walls."""
        require_x64(stiffness, damping)
        alpha = self.alpha(checked_gain("stiffness", stiffness))
        return alpha, self.beta(checked_gain("damping", damping))

    def _refuse_tracers(self, method: str) -> None:
        """Refuse a loop that JAX traces where what answers searches outside of JAX."""
        if is_any_traced(self):
            raise TypeError(
                f"{method} takes no loop that JAX traces: give one of concrete numbers, made "
                "outside of jit, vmap and grad."
            )

    def _refuse_general_devices(self, method: str) -> None:
        """Refuse a device that is not one mass where what computes cannot take one yet."""
        if self.body is None:
            raise NotImplementedError(
                f"{method} is answered for devices and hands of one mass; this device is not: "
                f"{self.device}."
            )
