"""The joints of robot files: inertias in closed form, and verdicts against MuJoCo itself."""

import csv
import json
import math
import os
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaign import first, many
from commands import assert_one_sentence, run

import jaxstab
from jaxstab import Verdict
from jaxstab.results import JointAnswer, Joints
from tests.truth.problems import LEAST_INERTIAS

mujoco = pytest.importorskip("mujoco")

RULES = {  # of jaxstab; MuJoCo's integrator, and whether it takes joint damping as implicit
    "semi-implicit": ("Euler", "disable"),
    "implicit-joint": ("Euler", "enable"),
    "implicit-damping": ("implicitfast", "enable"),
}
ARM = """
<mujoco>
  <option timestep="{step!r}" integrator="{integrator}" gravity="0 0 0">
    <flag autoreset="disable" eulerdamp="{eulerdamp}" contact="disable"/>
  </option>
  <worldbody>
    <body>
      <joint name="shoulder" axis="0 1 0" armature="{shoulder!r}" damping="{damping!r}"
             stiffness="{spring!r}"/>
      <inertial pos="0.15 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
      <body pos="0.3 0 0">
        <joint name="elbow" axis="0 1 0" armature="{elbow!r}" damping="{slack!r}" range="-150 150"
               stiffness="{elbow_spring!r}"/>
        <inertial pos="0.1 0 0" mass="0.5" diaginertia="0.005 0.005 0.005"/>
      </body>
    </body>
  </worldbody>
  <actuator>{actuators}</actuator>
</mujoco>
"""
HUGE = 1e9  # kg m^2, an armature that holds a joint
START = 1e-6  # rad


def arm(**given: Any) -> Any:
    """A planar arm of two links, whose mass matrix is known in closed form."""
    plain = {"step": 1e-3, "integrator": "Euler", "eulerdamp": "enable", "actuators": ""}
    plain |= {"shoulder": 0.01, "elbow": 0.002, "damping": 0.0, "slack": 0.0}
    plain |= {"spring": 0.0, "elbow_spring": 0.0}
    return mujoco.MjModel.from_xml_string(ARM.format(**plain | given))


def mass_matrix(elbow: float, armatures: tuple[float, float] = (0.01, 0.002)) -> np.ndarray:
    """That of the arm, from its kinetic energy."""
    second = 0.005 + 0.5 * 0.1**2
    cross = 0.5 * 0.3 * 0.1 * np.cos(elbow)
    first = 0.01 + 1.0 * 0.15**2 + 0.5 * 0.3**2 + second + 2.0 * cross
    return np.array(
        [[first + armatures[0], second + cross], [second + cross, second + armatures[1]]]
    )


def test_inertias_are_those_of_the_mass_matrix_over_postures() -> None:
    answer = jaxstab.joints(arm(), rate=500.0, postures=5000).joints
    matrices = [mass_matrix(angle) for angle in np.radians(np.linspace(-150.0, 150.0, 3001))]
    for index, joint in enumerate(answer.values()):
        free = min(1.0 / np.linalg.inv(matrix)[index, index] for matrix in matrices)
        held = max(matrix[index, index] for matrix in matrices)
        assert joint.inertia[0] == pytest.approx(free, rel=1e-3)
        assert joint.inertia[1] == pytest.approx(held, rel=1e-3)
        assert joint.inertia[0] >= free * (1.0 - 1e-6)
        assert joint.inertia[1] <= held * (1.0 + 1e-6)


@pytest.mark.parametrize(("delay", "gains", "least"), LEAST_INERTIAS)
def test_the_least_inertia_is_the_known_one(
    delay: float, gains: tuple[float, float], least: float
) -> None:
    given = {"elbow": dict(zip(("kp", "kd"), gains, strict=True))}
    plain = jaxstab.joints(arm(), rate=500.0, delay=delay, gains=given).joints["elbow"]
    assert plain.least_inertia == pytest.approx(least, abs=1e-10)
    # A damping of nearly nothing takes the other way: boxes, and verdicts on both sides.
    damped = jaxstab.joints(arm(slack=1e-9), rate=500.0, delay=delay, gains=given).joints["elbow"]
    assert damped.least_inertia == pytest.approx(least, rel=1e-6)
    assert plain.verdict == damped.verdict


def settles(model: Any, joint: str, step_torque: Any = None) -> bool | None:
    """True if a joint comes to rest; None: neither in time."""
    data = mujoco.MjData(model)
    place = model.joint(joint).qposadr[0]
    data.qpos[place] = START
    for count in range(400_000):
        if step_torque:
            step_torque(data, count)
        mujoco.mj_step(model, data)
        if count % 500 == 499:
            size = max(abs(data.qpos[place]), abs(data.qvel[place]) * model.opt.timestep)
            if not size < 1e3 * START:
                return False
            if size < 1e-3 * START:
                return True
    return None


