"""All joints of a robot at once: against step matrices of its own, and MuJoCo's own steps."""

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from commands import run
from scipy.linalg import eigvalsh

import jaxstab
from jaxstab import Verdict

mujoco = pytest.importorskip("mujoco")

PERIOD = 2e-3  # s, of a controller at 500 Hz
LINK, MASS, ARMATURE = 0.12, 0.4, 0.002  # m, kg and kg m^2, of each link of the chain
RADIUS = 0.02  # m, of each link: a capsule
BALL = MASS * 4.0 * RADIUS / (4.0 * RADIUS + 3.0 * LINK)  # kg, of its two ends
OWN_INERTIA = (MASS - BALL) * (LINK**2 / 12.0 + RADIUS**2 / 4.0)
OWN_INERTIA += BALL * (0.4 * RADIUS**2 + LINK**2 / 4.0 + 0.375 * LINK * RADIUS)
HELD = {"rate": 1.0 / PERIOD, "delay": PERIOD}


def chain(count: int, kp: float, kd: float, options: str = "", joint: str = "") -> str:
    """A planar chain of equal links under position actuators."""
    bodies = "".join(
        f'<body pos="{LINK * (k > 0)} 0 0"><joint name="j{k}" axis="0 0 1" armature="{ARMATURE}" '
        f'{joint}/><inertial pos="{LINK / 2} 0 0" mass="{MASS}" '
        f'diaginertia="1e-4 {OWN_INERTIA!r} {OWN_INERTIA!r}"/>'
        for k in range(count)
    )
    actuators = "".join(f'<position joint="j{k}" kp="{kp}" kv="{kd}"/>' for k in range(count))
    return (
        f'<mujoco><compiler angle="radian"/><option gravity="0 0 0" {options}/><worldbody>{bodies}'
        f"{'</body>' * count}</worldbody><actuator>{actuators}</actuator></mujoco>"
    )


def mass_matrix(angles: np.ndarray) -> np.ndarray:
    """That of the chain, from the speeds of the centres of its links."""
    count, turned = len(angles), np.cumsum(angles)
    whole = ARMATURE * np.eye(count)
    for last in range(count):
        reach = np.full(last + 1, LINK)
        reach[-1] /= 2.0
        parts = reach * np.array([-np.sin(turned[: last + 1]), np.cos(turned[: last + 1])])
        speeds = np.zeros((3, count))  # of the centre and of the link, by the joints' speeds
        speeds[:2, : last + 1] = np.cumsum(parts[:, ::-1], axis=1)[:, ::-1]
        speeds[2, : last + 1] = 1.0
        whole += speeds.T @ np.diag([MASS, MASS, OWN_INERTIA]) @ speeds
    return whole


def radius_of_chain(mass: np.ndarray, kp: np.ndarray, kd: np.ndarray) -> float:
    """Without damping, one sample late, by differences: q+ = q + T v + T^2/2 a, v+ = v + T a."""
    one, push = np.eye(len(mass)), np.linalg.inv(mass)
    none, torque = 0.0 * one, np.hstack([-np.diag(kp + kd / PERIOD), 0.0 * one])
    period = np.block(
        [
            [one, PERIOD * one, PERIOD**2 / 2.0 * push, none],
            [none, one, PERIOD * push, none],
            [torque, none, np.diag(kd / PERIOD)],
            [one, none, none, none],
        ]
    )
    return float(np.max(np.abs(np.linalg.eigvals(period))))


def named(kp: float, kd: float, count: int = 6) -> dict[str, dict[str, float]]:
    return {f"j{k}": {"kp": kp, "kd": kd} for k in range(count)}


