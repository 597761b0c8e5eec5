"""Contacts with friction, by ``scipy.integrate.solve_ivp`` with events, one run at a time.

Nothing is shared with jaxstab: forces wait in a list with their times of arrival, filters are
scipy's difference equations, and between two arrivals the equations of motion, in coordinates of
masses and modes, are integrated up to where the handle's velocity changes its sign, or where a
handle that sticks breaks loose.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import numpy as np
import scipy.integrate
import scipy.signal

from tests.truth.march import Taps

CLOSE = 1e-9  # a decision that is closer may fall otherwise in another arithmetic


@dataclass(frozen=True)
class Structure:
    """A device by z' = A z + w f + h p, f the wall's force, p a force at its handle.

    position, velocity: rows of the handle's; pull: what pulls beside the hand, of z and of f.
    arriving: all masses move at velocity 1, springs at rest.
    """

    matrix: np.ndarray
    wall: np.ndarray
    hand: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    pull: np.ndarray
    arriving: np.ndarray

    def start(self, x: float, v: float) -> np.ndarray:
        """At rest at x without a force of the wall, and moving as a whole."""
        held = np.block([[self.matrix, self.hand[:, None]], [self.position, np.zeros(1)]])
        rest = np.linalg.lstsq(held, np.eye(len(held))[-1] * x)[0][:-1]
        return rest + self.arriving * v

    @property
    def thrown(self) -> np.ndarray:
        """What a blow that gives the velocity 1 does."""
        return self.hand / (self.velocity @ self.hand)


def structure(
    bodies: Sequence[tuple[float, float, float]],
    arm: tuple[float, float, float, float, float] | None = None,
    bandwidth: float | None = None,
) -> Structure:
    """Masses, dampings and stiffnesses whose displacements add up, the first one the rigid body.

    arm: its mass, damping and stiffness to the ground, damping and stiffness of the grip before it.
    """
    count = len(bodies)
    size = 2 * count + (2 if arm else 0) + (1 if bandwidth else 0)
    position, velocity = np.zeros(size), np.zeros(size)
    position[: 2 * count : 2] = velocity[1 : 2 * count : 2] = 1.0
    matrix, hand, arriving = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    arriving[1] = 1.0
    for k, (mass, damping, stiffness) in enumerate(bodies):
        hand[2 * k + 1] = 1.0 / mass
        matrix[2 * k, 2 * k + 1] = 1.0
        matrix[2 * k + 1, 2 * k : 2 * k + 2] = -stiffness / mass, -damping / mass
    if arm:
        mass, damping, stiffness, grip_damping, grip_stiffness = arm
        x, v = 2 * count, 2 * count + 1
        grip = grip_stiffness * position + grip_damping * velocity  # on the arm
        grip[[x, v]] -= grip_stiffness, grip_damping
        matrix -= np.outer(hand, grip)
        matrix[x, v] = arriving[v] = 1.0
        matrix[v] += grip / mass
        matrix[v, [x, v]] -= stiffness / mass, damping / mass
    pull, wall = np.eye(size + 1)[-1], hand
    if bandwidth:
        rate, pull = 2.0 * np.pi * bandwidth, np.eye(size + 1)[-2]
        matrix[:, -1], wall = hand, rate * np.eye(size)[-1]
        matrix[-1, -1] = -rate
    return Structure(matrix, wall, hand, position, velocity, pull, arriving)


@dataclass(frozen=True)
class Felt:
    """A mass in SI units, its wall and what disturbs it; delays in s, taken in turn.

    The mass of a structure is that at its handle; its damping and stiffness are not used.
    """

    mass: float
    damping: float
    stiffness: float
    period: float
    delays: Sequence[float]
    velocity: Sequence[Taps]
    position: Sequence[Taps]
    wall: tuple[float, float]
    friction: float = 0.0
    static_friction: float = 0.0
    encoder: float = 0.0
    phase: float = 0.0
    force_step: float = 0.0
    max_force: float = inf
    push: float = 0.0
    one_sided: bool = True
    pulls: bool = False
    gate: str = "position"
    device: Structure | None = None


@dataclass
class Run:
    """Position, velocity and force at samples; what the wall gave, and what one mass lost, in J.

    certain: of how many samples every decision before was clear.
    events: how often the mass stopped.
    """

    path: np.ndarray
    highest: float
    given: float
    lost: float
    certain: int
    events: int


def run(felt: Felt, start: tuple[float, float], samples: int) -> Run:
    """Return the motion from a position and a velocity."""
    x, v = start
    device = felt.device or structure([(felt.mass, felt.damping, felt.stiffness)])
    state, is_still = device.start(x, v), v == 0.0
    chains = [_Chain(taps, _read(felt, x)) for taps in (felt.velocity, felt.position)]
    size = max(abs(x), abs(v) * felt.period, abs(felt.push) * felt.period**2 / felt.mass)
    arrivals: list[tuple[float, float]] = []
    answer, path = Run(np.empty(0), x, 0.0, 0.0, samples, 0), []
    for sample in range(samples):
        now, x, v = float(sample), float(device.position @ state), float(device.velocity @ state)
        read, is_clear = _read(felt, x), True
        if felt.encoder:
            is_clear = abs((x / felt.encoder + felt.phase) % 1.0 - 0.5) > CLOSE
        speed, filtered = (chain(read) for chain in chains)
        force = -(felt.wall[0] * filtered + felt.wall[1] * speed / felt.period)
        if felt.gate == "force":
            force = min(force, 0.0)
        elif felt.one_sided:
            is_clear &= abs(read) > CLOSE * size
            force = 0.0 if read <= 0.0 else force if felt.pulls else min(force, 0.0)
        if felt.force_step:
            is_clear &= abs(force / felt.force_step % 1.0 - 0.5) > CLOSE
            force = felt.force_step * np.rint(force / felt.force_step)
        force = float(np.clip(force, -felt.max_force, felt.max_force))
        path.append((x, v, force))
        arrivals.append((now + felt.delays[sample % len(felt.delays)] / felt.period, force))
        inner = sorted(time for time, _ in arrivals if now < time < now + 1.0)
        for begin, end in zip([now, *inner], [*inner, now + 1.0], strict=True):
            arrived = [one for time, one in arrivals if time <= begin]
            acting = arrived[-1] if arrived else 0.0
            span = (end - begin) * felt.period
            state, is_still, is_sure = _move(felt, device, acting, state, is_still, span, answer)
            is_clear &= is_sure
        if not (is_clear or sample == 0):
            answer.certain = min(answer.certain, sample)
    answer.path = np.array(path).T
    return answer


def _read(felt: Felt, x: float) -> float:
    if not felt.encoder:
        return x
    return felt.encoder * float(np.rint(x / felt.encoder + felt.phase) - felt.phase)


def _move(
    felt: Felt,
    device: Structure,
    acting: float,
    state: np.ndarray,
    is_still: bool,
    length: float,
    answer: Run,
) -> tuple[np.ndarray, bool, bool]:
    """Move while a force is held, from event to event; whether the handle is still afterwards."""
    size, time, is_clear, loose = len(state), 0.0, True, 0.0
    inertia = 1.0 / (device.velocity @ device.hand)

    def beside_friction(z: np.ndarray) -> float:
        rates = device.matrix @ z + device.wall * acting
        return float(inertia * (device.velocity @ rates)) + felt.push

    while time < length:
        v, others = 0.0 if is_still else float(device.velocity @ state), beside_friction(state)
        if is_still and not loose:
            is_clear &= abs(abs(others) - felt.static_friction) > CLOSE * abs(others)
            sign = np.sign(others) if abs(others) > felt.static_friction else 0.0
        else:
            sign = loose or np.sign(v)

        def rates(_: float, y: np.ndarray, sign: float = sign) -> np.ndarray:
            z = y[:size]
            speed = device.velocity @ z
            friction = -sign * felt.friction if sign else -beside_friction(z)
            motion = device.matrix @ z + device.wall * acting
            motion = motion + device.hand * (felt.push + friction)
            given = device.pull @ np.append(z, acting) * speed
            return np.array([*motion, given, (felt.damping * speed - friction) * speed])

        def stop(_: float, y: np.ndarray, sign: float = sign) -> float:
            if sign:
                return float(device.velocity @ y[:size])
            return felt.static_friction - abs(beside_friction(y[:size]))

        stop.terminal, stop.direction = True, -sign or -1.0  # type: ignore[attr-defined]
        speed = max(abs(v), abs(others) * felt.period / felt.mass)
        scale = max(speed, 1e-3 * float(np.abs(state).max()))
        small = [1e-15 * scale * felt.period] * size + [1e-13 * felt.mass * speed**2 + 1e-30] * 2
        solved = scipy.integrate.solve_ivp(
            rates, (time, length), [*state, 0.0, 0.0], method="DOP853", events=stop, rtol=1e-13,
            atol=small, max_step=0.25 * felt.period,
            # A handle at rest may soon turn round, and events are seen at the ends of steps alone.
            first_step=1e-4 * (length - time) if is_still else None,
        )  # fmt: skip
        state, time = solved.y[:size, -1], solved.t[-1]
        answer.given += solved.y[-2, -1]
        answer.lost += solved.y[-1, -1]
        answer.highest = max(answer.highest, float(device.position @ state))
        loose, is_still = 0.0, sign == 0.0
        if solved.status == 1:
            answer.events += 1
            loose = 0.0 if sign else np.sign(beside_friction(state))
            is_still = True
            state = state - device.thrown * (device.velocity @ state)
    return state, is_still, is_clear


class _Chain:
    """Difference equations one after the other, after a long rest at a position."""

    def __init__(self, chain: Sequence[Taps], at: float) -> None:
        self.chain, self.memories = chain, []
        for above, below in chain:
            self.memories.append(scipy.signal.lfilter_zi(above, below) * at)
            at *= sum(above) / sum(below)

    def __call__(self, value: float) -> float:
        for number, (above, below) in enumerate(self.chain):
            (value,), self.memories[number] = scipy.signal.lfilter(
                above, below, [value], zi=self.memories[number]
            )
        return float(value)