class Case:
    """A joint of the arm under random gains, with others free or held, in one kind of loop."""

    def __init__(self, rng: np.random.Generator, kind: str) -> None:
        self.kind = kind
        self.joint = str(rng.choice(["shoulder", "elbow"]))
        self.other = "elbow" if self.joint == "shoulder" else "shoulder"
        self.holds = bool(rng.integers(2))
        self.step = float(10 ** rng.uniform(-3.3, -2.5))
        self.substeps, self.late = 1, 0
        frequency, least_kp = 1.0 / self.step, 0.3
        if kind in ("held", "outside"):
            self.substeps, self.late = int(rng.integers(1, 5)), int(rng.integers(0, 7))
            frequency, least_kp = 0.25 / (self.step * (self.substeps + self.late)), 0.1
        kp, kd = rng.uniform(least_kp, 1.0), rng.uniform(0.05, 0.15)
        self.gains = float(kp * frequency**2), float(kd * frequency)
        if kind in ("held", "outside"):
            self.gains = self.gains[0], 6.0 * self.gains[1]
        self.damping = float(0.1 * self.gains[1]) if rng.integers(2) else 0.0
        self.spring = float(0.1 * self.gains[0]) if rng.integers(2) else 0.0
        rules = ["semi-implicit", "implicit-joint"]
        self.rule = str(rng.choice(rules)) if kind == "outside" else kind
        # The least inertia grows in proportion to gains, damping and spring.
        plain = self.asked(self.model(0.0, self.actuators()))
        share = rng.uniform(1.5, 3.0) * plain.inertia[0] / plain.least_inertia
        self.gains = self.gains[0] * share, self.gains[1] * share
        self.damping, self.spring = self.damping * share, self.spring * share

    def model(self, armature: float, actuators: str) -> Any:
        """The arm with an armature of the joint; the other one is held by a huge armature."""
        integrator, damp = ("RK4", "enable") if self.kind == "held" else RULES[self.rule]
        armatures = {self.joint: armature, self.other: HUGE if self.holds else 0.01}
        names = ("damping", "spring") if self.joint == "shoulder" else ("slack", "elbow_spring")
        damping = dict(zip(names, (self.damping, self.spring), strict=True))
        options = {"step": self.step, "integrator": integrator, "eulerdamp": damp}
        return arm(**options, **armatures, **damping, actuators=actuators)

    def asked(self, model: Any) -> JointAnswer:
        """What is answered at the posture of the file alone."""
        timing: dict[str, Any] = {"simulated": self.kind != "held"}
        if self.kind in ("held", "outside"):
            timing |= {
                "rate": 1.0 / (self.substeps * self.step),
                "delay": self.late * self.step,
                "gains": {self.joint: {"kp": self.gains[0], "kd": self.gains[1]}},
            }
        return jaxstab.joints(model, **timing, postures=1).joints[self.joint]

    def actuators(self) -> str:
        if self.kind in RULES:
            kp, kd = self.gains
            return f'<position joint="{self.joint}" kp="{kp!r}" kv="{kd!r}"/>'
        return f'<motor joint="{self.joint}"/>'

    def settles(self, model: Any) -> bool | None:
        """True if MuJoCo brings it to rest: with its own actuator, or under torques of samples."""
        if self.kind in RULES:
            return settles(model, self.joint)
        place, (kp, kd) = model.joint(self.joint).qposadr[0], self.gains
        late, before = [0.0] * (self.late + 1), [START]

        def apply(data: Any, count: int) -> None:
            if count % self.substeps == 0:
                here = float(data.qpos[place])
                speed = (here - before[0]) / (self.substeps * self.step)
                if self.kind == "outside":
                    speed = float(data.qvel[place])
                before[0] = here
                late[self.late :] = [-kp * here - kd * speed] * self.substeps
            data.ctrl[0] = late.pop(0)

        return settles(model, self.joint, apply)


def disagreements(kind: str, count: int) -> tuple[int, list[str]]:
    """Armatures that give a joint 0.98 and 1.02 of the least inertia, and what MuJoCo does."""
    rng, decided, wrong = np.random.default_rng([55, *kind.encode()]), 0, []
    for _ in range(count):
        case = Case(rng, kind)
        plain = case.asked(case.model(0.0, case.actuators()))
        least = plain.least_inertia
        own = plain.inertia[0]  # free, or held: the other one then hardly moves
        assert least > own
        for side in (0.98, 1.02):
            model = case.model(side * least - own, case.actuators())
            answer = case.asked(model)
            assert answer.inertia[0] == pytest.approx(side * least, rel=1e-6)
            settled = case.settles(model)
            expected = side > 1.0
            assert answer.verdict == (Verdict.STABLE if expected else Verdict.UNSTABLE)
            if settled is not None:
                decided += 1
                if settled != expected:
                    wrong.append(f"{vars(case)} {side} {settled}")
    return decided, wrong


KINDS = ["held", "outside", *RULES]


@pytest.mark.parametrize("kind", first(KINDS[1:], 2))
def test_mujoco_settles_above_the_least_inertia_and_not_below(kind: str) -> None:
    decided, wrong = disagreements(kind, 3)
    assert not wrong
    assert decided >= 5


@pytest.mark.campaign
@pytest.mark.parametrize("kind", KINDS)
def test_many_joints_of_mujoco_agree_with_their_least_inertia(kind: str) -> None:
    decided, wrong = disagreements(kind, count := many(50, 3))
    assert not wrong
    assert decided >= 1.8 * count


