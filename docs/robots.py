"""The table of docs/robots.md: joints of robots from packages that ship their files.

python -m pip install --no-deps --target robots robosuite dm-control example-robot-data
PYTHONPATH=robots python -m docs.robots

writes the record to benchmarks/results and the table into the page.
"""

from importlib.metadata import distribution, version
from pathlib import Path
from time import process_time

import jaxstab
from benchmarks import record
from benchmarks.table import of_cells, put_between
from jaxstab.results import Joints

PAGE = Path(__file__).with_suffix(".md")
MARKER = "written by python -m docs.robots: {} {}"
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


def row(robot: str, package: str, file: str) -> record.Row:
    answer, has_own, seconds = asked(file)
    joints = answer.joints.values()
    judged = [joint for joint in joints if joint.kp_growth is not None]
    left_out = sum(isinstance(joint.verdict, str) and joint.kp_growth is None for joint in joints)
    if has_own:
        left_out -= sum(joint.verdict == "no gains" for joint in joints)
    asked_for = judged or [joint for joint in joints if joint.verdict != "it moves freely"]
    simulated = None
    if has_own:
        of_file = jaxstab.joints(file, simulated=True).joints.values()
        simulated = sum(joint.is_stable for joint in of_file)
    return {
        "robot": robot,
        "package": package,
        "joints": len(joints),
        "judged": len(judged),
        "left_out": left_out,
        "least_inertia": min(joint.inertia[0] for joint in asked_for),
        "greatest_inertia": max(joint.inertia[1] for joint in asked_for),
        "has_own_gains": has_own,
        **GAINS,
        "stable": sum(joint.is_stable for joint in judged),
        "missing_armature": max((joint.missing_armature for joint in judged), default=0.0),
        "simulated_stable": simulated,
        "cpu_seconds": seconds,
        "mujoco": version("mujoco"),
    }


def table(rows: list[record.Row]) -> str:
    lines = []
    for one in rows:
        missing, simulated = one["missing_armature"], one["simulated_stable"]
        cells = (
            *(one[key] for key in ("robot", "package", "joints", "judged", "left_out")),
            f"{one['least_inertia']:.1e} to {one['greatest_inertia']:.1e}",
            "its own" if one["has_own_gains"] else f"{one['kp']:g}, {one['kd']:g}",
            one["stable"],
            f"{missing:.1e}" if missing else "0",
            "-" if simulated is None else simulated,
            f"{one['cpu_seconds']:.1f}",
        )
        lines.append([str(cell) for cell in cells])
    heading = (
        *("robot", "package", "joints", "judged", "left out", "inertia (kg m², kg)", "kp, kd"),
        *("stable", "missing armature, at most", "stable in the file's own step", "CPU s"),
    )
    return of_cells(heading, lines)


def main() -> None:
    rows = []
    for name, robots in ROBOTS.items():
        package = distribution(name)
        files = [str(package.locate_file(path)) for path in package.files or ()]
        for robot, ending in robots.items():
            file = next(path for path in files if path.endswith(ending))
            rows.append(row(robot, f"{name} {package.version}", file))
            print(rows[-1], flush=True)
    record.write(record.new_record("robots", False, rows), record.RESULTS)
    put_between(PAGE, MARKER, {"robots": table(rows)})


if __name__ == "__main__":
    main()
