"""The joints of a robot file: are their gains stable, for every inertia that a joint may have?

MuJoCo reads MJCF and URDF and gives the mass matrix M of a posture. One joint under kp and kd, the
others without torque, moves as an inertia 1/(M^-1)_ii; with the others held as M_ii, which is never
less. Both are sampled over postures; armature is in M, and adds to both (Sherman, Morrison). What
is proved holds for every constant inertia between the least and the greatest that were seen. Left
out are gravity, and that other joints are controlled at the same time.

The loop is a wall on a held inertia (``HapticLoop``) or, ``simulated``, on the file's own step and
rule of integration: position actuators inside of the step (``simulated_pd``), or a torque that a
program holds (``Device.simulated``). A range of inertia is proved by one of two lemmas:

- Without damping and spring p(z) depends on (kp, kd)/J alone: all inertias are a ray of gains at
  one of them, whose stable intervals are complete (E3), and its end is the least inertia. Inside of
  a step, damping c adds to kd and a spring to kp; where c alone is implicit, J + h c is the inertia
  of a semi-implicit step.
- Otherwise a held joint has boxes, ``worst_hand`` with a range of mass, also for a delay that
  moves. Its least inertia is bracketed by verdicts.

A damped joint under a torque that is held for steps of an engine is tried, not proved.
"""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, field, fields, replace
from decimal import ROUND_CEILING
from difflib import get_close_matches
from functools import cached_property, partial
from importlib import import_module
from math import inf, isfinite, isnan, nan, pi
from os import PathLike
from typing import Annotated, Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from jaxstab.boxes.hands import HandRange
from jaxstab.conventions import Verdict
from jaxstab.exact import LineStatus, StableLine, TripleAt, stable_line, wall_verdict
from jaxstab.loop import HapticLoop, Loop, simulated_pd
from jaxstab.loop.margins import crossings_of, ends_of_gains
from jaxstab.model import Device
from jaxstab.model.affine import affine_triple
from jaxstab.model.balls import ball_triple
from jaxstab.model.filters import Velocity
from jaxstab.numbers import checked_count, checked_number
from jaxstab.rounding import EPS
from jaxstab.scene.answers import (
    Answer,
    Damping,
    GivenDamping,
    GivenStiffness,
    IntervalQuantity,
    Quantity,
)
from jaxstab.scene.check import SpareGain, SpareTime
from jaxstab.scene.gains import GainAnswer
from jaxstab.scene.hands import BUT_FOR_DRIFT
from jaxstab.scene.scene import Units
from jaxstab.shown import rounded_text, shortened, table_text
from jaxstab.tables import text_of

_SEED = 55  # of the postures
_TRIED = 17  # inertias where a range is not proved
_MOST_BYTES = 100_000_000  # of a file

Gains = tuple[float, float]


class Joint(NamedTuple):
    """A joint of a file, and the ``reason`` why it is not answered for, if there is one."""

    turns: bool
    least: float
    greatest: float
    damping: float
    spring: float
    friction: float
    gains: Gains
    reason: str | None


# ------------------------------------------------------------------------------------- robot files
def _model_of(robot: Any) -> Any:
    """The model of a file, or a copy of one; of URDF neither shapes nor meshes are read."""
    mujoco = _optional("mujoco")
    if isinstance(robot, mujoco.MjModel):
        return copy(robot)
    if not isinstance(robot, str | PathLike):
        raise TypeError(f"robot is {shortened(robot)}; give a file name or a mujoco.MjModel.")
    try:
        root = ElementTree.fromstring(text_of(robot, _MOST_BYTES))
        if root.tag != "robot":
            return mujoco.MjModel.from_xml_path(str(robot))
        for link in root.iter("link"):
            for shape in [*link.findall("visual"), *link.findall("collision")]:
                link.remove(shape)
        return mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
    except (ElementTree.ParseError, ValueError) as error:
        words = " ".join(str(error).split()).rstrip(".")
        raise ValueError(f"MuJoCo reads no robot from {robot}: {words}.") from error


