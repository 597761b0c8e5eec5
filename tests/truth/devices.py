"""General devices, put together from masses, springs and motors as equations of motion in mpmath.

Nothing here knows transfer functions: the states are displacements and velocities of the modes and
of the arm, and the actuator's force; the exponential is mpmath's, N(z) and D(z) come from the
recursion of Faddeev and Leverrier, and the loop's roots are certified by python-flint.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import flint
import numpy as np
from mpmath import mp, mpf

from tests.truth import loop as truth
from tests.truth.balls import BallLoop, InBalls, Rational

DIGITS = 120
WORKING = 260  # digits; the rest is for what stiff devices lose


class System(NamedTuple):
    """x' = A x + B u, position C x."""

    a: mp.matrix
    b: mp.matrix
    c: mp.matrix


@dataclass(frozen=True)
class Mechanism:
    """Modes (mass, damping, stiffness), all at one handle; hands; actuators by their bandwidths.

    A hand is (mass, damping, stiffness, grip), where the grip is (damping, stiffness) or None.
    """

    modes: Sequence[tuple[mpf, mpf, mpf]]
    hands: Sequence[tuple[float, float, float, tuple[float, float] | None]] = ()
    actuators: Sequence[float] = ()

    @mp.workdps(WORKING)
    def system(self) -> System:
        """The equations of motion, states first of modes, then of arms, then of actuators."""
        arms = [hand for hand in self.hands if hand[3] is not None]
        count = 2 * (len(self.modes) + len(arms)) + len(self.actuators)
        force = 2 * (len(self.modes) + len(arms))  # the first actuator's, the last in the chain
        places, rates = range(0, 2 * len(self.modes), 2), range(1, 2 * len(self.modes), 2)
        zero = [mpf(0)] * (count + 1)  # the last column is the force u
        position, velocity = zero[:], zero[:]
        for place, rate in zip(places, rates, strict=True):
            position[place] = velocity[rate] = mpf(1)
        pull = zero[:]  # on the handle, but for what accelerates glued masses
        pull[force if self.actuators else count] = mpf(1)
        glued = mpf(0)
        rows = [zero[:] for _ in range(count)]
        arm = 2 * len(self.modes)
        for mass, damping, stiffness, grip in self.hands:
            if grip is None:
                glued += mpf(mass)
                pull = added(pull, position, -mpf(stiffness))
                pull = added(pull, velocity, -mpf(damping))
                continue
            bond = zero[:]  # from the arm on the handle
            bond = added(bond, position, -mpf(grip[1]))
            bond = added(bond, velocity, -mpf(grip[0]))
            bond[arm] += mpf(grip[1])
            bond[arm + 1] += mpf(grip[0])
            pull = added(pull, bond, mpf(1))
            rows[arm][arm + 1] = mpf(1)
            rows[arm + 1] = added(rows[arm + 1], bond, -1 / mpf(mass))
            rows[arm + 1][arm] -= mpf(stiffness) / mpf(mass)
            rows[arm + 1][arm + 1] -= mpf(damping) / mpf(mass)
            arm += 2
        own = [zero[:] for _ in self.modes]  # accelerations without the pull
        for row, place, (mass, damping, stiffness) in zip(own, places, self.modes, strict=True):
            row[place], row[place + 1] = -stiffness / mass, -damping / mass
        mobility = sum((1 / mass for mass, _, _ in self.modes), mpf(0))
        # The handle's acceleration is sum(own) + mobility total, total = pull - glued acceleration.
        total = pull
        for row in own:
            total = added(total, row, -glued)
        total = [value / (1 + glued * mobility) for value in total]
        for row, place, (mass, _, _) in zip(own, places, self.modes, strict=True):
            rows[place][place + 1] = mpf(1)
            rows[place + 1] = added(row, total, 1 / mass)
        for k, bandwidth in enumerate(self.actuators):
            turn = 2 * mp.pi * mpf(bandwidth)
            rows[force + k][force + k] = -turn
            rows[force + k][force + k + 1 if k + 1 < len(self.actuators) else count] = turn
        return System(
            mp.matrix([row[:-1] for row in rows]),
            mp.matrix([[row[-1]] for row in rows]),
            mp.matrix([position[:-1]]),
        )


def added(row: list[mpf], other: list[mpf], factor: mpf) -> list[mpf]:
    """row + factor other."""
    return [one + factor * two for one, two in zip(row, other, strict=True)]


def mode(frequency: float, damping_ratio: float, modal_mass: float) -> tuple[mpf, mpf, mpf]:
    """Mass, damping and stiffness of a mode."""
    with mp.workdps(WORKING):
        w = 2 * mp.pi * mpf(frequency)
        return mpf(modal_mass), 2 * mpf(damping_ratio) * w * mpf(modal_mass), w**2 * modal_mass


class Sampled(NamedTuple):
    """N(z), in m/N, and D(z), highest power first, and whole samples of lag."""

    numerator: list[mpf]
    denominator: list[mpf]
    lag: int


