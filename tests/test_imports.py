"""What importing jaxstab loads, and that all of it is there."""

import subprocess
import sys
from operator import attrgetter
from pathlib import Path

import pytest
from calls import PUBLIC

import jaxstab

ROOT = Path(__file__).resolve().parents[1]


def run_python(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )


def loaded_by(module: str) -> set[str]:
    """The modules that a fresh interpreter holds after importing this one."""
    completed = run_python("-c", f"import sys, {module}; print(*sys.modules)")
    assert completed.returncode == 0, completed.stderr
    return set(completed.stdout.split())


@pytest.mark.parametrize(
    "package",
    [
        "",
        ".model",
        ".exact",
        ".point",
        ".region",
        ".boxes",
        ".paper",
        ".atlas",
        ".results",
    ],
)
def test_importing_a_package_loads_nothing_heavy(package: str) -> None:
    loads = loaded_by(f"jaxstab{package}")
    assert loads.isdisjoint({"jax", "numpy", "h5py", "matplotlib", "pydantic"})


@pytest.mark.parametrize("module", ["file", "query", "table"])
def test_the_reader_of_an_atlas_loads_no_jax(module: str) -> None:
    assert loaded_by(f"jaxstab.atlas.{module}").isdisjoint({"jax", "jaxlib", "matplotlib"})


@pytest.mark.parametrize("name", PUBLIC)
def test_every_public_name_can_be_imported(name: str) -> None:
    assert attrgetter(name)(jaxstab) is not None


@pytest.mark.campaign
def test_all_of_it_is_there_without_docstrings() -> None:
    code = (
        "import importlib, pkgutil, jaxstab\n"
        "modules = pkgutil.walk_packages(jaxstab.__path__, 'jaxstab.')\n"
        "names = [m.name for m in modules if not m.name.endswith('__main__')]\n"
        "print(len([*map(importlib.import_module, names)]))\n"
        "print(len([getattr(jaxstab, name) for name in dir(jaxstab)]))\n"
    )
    done = run_python("-OO", "-c", code)
    assert done.returncode == 0, done.stderr
    modules, names = map(int, done.stdout.split())
    assert modules > 100
    assert names == len(dir(jaxstab))
    device = ["--mass", "0.3", "--damping", "0.2", "--sample-time", "0.001", "--delay", "0.001"]
    limits = run_python("-OO", "-m", "jaxstab", "limits", *device)
    assert (limits.returncode, limits.stderr) == (0, "")
    assert "largest stiffness" in limits.stdout