def _optional(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError as error:
        raise RuntimeError(
            f"robot files need the package {name}: python -m pip install 'jaxstab[robots]'."
        ) from error


def _joints_of(model: Any, postures: int) -> dict[str, Joint]:
    import mujoco

    least, greatest = _inertias(model, postures)
    reasons, joints = _reasons(model), {}
    for index, kind in enumerate(model.jnt_type.tolist()):
        own, place = model.joint(index), model.jnt_dofadr[index]
        gains, damping = _actuators(model, index)
        joints[own.name or f"joint {index}"] = Joint(
            kind != mujoco.mjtJoint.mjJNT_SLIDE,
            float(least[place]),
            float(greatest[place]),
            float(model.dof_damping[place]) + damping,
            float(model.jnt_stiffness[index]),
            float(model.dof_frictionloss[place]),
            gains,
            reasons.get(index),
        )
    return joints


def _actuators(model: Any, joint: int) -> tuple[Gains, float]:
    """The gains of the position and velocity actuators of a joint, and the damping they add."""
    import mujoco

    places = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    own = np.isin(model.actuator_trntype, [*map(int, places)]) & (
        model.actuator_trnid[:, 0] == joint
    )
    gear = model.actuator_gear[own, 0] ** 2  # of the angle, and of the torque
    damping = getattr(model, "actuator_damping", np.zeros(model.nu))[own]  # new versions have it
    is_pd = model.actuator_biastype[own] == int(mujoco.mjtBias.mjBIAS_AFFINE)
    kp, kd = -(gear * is_pd) @ model.actuator_biasprm[own, 1:3]
    return (float(kp) + 0.0, float(kd) + 0.0), float(gear @ damping)


def _reasons(model: Any) -> dict[int, str]:
    """Why joints are not answered for: several of them, or several axes, move together."""
    import mujoco

    kinds, ways, along = mujoco.mjtJoint, mujoco.mjtEq, _along_tendons(model)
    reasons = dict[int, str]()
    driven = model.actuator_trnid[model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_TENDON), 0]
    for index in range(model.ntendon):
        if index in driven or model.tendon_stiffness[index] or model.tendon_damping[index]:
            words = f"tendon {model.tendon(index).name or index} moves it with other joints"
            reasons |= dict.fromkeys(along[index], words)
    for index in np.flatnonzero(model.eq_active0).tolist():
        kind, pair = int(model.eq_type[index]), (model.eq_obj1id[index], model.eq_obj2id[index])
        ends, words = [end for end in map(int, pair) if end >= 0], "ties it to another joint"
        tied = {*ends} if kind == ways.mjEQ_JOINT else set[int]()
        if kind == ways.mjEQ_TENDON:
            tied = tied.union(*(along[end] for end in ends))
        elif kind in (ways.mjEQ_CONNECT, ways.mjEQ_WELD):
            if int(model.eq_objtype[index]) == mujoco.mjtObj.mjOBJ_SITE:
                ends = model.site_bodyid[ends].tolist()
            first, second = (_above(model, body) for body in ends)
            tied, words = first ^ second, "closes a chain that it is in"
        words = f"equality {model.equality(index).name or index} {words}"
        reasons |= dict.fromkeys(tied, words)
    several = {kinds.mjJNT_FREE: "it moves freely", kinds.mjJNT_BALL: "a ball, of three axes"}
    types = enumerate(map(kinds, model.jnt_type.tolist()))
    return reasons | {index: several[kind] for index, kind in types if kind in several}


def _above(model: Any, body: int) -> set[int]:
    """The joints between the world and a body."""
    joints = set[int]()
    while body:
        start = int(model.body_jntadr[body])
        joints |= {*range(start, start + int(model.body_jntnum[body]))}
        body = int(model.body_parentid[body])
    return joints


