"""The guide from a device to a guard in C: its scene, its commands and its C."""

import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
from commands import run

GUIDE = Path(__file__).parents[1] / "docs" / "guide.md"
CALLER = """
#include <stdio.h>
int main(void)
{
    printf("%.1f %.1f\\n", wall_force(-1e-3, 0.0, 1000.0, 10.0), wall_force(-1e-3, 0.0, 1e9, 10.0));
    return 0;
}
"""


def blocks(language: str) -> list[str]:
    pattern = rf"^```{language}\n(.*?)^```"
    return re.findall(pattern, GUIDE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


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
        assert answer.exit_code == int(arguments[0] == "tune"), answer.stderr  # over ranges
        said += answer.stdout
    for promised in ("1823 N/m", "1844 N/m", "settled, and proved to stay so"):
        assert promised in said
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("there is no C compiler here")
    (source,) = blocks("c")
    Path("loop.c").write_text(source + CALLER, encoding="utf-8")
    options = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-o", "loop"]
    subprocess.run([compiler, *options, "loop.c"], check=True)
    forces = subprocess.run(["./loop"], capture_output=True, text=True, check=True).stdout.split()
    assert float(forces[0]) == 1.0  # the wall was granted
    assert 1.0 < float(forces[1]) < 2.0  # it was lowered
