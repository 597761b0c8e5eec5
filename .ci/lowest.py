"""Print the lowest version of each dependency that pyproject.toml names, as requirements."""

import tomllib
from pathlib import Path

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))

for requirement in PROJECT["project"]["dependencies"]:
    print(requirement.replace(">=", "=="))