def _along_tendons(model: Any) -> list[set[int]]:
    """The joints that change the length of each tendon, next to some posture."""
    import mujoco

    data, near = mujoco.MjData(model), 1e-4
    here, lengths = _posture(model, np.random.default_rng(_SEED)), list[np.ndarray]()
    for place in (0, *model.jnt_qposadr.tolist()):
        data.qpos[:] = here
        data.qpos[place] += near if lengths else 0.0
        mujoco.mj_fwdPosition(model, data)
        lengths.append(data.ten_length.copy())
    changes = np.abs(np.array(lengths[1:]) - lengths[0]) > 1e-6 * near
    return [{*np.flatnonzero(changed).tolist()} for changed in changes.T]


def _inertias(model: Any, postures: int) -> tuple[np.ndarray, np.ndarray]:
    """The least 1/(M^-1)_ii and the greatest M_ii over postures, the file's own among them."""
    import mujoco

    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data, rng, units = mujoco.MjData(model), np.random.default_rng(_SEED), np.eye(model.nv)
    mass, (least, greatest) = np.zeros_like(units), (np.full(model.nv, inf), np.zeros(model.nv))
    for number in range(postures):
        data.qpos[:] = _posture(model, rng) if number else model.qpos0
        mujoco.mj_fwdPosition(model, data)
        for row, unit in zip(mass, units, strict=True):
            mujoco.mj_mulM(model, data, row, unit)
        least = np.minimum(least, 1.0 / np.diag(np.linalg.inv(mass)))
        greatest = np.maximum(greatest, np.diag(mass))
    if not (model.nv and np.all((least > 0.0) & np.isfinite(greatest))):
        raise ValueError(
            "the robot has no joint, or its mass matrix is not positive; give one that moves, with "
            "masses and inertias of all bodies."
        )
    return np.minimum(least, greatest), greatest


def _posture(model: Any, rng: np.random.Generator) -> np.ndarray:
    """Joints anywhere in their ranges, hinges without one anywhere in a turn."""
    import mujoco

    place, kinds = model.qpos0.copy(), mujoco.mjtJoint
    for index, kind in enumerate(model.jnt_type.tolist()):
        at = model.jnt_qposadr[index]
        if kind == kinds.mjJNT_BALL:
            turn = rng.standard_normal(4)
            place[at : at + 4] = turn / np.linalg.norm(turn)
        elif model.jnt_limited[index] and kind != kinds.mjJNT_FREE:
            place[at] = rng.uniform(*model.jnt_range[index])
        elif kind == kinds.mjJNT_HINGE:
            place[at] = rng.uniform(-pi, pi)
    return place


# ------------------------------------------------------------------------------------------- loops
class _Control(NamedTuple):
    """What closes the loop of every joint; in a simulation the rule of its steps.

    ``is_inside``: the gains are part of the step. Times are in s.
    """

    sample_time: float
    delay: float
    jitter: float
    velocity: Velocity | None
    step: float
    rule: str = ""
    is_inside: bool = False

    @property
    def words(self) -> str:
        """Where and when the gains act."""
        if self.is_inside:
            return f"inside of the simulation's step of {1e3 * self.step:g} ms, {self.rule}"
        late = f"{1e3 * self.delay:g} ms"
        if self.jitter:
            late += f" to {1e3 * (self.delay + self.jitter):g} ms, varying"
        own = f"the engine's velocity; steps of {1e3 * self.step:g} ms, {self.rule}"
        velocity = str(self.velocity or (own if self.rule else Velocity()))
        return f"{1.0 / self.sample_time:g} Hz, delay {late}, {velocity}"


