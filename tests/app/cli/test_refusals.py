"""Input without end, too large or unprintable is refused."""

import csv
import io
import json
import os
import subprocess
import sys
import zipfile
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from commands import START, assert_one_sentence, run, run_code, run_process

import jaxstab
from jaxstab.app.scene import Scene
from jaxstab.tables import MOST_BYTES, MOST_LETTERS, checked_label

ROOT = Path(__file__).parents[3]
ATLAS = ROOT / "data" / "golden" / "atlas-v5.h5"
LOOP = ["--mass", "0.25", "--damping", "0.1", "--sample-time", "0.001"]
A_WALL = ["--wall", "a", "10", "1"]
TABLE = {
    "device": {"mass": 0.25, "damping": 0.1},
    "controller": {"sample_time": 1e-3, "delay_samples": 1.0},
}
WALL = {"stiffness": 1000.0, "damping": 10.0}


def scene_text(*walls: str) -> str:
    lines = ["[device]", "mass = 0.25", "damping = 0.1", "[controller]", "sample_time = 0.001"]
    for wall in walls:
        lines += [f"[walls.{wall}]", "stiffness = 1000.0", "damping = 10.0"]
    return "\n".join(lines)


# ----------------------------------------------------------------------------- 29: without end


@pytest.mark.parametrize(
    "command",
    [
        ["limits", "/dev/zero"],
        ["atlas", "build", "--spec", "/dev/zero"],
        ["atlas", "query", str(ATLAS), "--csv", "/dev/zero"],
    ],
    ids=lambda command: command[0],
)
def test_a_file_without_end_is_refused(command: list[str]) -> None:
    done = run_process(*command)
    assert done.returncode in (1, 2)
    assert_one_sentence(done.stderr)
    assert "/dev/zero has more than" in done.stderr


