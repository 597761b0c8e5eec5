"""What a loop answers about its motion at given walls (K, B), in SI units."""

from typing import Any

from jaxstab import motion
from jaxstab.arrays import Array, Numbers, is_any_traced
from jaxstab.model import LoopParameters, checked_gain, require_x64
from jaxstab.model.device import Device
from jaxstab.model.filters import Filters, given_filters
from jaxstab.motion import Amplitude, Response, Settling
from jaxstab.motion.amplitude import WallAmplitude, device_amplitude
from jaxstab.motion.response import simulate_device
from jaxstab.motion.settling import (
    HORIZON,
    Excitation,
    SettlingTime,
    device_settling_samples,
)
from jaxstab.numbers import checked


class LoopInTime(LoopParameters):
    """The answers of ``jaxstab.HapticLoop`` about the motion of device and hand at given walls."""

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

        It is ``jaxstab.settling_samples`` times the sample time; the tolerance is explained there.
        A count of samples jumps from number to number, so it has no useful derivative; that of
        ``spectral_radius`` says how the decay changes. The hand pushes or strikes at the handle,
        behind the actuators of a device.

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
            RuntimeError: JAX arrays are given without x64.

        Source: the loop of eqs. (1)-(5), Table I; lemmas M1 to M3 of docs/proofs.md.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> round(float(loop.settling_time(1000.0, 20.0).value), 3)
            0.069
        """
        self._refuse_tracers("settling_time")
        options: dict[str, Any] = {"excitation": excitation, "horizon": horizon}
        if self.body is None:
            samples = device_settling_samples(
                *self._device_and_filters, stiffness, damping, level, **options
            )
        else:
            alpha, beta = self._wall(stiffness, damping)
            samples = motion.settling_samples(
                alpha, beta, **self.slice, level=level, **options, **self.filters
            )
        return SettlingTime(samples.value * self.sample_time, samples.status)

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

        The loop is compared with the same loop without any of these, started and pushed alike. The
        answer bounds how far the two are apart at all times; as the undisturbed one comes to rest
        under a constant push, it bounds the chatter that the hand feels in the long run. See
        ``jaxstab.amplitude``.

        Args:
            stiffness: K in N/m, any shape; like all arguments it broadcasts.
            damping: B in N s/m.
            encoder: resolution of the position in m, which is rounded to the nearest multiple.
            force_step: resolution of the force in N, which is rounded to the nearest multiple.
            friction: largest Coulomb friction of the device in N, treated as any force at the
                handle that is never larger.
            noise: largest error of the position in m, beside that of the resolution.

        Returns:
            Amplitude in m, m/s and N; infinite where nothing is proved, as at the boundary of
            stability and beyond it.

        Raises:
            ValueError: an argument is negative, infinite or NaN, nothing disturbs the loop, or the
                device does not give way to a constant force.
            TypeError: a filter is traced.
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
        if self.body is None:
            causes = {"encoder": encoder, "force_step": force_step, "friction": friction}
            return device_amplitude(
                *self._device_and_filters, stiffness, damping, **causes, noise=noise
            )
        unit = self.mass / self.sample_time**2  # N that are 1 where 1 m is
        found = motion.amplitude(
            *self._wall(stiffness, damping),
            **self.slice,
            encoder=checked("encoder", encoder, 0.0),
            force_step=checked("force_step", force_step, 0.0) / unit,
            friction=checked("friction", friction, 0.0) / unit,
            noise=checked("noise", noise, 0.0),
            **self.filters,
        )
        return WallAmplitude(
            found.position,
            found.velocity / self.sample_time,
            found.force * unit,
            found.force_per_count * unit,
            found.status,
        )

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

        Device and hand move in continuous time. At every sample the wall computes -K x - B v from
        the position x, filtered if there is a filter, and the estimated velocity v; this force
        begins to act after the delay and is held for one sample. Before time 0 the device stood
        where it starts, held there by the hand, and no force was on its way.

        Args:
            stiffness: K in N/m, any shape; broadcasts with the four other arrays.
            damping: B in N s/m.
            samples: how many samples to simulate, from time 0 on.
            force: a step in N from time 0 on: the hand begins to push, at the handle.
            initial_velocity: in m/s at time 0: an impact on the wall, or a blow of this velocity
                times the mass. A device of several masses was thrown by a blow at the handle.
            initial_position: in m at time 0, the penetration if positive.
            between: how many equidistant points to return between two samples.
            unilateral: the wall pushes or pulls only while the sampled position is positive
                (Remark 1); otherwise it holds the device from both sides, as in the rest of the
                paper.

        Returns:
            Response at samples * (between + 1) times; exact up to rounding at each of them, and
            differentiable in all arrays.

        Raises:
            ValueError: a gain is infinite or NaN, nothing moves the device, a count is too small, a
                blow cannot throw the device, or it does not give way to a constant force.
            RuntimeError: JAX arrays are given without x64.

        Source: eqs. (1)-(5) and Fig. 2 of Hulin, Preusche, Hirzinger (2008); Remark 1.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> response = loop.simulate(1000.0, 20.0, samples=100, initial_velocity=0.1)
            >>> f"{1e3 * response.position.max():.3f} mm deep"
            '0.372 mm deep'
        """
        self._refuse_tracers("simulate")
        options: dict[str, Any] = {
            "samples": samples,
            "force": force,
            "initial_velocity": initial_velocity,
            "initial_position": initial_position,
            "between": between,
            "unilateral": unilateral,
        }
        if self.body is None:
            return simulate_device(*self._device_and_filters, stiffness, damping, **options)
        return motion.simulate(self, stiffness, damping, **options)

    @property
    def _device_and_filters(self) -> tuple[Device, float, float, Filters | None]:
        """Device, sampling period in s, delay in samples, estimator and filter in SI units."""
        loop = self.in_floats()
        assert loop.device is not None  # asked only where the device is not one mass
        filters = given_filters(loop.velocity, loop.position)
        return loop.device, loop.sample_time, loop.delay_samples, filters

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
