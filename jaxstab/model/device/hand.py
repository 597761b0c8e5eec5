"""The hand that holds a device: its dynamic stiffness, and its grip."""

from dataclasses import dataclass, replace

from jaxstab.model.device.parts import (
    Coefficients,
    MassSpringDamper,
    TransferFunction,
    checked_transfer_function,
)
from jaxstab.model.device.rational import Rational
from jaxstab.numbers import checked_number


@dataclass(frozen=True, repr=False)
class Hand:
    """A hand and arm by their dynamic stiffness Z(s), force over displacement, in N/m.

    Make one with ``mass_spring_damper`` or ``transfer_function``. ``with_grip`` puts fingers
    between the arm and the device; without a grip the arm is glued to the handle:

        handle ---[grip: spring and damper, in parallel]--- arm Z(s) --- ground

    ``Device.held_by`` says how device and hand work together.

    Example:
        >>> arm = jaxstab.Hand.mass_spring_damper(mass=1.0, damping=5.0, stiffness=300.0)
        >>> str(arm.with_grip(stiffness=2000.0, damping=4.0))
        'a hand of 1 kg, 5 N s/m, 300 N/m behind a grip of 4 N s/m, 2000 N/m'
    """

    dynamics: MassSpringDamper | TransferFunction
    grip: MassSpringDamper | None = None

    @classmethod
    def mass_spring_damper(
        cls, mass: float = 0.0, *, damping: float = 0.0, stiffness: float = 0.0
    ) -> "Hand":
        """Return an arm of one mass on a spring and a damper to the ground.

        Args:
            mass: in kg, >= 0.
            damping: in N s/m, >= 0.
            stiffness: in N/m, >= 0.

        Raises:
            TypeError: a value is no real number.
            ValueError: a value is out of range.

        Example:
            >>> print(jaxstab.Hand.mass_spring_damper(mass=1.0, damping=5.0, stiffness=300.0))
            a hand of 1 kg, 5 N s/m, 300 N/m
        """
        return cls(
            MassSpringDamper(
                checked_number("mass", mass, 0.0, unit="kg"),
                checked_number("damping", damping, 0.0, unit="N s/m"),
                checked_number("stiffness", stiffness, 0.0, unit="N/m"),
            )
        )

    @classmethod
    def transfer_function(cls, numerator: Coefficients, denominator: Coefficients) -> "Hand":
        """Return an arm by its dynamic stiffness Z(s) = force / displacement, in N/m.

        Args:
            numerator: coefficients in s, highest power first; [m, b, k] is a mass-spring-damper.
            denominator: the same; its degree is at most two below that of the numerator, as the
                force on a mass is m s^2.

        Raises:
            TypeError: the coefficients are no numbers.
            ValueError: a polynomial is 0, or the degrees do not fit.

        Example:
            >>> print(jaxstab.Hand.transfer_function([1.0, 5.0, 300.0], [1.0]))
            a hand of a transfer function in s of order 0
        """
        what = "the force on a hand grows with the acceleration at most, two degrees"
        return cls(checked_transfer_function(numerator, denominator, 2, what))

    def with_grip(self, *, stiffness: float, damping: float = 0.0) -> "Hand":
        """Return the same arm behind a grip: a spring and a damper side by side, without mass.

        Args:
            stiffness: in N/m, >= 0.
            damping: in N s/m, >= 0; not both are 0.

        Raises:
            TypeError: a value is no real number.
            ValueError: a value is out of range, or both are 0, or there is a grip already.

        Example:
            >>> arm = jaxstab.Hand.mass_spring_damper(mass=1.0, damping=5.0, stiffness=300.0)
            >>> print(arm.with_grip(stiffness=2000.0, damping=4.0))
            a hand of 1 kg, 5 N s/m, 300 N/m behind a grip of 4 N s/m, 2000 N/m
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