@pytest.mark.campaign
def test_a_toml_file_of_100_mb_is_refused_unread(tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    file.write_text(scene_text())
    with file.open("r+b") as stream:
        stream.truncate(100_000_000)
    done = run("limits", file)
    assert done.exit_code == 2
    assert_one_sentence(done.stderr, file, "4 MB")
    comments = "#\n" * ((MOST_BYTES - len(scene_text()) - 1) // 2)
    file.write_text(f"{scene_text()}\n{comments}")
    assert run("limits", file).exit_code == 0


def test_a_hundred_thousand_walls_are_refused() -> None:
    walls = {f"w{number}": WALL for number in range(100_000)}
    with pytest.raises(ValueError, match="walls has 100000 entries; give 1000 at most"):
        Scene.from_table(TABLE | {"walls": walls})


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (["check", *LOOP, "--delay-samples", "1024", *A_WALL], "at most 500 sam"),
        (
            ["check", *LOOP, "--delay-samples", "129", "--hand-mass", "0:1", *A_WALL],
            "129 samples beside a range of hands; give at most 128 samples, or one hand",
        ),
        (["study", *LOOP, "--over", "device.mass=1,2", "--workers", "99999999999"], "<=x<=1000"),
        (["atlas", "build", "--workers", "99999999999"], "is not in the range 1<=x<=1000"),
        (["guard", *LOOP, "-o", "g.h", "--delay", "0:1e9"], "give at most 500 samples"),
        (["guard", *LOOP, "-o", "g.h", "--cells", "1048576,1024,1024"], "give fewer"),
        (["guard", *LOOP, "-o", "g.h", "--cells", "64,64,64"], "may have 166666 numbers"),
        (["atlas", "verify", str(ATLAS), "--sample", "1000000000"], "not in the range"),
    ],
    ids=lambda value: " ".join(value[:1]) if isinstance(value, list) else "",
)
def test_what_would_take_too_long_is_refused_at_the_door(
    command: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = run(*command)
    assert done.exit_code == 2
    assert_one_sentence(done.stderr)
    assert words in done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", ["limits", "check", "tune"])
@pytest.mark.parametrize("count", [20, 1000])
def test_a_device_of_many_modes_is_refused_before_its_polynomials_are_multiplied(
    command: str, count: int, tmp_path: Path
) -> None:
    mode = "[[device.modes]]\nfrequency = {}.0\ndamping_ratio = 0.01\nmodal_mass = 1.0\n"
    modes = "".join(mode.format(50 + number) for number in range(count))
    file = tmp_path / "scene.toml"
    file.write_text(scene_text("a").replace("[controller]", f"{modes}[controller]"))
    done = run(command, file)
    assert (done.exit_code, done.stdout) == (2, "")
    assert_one_sentence(done.stderr)
    assert f"modes has {count} modes; give 19 at most." in done.stderr


def test_a_user_without_a_home_directory_has_no_cache(tmp_path: Path) -> None:
    start = f"import pwd; pwd.getpwuid = lambda user: {{}}[user]; {START}"  # an unknown user
    command = ["study", *LOOP, "--over", "device.mass=0.1,0.2"]
    names = "HOME", "XDG_CACHE_HOME", "LOCALAPPDATA", "JAX_COMPILATION_CACHE_DIR"
    done = subprocess.run(
        [sys.executable, "-c", start, *command],
        capture_output=True,
        text=True,
        env={name: value for name, value in os.environ.items() if name not in names},
        cwd=tmp_path,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "largest stiffness" in done.stdout
    assert not list(tmp_path.iterdir())


# ------------------------------------------------------------------------------------ 30: names

NO_NAMES = [
    "",
    " a",
    "a\nverdict                           stable",
    "\x1b[31mred",
    "a\u202eb",
    "a\udcff",
    "=1+2",
    "+1",
    "-1",
    "@SUM(1)",
    "_hidden",
    "a" * (MOST_LETTERS + 1),
]


@pytest.mark.parametrize("name", NO_NAMES, ids=ascii)
def test_a_name_that_commands_a_terminal_or_a_spreadsheet_is_refused(
    name: str,
) -> None:
    for done in (
        run("check", *LOOP, "--wall", name, "1000", "10"),
        run("limits", *LOOP, "--wall", name, "1000", "10", "--csv", "-"),
    ):
        assert done.exit_code == 2
        assert_one_sentence(done.stderr)
        assert "the name of a wall is" in done.stderr
        assert done.stderr[:-1].isprintable()
    with pytest.raises(ValueError, match="the name of a wall is"):
        Scene.from_table(TABLE | {"walls": {name: WALL}})


@pytest.mark.parametrize("name", ["größe", "壁", "soft wall (5 N)", "1 = a", "a" * MOST_LETTERS])
def test_other_names_are_allowed(name: str) -> None:
    assert checked_label(name) == name


def test_keys_of_a_file_reach_the_terminal_in_one_line(tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    file.write_text('"mass\\nverdict: stable\\u001b[31m" = 1\n' + scene_text())
    done = run("limits", file)
    assert done.exit_code == 2
    assert_one_sentence(done.stderr)
    assert done.stderr[:-1].isprintable()
    two = run("limits", file, file)
    assert two.exit_code == 2
    assert "\x1b" not in two.stdout + two.stderr


def test_a_csv_file_holds_no_formula(tmp_path: Path) -> None:
    file = tmp_path / "=1+2.toml"
    file.write_text('"=1+2" = 1\n' + scene_text())
    good = tmp_path / "good.toml"
    good.write_text(scene_text("a"))
    done = subprocess.run(
        [sys.executable, "-c", START, "limits", file.name, good.name, "--csv", "-"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    rows = list(csv.reader(io.StringIO(done.stdout)))
    assert len(rows) == 3
    assert rows[1][0] == "'=1+2.toml"
    assert rows[1][-1].startswith("'=1+2 is unknown")
    assert rows[2][0] == "good.toml"
    for cell in (cell for row in rows for cell in row):
        assert not cell.startswith(("=", "+", "@")), cell


@pytest.mark.campaign
def test_a_dollar_sign_of_a_name_begins_no_formula(tmp_path: Path) -> None:
    picture = tmp_path / "scene.svg"
    done = run("check", *LOOP, "--wall", r"a $\frac{$", "1000", "10", "--plot", picture)
    assert done.exit_code == 0, done.stderr
    assert picture.stat().st_size > 10_000


@pytest.fixture(scope="module")
def guard() -> jaxstab.results.Guard:
    loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
    ranges = {"mass": (0.24, 0.26), "delay": (1e-3, 1.1e-3), "cells": (1, 1, 4)}
    return jaxstab.build_guard(loop, jaxstab.HandRange(), **ranges, constant_delay=True)


@pytest.mark.parametrize(
    "about", ["**// int injected;", "*/ int injected;", "*/", "a\x00b", "a\x1b[31m", "a\rb"]
)
def test_what_a_guard_is_about_stays_in_its_comment(
    about: str, guard: jaxstab.results.Guard
) -> None:
    with pytest.raises(ValueError, match="about is "):
        guard.header("g", about)
    with pytest.raises(ValueError, match="units is "):
        guard.header("g", "", ("kg", "N/m */ int injected; /*", "N s/m"))
    header = guard.header("g", "two\nlines: /* and //")
    assert " * two\n * lines: /* and //\n" in header


# ------------------------------------------------------------------------------------ 31: words


def test_the_package_runs_as_a_module() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "jaxstab", "--version"], capture_output=True, text=True, check=False
    )
    assert done.stdout == f"jaxstab, version {jaxstab.__version__}\n", done.stderr


@pytest.mark.campaign
def test_a_zip_file_on_the_path_can_be_imported(tmp_path: Path) -> None:
    """As it is in a wheel; its dependencies are installed."""
    wheel = tmp_path / "jaxstab.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        for folder, place in ((ROOT / "jaxstab", ""), (ROOT / "data" / "presets", "jaxstab/")):
            for file in folder.rglob("*"):
                if file.is_file() and "__pycache__" not in file.parts:
                    archive.write(file, place + str(file.relative_to(folder.parent)))
    for words in (
        ["-c", "import jaxstab; print(jaxstab.__file__, jaxstab.margins, *dir(jaxstab.loop))"],
        ["-m", "jaxstab", "limits", "--device", "omega", "--sample-time", "0.001"],
        ["-m", "jaxstab", "scene", "presets"],
    ):
        done = subprocess.run(
            [sys.executable, *words],
            capture_output=True,
            text=True,
            cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": str(wheel)},
            check=False,
        )
        assert done.returncode == 0, done.stderr
    here = subprocess.run(
        [sys.executable, "-c", "import jaxstab; print(jaxstab.__file__)"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(wheel)},
        check=True,
    )
    assert here.stdout.startswith(str(wheel))


def test_numbers_of_5000_digits_are_refused_in_words(tmp_path: Path) -> None:
    digits = "9" * 5000
    file = tmp_path / "scene.toml"
    file.write_text(scene_text().replace("0.25", digits))
    for done in (
        run("limits", file),
        run("study", *LOOP, "--over", f"device.mass=0.1:0.2:{digits}"),
        run("limits", *LOOP, "--wall", "a", digits, "1"),
        run("guard", *LOOP, "-o", tmp_path / "g.h", "--cells", f"1,1,{digits}"),
    ):
        assert done.exit_code == 2
        assert_one_sentence(done.stderr)
        assert "set_int_max_str_digits" not in done.stderr
        assert len(done.stderr) < 400
    many = 10**5000
    with pytest.raises(TypeError, match="alpha is a whole number of thousands of digits"):
        jaxstab.verdict(many, 0.2, gamma=0.0, delta=0.0, delay=0.0)
    with pytest.raises(ValueError, match="samples is a whole number of thousands of digits"):
        jaxstab.Velocity.difference(many)
    with pytest.raises(ValueError, match=r"device\.mass is a whole number of thousands of digits"):
        Scene.from_table(TABLE | {"device": {"mass": many, "damping": 0.1}})


def test_stdout_that_is_full_is_named() -> None:
    for words in (["limits", *LOOP], ["limits", *LOOP, "--csv", "-"]):
        done = subprocess.run(
            ["sh", "-c", '"$@" > /dev/full', "sh", sys.executable, "-c", START, *words],
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode in (1, 2)
        assert_one_sentence(done.stderr, "stdout", "No space left on device")


@pytest.mark.campaign
def test_names_reach_a_stdout_of_ascii(tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    file.write_text(scene_text('"größe"'), encoding="utf-8")
    spec = tmp_path / "spec.toml"
    spec.write_text(run("atlas", "spec", "--scene", file).stdout, encoding="utf-8")
    for words in (
        ["check", str(file)],
        ["limits", str(file), "--csv", "-"],
        ["atlas", "query", str(ROOT / "data/golden/atlas-v5.h5"), "--scene", str(file)],
    ):
        done = subprocess.run(
            [sys.executable, "-c", START, *words],
            capture_output=True,
            env=os.environ | {"PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0", "LC_ALL": "C"},
            check=False,
        )
        assert "codec" not in done.stderr.decode()
        assert done.returncode == 0, done.stderr


def test_a_file_that_is_not_utf_8_is_named_with_its_line(tmp_path: Path) -> None:
    file = tmp_path / "bad.toml"
    file.write_bytes(b"# a\n# \xff\n")
    for done in (run("limits", file), run("atlas", "build", "--spec", file)):
        assert done.exit_code in (1, 2)
        assert_one_sentence(done.stderr, file, "line 2", "UTF-8")


def test_a_scheduler_that_is_no_address_is_named() -> None:
    distributed = pytest.importorskip("distributed")
    from jaxstab.app.cli.options import _client

    with pytest.raises(ValueError, match="scheduler is 'inproc://'; give an address"):
        _client("inproc://")
    with suppress(TimeoutError):  # dask keeps it for all that this process computes
        distributed.default_client().close(timeout=0.1)


@pytest.mark.parametrize(
    ("given", "names"),
    [
        (["check", "--wall", "1000"], "NAME K B"),
        (["design", "--wall", "1000"], "NAME K B"),
        (["limits", "--gains", "40"], "K B"),
        (["limits", "--gains", "40", "soft"], "K B"),
        (["design", "--wall", "40", "2", "--for", "mass"], "NAME K B"),
    ],
)
def test_an_option_with_too_few_values_or_bad_ones_names_them(given: list[str], names: str) -> None:
    done = run(*given)
    assert done.exit_code == 2
    assert done.stderr.endswith(f" Its values are {names}.\n")


def test_an_atlas_is_asked_about_a_wall_beside_those_of_a_scene(tmp_path: Path) -> None:
    file, atlas = tmp_path / "scene.toml", ROOT / "data/golden/atlas-v5.h5"
    file.write_text(scene_text("soft"), encoding="utf-8")
    wall = ["--wall", "stiff", "1e9", "20"]
    done = run("atlas", "query", atlas, "--scene", file, *wall, "--format", "json")
    assert done.exit_code == 1
    points = json.loads(done.stdout)["points"]
    assert {point["wall"]: point["verdict"] for point in points}["stiff"] == "unstable"
    assert {point["wall"] for point in points} == {"soft", "stiff"}
    alone = run("atlas", "query", atlas, *wall)
    assert alone.exit_code == 2
    assert "give --scene FILE" in alone.stderr


@pytest.mark.campaign
def test_a_stream_that_takes_nothing_is_no_answer() -> None:
    no_file = ["limits", "none.toml"]
    for words, where in (
        (["limits", *LOOP], '"$@" | false'),
        (["limits", *LOOP, "--json", "--all"], '"$@" | false'),
        (no_file, '"$@" 2> /dev/full'),
        (no_file, '"$@" 2> >(false)'),
        (["limits", *LOOP, "--set", "wanted.tolerance=2"], '"$@" 2> /dev/full'),
    ):
        shell = ["bash", "-c", f"{where}; exit ${{PIPESTATUS[0]}}", "bash"]
        done = subprocess.run(
            [*shell, sys.executable, "-c", START, *words], capture_output=True, check=False
        )
        assert (done.returncode, done.stderr) == (2, b""), where


@pytest.mark.parametrize("option", [["--workers", "2"], ["--count", "9"], ["--scheduler", "a"]])
def test_an_option_of_a_map_of_contacts_is_refused_without_one(option: list[str]) -> None:
    answer = run("contact", *LOOP, "--push", "1", *option)
    assert (answer.exit_code, answer.stdout) == (2, "")
    assert_one_sentence(answer.stderr)
    assert f"{option[0]} is for a map; give --output, too." in answer.stderr


def test_a_masked_array_is_refused_wherever_numbers_are_given() -> None:
    masked = np.ma.array([1.0, -2.0, 0.5], mask=[0, 1, 0])
    plant = {"gamma": 0.0, "delta": 0.1, "delay": 0.0}
    loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
    for name, ask in (
        ("coefficients", lambda: jaxstab.is_schur(masked)),
        ("coefficients", lambda: jaxstab.radius([masked, masked])),
        ("coefficients", lambda: jaxstab.companion_matrix(masked)),
        ("alpha", lambda: jaxstab.verdict([masked, masked], 0.2, **plant)),
        ("alpha", lambda: jaxstab.verdict([[[0.1, 0.2, 0.3], masked]], 0.2, **plant)),
        ("alpha", lambda: jaxstab.evaluate_grid(jaxstab.verdict, masked, 0.2, **plant)),
        ("delay", lambda: jaxstab.limits_of(loop, delay=abs(masked))),
    ):
        with pytest.raises(TypeError, match=f"{name} is a masked array; give plain numbers"):
            ask()


OF_ANOTHER_KIND = """
import jaxstab
loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
ranges = {"mass": (0.2, 0.3), "delay": (0.0, 1e-3)}
sides = {"base": [1, -2, 1], "first": [1, 0], "second": [1, -1], "sample_time": 1.0}
over = {"device_mass": [0.1, 0.2]}
arm = jaxstab.Device.mass_spring_damper(0.25)
guard = jaxstab.build_guard(
    loop, jaxstab.HandRange(), mass=(0.24, 0.26), delay=(1e-3, 1.1e-3), cells=(1, 1, 4),
    constant_delay=True,
)
for call in (
    lambda: jaxstab.shares(3),
    lambda: jaxstab.quantiles(loop),
    lambda: jaxstab.quantiles(3, at="x"),
    lambda: jaxstab.shares(3, confidence=None),
    lambda: jaxstab.study(loop, over, walls=3),
    lambda: jaxstab.study(loop, over, walls={"soft": 3}),
    lambda: jaxstab.build_atlas(3, "atlas.h5"),
    lambda: jaxstab.contact_table(3, [1.0], 1.0, push=1.0),
    lambda: jaxstab.pid(3, kd=1.0),
    lambda: jaxstab.build_guard(3, jaxstab.HandRange(), **ranges),
    lambda: jaxstab.build_guard(loop, jaxstab.HandRange(), **ranges | {"mass": 0.2}),
    lambda: jaxstab.build_guard(loop, jaxstab.HandRange(), **ranges, cells=4),
    lambda: jaxstab.build_guard(loop, jaxstab.HandRange(), **ranges, cells=(4, 1, 1.5)),
    lambda: loop.worst_hand(jaxstab.HandRange(), 1000.0, 10.0, delay=1e-3),
    lambda: jaxstab.Loop.from_coefficients(**sides | {"base": 3}),
    lambda: jaxstab.Loop.from_coefficients(**sides | {"base": [1, (1, 2, 3)]}),
    lambda: jaxstab.Loop.from_coefficients(**sides, gains=3),
    lambda: jaxstab.Loop.from_coefficients(**sides, gains=("a", "a", "b")),
    lambda: jaxstab.Loop.from_coefficients(**sides, units=("N",)),
    lambda: jaxstab.Loop.from_coefficients(**sides, units=None),
    lambda: jaxstab.identify(force=None, position=[0.0], sample_time=1e-3),
    lambda: jaxstab.HapticLoop(device=loop.region(), sample_time=1e-3),
    lambda: jaxstab.tune_for_all(loop),
    lambda: jaxstab.open_atlas(ATLAS).plot(delay="x"),
    lambda: guard.largest_stiffness("x", mass=0.25, delay=1e-3),
    lambda: guard.header(3),
    lambda: jaxstab.coupling(arm, arm, sample_time=1e-3, delays_samples=1),
):
    try:
        call()
    except (TypeError, ValueError) as error:
        print(error)
"""


def test_what_is_of_another_kind_is_refused_by_its_name(tmp_path: Path) -> None:
    """In a process of its own: here annotations would refuse it."""
    completed = run_code(OF_ANOTHER_KIND.replace("ATLAS", repr(str(ATLAS))), tmp_path)
    assert completed.returncode == 0, completed.stderr
    assert [*tmp_path.iterdir()] == []
    for said, words in zip(
        completed.stdout.splitlines(),
        (
            "study is 3; give the xarray.Dataset of jaxstab.study or of its file.",
            "study is HapticLoop(",
            "at is 'x'; give real numbers.",
            "confidence is None; give real numbers.",
            "walls is 3; give (K, B) by the name of each wall.",
            "wall soft is 3; give its K and B.",
            "spec is 3; give a jaxstab.AtlasSpec.",
            *["loop is 3; give a jaxstab.HapticLoop."] * 3,
            "mass is 0.2; give its lowest and its highest value.",
            "cells are 4; give three numbers: along mass, delay and damping.",
            "cells is 1.5; give a whole number.",
            "delay is 0.001; give its lowest and its highest value.",
            "base is 3; give a list of coefficients.",
            "base[1] is (1, 2, 3); give its lowest and its highest value.",
            'gains is 3; give two different names such as ("kp", "kd").',
            "gains is ('a', 'a', 'b'); give two different names",
            "units is ('N',); give two, such as",
            "units is None; give two, such as",
            "force is None; give real numbers.",
            "device is Region",
            "loops is HapticLoop(",
            "delay is 'x'; give real numbers.",
            "damping is 'x'; give real numbers.",
            "name is 3; give at most 40 letters",
            "delays_samples is 1; give one delay for each device.",
        ),
        strict=True,
    ):
        assert said.startswith(words)


ODD_VALUES = """
import numpy as np
import jaxstab

number = {"device_mass": 0.1, "device_damping": 1.5, "sample_time": 1e-3}
loop, ragged, endless = jaxstab.HapticLoop(**number), [[1, 2], [3]], 10**40
wall, five = (1000.0, 10.0), {"gamma": 0.0, "delta": 0.01, "delay": 0.0}
device = jaxstab.Device.mass_spring_damper(0.25, damping=0.1)
scene = {"device": {"mass": 0.1, "damping": 0.1}, "controller": {"sample_time": 1e-3}}
mass = {"device.mass": [0.1, 0.2]}
parts = {"base": [1, -2, 1], "first": [1, 0], "second": [1]}
cases = [
    ("sample_time", lambda x: jaxstab.HapticLoop(**number | {"sample_time": x}), None),
    ("hand_mass", lambda x: jaxstab.HapticLoop(**number, hand_mass=x), None),
    ("delay", lambda x: jaxstab.HapticLoop(**number, delay=x), None),
    ("delays", lambda x: loop.verdict(*wall, delays=x), ragged),
    ("delays", lambda x: loop.simulate(*wall, force=1.0, delays=x), "", 1j, {}, ragged),
    ("between", lambda x: loop.range_of("delay", *wall, between=x), ragged),
    ("between", lambda x: loop.simulate(*wall, force=1.0, between=x), endless),
    ("samples", lambda x: loop.simulate(*wall, force=1.0, samples=x), endless),
    ("horizon", lambda x: loop.settling_time(*wall, horizon=x), endless),
    ("lost", lambda x: loop.verdict(*wall, delays=(0.0, 1e-3), lost=x), endless),
    ("count", lambda x: loop.range_of("delay", *wall, count=x), endless),
    ("quantity", lambda x: loop.range_of(x, *wall), np.ma.masked_array([1, 2], [0, 1])),
    ("samples", lambda x: loop.simulate(*wall, force=1.0, samples=x), np.int8(0)),
    ("units", lambda x: jaxstab.Loop.from_coefficients(**parts, sample_time=1.0, units=x), ragged),
    ("delays_samples", lambda x: jaxstab.coupling(
        device, device, sample_time=1e-3, delays_samples=x), ragged),
    ("damping", lambda x: jaxstab.contact_table(loop, 1000.0, x, push=1.0), ragged),
    ("gamma", lambda x: jaxstab.closed_loop_poles(0.1, 0.2, **five | {"gamma": x}), ragged),
    ("over", lambda x: jaxstab.study(loop, x), 3, None, {3: [1.0]}),
    ("delay", lambda x: jaxstab.study(loop, {"delay": x}), ragged, [endless**20]),
    ("walls", lambda x: jaxstab.study(scene | {"walls": x}, mass), 3),
    ("walls.a", lambda x: jaxstab.study(scene | {"walls": {"a": x}}, mass), 3),
    ("walls.a.stiffness", lambda x: jaxstab.study(scene | {"walls": {"a": x}}, mass), {}),
    ("controller.delay", lambda x: jaxstab.study(
        scene | {"controller": x}, {"controller.delay": [0.0, 1e-3]}), 3),
    ("plane", lambda x: trace(x, ((0.0, 3.0), (0.0, 0.3))), None, 3, ragged, "ab"),
    ("window", lambda x: trace(("delay", "alpha"), x), None, [], (0.0, 1.0), ragged),
    ("gamma", lambda x: jaxstab.robust_region(**five | {"gamma": x}), ragged),
    ("delay", lambda x: jaxstab.robust_region(
        gamma=(0.0, 0.1), delta=(0.0, 0.01), delay=x), [0.0, 1.0]),
]


def trace(*axes):
    return jaxstab.trace_boundary(*axes, beta=0.2, gamma=0.0, delta=0.015)


for name, question, *values in cases:
    for value in values:
        try:
            answer = question(value)
        except (TypeError, ValueError) as error:
            answer = str(error)
        assert answer.startswith(name + " ") and answer.endswith("."), (name, value, answer)
        assert chr(10) not in answer and len(answer) < 250, answer
"""


def test_odd_values_are_refused_by_the_name_of_the_argument(tmp_path: Path) -> None:
    """In a process of its own, likewise: they ended in errors of others, or without an end."""
    completed = run_code(ODD_VALUES, tmp_path)
    assert completed.returncode == 0, completed.stderr


def test_what_rounds_to_no_disturbance_and_no_gains_have_answers() -> None:
    loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
    assert loop.amplitude(1000.0, 10.0, encoder=5e-324).position < 1e-300
    assert loop.amplitude(1000.0, 10.0, encoder=1e-5, noise=[]).position.shape == (0,)
    robot = jaxstab.admittance(1e4, sample_time=1e-3, delay_samples=2)
    assert robot.poles(mass=[], damping=1.0).shape == (0, 3)
