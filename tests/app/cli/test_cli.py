"""The commands, as a user meets them."""

import csv
import json
import os
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from atlases import SMALL_TOML, write_small
from campaign import first
from commands import EXAMPLE, POINT, START, assert_one_sentence, run, run_process

import jaxstab

SMALLEST_TOML = """
rows = 5
gamma = [0, 0.001]
delta = [0, 0.01]
delay = [0]
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return write_small(tmp_path)


def test_version_and_help() -> None:
    assert run("--version").output.startswith("jaxstab, version ")
    for command in ([], ["atlas"], ["atlas", "build"], ["atlas", "query"], ["atlas", "plot"]):
        answer = run(*command, "--help")
        assert answer.exit_code == 0
        assert answer.output.startswith("Usage:")


def test_a_build_prints_what_the_file_holds_and_a_line_that_queries_it(tmp_path: Path) -> None:
    spec = tmp_path / "small.toml"
    spec.write_text(SMALL_TOML, encoding="utf-8")
    output = tmp_path / "an atlas.h5"
    built = run("atlas", "build", "--spec", spec, "-o", output)
    assert built.exit_code == 0, built.stderr
    assert "limits of alpha in 17 rows, and fields" in built.stdout
    assert "3 nodes  0 to 0.015" in built.stdout
    assert built.stdout == run("atlas", "info", output).stdout
    line = built.stdout.splitlines()[-1].strip()
    completed = subprocess.run(
        ["/bin/sh", "-c", f"jaxstab() {{ '{sys.executable}' -c '{START}' \"$@\"; }}; {line}"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert completed.stderr == ""
    assert next(csv.DictReader(completed.stdout.splitlines()))["verdict"] == "stable"
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["an atlas.h5", "small.toml"]


@pytest.mark.campaign
def test_a_build_sets_up_jax_for_itself(tmp_path: Path) -> None:
    spec = tmp_path / "smallest.toml"
    spec.write_text(SMALLEST_TOML, encoding="utf-8")
    built = run_process("atlas", "build", "--spec", spec, "-o", tmp_path / "smallest.h5")
    assert built.returncode == 0, built.stderr
    assert "limits of alpha in 5 rows\n" in built.stdout


def test_a_point_is_answered_as_csv_and_as_json(path: Path) -> None:
    answer = run("atlas", "query", path, *POINT)
    (row,) = csv.DictReader(answer.stdout.splitlines())
    assert (row["verdict"], row["status"]) == ("stable", "interpolated")
    assert float(row["alpha"]) == 0.1
    table = json.loads(run("atlas", "query", path, *POINT, "--format", "json").stdout)
    (entry,) = table["points"]
    assert entry["verdict"] == "stable"
    assert entry["status"] == row["status"]


def test_points_come_from_csv_with_columns_in_any_order_and_options_for_the_rest(
    path: Path, tmp_path: Path
) -> None:
    text = "name,delay, beta,alpha,delta\na,0,0.5,0.1,0.01\n\nb,1.5,0.2,0.02,0.01\n"
    table = tmp_path / "points.csv"
    table.write_text(text, encoding="utf-8-sig")
    from_file = run("atlas", "query", path, "--csv", table, "--gamma", "0.0005")
    from_stdin = run("atlas", "query", path, "--csv", "-", "--gamma", "0.0005", stdin=text)
    assert from_file.exit_code == 0, from_file.stderr
    assert from_file.stdout == from_stdin.stdout
    rows = list(csv.DictReader(from_file.stdout.splitlines()))
    assert [row["alpha"] for row in rows] == ["0.1", "0.02"]
    assert [row["gamma"] for row in rows] == ["0.0005", "0.0005"]
    assert rows[0]["verdict"] == "stable"


def test_points_outside_are_computed(path: Path) -> None:
    answer = run("atlas", "query", path, *POINT, "--gamma", "9")
    code = jaxstab.Verdict(jaxstab.verdict(0.1, 0.5, gamma=9.0, delta=0.01, delay=0.0))
    assert answer.exit_code == int(code != jaxstab.Verdict.STABLE)
    assert answer.stdout.splitlines()[1].endswith(f",{code.name.lower()},computed")


@pytest.mark.campaign
def test_a_plot_is_a_picture(path: Path, tmp_path: Path) -> None:
    png = tmp_path / "plot.png"
    answer = run("atlas", "plot", path, "-o", png, "--delta", "0.01", "--delay", "1.5")
    assert answer.exit_code == 0, answer.stderr
    data = png.read_bytes()
    assert data.startswith(b"\x89PNG")
    wide, high = struct.unpack(">II", data[16:24])
    assert 2 * wide < high < 4 * wide  # one delay; rows of verdicts, radii and two fields
    answer = run("atlas", "plot", path, "-o", png, "--delay", "9")
    assert "delay 9 has no fields in this atlas" in answer.stderr


@pytest.mark.campaign
def test_a_picture_names_the_nodes_of_its_fields(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fields between nodes were those of the nearest ones, without a word."""
    from jaxstab.app.pictures import plane as pictures

    monkeypatch.setattr(pictures, "picture", lambda figure, _: figure.get_suptitle().encode())
    opened = jaxstab.open_atlas(path)
    titles = [pictures.draw_atlas(opened, gamma, 0.005, [1.5]).decode() for gamma in (1e-3, 8e-4)]
    assert "fields at" not in titles[0]
    assert "0.0008" in titles[1].partition("; fields at")[0]
    assert "0.001" in titles[1].partition("; fields at")[2]