def test_a_chain_that_is_stable_joint_by_joint_shakes_together(tmp_path: Path) -> None:
    robot = tmp_path / "chain.xml"
    robot.write_text(chain(6, 20.0, 1.0))
    answer = jaxstab.joints(robot, **HELD)
    assert all(joint.verdict == Verdict.STABLE for joint in answer.joints.values())
    assert not answer.all_stable
    found = answer.together
    gains = np.full(6, 20.0), np.full(6, 1.0)
    assert found.verdict == Verdict.UNSTABLE
    assert found.spectral_radius == pytest.approx(1.047, abs=5e-4)
    radii = [radius_of_chain(mass_matrix(angles), *gains) for angles in answer.robot.places]
    assert found.unstable_postures == np.count_nonzero(np.array(radii) > 1.0)
    assert found.spectral_radius == pytest.approx(max(radii), abs=1e-9)

    command = ["joints", robot, "--rate", "500", "--delay", "2e-3"]
    done = run(*command)
    assert done.exit_code == 1
    words = f"at {found.unstable_postures}, growing by {found.spectral_radius:.5g} a sample, mostly"
    assert f"All joints at once, computed at 256 postures: unstable {words}" in done.stdout
    together = json.loads(run(*command, "--json").stdout)["together"]
    assert together["verdict"] == "unstable"
    assert together["spectral_radius"] == found.spectral_radius
    *_, row = csv.DictReader(run(*command, "--csv", "-").stdout.splitlines())
    assert (row["joint"], row["verdict"]) == ("all joints at once", "unstable")
    assert float(row["spectral_radius"]) == found.spectral_radius


def test_safe_gains_and_their_doubles_are_stable_together(tmp_path: Path) -> None:
    robot, safe = tmp_path / "chain.xml", tmp_path / "safe.yaml"
    robot.write_text(chain(4, 20.0, 1.0))
    command = ["joints", robot, "--rate", "500", "--delay", "2e-3"]
    assert run(*command, "--safe-gains", safe).exit_code == 1
    assert "for all joints at once it is computed at sampled postures" in safe.read_text()
    assert run(*command, "--gains", safe).exit_code == 0
    gains = yaml.safe_load(safe.read_text())
    kp, kd = (np.array([pair[key] for pair in gains.values()]) for key in ("kp", "kd"))
    assert kd / kp**0.5 == pytest.approx(np.full(4, 1.0 / 20.0**0.5), rel=1e-3)
    postures = np.random.default_rng(2).uniform(-np.pi, np.pi, (400, 4))

    def largest(factor: float, kp: np.ndarray, kd: np.ndarray) -> float:
        return max(radius_of_chain(mass_matrix(q), factor * kp, factor * kd) for q in postures)

    assert max(largest(1.0, kp, kd), largest(2.0, kp, kd)) < 1.0
    # No smaller than necessary: they are a common factor below, on a grid of fourth roots of 2.
    assert largest(2.1, kp * 2.0**0.5, kd * 2.0**0.25) > 1.0


# q = (0, 0.9, -1.4) and its spectral radii are from 40-digit arithmetic.
PLANAR = """
<mujoco><compiler angle="radian"/><option gravity="0 0 0" timestep="0.002"/><worldbody>
<body><joint name="a" axis="0 0 1" damping="{damping[0]}" armature="0.01"/>
<inertial pos="0.2 0 0" mass="1.5" diaginertia="0.01 0.02 0.02"/>
<body pos="0.4 0 0" euler="0 0 0.9">
<joint name="b" axis="0 0 1" damping="{damping[1]}" armature="0.004"/>
<inertial pos="0.15 0 0" mass="0.8" diaginertia="0.005 0.008 0.008"/>
<body pos="0.3 0 0" euler="0 0 -1.4">
<joint name="c" axis="0 0 1" damping="{damping[2]}" armature="0.002"/>
<inertial pos="0.06 0 0" mass="0.3" diaginertia="0.0005 0.001 0.001"/>
</body></body></body></worldbody></mujoco>
"""
DAMPED = (0.05, 0.02, 0.01)


