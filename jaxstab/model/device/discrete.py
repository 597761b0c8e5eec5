"""Devices that are known at samples alone: in z, as physics engines step them.

A step is x+ = F x + G u, and position and, where it is a second output, velocity are C x + D u, in
exact numbers. A controller that acts every n steps, and whose force is late by d = w n + f of them,
meets with Gamma_j = G + F G + ... + F^(j-1) G

    z^-lag N/D,     D = det(z - F^n),     N = C adj(z - F^n) (Gamma_(n-f) z + F^(n-f) Gamma_f),

and C adj(z - F^n) Gamma_n, one sample less late, for f = 0. c adj(z - M) v is det(z - M + v c) -
det(z - M). There is no motion between the steps: hands, actuators and whatever else needs a
function of s are refused by ``ports``, which they all ask for.
"""

from dataclasses import dataclass
from functools import lru_cache, partial
from math import isclose
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxstab.model.device.parts import HIGHEST_ORDER, Part, Ports, exact, flint, polynomial
from jaxstab.numbers import checked, checked_number

if TYPE_CHECKING:
    from flint import fmpq, fmpq_mat, fmpq_poly, fmpz, fmpz_mat

INTEGRATORS = ("explicit", "semi-implicit", "implicit-joint", "implicit-damping", "implicit", "rk4")


Sampled = tuple["fmpq_poly", "list[fmpq_poly]", int]
"""D(z), N(z) of each output, and the lag."""


@dataclass(frozen=True)
class InSteps(Part):
    """A device that is known at its steps alone."""

    step: float

    def one_step(self) -> "tuple[fmpq_mat, fmpq_mat, list[tuple[fmpq_mat, fmpq]]]":
        """F and G, and of each output its row c and its d."""
        raise NotImplementedError

    @property
    def has_velocity(self) -> bool:
        """True if the velocity is a second output."""
        return len(self.one_step()[2]) == 2

    def ports(self) -> Ports:
        """There are none in s: ValueError."""
        raise ValueError(
            f"the device ({self}) is known at its steps alone: its poles in s, motion between "
            "samples, delays that move, hands and actuators are not; give a device in s "
            "(Device.state_space, for instance), or one in z that has hand and actuator in it."
        )

    def at_rest(self) -> tuple[Any, Any]:
        """Position and constant force at rest, as ``Rational.at_rest``."""
        below, above, _ = sampled_steps(self, 1, 0)
        return polynomial([above[0](1)]), polynomial([below(1)])

    def steps(self, sample_time: float, delay_samples: float) -> tuple[int, int]:
        """The steps of a sample, and those by which the force is late; both are whole.

        Raises: ValueError if they are not, or the loop is algebraic.
        """
        given = sample_time / self.step, delay_samples * sample_time / self.step
        count, late = map(round, given)
        are_whole = map(partial(isclose, rel_tol=1e-9, abs_tol=1e-9), given, (count, late))
        if not (1 <= count <= 1000 and all(are_whole)):
            raise ValueError(
                f"sample_time is {given[0]:g} steps of {self.step:g} s of the device in z and the "
                f"delay {given[1]:g}; give whole numbers of steps, 1 to 1000 of them a sample."
            )
        if not late and any(direct for _, direct in self.one_step()[2]):
            raise ValueError(
                f"the device ({self}) moves in the same step as the force, and without a delay the "
                "force depends on it: the loop is algebraic; give a delay of a step or more."
            )
        return count, late

    def sampled(self, sample_time: float, delay_samples: float) -> Sampled:
        """The device behind its hold and a delay."""
        return sampled_steps(self, *self.steps(sample_time, delay_samples))