# ------------------------------------------------------------------------------- what files contain
TANGLED = """
<mujoco>
  <worldbody>
    <body>
      <freejoint name="base"/><geom size="0.1"/>
      <body pos="0.2 0 0"><joint name="ball" type="ball"/><geom size="0.05"/></body>
      <body pos="0 0.2 0"><joint name="plain"/><geom size="0.05" pos="0.1 0 0"/></body>
      <body pos="0 0 0.2"><joint name="lead"/><geom size="0.05" pos="0.1 0 0"/></body>
      <body pos="0 0 0.4"><joint name="mimic"/><geom size="0.05" pos="0.1 0 0"/></body>
      <body pos="0 0 0.6"><joint name="pulled"/><geom size="0.05" pos="0.1 0 0"/></body>
      <body pos="0 0 0.8"><joint name="pushed"/><geom size="0.05" pos="0.1 0 0"/></body>
      <body pos="0.5 0 0">
        <joint name="upper"/><geom size="0.05" pos="0.1 0 0"/>
        <body name="left" pos="0.2 0 0"><joint name="left"/><geom size="0.05" pos="0.1 0 0"/></body>
        <body name="right" pos="0.2 0.1 0">
          <joint name="right"/><geom size="0.05" pos="0.1 0 0"/>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon><fixed name="cable"><joint joint="pulled" coef="1"/><joint joint="pushed" coef="-1"/>
  </fixed></tendon>
  <equality>
    <connect name="loop" body1="left" body2="right" anchor="0.2 0 0"/>
    <joint name="same" joint1="lead" joint2="mimic"/>
    <joint name="off" joint1="plain" joint2="upper" active="false"/>
  </equality>
  <actuator>
    <position joint="plain" kp="3" kv="0.2" gear="2"/>
    <velocity joint="upper" kv="0.3"/>
    <position tendon="cable" kp="5"/>
  </actuator>
</mujoco>
"""


def test_every_joint_is_answered_or_has_its_reason() -> None:
    model = mujoco.MjModel.from_xml_string(TANGLED)
    answer = jaxstab.joints(model, rate=1000.0, delay=1e-3)
    verdicts = {name: joint.verdict for name, joint in answer.joints.items()}
    assert verdicts == {
        "base": "it moves freely",
        "ball": "a ball, of three axes",
        "plain": Verdict.STABLE,
        "lead": "equality same ties it to another joint",
        "mimic": "equality same ties it to another joint",
        "pulled": "tendon cable moves it with other joints",
        "pushed": "tendon cable moves it with other joints",
        "upper": "stable but for the position, which nothing holds",
        "left": "equality loop closes a chain that it is in",
        "right": "equality loop closes a chain that it is in",
    }
    assert (answer.joints["plain"].kp, answer.joints["plain"].kd) == (12.0, 0.8)  # gear squared
    assert answer.all_stable
    assert {*answer.safe_gains()} == {"plain", "upper"}


BAR = """
<mujoco>
  <option timestep="0.00173" gravity="0 0 0" {options}>{flags}</option>
  <worldbody>
    <body>
      <joint name="bar" axis="0 0 1" {joint}/><site name="tip" pos="0.1 0 0"/>
      <inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
    </body>
    <site name="world" pos="0.1 0 0"/>
  </worldbody>
  <actuator>{actuators}</actuator>
</mujoco>
"""
PD = '<position joint="bar" kp="100" kv="1"/>'
OFF = '<motor joint="bar" gear="3" damping="8" group="3"/>'


def bar(actuators: str = PD, flags: str = "", joint: str = "", options: str = "") -> Any:
    text = BAR.format(actuators=actuators, flags=flags, joint=joint, options=options)
    return mujoco.MjModel.from_xml_string(text)


def radius_in_mujoco(model: Any) -> float:
    """The spectral radius of the engine's own step, by finite differences of it."""
    data, n = mujoco.MjData(model), 2 * model.nv + model.na
    step = np.zeros((n, n))
    mujoco.mjd_transitionFD(model, data, 1e-6, True, step, None, None, None)
    return float(np.max(np.abs(np.linalg.eigvals(step))))


@pytest.mark.parametrize(
    ("model", "words"),
    [
        (bar('<pid joint="bar" kp="100" ki="1e4" kv="1"/>'), "actuator 0 has another law"),
        (bar('<dcmotor joint="bar" motorconst="1 1" resistance="1"/>'), "actuator 0 has"),
        (bar('<muscle joint="bar" lengthrange="0 1"/>'), "actuator 0 has another law"),
        (bar(PD + '<damper name="oil" joint="bar" kv="1" ctrlrange="0 1"/>'), "actuator oil has"),
        (
            bar(PD + '<position site="tip" refsite="world" kp="3e6" gear="0 1 0 0 0 0"/>'),
            "actuator 1 has another law",
        ),
        (bar(PD + '<velocity site="tip" kv="3e3" gear="0 1 0 0 0 0"/>'), "actuator 1 has"),
        (
            bar(PD + '<position cranksite="tip" slidersite="world" cranklength="0.2" kp="1e3"/>'),
            "actuator 1 has another law",
        ),
        (
            bar('<general joint="bar" biastype="affine" biasprm="0 -100 0.5"/>'),
            "kp = 100 and kd = -0.5; give gains of 0 or more",
        ),
        (bar(joint='stiffness="10 5 50000"'), "its spring or damper is not linear"),
        (bar(joint='damping="1 2 3"'), "its spring or damper is not linear"),
        (
            bar(PD + OFF.replace('"8"', '"8 1 2"'), options='actuatorgroupdisable="3"'),
            "its spring or damper is not linear",
        ),
    ],
)
def test_a_joint_under_another_law_than_pd_has_its_reason(model: Any, words: str) -> None:
    answer = jaxstab.joints(model, simulated=True)
    assert words in str(answer.joints["bar"].verdict)
    assert not answer.all_stable
    assert not answer.safe_gains()
    given = jaxstab.joints(model, simulated=True, gains={"bar": {"kp": 100.0, "kd": 1.0}})
    reason = str(given.joints["bar"].verdict)
    assert given.joints["bar"].is_stable or "not linear" in reason  # given gains replace a servo


