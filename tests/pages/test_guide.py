"""The guide from a device to a guard in C: its scene, its commands and its C."""

import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
from commands import run

GUIDE = Path(__file__).parents[2] / "docs" / "guide.md"
CALLER = """
#include <stdio.h>
int main(void)
{
    printf("%.1f ", wall_force(-1e-3, 0.0, 1000.0, 10.0));
    printf("%.1f ", wall_force(-1e-3, 0.0, 1e9, 10.0)); /* the gains of the contact are kept */
    wall_force(1e-3, 0.0, 1000.0, 10.0);
    printf("%.1f\\n", wall_force(-1e-3, 0.0, 1e9, 10.0));
    return 0;
}
"""


def blocks(language: str) -> list[str]:
    pattern = rf"^```{language}\n(.*?)^```"
    return re.findall(pattern, GUIDE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


WHEEL = """
[device]
inertia = 0.02
damping = 0.02
encoder.resolution = 1e-4

[hand]
inertia = [0.0, 0.05]
stiffness = [0.0, 20.0]
damping = [0.0, 0.8]

[controller]
sample_time = 1e-3
delay_samples = 2.0
velocity.window = 0.005

[walls]
soft = { stiffness = 100.0, damping = 1.0 }
"""


@pytest.mark.campaign
def test_the_guide_leads_a_steering_wheel_to_a_program_in_c(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every command of the guide but `tune`, which is the same for all scenes and takes long."""
    monkeypatch.chdir(tmp_path)
    Path("my_device.toml").write_text(WHEEL, encoding="utf-8")
    said = ""
    for line in "".join(blocks("sh")).splitlines():
        _, *arguments = shlex.split(line, comments=True)
        if arguments[0] == "tune":
            continue
        own = arguments[: arguments.index("--mass")] if "--mass" in arguments else arguments
        answer = run(*("20" if word == "200" else word for word in own))  # draws
        assert answer.exit_code == 0, answer.stderr
        said += answer.stdout
    assert "506.7 N m/rad" in said
    assert granted(said) > 70.0  # a delay that moves by a whole sample
    (source,) = blocks("c")
    wheel = source.replace("mass = 0.25;", "mass = 0.02;")
    forces = forces_of(wheel + CALLER.replace("1000.0, 10.0", "100.0, 1.0"))
    assert forces[:2] == [0.1, 0.1]  # the wall was granted, for the whole contact
    assert 0.1 < forces[2] < 0.6  # it was lowered


def granted(said: str) -> float:
    """The share of the stable stiffness in percent that the command tells."""
    return float(said.split("It grants ")[1].split(" %")[0])


def forces_of(source: str) -> list[float]:
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("there is no C compiler here")
    Path("loop.c").write_text(source, encoding="utf-8")
    options = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-o", "loop"]
    subprocess.run([compiler, *options, "loop.c"], check=True)
    done = subprocess.run(["./loop"], capture_output=True, text=True, check=True)
    return [float(word) for word in done.stdout.split()]


@pytest.mark.campaign
def test_the_guide_leads_from_a_scene_to_a_program_in_c(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (scene,) = blocks("toml")
    Path("my_device.toml").write_text(scene, encoding="utf-8")
    said = ""
    for line in "".join(blocks("sh")).splitlines():
        _, *arguments = shlex.split(line, comments=True)
        answer = run(*arguments)
        assert answer.exit_code == 0, answer.stderr
        said += answer.stdout
    for promised in ("1824 N/m", "settling time (2 %)"):
        assert promised in said
    (source,) = blocks("c")
    forces = forces_of(source + CALLER)
    assert forces[:2] == [1.0, 1.0]  # the wall was granted, for the whole contact
    assert 1.0 < forces[2] < 2.0  # it was lowered
