"""All joints of a robot at once, at one posture: the eigenvalues of one sampling period.

At a frozen posture M q'' + C q' + G q = -(Kp q + Kd V(z) q), where C, G, Kp and Kd are diagonal and
the torque is late and held. The mass matrix M couples the joints: each can be stable alone and all
of them unstable together. The state has positions, velocities, torques on their way and the memory
of the velocity estimators. The matrix that advances it by one period has all its eigenvalues inside
the unit circle if and only if the robot is stable at that posture.

- Between samples the motion is the exponential of [[A, B], [0, 0]] (Van Loan 1978) or, in an
  engine, a power of its step. MuJoCo's Euler and implicit steps solve
  (M + h C) v+ = M v + h (u - G q), q+ = q + h v+. Implicit gains add Kd to C.
- A joint without torque, damping and spring only adds its inertia to the others: M is then the
  inverse of the block of M^-1 that the others have.
- A joint that nothing holds in place has one root at 1, which does not count.

Time is in sampling periods, an angle in units of 1/sqrt(M_ii). The eigenvalues are computed in
float64 and not proved, so a radius within ``_NEAR`` of 1 is undecided.
"""

from dataclasses import dataclass, replace
from math import factorial, nan
from typing import Any

import numpy as np
from scipy.linalg import expm

from jaxstab.conventions import Verdict
from jaxstab.lab.joints.joint import JointControl
from jaxstab.model.filters import Velocity, behind_measured

Matrix = np.ndarray[Any, np.dtype[Any]]

_NEAR = 2e-7  # more than the rounding of nearly double roots: that of 1e-14, to the power 1/2


def verdict_of(radius: float) -> Verdict:
    """The verdict on a computed spectral radius; UNDECIDED close to 1 and for NaN."""
    if radius < 1.0 - _NEAR:
        return Verdict.STABLE
    return Verdict.UNSTABLE if radius > 1.0 + _NEAR else Verdict.UNDECIDED