SPRING = 'damping="2" stiffness="500"'


@pytest.mark.parametrize("integrator", ["Euler", "implicit", "implicitfast"])
@pytest.mark.parametrize(
    ("file", "kp", "kd"),
    [
        ({"joint": SPRING}, 100.0, 1.0),
        ({"joint": SPRING, "flags": '<flag damper="disable"/>'}, 100.0, 1.0),
        ({"joint": SPRING, "flags": '<flag spring="disable"/>'}, 100.0, 1.0),
        ({"joint": SPRING, "flags": '<flag eulerdamp="disable"/>'}, 100.0, 1.0),
        ({"joint": SPRING, "flags": '<flag actuation="disable"/>'}, None, None),
        ({"actuators": '<pid joint="bar" kp="100" kv="1"/>'}, 100.0, 1.0),
        ({"actuators": PD + '<motor joint="bar"/><motor site="tip"/>'}, 100.0, 1.0),
        ({"actuators": PD + PD.replace("/>", ' group="3"/>')}, 200.0, 2.0),
        (
            {
                "actuators": PD + PD.replace("/>", ' group="3"/>'),
                "options": 'actuatorgroupdisable="3"',
            },
            100.0,
            1.0,
        ),
        ({"actuators": PD.replace("/>", ' damping="2"/>'), "joint": 'damping="0.3"'}, 100.0, 1.0),
        # The damping of an actuator acts, even if the file disables the actuator.
        ({"actuators": PD + OFF, "options": 'actuatorgroupdisable="3"'}, 100.0, 1.0),
        ({"actuators": OFF, "flags": '<flag actuation="disable"/>'}, None, None),
        (
            {
                "actuators": PD + OFF,
                "options": 'actuatorgroupdisable="3"',
                "flags": '<flag eulerdamp="disable"/>',
            },
            100.0,
            1.0,
        ),
        (
            {
                "actuators": PD + OFF,
                "options": 'actuatorgroupdisable="3"',
                "flags": '<flag damper="disable"/>',
            },
            100.0,
            1.0,
        ),
    ],
)
def test_what_a_file_disables_does_not_act(
    file: dict[str, str], kp: float | None, kd: float | None, integrator: str
) -> None:
    options = f'integrator="{integrator}" {file.get("options", "")}'
    model = bar(**{**file, "options": options})
    answer = jaxstab.joints(model, simulated=True)
    own = answer.joints["bar"]
    assert (own.kp, own.kd) == (kp, kd)
    radius = answer.questions["bar"].loop(0.02).spectral_radius(kp=kp or 0.0, kd=kd or 0.0)
    assert float(radius.value) == pytest.approx(radius_in_mujoco(model), abs=1e-9)


