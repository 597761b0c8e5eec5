"""A device with its vibration modes, actuators and a held grip, of any mass, for any hand.

In units of one sample, with s = i theta or any other number, position over force is N(s)/D(s). Both
are polynomials that are affine in the mass of the device and in what the arm is made of.
"""

from dataclasses import replace
from math import hypot, inf, pi, prod
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64

from jaxstab.model import Device, LoopParameters
from jaxstab.model import Hand as Arm
from jaxstab.model.device.parts import MassSpringDamper, Mode, Modes

_ALIASES = 4  # on either side, that responses without a bound add up

Function = Any  # a number, an array or a model of a function over boxes


class Arms(NamedTuple):
    """What the arm is made of: mass in kg; stiffness and damping in units of one sample, too."""

    mass: Function
    stiffness: Function
    damping: Function


class HeldDevice(NamedTuple):
    """A device of any mass in the hand of any arm, in units of one sample and kg.

    Attributes:
        damping: of the rigid body, b T.
        stiffness: to the ground, k T^2.
        modes: angular frequency, damping ratio and mass of the vibration modes.
        lags: angular frequencies of the actuators.
        grip: stiffness and damping between the arm and the device; None if they are glued.
    """

    damping: float
    stiffness: float
    modes: tuple[tuple[float, float, float], ...]
    lags: tuple[float, ...]
    grip: tuple[float, float] | None

    @classmethod
    def of(cls, device: Device, period: float) -> "HeldDevice":
        """Return a device, for some sampling period in s.

        Raises:
            NotImplementedError: the device has no mass that could change, or the hand is none of
                one mass, spring and damper, or slips out of its grip.
        """
        body = _body_of(device)
        springs = body.stiffness if isinstance(body, MassSpringDamper) else 0.0
        modes = body.modes if isinstance(body, Modes) else ()
        grips = [hand.grip for hand in device.hands if hand.grip is not None]
        return cls(
            body.damping * period,
            springs * period**2,
            tuple(_mode_in_samples(mode, period) for mode in modes),
            tuple(2.0 * pi * hertz * period for hertz in device.bandwidths),
            (grips[0].stiffness * period**2, grips[0].damping * period) if grips else None,
        )

    def parts(self, s: Function, mass: Function, arm: Arms) -> tuple[Function, Function]:
        """Return N(s) and D(s) in 1/kg, of numbers, arrays or models."""
        # The square comes last: only it takes from the stiffness, which is rounded.
        body = (s * self.damping + self.stiffness) + s * s * mass
        held = s * (s * arm.mass + arm.damping) + arm.stiffness
        above, below = 1.0, body
        if self.modes:
            give, whole = self._vibrations(s)
            above, below = body * give + whole, body * whole
        if self.grip is None:
            below = below + held * above
        else:
            # Of a unit of the stiffer one, so that a pure spring and a pure damper are of size 1.
            unit = 1.0 / (self.grip[0] + self.grip[1])
            between = s * (self.grip[1] * unit) + self.grip[0] * unit
            both = held * unit + between
            below = below * both + held * between * above
            above = both * above
        if self.lags:
            below = below * self.lag(s)
        return above, below

    def lag(self, s: Function) -> Function:
        """Return the denominator of the actuators."""
        product = 1.0
        for lag in self.lags:
            product = (s * (1.0 / lag) + 1.0) * product
        return product

    @property
    def is_passive(self) -> bool:
        """Whether device and arm, without actuators, give no energy."""
        return all(moved > 0.0 for _, _, moved in self.modes)

    def _vibrations(self, s: Function) -> tuple[Function, Function]:
        """Return numerator and denominator of the sum of the modes' displacements over force."""
        give, whole = 0.0, 1.0
        for frequency, damping_ratio, moved in self.modes:
            part = s * (1.0 / frequency)
            one = part * (part + 2.0 * damping_ratio) + 1.0
            give, whole = one * give + whole * (1.0 / (moved * frequency**2)), one * whole
        return give, whole

    def response(
        self,
        mass: float,
        arm: Arms,
        delay: Float64[np.ndarray, " delay"],
        theta: Float64[np.ndarray, " angle"],
    ) -> Complex128[np.ndarray, "delay arm angle"]:
        """Return sampled position over force on the unit circle, to 1e-3 or so.

        Source: the sum of aliases, lemma B20 of docs/proofs.md.
        """
        turns = theta + 2.0 * pi * np.arange(-_ALIASES, _ALIASES + 1)[:, None]
        arms = Arms(*(np.reshape(part, (-1, 1, 1)) for part in arm))
        above, below = self.parts(1j * turns, mass, arms)
        terms = above / below * (2.0 * np.sin(0.5 * theta) / turns)
        phases = np.exp(-1j * (turns * delay[:, None, None] + 0.5 * theta))
        sums: np.ndarray = np.einsum("hka,dka->dha", terms, phases, optimize=True)
        return sums

    def largest_compliance(
        self, mass: tuple[float, float], arm: tuple[float, float], beyond: float
    ) -> float:
        """Return a bound of w^2 |N/D| at s = i w for w >= beyond; infinite where none is known.

        Args:
            mass: the smallest and the largest one of the device.
            arm: the largest stiffness and the smallest damping of the arm, of any mass.
            beyond: an angle in radians per sample.

        Source: lemma B20 of docs/proofs.md.
        """
        light = off = 0.0
        for moved, damper, spring in self._bodies(mass[0], beyond):
            if damper + spring >= 1.0:
                return inf
            light += 1.0 / moved
            off += (damper + spring) / (abs(moved) * (1.0 - damper - spring))
        stiff = arm[0]
        if self.grip is not None:
            grip = self.grip[0] + beyond * self.grip[1]
            damped = beyond * (self.grip[1] + arm[1])
            stiff = grip * (1.0 + grip / damped) if damped else inf
        clear = 1.0 / (light + off) - stiff / beyond**2
        weaker = prod(hypot(1.0, beyond / lag) for lag in self.lags)
        is_known = off < light - (1.0 / mass[0] - 1.0 / mass[1]) and clear > 0.0
        return 1.0 / (clear * weaker) if is_known else inf

    def _bodies(self, mass: float, beyond: float) -> list[tuple[float, float, float]]:
        """Return masses that move, and how much damper and spring do beside them at most."""
        own = mass, self.damping / (mass * beyond), self.stiffness / (mass * beyond**2)
        ratios = [frequency / beyond for frequency, _, _ in self.modes]
        return [own] + [
            (moved, 2.0 * damping_ratio * ratio, ratio**2)
            for (_, damping_ratio, moved), ratio in zip(self.modes, ratios, strict=True)
        ]