CSV = "alpha,beta,gamma,delta,delay\n"
BAD_QUERIES = {
    "not a number": ("", ["--alpha", "much"]),
    "an unknown option": ("", ["--alfa", "1"]),
    "a missing option": ("", ["--alpha", "0.1"]),
    "an empty table": ("", ["--csv", "-"]),
    "a misspelt column": ("alfa,beta,gamma,delta,delay\n", ["--csv", "-"]),
    "a column twice": (CSV, ["--csv", "-", "--alpha", "1"]),
    "two columns of a name": ("alpha," + CSV + "0,0,0.1,0,0,0\n", ["--csv", "-"]),
    "a long cell": (CSV + "1" * 200_000 + ",0.1,0,0,0\n", ["--csv", "-"]),
    "commands to the terminal": ("\x1b]0;title\x07," + CSV[6:], ["--csv", "-"]),
    "a word in a table": (CSV + "0,0.1,0,zero,0\n", ["--csv", "-"]),
    "a short row": (CSV + "0,0.1,0\n", ["--csv", "-"]),
    "NaN": (CSV + "0,0.1,0,nan,0\n", ["--csv", "-"]),
    "a missing table": ("", ["--csv", "missing.csv"]),
}


@pytest.mark.parametrize("name", BAD_QUERIES)
def test_a_bad_query_is_one_sentence(name: str, path: Path) -> None:
    stdin, arguments = BAD_QUERIES[name]
    answer = run("atlas", "query", path, *arguments, stdin=stdin)
    assert (answer.exit_code, answer.stdout) == (2, "")
    assert_one_sentence(answer.stderr)


@pytest.mark.parametrize("command", ["info", "query", "plot"])
@pytest.mark.parametrize("damage", ["missing", "foreign", "truncated", "folder"])
def test_a_bad_file_is_one_sentence(command: str, damage: str, path: Path, tmp_path: Path) -> None:
    if damage == "missing":
        path.unlink()
    elif damage == "foreign":
        path.write_text("no atlas")
    elif damage == "truncated":
        path.write_bytes(path.read_bytes()[:-100])
    else:
        path = tmp_path
    options = {"info": [], "query": POINT, "plot": ["-o", tmp_path / "plot.png"]}
    answer = run("atlas", command, path, *options[command])
    assert (answer.exit_code, answer.stdout) == (2, "")
    assert_one_sentence(answer.stderr)
    assert not (tmp_path / "plot.png").exists()


