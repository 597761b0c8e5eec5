"""The command for the joints of a robot file."""

import json
from pathlib import Path
from typing import Any

import click

from jaxstab.cli.options import file_in, file_option, print_with_csv, write_beside


@click.command()
@click.argument("robot", type=Path)
@click.option("--rate", type=float, help="Of the controller in Hz.")
@click.option("--delay", type=float, default=0.0, help="From sample to torque in s; default: 0.")
@click.option("--jitter", type=float, default=0.0, help="By which the delay varies, in s.")
@click.option("--cutoff", type=float, help="Low pass of the velocity in Hz; default: none.")
@click.option("--gains", type=Path, help="YAML file: kp and kd by the names of joints.")
@click.option("--simulated", is_flag=True, help="Take the file's own step and integrator.")
@file_option("--csv", "csv_file", help="CSV file ('-': stdout), a row for each joint.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@file_option(
    "--safe-gains", check=file_in(".yaml", ".yml"), help="YAML file of safe gains to write."
)
def joints(
    robot: Path,
    cutoff: float | None,
    gains: Path | None,
    csv_file: Path | None,
    as_json: bool,
    safe_gains: Path | None,
    **asked: Any,
) -> int:
    """Judge kp and kd of each joint of a ROBOT (MJCF or URDF).

    For every inertia that a joint has over its postures. Gains are those of the file's position
    actuators, or of --gains. With --simulated and no --rate they are inside of the simulation's
    step. The exit code is 0 if all gains are proved stable, 1 if not, or if no joint has any.
    """
    import jaxstab
    from jaxstab.scene.joints import read_gains

    velocity = None if cutoff is None else jaxstab.Velocity.low_pass(cutoff)
    own = None if gains is None else read_gains(gains)
    answer = jaxstab.joints(robot, gains=own, velocity=velocity, **asked)
    if safe_gains:
        write_beside(answer.as_yaml().encode(), safe_gains)
    words = json.dumps(answer.as_json(), indent=1) if as_json else str(answer)
    print_with_csv(words, answer.rows(), csv_file)
    return 0 if answer.all_stable else 1