@pytest.mark.parametrize("options", ["", 'actuatorgroupdisable="3"'])
def test_a_damper_at_a_tendon_moves_its_joints_even_if_it_is_disabled(options: str) -> None:
    cable = '<tendon><fixed name="cable"><joint joint="bar" coef="1"/></fixed></tendon><actuator>'
    text = BAR.replace("<actuator>", cable).format(
        actuators=PD + OFF.replace('joint="bar"', 'tendon="cable"'),
        flags="",
        joint="",
        options=options,
    )
    answer = jaxstab.joints(mujoco.MjModel.from_xml_string(text), simulated=True)
    assert answer.joints["bar"].verdict == "tendon cable moves it with other joints"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('mass="1"', 'mass="nan"'),
        ('mass="1"', 'mass="inf"'),
        ('pos="0.1 0 0" mass', 'pos="NaN 0 0" mass'),
        ('kp="100"', 'kp="nan"'),
        ('kv="1"', 'kv="inf"'),
        ('timestep="0.00173"', 'timestep="inf"'),
        ('name="bar"', 'name="bar" damping="nan"'),
        ('name="bar"', 'name="bar" stiffness="-inf"'),
        ('name="bar"', 'name="bar" frictionloss="nan"'),
        ('name="bar"', 'name="bar" range="nan 90"'),
        ("</body>", '<geom size="0.1" mass="nan"/></body>'),
    ],
)
def test_numbers_of_a_robot_that_are_not_finite_are_refused(
    old: str, new: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    text = BAR.format(actuators=PD, flags="", joint="", options="")
    assert old in text
    Path("whole.xml").write_text(text.replace(old, new))
    Path("robot.xml").write_text('<mujoco><include file="whole.xml"/></mujoco>')
    for robot in ("whole.xml", "robot.xml"):
        done = run("joints", robot, "--simulated")
        assert done.exit_code == 2
        assert_one_sentence(done.stderr)
    assert {path.name for path in tmp_path.iterdir()} == {"whole.xml", "robot.xml"}  # no log


def test_a_model_with_a_number_that_is_not_finite_is_refused() -> None:
    model = bar()
    model.dof_damping[0] = math.nan
    with pytest.raises(ValueError, match="not finite, in dof_damping; give"):
        jaxstab.joints(model, simulated=True)


def test_a_joint_without_a_name_has_one_of_its_own() -> None:
    body = '<body><joint {}axis="0 0 1"/><geom size="0.1"/></body>'
    named, unnamed = body.format('name="joint 1" '), body.format("")
    held = '<equality><joint joint1="joint 1"/></equality>'
    text = f"<mujoco>{{}}<worldbody>{named}{unnamed}</worldbody>{held}</mujoco>"
    answer = jaxstab.joints(mujoco.MjModel.from_xml_string(text.format("")), rate=500.0)
    verdicts = [own.verdict for own in answer.joints.values()]
    assert verdicts == ["equality 0 holds it at a place", "no gains"]
    off = text.format('<option><flag equality="disable"/></option>')
    answer = jaxstab.joints(mujoco.MjModel.from_xml_string(off), rate=500.0)
    assert [own.verdict for own in answer.joints.values()] == ["no gains", "no gains"]


def test_a_joint_that_cannot_be_computed_is_named_and_the_others_are_answered() -> None:
    gains = {name: {"kp": 20.0, "kd": 1.0} for name in ("shoulder", "elbow")}
    answer = jaxstab.joints(arm(slack=1e6), rate=500.0, delay=2e-3, gains=gains)
    assert answer.joints["shoulder"].verdict == Verdict.STABLE
    assert "a pole at 2^" in str(answer.joints["elbow"].verdict)
    assert not answer.all_stable
    assert {*answer.safe_gains()} == {"shoulder"}


def test_a_velocity_servo_is_stable_but_for_its_position_unless_the_delay_varies() -> None:
    _, plain = answered((0.0, 1.0))
    assert plain.verdict == "stable but for the position, which nothing holds"
    assert answered((0.0, plain.kd_growth * 1.001))[1].verdict == Verdict.UNSTABLE
    assert answered((0.0, 0.1), jitter=1e-3)[1].verdict == Verdict.UNDECIDED


def test_a_joint_without_gains_is_not_called_stable() -> None:
    answer = jaxstab.joints(arm(), rate=500.0)
    assert [joint.verdict for joint in answer.joints.values()] == ["no gains"] * 2
    assert not answer.all_stable
    assert str(answer).splitlines()[-1] == (
        "Give kp and kd by joints (--gains FILE); --safe-gains FILE writes safe ones."
    )
    assert "proved" not in str(answer)
    one = str(jaxstab.joints(arm(), rate=500.0, gains={"elbow": {"kp": 1.0, "kd": 0.1}}))
    assert "Give kp" not in one
    assert "Stable, growth: proved" in one


URDF = """
<robot name="lift">
  <link name="world"/>
  <link name="base"><inertial><mass value="3"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
   iyz="0"/></inertial><visual><geometry><mesh filename="package://none/none.dae"/></geometry>
   </visual><collision><geometry><mesh filename="package://none/none.stl"/></geometry></collision>
  </link>
  <joint name="slide" type="prismatic"><parent link="world"/><child link="base"/>
   <axis xyz="0 0 1"/><limit lower="0" upper="1" effort="1" velocity="1"/>
   <dynamics damping="2" friction="4"/></joint>
</robot>
"""


def test_urdf_is_read_without_its_meshes_and_slides_have_units_of_their_own(
    tmp_path: Path,
) -> None:
    (tmp_path / "lift.urdf").write_text(URDF)
    (tmp_path / "gains.yaml").write_text("slide: {kp: 1e3, kd: 60.0}\n")  # 1e3 is a text to PyYAML
    command = [
        "joints",
        tmp_path / "lift.urdf",
        "--gains",
        tmp_path / "gains.yaml",
        "--rate",
        "500",
    ]
    done = run(*command, "--json")
    joint = json.loads(done.stdout)["joints"]["slide"]
    assert (done.exit_code, joint["verdict"], joint["motion"]) == (0, "stable", "slides")
    assert joint["inertia"] == [3.0, 3.0]
    assert (joint["damping"], joint["friction"], joint["kp"]) == (2.0, 4.0, 1000.0)
    assert (joint["units"]["kp"], joint["units"]["friction"]) == ("N/m", "N")
    assert "slide  slides  3" in run(*command).stdout
    (tmp_path / "lift.urdf").write_text(URDF.replace('"slide"', '"&#155;2J&#127;"'))  # it clears
    assert "\\x9b2J\\x7f  slides  3" in run(*command[:2], *command[4:]).stdout


@pytest.mark.parametrize(
    ("extra", "words"),
    [
        ("", " (assumed: the file has no timestep and no integrator)"),
        (
            '<mujoco><option timestep="0.001"/></mujoco>',
            "step of 1 ms, implicit-joint (assumed: the file has no integrator)",
        ),
        ('<mujoco><option timestep="0.001" integrator="Euler"/></mujoco>', "implicit-joint\n"),
    ],
)
def test_a_step_that_urdf_does_not_have_is_called_assumed(
    extra: str, words: str, tmp_path: Path
) -> None:
    (tmp_path / "lift.urdf").write_text(URDF.replace("</robot>", f"{extra}</robot>"))
    gains = {"slide": {"kp": 100.0, "kd": 1.0}}
    assert words in str(jaxstab.joints(tmp_path / "lift.urdf", simulated=True, gains=gains))
    assert "assumed" not in str(jaxstab.joints(tmp_path / "lift.urdf", rate=500.0, gains=gains))


def test_the_page_shows_what_the_command_prints(monkeypatch: pytest.MonkeyPatch) -> None:
    root = Path(__file__).parents[3]
    monkeypatch.chdir(root)
    page = (root / "docs" / "robots.md").read_text(encoding="utf-8")
    done = run("joints", "data/robots/arm.xml", "--rate", "500", "--delay", "2e-3")
    assert f"```text\n{done.stdout}```" in page


# ---------------------------------------------------------------------- what follows from an answer
def answered(gains: tuple[float, float], **given: Any) -> tuple[Joints, JointAnswer]:
    """The arm with gains of the elbow at 500 Hz and 2 ms."""
    timing: dict[str, Any] = {"rate": 500.0, "delay": 2e-3}
    own = {"elbow": {"kp": gains[0], "kd": gains[1]}}
    answer = jaxstab.joints(arm(), **timing | given, gains=own)
    return answer, answer.joints["elbow"]


@pytest.mark.parametrize("side", [0.999, 1.001])
def test_gains_and_delay_may_grow_by_what_is_said(side: float) -> None:
    expected = Verdict.STABLE if side < 1.0 else Verdict.UNSTABLE
    _, elbow = answered((20.0, 1.0))
    assert answered((20.0 * elbow.kp_growth * side, 1.0))[1].verdict == expected
    assert answered((20.0, elbow.kd_growth * side))[1].verdict == expected
    later = 2e-3 + elbow.extra_delay * side
    assert answered((20.0, 1.0), delay=later)[1].verdict == expected


def test_safe_gains_have_a_factor_of_two_left(tmp_path: Path) -> None:
    answer, elbow = answered((200.0, 10.0))
    assert elbow.verdict == Verdict.UNSTABLE
    safe = answer.safe_gains()["elbow"]
    assert answered((2.0 * safe["kp"], 2.0 * safe["kd"]))[1].verdict == Verdict.STABLE
    ratio = safe["kd"] / safe["kp"] ** 0.5
    assert ratio == pytest.approx(10.0 / 200.0**0.5, rel=1e-3)  # that of the damping
    (tmp_path / "safe.yaml").write_text(answer.as_yaml())
    (tmp_path / "arm.xml").write_text(ARM.format(**PLAIN))
    robot, timing = tmp_path / "arm.xml", ["--rate", "500", "--delay", "2e-3"]
    done = run("joints", robot, *timing, "--gains", tmp_path / "safe.yaml")
    assert done.exit_code == 0
    assert done.stdout.count(" stable ") == 2


@pytest.mark.parametrize("name", ["1", "on", "1e3", "~"])
def test_names_of_joints_are_texts_in_files_of_gains(name: str, tmp_path: Path) -> None:
    robot, safe, own = (tmp_path / end for end in ("arm.xml", "safe.yaml", "own.yaml"))
    robot.write_text(ARM.format(**PLAIN).replace("elbow", name))
    timing = ["--rate", "500", "--delay", "2e-3"]
    assert run("joints", robot, *timing, "--safe-gains", safe).exit_code == 1
    own.write_text(f"{name}: {{kp: 2, kd: 1}}")
    for file, stable in ((safe, 2), (own, 1)):
        assert run("joints", robot, *timing, "--gains", file).stdout.count(" stable ") == stable


def test_what_lacks_armature_is_stable_with_it() -> None:
    _, elbow = answered((40.0, 4.0))
    missing = elbow.missing_armature
    for armature, verdict in ((1.001, Verdict.STABLE), (0.999, Verdict.UNSTABLE)):
        model = arm(elbow=0.002 + missing * armature)
        own = {"elbow": {"kp": 40.0, "kd": 4.0}}
        answer = jaxstab.joints(model, rate=500.0, delay=2e-3, gains=own)
        assert answer.joints["elbow"].verdict == verdict


def test_a_delay_that_varies_allows_less() -> None:
    _, constant = answered((20.0, 1.0), delay=3e-3)
    _, moving = answered((20.0, 1.0), jitter=1e-3)
    assert moving.verdict == Verdict.STABLE
    assert moving.least_inertia > constant.least_inertia
    _, elbow = answered((20.0, 1.0), jitter=0.03)
    assert elbow.verdict != Verdict.STABLE


# --------------------------------------------------------------------------------- what is refused
PLAIN = {
    "step": 1e-3,
    "integrator": "Euler",
    "eulerdamp": "enable",
    "actuators": '<position joint="elbow" kp="900" kv="9"/>',
    "shoulder": 0.01,
    "elbow": 0.002,
    "damping": 0.0,
    "slack": 0.0,
    "spring": 0.0,
    "elbow_spring": 0.0,
}


def test_a_sample_time_in_place_of_the_rate_is_warned_of() -> None:
    with pytest.warns(UserWarning, match="rate is 0.002 Hz, usual are 20 to 100000 Hz; is it a sa"):
        jaxstab.joints(arm(), rate=0.002, delay=2e-3)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], "rate is missing"),
        (["--rate", "0"], "rate is 0"),
        (["--rate", "500", "--delay", "-1"], "delay is -1"),
        (["--rate", "500", "--jitter", "nan"], "jitter is nan"),
        (["--simulated", "--delay", "1e-3"], "rate is missing"),
        (["--simulated", "--rate", "500", "--jitter", "1e-3"], "simulated"),
        (["--simulated", "--rate", "333"], "whole numbers of steps"),
        (["--rate", "500", "--gains", "none.yaml"], "cannot read none.yaml"),
        (
            ["--rate", "500", "--gains", "{folder}/bad.yaml"],
            "bad.yaml, line 1, column 14 is not YAML: ",
        ),
        (["--rate", "500", "--gains", "{folder}/list.yaml"], "kp and kd by the names of joints"),
        (["--rate", "500", "--gains", "{folder}/slip.yaml"], "give elbow, for instance"),
        (["--rate", "500", "--gains", "{folder}/half.yaml"], "give kp and kd"),
        (["--rate", "500", "--gains", "{folder}/word.yaml"], "kp of elbow"),
        (["--rate", "500", "--gains", "{folder}/text.yaml"], "kp of elbow is '60'; give real"),
        (["--rate", "500", "--gains", "{folder}/odd.yaml"], "odd.yaml is not YAML: special"),
        (["--rate", "500", "--gains", "{folder}/twice.yaml"], "gives 'elbow' twice"),
        (["--rate", "500", "--gains", "{folder}/inner.yaml"], "gives 'kp' twice"),
        (["--rate", "500", "--gains", "{folder}/time.yaml"], "'x' is not a value of the type time"),
        (
            ["--rate", "500", "--gains", "{folder}/truth.yaml"],
            "'x' is not a value of the type bool",
        ),
        (["--rate", "500", "--gains", "{folder}/int.yaml"], "'x' is not a value of the type int"),
        (["--rate", "500", "--gains", "{folder}/float.yaml"], "'x' is not a value of the type flo"),
        (["--rate", "500", "--gains", "{folder}/day.yaml"], "'2026-13-45' is not a value of the t"),
        (
            ["--rate", "500", "--gains", "{folder}/digits.yaml"],
            "99' is not a value of the type int",
        ),
        (["--rate", "500", "--gains", "{folder}/deep.yaml"], "deep.yaml is nested too deeply; giv"),
        (["--rate", "500", "--gains", "{folder}/deeper.yaml"], "deeper.yaml is nested too deeply"),
        (["--rate", "500", "--gains", "{folder}/cycle.yaml"], "kd of elbow is [[[[[[[...]]]]]]]"),
        (["--rate", "500", "--gains", "{folder}/laughs.yaml"], "kd of elbow is [[1], [[1], [1]"),
        (
            ["--rate", "500", "--gains", "{folder}/many.yaml"],
            "many.yaml has more than 0.2 MB; give",
        ),
        (["--rate", "500", "--safe-gains", "safe.txt"], "ends in neither .yaml nor .yml"),
    ],
)
def test_bad_input_is_one_sentence(options: list[str], words: str, tmp_path: Path) -> None:
    files = {
        "bad": "elbow: {kp: 1",
        "list": "- elbow",
        "slip": "ellbow: {kp: 1, kd: 1}",
        "twice": "elbow: {kp: 1, kd: 1}\nelbow: {kp: 2, kd: 1}",
        "inner": "elbow: {kp: 1, kd: 1, kp: 2}",
        "half": "elbow: {kp: 1}",
        "word": "elbow: {kp: soft, kd: 1}",
        "text": "elbow: {kp: '60', kd: 1}",
        "odd": "elbow: \x01",
        "time": 'elbow: {kp: 1, kd: !!timestamp "x"}',
        "truth": 'elbow: {kp: 1, kd: !!bool "x"}',
        "int": 'elbow: {kp: 1, kd: !!int "x"}',
        "float": 'elbow: {kp: 1, kd: !!float "x"}',
        "day": "elbow: {kp: 1, kd: 2026-13-45}",
        "digits": f"elbow: {{kp: 1, kd: {'9' * 5000}}}",
        "deep": f"elbow: {{kp: 1, kd: {'[' * 5000}",
        "deeper": f"elbow: {{kp: 1, kd: {'{a: ' * 5000}",
        "cycle": "elbow: {kp: 1, kd: &a [*a]}",
        "laughs": "elbow: {kp: 1, kd: [&a0 [1], "  # 3^40 numbers
        + ", ".join(f"&a{n + 1} [*a{n}, *a{n}, *a{n}]" for n in range(40))
        + "]}",
        "many": "".join(f"joint_{number}: {{kp: 1, kd: 1}}\n" for number in range(60_000)),
    }
    for name, text in files.items():
        (tmp_path / f"{name}.yaml").write_text(text)
    (tmp_path / "arm.xml").write_text(ARM.format(**PLAIN))
    done = run("joints", tmp_path / "arm.xml", *(each.format(folder=tmp_path) for each in options))
    assert done.exit_code == 2
    assert_one_sentence(done.stderr)
    assert words in done.stderr