@pytest.mark.parametrize(
    "spec", ["gama = [0, 1]", "gamma = [1, 0]", "gamma = []", "gamma = [0, nan]", "]"]
)
def test_a_bad_specification_is_one_sentence_and_no_file(spec: str, tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text(spec, encoding="utf-8")
    answer = run("atlas", "build", "--spec", tmp_path / "bad.toml", "-o", tmp_path / "a.h5")
    assert (answer.exit_code, answer.stdout) == (2, "")
    assert_one_sentence(answer.stderr)
    assert not (tmp_path / "a.h5").exists()


def test_a_specification_of_another_type_is_one_sentence_too(tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text("gamma = 3", encoding="utf-8")
    answer = run_process("atlas", "build", "--spec", tmp_path / "bad.toml", "-o", tmp_path / "a.h5")
    assert (answer.returncode, answer.stdout) == (2, "")
    assert_one_sentence(answer.stderr)
    assert not (tmp_path / "a.h5").exists()


def test_a_missing_specification_is_named() -> None:
    answer = run("atlas", "build", "--spec", "nowhere.toml")
    assert answer.exit_code == 2
    assert_one_sentence(answer.stderr)
    assert "nowhere.toml: No such file or directory; name a file" in answer.stderr


def test_an_output_folder_that_cannot_be_written_is_one_sentence_before_the_work() -> None:
    answer = run_process("atlas", "build", "-o", "/proc/atlas.h5")
    assert (answer.returncode, answer.stdout) == (2, "")
    assert_one_sentence(answer.stderr)


@pytest.mark.parametrize("arguments", [["--help"], ["atlas", "query"]])
def test_help_and_queries_start_without_anything_heavy(arguments: list[str], path: Path) -> None:
    given = [*arguments, str(path), *POINT] if "query" in arguments else arguments
    script = (
        "import sys\n"
        "from jaxstab.app.cli.main import main\n"
        "try:\n"
        "    main()\n"
        "finally:\n"
        "    print(*sys.modules, file=sys.stderr)\n"
    )
    completed = subprocess.run(
        [sys.executable, "-c", script, *given], capture_output=True, text=True, check=False
    )
    assert completed.returncode == 0
    loaded = set(completed.stderr.split())
    assert loaded.isdisjoint({"jax", "jaxtyping", "matplotlib", "rich", "scipy", "pydantic"})
    assert ("numpy" in loaded) == ("query" in arguments)


PLAIN = ["--device", "phantom", "--sample-time", "0.001"]
WITHOUT_A_PICTURE = [
    ["limits", *PLAIN],
    ["limits", *PLAIN, "--hand-mass", "0:0.2"],
    ["check", *PLAIN, "--wall", "a", "800", "5"],
    ["tune", *PLAIN],
    ["design", *PLAIN, "--stiffness", "3000"],
]
PICTURES = [
    ["region", "--gamma", "0", "--delta", "0.015", "--delay", "1", "-o", "region.png"],
    ["figure", "4"],
]


@pytest.mark.parametrize(
    "commands",
    [WITHOUT_A_PICTURE, pytest.param(PICTURES, marks=pytest.mark.campaign)],
    ids=["words", "pictures"],
)
def test_what_is_asked_once_does_not_load_jax(commands: list[list[str]], tmp_path: Path) -> None:
    script = (
        "import json, sys\n"
        "from jaxstab.app.cli.main import main\n"
        "for command in json.loads(sys.argv[1]):\n"
        "    assert not main(command, standalone_mode=False)\n"
        "print(*sys.modules, file=sys.stderr)\n"
    )
    completed = subprocess.run(
        [sys.executable, "-c", script, json.dumps(commands)],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(Path(jaxstab.__file__).parents[1])},
    )
    assert completed.returncode == 0, completed.stderr
    loaded = set(completed.stderr.split())
    assert loaded.isdisjoint({"jax", "rich", "scipy"})
    assert ("matplotlib" in loaded) == (commands is PICTURES)


# What a command reads is never what it writes.

_WRITES = {
    "limits": ("limits", "{}", "--csv", "{}"),
    "link": ("limits", "{}", "--csv", "link.toml"),
    "study": ("study", "{}", "--over", "device.mass=1,2", "--csv", "{}"),
    "draws": ("study", "{}", "--over", "device.mass=csv:log.csv:m", "--csv", "log.csv"),
    "guard": ("guard", "{}", "-o", "{}"),
    "plot": ("check", "scene.svg", "--plot", "scene.svg"),
    "certificate": ("check", "scene.json", "--certificate", "scene.json"),
    "atlas": ("atlas", "plot", "scene.png", "-o", "scene.png"),
    "explore": ("explore", "scene.html", "-o", "scene.html"),
    "build": ("atlas", "build", "--spec", "{}", "-o", "{}"),
    "gains": ("joints", "arm.xml", "--gains", "arm.yaml", "--safe-gains", "arm.yaml"),
    "robot": ("joints", "arm.xml", "--rate", "500", "--csv", "arm.xml"),
    "identify": ("identify", "log.csv", "-o", "./log.csv"),
    "merge": ("study", "part.h5", "--merge", "-o", "part.h5"),
}


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="it counts threads of Linux")
@pytest.mark.parametrize(("given", "count"), first([(None, 1), ("3", 3)], 1))
def test_a_command_computes_in_one_thread_unless_it_is_told_otherwise(
    given: str | None, count: int
) -> None:
    code = (
        "import os; from jaxstab.app.cli.main import main; "
        "main(['limits', 'data/scenes/omega.toml'], "
        "standalone_mode=False); print(len(os.listdir('/proc/self/task')), 'threads')"
    )
    own = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    own |= {"OPENBLAS_NUM_THREADS": given} if given else {}
    process = [sys.executable, "-c", code]
    done = subprocess.run(process, env=own, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == f"{min(count, os.cpu_count() or 1)} threads"


@pytest.mark.parametrize("name", _WRITES)
def test_a_command_never_replaces_what_it_reads(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for ending in ("toml", "svg", "png", "json", "html"):
        (tmp_path / f"scene.{ending}").write_text(EXAMPLE)
    (tmp_path / "link.toml").symlink_to("scene.toml")
    for robot in (Path(__file__).parents[3] / "data/robots").iterdir():
        shutil.copy(robot, tmp_path)
    (tmp_path / "log.csv").write_text("time,force,position,m\n0,1,2,3\n")
    (tmp_path / "part.h5").write_bytes(b"")
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    done = run(*(word.format("scene.toml") for word in _WRITES[name]))
    assert (done.exit_code, done.stdout) == (2, "")
    assert_one_sentence(done.stderr)
    assert "which this command reads; give another name." in done.stderr
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before


def test_two_outputs_have_two_names(tmp_path: Path) -> None:
    plain = ["limits", "--mass", "0.25", "--damping", "0.1", "--rate", "1000"]
    (tmp_path / "link.png").symlink_to("a.png")
    for second in ("a.png", "link.png"):
        files = ["--csv", tmp_path / "a.png", "--plot", tmp_path / second]
        done = run(*plain, *files)
        assert (done.exit_code, done.stdout) == (2, "")
        assert_one_sentence(done.stderr)
        assert "is the file of --csv, too; give another name." in done.stderr
        assert not (tmp_path / "a.png").exists()


def test_stdin_is_not_replaced_either(tmp_path: Path) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(EXAMPLE)
    command = [sys.executable, "-c", START, "check", "-", "--csv", scene]
    with scene.open() as stdin:
        done = subprocess.run(command, stdin=stdin, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert_one_sentence(done.stderr, "--csv", scene)
    assert scene.read_text() == EXAMPLE
