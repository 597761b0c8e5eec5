"""One joint under kp and kd: is it stable for every inertia of a range, and what is left?

The loop is a wall on a held inertia (``HapticLoop``) or, by a ``rule`` of integration, on the steps
of a physics engine: gains inside of the step (``simulated_pd``), or a torque that a program holds
(``Device.simulated``). All that is proved is of constant inertias J, from the least to the
greatest, and of all gains between two:

- p(z) is a polynomial in 1/J: of degree 1 without damping and spring, where it depends on kp/J and
  kd/J alone; of degree n in n steps of an engine, and of 4 n with Runge and Kutta's rule. Where
  damping c is implicit, it is one in 1/(J + h c). That is lemma E6 (``exact.ranges``).
- Else a held joint has boxes, as hands of a range have (lemma B20); so has a delay that varies.

The least inertia is searched as other values of one quantity are (``loop.backwards``).
"""

from dataclasses import dataclass
from math import isfinite, nan
from typing import Any, NamedTuple

from jaxstab.boxes.search import HandRange
from jaxstab.conventions import Verdict
from jaxstab.exact import wall_verdict
from jaxstab.exact.ranges import Range, stable_over
from jaxstab.loop.affine import Loop, simulated_pd
from jaxstab.loop.backwards import Sweep, stable_values
from jaxstab.loop.hands import HandFamily
from jaxstab.loop.loop import HapticLoop
from jaxstab.loop.margins import crossings_of, ends_of_gains
from jaxstab.model import Device
from jaxstab.model.balls import Factored
from jaxstab.model.device.parts import exact
from jaxstab.model.filters import Velocity
from jaxstab.rounding import EPS

PD = tuple[float, float]


class Joint(NamedTuple):
    """A joint, its range of inertia, and the ``reason`` why it is not answered for, if any.

    ``servo`` is that against its own gains alone.
    """

    turns: bool
    least: float
    greatest: float
    damping: float
    spring: float
    friction: float
    gains: PD
    reason: str | None
    servo: str | None = None


class JointControl(NamedTuple):
    """The controller of every joint; in a simulation the rule of its steps.

    ``is_inside``: the gains are part of the step. Times are in s.
    """

    sample_time: float
    delay: float
    jitter: float
    velocity: Velocity | None
    step: float
    rule: str = ""
    is_inside: bool = False

    def __str__(self) -> str:
        if self.is_inside:
            return f"inside of the simulation's step of {1e3 * self.step:g} ms, {self.rule}"
        late = f"{1e3 * self.delay:g} ms"
        if self.jitter:
            late += f" to {1e3 * (self.delay + self.jitter):g} ms, varying"
        own = f"the engine's velocity; steps of {1e3 * self.step:g} ms, {self.rule}"
        velocity = str(self.velocity or (own if self.rule else Velocity()))
        return f"{1.0 / self.sample_time:g} Hz, delay {late}, {velocity}"