def sampled(system: System, sample_time: float, delay: float) -> Sampled:
    """The system behind a zero-order hold and a delay in samples."""
    whole, fraction = truth.split_delay(delay)
    with mp.workdps(WORKING):
        last, late = held(system, mpf(sample_time) * (1 - mpf(fraction)))
        if fraction == 0:
            numerator, denominator = resolvent(last, late, system.c)
            return Sampled(numerator, denominator, whole)
        first, early = held(system, mpf(sample_time) * mpf(fraction))
        one, denominator = resolvent(last * first, late, system.c)
        other, _ = resolvent(last * first, last * early, system.c)
        above = [a + b for a, b in zip([*one, mpf(0)], [mpf(0), *other], strict=True)]
        return Sampled(above, denominator, whole + 1)


def held(system: System, time: mpf) -> tuple[mp.matrix, mp.matrix]:
    """How the state moves in a time, and what a held force adds to it."""
    order = system.a.rows
    block = mp.zeros(order + 1)
    for i in range(order):
        for j in range(order):
            block[i, j] = system.a[i, j] * time
        block[i, order] = system.b[i, 0] * time
    moved = mp.expm(block, method="taylor")
    return moved[:order, :order], moved[:order, order]


def resolvent(
    transition: mp.matrix, column: mp.matrix, row: mp.matrix
) -> tuple[list[mpf], list[mpf]]:
    """C adj(z - F) G and det(z - F), by the recursion of Faddeev and Leverrier."""
    order = transition.rows
    adjugate, numerator, denominator = mp.eye(order), [], [mpf(1)]
    for k in range(1, order + 1):
        numerator.append((row * adjugate * column)[0, 0])
        product = transition * adjugate
        coefficient = -sum((product[i, i] for i in range(order)), mpf(0)) / k
        denominator.append(coefficient)
        adjugate = product + coefficient * mp.eye(order)
    return numerator, denominator


@dataclass(frozen=True)
class DeviceLoop(InBalls):
    """A system, a delay in samples, an estimator of T times the velocity, and a position filter."""

    system: System
    sample_time: float
    delay: float
    velocity: Rational
    position: Rational
    plant: Sampled = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "plant", sampled(self.system, self.sample_time, self.delay))

    def balls(self, bits: int = 400) -> BallLoop:
        """p(z) for all K in N/m and B in N s/m."""
        with flint.ctx.workprec(bits):
            above, below = (
                flint.arb_poly([ball(value) for value in falling[::-1]])
                for falling in self.plant[:2]
            )
        loop = BallLoop.of(above, below, self.plant.lag, self.velocity, self.position, bits)
        return loop.in_units(1.0, self.sample_time)


def ball(value: mpf) -> flint.arb:
    """A ball about a number of mpmath of which DIGITS are right."""
    return truth.as_arb(value) * flint.arb(1, flint.arb(10) ** -DIGITS)


# ------------------------------------------------------------------------------- random devices


class Drawn(NamedTuple):
    """What was drawn of a device: a rigid body, modes, a hand with or without a grip, a motor."""

    mass: float
    damping: float
    modes: list[tuple[float, float, float]]
    hand: tuple[float, float, float, tuple[float, float] | None] | None
    bandwidth: float | None
    sample_time: float
    delay: float

    @property
    def mechanism(self) -> Mechanism:
        """The same as equations of motion."""
        body = mpf(self.mass), mpf(self.damping), mpf(0)
        hands = [] if self.hand is None else [self.hand]
        actuators = [] if self.bandwidth is None else [self.bandwidth]
        return Mechanism([body, *(mode(*one) for one in self.modes)], hands, actuators)


def drawn(rng: np.random.Generator) -> Drawn:
    """A device as haptics knows them, and some that are stiffer, less damped or later."""

    def between(low: float, high: float) -> float:
        return float(10.0 ** rng.uniform(low, high))

    def or_none(number: float, share: float) -> float:
        return 0.0 if rng.random() < share else number

    modes = [
        (between(0.5, 3.0), or_none(between(-6.0, 0.0), 0.3), between(-1.5, 1.5))
        for _ in range(rng.integers(0, 3))
    ]
    hand = None
    if rng.random() < 0.7:
        grip = (between(-1.0, 2.0), between(1.0, 5.0 if rng.random() < 0.7 else 9.0))
        arm = between(-1.0, 1.0), between(-1.0, 1.5), or_none(between(0.0, 3.5), 0.3)
        hand = (*arm, grip if rng.random() < 0.6 else None)
    delays = [0.0, 1.0, 2.0, rng.uniform(0.0, 5.0), rng.uniform(5.0, 30.0), rng.integers(3, 31)]
    return Drawn(
        mass=between(-2.0, 1.0),
        damping=or_none(between(-2.0, 1.0), 0.3),
        modes=modes,
        hand=hand,
        bandwidth=between(1.0, 3.0 if rng.random() < 0.7 else 5.0) if rng.random() < 0.5 else None,
        sample_time=float(rng.choice([1e-3, 2.5e-4, 1e-2, 2.0**-10])),
        delay=float(rng.choice(delays)),
    )