@pytest.mark.parametrize(
    ("damping", "kd", "delay", "window", "radius"),
    [
        ((0.0, 0.0, 0.0), (6.0, 3.0, 1.0), 2e-3, 1, 0.98849087502357),
        (DAMPED, (6.0, 1.5, 0.4), 2e-3, 1, 0.98930229884177),
        ((0.0, 0.0, 0.0), (6.0, 1.5, 0.4), 2.5e-3, 3, 0.98928382831208),
    ],
)
def test_radii_are_those_of_forty_digits(
    damping: tuple[float, ...], kd: tuple[float, ...], delay: float, window: int, radius: float
) -> None:
    model = mujoco.MjModel.from_xml_string(PLANAR.format(damping=damping))
    pairs = zip("abc", (120.0, 60.0, 20.0), kd, strict=True)
    gains = {name: {"kp": kp, "kd": own} for name, kp, own in pairs}
    velocity = jaxstab.Velocity.difference(window)
    timing: dict[str, Any] = {"rate": 500.0, "delay": delay, "velocity": velocity}
    found = jaxstab.joints(model, **timing, gains=gains, postures=1).together
    assert found.spectral_radius == pytest.approx(radius, abs=1e-13)


# ------------------------------------------------------------------------------- MuJoCo's own steps
def radius_in_mujoco(model: Any) -> float:
    data, n = mujoco.MjData(model), 2 * model.nv
    step = np.zeros((n, n))
    mujoco.mjd_transitionFD(model, data, 1e-6, True, step, None, None, None)
    return float(np.max(np.abs(np.linalg.eigvals(step))))


INTEGRATORS = {
    "Euler": "",
    "implicit": "",
    "implicitfast": "",
    "Euler ": '<flag eulerdamp="disable"/>',
}


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_the_step_of_all_joints_is_the_one_of_mujoco(integrator: str) -> None:
    rng = np.random.default_rng([*integrator.encode()])
    for _ in range(6):
        kp, kd, damping, spring = rng.uniform([1.0, 0.1, 0.0, 0.0], [300.0, 4.0, 0.5, 50.0])
        text = chain(
            int(rng.integers(2, 6)),
            kp,
            kd,
            f'timestep="0.002" integrator="{integrator.strip()}"',
            f'damping="{damping}" stiffness="{spring}"',
        ).replace("/><worldbody>", f">{INTEGRATORS[integrator]}</option><worldbody>")
        model = mujoco.MjModel.from_xml_string(text)
        found = jaxstab.joints(model, simulated=True, postures=1).together
        assert found.spectral_radius == pytest.approx(radius_in_mujoco(model), abs=1e-7)


@pytest.mark.parametrize(("integrator", "sign"), [("Euler", 1.0), ("implicitfast", -1.0)])
def test_the_limit_of_the_step_is_one_symmetric_eigenvalue(integrator: str, sign: float) -> None:
    """Stable if and only if 4 M + 2 h C -+ 2 h Kd - h^2 (Kp + G) > 0: all gains times a factor."""
    h, damping, spring, count = 2e-3, 0.02, 5.0, 4
    base = 4.0 * mass_matrix(np.zeros(count)) + (2.0 * h * damping - h**2 * spring) * np.eye(count)
    kp, kd = 200.0, 0.01
    factor = 1.0 / eigvalsh((h**2 * kp + sign * 2.0 * h * kd) * np.eye(count), base)[-1]
    for share, verdict in ((1.0 - 1e-5, Verdict.STABLE), (1.0 + 1e-5, Verdict.UNSTABLE)):
        gains = share * factor * kp, share * factor * kd
        options = f'timestep="{h}" integrator="{integrator}"'
        text = chain(count, *gains, options, f'damping="{damping}" stiffness="{spring}"')
        model = mujoco.MjModel.from_xml_string(text)
        assert jaxstab.joints(model, simulated=True, postures=1).together.verdict == verdict


def settles(model: Any, angles: Any, apply: Callable[[Any, int], None] | None = None) -> bool:
    """True if MuJoCo brings a robot to rest that starts next to a posture."""
    data = mujoco.MjData(model)
    data.qpos[:] = angles + 1e-5 * np.random.default_rng(3).standard_normal(model.nq)
    if not apply:
        data.ctrl[:] = angles
    for count in range(20_000):
        if apply:
            apply(data, count)
        mujoco.mj_step(model, data)
        size = np.max(np.abs(data.qpos - angles))
        if not size < 1e-2 or size < 1e-8:
            return bool(size < 1e-8)
    raise AssertionError("neither grows nor settles")


