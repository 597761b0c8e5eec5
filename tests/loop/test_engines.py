"""PD control in a real physics engine: MuJoCo, 1 % on either side of proved limits."""

from typing import Any

import numpy as np
import pytest
from campaign import many

import jaxstab

mujoco = pytest.importorskip("mujoco")

START = 1e-3  # rad
RULES = {  # of jaxstab, and MuJoCo's integrator
    "implicit-joint": "Euler",
    "semi-implicit": "Euler",
    "implicit-damping": "implicit",
    "rk4": "RK4",
}
SCENE = """
<mujoco>
  <option timestep="{step!r}" integrator="{integrator}" gravity="0 0 0">
    <flag autoreset="disable" eulerdamp="{eulerdamp}" contact="disable"/>
  </option>
  <worldbody>
    <body>
      <joint name="joint" type="hinge" axis="0 0 1" damping="{damping!r}" stiffness="{stiffness!r}"
             armature="{armature!r}"/>
      <inertial pos="0 0 0" mass="1" diaginertia="{body!r} {body!r} {body!r}"/>
    </body>
  </worldbody>
  <actuator>{actuator}</actuator>
</mujoco>
"""


class Joint:
    """A joint of MuJoCo."""

    def __init__(self, rng: np.random.Generator, rule: str) -> None:
        inertia, step = 10 ** rng.uniform(-3, 0), 10 ** rng.uniform(-3.3, -2)
        self.rule, self.step = rule, step
        self.body = inertia * rng.uniform(0.3, 1.0)
        self.armature = inertia - self.body
        self.damping = float(rng.choice([0.0, 0.05])) * inertia / step
        self.stiffness = float(rng.choice([0.0, 0.05])) * inertia / step**2

    @property
    def options(self) -> dict[str, Any]:
        return {
            "step": self.step,
            "damping": self.damping,
            "stiffness": self.stiffness,
            "integrator": self.rule,
        }

    def model(self, actuator: str) -> Any:
        return mujoco.MjModel.from_xml_string(
            SCENE.format(
                step=self.step,
                integrator=RULES[self.rule],
                eulerdamp="disable" if self.rule == "semi-implicit" else "enable",
                damping=self.damping,
                stiffness=self.stiffness,
                armature=self.armature,
                body=self.body,
                actuator=actuator,
            )
        )

    def inside(self, kp: float, kd: float) -> bool | None:
        """True if it comes to rest under a position actuator; None: neither in time."""
        model = self.model(f'<position joint="joint" kp="{kp!r}" kv="{kd!r}"/>')
        data = mujoco.MjData(model)
        data.qpos[0] = START
        for _ in range(400):
            mujoco.mj_step(model, data, nstep=500)
            if (settled := _is_settled(data)) is not None:
                return settled
        return None

    def outside(
        self, kp: float, kd: float, substeps: int, delay_steps: int, window: int = 0
    ) -> bool | None:
        """The same under a torque that a program computes and holds.

        It takes the engine's velocity, or the difference over a window of its own samples.
        """
        model = self.model('<motor joint="joint"/>')
        data = mujoco.MjData(model)
        data.qpos[0] = START
        seen = [START] * (window + 1)
        late = [0.0] * (delay_steps + 1)  # torques by the step in which they act, from now on
        for count in range(100_000):
            if count % substeps == 0:
                seen = [float(data.qpos[0]), *seen[:window]]
                span = window * substeps * self.step
                speed = (seen[0] - seen[-1]) / span if window else data.qvel[0]
                late[delay_steps:] = [-kp * data.qpos[0] - kd * speed] * substeps
            data.ctrl[0] = late.pop(0)
            mujoco.mj_step(model, data)
            if count % 1000 == 999 and (settled := _is_settled(data)) is not None:
                return settled
        return None


def _is_settled(data: Any) -> bool | None:
    size = max(abs(float(data.qpos[0])), abs(float(data.qvel[0])) * data.time / 1e3)
    if not size < 1e3 * START:  # NaN too
        return False
    return True if size < 1e-4 * START else None