@dataclass(frozen=True)
class _Question:
    """A joint under two gains."""

    control: _Control
    joint: Joint
    gains: Gains

    @property
    def drifts(self) -> bool:
        """Whether nothing holds the position: one root at 1 does not count then."""
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
        verdict = wall_verdict(_triple(loop), *self.gains, may_drift=self.drifts).verdict
        return Verdict.UNDECIDED if jitter and verdict == Verdict.STABLE else verdict

    def verdict(self) -> Verdict:
        """The verdict for every inertia: proved, if not UNDECIDED."""
        joint = self.joint
        if self._ray is None and not (self.control.rule or self.drifts):
            loop: Any = self.loop(joint.greatest)
            moves = {"delays": (self.control.delay, loop.delay)} if self.control.jitter else {}
            springs, inertias = (joint.spring, joint.spring), (joint.least, joint.greatest)
            own = HandRange(stiffness=springs)
            return Verdict(loop.worst_hand(own, *self.gains, mass=inertias, **moves).verdict)
        if self._ray is not None:
            line, reach, shift = self._ray
            rounded = (joint.greatest, 1.0 - 4.0 * EPS), (joint.least, 1.0 + 4.0 * EPS)
            ends = [line.holding(outwards * reach / (own + shift)) for own, outwards in rounded]
            if ends[0] and ends[0] == ends[1]:
                return Verdict.STABLE
        tried = np.geomspace(joint.least, joint.greatest, _TRIED).tolist()
        codes = {self.verdict_at(inertia) for inertia in tried}
        return Verdict.UNSTABLE if Verdict.UNSTABLE in codes else Verdict.UNDECIDED

    def least_inertia(self) -> float:
        """From which inertia on these gains are stable, to the greatest at least; NaN from none."""
        joint, period = self.joint, self.control.sample_time
        if self._ray is None:
            fast = max(joint.damping * period, joint.spring * period**2, 2e-12 * joint.greatest)
            return self._bracketed(fast / 2**12)  # faster ones are refused
        line, reach, shift = self._ray
        # The greatest inertia is nearest to 0, and what begins at 0 has all heavier ones.
        heavy = (i for i in line.intervals if i.high.value > 0.0 and i.low.value <= i.low.error)
        held = line.holding(reach / (joint.greatest + shift)) or next(heavy, None)
        if held is None or line.status != LineStatus.PROVED:
            return nan
        return max((1.0 + 4.0 * EPS) * reach / (held.high.value - held.high.error) - shift, 0.0)

    def _bracketed(self, lightest: float) -> float:
        """The least inertia that is stable with all that were tried above, or the lightest one.

        1e-9 of it below, it is not proved stable. NaN if none to 2^40 times the greatest is.
        """

        def is_stable(inertia: float) -> bool:
            return self.verdict_at(inertia) == Verdict.STABLE

        high = self.joint.greatest
        while not is_stable(high):
            high *= 2.0
            if high > self.joint.greatest * 2.0**40:
                return nan
        low = 0.5 * high
        while is_stable(low):
            high, low = low, 0.5 * low
            if low < lightest:
                return high
        while high - low > 1e-9 * high:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if is_stable(middle) else (middle, high)
        return high

    def spare(self, inertia: float) -> tuple[float, float, float]:
        """By which factors kp and kd may grow, and for how many s more the delay; NaN for none."""
        loop, (kp, kd), later = self.loop(inertia), self.gains, nan
        if isinstance(loop, Loop) or self.control.rule or self.drifts:
            ends = [crossing.end for crossing in ends_of_gains(_triple(loop), self.gains)]
        else:
            ends = crossings_of(loop.in_floats(), self.gains)[1::2]
            later = ends[4] * self.control.sample_time
        return ends[1] / kp if kp > 0.0 else nan, ends[3] / kd if kd > 0.0 else nan, later

    @cached_property
    def _ray(self) -> tuple[StableLine, float, float] | None:
        """The stable gains along (kp, kd)/J, J times the place on it, and what adds to J."""
        control, joint, (kp, kd), shift = self.control, self.joint, self.gains, 0.0
        if control.is_inside:
            kp, kd = kp + joint.spring, kd + joint.damping
            if control.rule == "implicit-joint":
                shift = control.step * joint.damping
                control = control._replace(rule="semi-implicit")
        elif joint.damping or joint.spring or control.jitter:
            return None
        alone = replace(self, control=control, joint=joint._replace(damping=0.0, spring=0.0))
        line = stable_line(_triple(alone.loop(joint.greatest)), (0.0, 0.0), (kp, kd))
        return line, joint.greatest, shift


