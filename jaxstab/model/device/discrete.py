"""Devices in z, which are known at steps of their own, and joints as physics engines step them.

A step is x+ = F x + G u, (position, velocity) = C x + D u, in exact numbers; the velocity is a
second output, where there is one. A controller that acts every n steps, and whose force is late by
d = w n + f of them, meets with Gamma_j = G + F G + ... + F^(j-1) G

    z^-lag N/D,     D = det(z - F^n),     N = C adj(z - F^n) (Gamma_(n-f) z + F^(n-f) Gamma_f)

(without the f: C adj(z - F^n) Gamma_n, one sample less late), and c adj(z - M) v is
det(z - M + v c) - det(z - M). Such a device has no motion between its steps: hands, actuators and
whatever else needs a function of s are refused by ``compliance``, which they all ask for.
"""

from dataclasses import dataclass
from functools import lru_cache, reduce
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxstab.model.device.parts import HIGHEST_ORDER, Part, Rational, exact, polynomial
from jaxstab.numbers import checked, checked_number

if TYPE_CHECKING:
    from flint import fmpq, fmpq_mat, fmpq_poly

INTEGRATORS = ("explicit", "semi-implicit", "implicit-joint", "implicit-damping", "implicit", "rk4")


class Step(NamedTuple):
    """F, G, and for each output its row c and its d."""

    move: "fmpq_mat"
    push: "fmpq_mat"
    outputs: "list[tuple[fmpq_mat, fmpq]]"


class Sampled(NamedTuple):
    """D(z), N(z) of each output, and the lag."""

    denominator: "fmpq_poly"
    numerators: "list[fmpq_poly]"
    lag: int


@dataclass(frozen=True)
class InSteps(Part):
    """A device that is known at its steps alone."""

    step: float

    def one_step(self) -> Step:
        """What a step does to the states, and which of them are seen."""
        raise NotImplementedError

    @property
    def has_velocity(self) -> bool:
        """Whether the velocity is a second output."""
        return len(self.one_step().outputs) == 2

    def compliance(self) -> Rational:
        """There is none in s: ValueError."""
        raise ValueError(
            f"the device ({self}) is known at its steps alone: its poles in s, motion between "
            "samples, delays that move, hands and actuators are not; give a device in s "
            "(Device.state_space, for instance), or one in z that has hand and actuator in it."
        )

    def steps(self, sample_time: float, delay_samples: float) -> tuple[int, int]:
        """How many steps a sample has, and how many the force is late; both are whole.

        Raises: ValueError if they are not, or the loop is algebraic.
        """
        most = 1000
        whole, given = round(sample_time / self.step), sample_time / self.step
        if not 1 <= whole <= most or abs(given - whole) > 1e-9 * whole:
            raise ValueError(
                f"sample_time is {sample_time:g} s, {given:g} steps of {self.step:g} s of the "
                f"device in z; give 1 to {most} whole steps."
            )
        late = round(delay_samples * whole)
        if abs(delay_samples * whole - late) > 1e-9 * max(late, 1):
            raise ValueError(
                f"the delay is {delay_samples * whole:g} steps of {self.step:g} s of the device in "
                "z; give a whole number of them."
            )
        if not late and any(direct for _, direct in self.one_step().outputs):
            raise ValueError(
                f"the device ({self}) moves in the same step as the force, and without a delay the "
                "force depends on it: the loop is algebraic; give a delay of a step or more."
            )
        return whole, late

    def at_rest(self) -> tuple[Any, Any]:
        """Position and constant force at rest, as ``Rational.at_rest``."""
        below, above, _ = sampled_steps(self, 1, 0)
        return polynomial([above[0](1)]), polynomial([below(1)])

    def sampled(self, sample_time: float, delay_samples: float) -> Sampled:
        """The device behind its hold and a delay."""
        return sampled_steps(self, *self.steps(sample_time, delay_samples))


@lru_cache(maxsize=128)
def sampled_steps(device: InSteps, count: int, delay: int) -> Sampled:
    """The same, for ``count`` steps a sample and a delay in steps.

    Raises: ValueError if no force moves an output at the samples, or what is not seen there grows.
    """
    from flint import fmpq_mat, fmpq_poly

    move, push, outputs = device.one_step()
    whole, late = divmod(delay, count)
    size = move.nrows()
    powers, pushes = [move**0], [fmpq_mat(size, 1)]
    for _ in range(count):
        pushes.append(pushes[-1] + powers[-1] * push)
        powers.append(move * powers[-1])
    newer, older = pushes[count - late], powers[count - late] * pushes[late]
    denominator = powers[count].charpoly()
    numerators = []
    for row, direct in outputs:
        early, rest = (
            (powers[count] - column * row).charpoly() - denominator for column in (newer, older)
        )
        moved = early * fmpq_poly([0, 1]) + rest if late else early
        numerators.append(moved + direct * denominator)
    if not all(numerators):
        raise ValueError(f"the device ({device}) does not move at samples; give a force that acts.")
    common = reduce(lambda p, q: p.gcd(q), numerators, denominator)
    roots: list[Any] = common.complex_roots()  # each with its multiplicity
    if not all(abs(root) < 1 for root, _ in roots):
        raise ValueError(
            f"the device ({device}) has a part that does not die out by itself and that no output "
            "shows at samples, a common factor in z: leave it out, or show it."
        )
    return Sampled(
        denominator // common, [side // common for side in numerators], whole + (late > 0)
    )