@dataclass(frozen=True)
class ControlledRobot:
    """The joints of a robot under their gains: arrays (n,) in SI units, at the longest delay."""

    control: JointControl
    damping: Matrix
    spring: Matrix
    kp: Matrix
    kd: Matrix

    def grown(self, factor: float) -> "ControlledRobot":
        """The loop with all gains multiplied by a factor."""
        return replace(self, kp=factor * self.kp, kd=factor * self.kd)

    @property
    def drifts(self) -> Matrix:
        """True (n,) for joints with gains that nothing holds in place."""
        return self._is_held & (self.kp + self.spring == 0.0)

    def radius(self, mass: Matrix) -> float:
        """The spectral radius with a mass matrix (n, n), drift not counted; NaN on overflow."""
        period = self.one_period(mass)
        if not np.all(np.isfinite(period)):
            return nan
        roots = np.linalg.eigvals(period)
        return float(np.max(np.abs(roots[self._counted(roots)]), initial=0.0))

    def shares(self, mass: Matrix) -> Matrix:
        """The share (n,) of each joint's gains in the motion of the largest root; 0 on overflow."""
        period = self.one_period(mass)
        if not np.all(np.isfinite(period)):
            return np.zeros(len(mass))
        roots, vectors = np.linalg.eig(period)
        counted = self._counted(roots)
        motion = vectors[:, counted[np.argmax(np.abs(roots[counted]))]]
        angles = np.zeros(len(mass), complex)
        angles[self._is_held] = motion[: np.count_nonzero(self._is_held)]
        sizes = np.ones(len(mass))
        sizes[self._moves] = np.diag(self._moving(mass))
        shares = np.abs(angles) ** 2 * self._load / sizes
        return np.asarray(shares / np.sum(shares))

    def lightness(self, mass: Matrix) -> float:
        """The largest kd + T kp per inertia of any motion, which is large in critical postures."""
        root = np.sqrt(self._load)
        return float(np.linalg.eigvalsh(root[:, None] * np.linalg.inv(mass) * root)[-1])

    def one_period(self, mass: Matrix) -> Matrix:
        """The matrix that advances the state by one period."""
        late, fraction = self._delay
        lines = late + (fraction > 0.0)
        pushed = np.flatnonzero(self._is_driven[self._moves])
        held = np.flatnonzero(self._is_held[self._moves])
        with np.errstate(all="ignore"):
            mass, damping, spring, kp, kd = self._per_period(mass)
            if self.control.is_inside and self.control.rule == "implicit-damping":
                damping, kd = damping + kd, 0.0 * kd
            motion = self._motion(mass, damping, spring, held, pushed)
            count, own = len(pushed), len(motion) - len(pushed)
            memory, into, out, direct = self._estimator
            state, one = np.eye(own + count * (lines + len(memory))), np.eye(count)
            position, speed = state[held.searchsorted(pushed)], state[len(held) + pushed]
            seen = speed if self._is_measured else position
            sent, remembered = np.split(state[own:], [count * lines])
            estimate = direct * seen + np.kron(out, one) @ remembered
            torque = -(kp[pushed, None] * position + kd[pushed, None] * estimate)
            torques = [torque, *(sent[k * count :][:count] for k in range(lines))]  # newest first
            moved = state[:own]
            for share, acting in ((fraction, torques[-1]), (1.0 - fraction, torques[late])):
                if share:
                    moved = (self._over(motion, share) @ np.vstack([moved, acting]))[:own]
            kept = np.kron(memory, one) @ remembered + np.kron(into, one) @ seen
        return np.vstack([moved, *torques[:lines], kept])

    def _motion(
        self, mass: Matrix, damping: Matrix, spring: Matrix, held: Matrix, pushed: Matrix
    ) -> Matrix:
        """[[A, B], [0, 0]] over a period; in an engine, what one step does to state and torque."""
        n, rule, inverse = len(mass), self.control.rule, np.linalg.inv(mass)
        rate = np.zeros((2 * n + len(pushed),) * 2)
        rate[:n, n : 2 * n] = np.eye(n)
        rate[n : 2 * n] = np.hstack([-inverse * spring, -inverse * damping, inverse[:, pushed]])
        moved, step = rate, self.control.step / self.control.sample_time
        if rule == "rk4":
            powers = (np.linalg.matrix_power(rate * step, k) / factorial(k) for k in range(5))
            moved = np.sum([*powers], axis=0)
        elif rule:
            response = np.eye(len(rate))
            if rule != "semi-implicit":  # damping at the new velocity
                solved = np.linalg.solve(mass + step * np.diag(damping), mass)
                response[n : 2 * n, n : 2 * n] = solved
            response[:n] += step * response[n : 2 * n]  # the position moves with that, too
            moved = np.eye(len(rate)) + step * response @ rate
        kept = [*held, *range(n, len(rate))]
        return moved[np.ix_(kept, kept)]

    def _over(self, motion: Matrix, share: float) -> Matrix:
        """The motion over a share of a period."""
        if not self.control.rule:
            try:
                return np.asarray(expm(motion * share))
            except np.linalg.LinAlgError:  # of numbers that overflow
                return np.full_like(motion, nan)
        steps = round(share * self.control.sample_time / self.control.step)
        return np.linalg.matrix_power(motion, steps)

    def _per_period(self, mass: Matrix) -> tuple[Matrix, ...]:
        """Mass matrix, damping, spring, kp and kd of the joints that move, without units."""
        moves, period, mass = self._moves, self.control.sample_time, self._moving(mass)
        size = np.diag(mass)
        scaled = mass / np.sqrt(np.outer(size, size))
        damping, kd = (period * each[moves] / size for each in (self.damping, self.kd))
        spring, kp = (period**2 * each[moves] / size for each in (self.spring, self.kp))
        return scaled, damping, spring, kp, kd

    def _moving(self, mass: Matrix) -> Matrix:
        """The mass matrix of the joints with torque, damping or spring, the others free."""
        moves = self._moves
        return mass if np.all(moves) else np.linalg.inv(np.linalg.inv(mass)[np.ix_(moves, moves)])

    def _counted(self, roots: Matrix) -> Matrix:
        """The places of the roots that count: all but one at 1 for each joint that drifts."""
        return np.argsort(np.abs(roots - 1.0))[np.count_nonzero(self.drifts) :]

    @property
    def _delay(self) -> tuple[int, float]:
        """Whole samples, and the rest of the delay as a share of one."""
        samples = (self.control.delay + self.control.jitter) / self.control.sample_time
        near = round(samples * 2.0**32) / 2.0**32  # of a delay of whole samples, but for rounding
        return int(near), near % 1.0

    @property
    def _estimator(self) -> tuple[Matrix, Matrix, Matrix, float]:
        """A, B, C and D of the velocity estimator: its stages in a row, in sampling periods."""
        velocity, period = self.control.velocity or Velocity(), self.control.sample_time
        if self._is_measured:
            behind = self.control.velocity and behind_measured(self.control.velocity)
            stages = behind.stages(period) if behind else []
        else:
            samples, stages = velocity.stages(period)
            difference = (1.0 / samples, *[0.0] * (samples - 1), -1.0 / samples)
            stages = [(difference, (1.0,)), *stages]
        a, b, c, d = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), 1.0
        for above, below in stages:
            order = max(len(above), len(below)) - 1
            poles, zeros = np.zeros(order + 1), np.zeros(order + 1)
            poles[: len(below)], zeros[: len(above)] = below, above
            own = np.eye(order, k=-1)
            own[:1] = -poles[1:]
            enters, leaves = np.eye(order, 1), zeros[None, 1:] - zeros[0] * poles[None, 1:]
            a = np.block([[a, np.zeros((len(a), order))], [enters @ c, own]])
            b, c, d = np.vstack([b, d * enters]), np.hstack([zeros[0] * c, leaves]), zeros[0] * d
        return a, b, c, d

    @property
    def _is_measured(self) -> bool:
        """True if the engine's own velocity is taken."""
        velocity = self.control.velocity
        is_own = velocity is None or behind_measured(velocity) is not None
        return bool(self.control.rule) and is_own

    @property
    def _is_driven(self) -> Matrix:
        return self._load > 0.0

    @property
    def _is_held(self) -> Matrix:
        """True for joints whose positions are states."""
        return self._is_driven | (self.spring > 0.0)

    @property
    def _moves(self) -> Matrix:
        return self._is_held | (self.damping > 0.0)

    @property
    def _load(self) -> Matrix:
        return self.kd + self.control.sample_time * self.kp