def _triple(loop: HapticLoop | Loop) -> TripleAt:
    if isinstance(loop, Loop):
        return partial(affine_triple, loop.parts)
    return partial(ball_triple, loop.in_floats())


# ----------------------------------------------------------------------------------------- answers
def joints(
    robot: Any,
    *,
    rate: float | None = None,
    delay: float = 0.0,
    jitter: float = 0.0,
    gains: Any = None,
    velocity: Velocity | None = None,
    simulated: bool = False,
    postures: int = 256,
) -> "Joints":
    """Whether the gains of each joint of a robot are stable, for every inertia that it may have.

    One joint is asked at a time, the others held or without torque: that all are stable alone does
    not say that they are together.

    Args:
        robot: an MJCF or URDF file, or a ``mujoco.MjModel``.
        rate: of the controller in Hz; None, if ``simulated``, for gains inside of the step.
        delay: from the sample to the torque in s, the hold not counted.
        jitter: in s; the delay then varies from ``delay`` to ``delay + jitter``, sample by sample.
        gains: ``kp`` and ``kd`` by the joint's name, in place of those of the file's actuators; in
            N m/rad and N m s/rad, of slides in N/m and N s/m.
        velocity: the estimator; None for the difference over one sample or, if ``simulated``, the
            engine's own velocity.
        simulated: whether the joint moves by the file's own step and rule of integration.
        postures: how many are sampled over the joints' ranges.

    Returns:
        Joints: a ``JointAnswer`` by the name of each joint.

    Raises: see ``jaxstab.conventions``; RuntimeError without MuJoCo; ValueError also for files that
    it does not read, and joints and rules of integration that are not known.

    Source: the paper's eq. (9), as ``HapticLoop`` and ``simulated_pd``; MuJoCo's mass matrix.

    Example:
        >>> answer = jaxstab.joints("data/robots/arm.xml", rate=500.0, delay=2e-3)
        >>> shoulder, elbow = answer.joints.values()
        >>> shoulder.verdict, round(shoulder.kp_growth, 1), elbow.verdict
        (<Verdict.STABLE: 1>, 13.6, <Verdict.UNSTABLE: 2>)
    """
    model = _model_of(robot)
    found = _joints_of(model, checked_count("postures", postures, 1, 100_000))
    timing = {"rate": rate, "delay": delay, "jitter": jitter, "velocity": velocity}
    control = _control(model, simulated=simulated, **timing)
    given = _checked_gains({} if gains is None else gains, [*found])
    plain = Joint(True, 1.0, 1.0, 0.0, 0.0, 0.0, (1.0, 1.0), None)
    _Question(control, plain, plain.gains).verdict_at(1.0)  # refuses timing that no joint can have
    questions = {
        name: _Question(control, own, given.get(name, own.gains)) for name, own in found.items()
    }
    source = str(robot) if isinstance(robot, str | PathLike) else "a model"
    sampled = f"at {postures} postures, with the other joints free to held; armature included"
    inputs = GainAnswer({"robot": source, "loop": control.words, "inertia": sampled})
    return Joints(inputs, {name: _answer(own) for name, own in questions.items()}, questions)


