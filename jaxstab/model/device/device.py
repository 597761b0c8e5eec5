"""General linear devices, from the wall's force to the position that the encoder shows.

A device G, hands Z_i and actuators w_j / (s + w_j) make one compliance, position over force:

    H(s) = G / (1 + G (Z_1 + Z_2 + ...))  *  product of the w_j / (s + w_j)

where motor, encoder and handle are one point. Where they are not, with the compliances G_em from
the motor to the encoder, and so on, a hand makes of G_em

    G_em - G_eh Z G_hm / (1 + Z G_hh) = (e_m y + z E) / (d y + z h_h),  E = (e_m h_h - e_h h_m)/d,

in numerators over their denominator d, and Z = z/y (``Ports``). E is a polynomial: each mode is of
rank one, and so is each pole of a state space.

It is a quotient of polynomials whose coefficients are exact (``parts``), with the common factors
removed. A common factor is a state that the force does not move or the position does not show; the
device is refused if such a state does not decay, but for a drift. Poles are certified: the
denominator is divided into squarefree factors, so that all of their roots are simple, and these are
isolated in balls.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import inf
from typing import Any

import numpy as np
from jaxtyping import Complex128

from jaxstab.model.device.discrete import (
    INTEGRATORS,
    InSteps,
    Simulated,
    checked_discrete,
)
from jaxstab.model.device.parts import (
    HIGHEST_ORDER,
    Coefficients,
    MassSpringDamper,
    Mode,
    Modes,
    Ports,
    Rational,
    StateSpace,
    TransferFunction,
    balls_of,
    checked_compliance,
    checked_state_space,
    checked_transfer_function,
    degree_of,
    polynomial,
    roots_of,
    turn,
    working_precision,
)
from jaxstab.numbers import checked_number, checked_word, require_kind
from jaxstab.shown import shortened


def _sides_of(system: Any) -> list[Any]:
    """A, B, C and D of a system of python-control or scipy.signal, or its two polynomials."""
    if all(hasattr(system, name) for name in "ABCD"):
        sides = [np.atleast_2d(getattr(system, name)) for name in "ABCD"]
        others = (1, 2) if getattr(system, "dt", None) else (2, 2)
        _refuse_many(sides[1].shape[1], sides[2].shape[0], others)
        return sides
    if all(hasattr(system, name) for name in ("zeros", "poles", "gain", "to_tf")):  # of scipy
        system = system.to_tf()
    if not (hasattr(system, "num") and hasattr(system, "den")):
        raise TypeError(
            f"system is {shortened(system)}; give a TransferFunction or StateSpace of "
            "python-control or scipy.signal, fitted to the data if they are a frequency response."
        )
    sides = [system.num, system.den]
    if isinstance(system.num, list):  # python-control: a row of lists for each output
        _refuse_many(len(system.num[0]), len(system.num))
        sides = [side[0][0] for side in sides]
    return [np.atleast_1d(side) for side in sides]


def _refuse_many(inputs: int, outputs: int, other: tuple[int, int] = (1, 1)) -> None:
    if (inputs, outputs) not in ((1, 1), other):
        raise ValueError(
            f"the system has {inputs} inputs and {outputs} outputs; give one force and one "
            "position; a state space in s may have those of the hand beside them, one in z the "
            "velocity."
        )


def _one_mass(mass: float, damping: float, stiffness: float, *, is_open: bool) -> MassSpringDamper:
    return MassSpringDamper(
        checked_number("mass", mass, 0.0, is_open=is_open, unit="kg"),
        checked_number("damping", damping, 0.0, unit="N s/m"),
        checked_number("stiffness", stiffness, 0.0, unit="N/m"),
    )


# The hand that holds a device: its dynamic stiffness, and its grip.


@dataclass(frozen=True, repr=False)
class Hand:
    """A hand and arm by their dynamic stiffness Z(s), force over displacement, in N/m.

    Make one with ``mass_spring_damper`` or ``transfer_function``. ``with_grip`` puts fingers
    between the arm and the device; without a grip the arm is rigidly attached to the handle:

        handle ---[grip: spring and damper, in parallel]--- arm Z(s) --- ground

    ``Device.held_by`` combines device and hand.

    Raises, of all methods: see ``jaxstab.conventions``; they say what they refuse beside it.

    Example:
        >>> arm = jaxstab.Hand.mass_spring_damper(mass=1.0, damping=5.0, stiffness=300.0)
        >>> str(arm.with_grip(stiffness=2000.0, damping=4.0))
        'a hand of 1 kg, 5 N s/m, 300 N/m behind a grip of 4 N s/m, 2000 N/m'
        >>> print(jaxstab.Hand.transfer_function([1.0, 5.0, 300.0], [1.0]))
        a hand of a transfer function in s of order 0
    """

    dynamics: MassSpringDamper | TransferFunction
    grip: MassSpringDamper | None = None

    @classmethod
    def mass_spring_damper(
        cls, mass: float = 0.0, *, damping: float = 0.0, stiffness: float = 0.0
    ) -> "Hand":
        """An arm of one mass on a spring and a damper to the ground: kg, N s/m, N/m, each >= 0."""
        return cls(_one_mass(mass, damping, stiffness, is_open=False))

    @classmethod
    def transfer_function(cls, numerator: Coefficients, denominator: Coefficients) -> "Hand":
        """An arm by its dynamic stiffness Z(s) = force / displacement, in N/m.

        Coefficients have the highest power first; [m, b, k] above [1] is a mass-spring-damper. The
        denominator's degree is at most two lower, as the force on a mass is m s^2.

        Raises: ValueError also if a polynomial is 0, or the degrees do not fit.
        """
        what = "the force on a hand grows with the acceleration at most, two degrees"
        return cls(checked_transfer_function(numerator, denominator, 2, what))

    def with_grip(self, *, stiffness: float, damping: float = 0.0) -> "Hand":
        """The same arm behind a grip: a massless spring and damper in parallel, in N/m and N s/m.

        Raises: ValueError also if both are 0, or there is a grip already.
        """
        if self.grip is not None:
            raise ValueError(f"the hand has a grip of {self.grip}; give one to a hand without.")
        spring = checked_number("stiffness", stiffness, 0.0, unit="N/m")
        damper = checked_number("damping", damping, 0.0, unit="N s/m")
        if spring == damper == 0.0:
            raise ValueError("stiffness and damping are 0.0; give a grip that holds something.")
        return replace(self, grip=MassSpringDamper(0.0, damper, spring))

    def dynamic_stiffness(self) -> Rational:
        """Return the force at the handle over its displacement, in exact numbers."""
        arm = self.dynamics.dynamic_stiffness()
        if self.grip is None:
            return arm
        return self.grip.dynamic_stiffness().in_series(arm).reduced()[0]

    def __repr__(self) -> str:
        grip, arm = self.grip, self.dynamics.call("Hand")
        if grip is None:
            return arm
        return f"{arm}.with_grip(stiffness={grip.stiffness!r}, damping={grip.damping!r})"

    def __str__(self) -> str:
        grip = "" if self.grip is None else f" behind a grip of {self.grip}"
        return f"a hand of {self.dynamics}{grip}"


_BITS = 1024


@dataclass(frozen=True, repr=False)
class Device:
    """A haptic device as a linear system in SI units: the force in N moves the position in m.

    Make one with ``mass_spring_damper``, ``modes``, ``transfer_function``, ``state_space`` or
    ``from_control``, or in z with ``discrete`` or ``simulated``; ``held_by`` attaches a hand,
    ``with_actuator`` a motor of finite bandwidth:

        wall's force --> [actuator] --> motor  [device]  encoder --> position
                                       handle <--------> hands

    Motor, encoder and handle are one point, unless modes have shapes there, or a state space has a
    second force and position: those of the hand. A device may be unstable or marginal without a
    wall (``stability``). The numbers are taken as exact, and everything computed from them has
    error bounds.

    Raises, of all methods: see ``jaxstab.conventions``; they say what they refuse beside it.

    Example:
        >>> arm = jaxstab.Hand.mass_spring_damper(mass=1.0, damping=5.0, stiffness=300.0)
        >>> device = jaxstab.Device.mass_spring_damper(mass=0.25, damping=0.1)
        >>> print(device.with_actuator(200.0).held_by(arm.with_grip(stiffness=2000.0, damping=4.0)))
        0.25 kg, 0.1 N s/m; an actuator of 200 Hz; a hand of 1 kg, 5 N s/m, 300 N/m behind a grip
        of 4 N s/m, 2000 N/m
        >>> device.poles().real.round(3).tolist(), device.stability  # it may drift
        ([0.0, -0.4], 'marginal')
        >>> device.held_by(arm).one_mass()
        MassSpringDamper(mass=1.25, damping=5.1, stiffness=300.0)
        >>> device.held_by(arm).static_stiffness()
        300.0
        >>> mode = jaxstab.Mode(frequency=80.0, damping_ratio=0.01, modal_mass=0.5)
        >>> print(jaxstab.Device.modes([mode], mass=0.25, damping=0.1))
        0.25 kg, 0.1 N s/m with modes at 80 Hz
        >>> jaxstab.Device.transfer_function([1.0], [0.25, 0.1, 0.0]).poles().tolist()
        [0j, (-0.4+0j)]
        >>> same = jaxstab.Device.state_space([[0, 1], [0, -0.4]], [[0], [4]], [[1, 0]])
        >>> sorted(same.poles().real.tolist())
        [-0.4, 0.0]
        >>> import control
        >>> len(jaxstab.Device.from_control(control.tf([1], [0.25, 0.1, 0.0])).poles())
        2
        >>> print(jaxstab.Device.discrete([2e-6, 2e-6], [1.0, -2.0, 1.0], step=1e-3))
        a device in z of order 2, steps of 0.001 s
        >>> print(jaxstab.Device.simulated(0.1, step=2e-3))
        a simulated inertia of 0.1, steps of 0.002 s
    """

    mechanism: MassSpringDamper | Modes | TransferFunction | StateSpace | InSteps
    hands: tuple[Hand, ...] = ()
    bandwidths: tuple[float, ...] = ()

    @classmethod
    def mass_spring_damper(
        cls, mass: float, *, damping: float = 0.0, stiffness: float = 0.0
    ) -> "Device":
        """A device of one mass > 0 at the handle in kg, damping, stiffness >= 0 to the ground."""
        return cls(_one_mass(mass, damping, stiffness, is_open=True))

    @classmethod
    def modes(
        cls, modes: Sequence[Mode] | Mode, *, mass: float | None = None, damping: float = 0.0
    ) -> "Device":
        """A device of a rigid body and vibration modes whose displacements add up.

        Args:
            modes: the vibration modes, or the one that there is.
            mass: of the rigid body in kg, > 0; None for a structure that is fixed to the ground.
            damping: of the rigid body in N s/m, >= 0.

        Raises: TypeError also if a mode is not a Mode, ValueError if there is neither a mode nor a
        mass.
        """
        given: Any = modes if isinstance(modes, Sequence) else [modes]
        most = HIGHEST_ORDER // 2 - (mass is not None)
        if len(given) > most:
            raise ValueError(f"modes has {len(given)} modes; give {most} at most.")
        for mode in given:
            if not isinstance(mode, Mode):
                words = f"modes has {shortened(mode)}; give jaxstab.Mode(...) for each mode."
                raise TypeError(words)
        if mass is None and not given:
            raise ValueError("modes is empty and mass is None; give at least one of them.")
        if mass is not None:
            mass = checked_number("mass", mass, 0.0, is_open=True, unit="kg")
        damping = checked_number("damping", damping, 0.0, unit="N s/m")
        if mass is None and damping:
            raise ValueError(f"damping is {damping:g} N s/m, of no mass; give mass, too.")
        return cls(Modes(mass, damping, tuple(given)))._checked()

    @classmethod
    def transfer_function(cls, numerator: Coefficients, denominator: Coefficients) -> "Device":
        """A device by its transfer function in s, position over force, in m/N.

        Coefficients have the highest power first. The denominator has the higher degree, up to 40;
        [m, b, k] below [1] is a mass-spring-damper.

        Raises: ValueError also if a polynomial is 0, or the degrees do not fit.
        """
        what = "position over force is strictly proper, a force moves a device, in time"
        return cls(checked_transfer_function(numerator, denominator, -1, what))._checked()

    @classmethod
    def state_space(cls, A: Any, B: Any, C: Any) -> "Device":
        """A device by x' = A x + B u with the force u in N and the position C x in m.

        States that the force does not move, or that the position does not show, are removed,
        exactly for the given numbers. A device with such a state that does not decay is refused,
        but for a drift (s = 0).

        A is of shape (n, n), n from 1 to 40, B of (n, 1) or (n,), C of (1, n) or (n,). Where the
        hand is elsewhere, B is of (n, 2), its second column for the hand's force, and C of (2, n),
        its second row for the position there; the first ones are motor and encoder.

        Raises: ValueError also if the shapes do not fit, the position never moves, or a hidden
        state does not decay.
        """
        return cls(checked_state_space(A, B, C))._checked()

    @classmethod
    def discrete(cls, *system: Any, step: float) -> "Device":
        """A device in z: numerator and denominator, or A, B, C and D, and its step in s.

        The highest power comes first. It leads from the force, held for a step, to the position at
        the steps, hand and actuator included; a second row of C and D is the velocity
        (``Velocity.measured``). Of a loop, sample time and delay are whole numbers of its steps.
        Parts that no output shows count as all others do.

        Raises: ValueError also if shapes do not fit, it is not proper, of an order above 40, or
        never moves.
        """
        return cls(checked_discrete(system, step))

    @classmethod
    def simulated(
        cls,
        inertia: float,
        *,
        step: float,
        damping: float = 0.0,
        stiffness: float = 0.0,
        integrator: str = "semi-implicit",
    ) -> "Device":
        """A joint of a physics engine, or a mass, under a force that is computed outside of it.

        Args and Raises: as ``jaxstab.simulated_pd``. The engine's own velocity is its second output
        (``Velocity.measured``).
        """
        step = checked_number("step", step, 0.0, is_open=True, unit="s")
        inertia = checked_number("inertia", inertia, 0.0, is_open=True, unit="kg m^2")
        damping = checked_number("damping", damping, 0.0)
        stiffness = checked_number("stiffness", stiffness, 0.0)
        rule = checked_word("integrator", integrator, INTEGRATORS)
        return cls(Simulated(step, inertia, damping, stiffness, rule))

    @classmethod
    def from_control(cls, system: Any) -> "Device":
        """A device from a system of python-control or ``scipy.signal``, in s or in z.

        It is a TransferFunction, StateSpace or (scipy's) ZerosPolesGain, of one force in N and one
        position in m; one that is sampled, with its dt in s, is ``discrete``. ``held_by`` lets the
        hand act at these; where it is elsewhere, give a StateSpace in s whose second input and
        output are the hand's force and its position. To frequency response data fit a
        TransferFunction first.

        Raises: TypeError if it is of another kind; ValueError if it is not (in s: strictly) proper,
        or has more inputs or outputs.
        """
        sides, step = _sides_of(system), getattr(system, "dt", None)
        if step is True:
            raise ValueError("the system is sampled, with dt = True; give its step in s.")
        if step:
            return cls.discrete(*sides, step=step)
        if len(sides) == 2:
            return cls.transfer_function(*sides)
        if np.any(sides[3]):
            raise ValueError(
                f"D is {sides[3].tolist()}; position over force is strictly proper in s: give "
                "D = 0."
            )
        return cls.state_space(*sides[:3])

    def held_by(self, hand: Hand) -> "Device":
        """The device with a hand at its handle: G / (1 + G Z), G without the actuators.

        The forces of several hands add up.

        Raises: TypeError if it is not a Hand; ValueError if hand and device cancel out, are of an
        order above 40, if a mode has a negative mass: motor and encoder are then apart, and it is
        not known where the hand acts; or if the handle has a negative mass that the hand's exceeds.
        """
        require_kind("hand", hand, Hand)
        if degree_of(hand.dynamic_stiffness().numerator) >= 0:  # it does anything
            self.require_handle()
        return replace(self, hands=(*self.hands, hand))._checked()

    def with_actuator(self, bandwidth: float) -> "Device":
        """The device behind an actuator of the force: w / (s + w), w = 2 pi bandwidth.

        It acts on the wall's force, not on that of a hand; several actuators follow one another.

        At the bandwidth, in Hz and > 0, the force is 3 dB too weak.
        """
        bandwidth = checked_number("bandwidth", bandwidth, 0.0, is_open=True, unit="Hz")
        return replace(self, bandwidths=(*self.bandwidths, bandwidth))._checked()

    def compliance(self) -> Rational:
        """Return position over the wall's force in exact numbers, without a common factor."""
        return _compliance(self)

    def ports(self) -> Ports:
        """The responses to forces at motor and handle, without actuators, in exact numbers."""
        return _held(self).reduced()

    def static_stiffness(self) -> float:
        """Force in N that holds the handle 1 m from its rest position, without a wall.

        It is 0 for a free mass, and infinite where a constant force moves nothing.
        """
        ports = self.ports()
        held, _ = Rational(ports.handle_by_hand, ports.below).reduced()
        with working_precision(_BITS):
            above, below = (balls_of(side)[0] for side in held)
            return inf if above == 0 else float((below / above).mid())

    def poles(self) -> Complex128[np.ndarray, " pole"]:
        """The poles without a wall in rad/s, with multiplicity, rightmost first.

        Each is the nearest complex float64, or a neighbour of it.
        """
        balls = [ball for ball, count in _pole_balls(self) for _ in range(count)]
        numbers = np.array([complex(z.real, 0 if z.imag.contains(0) else z.imag) for z in balls])
        return numbers[np.argsort(-numbers.real, kind="stable")]

    @property
    def stability(self) -> str:
        """The device's stability without a wall: "stable", "marginal" or "unstable".

        A free mass is marginal. Poles within 1e-60 rad/s of the imaginary axis count as on it.
        """
        reals = [ball.real for ball, _ in _pole_balls(self)]
        if any(real > 0 for real in reals):
            return "unstable"
        return "stable" if all(real < 0 for real in reals) else "marginal"

    def one_mass(self) -> MassSpringDamper | None:
        """Device and hands as one mass if rigidly attached and without actuators, else None."""
        systems = [self.mechanism, *(hand.dynamics for hand in self.hands)]
        is_one = all(isinstance(system, MassSpringDamper) for system in systems)
        if not is_one or self.bandwidths or any(hand.grip for hand in self.hands):
            return None
        return MassSpringDamper(*map(sum, zip(*(vars(x).values() for x in systems), strict=True)))

    def require_handle(self) -> None:
        """Refuse a device whose handle is not known.

        Raises: ValueError if a mode has a negative mass.
        """
        body = self.mechanism
        for mode in body.modes if isinstance(body, Modes) else ():
            if mode.modal_mass < 0.0:
                raise ValueError(
                    f"modal_mass is {mode.modal_mass:g} beside a hand: such a mode moves motor and "
                    "encoder against each other, and the hand's place is not known; give "
                    f"modal_mass = {-mode.modal_mass:g} with the shapes motor = 1, encoder = -1, "
                    "and handle = 1 or -1, where the hand is."
                )

    def _checked(self) -> "Device":
        self.compliance()
        return self

    def __repr__(self) -> str:
        actuators = [f".with_actuator({bandwidth!r})" for bandwidth in self.bandwidths]
        hands = [f".held_by({hand!r})" for hand in self.hands]
        return "".join([self.mechanism.call("Device"), *actuators, *hands])

    def __str__(self) -> str:
        actuators = [f"an actuator of {bandwidth:g} Hz" for bandwidth in self.bandwidths]
        return "; ".join([str(self.mechanism), *actuators, *map(str, self.hands)])


def in_steps(device: Device) -> InSteps | None:
    """A device in z alone; None for one in s."""
    body, is_alone = device.mechanism, not (device.hands or device.bandwidths)
    return body if isinstance(body, InSteps) and is_alone else None


@lru_cache(maxsize=256)
def _compliance(device: Device) -> Rational:
    ports = _held(device)
    function = Rational(ports.encoder, ports.below)
    if ports.excess is None and not (device.hands or device.bandwidths):
        return function  # checked, and without a common factor
    for bandwidth in device.bandwidths:
        w = turn(bandwidth)
        function = function.times(Rational(w, polynomial([1.0, 0.0]) + w))
    return checked_compliance(function, device)


@lru_cache(maxsize=256)
def _held(device: Device) -> Ports:
    ports = device.mechanism.ports()
    alone = checked_compliance(Rational(ports.encoder, ports.below), device.mechanism)
    ports = Ports.at_one_point(*alone) if ports.excess is None else ports.reduced()
    for hand in device.hands:
        stiffness = hand.dynamic_stiffness()
        free, ports = ports.below * stiffness.denominator, ports.held_by(*stiffness)
        if ports.excess is not None and not _has_mass_left(free, ports.below):
            raise ValueError(
                f"the handle of the device ({device.mechanism}) moves under fast forces as a "
                f"negative mass would, which {hand} makes 0 or exceeds; give shapes or ports of "
                "one sense to motor, encoder and handle."
            )
    return ports


def _has_mass_left(free: Any, held: Any) -> bool:
    """True if a hand leaves the sense of the leading coefficient of the denominator."""
    if degree_of(held) > degree_of(free):
        return True  # a mass on a device without one
    with working_precision(_BITS):
        before, after = balls_of(free), balls_of(held)
        return len(after) == len(before) and bool(after[-1] / before[-1] > 0)


@lru_cache(maxsize=256)
def _pole_balls(device: Device) -> list[tuple[Any, int]]:
    return roots_of(device.compliance().denominator)
