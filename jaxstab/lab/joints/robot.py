"""The joints of a robot file: are their gains stable, for every inertia that a joint may have?

MuJoCo reads MJCF and URDF, and gives the mass matrix M of a posture. One joint under kp and kd, the
others without torque, moves as an inertia 1/(M^-1)_ii; with the others held as M_ii, which is never
less. Both are sampled over postures; armature is in M, and adds to both (Sherman, Morrison). Each
joint is judged alone (``loop.joint``), proved; those that move only with others are named with the
reason. Controlled at the same time, joints shake each other through M: the whole robot is judged by
its eigenvalues at the sampled postures (``loop.together``), computed. Gravity is left out.
"""

import os
import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from copy import copy
from dataclasses import dataclass, field, fields, replace
from decimal import ROUND_CEILING
from difflib import get_close_matches
from importlib import import_module
from math import inf, isfinite, isnan, nan, pi
from os import PathLike
from typing import Any
from xml.etree import ElementTree

import lazy_loader
import numpy as np

from jaxstab.answers import (
    BUT_FOR_DRIFT,
    FORMATS,
    Answer,
    GainAnswer,
    Quantity,
    Units,
    formats_of,
    in_words,
)
from jaxstab.conventions import Verdict
from jaxstab.lab.joints.joint import PD, ControlledJoint, Joint, JointControl
from jaxstab.lab.joints.together import ControlledRobot, verdict_of
from jaxstab.model.filters import Velocity
from jaxstab.numbers import checked_count, checked_number
from jaxstab.shown import rounded_text, shortened, table_text
from jaxstab.tables import PERIODS, text_of

mujoco: Any = lazy_loader.load("mujoco")  # loaded at its first use

_SEED = 55  # of the postures
_MOST_NUMBERS = 2.5e7  # in the mass matrices that are kept: 200 MB
MOST_BYTES = 100_000_000
"""Of a robot file."""


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
    """The verdict on the gains of each joint of a robot, and on all joints at once.

    Each joint alone is answered for every inertia that it may have, the others held or without
    torque. The robot, with the gains of all joints, is answered at the sampled postures.

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
        Joints: a ``JointAnswer`` by the name of each joint, and ``together`` for the robot.

    Raises: see ``jaxstab.conventions``; RuntimeError without MuJoCo; ValueError also for files that
    it does not read, and joints and rules of integration that are not known.

    Source: the paper's eq. (9), as ``HapticLoop`` and ``simulated_pd``; MuJoCo's mass matrix; B20
    and E6 of docs/proofs.md.

    Example:
        >>> answer = jaxstab.joints("data/robots/arm.xml", rate=500.0, delay=2e-3)
        >>> shoulder, elbow = answer.joints.values()
        >>> shoulder.verdict, round(shoulder.kp_growth, 1), elbow.verdict
        (<Verdict.STABLE: 1>, 13.5, <Verdict.UNSTABLE: 2>)
    """
    count = checked_count("postures", postures, 1, 100_000)
    optional("mujoco")
    with _mujoco_warnings() as heard:
        model, assumed = model_of(robot)
        if any("NaN" in words for words in heard):  # which counts as a number that is not given
            raise ValueError(f"{robot} has a number NaN; give finite numbers.")
        _require_finite(model)
        found, robot_at = joints_of(model, count)
    timing = {"rate": rate, "delay": delay, "jitter": jitter, "velocity": velocity}
    control = _control(model, simulated=simulated, **timing)
    given = _checked_gains({} if gains is None else gains, [*found])
    plain = Joint(True, 1.0, 1.0, 0.0, 0.0, 0.0, (1.0, 1.0), None)
    ControlledJoint(control, plain, plain.gains).verdict_at(
        1.0
    )  # refuses timing that no joint can have
    questions = {}
    for name, own in found.items():
        judged = own if name in given else own._replace(reason=own.reason or own.servo)
        questions[name] = ControlledJoint(control, judged, given.get(name, own.gains))
    source = str(robot) if isinstance(robot, str | PathLike) else "a model"
    sampled = f"at {postures} postures, with the other joints free to held; armature included"
    loop = f"{control} ({assumed})" if assumed and simulated else str(control)
    inputs = GainAnswer({"robot": source, "loop": loop, "inertia": sampled})
    answers = {name: _answer(own) for name, own in questions.items()}
    pairs = {name: own.gains for name, own in questions.items() if not own.joint.reason}
    together = _together(robot_at, control, pairs)
    return Joints(inputs, answers, together, questions, robot_at)