NO_INERTIA = """<mujoco><worldbody><body>
  <joint name="a" type="slide" axis="1 0 0"/><joint name="b" type="slide" axis="1 0 0"/>
  <inertial pos="0 0 0" mass="{mass}" diaginertia="1 1 1"/>
  <body><joint name="c"/><inertial pos="0 0 0" mass="1e-14" diaginertia="1e-14 1e-14 1e-14"/></body>
</body></worldbody></mujoco>"""


def test_what_mujoco_warns_of_is_in_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("robot.xml").write_text(NO_INERTIA.format(mass="1e10"))
    done = run("joints", "robot.xml", "--rate", "500")
    assert (done.exit_code, done.stdout) == (2, "")
    assert_one_sentence(done.stderr)
    assert "its mass matrix is not positive; give one that moves" in done.stderr
    assert [file.name for file in tmp_path.iterdir()] == ["robot.xml"]
    assert mujoco.get_mju_user_warning() is None


def test_what_mujoco_warns_of_is_a_warning_of_python() -> None:
    model = arm(elbow=0.0)
    model.body_mass[-1] = model.body_inertia[-1] = 1e-16
    with pytest.warns(UserWarning, match="MuJoCo: Inertia matrix is too close to singular"):
        elbow = jaxstab.joints(model, rate=500.0).joints["elbow"]
    assert elbow.inertia == pytest.approx((1.01e-16, 1.01e-16), rel=1e-6)


