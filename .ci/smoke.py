"""What an installed jaxstab must answer, wherever it is installed: python -W error .ci/smoke.py.

It needs nothing but the package and its dependencies, and runs outside of the repository.
"""

import sys
import tempfile
from operator import attrgetter
from pathlib import Path

import jax
import numpy as np
from click.testing import CliRunner

import jaxstab
from jaxstab.app.cli.main import main

REPOSITORY = Path(__file__).resolve().parents[1]


def names() -> None:
    """Every public name is there, and each one that computes answers a good call."""
    sys.path.append(str(REPOSITORY / "tests"))  # after what is installed
    from calls import COMPUTING_CALLS, PUBLIC, outcome  # type: ignore[import-not-found]

    for name in PUBLIC:
        attrgetter(name)(jaxstab)
    for name in COMPUTING_CALLS:
        said = outcome(name)
        assert "Error: " not in said, (name, said)


def commands() -> None:
    """The commands that a first user gives."""
    scene = str(REPOSITORY / "data" / "scenes" / "omega.toml")
    golden = str(REPOSITORY / "data" / "golden" / "atlas-v5.h5")
    point = [
        "--alpha",
        "0.05",
        "--beta",
        "0.3",
        "--gamma",
        "0.0005",
        "--delta",
        "0.01",
        "--delay",
        "1",
    ]
    with tempfile.TemporaryDirectory() as folder:
        picture = str(Path(folder) / "limits.png")
        for command, code in (
            (["limits", scene, "--plot", picture], 1),  # one of its walls is outside
            (["atlas", "query", golden, *point], 0),
            (["scene", "presets"], 0),
            (["files", "check_wall.py"], 0),
            (["files", "jaxstab_query.c"], 0),
        ):
            result = CliRunner().invoke(main, command)
            assert result.exit_code == code, result.output


def answers() -> None:
    """Numbers in, NumPy out; and the same by JAX."""
    loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3, delay=1e-3)
    assert loop.verdict(2000.0, 20.0) == jaxstab.Verdict.STABLE
    assert "N/m" in repr(loop.region())
    assert "<img" in loop.region()._repr_html_()
    device = jaxstab.Device.mass_spring_damper(0.1, damping=1.5).with_actuator(500.0)
    general = jaxstab.HapticLoop(device=device, sample_time=1e-3, delay=1e-3)
    assert general.limits().stiffness < loop.limits().stiffness
    jax.config.update("jax_enable_x64", True)
    alpha = np.linspace(0.0, 0.2, 101)
    radii = jaxstab.spectral_radius(alpha, 0.2, gamma=0.0, delta=0.015, delay=1.0).value
    traced = jax.jit(
        lambda a: jaxstab.spectral_radius(a, 0.2, gamma=0.0, delta=0.015, delay=1.0).value
    )(alpha)
    assert np.allclose(radii, traced, rtol=0.0, atol=1e-12)


def batches() -> None:
    """Many loops are answered by compiled programs."""
    masses = np.linspace(0.1, 0.5, 64)
    loops = jaxstab.HapticLoop(device_mass=masses, device_damping=1.5, sample_time=1e-3, delay=1e-3)
    limits = jaxstab.limits_of(loops)
    own = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3, delay=1e-3)
    assert np.isclose(limits.stiffness[0], own.limits().stiffness, rtol=1e-9)
    assert np.all(jaxstab.regions_of(loops).area > 0.0)


def atlas() -> None:
    """An atlas is built and asked."""
    spec = jaxstab.AtlasSpec(gamma=(0.0,), delta=(0.015,), delay=(1.0,))
    with tempfile.TemporaryDirectory() as folder:
        built = jaxstab.build_atlas(spec, Path(folder) / "atlas.h5")
        answer = built.query(0.05, 0.3, gamma=0.0, delta=0.015, delay=1.0)
        assert answer.verdict == jaxstab.Verdict.STABLE


names()
commands()
answers()
batches()
atlas()