def _control(
    model: Any, *, simulated: bool, rate: Any, delay: Any, jitter: Any, velocity: Any
) -> JointControl:
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
    low, high = PERIODS[:2]
    if hertz and not low <= period <= high:
        words = f"usual are {1.0 / high:g} to {1.0 / low:g} Hz; is it a sample time?"
        warnings.warn(f"rate is {hertz:g} Hz, {words}", stacklevel=3)
    if not simulated:
        return JointControl(period, delay, jitter, velocity, step)
    plain = model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    own = mujoco.mjtIntegrator(model.opt.integrator).name[6:]
    rule = "semi-implicit" if own == "EULER" and plain else _RULES.get(own)
    if rule is None or (rule == "rk4" and is_inside) or jitter:
        raise ValueError(
            f"simulated with the integrator {own}{' and jitter' * (jitter > 0.0)} is not "
            "answered; give Euler, implicit or implicitfast (RK4 beside a rate), and no jitter."
        )
    return JointControl(period, delay, jitter, velocity, step, rule, is_inside)


_RULES = {
    "EULER": "implicit-joint",
    "IMPLICIT": "implicit-damping",
    "IMPLICITFAST": "implicit-damping",
    "RK4": "rk4",
}
"""The names of ``Device.simulated`` for MuJoCo's integrators."""


def _checked_gains(gains: Any, names: list[str]) -> dict[str, PD]:
    """Pairs of gains of joints that there are."""
    if not isinstance(gains, Mapping):
        raise TypeError(f"gains is {shortened(gains)}; give kp and kd by the names of joints.")
    checked = dict[str, PD]()
    for name, pair in gains.items():
        if name not in names:
            near = get_close_matches(str(name), names, 1) or names
            raise ValueError(
                f"gains has {shortened(name)}, which is no joint of the robot; give {near[0]}, for "
                "instance."
            )
        if not isinstance(pair, Mapping) or {*pair} != {"kp", "kd"}:
            raise ValueError(f"the gains of {name} are {shortened(pair)}; give kp and kd.")
        for key, gain in pair.items():  # a list of YAML may hold itself, or too much to look at
            if isinstance(gain, list):
                raise TypeError(f"{key} of {name} is {shortened(gain)}; give a real number.")
        kp, kd = (checked_number(f"{key} of {name}", pair[key], 0.0) for key in ("kp", "kd"))
        checked[name] = kp, kd
    return checked


def read_gains(file: str | PathLike[str]) -> Any:
    """The contents of a YAML file, which ``joints`` checks; ValueError if it is not YAML."""
    yaml = optional("yaml")

    class Once(yaml.SafeLoader):  # type: ignore[misc, name-defined]
        """YAML in which keys are texts, such as 1 or on, and none is given twice."""

        def construct_mapping(self, node: Any, deep: bool = False) -> Any:
            names = set[str]()
            for key, _ in node.value:
                if (name := str(key.value)) in names:
                    raise ValueError(f"{file} gives {shortened(name)} twice; give each key once.")
                names.add(name)
                if isinstance(key, yaml.ScalarNode) and not key.tag.endswith(":merge"):
                    key.tag = "tag:yaml.org,2002:str"
            return super().construct_mapping(node, deep)

    # PyYAML takes 1e3, without a point and a sign, for a text.
    number = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+")
    Once.add_implicit_resolver("tag:yaml.org,2002:float", number, [*"-+.0123456789"])
    for kind in ("bool", "float", "int", "timestamp"):
        Once.add_constructor(f"tag:yaml.org,2002:{kind}", _checked_value(Once, kind))
    most = 200_000  # bytes, of 5,000 joints: PyYAML takes seconds for more
    try:
        return yaml.load(text_of(file, most), Once) or []  # an empty file holds no gains
    except RecursionError:
        raise ValueError(f"{file} is nested too deeply; give kp and kd by joints.") from None
    except yaml.reader.ReaderError as error:
        raise ValueError(f"{file} is not YAML: {error.reason}.") from error
    except yaml.MarkedYAMLError as error:
        place = f"line {error.problem_mark.line + 1}, column {error.problem_mark.column + 1}"
        raise ValueError(f"{file}, {place} is not YAML: {error.problem}.") from error


def _checked_value(loader: Any, kind: str) -> Any:
    """Return a constructor of PyYAML that refuses malformed values in the words of its errors."""
    own = loader.yaml_constructors[f"tag:yaml.org,2002:{kind}"]
    error = import_module("yaml").constructor.ConstructorError

    def construct(loader: Any, node: Any) -> Any:
        try:
            return own(loader, node)
        except (AttributeError, LookupError, ValueError) as cause:
            words = f"{shortened(node.value)} is not a value of the type {kind}"
            raise error(None, None, words, node.start_mark) from cause

    return construct