def test_a_robot_is_read_from_a_pipe_once(tmp_path: Path) -> None:
    pipe, file = tmp_path / "pipe.xml", tmp_path / "arm.xml"
    file.write_text(ARM.format(**PLAIN))
    os.mkfifo(pipe)
    writer = threading.Thread(target=pipe.write_text, args=(file.read_text(),))
    writer.start()
    answer = run("joints", pipe, "--rate", 500)
    writer.join()
    plain = run("joints", file, "--rate", 500)
    assert answer.stdout == plain.stdout.replace(str(file), str(pipe))
    assert answer.exit_code == plain.exit_code == 1  # no gains


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<robot>", "reads no robot from"),
        ("<mujoco><worldbody/></mujoco>", "no joint"),
        ("<mujoco><nonsense/></mujoco>", "nonsense"),
        ("<robot name='a'><link name='a'/><link name='b'/><joint name='j' type='continuous'>"
         "<parent link='a'/><child link='b'/></joint></robot>", "mass and inertia"),
    ],
)  # fmt: skip
def test_files_that_mujoco_does_not_read_are_named(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "robot.xml").write_text(text)
    done = run("joints", tmp_path / "robot.xml", "--rate", "500")
    assert done.exit_code == 2
    assert_one_sentence(done.stderr)
    assert words in done.stderr