@lru_cache(maxsize=128)
def sampled_steps(device: InSteps, count: int, delay: int) -> Sampled:
    """The same, for steps a sample and a delay in steps; ValueError if it does not move."""
    move, push, outputs = device.one_step()
    whole, late = divmod(delay, count)
    last = [0] * move.nrows() + [1]  # [[F, G], [0, 1]]^j is [[F^j, Gamma_j], [0, 1]]
    rows = [row + column for row, column in zip(move.tolist(), push.tolist(), strict=True)]
    # Over one denominator: of fractions each sum would look for a common divisor.
    held, unit = flint.fmpq_mat([*rows, last]).numer_denom()
    early = held ** (count - late)
    powers = [power.tolist()[:-1] for power in (early * held**late, early)]
    everything, newest = (flint.fmpz_mat([row[-1:] for row in power]) for power in powers)
    newest, over = newest * unit**late, unit**count
    onward = flint.fmpz_mat([row[:-1] for row in powers[0]])
    below, numerators = _characteristic(onward, over), []
    for row, direct in outputs:
        seen, share = row.numer_denom()
        newer, older = (
            _characteristic(onward * share - column * seen, over * share) - below
            for column in (newest, everything - newest)
        )
        moved = newer * flint.fmpq_poly([0, 1]) + older if late else newer
        numerators.append(moved + direct * below)
    if not all(numerators):
        raise ValueError(f"the device ({device}) does not move at samples; give a force that acts.")
    return below, numerators, whole + (late > 0)


def _characteristic(whole: "fmpz_mat", over: "fmpz") -> "fmpq_poly":
    """The characteristic polynomial of a matrix of whole numbers over one number."""
    rising = whole.charpoly().coeffs()
    own = [c * over**power for power, c in enumerate(rising)]
    return flint.fmpq_poly(own, over ** (len(rising) - 1))


@lru_cache(maxsize=64)
def held_steps(device: InSteps) -> "tuple[fmpq_mat, fmpq_mat | None]":
    """[[F, G], [0, 1]] of states of which the first is the position, and the velocity's row.

    Its powers are the states after so many steps under a constant force. ValueError if the force
    moves the device at once.
    """
    move, push, outputs = device.one_step()
    if any(direct for _, direct in outputs):
        raise ValueError(
            f"the device ({device}) moves in the same step as the force: its motion is not known; "
            "give one that moves a step later."
        )
    size, position = move.nrows(), outputs[0][0].tolist()[0]
    left_out = next(k for k in range(size) if position[k] != 0)
    others = [[int(k == row) for k in range(size)] for row in range(size) if row != left_out]
    basis = flint.fmpq_mat([position, *others])
    move, push = basis * move * basis.inv(), basis * push
    rows = [row + column for row, column in zip(move.tolist(), push.tolist(), strict=True)]
    held = flint.fmpq_mat([*rows, [0] * size + [1]])
    return held, outputs[1][0] * basis.inv() if len(outputs) > 1 else None


@dataclass(frozen=True)
class Discrete(InSteps):
    """Numerators and a denominator, or A, B, C and D, of one or two outputs."""

    system: tuple[Any, ...]

    def call(self, kind: str) -> str:
        """Return the call that makes a device of it."""
        return f"{kind}.discrete({', '.join(map(repr, self.system))}, step={self.step!r})"

    def __str__(self) -> str:
        return f"a device in z of order {self.one_step()[0].nrows()}, steps of {self.step:g} s"

    def one_step(self) -> "tuple[fmpq_mat, fmpq_mat, list[tuple[fmpq_mat, fmpq]]]":
        """F and G, and of each output its row c and its d."""
        sides: Any = _exact(self.system)
        if len(sides) == 4:
            a, b, c, d = sides
            outputs = [(flint.fmpq_mat([row]), own) for row, (own,) in zip(c, d, strict=True)]
            return flint.fmpq_mat(a), flint.fmpq_mat(b), outputs
        above, below = (flint.fmpq_poly(side[::-1]) / sides[1][0] for side in sides)
        direct, rest = divmod(above, below)
        order = below.degree()
        move = [[int(k == row + 1) for k in range(order)] for row in range(order - 1)]
        move.append([-below[k] for k in range(order)])
        push = [[int(row == order - 1)] for row in range(order)]
        outputs = [(flint.fmpq_mat([[rest[k] for k in range(order)]]), direct[0])]
        return flint.fmpq_mat(move), flint.fmpq_mat(push), outputs