_FORMATS = {
    **formats_of({"kp": "N/m", "kd": "N s/m"}),
    **dict.fromkeys(("kp_growth", "kd_growth"), FORMATS["stiffness_gain"]),
    **dict.fromkeys(("least_inertia", "missing_armature"), Quantity("kg", 4, ROUND_CEILING)),
    "inertia": Quantity("kg", 4),
    "damping": Quantity("N s/m"),
}
_AT_ENDS = "at both ends of its range"
_NO_GAINS = "no gains"
_AT_ONCE = "all joints at once"


@dataclass(frozen=True)
class JointAnswer(Answer):
    """A joint: its inertias, the verdict on its gains, and what is left of them.

    In kg m^2, N m/rad and N m s/rad, of a slide in kg, N/m and N s/m. Growth and extra delay are at
    the longest delay, as a constant one; NaN where not stable.

    Attributes:
        motion: "turns" or "slides".
        inertia: the least over postures with the other joints free, the greatest with them held.
        damping: of the joint.
        friction: of the joint, which the loop leaves out.
        kp, kd: None where there are none.
        verdict: for every inertia; a text where nothing is asked, or nothing holds the position.
        kp_growth, kd_growth: the factor by which one gain may grow alone.
        growth_is: "for every inertia" where growth is proved so, else "at both ends of its range".
        extra_delay: by how many s the delay may be longer at both ends of the range; None in a
            simulation.
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
    inertia: tuple[float, float]
    damping: float
    friction: float
    kp: float | None
    kd: float | None
    verdict: Verdict | str
    kp_growth: float | None = None
    kd_growth: float | None = None
    growth_is: str | None = None
    extra_delay: float | None = None
    least_inertia: float | None = None
    missing_armature: float | None = None

    @property
    def is_stable(self) -> bool:
        """True if the gains are proved stable for every inertia."""
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
        return "none" if isnan(np.sum(value)) else unitless.words(value)

    def _quantity(self, name: str) -> Quantity:
        return _FORMATS.get(name) or super()._quantity(name)

    def _units(self, units: Units) -> Units:
        return Units.ROTATION if self.motion == "turns" else Units.LINE

    def _units_of_keys(self, units: Units) -> dict[str, str]:
        return {}  # each joint has its own


@dataclass(frozen=True)
class Together(Answer):
    """All joints of a robot at once, at sampled postures: computed eigenvalues, not a proof.

    Joints without an answer count as without torque. With more than about 40 joints, or a long
    window, only the postures with the largest gains per inertia are asked.

    Attributes:
        verdict: UNDECIDED also with a delay that varies, unless a constant one is unstable.
        postures: at how many it is computed.
        unstable_postures: at how many of them it is not stable.
        spectral_radius: the largest of all postures: above 1, the growth in one sample.
        mostly_in: the joints whose gains have the largest shares of that motion.
        posture: where that is, by the names of joints, in rad and m.

    Example:
        >>> answer = jaxstab.joints("data/robots/arm.xml", rate=500.0, delay=2e-3)
        >>> found = answer.together
        >>> found.verdict.name, found.postures, found.unstable_postures, found.mostly_in
        ('UNSTABLE', 256, 109, 'elbow')
        >>> found.as_json()["verdict"]
        'unstable'
    """

    verdict: Verdict | str
    postures: int
    unstable_postures: int
    spectral_radius: float
    mostly_in: str
    posture: dict[str, float]

    def _quantity(self, name: str) -> Quantity:
        return Quantity()

    def _units_of_keys(self, units: Units) -> dict[str, str]:
        return {}


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
        >>> answer.all_stable, [row[0] for row in answer.rows()]
        (True, ['joint', 'shoulder', 'elbow', 'all joints at once'])
        >>> answer.as_json()["joints"]["elbow"]["verdict"], answer.as_yaml().count("kp: ")
        ('stable', 2)
    """

    inputs: GainAnswer
    joints: dict[str, JointAnswer]
    together: Together | None
    questions: dict[str, ControlledJoint] = field(repr=False)
    robot: "Postures" = field(repr=False)

    @property
    def all_stable(self) -> bool:
        """True if the gains that are judged are stable, joint by joint and at once; there are some.

        Each joint is proved; all at once are computed at the sampled postures.
        """
        judged = [joint for joint in self.joints.values() if joint.kp_growth is not None]
        return (
            all(joint.is_stable for joint in judged)
            and self.together is not None
            and self.together.verdict in (Verdict.STABLE, BUT_FOR_DRIFT)
        )

    def safe_gains(self) -> dict[str, dict[str, float]]:
        """Gains of which the doubles are stable, too: each joint proved, all at once computed.

        They are the joint's own or the largest of their halves, at the same damping ratio; where it
        has none, or only kp, those from critical damping at 1/T on. If all joints at once are not
        stable at the sampled postures with 2.1 times these gains, all are lowered together. Joints
        without an answer, and without a proof, are left out, as without torque. A delay that varies
        is, for all joints at once, each of its ends as a constant one.

        Example:
            >>> answer = jaxstab.joints("data/robots/arm.xml", rate=500.0, delay=2e-3)
            >>> answer.safe_gains()["elbow"]
            {'kp': 1.768, 'kd': 0.8922}
        """
        asked = {name: own for name, own in self.questions.items() if not own.joint.reason}
        alone = {name: pair for name, own in asked.items() if (pair := _safe(own))}
        for share in 2.0 ** (-0.25 * np.arange(60.0 * bool(alone))):
            pairs = {name: _rounded(share**2 * kp, share * kd) for name, (kp, kd) in alone.items()}
            are_proved = (_is_safe(asked[name], pair) for name, pair in pairs.items())
            if self._are_safe_together(pairs) and all(are_proved):
                return {name: {"kp": pair[0], "kd": pair[1]} for name, pair in pairs.items()}
        return {}

    def _are_safe_together(self, pairs: Mapping[str, PD]) -> bool:
        """True if the robot is stable at all postures with these gains, their doubles and more."""
        loops = self.robot.loops(self._control, pairs)
        grown = [loop.grown(factor) for factor in (2.1, 2.0, 1.0) for loop in loops]
        return all(
            verdict_of(loop.radius(self.robot.masses[place])) == Verdict.STABLE
            for loop in grown
            for place in self.robot.lightest(loop)
        )

    def as_yaml(self) -> str:
        """The safe gains as a YAML file."""
        head = (
            f"# {self.inputs.values['loop']}\n"
            "# The doubles of these gains are stable, too: for each joint alone this is proved,\n"
            "# for all joints at once it is computed at sampled postures.\n"
        )
        return head + str(optional("yaml").safe_dump(self.safe_gains(), sort_keys=False))

    def rows(self) -> list[list[Any]]:
        """All values for a CSV file: a row for each joint, and one for all at once."""
        answers = self.joints | ({_AT_ONCE: self.together} if self.together else {})
        tables = {
            name: {path: own for path, own, _ in each.leaves() if "." not in path}
            for name, each in answers.items()
        }
        columns = list(dict.fromkeys(name for table in tables.values() for name in table))
        rows = ([name, *map(own.get, columns)] for name, own in tables.items())
        return [["joint", *columns], *rows]

    def __str__(self) -> str:
        answers = self.joints.values()
        given = {name for own in answers for (name,), _ in own._entries()} - {"growth_is"}
        names = [each.name for each in fields(JointAnswer) if each.name in given]
        at_ends = ["extra delay"] * ("extra_delay" in given)
        at_ends += [f"growth of {x}" for x, own in self.joints.items() if own.growth_is == _AT_ENDS]
        rows = [[name, *map(own._cell, names)] for name, own in self.joints.items()]
        robot, loop, sampled = self.inputs.values.values()
        notes = []
        if "kp_growth" in given:
            notes = ["Stable, growth: proved for every inertia of the range, one joint at a time."]
        elif any(own.verdict == _NO_GAINS for own in answers):
            notes = ["Give kp and kd by joints (--gains FILE); --safe-gains FILE writes safe ones."]
        return "\n".join(
            [
                f"{robot}: {loop}",
                table_text([["joint", *(name.replace("_", " ") for name in names)], *rows]),
                "Turning in kg m^2, N m/rad, N m s/rad and N m, sliding in kg, N/m, N s/m and N.",
                f"Inertia: sampled {sampled}.",
                *notes,
                *([f"Of both ends of the range alone: {', '.join(at_ends)}."] if at_ends else []),
                *([self._together_in_words(self.together)] if self.together else []),
            ]
        )

    def _together_in_words(self, found: Together) -> str:
        control, sampled = self._control, f"{len(self.robot.masses)} postures"
        if found.postures < len(self.robot.masses):
            sampled = f"the {found.postures} lightest of {sampled}"
        words = in_words(found.verdict)
        if found.verdict == Verdict.UNSTABLE:
            growth = Quantity(digits=5).words(found.spectral_radius)
            words += f" at {found.unstable_postures}, growing by {growth} a "
            words += f"{'step' if control.is_inside else 'sample'}, mostly in {found.mostly_in}"
        elif control.jitter:
            words += ", as the delay varies"
        return f"All joints at once, computed at {sampled}: {words}."

    @property
    def _control(self) -> JointControl:
        return next(iter(self.questions.values())).control

    def _values(self) -> Mapping[str, Any]:
        return {"inputs": self.inputs, "joints": self.joints, "together": self.together}


