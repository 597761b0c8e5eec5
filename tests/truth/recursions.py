"""Loops of any two gains step by step: what their software and their engines compute, in floats.

Each function returns the matrix by which one control step moves all that is remembered: it is made
by stepping unit vectors, and knows nothing of polynomials. A loop is stable where all eigenvalues
are inside the circle. Plants between samples move by a matrix exponential of scipy.

Numbers may be fractions or of mpmath as well, ``one`` of them: the matrix then is of such numbers.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

Vector = NDArray[np.float64]


def matrix_of(step: Callable[[Vector], Vector], size: int, one: Any = 1.0) -> NDArray[np.float64]:
    """The matrix of a linear step."""
    units = np.eye(size) if isinstance(one, float) else np.eye(size, dtype=int).astype(object) * one
    return np.transpose([step(unit) for unit in units])


def radius(matrix: NDArray[np.float64]) -> float:
    """The largest modulus of its eigenvalues."""
    return float(np.abs(np.linalg.eigvals(matrix)).max())


def engine_step(
    q: float,
    v: float,
    torque: float,
    *,
    inertia: float,
    damping: float,
    stiffness: float,
    step: float,
    integrator: str,
    kp: float = 0.0,
    kd: float = 0.0,
) -> tuple[float, float]:
    """One step of a physics engine; kp and kd act inside of it."""
    c, k, h = damping, stiffness, step
    push = torque - k * q - kp * q
    if integrator == "explicit":
        return q + h * v, v + h / inertia * (push - (c + kd) * v)
    if integrator == "semi-implicit":
        v += h / inertia * (push - (c + kd) * v)
    elif integrator == "implicit-joint":
        v = (inertia * v + h * (push - kd * v)) / (inertia + h * c)
    elif integrator == "implicit-damping":
        v = (inertia * v + h * push) / (inertia + h * (c + kd))
    elif integrator == "implicit":  # kp acts on the new position
        v = (inertia * v + h * push) / (inertia + h * (c + kd) + h * h * kp)
    else:

        def rate(x: Vector) -> Vector:
            return np.array([x[1], (torque - c * x[1] - k * x[0]) / inertia])

        x = np.array([q, v])
        one = rate(x)
        two = rate(x + h / 2 * one)
        three = rate(x + h / 2 * two)
        four = rate(x + h * three)
        q, v = x + h / 6 * (one + 2 * two + 2 * three + four)
        return q, v
    return q + h * v, v


def simulated(
    kp: float,
    kd: float,
    *,
    inside: bool,
    substeps: int = 1,
    delay_steps: int = 0,
    one: Any = 1.0,
    **engine: Any,
) -> NDArray[np.float64]:
    """PD control of a simulated joint."""
    if inside:
        return matrix_of(
            lambda x: np.array(engine_step(*x, 0 * one, kp=kp, kd=kd, **engine)), 2, one
        )
    waiting = delay_steps // substeps + 1

    def control(x: Vector) -> Vector:
        (q, v), past = x[:2], [-(kp * x[0] + kd * x[1]), *x[2:]]  # the newest first
        for step in range(substeps):
            older = step < delay_steps % substeps
            q, v = engine_step(q, v, past[waiting - 1 + older], kp=0 * one, kd=0 * one, **engine)
        return np.array([q, v, *past[:waiting]])

    return matrix_of(control, 2 + waiting, one)


def admittance(
    mass: float,
    damping: float,
    *,
    environment: float,
    sample_time: float,
    delay_samples: int,
    rule: str,
    stiffness: float = 0.0,
    one: Any = 1.0,
) -> NDArray[np.float64]:
    """A virtual mass and damper whose positions a robot takes some samples later."""
    t, w = sample_time, delay_samples

    def control(x: Vector) -> Vector:
        v, past = x[0], list(x[1:])  # the newest position first
        here = past[0]
        force = -environment * past[w] - stiffness * here
        if rule == "forward":
            v += t / mass * (force - damping * v)
            new = here + t * v
        elif rule == "backward":
            v = (mass * v + t * force) / (mass + t * damping)
            new = here + t * v
        elif rule == "explicit":
            new = here + t * v
            v += t / mass * (force - damping * v)
        else:  # trapezoid: the new force is that of a position that is known, w >= 1
            later = -environment * past[w - 1]
            moved, at = mass + t / 2 * damping, here + t / 2 * v
            known = mass * v + t / 2 * (force + later - damping * v)
            v = (known - t / 2 * stiffness * at) / (moved + t * t / 4 * stiffness)
            new = at + t / 2 * v
        return np.array([v, new, *past[:-1]])

    return matrix_of(control, 2 + w + 1, one)


class HeldMass:
    """A mass on a damper and a spring, behind a hold and a delay in samples."""

    def __init__(
        self,
        mass: float,
        damping: float,
        stiffness: float,
        period: float,
        delay: float,
        exponential: Callable[[Any], Any] = expm,
    ) -> None:
        rates = np.array([[0, 1, 0], [-stiffness / mass, -damping / mass, 1 / mass], [0, 0, 0]])
        whole, late = int(delay // 1), delay % 1
        self.older, self.newer = (exponential(rates * period * x) for x in (late, 1 - late))
        self.waiting = whole + 1

    def moved(self, x: Vector, forces: list[float]) -> Vector:
        """The state a sample later; forces: the newest first."""
        state = (self.older @ [*x, forces[self.waiting]])[:2]
        return np.asarray((self.newer @ [*state, forces[self.waiting - 1]])[:2])


class Wall:
    """What nothing moves."""

    waiting = 0

    def moved(self, x: Vector, forces: list[float]) -> Vector:
        """Its state, which is 0."""
        return 0 * np.array([x[0], forces[0]])


def pid(
    kp: float,
    ki: float,
    kd: float,
    plant: HeldMass,
    *,
    period: float,
    rule: str,
    window: int,
    one: Any = 1.0,
) -> NDArray[np.float64]:
    """PID control of a held mass, its velocity the difference over a window."""
    waiting = plant.waiting

    def control(x: Vector) -> Vector:
        state, total, earlier = x[:2], x[2], list(x[3 : 3 + window])
        forces = list(x[3 + window :])
        here, before = state[0], earlier[0]
        new = total + period * {"backward": here, "forward": before}.get(rule, (here + before) / 2)
        speed = (here - earlier[-1]) / (window * period)
        forces = [-(kp * here + ki * new + kd * speed), *forces]
        moved = plant.moved(state, forces)
        return np.array([*moved, new, here, *earlier[:-1], *forces[:waiting]])

    return matrix_of(control, 3 + window + waiting, one)


def coupling(
    stiffness: float,
    damping: float,
    first: HeldMass,
    second: HeldMass | Wall,
    *,
    period: float,
    window: int = 1,
    drift: int = 0,
    one: Any = 1.0,
) -> NDArray[np.float64]:
    """A spring and a damper between two held masses, or to a wall; difference over a window.

    The first ``drift`` roots of both, of a motion that they share, are left out: where no spring
    holds either of them, the state has their distance in place of both positions; where nothing
    does, or with a wall, their relative velocity in place of both.
    """
    waiting = max(first.waiting, second.waiting)

    def control(x: Vector) -> Vector:
        own, earlier = x[: 4 - drift], list(x[4 - drift : 4 - drift + window])
        forces = list(x[4 - drift + window :])
        zero = 0 * own[0]
        bodies = {0: own, 1: [*own[:2], zero, own[-1]], 2: [*own, zero, zero]}[drift]
        one, other = bodies[:2], bodies[2:]
        apart = one[0] - other[0]
        force = -(stiffness * apart + damping * (apart - earlier[-1]) / (window * period))
        forces = [force, *forces]
        (p, v), (q, w) = first.moved(one, forces), second.moved(other, [-each for each in forces])
        moved = {0: [p, v, q, w], 1: [p - q, v, w], 2: [p - q, v - w]}[drift]
        return np.array([*moved, apart, *earlier[:-1], *forces[:waiting]])

    return matrix_of(control, 4 - drift + window + waiting, one)


def in_steps(
    stiffness: float,
    damping: float,
    plant: tuple[Vector, Vector, Vector, Vector],
    *,
    period: float,
    count: int,
    late: int,
    window: int | None,
    smoothing: float,
) -> NDArray[np.float64]:
    """A wall on a plant A, B, C, D in steps of its own, ``count`` a sample, ``late`` of them late.

    The velocity is the smoothed difference over a window, or the second output; no window.
    """
    a, b, c, d = plant
    order, (whole, older) = len(a), divmod(late, count)

    def control(x: Vector) -> Vector:
        state, smooth = x[:order], x[order]
        earlier, past = (
            list(x[order + 1 : order + 1 + (window or 0)]),
            x[order + 1 + (window or 0) :],
        )
        acting = past[whole - (not older)] if late else 0.0
        seen = c @ state + d[:, 0] * acting
        speed = seen[1] if window is None else (seen[0] - earlier[-1]) / (window * period)
        smooth += smoothing * (speed - smooth)
        forces = [-(stiffness * seen[0] + damping * smooth), *past]
        for step in range(count):
            state = a @ state + b[:, 0] * forces[whole + (step < older)]
        return np.array([*state, smooth, *[seen[0], *earlier][: window or 0], *forces[: whole + 1]])

    return matrix_of(control, order + 1 + (window or 0) + whole + 1)