def _control(
    model: Any, *, simulated: bool, rate: Any, delay: Any, jitter: Any, velocity: Any
) -> _Control:
    import mujoco

    delay = checked_number("delay", delay, 0.0, unit="s")
    jitter = checked_number("jitter", jitter, 0.0, unit="s")
    is_inside, step = rate is None, float(model.opt.timestep)
    if is_inside and (not simulated or delay or jitter or velocity):
        raise ValueError(
            "rate is missing; give that of the controller in Hz. Only simulated gains inside of "
            "the step, without delay, jitter and velocity, have none."
        )
    hertz = None if is_inside else checked_number("rate", rate, 0.0, is_open=True, unit="Hz")
    period = 1.0 / hertz if hertz else step
    if not simulated:
        return _Control(period, delay, jitter, velocity, step)
    plain = model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    own = mujoco.mjtIntegrator(model.opt.integrator).name[6:]
    rule = "semi-implicit" if own == "EULER" and plain else _RULES.get(own)
    if rule is None or (rule == "rk4" and is_inside) or jitter:
        raise ValueError(
            f"simulated with the integrator {own}{' and jitter' * (jitter > 0.0)} is not "
            "answered; give Euler, implicit or implicitfast (RK4 beside a rate), and no jitter."
        )
    return _Control(period, delay, jitter, velocity, step, rule, is_inside)


_RULES = {
    "EULER": "implicit-joint",
    "IMPLICIT": "implicit-damping",
    "IMPLICITFAST": "implicit-damping",
    "RK4": "rk4",
}
"""The names of ``Device.simulated`` for MuJoCo's integrators."""


def _checked_gains(gains: Any, names: list[str]) -> dict[str, Gains]:
    """Pairs of gains of joints that there are."""
    if not isinstance(gains, Mapping):
        raise TypeError(f"gains is {shortened(gains)}; give kp and kd by the names of joints.")
    checked = dict[str, Gains]()
    for name, pair in gains.items():
        if name not in names:
            near = get_close_matches(str(name), names, 1) or names
            raise ValueError(
                f"gains has {shortened(name)}, which is no joint of the robot; give {near[0]}, for "
                "instance."
            )
        if not isinstance(pair, Mapping) or {*pair} != {"kp", "kd"}:
            raise ValueError(f"the gains of {name} are {shortened(pair)}; give kp and kd.")
        kp, kd = (_number(f"{key} of {name}", pair[key]) for key in ("kp", "kd"))
        checked[name] = kp, kd
    return checked


def _number(name: str, value: Any) -> float:
    """A gain, also as the text that YAML makes of 1e3, without a point and a sign."""
    with suppress(ValueError):
        value = float(value) if isinstance(value, str) else value
    return checked_number(name, value, 0.0)


def read_gains(file: str | PathLike[str]) -> Any:
    """What a YAML file holds, which ``joints`` checks; ValueError if it is not YAML."""
    yaml = _optional("yaml")

    class Once(yaml.SafeLoader):  # type: ignore[misc, name-defined]
        """YAML in which no key is given twice; the last one would count."""

        def construct_mapping(self, node: Any, deep: bool = False) -> Any:
            names = [str(key.value) for key, _ in node.value]
            for name in names:
                if names.count(name) > 1:
                    raise ValueError(f"{file} gives {shortened(name)} twice; give each key once.")
            return super().construct_mapping(node, deep)

    try:
        return yaml.load(text_of(file, _MOST_BYTES), Once) or []  # which are no gains
    except yaml.YAMLError as error:
        raise ValueError(f"{file} is not YAML: {' '.join(str(error).split())}.") from error


Inertia = Annotated[float, Quantity("kg", 4, ROUND_CEILING)]


