"""Print the table of docs/robots.md: joints of robots from packages that ship their files.

python -m pip install --no-deps --target robots robosuite dm-control example-robot-data
PYTHONPATH=robots python docs/robots.py
"""

from importlib.metadata import distribution
from time import process_time

import mujoco

import jaxstab
from jaxstab.results import Joints

LOOP = {"rate": 500.0, "delay": 2e-3}
GAINS = {"kp": 40.0, "kd": 2.0}  # of files that have none
ROBOTS = {
    "robosuite": {
        "UR5e": "robots/ur5e/robot.xml",
        "Panda": "robots/panda/robot.xml",
        "GR1": "robots/gr1/robot.xml",
        "Fourier hand": "grippers/fourier_left_hand.xml",
        "Inspire hand": "grippers/inspire_left_hand.xml",
        "Robotiq 2F-140": "grippers/robotiq_gripper_140.xml",
    },
    "dm-control": {
        "humanoid": "suite/humanoid.xml",
        "quadruped": "suite/quadruped.xml",
        "rodent": "walkers/assets/rodent.xml",
        "fruit fly": "walkers/assets/fruitfly_v2/fruitfly.xml",
    },
    "example-robot-data": {
        "UR10": "urdf/ur10_robot.urdf",
        "G1, 29 axes": "urdf/g1_29dof_rev_1_0.urdf",
        "Go2": "urdf/go2.urdf",
        "SO-101": "urdf/so101.urdf",
        "Solo 12": "robots/solo12.urdf",
        "TALOS, reduced": "robots/talos_reduced.urdf",
        "TIAGo Pro": "robots/tiago_pro.urdf",
    },
}


def asked(file: str) -> tuple[Joints, bool, float]:
    """The answer, with the gains of the file if it has any, and the seconds that it took."""
    start = process_time()
    answer = jaxstab.joints(file, **LOOP)
    has_own = any(joint.kp is not None for joint in answer.joints.values())
    if not has_own:
        own = {name: GAINS for name, joint in answer.joints.items() if joint.verdict == "no gains"}
        start = process_time()
        answer = jaxstab.joints(file, **LOOP, gains=own)
    return answer, has_own, process_time() - start


def row(robot: str, package: str, file: str) -> str:
    answer, has_own, seconds = asked(file)
    joints = answer.joints.values()
    judged = [joint for joint in joints if joint.kp_growth is not None]
    left_out = sum(isinstance(joint.verdict, str) and joint.kp_growth is None for joint in joints)
    if has_own:
        left_out -= sum(joint.verdict == "no gains" for joint in joints)
    asked_for = judged or [joint for joint in joints if joint.verdict != "it moves freely"]
    light = min(joint.inertia[0] for joint in asked_for)
    heavy = max(joint.inertia[1] for joint in asked_for)
    missing = max((joint.missing_armature for joint in judged), default=0.0)
    inside = "-"
    if has_own:
        try:
            simulated = jaxstab.joints(file, simulated=True).joints.values()
            inside = str(sum(joint.is_stable for joint in simulated))
        except ValueError:
            inside = "RK4"
    cells = [
        robot,
        package,
        len(joints),
        len(judged),
        left_out,
        f"{light:.1e} to {heavy:.1e}",
        "its own" if has_own else "40, 2",
        sum(joint.is_stable for joint in judged),
        f"{missing:.1e}" if missing else "0",
        inside,
        f"{seconds:.1f}",
    ]
    return f"| {' | '.join(map(str, cells))} |"


if __name__ == "__main__":
    print(f"MuJoCo {mujoco.__version__}")
    for name, robots in ROBOTS.items():
        package = distribution(name)
        files = [str(package.locate_file(path)) for path in package.files or ()]
        for robot, ending in robots.items():
            file = next(path for path in files if path.endswith(ending))
            print(row(robot, f"{name} {package.version}", file), flush=True)