def test_a_file_that_mujoco_cannot_step_is_not_stable(tmp_path: Path) -> None:
    (tmp_path / "chain.xml").write_text(chain(6, 20.0, 2.5, '><flag autoreset="disable"/></option'))
    text = (tmp_path / "chain.xml").read_text().replace("</option/>", "</option>")
    (tmp_path / "chain.xml").write_text(text)
    answer = jaxstab.joints(tmp_path / "chain.xml", simulated=True)
    assert all(joint.verdict == Verdict.STABLE for joint in answer.joints.values())
    assert answer.together.verdict == Verdict.UNSTABLE
    assert not answer.all_stable
    done = run("joints", tmp_path / "chain.xml", "--simulated")
    assert done.exit_code == 1
    assert f"growing by {answer.together.spectral_radius:.5g} a step" in done.stdout
    model = mujoco.MjModel.from_xml_string(text)
    assert not settles(model, np.array([*answer.together.posture.values()]))
    safe = jaxstab.joints(model, simulated=True, gains=answer.safe_gains())
    assert safe.all_stable
    kp, kd = (2.0 * np.array([getattr(j, x) for j in safe.joints.values()]) for x in ("kp", "kd"))
    model.actuator_gainprm[:, 0], model.actuator_biasprm[:, 1] = kp, -kp
    model.actuator_biasprm[:, 2] = -kd
    assert settles(model, np.array([*answer.together.posture.values()]))


@pytest.mark.parametrize(
    ("integrator", "filtered"), [("Euler", False), ("implicitfast", True), ("RK4", False)]
)
def test_torques_that_a_program_holds_act_as_in_mujoco(integrator: str, filtered: bool) -> None:
    """Periods of 2 steps, torques 3 steps late: the period of MuJoCo, by differences."""
    substeps, late, count, step, near = 2, 3, 2, 1e-3, 1e-6
    cutoff, kp, kd = 40.0, 5.0, 0.3
    damping = 'damping="0.05" stiffness="2"'
    options = f'timestep="{step}" integrator="{integrator}"'
    text = chain(count, 1.0, 1.0, options, damping)
    text = text[: text.index("<actuator>")] + "<actuator>"
    text += "".join(f'<motor joint="j{k}"/>' for k in range(count)) + "</actuator></mujoco>"
    model = mujoco.MjModel.from_xml_string(text)
    pole = np.exp(-2.0 * np.pi * cutoff * substeps * step)

    def period(state: np.ndarray) -> np.ndarray:
        """Angles, speeds, last angles, filtered speeds, torques of the steps to come."""
        q, v, before, speed, *queue = state.reshape(-1, count)
        estimate = v
        if filtered:
            estimate = pole * speed + (1.0 - pole) * (q - before) / (substeps * step)
        queue = [*queue, *[-kp * q - kd * estimate] * substeps]
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = q, v
        for torque in queue[:substeps]:
            data.ctrl[:] = torque
            mujoco.mj_step(model, data)
        return np.concatenate([data.qpos, data.qvel, q, estimate, *queue[substeps:]])

    basis = near * np.eye((4 + late) * count)
    whole = np.transpose([(period(row) - period(-row)) / (2.0 * near) for row in basis])
    radius = np.max(np.abs(np.linalg.eigvals(whole)))
    timing: dict[str, Any] = {"rate": 1.0 / (substeps * step), "delay": late * step}
    timing["velocity"] = jaxstab.Velocity.low_pass(cutoff) if filtered else None
    gains = named(kp, kd, count)
    found = jaxstab.joints(model, simulated=True, gains=gains, postures=1, **timing).together
    assert found.spectral_radius == pytest.approx(radius, abs=1e-7)