def disagreements(where: str, rule: str, count: int) -> tuple[int, list[str]]:
    """Compare the upper ends of intervals of kp with what the engine does beside them."""
    rng, decided, wrong = np.random.default_rng([54, len(rule), len(where)]), 0, []
    for index in range(count):
        joint = Joint(rng, rule)
        timing: dict[str, int] = {}
        if where == "outside":
            timing = {"substeps": int(rng.integers(1, 9)), "delay_steps": int(rng.integers(0, 10))}
        size = (joint.body + joint.armature) / joint.step
        kd = size * rng.uniform(0.05, 0.5) / (1 + sum(timing.values()))
        if where == "by differences":
            timing = {"substeps": int(rng.integers(1, 6)), "delay_steps": int(rng.integers(0, 10))}
            kd = size * rng.uniform(0.05, 0.3) / (2 + sum(timing.values()))
            loop = jaxstab.HapticLoop(
                device=jaxstab.Device.simulated(joint.body + joint.armature, **joint.options),
                sample_time=timing["substeps"] * joint.step,
                delay=timing["delay_steps"] * joint.step,
                velocity=jaxstab.Velocity.difference(samples=(window := int(rng.integers(1, 4)))),
            )
            line, timing["window"] = loop.stiffness_intervals(kd), window
        else:
            line = jaxstab.simulated_pd(
                joint.body + joint.armature, **joint.options, **timing, outside=where == "outside"
            ).intervals(kd=kd)
        tops = [high.value for low, high in line.intervals if 0.0 < high.value < np.inf]
        for top in tops[-1:]:
            for side in (0.99, 1.01):
                kp = side * top
                act = joint.inside if where == "inside" else joint.outside
                settled = act(kp, kd, **timing)
                if settled is not None:
                    decided += 1
                    if settled != (side < 1.0):
                        wrong.append(f"{where} {rule} {index}: {kp} {kd} {settled}")
    return decided, wrong


PLACES = [("inside", rule) for rule in RULES if rule != "rk4"]
PLACES += [
    (where, rule)
    for where in ("outside", "by differences")
    for rule in ("implicit-joint", "semi-implicit", "rk4")
]


@pytest.mark.parametrize(("where", "rule"), PLACES[:6:2])
def test_mujoco_settles_below_proved_limits_and_not_above(where: str, rule: str) -> None:
    decided, wrong = disagreements(where, rule, 4)
    assert not wrong
    assert decided >= 4


@pytest.mark.campaign
@pytest.mark.parametrize(("where", "rule"), PLACES)
def test_many_joints_of_mujoco_agree_with_proved_limits(where: str, rule: str) -> None:
    decided, wrong = disagreements(where, rule, count := many(200, 8))
    assert not wrong
    assert decided > count


TWO = """
<mujoco>
  <option timestep="{step!r}" gravity="0 0 0"><flag autoreset="disable" contact="disable"/></option>
  <worldbody>
    <body><joint name="first" type="slide" axis="1 0 0" damping="{damping!r}"/>
      <inertial pos="0 0 0" mass="{first!r}" diaginertia="1 1 1"/></body>
    <body><joint name="second" type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="{second!r}" diaginertia="1 1 1"/></body>
  </worldbody>
  <actuator><motor joint="first"/><motor joint="second"/></actuator>
</mujoco>
"""


def stays_together(
    masses: dict[str, float], gains: tuple[float, float], late: tuple[int, int], substeps: int
) -> bool | None:
    """True if two masses come together under a spring and a damper that a program computes."""
    model = mujoco.MjModel.from_xml_string(TWO.format(**masses))
    data = mujoco.MjData(model)
    data.qpos[0] = before = START
    queues = [[0.0] * (each * substeps + 1) for each in late]
    for count in range(100_000):
        if count % substeps == 0:
            apart = float(data.qpos[0] - data.qpos[1])
            speed = (apart - before) / (substeps * masses["step"])
            before, force = apart, -gains[0] * apart - gains[1] * speed
            for queue, each, sign in zip(queues, late, (1.0, -1.0), strict=True):
                queue[each * substeps :] = [sign * force] * substeps
        data.ctrl[:] = [queue.pop(0) for queue in queues]
        mujoco.mj_step(model, data)
        if count % 1000 == 999:
            size = max(abs(data.qpos[0] - data.qpos[1]), abs(data.qvel[0] - data.qvel[1]))
            if not size < 1e3 * START:  # NaN too
                return False
            if size < 1e-5 * START:
                return True
    return None


@pytest.mark.campaign
def test_mujoco_keeps_a_tool_behind_a_coupling_below_proved_limits_and_not_above() -> None:
    rng, decided = np.random.default_rng(543), 0
    for _ in range(8):
        step, substeps = 10 ** rng.uniform(-3.3, -2.3), int(rng.integers(1, 4))
        masses = {"first": rng.uniform(0.1, 1.0), "second": rng.uniform(0.05, 1.0), "step": step}
        masses["damping"] = 0.1 * masses["first"] / step
        late = int(rng.integers(0, 3)), int(rng.integers(0, 3))
        bodies = [
            jaxstab.Device.simulated(masses[name], damping=damping, step=step, integrator=rule)
            for name, damping, rule in (
                ("first", masses["damping"], "implicit-joint"),
                ("second", 0.0, "semi-implicit"),
            )
        ]
        period = substeps * step
        delays = [float(each) for each in late]
        loop = jaxstab.coupling(*bodies, sample_time=period, delays_samples=delays)
        damping = 0.1 * masses["second"] / period / (1 + sum(late))
        tops = [high.value for _, high in loop.intervals(damping=damping).intervals]
        for top in tops[-1:]:
            for side in (0.99, 1.01):
                settled = stays_together(masses, (side * top, damping), late, substeps)
                assert settled in (None, side < 1.0)
                decided += settled is not None
    assert decided >= 12
