"""Contacts as labelled tables: those of the arrays, in any blocks, with names, units and codes."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray
from commands import assert_one_sentence, run

import jaxstab
from jaxstab import HapticLoop, Velocity
from jaxstab.lab.contact import table as maps
from jaxstab.lab.contact.table import plan_contacts
from jaxstab.results import ContactKind

LOOP = HapticLoop(
    device_mass=0.25,
    device_damping=0.1,
    sample_time=1e-3,
    delay=1e-3,
    velocity=Velocity.difference(window=0.02),
)
WALLS = np.linspace(500.0, 6000.0, 7), np.linspace(2.0, 40.0, 9)
GIVEN: dict[str, Any] = {"friction": [0.0, 0.1, 0.3], "push": 1.0, "duration": 0.3}

SCENE = """
[device]
inertia = 0.002
damping = 0.001
[controller]
sample_time = 0.001
[contact]
push = 0.05
duration = 0.2
"""


def table(**options: Any) -> xarray.Dataset:
    return jaxstab.contact_table(LOOP, *WALLS, **{**GIVEN, **options})


def test_a_table_holds_the_contacts_of_arrays_in_any_blocks(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    K, B, friction = np.ix_(*WALLS, GIVEN["friction"])
    plain = jaxstab.contact(LOOP, K, B, **{**GIVEN, "friction": friction}, path=False)
    whole = table()
    for name in plain._fields[:-1]:
        np.testing.assert_array_equal(whole[name], getattr(plain, name))
    monkeypatch.setattr(maps, "_BLOCK", 30 * 300)
    monkeypatch.setattr(maps, "_LEAST", 1)
    planned = plan_contacts(LOOP, {"stiffness": WALLS[0], "damping": WALLS[1], **GIVEN})
    assert max(planned.chunks["stiffness"]) == 1
    assert table().identical(whole)


def test_dimensions_units_and_codes_have_names() -> None:
    made = table()
    assert dict(made.sizes) == {"stiffness": 7, "damping": 9, "friction": 3}
    assert made.sel(friction=0.1).amplitude.dims == ("stiffness", "damping")
    assert made.penetration.units == "m"
    assert made.stiffness.attrs == {"long_name": "stiffness of the virtual wall", "units": "N/m"}
    words = dict(zip(made.kind.flag_values, made.kind.flag_meanings.split(), strict=True))
    assert words == {kind.value: kind.name.lower() for kind in ContactKind}
    assert "nothing is proved" in made.title
    assert made.loop == repr(LOOP)
    assert "push=1.0" in made.conditions


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"stiffness": 1000.0, "damping": 10.0, "friction": 0.1}, "no argument is a list"),
        ({"stiffness": np.ones((2, 2)), "damping": 1.0}, r"stiffness has the shape \(2, 2\); give"),
        ({"stiffness": [], "damping": 1.0}, r"stiffness has the shape \(0,\); give"),
        ({"stiffness": [1.0, np.nan], "damping": 1.0}, "stiffness is nan"),
        ({"stiffness": [1.0, 2.0], "damping": 1.0, "friction": 0.0, "push": 0.0}, "nothing moves"),
    ],
)
def test_what_is_no_table_is_refused(given: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words) as refusal:
        jaxstab.contact_table(LOOP, **{**GIVEN, **given})
    assert "\n" not in str(refusal.value)


def test_the_command_stores_a_map_in_the_units_of_its_scene(tmp_path: Path) -> None:
    scene, path = tmp_path / "scene.toml", tmp_path / "map.h5"
    scene.write_text(SCENE)
    words = ("contact", scene, "-o", path, "--count", "6", "--frictions", "0:0.01:3")
    done = run(*words)
    assert done.exit_code == 0, done.stderr
    assert "6 stiffness x 6 damping x 3 friction: 108 contacts of 0.2 s" in done.stderr
    opened = xarray.load_dataset(path, engine="h5netcdf")
    assert opened.stiffness.units == "N m/rad"
    assert opened.friction.units == "N m"
    assert opened.amplitude.units == "rad"
    share = 100.0 * float(np.mean(opened.kind == ContactKind.RESTS))
    assert done.stdout == f"{path}: {share:.1f} % of the contacts come to rest\n"
    again = run(*words)
    assert (again.exit_code, again.stdout) == (2, "")
    assert_one_sentence(again.stderr, f"{path} exists")
    for more, said in (
        (("--plot", tmp_path / "a.png"), "--plot is given beside --output; give one of them"),
        ((scene,), "a map is for one scene; give one FILE"),
    ):
        refused = run(*words, *more)
        assert (refused.exit_code, refused.stdout) == (2, "")
        assert said in refused.stderr
    path.unlink()
    for more, said in (
        (("--frictions", "a,b"), "friction is ['a', 'b']; give real numbers"),
        (("--count", "100000000"), "100000000 is not in the range 2<=x<=10000"),
    ):
        assert said in run(*words, *more).stderr