def _answer(question: ControlledJoint) -> JointAnswer:
    joint, has_gains = question.joint, any(question.gains)
    motion, inertia = "turns" if joint.turns else "slides", (joint.least, joint.greatest)
    kp, kd = question.gains if has_gains else (None, None)
    words = joint.reason or _NO_GAINS
    answer = JointAnswer(motion, inertia, joint.damping, joint.friction, kp, kd, words)
    if joint.reason or not has_gains:
        return answer
    try:
        code, least = question.verdict(), question.least_inertia()
        is_stable = code == Verdict.STABLE
        *growth, later, is_proved = question.spare() if is_stable else (nan, nan, nan, False)
    except ValueError as error:  # of numbers that are too large or small to compute with
        return replace(answer, verdict=str(error), kp_growth=nan)
    words = "for every inertia" if is_proved else _AT_ENDS
    return replace(
        answer,
        verdict=BUT_FOR_DRIFT if is_stable and question.drifts else code,
        kp_growth=growth[0],
        kd_growth=growth[1],
        growth_is=words if is_stable else None,
        extra_delay=None if question.control.rule else later,
        least_inertia=least,
        missing_armature=max(least - joint.least, 0.0) if isfinite(least) else nan,
    )


def _safe(question: ControlledJoint) -> PD | None:
    """Gains of which the doubles are stable, too: the first of a sequence of halves."""
    joint, period = question.joint, question.control.sample_time
    critical = joint.least / period**2, 2.0 * joint.least / period
    for kp, kd in filter(any, (question.gains, critical)):
        for share in 0.5 ** np.arange(60.0):
            pair = _rounded(share * kp, share**0.5 * kd)
            if _is_safe(question, pair):
                return pair
    return None