@dataclass(frozen=True)
class ControlledJoint:
    """A joint under two gains."""

    control: JointControl
    joint: Joint
    gains: PD

    @property
    def drifts(self) -> bool:
        """True if nothing holds the position: one root at 1 does not count then."""
        return self.gains[0] == 0.0 and self.joint.spring == 0.0

    def loop(self, inertia: float) -> HapticLoop | Loop:
        """The loop with an inertia, at its longest delay."""
        period, delay, jitter, velocity, step, rule, is_inside = self.control
        damping, spring = self.joint.damping, self.joint.spring
        timing: Any = {"sample_time": period, "delay": delay + jitter, "velocity": velocity}
        if not rule:
            timing |= {"device_damping": damping, "hand_stiffness": spring}
            return HapticLoop(device_mass=inertia, **timing)
        given: Any = {"step": step, "integrator": rule, "damping": damping, "stiffness": spring}
        if is_inside:
            return simulated_pd(inertia, **given)
        timing["velocity"] = velocity or Velocity.measured()
        return HapticLoop(device=Device.simulated(inertia, **given), **timing)

    def verdict_at(self, inertia: float) -> Verdict:
        """The verdict with one inertia: proved, if not UNDECIDED."""
        loop, (_, delay, jitter, *_) = self.loop(inertia), self.control
        if jitter and not self.drifts and isinstance(loop, HapticLoop):
            return Verdict(int(loop.verdict(*self.gains, delays=(delay, delay + jitter))))
        verdict = wall_verdict(loop._triple, *self.gains, may_drift=self.drifts).verdict
        return Verdict.UNDECIDED if jitter and verdict == Verdict.STABLE else verdict

    def verdict(self, until: PD | None = None) -> Verdict:
        """The verdict for every inertia, ``until`` other gains: proved, if not UNDECIDED."""
        if until is None and Verdict.UNSTABLE in map(self.verdict_at, self._inertias):
            return Verdict.UNSTABLE
        axis, upper = self._range, until or self.gains
        if axis:
            changed = int(self.gains[0] == upper[0])

            def p(gain: float, inertia: float) -> Factored:
                pair = (gain, upper[1]) if changed == 0 else (upper[0], gain)
                own = self.loop(inertia)._triple().at(*pair)
                return own._replace(at_one=own.at_one - self.drifts)

            return stable_over(p, Range(self.gains[changed], upper[changed]), axis)
        if self.drifts:
            return Verdict.UNDECIDED
        springs, (_, delay, jitter, *_) = (self.joint.spring,) * 2, self.control
        moves = (delay, delay + jitter) if jitter and until is None else None
        held, hands = self.loop(self.joint.greatest), HandRange(stiffness=springs)
        every = HandFamily(held, hands, self._inertias, delays=moves)
        if until is None:
            return every.worst(*self.gains).verdict
        left = every.unproved(self.gains, until)
        return Verdict.UNDECIDED if left is None or len(left) else Verdict.STABLE

    def least_inertia(self) -> float:
        """From which inertia on these gains are stable, to the greatest at least; NaN from none.

        1e-12 of it below, they are not proved stable. With all that were tried it is the least.
        """
        most = self.joint.greatest
        scan = Sweep.of(1e-9 * most, 1e9 * most, 61)
        found = stable_values(("inertia", ""), scan, self.verdict_at).intervals
        return next((low.stable for low, high in found if high.stable >= most), nan)

    def spare(self) -> tuple[float, float, float, bool]:
        """By which factors kp and kd may grow, and by how many s a constant delay; NaN for none.

        They are those of both ends of the range. Where growth is proved for every inertia, which is
        said last, it is a little less.
        """
        *growth, later = map(min, zip(*map(self._ends_at, self._inertias), strict=True))
        proved = [self._proved(index, factor) for index, factor in enumerate(growth)]
        pairs = zip(proved, self.gains, strict=True)
        is_proved = all(isfinite(own) or gain == 0.0 for own, gain in pairs)
        kp, kd = proved if is_proved else growth
        return kp, kd, later, is_proved

    def _proved(self, index: int, factor: float) -> float:
        """Nearly this growth of one gain, if it is proved for every inertia; else NaN."""
        share = 1.0 - 2.0**-20 if self._range else 0.99
        grown, upper = 1.0 + share * (factor - 1.0), [*self.gains]
        upper[index] *= grown
        is_proved = isfinite(grown) and self.verdict((upper[0], upper[1])) == Verdict.STABLE
        return grown * (1.0 - EPS) if is_proved else nan

    def _ends_at(self, inertia: float) -> tuple[float, float, float]:
        """The growth of both gains, and of the delay, with one inertia."""
        loop, (kp, kd), later = self.loop(inertia), self.gains, nan
        if isinstance(loop, Loop) or self.control.rule or self.drifts:
            ends = [end for end, _ in ends_of_gains(loop._triple, self.gains)]
        else:
            ends = crossings_of(loop.in_floats(), self.gains)[1::2]
            later = ends[4] * self.control.sample_time
        return ends[1] / kp if kp else nan, ends[3] / kd if kd else nan, later

    @property
    def _inertias(self) -> tuple[float, float]:
        return self.joint.least, self.joint.greatest

    @property
    def _range(self) -> Range | None:
        """The inertias, if p(z) is a polynomial in 1/J, or in 1/(J + h c)."""
        joint, control = self.joint, self.control
        is_free = not (joint.damping or joint.spring)
        if control.jitter or not (control.rule or is_free):
            return None
        steps = 1 if is_free or control.is_inside else round(control.sample_time / control.step)
        is_implicit = control.rule.startswith("implicit")
        added = exact(control.step) * exact(joint.damping) * is_implicit
        degree = steps * (4 if control.rule == "rk4" and not is_free else 1)
        return Range(*self._inertias, degree, lambda inertia: 1 / (inertia + added))