@dataclass(frozen=True)
class JointAnswer(Answer):
    """A joint: its inertias, the verdict on its gains, and what is left of them.

    In kg m^2, N m/rad and N m s/rad, of a slide in kg, N/m and N s/m. Growth and extra delay are
    the lesser of both ends of the range, at the longest delay; NaN where not stable.

    Attributes:
        motion: "turns" or "slides".
        inertia: the least over postures with the other joints free, the greatest with them held.
        damping: of the joint.
        friction: of the joint, which the loop leaves out.
        kp, kd: None where there are none.
        verdict: for every inertia; a text where nothing is asked, or nothing holds the position.
        kp_growth, kd_growth: the factor by which one gain may grow alone.
        extra_delay: by how many s the delay may be longer; None in a simulation.
        least_inertia: from which on the gains are stable, or the least tried; NaN from none.
        missing_armature: what the least inertia of the joint lacks of that.

    Example:
        >>> answer = jaxstab.joints("data/robots/arm.xml", rate=500.0, delay=2e-3)
        >>> elbow = answer.joints["elbow"]
        >>> elbow.verdict.name, elbow.is_stable, round(elbow.missing_armature, 5)
        ('UNSTABLE', False, 0.00173)
        >>> elbow.as_json()["units"]["kp"]
        'N m/rad'
    """

    motion: str
    inertia: Annotated[tuple[float, float], IntervalQuantity("kg", 4)]
    damping: Damping
    friction: Annotated[float, Quantity("N")]
    kp: GivenStiffness | None
    kd: GivenDamping | None
    verdict: Verdict | str
    kp_growth: SpareGain | None = None
    kd_growth: SpareGain | None = None
    extra_delay: SpareTime | None = None
    least_inertia: Inertia | None = None
    missing_armature: Inertia | None = None

    @property
    def is_stable(self) -> bool:
        """Whether the gains are proved stable for every inertia."""
        return self.verdict in (Verdict.STABLE, BUT_FOR_DRIFT)

    def as_json(self, units: Units = Units.LINE) -> dict[str, Any]:
        """Names and values as JSON has them, and the units of this joint."""
        own = self._units(units)
        return super().as_json(own) | {"units": super()._units_of_keys(own)}

    def _cell(self, name: str) -> str:
        """A value as a cell of a table, without its unit but for a time."""
        value = getattr(self, name)
        if value is None or isinstance(value, str | Verdict):
            return "" if value is None else self._words(name, value, Units.LINE)
        quantity = self._quantity(name)
        unitless = quantity if quantity.unit == "s" else replace(quantity, unit="")
        return self.absent if isnan(np.sum(value)) else unitless.words(value)

    def _units(self, units: Units) -> Units:
        return Units.ROTATION if self.motion == "turns" else Units.LINE

    def _units_of_keys(self, units: Units) -> dict[str, str]:
        return {}  # each joint has its own