def _is_safe(question: ControlledJoint, pair: PD) -> bool:
    """True if two gains and their doubles are proved stable."""
    tried = (replace(question, gains=(n * pair[0], n * pair[1])) for n in (2.0, 1.0))
    with suppress(ValueError):  # of numbers that are too large to compute with
        return all(each.verdict() == Verdict.STABLE for each in tried)
    return False


def _rounded(kp: float, kd: float) -> PD:
    """Gains as they are written."""
    return float(rounded_text(kp, 4)), float(rounded_text(kd, 4))


# All joints at once.


@dataclass(frozen=True)
class Postures:
    """A robot at sampled postures.

    Attributes:
        masses: mass matrices, (posture, n, n).
        places: positions, (posture, n), of degrees of freedom that joints have alone.
        dofs: their numbers by the names of joints.
        damping, spring: of each degree of freedom, (n,).
    """

    masses: np.ndarray
    places: np.ndarray
    dofs: dict[str, int]
    damping: np.ndarray
    spring: np.ndarray

    def loops(self, control: JointControl, pairs: Mapping[str, PD]) -> list[ControlledRobot]:
        """The loop under gains by the names of joints: at its delay, or both ends of it."""
        kp, kd = np.zeros_like(self.damping), np.zeros_like(self.damping)
        for name, pair in pairs.items():
            kp[self.dofs[name]], kd[self.dofs[name]] = pair
        ends = [control, *([control._replace(jitter=0.0)] if control.jitter else [])]
        return [ControlledRobot(end, self.damping, self.spring, kp, kd) for end in ends]

    def lightest(self, loop: ControlledRobot) -> list[int]:
        """The postures that are asked: those with the largest gains for the inertia first."""
        size = len(loop.one_period(self.masses[0]))
        order = np.argsort([-loop.lightness(mass) for mass in self.masses], kind="stable")
        return [*order[: max(_FEWEST, int(_MOST_WORK / size**3))].tolist()]


_MOST_WORK = 1e9  # states cubed, about 5 s
_FEWEST = 8
_MOSTLY = 0.75  # of a motion, in the joints that are named