def device_of(loop: LoopParameters) -> Device:
    """Return the device of a loop, without a hand where it is one mass by its numbers."""
    if loop.device is not None:
        return loop.device
    return Device.mass_spring_damper(loop.device_mass, damping=loop.device_damping)


def with_parts(device: Device, mass: float, arm: Arms) -> Device:
    """Return a device with another mass, held by another arm behind the same grip, if any."""
    dynamics = MassSpringDamper(arm.mass, arm.damping, arm.stiffness)
    hands = device.hands or (Arm.mass_spring_damper(),)
    mechanism = replace(_body_of(device), mass=mass)
    return replace(device, mechanism=mechanism, hands=(replace(hands[0], dynamics=dynamics),))


def _body_of(device: Device) -> MassSpringDamper | Modes:
    body, hands = device.mechanism, device.hands
    known = isinstance(body, MassSpringDamper) or (
        isinstance(body, Modes) and body.mass is not None
    )
    known &= len(hands) <= 1 and all(isinstance(hand.dynamics, MassSpringDamper) for hand in hands)
    known &= all(hand.grip is None or hand.grip.stiffness > 0.0 for hand in hands)
    if not known or not isinstance(body, MassSpringDamper | Modes):
        raise NotImplementedError(
            "a guard is proved for a mass with vibration modes, actuators and one hand of mass, "
            f"spring and damper, behind a grip with a spring or glued; this device is {device}."
        )
    return body


def _mode_in_samples(mode: Mode, period: float) -> tuple[float, float, float]:
    return 2.0 * pi * mode.frequency * period, mode.damping_ratio, mode.modal_mass
