"""Commands that meet odd files: monstrous input, outputs that are none, files of strangers."""

import errno
import io
import os
import signal
import stat
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from atlases import write_small
from commands import EXAMPLE, POINT, START, assert_one_sentence, run

from jaxstab import AtlasSpec, Verdict, build_atlas, durable, open_atlas, tables

CSV = "alpha,beta,gamma,delta,delay\n"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return write_small(tmp_path)


def test_bytes_that_are_no_text_are_named_by_file_and_line(path: Path, tmp_path: Path) -> None:
    table, spec = tmp_path / "points.csv", tmp_path / "spec.toml"
    table.write_bytes(CSV.encode() + b"0,0.1,0,0,0\n\xff,0.1,0,0,0\n")
    spec.write_bytes(b"gamma = [0]\ndelta = \xff\n")
    for answer, place in (
        (run("atlas", "query", path, "--csv", table), f"{table}: line 3"),
        (run("limits", spec), f"{spec}: line 2"),
    ):
        assert (answer.exit_code > 0, answer.stdout) == (True, "")
        assert_one_sentence(answer.stderr)
        assert place in answer.stderr


@pytest.mark.parametrize(
    "text",
    ["[" * 6000 + "]" * 6000, ".".join("a" * 100_000) + " = 1", "a = " + "9" * 5000],
    ids=["nested", "dots", "digits"],
)
def test_a_monstrous_toml_is_one_sentence(text: str, tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text(f"a = {text}" if text[0] == "[" else text)
    answer = run("limits", tmp_path / "bad.toml")
    assert (answer.exit_code, answer.stdout) == (2, "")
    assert_one_sentence(answer.stderr)
    assert "bad.toml" in answer.stderr


def test_axes_without_width_are_refused_and_hands_next_to_each_other_are_not(
    tmp_path: Path,
) -> None:
    hands = "gamma = [0.0, 5e-324]\ndelta = [0.0]\ndelay = [0.0]\nrows = 5\n"
    for name in ("alpha", "beta"):
        text = f"{hands}[fields]\n{name} = [0.0, 5e-324]\n"
        (tmp_path / "thin.toml").write_text(text, encoding="utf-8")
        answer = run("atlas", "build", "--spec", tmp_path / "thin.toml", "-o", tmp_path / "a.h5")
        assert (answer.exit_code, answer.stdout) == (2, "")
        assert f"axis {name} is 5e-324 long" in answer.stderr
    atlas = build_atlas(AtlasSpec.from_toml(hands), tmp_path / "a.h5")
    plant = {"gamma": 5e-324, "delta": 0.0, "delay": 0.0}
    assert atlas.query(0.1, 0.15, **plant).verdict == Verdict.STABLE


def test_a_table_where_a_number_should_be_is_named_by_its_key(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(
        "[device]\npreset = 'omega'\n[controller]\nsample_time = 0.001\n"
        "[wanted]\nstiffness = { a = 1 }\n"
    )
    answer = run("limits", tmp_path / "s.toml")
    assert "s.toml: wanted.stiffness is {'a': 1}; give a finite number" in answer.stderr


def test_stdout_that_is_full_or_closed_is_one_sentence(path: Path) -> None:
    words = [sys.executable, "-c", START, "atlas"]
    for command, where, reason in (
        (["query", str(path), *POINT], "> /dev/full", "No space left"),
        (["info", str(path)], ">&-", "stdout is closed"),
    ):
        done = subprocess.run(
            ["sh", "-c", f'"$@" {where}', "sh", *words, *command], capture_output=True, text=True
        )
        assert done.returncode == 2
        assert_one_sentence(done.stderr)
        assert reason in done.stderr


@pytest.mark.parametrize("place", ["", ".", "/dev/null", "pipe.png", "folder.png"])
def test_an_output_that_is_no_file_is_refused_before_the_work(
    place: str, path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe.png")
    (tmp_path / "folder.png").mkdir()
    for command in (
        ["region", "--gamma", "0", "--delta", "0"],
        ["atlas", "plot", path],
        ["atlas", "build"],
    ):
        answer = run(*command, "-o", place)
        assert (answer.exit_code > 0, answer.stdout) == (True, "")
        assert_one_sentence(answer.stderr)
    assert sorted(entry.name for entry in tmp_path.iterdir() if entry != path) == [
        "folder.png",
        "pipe.png",
    ]


def test_a_picture_has_the_format_of_its_name(path: Path) -> None:
    for name in ("picture", "picture.jpg", "picture.svg"):
        answer = run("atlas", "plot", path, "-o", name)
        assert (answer.exit_code, "end" in answer.stderr) == (2, True)


def test_a_file_is_written_behind_its_link_and_keeps_its_mode(tmp_path: Path) -> None:
    target, link = tmp_path / "there" / "file", tmp_path / "link"
    target.parent.mkdir()
    link.symlink_to(target)
    durable.publish(b"first", link)
    assert link.is_symlink()
    target.chmod(0o640)
    durable.publish(b"second", link)
    assert (target.read_bytes(), target.stat().st_mode & 0o777) == (b"second", 0o640)
    assert [entry.name for entry in target.parent.iterdir()] == ["file"]


def test_a_file_has_any_name_that_the_system_takes(tmp_path: Path) -> None:
    longest = tmp_path / ("n" * os.pathconf(tmp_path, "PC_NAME_MAX"))
    durable.publish(b"data", longest)
    assert longest.read_bytes() == b"data"


def test_a_new_file_has_the_mode_that_the_umask_says(tmp_path: Path) -> None:
    former = os.umask(0o027)
    try:
        durable.publish(b"data", tmp_path / "file")
    finally:
        os.umask(former)
    assert (tmp_path / "file").stat().st_mode & 0o777 == 0o640


ENDED = """
import os, pathlib, signal, sys
from jaxstab.durable import replacing

signal.signal(signal.SIGINT, signal.SIG_DFL)
with replacing(pathlib.Path("a")) as descriptor:
    os.write(descriptor, b"half")
    os.kill(os.getpid(), int(sys.argv[1]))
"""


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP", "SIGKILL"])
def test_a_file_that_is_half_written_when_a_signal_ends_the_process_is_removed(
    name: str, tmp_path: Path
) -> None:
    """SIGKILL leaves it under its own name, and nothing under that of the target."""
    number = getattr(signal, name)
    words = [sys.executable, "-c", ENDED, str(int(number))]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (-number, b"")
    left = [*tmp_path.glob(".jaxstab-*.part")]
    assert [*tmp_path.iterdir()] == left
    assert len(left) == (name == "SIGKILL")


def test_signals_are_as_they_were_when_a_file_is_written(tmp_path: Path) -> None:
    numbers = signal.SIGINT, signal.SIGTERM
    before = [signal.getsignal(number) for number in numbers]
    durable.publish(b"data", tmp_path / "file")
    assert [signal.getsignal(number) for number in numbers] == before


@pytest.mark.parametrize("has_links", [True, False])
def test_a_file_that_appears_meanwhile_is_kept(
    has_links: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> None:
        raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))

    if not has_links:  # as on a memory stick
        monkeypatch.setattr(os, "link", refused)
    path = tmp_path / "file"
    durable.publish(b"ours", path, may_replace=False)
    assert path.read_bytes() == b"ours"
    path.unlink()
    with (
        pytest.raises(FileExistsError, match="file: another process has written it meanwhile"),
        durable.replacing(path, may_replace=False),
    ):
        path.write_bytes(b"theirs")
    assert (path.read_bytes(), [*tmp_path.iterdir()]) == (b"theirs", [path])


def test_what_a_full_disk_does_not_take_can_be_closed() -> None:
    image, full = io.BytesIO(b"image"), os.open("/dev/full", os.O_WRONLY)
    with pytest.raises(OSError, match="No space left") as _, image.getbuffer() as view:
        durable.write_all(full, view)
    os.close(full)
    image.close()  # BufferError, which a command that ends prints, if a view of it is left


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are bytes on Linux alone")
def test_a_csv_file_has_a_name_that_is_no_text(tmp_path: Path) -> None:
    scene = os.fsencode(tmp_path) + b"/wall\xff.toml"
    with open(scene, "w", encoding="utf-8") as file:
        file.write(EXAMPLE)
    words, table = ["limits", os.fsdecode(scene), "--csv"], tmp_path / "table.csv"
    written = run(*words, table)
    assert scene in table.read_bytes()
    for more in ({}, {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}):
        printed = subprocess.run(
            [sys.executable, "-c", START, *words, "-"],
            stdout=subprocess.PIPE,
            env=os.environ | more,
        )
        assert (written.exit_code, table.read_bytes()) == (printed.returncode, printed.stdout)


def test_where_tiles_are_computed_is_checked_first(tmp_path: Path) -> None:
    both = ["--scheduler", "tcp://a:1", "--workers", "2", "-o", tmp_path / "a.h5"]
    answer = run("atlas", "build", *both)
    assert answer.exit_code == 2
    assert "--workers and --scheduler are given; give one of them" in answer.stderr
    assert_one_sentence(answer.stderr)


@pytest.mark.parametrize(
    ("command", "words", "answer"),
    [
        (["region", "--gamma", "0", "--delta", "0"], "region of a loop with 0", "largest alpha"),
        pytest.param(
            ["limits", "data/scenes/gains/pid.toml"],
            "limits of a loop",
            "largest",
            marks=pytest.mark.campaign,
        ),
        (["joints", "data/robots/arm.xml", "--rate", "500"], "joints of data/robots", "stable"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_what_takes_long_is_shown_on_a_terminal(
    command: list[str], words: str, answer: str
) -> None:
    reader, terminal = os.openpty()
    process = [sys.executable, "-c", START, *command]
    started = subprocess.Popen(process, stderr=terminal, stdout=subprocess.PIPE, text=True)
    os.close(terminal)
    shown = b""
    with suppress(OSError):  # nobody writes any more
        while chunk := os.read(reader, 10**4):  # or a full terminal would keep the command waiting
            shown += chunk
    os.close(reader)
    answered, _ = started.communicate()
    assert words in shown.decode(errors="replace")
    assert answer in answered


MEMORY = """
import os, resource, sys
from jaxstab.atlas import open_atlas

def checks():
    return [open_atlas(sys.argv[1]).fields["outside"].size > 0]

assert all(checks())
found = {"right": 0, "damaged": 0, "memory": 0}
_, most = resource.getrlimit(resource.RLIMIT_AS)
for more in [*range(0, 3_000_000, 100_000), *(10**6 * 2**k for k in range(2, 9))]:
    # Each limit in a process of its own: libhdf5 may be of no use after memory ran short.
    child = os.fork()
    if not child:
        taken = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (taken + more, most))
        try:
            answer = "right" if all(checks()) else "damaged"
        except MemoryError:
            answer = "memory"
        except Exception as error:
            print(type(error), error, file=sys.stderr)
            answer = "damaged"
        os._exit([*found].index(answer))
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    if code >= 0:  # h5py itself may crash where it gets no memory
        found[[*found][code]] += 1
print(*found.values())
"""


@pytest.mark.campaign
@pytest.mark.skipif(sys.platform != "linux", reason="the limit is that of Linux")
def test_a_good_file_is_not_called_damaged_where_memory_runs_short() -> None:
    golden = Path(__file__).resolve().parents[3] / "data" / "golden" / "atlas-v5.h5"
    # Freed memory goes back to the system at once, so that none is at hand beyond the limit.
    returned = {"MALLOC_MMAP_THRESHOLD_": "4096", "MALLOC_TRIM_THRESHOLD_": "0"}
    done = subprocess.run(
        [sys.executable, "-c", MEMORY, str(golden)],
        env=os.environ | returned | {"MALLOC_TOP_PAD_": "0"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    right, damaged, memory = map(int, done.stdout.split())
    assert (damaged, right > 0, memory > 0) == (0, True, True), done.stderr


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        SystemError("error return without exception set"),
        OSError("Can't synchronously read data (filter returned failure during read)"),
    ],
)
def test_an_error_that_lacked_memory_is_named(
    error: Exception, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def short(*_: object) -> None:
        raise error

    monkeypatch.setattr("jaxstab.atlas.file.h5py.File", short)
    monkeypatch.setattr("jaxstab.atlas.file.is_memory_short", lambda: isinstance(error, OSError))
    with pytest.raises(MemoryError, match=f"there is not enough memory to read {path}"):
        open_atlas(path)


def test_a_table_is_not_called_damaged_where_memory_runs_short(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = tmp_path / "text.h5"
    text.write_text("no table")
    monkeypatch.setattr("jaxstab.tables.is_memory_short", lambda: True)
    with pytest.raises(MemoryError, match=f"there is not enough memory to read {text}"):
        tables.read(text)


def test_a_pipe_is_not_waited_for(path: Path, tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.h5"
    os.mkfifo(pipe)
    for command in (
        ["atlas", "info", pipe],
        ["atlas", "verify", pipe],
        ["study", "--merge", pipe, "-o", tmp_path / "all.h5"],
    ):
        answer = run(*command)
        assert answer.exit_code == 2
        assert_one_sentence(answer.stderr)
        assert "it is a device, a pipe or a socket" in answer.stderr


@pytest.mark.parametrize(
    "command",
    [
        ["atlas", "build"],
        ["guard", "--device", "omega", "--sample-time", "0.001"],
        ["figure", "4"],
        ["region", "--gamma", "0", "--delta", "0"],
        ["explore"],
    ],
    ids=lambda command: command[0],
)
def test_no_file_is_named_by_a_dash(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    answer = run(*command, "-o", "-")
    assert (answer.exit_code, answer.stdout) == (2, "")
    assert_one_sentence(answer.stderr)
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(os.name != "posix", reason="elsewhere a folder is not synchronised")
def test_a_file_that_is_in_place_is_not_said_to_be_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After the rename the former file is gone, whatever the disk says of the folder."""
    table, synchronise = tmp_path / "scene.csv", os.fsync
    table.write_text("of last week")
    (tmp_path / "scene.toml").write_text(EXAMPLE)

    def refused_for_folders(descriptor: int) -> None:
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        synchronise(descriptor)

    monkeypatch.setattr(os, "fsync", refused_for_folders)
    answer = run("limits", tmp_path / "scene.toml", "--csv", table)
    assert answer.exit_code == 2
    assert_one_sentence(answer.stderr)
    assert f"{table} is written and in its place, but may be lost" in answer.stderr
    assert os.strerror(errno.EIO) in answer.stderr
    assert table.read_text().startswith("scene,")
    assert list(tmp_path.glob(".*.part")) == []