def _together(robot: Postures, control: JointControl, pairs: Mapping[str, PD]) -> Together | None:
    """The answer for all joints that have gains; None if there are none."""
    if not any(map(any, pairs.values())):
        return None
    loops = robot.loops(control, pairs)
    places = robot.lightest(loops[0])
    radii = np.array([[loop.radius(robot.masses[place]) for place in places] for loop in loops])
    late, worst = np.unravel_index(np.argmax(radii), radii.shape)  # of NaN the first one
    codes = [verdict_of(radius) for radius in np.max(radii, axis=0).tolist()]
    verdict: Verdict | str = Verdict.STABLE
    if control.jitter or Verdict.UNDECIDED in codes:
        verdict = Verdict.UNDECIDED
    elif any(loops[0].drifts):
        verdict = BUT_FOR_DRIFT
    verdict = Verdict.UNSTABLE if Verdict.UNSTABLE in codes else verdict
    shares = loops[late].shares(robot.masses[places[worst]])
    order = sorted(pairs, key=lambda name: -shares[robot.dofs[name]])
    covered = np.cumsum([shares[robot.dofs[name]] for name in order])
    mostly = order[: 1 + int(np.searchsorted(covered, _MOSTLY))]
    return Together(
        verdict,
        len(places),
        codes.count(Verdict.UNSTABLE),
        float(radii[late, worst]),
        ", ".join(mostly),
        {name: float(robot.places[places[worst], dof]) for name, dof in robot.dofs.items()},
    )


# Robot files, as MuJoCo reads them.


@contextmanager
def _mujoco_warnings() -> Iterator[list[str]]:
    """Pass MuJoCo's warnings on to Python; by default they go to MUJOCO_LOG.TXT in this folder."""
    former, heard = mujoco.get_mju_user_warning(), list[str]()
    mujoco.set_mju_user_warning(heard.append)
    try:
        yield heard
    finally:
        mujoco.set_mju_user_warning(former)
    for words in dict.fromkeys(heard):
        warnings.warn(f"MuJoCo: {words}", stacklevel=4)


def model_of(robot: Any) -> tuple[Any, str]:
    """The model of a file, or a copy of one, and which options of MuJoCo are assumed.

    Of URDF neither shapes nor meshes are read.
    """
    if isinstance(robot, mujoco.MjModel):
        return copy(robot), ""
    if not isinstance(robot, str | PathLike):
        raise TypeError(f"robot is {shortened(robot)}; give a file name or a mujoco.MjModel.")
    try:
        root = ElementTree.fromstring(text_of(robot, MOST_BYTES))
        if root.tag != "robot" and os.path.isfile(robot):  # a pipe is read once
            return mujoco.MjModel.from_xml_path(str(robot)), ""
        for link in root.iter("link"):
            for shape in [*link.findall("visual"), *link.findall("collision")]:
                link.remove(shape)
        model = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
    except (ElementTree.ParseError, ValueError) as error:
        words = " ".join(str(error).split()).rstrip(".")
        raise ValueError(f"MuJoCo reads no robot from {robot}: {words}.") from error
    given = {name for option in root.findall("mujoco/option") for name in option.attrib}
    needed = ("timestep", "integrator") if root.tag == "robot" else ()
    missing = [name for name in needed if name not in given]
    return model, f"assumed: the file has no {' and no '.join(missing)}" if missing else ""


def _require_finite(model: Any) -> None:
    """Refuse numbers that are not finite, but for the limits of forces."""
    numbers = {name: getattr(model, name) for name in dir(model)} | {"timestep": model.opt.timestep}
    names = []
    for name, values in numbers.items():
        if isinstance(values, np.ndarray | float):
            may_be_infinite = name.endswith("range") and name != "jnt_range"
            is_finite = np.isfinite(values) | (may_be_infinite & np.isinf(values))
            names += [] if np.all(is_finite) else [name]
    if names:
        raise ValueError(
            f"the robot has numbers that are not finite, in {', '.join(names)}; give finite ones."
        )


def optional(name: str) -> Any:
    """A package of the extra ``robots``; RuntimeError without it."""
    try:
        return import_module(name)
    except ImportError as error:
        raise RuntimeError(
            f"robot files need the package {name}: python -m pip install 'jaxstab[robots]'."
        ) from error


def joints_of(model: Any, postures: int) -> tuple[dict[str, Joint], Postures]:
    """The joints by their names, with their inertias over postures, and the robot there."""
    (least, greatest), masses, places = _inertias(model, postures)
    reasons, servos, joints = _reasons(model), _other_servos(model), dict[str, Joint]()
    no_springs, no_dampers = (_is_off(model, name) for name in ("SPRING", "DAMPER"))
    for index, (name, kind) in enumerate(zip(_names(model), model.jnt_type.tolist(), strict=True)):
        place = model.jnt_dofadr[index]
        (kp, kd), damping = _actuators(model, index)
        negative = f"its actuators have kp = {kp:g} and kd = {kd:g}; give gains of 0 or more"
        joints[name] = Joint(
            kind != mujoco.mjtJoint.mjJNT_SLIDE,
            float(least[place]),
            float(greatest[place]),
            0.0 if no_dampers else float(model.dof_damping[place]) + damping,
            0.0 if no_springs else float(model.jnt_stiffness[index]),
            float(model.dof_frictionloss[place]),
            (kp, kd),
            reasons.get(index),
            servos.get(index) or (negative if min(kp, kd) < 0.0 else None),
        )
    kinds = mujoco.mjtJoint
    is_one = np.isin(model.jnt_type, [int(kinds.mjJNT_HINGE), int(kinds.mjJNT_SLIDE)])
    named = dict(zip(joints, model.jnt_dofadr.tolist(), strict=True))
    dofs = {name: named[name] for name, one in zip(named, is_one.tolist(), strict=True) if one}
    damping, spring = model.dof_damping * (not no_dampers), np.zeros(model.nv)
    damping[[*dofs.values()]] = [joints[name].damping for name in dofs]
    spring[[*dofs.values()]] = [joints[name].spring for name in dofs]
    at = np.zeros((len(places), model.nv))
    at[:, [*dofs.values()]] = places[:, model.jnt_qposadr[is_one]]
    return joints, Postures(masses, at, dofs, damping, spring)