def _exact(numbers: Any) -> Any:
    return [_exact(x) for x in numbers] if isinstance(numbers, tuple) else exact(numbers)


def checked_discrete(system: tuple[Any, ...], step: float) -> Discrete:
    """A device by numerator and denominator, or by A, B, C and D, and its step in s."""
    step = checked_number("step", step, 0.0, is_open=True, unit="s")
    names = {2: ("numerator", "denominator"), 3: "ABC", 4: "ABCD"}.get(len(system), ())
    given = [np.atleast_1d(checked(*each)) for each in zip(names, system, strict=False)]
    order = 0
    if len(given) == 2:
        given = [np.trim_zeros(side.ravel(), "f") for side in given]
        order = len(given[1]) - 1 if len(given[0]) <= len(given[1]) else 0
    elif len(given) > 2:
        a, b, c, *d = given
        b, c = b.reshape(len(b), -1), np.atleast_2d(c)
        direct = d[0].reshape(-1, 1) if d and np.any(d[0]) else np.zeros((len(c), 1))
        given, n = [a, b, c, direct], len(a)
        shapes = [[(n, n), (n, 1), (rows, n), (rows, 1)] for rows in (1, 2)]
        order = n if [side.shape for side in given] in shapes else 0
    if not 1 <= order <= HIGHEST_ORDER:
        raise ValueError(
            f"parts of shapes {', '.join(str(np.shape(side)) for side in system)} are no device in "
            "z; give numerator and denominator, of no lower degree, or A, B, C and D of (n, n), "
            f"(n, 1), (1, n) and (1, 1), n from 1 to {HIGHEST_ORDER}, or two rows for velocity."
        )
    device = Discrete(step, _frozen([side.tolist() for side in given]))
    sampled_steps(device, 1, 0)  # which refuses what does not move
    return device


def _frozen(numbers: Any) -> Any:
    return tuple(map(_frozen, numbers)) if isinstance(numbers, list) else numbers


# ------------------------------------------------------------------------- steps of physics engines
@dataclass(frozen=True)
class Simulated(InSteps):
    """A joint of a physics engine: its inertia on a damper and a spring, by a rule."""

    maker = "simulated"

    inertia: float
    damping: float
    stiffness: float
    integrator: str

    def __str__(self) -> str:
        return f"a simulated inertia of {self.inertia:g}, steps of {self.step:g} s"

    def one_step(self) -> "tuple[fmpq_mat, fmpq_mat, list[tuple[fmpq_mat, fmpq]]]":
        """F and G, and position and velocity themselves."""
        given = self.inertia, self.damping, self.stiffness, self.step
        inertia, damping, stiffness, step = map(exact, given)
        rate = flint.fmpq_mat([[0, 1], [-stiffness / inertia, -damping / inertia]])
        torque = flint.fmpq_mat([[0], [1 / inertia]])
        response = rate**0  # mean of exp(rate t) over a step: of a series, or of the rule
        if self.integrator == "rk4":
            response += rate * (step / 2) + rate**2 * (step**2 / 6) + rate**3 * (step**3 / 24)
        elif self.integrator != "explicit":
            # The position moves with the new velocity, and joint damping may be implicit.
            kept = 1 if self.integrator == "semi-implicit" else inertia / (inertia + step * damping)
            response = flint.fmpq_mat([[1, step * kept], [0, kept]])
        outputs = [(flint.fmpq_mat([row]), flint.fmpq(0)) for row in ([1, 0], [0, 1])]
        return rate**0 + response * rate * step, response * torque * step, outputs
