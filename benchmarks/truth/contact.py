"""Contacts with friction, by ``scipy.integrate.solve_ivp`` with events, one run at a time.

Nothing is shared with jaxstab: forces wait in a list with their times of arrival, filters are
scipy's difference equations, and between two arrivals the equation of motion is integrated up to
where the velocity changes its sign.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import numpy as np
import scipy.integrate
import scipy.signal

from benchmarks.truth.march import Taps

CLOSE = 1e-9  # a decision that is closer may fall otherwise in another arithmetic


@dataclass(frozen=True)
class Felt:
    """A mass in SI units, its wall and what disturbs it; delays in s, taken in turn."""

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


@dataclass
class Run:
    """Position, velocity and force at samples; what the wall gave, and what was lost, in J.

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
    chains = [_Chain(taps, _read(felt, x)) for taps in (felt.velocity, felt.position)]
    size = max(abs(x), abs(v) * felt.period, abs(felt.push) * felt.period**2 / felt.mass)
    arrivals: list[tuple[float, float]] = []
    answer, path = Run(np.empty(0), x, 0.0, 0.0, samples, 0), []
    for sample in range(samples):
        now = float(sample)
        read, is_clear = _read(felt, x), True
        if felt.encoder:
            is_clear = abs((x / felt.encoder + felt.phase) % 1.0 - 0.5) > CLOSE
        speed, filtered = (chain(read) for chain in chains)
        force = -(felt.wall[0] * filtered + felt.wall[1] * speed / felt.period)
        if felt.one_sided:
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
            x, v, is_sure = _move(felt, acting, (x, v), (end - begin) * felt.period, answer)
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
    felt: Felt, acting: float, state: tuple[float, float], length: float, answer: Run
) -> tuple[float, float, bool]:
    """Move while a force is held, from stop to stop."""
    (x, v), time, is_clear = state, 0.0, True
    for _ in range(3):
        others = acting + felt.push - felt.stiffness * x
        if v == 0.0:
            is_clear &= abs(abs(others) - felt.static_friction) > CLOSE * abs(others)
            if abs(others) <= felt.static_friction:
                break
        sign = np.sign(v) if v else np.sign(others)

        def rates(_: float, y: np.ndarray, sign: float = sign) -> list[float]:
            force = acting + felt.push - felt.stiffness * y[0] - felt.damping * y[1]
            rub = sign * felt.friction
            return [y[1], (force - rub) / felt.mass, (felt.damping * y[1] + rub) * y[1]]

        def stop(_: float, y: np.ndarray) -> float:
            return y[1]

        stop.terminal, stop.direction = True, -sign  # type: ignore[attr-defined]
        scale = max(abs(v), abs(others) * felt.period / felt.mass)
        solved = scipy.integrate.solve_ivp(
            rates, (time, length), [x, v, 0.0], method="DOP853", events=stop, rtol=1e-13,
            atol=[1e-15 * scale * felt.period, 1e-15 * scale, 1e-13 * felt.mass * scale**2],
            max_step=0.25 * felt.period,
        )  # fmt: skip
        answer.given += acting * (solved.y[0, -1] - x)
        answer.lost += solved.y[2, -1]
        x, v, time = solved.y[0, -1], solved.y[1, -1], solved.t[-1]
        answer.highest = max(answer.highest, x)
        if solved.status != 1:
            break
        v, answer.events = 0.0, answer.events + 1
    return float(x), float(v), is_clear


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