def _names(model: Any) -> list[str]:
    """The names of the joints; the number of one without, in a name that no other one has."""
    given = [model.joint(index).name for index in range(model.njnt)]
    names = []
    for index, own in enumerate(given):
        name = own or f"joint {index}"
        while not own and name in given:
            name += " (no name)"
        names.append(name)
    return names


def _is_off(model: Any, part: str) -> bool:
    """True if the file disables a part of the simulation; old versions know PASSIVE alone."""
    bits = mujoco.mjtDisableBit
    part = "PASSIVE" if hasattr(bits, "mjDSBL_PASSIVE") and part in ("SPRING", "DAMPER") else part
    return bool(model.opt.disableflags & int(getattr(bits, f"mjDSBL_{part}")))


def _acting(model: Any) -> np.ndarray:
    """True for actuators that the file does not disable, all of them or by their group."""
    off, groups = model.opt.disableactuator, model.actuator_group
    in_group = (groups >= 0) & (groups < 31) & (off >> np.clip(groups, 0, 30) & 1 > 0)
    return ~in_group & (not _is_off(model, "ACTUATION"))


def _actuators(model: Any, joint: int) -> tuple[PD, float]:
    """The gains of the position and velocity actuators of a joint, and the damping they add."""
    own = _at_joints(model) & (model.actuator_trnid[:, 0] == joint)
    has_bias = np.equal(model.actuator_biastype, int(mujoco.mjtBias.mjBIAS_AFFINE))
    gear = own * model.actuator_gear[:, 0] ** 2  # of the angle, and of the torque
    # New versions have damping, that of disabled actuators acts, too.
    damping = gear @ getattr(model, "actuator_damping", np.zeros(len(own)))
    kp, kd = -(gear * has_bias * _acting(model)) @ model.actuator_biasprm[:, 1:3]
    return (float(kp) + 0.0, float(kd) + 0.0), float(damping)


def _at_joints(model: Any) -> np.ndarray:
    places = mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT
    return np.isin(model.actuator_trntype, [*map(int, places)])


def _other_servos(model: Any) -> dict[int, str]:
    """Joints that an actuator moves by another law than kp and kd of their own angle, and which."""
    ways, at_joint, found = mujoco.mjtTrn, _at_joints(model), dict[int, str]()
    for index in np.flatnonzero(_acting(model)).tolist():
        way, ends = ways(model.actuator_trntype[index]), model.actuator_trnid[index].tolist()
        is_pd, moved = _is_pd(model, index), set[int]()
        if at_joint[index] and not is_pd:
            moved = {ends[0]}
        elif way in (ways.mjTRN_SITE, ways.mjTRN_SLIDERCRANK):
            is_motor = is_pd and not np.any(model.actuator_biasprm[index, 1:3])
            for body in model.site_bodyid[[end for end in ends if end >= 0 and not is_motor]]:
                moved ^= _above(model, int(body))
        name = model.actuator(index).name or index
        words = f"actuator {name} has another law than kp and kd of this joint; give its gains"
        found |= dict.fromkeys(moved, words)
    return found


def _is_pd(model: Any, actuator: int) -> bool:
    """True if its force is kp and kd times its own length and speed, and what it is commanded."""
    bias = mujoco.mjtBias(model.actuator_biastype[actuator]).name
    kind = mujoco.mjtGain(model.actuator_gaintype[actuator]).name
    gain, *slopes = model.actuator_gainprm[actuator, :3]
    has_gain = {
        "mjGAIN_FIXED": True,
        "mjGAIN_AFFINE": not any(slopes),  # else commands change the stiffness
        "mjGAIN_PID": gain == 0.0,  # of the integral
    }
    is_linear = bias in ("mjBIAS_NONE", "mjBIAS_AFFINE") and has_gain.get(kind, False)
    return bool(is_linear and model.actuator_plugin[actuator] < 0)