# ------------------------------------------------------------------------------------ given in z
@dataclass(frozen=True)
class Discrete(InSteps):
    """Numerators and a denominator, or A, B, C and D, of one or two outputs."""

    system: tuple[Any, ...]

    def call(self, kind: str) -> str:
        """Return the call that makes a device of it."""
        return f"{kind}.discrete({', '.join(map(repr, self.system))}, step={self.step!r})"

    def __str__(self) -> str:
        return f"a device in z of order {self.one_step().move.nrows()}, steps of {self.step:g} s"

    def one_step(self) -> Step:
        """What a step does to the states, and which of them are seen."""
        from flint import fmpq, fmpq_mat

        sides: Any = _exact(self.system)
        if len(sides) == 4:
            a, b, c, d = sides
            rows = [(fmpq_mat([row]), direct[0]) for row, direct in zip(c, d, strict=True)]
            return Step(fmpq_mat(a), fmpq_mat(b), rows)
        numerators, falling = sides
        order, leading = len(falling) - 1, falling[0]
        below = [c / leading for c in falling[:0:-1]]  # the lowest power first
        move = [[fmpq(int(k == row + 1)) for k in range(order)] for row in range(order - 1)]
        rows = []
        for side in numerators:
            above = [fmpq(0)] * (order + 1 - len(side)) + [c / leading for c in side]
            rising, direct = above[:0:-1], above[0]
            row = [c - direct * k for c, k in zip(rising, below, strict=True)]
            rows.append((fmpq_mat([row]), direct))
        push = [[fmpq(int(row == order - 1))] for row in range(order)]
        return Step(fmpq_mat([*move, [-c for c in below]]), fmpq_mat(push), rows)


def checked_discrete(system: tuple[Any, ...], step: float) -> Discrete:
    """A device by (numerator, denominator), (A, B, C) or (A, B, C, D), and its step in s."""
    step = checked_number("step", step, 0.0, is_open=True, unit="s")
    if len(system) not in (2, 3, 4):
        raise TypeError(
            f"the device in z is given by {len(system)} arguments; give numerator and denominator, "
            "or A, B, C and D."
        )
    check = _polynomials if len(system) == 2 else _matrices
    device = Discrete(step, check(*system))
    sampled_steps(device, 1, 0)  # which refuses what does not move
    return device


def _polynomials(numerator: Any, denominator: Any) -> tuple[Any, ...]:
    above = np.atleast_2d(checked("numerator", numerator))
    below = np.trim_zeros(np.ravel(checked("denominator", denominator)), "f")
    rows = [np.trim_zeros(row, "f") for row in above]
    most, order = max(map(len, rows)) - 1, len(below) - 1
    if len(rows) > 2 or not max(most, 1) <= order <= HIGHEST_ORDER:
        raise ValueError(
            f"the numerator has {len(rows)} rows of degree {most} in z and the denominator degree "
            f"{order}; give one row, of the position, or two, and a denominator of the same degree "
            f"or a higher one, 1 to {HIGHEST_ORDER}."
        )
    return tuple(tuple(row.tolist()) for row in rows), tuple(below.tolist())


def _matrices(a: Any, b: Any, c: Any, d: Any = 0.0) -> tuple[Any, ...]:
    a, b, c, d = (
        np.atleast_1d(checked(name, x)) for name, x in zip("ABCD", (a, b, c, d), strict=True)
    )
    b, c = b.reshape(len(b), -1), np.atleast_2d(c)
    order, outputs = b.shape[0], c.shape[0]
    d = d.reshape(-1, 1) if np.any(d) else np.zeros((outputs, 1))
    given, shapes = (
        (a.shape, b.shape, c.shape, d.shape),
        ((order, order), (order, 1), (outputs, order), (outputs, 1)),
    )
    if given != shapes or not order <= HIGHEST_ORDER or not outputs <= 2:
        raise ValueError(
            f"A, B, C and D have the shapes {given}; a device in z of n states, 1 to "
            f"{HIGHEST_ORDER}, and one force has (n, n), (n, 1), (1, n) and (1, 1), or (2, n) and "
            "(2, 1) with its velocity."
        )
    return tuple(tuple(map(tuple, x.tolist())) for x in (a, b, c, d))


def _exact(numbers: Any) -> Any:
    return [_exact(x) for x in numbers] if isinstance(numbers, tuple) else exact(numbers)


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
        return (
            f"a simulated inertia of {self.inertia:g} ({self.integrator}), steps of {self.step:g} s"
        )

    def numbers(self) -> "list[fmpq]":
        """Inertia, damping, stiffness and step."""
        return [exact(x) for x in (self.inertia, self.damping, self.stiffness, self.step)]

    def one_step(self) -> Step:
        """What a step does to position and velocity, which are both seen."""
        from flint import fmpq, fmpq_mat

        inertia, damping, stiffness, step = self.numbers()
        rate = fmpq_mat([[0, 1], [-stiffness / inertia, -damping / inertia]])
        one = fmpq_mat([[1, 0], [0, 1]])
        torque = fmpq_mat([[0], [1 / inertia]])
        outputs = [(fmpq_mat([[1, 0]]), fmpq(0)), (fmpq_mat([[0, 1]]), fmpq(0))]
        if self.integrator == "rk4":
            halves = [one, rate * (step / 2), rate**2 * (step**2 / 6), rate**3 * (step**3 / 24)]
            response = halves[0] + halves[1] + halves[2] + halves[3]
            return Step(one + rate * response * step, response * torque * step, outputs)
        if self.integrator == "explicit":
            return Step(one + rate * step, torque * step, outputs)
        is_joint_implicit = self.integrator != "semi-implicit"
        moved = inertia + step * damping if is_joint_implicit else inertia
        kept = inertia if is_joint_implicit else inertia - step * damping
        velocity = [-step * stiffness / moved, kept / moved]
        by_torque = step / moved
        move = fmpq_mat([[1 + step * velocity[0], step * velocity[1]], velocity])
        return Step(move, fmpq_mat([[step * by_torque], [by_torque]]), outputs)