# -------------------------------------------------------------------- joints without torque or hold
def test_a_joint_without_torque_only_adds_its_inertia() -> None:
    gains = {name: {"kp": 20.0, "kd": 1.0} for name in ("j0", "j2")}
    model = mujoco.MjModel.from_xml_string(chain(4, 0.0, 0.0))
    found = jaxstab.joints(model, **HELD, gains=gains, postures=1).together
    free = np.linalg.inv(np.linalg.inv(mass_matrix(np.zeros(4)))[np.ix_([0, 2], [0, 2])])
    radius = radius_of_chain(free, np.full(2, 20.0), np.full(2, 1.0))
    assert found.spectral_radius == pytest.approx(radius, abs=1e-9)


def test_positions_that_nothing_holds_do_not_count() -> None:
    model = mujoco.MjModel.from_xml_string(chain(2, 0.0, 0.0))
    for kd, is_stable in ((0.05, True), (3.0, False)):
        gains = {"j0": {"kp": 20.0, "kd": 1.0}, "j1": {"kp": 0.0, "kd": kd}}
        answer = jaxstab.joints(model, **HELD, gains=gains, postures=1)
        assert answer.all_stable == is_stable
        radius = radius_of_chain(
            mass_matrix(np.zeros(2)), np.array([20.0, 0.0]), np.array([1.0, kd])
        )
        assert (radius <= 1.0 + 1e-9) == is_stable  # it has the root at 1
    with_hold = "stable but for the position, which nothing holds"
    gains = named(0.0, 0.05, 2)
    assert jaxstab.joints(model, **HELD, gains=gains, postures=1).together.verdict == with_hold


def test_a_delay_that_varies_is_decided_only_where_a_constant_one_is_unstable() -> None:
    model = mujoco.MjModel.from_xml_string(chain(2, 0.0, 0.0))
    slow = jaxstab.joints(model, **HELD, jitter=1e-3, gains=named(1.0, 0.1, 2), postures=9)
    assert all(joint.verdict == Verdict.STABLE for joint in slow.joints.values())
    assert slow.together.verdict == Verdict.UNDECIDED
    assert not slow.all_stable
    assert str(slow).endswith("computed at 9 postures: undecided, as the delay varies.")
    stiff = jaxstab.joints(model, **HELD, jitter=1e-3, gains=named(100.0, 5.0, 2), postures=9)
    assert stiff.together.verdict == Verdict.UNSTABLE


@pytest.mark.parametrize(("gain", "damping"), [(1e-150, "0"), (20.0, "1e300")])
def test_what_rounding_hides_is_undecided(gain: float, damping: str) -> None:
    """Two roots within 1e-150 of 1, which rounding moves to 1 + 1e-8; numbers that overflow."""
    text = chain(2, 0.0, 0.0, joint=f'damping="{damping}"')
    gains = named(gain, gain, 2)
    found = jaxstab.joints(mujoco.MjModel.from_xml_string(text), **HELD, gains=gains, postures=2)
    assert found.together.verdict == Verdict.UNDECIDED
    assert not found.all_stable


def test_of_many_states_the_lightest_postures_are_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    model = mujoco.MjModel.from_xml_string(chain(3, 30.0, 1.3))
    whole = jaxstab.joints(model, **HELD, postures=99)
    monkeypatch.setattr("jaxstab.lab.joints.robot._MOST_WORK", 20.0 * 12**3)  # of 12 states
    part = jaxstab.joints(model, **HELD, postures=99)
    assert part.together.spectral_radius == whole.together.spectral_radius > 1.0
    assert part.together.postures == 20
    assert "computed at the 20 lightest of 99 postures: unstable" in str(part)


def test_without_gains_there_is_no_answer_for_all_joints() -> None:
    answer = jaxstab.joints(mujoco.MjModel.from_xml_string(chain(2, 0.0, 0.0)), **HELD)
    assert answer.together is None
    assert "at once" not in str(answer)
    assert "together" not in answer.as_json()
    safe = jaxstab.joints(
        mujoco.MjModel.from_xml_string(chain(2, 0.0, 0.0)), **HELD, gains=answer.safe_gains()
    )
    assert safe.all_stable