def _curve(model: Any, name: str, index: int) -> bool:
    """True if a spring or damper has coefficients beyond the linear one, as in new versions."""
    return bool(np.any(getattr(model, f"{name}poly", np.zeros((index + 1, 1)))[index]))


def _reasons(model: Any) -> dict[int, str]:
    """Why joints are not answered for: several of them, or several axes, move together."""
    kinds, ways, along = mujoco.mjtJoint, mujoco.mjtEq, _along_tendons(model)
    reasons = dict[int, str]()
    for index, place in enumerate(model.jnt_dofadr.tolist()):
        if _curve(model, "jnt_stiffness", index) or _curve(model, "dof_damping", place):
            reasons[index] = "its spring or damper is not linear"
    # The damping of an actuator acts, even if the file disables the actuator.
    count = len(model.actuator_trntype)  # model.nu is that of their inputs
    damping = getattr(model, "actuator_damping", np.zeros(count))
    has_curve = np.array([_curve(model, "actuator_damping", k) for k in range(count)], bool)
    for index in model.actuator_trnid[_at_joints(model) & has_curve, 0].tolist():
        reasons[index] = "its spring or damper is not linear"
    at_tendon = model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_TENDON)
    acts = _acting(model) | (damping != 0.0) | has_curve
    driven = model.actuator_trnid[at_tendon & acts, 0]
    for index in range(model.ntendon):
        held = model.tendon_stiffness[index] or model.tendon_damping[index]
        curves = (_curve(model, f"tendon_{part}", index) for part in ("stiffness", "damping"))
        if index in driven or held or any(curves):
            words = f"tendon {model.tendon(index).name or index} moves it with other joints"
            reasons |= dict.fromkeys(along[index], words)
    for index in np.flatnonzero(model.eq_active0 * (not _is_off(model, "EQUALITY"))).tolist():
        kind, pair = int(model.eq_type[index]), (model.eq_obj1id[index], model.eq_obj2id[index])
        ends, words = [end for end in map(int, pair) if end >= 0], "ties it to another joint"
        tied = {*ends} if kind == ways.mjEQ_JOINT else set[int]()
        words = "holds it at a place" if len(tied) == 1 else words
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
    data, near = mujoco.MjData(model), 1e-4
    here, lengths = _posture(model, np.random.default_rng(_SEED)), list[np.ndarray]()
    for place in (0, *model.jnt_qposadr.tolist()):
        data.qpos[:] = here
        data.qpos[place] += near if lengths else 0.0
        mujoco.mj_fwdPosition(model, data)
        lengths.append(data.ten_length.copy())
    changes = np.abs(np.array(lengths[1:]) - lengths[0]) > 1e-6 * near
    return [{*np.flatnonzero(changed).tolist()} for changed in changes.T]


def _inertias(
    model: Any, postures: int
) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray, np.ndarray]:
    """The least 1/(M^-1)_ii and the greatest M_ii over postures, the file's own among them.

    With them come the mass matrices and the positions of as many postures as memory has room for.
    """
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data, rng, units = mujoco.MjData(model), np.random.default_rng(_SEED), np.eye(model.nv)
    mass, (least, greatest) = np.zeros_like(units), (np.full(model.nv, inf), np.zeros(model.nv))
    room = min(postures, 1 + int(_MOST_NUMBERS / max(mass.size, 1)))
    masses, places = np.empty((room, *mass.shape)), np.empty((room, model.nq))
    for number in range(postures):
        data.qpos[:] = _posture(model, rng) if number else model.qpos0
        mujoco.mj_fwdPosition(model, data)
        for row, unit in zip(mass, units, strict=True):
            mujoco.mj_mulM(model, data, row, unit)
        try:
            with np.errstate(all="ignore"):  # infinite, which is refused below
                least = np.minimum(least, 1.0 / np.diag(np.linalg.inv(mass)))
        except np.linalg.LinAlgError:  # some motion has no inertia, which is refused below
            least[:] = 0.0
        greatest = np.maximum(greatest, np.diag(mass))
        if number < room:
            masses[number], places[number] = mass, data.qpos
    if not (model.nv and np.all((least > 0.0) & np.isfinite(greatest))):
        raise ValueError(
            "the robot has no joint, or its mass matrix is not positive; give one that moves, with "
            "masses and inertias of all bodies."
        )
    return (np.minimum(least, greatest), greatest), masses, places


def _posture(model: Any, rng: np.random.Generator) -> np.ndarray:
    """Joints anywhere in their ranges, hinges without one anywhere in a turn."""
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