def test_without_mujoco_the_sentence_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    done = run("joints", tmp_path / "robot.xml", "--rate", "500")
    assert done.exit_code == 2
    assert_one_sentence(done.stderr)
    assert "jaxstab[robots]" in done.stderr


def test_rules_whose_gains_are_not_affine_are_refused() -> None:
    with pytest.raises(ValueError, match="RK4"):
        jaxstab.joints(arm(integrator="RK4"), simulated=True)


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
def test_a_damped_joint_under_held_torques_of_an_engine_is_proved(integrator: str) -> None:
    timing: dict[str, Any] = {"rate": 250.0, "delay": 2e-3, "simulated": True}
    for kp, verdict in ((5.0, Verdict.STABLE), (400.0, Verdict.UNSTABLE)):
        gains = {"elbow": {"kp": kp, "kd": 0.5}}
        model = arm(slack=0.01, integrator=integrator)
        elbow = jaxstab.joints(model, **timing, gains=gains, postures=9).joints["elbow"]
        assert elbow.verdict == verdict


def test_growth_is_of_every_inertia_between_the_ends() -> None:
    """The elbow held by RK4 at 1 ms, every 4th step, two steps late: the radius of one period."""
    timing: dict[str, Any] = {"rate": 250.0, "delay": 2e-3, "simulated": True}
    kp, kd, damping, spring = 5.0, 0.1, 0.05, 3.0
    model = arm(slack=damping, elbow_spring=spring, integrator="RK4")
    gains = {"elbow": {"kp": kp, "kd": kd}}
    elbow = jaxstab.joints(model, **timing, gains=gains, postures=9).joints["elbow"]
    assert elbow.growth_is == "for every inertia"
    factors = elbow.kp_growth, elbow.kd_growth
    assert min(factors) > 1.0

    def radius(inertia: float, kp: float, kd: float) -> float:
        rate = np.array([[0, 1, 0], [-spring / inertia, -damping / inertia, 1 / inertia], [0] * 3])
        terms = (np.linalg.matrix_power(rate * 1e-3, k) / math.factorial(k) for k in range(5))
        step, gains = sum(terms), np.array([[kp, kd]])
        half = np.linalg.matrix_power(step, 2)  # under the torque of before, then under that of now
        move, push = half[:2, :2], half[:2, 2:]
        period = np.block([[move @ move - push @ gains, move @ push], [-gains, np.zeros((1, 1))]])
        return float(np.abs(np.linalg.eigvals(period)).max())

    inertias = np.linspace(*elbow.inertia, 60).tolist()
    for index, factor in enumerate(factors):
        for share, is_stable in ((0.3, True), (0.99, True), (1.01, False)):
            grown = [kp, kd]
            grown[index] *= 1.0 + share * (factor - 1.0)
            assert all(radius(inertia, *grown) < 1.0 for inertia in inertias) == is_stable


def test_the_exit_code_tells_a_ci_of_a_joint_that_is_not_stable(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ARM.format(**PLAIN))
    command = ["joints", tmp_path / "arm.xml", "--rate", "500", "--delay", "2e-3"]
    done = run(*command, "--csv", "-", "--safe-gains", tmp_path / "safe.yaml")
    assert done.exit_code == 1
    verdicts = {row["joint"]: row["verdict"] for row in csv.DictReader(done.stdout.splitlines())}
    expected = {"shoulder": "no gains", "elbow": "unstable", "all joints at once": "unstable"}
    assert verdicts == expected
    safe = [*command, "--gains", tmp_path / "safe.yaml"]
    assert run(*safe).exit_code == 0
    assert run(*command, "--simulated").exit_code == 1
    simulated = run("joints", tmp_path / "arm.xml", "--simulated")
    assert "inside of the simulation's step of 1 ms" in simulated.stdout