@dataclass(frozen=True)
class Joints(Answer):
    """The answers for all joints of a robot by their names, printed as a table.

    Example:
        >>> answer = jaxstab.joints("data/robots/arm.xml", simulated=True)
        >>> print(answer)
        data/robots/arm.xml: inside of the simulation's step of 2 ms, implicit-joint
        joint     motion  inertia               damping  friction  kp   kd  verdict  kp growth...
        shoulder  turns   0.05629 to 0.1062     0.1      0         100  5   stable   513...
        elbow     turns   0.005646 to 0.009691  0        0.1       20   3   stable   132...
        ...
        >>> answer.all_stable, [row[:2] for row in answer.rows()]
        (True, [['joint', 'motion'], ['shoulder', 'turns'], ['elbow', 'turns']])
        >>> answer.as_json()["joints"]["elbow"]["verdict"], answer.as_yaml().count("kp: ")
        ('stable', 2)
    """

    inputs: GainAnswer
    joints: dict[str, JointAnswer]
    questions: dict[str, _Question] = field(repr=False)

    @property
    def all_stable(self) -> bool:
        """Whether all gains that are judged are proved stable, and there are some."""
        judged = [joint for joint in self.joints.values() if joint.kp_growth is not None]
        return bool(judged) and all(joint.is_stable for joint in judged)

    def safe_gains(self) -> dict[str, dict[str, float]]:
        """Gains of which the doubles are proved stable, too, for every inertia.

        They are the joint's own or the largest of their halves, at the same damping ratio; where it
        has none, or only kp, those from critical damping at 1/T on. Joints without an answer, and
        without a proof, are left out.

        Example:
            >>> answer = jaxstab.joints("data/robots/arm.xml", rate=500.0, delay=2e-3)
            >>> answer.safe_gains()["elbow"]
            {'kp': 2.5, 'kd': 1.061}
        """
        asked = {name: own for name, own in self.questions.items() if not own.joint.reason}
        pairs = {name: _safe(question) for name, question in asked.items()}
        return {name: {"kp": pair[0], "kd": pair[1]} for name, pair in pairs.items() if pair}

    def as_yaml(self) -> str:
        """The safe gains as a YAML file."""
        head = f"# {self.inputs.values['loop']}\n# The doubles of these gains are proved, too.\n"
        return head + str(_optional("yaml").safe_dump(self.safe_gains(), sort_keys=False))

    def rows(self) -> list[list[Any]]:
        """All values for a CSV file, a row for each joint."""
        tables = [{path: own for path, own, _ in each.leaves()} for each in self.joints.values()]
        columns = list(dict.fromkeys(name for table in tables for name in table))
        rows = zip(self.joints, tables, strict=True)
        return [["joint", *columns], *([name, *map(own.get, columns)] for name, own in rows)]

    def __str__(self) -> str:
        answers = self.joints.values()
        given = {name for own in answers for (name,), _ in own._entries()}
        names = [each.name for each in fields(JointAnswer) if each.name in given]
        rows = [[name, *map(own._cell, names)] for name, own in self.joints.items()]
        robot, loop, sampled = self.inputs.values.values()
        return "\n".join(
            [
                f"{robot}: {loop}",
                table_text([["joint", *(name.replace("_", " ") for name in names)], *rows]),
                "Turning in kg m^2, N m/rad, N m s/rad and N m, sliding in kg, N/m, N s/m and N.",
                f"Inertia: sampled {sampled}.",
                "Stable: proved for every inertia of the range, one joint at a time.",
            ]
        )

    def _entries(self) -> Iterator[tuple[tuple[str, ...], Any]]:
        return (entry for entry in super()._entries() if entry[0][0] != "questions")


def _answer(question: _Question) -> JointAnswer:
    joint, control, gains = question.joint, question.control, question.gains
    motion, inertia = "turns" if joint.turns else "slides", (joint.least, joint.greatest)
    kp, kd = gains if any(gains) else (None, None)
    facts = motion, inertia, joint.damping, joint.friction, kp, kd
    if joint.reason or kp is None:
        return JointAnswer(*facts, joint.reason or "no gains")
    try:
        code, least = question.verdict(), question.least_inertia()
        is_stable = code == Verdict.STABLE
        spare = [question.spare(own) for own in inertia] if is_stable else [(nan, nan, nan)]
    except ValueError as error:  # of numbers that are too large or small to compute with
        return JointAnswer(*facts, str(error), nan)
    verdict = BUT_FOR_DRIFT if is_stable and question.drifts else code
    kp_growth, kd_growth, later = map(min, zip(*spare, strict=True))
    missing = max(least - joint.least, 0.0) if isfinite(least) else nan
    delay = None if control.rule else later
    return JointAnswer(*facts, verdict, kp_growth, kd_growth, delay, least, missing)


def _safe(question: _Question) -> Gains | None:
    """Gains of which the doubles are stable, too: the first of a sequence of halves."""
    joint, period = question.joint, question.control.sample_time
    critical = joint.least / period**2, 2.0 * joint.least / period
    for kp, kd in filter(any, (question.gains, critical)):
        for share in 0.5 ** np.arange(60.0):
            pair = [float(rounded_text(gain, 4)) for gain in (share * kp, share**0.5 * kd)]
            tried = (replace(question, gains=(n * pair[0], n * pair[1])) for n in (2.0, 1.0))
            with suppress(ValueError):  # of numbers that are too large to compute with
                if all(each.verdict() == Verdict.STABLE for each in tried):
                    return pair[0], pair[1]
    return None
