"""Guards: what a header lets through is stable; its callers may be hostile."""

import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaign import first, many
from commands import assert_one_sentence, run
from programs_in_c import STRICT, compiled, rows_of

import jaxstab
import jaxstab.lab.guard.build
from jaxstab import HandRange, HapticLoop, Velocity, Verdict, build_guard
from jaxstab.lab.guard.guard import boundary_of, checked_name
from jaxstab.results import Guard
from tests.truth.filtered import FilteredLoop, average, difference
from tests.truth.moving import Moving, growth

ROOT = Path(__file__).resolve().parents[3]
CHECKED = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
HANDS = HandRange(mass=(0.0, 0.1), stiffness=(0.0, 100.0), damping=(0.0, 1.0))
LOOP = HapticLoop(
    device_mass=0.25,
    device_damping=0.5,
    sample_time=1e-3,
    delay=1e-3,
    velocity=Velocity.difference(samples=4),
)
REFUSED = 2


@pytest.fixture(scope="module")
def guard() -> Guard:
    return build_guard(
        LOOP,
        HANDS,
        mass=(0.24, 0.26),
        delay=(0.9e-3, 1.1e-3),
        cells=(1, 1, 16),
        constant_delay=True,
    )


@pytest.fixture(scope="module")
def folder(guard: Guard, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("guard")
    (folder / "test_guard.h").write_text(guard.header("test_guard", "of a test"))
    return folder


@pytest.fixture(scope="module")
def program(folder: Path) -> Path:
    source = ROOT / "tests" / "guard.c"
    return compiled(source, folder, ["-O2", "-D_POSIX_C_SOURCE=200809L", f"-I{folder}", *STRICT])


def held(
    guard: Guard, rows: np.ndarray, rng: np.random.Generator, *, corners: bool
) -> dict[str, Any]:
    """The loops of calls in dimensionless numbers, each with a hand of its own."""
    share = rng.random((3, len(rows)))
    share = np.round(share) if corners else share
    mass, stiffness, damping = (
        low + (high - low) * part
        for (low, high), part in zip(vars(guard.hands).values(), share, strict=True)
    )
    period, moved = guard.loop.sample_time, rows[:, 2] + mass
    stiff = np.maximum(rows[:, 4], 1e-6)  # a free device without stiffness drifts
    return {
        "alpha": stiff * period**2 / moved,
        "beta": rows[:, 5] * period / moved,
        "gamma": stiffness * period**2 / moved,
        "delta": (guard.loop.device_damping + damping) * period / moved,
        "delay": rows[:, 3] / period,
    }


def judged(guard: Guard, program: Path, mode: str, count: int, seed: int) -> np.ndarray:
    """Calls of C: K, B, mass, delay, a hand, whether nothing is larger than before, and a code."""
    own = guard.loop.sample_time, guard.loop.device_damping, 4
    words = [mode, count, seed, *own, *(end for ends in vars(guard.hands).values() for end in ends)]
    done = subprocess.run([program, *map(str, words)], capture_output=True, check=True)
    return np.frombuffer(done.stdout).reshape(-1, 9)


def codes_of(guard: Guard, rows: np.ndarray) -> np.ndarray:
    """Certified verdicts on such calls."""
    period, moved = guard.loop.sample_time, rows[:, 2] + rows[:, 4]
    alpha = np.maximum(rows[:, 0], 1e-6) * period**2 / moved
    gamma = rows[:, 5] * period**2 / moved
    delta = (guard.loop.device_damping + rows[:, 6]) * period / moved
    wall = alpha, rows[:, 1] * period / moved
    return np.asarray(
        jaxstab.verdict(
            *wall, gamma=gamma, delta=delta, delay=rows[:, 3] / period, **guard.loop.filters
        )
    )


def unstable(guard: Guard, program: Path, count: int, seed: int) -> int:
    """How many of some calls left a wall that is not proved stable."""
    rows = judged(guard, program, "judge", count, seed)
    assert np.all(rows[:, 7] == 1.0)
    return int(np.sum(codes_of(guard, rows) != Verdict.STABLE)) if len(rows) else 0


def test_the_judge_in_c_is_as_strict_as_certified_verdicts(guard: Guard, program: Path) -> None:
    rows = judged(guard, program, "raw", 3_000, 2)
    codes, is_clear = codes_of(guard, rows), rows[:, 8] == 1.0
    assert 0.2 < np.mean(is_clear) < 0.8
    assert np.all(codes[is_clear] == Verdict.STABLE)
    assert np.mean(is_clear[codes == Verdict.STABLE]) > 0.999


def test_what_the_header_lets_through_is_stable(guard: Guard, program: Path) -> None:
    """Of a hand at random each time, half of them at the corners of the range."""
    assert sum(unstable(guard, program, 100_000, seed) for seed in range(2)) == 0


@pytest.mark.campaign
def test_what_the_header_lets_through_is_stable_in_many_calls(guard: Guard, program: Path) -> None:
    """5e7 calls at full size; JAXSTAB_CAMPAIGN=20 asks a billion, a quarter of an hour of CPU."""
    chunk = 1_000_000
    for seed in range(many(50)):  # the first wrong one ends it
        assert unstable(guard, program, chunk, seed) == 0


def test_times_of_calls_are_told(program: Path) -> None:
    """The worst of the least of 100 times each; ``guard time 100000000 1`` for the full size."""
    done = subprocess.run([program, "time", "20000", "1"], capture_output=True, text=True)
    assert "worst of the least times" in done.stdout


def test_certified_roots_agree(guard: Guard, program: Path) -> None:
    rows = rows_of(program, 100, 7)
    loops = held(guard, rows, np.random.default_rng(7), corners=True)
    for alpha, beta, gamma, delta, delay in zip(*loops.values(), strict=True):
        loop = FilteredLoop(gamma, delta, delay, difference(4), average(1))
        assert loop.code(alpha, beta) == Verdict.STABLE


def test_the_header_is_of_the_same_numbers_as_python(guard: Guard, program: Path) -> None:
    rows = rows_of(program, 5_000, 3)
    own = guard.largest_stiffness(rows[:, 5], mass=rows[:, 2], delay=rows[:, 3])
    assert own == pytest.approx(rows[:, 7], rel=1e-9, abs=1e-6)


def test_it_grants_nine_tenths_and_never_more_than_is_stable(guard: Guard) -> None:
    assert 0.9 < guard.granted < 1.0
    mass, delay = np.linspace(*guard.mass, 5), np.linspace(*guard.delay, 5)
    damping = np.broadcast_to(np.linspace(0.0, 200.0, 100), (5, 5, 100))
    exact = guard.exact_stiffness(damping, mass=mass, delay=delay)
    own = guard.largest_stiffness(damping, mass=mass[:, None, None], delay=delay[:, None])
    assert np.all(own <= exact)


def test_exact_limits_are_those_of_the_region() -> None:
    boundary = boundary_of(LOOP, HandRange(), np.array([0.25]), np.array([1.0]))
    dampings = np.array([[[2.0, 10.0, 20.0, 40.0]]])
    limits = LOOP.stiffness_limits(dampings[0, 0])[:, 1]
    assert boundary.largest_stiffness(dampings)[0, 0] == pytest.approx(limits, rel=1e-3)
    last = LOOP.damping_limits(1e-3)[1]
    assert boundary.largest_damping()[0, 0] == pytest.approx(last, rel=1e-3)


CLAMPED = """
#include <stdio.h>
#include "test_guard.h"
int main(void)
{
    double stiffness, damping, mass;
    while (scanf("%lf %lf %lf", &stiffness, &damping, &mass) == 3) {
        test_guard_clamp(&stiffness, &damping, mass CALL_DELAY);
        printf("%.17g %.17g\\n", stiffness, damping);
    }
    return 0;
}
"""
LIGHT = HapticLoop(device_mass=0.1, device_damping=0.05, sample_time=1e-3)
TURNS = [[1, 1, 1, 0], [1, 1, 0], [1, 0], [1, 0, 0], [1, 1, 1, 1, 0], [1, 1, 1, 0, 0], [1, 1, 0, 0]]


def grown(guard: Guard, folder: Path, call_delay: str, requests: int) -> int:
    """Of some requests, how many are left with a wall that grows under some sequence of delays."""
    (folder / "test_guard.h").write_text(guard.header("test_guard"))
    source = folder / "clamped.c"
    source.write_text(CLAMPED.replace("CALL_DELAY", call_delay))
    program = compiled(source, folder, ["-O2", f"-I{folder}", *STRICT])
    rng = np.random.default_rng(208)
    walls = [(k, b) for k in np.linspace(1000.0, 16000.0, 16) for b in np.linspace(5.0, 90.0, 13)]
    walls = [walls[number] for number in rng.permutation(len(walls))[:requests]]
    masses = rng.choice(rng.uniform(*guard.mass, 8), len(walls))
    words = "".join(f"{k} {b} {m}\n" for (k, b), m in zip(walls, masses, strict=True))
    done = subprocess.run([program], input=words, capture_output=True, text=True, check=True)
    turns = [np.tile(8 * np.array(turn), 1200 // len(turn)) for turn in TURNS]
    turns += [np.tile(rng.integers(0, 9, 12), 100) for _ in range(12)]
    granted = np.array([[*map(float, line.split())] for line in done.stdout.splitlines()])
    count = 0
    for mass in np.unique(masses).tolist():
        gains = granted[(masses == mass) & (granted[:, 0] > 0.0)]
        truth = Moving((1.0,), (mass, LIGHT.device_damping, 0.0), 1e-3)
        stiffness, damping = np.repeat(gains, len(turns), axis=0).T
        runs = truth.positions(stiffness, damping, np.tile(turns, (len(gains), 1)))
        is_growing = growth(runs, 60).reshape(len(gains), -1) > 1.0
        count += int(np.sum(np.any(is_growing, axis=1)))
    return count


RANGES: dict[str, Any] = {"mass": (0.095, 0.105), "delay": (0.0, 1e-3)}


@pytest.fixture
def little_work(monkeypatch: pytest.MonkeyPatch) -> None:
    work = jaxstab.lab.guard.build._OF_MASS._replace(most=60_000)
    monkeypatch.setattr(jaxstab.lab.guard.build, "_OF_MASS", work)


@pytest.mark.campaign
@pytest.mark.usefixtures("little_work")
def test_no_sequence_of_delays_makes_a_wall_grow_that_a_header_grants(tmp_path: Path) -> None:
    ranges = RANGES | {"mass": (0.099, 0.101)}
    moving = build_guard(LIGHT, HandRange(), **ranges, cells=(1, 1, 8))
    assert not moving.is_delay_constant
    assert moving.granted > 0.3
    assert grown(moving, tmp_path, "", 12) == 0
    constant = build_guard(LIGHT, HandRange(), **ranges, cells=(1, 1, 8), constant_delay=True)
    assert grown(constant, tmp_path, ", 0.0", 12) > 2  # as its header says


@pytest.mark.campaign
def test_of_208_requests_none_grows(tmp_path: Path) -> None:
    """Clamped for constant delays and asked with the delay 0, 88 did."""
    requests = many(208, 40)
    for given in ({}, {"lost": 1}):
        moving = build_guard(LIGHT, HandRange(), **RANGES, **given, cells=(1, 1, many(16, 4)))
        assert grown(moving, tmp_path, "", requests) == 0
    constant = build_guard(LIGHT, HandRange(), **RANGES, cells=(1, 4, 16), constant_delay=True)
    assert grown(constant, tmp_path, ", 1e-3", requests) > requests / 40
    assert grown(constant, tmp_path, ", 0.0", requests) > requests / 4


@pytest.mark.usefixtures("little_work")
def test_a_guard_is_asked_with_a_delay_if_and_only_if_it_is_constant(guard: Guard) -> None:
    moving = build_guard(
        LIGHT, HandRange(), mass=(0.099, 0.101), delay=(0.0, 1e-4), cells=(1, 1, 2)
    )
    with pytest.raises(TypeError, match="give no delay"):
        moving.largest_stiffness(10.0, mass=0.1, delay=0.5e-3)
    with pytest.raises(TypeError, match="give delay in s"):
        guard.largest_stiffness(10.0, mass=0.25)
    assert moving.largest_stiffness(10.0, mass=0.1) > 1000.0
    assert moving.costliest.delay is None
    limits = LIGHT.limits(delays=(0.0, 1e-4))
    assert moving.largest_stiffness(np.linspace(0.0, 80.0, 99), mass=0.1).max() < limits.stiffness
    assert "double mass)" in moving.header("one")
    assert "double mass, double delay)" in guard.header("one")


HOSTILE = """
#include <stdio.h>
#include "test_guard.h"
int main(void)
{
    volatile double zero = 0.0;
    double none = zero / zero, all = 1.0 / zero;
    double numbers[] = {none, -none, all, -all, -1.0, -1e-300, 1e308, 5e-324, -0.0, 0.0,
                        0.25, 1e-3, 10.0, 0.24, 0.26, 0.9e-3, 1.1e-3, 0.2400000001, 1e15};
    int count = (int)(sizeof numbers / sizeof *numbers), refused = 0;
    for (int a = 0; a < count; ++a)
        for (int b = 0; b < count; ++b)
            for (int c = 0; c < count; ++c)
                for (int d = 0; d < count; ++d) {
                    double k = numbers[a], f = numbers[b];
                    int code = test_guard_clamp(&k, &f, numbers[c], numbers[d]);
                    double most = test_guard_largest_stiffness(f, numbers[c], numbers[d]);
                    int good = (a > 5 && b > 5 && c > 5 && d > 5) && numbers[c] >= 0.24
                        && numbers[c] <= 0.26 && numbers[d] >= 0.9e-3 && numbers[d] <= 1.1e-3;
                    if ((code == TEST_GUARD_REFUSED) == good)
                        return 1;
                    if (!good && (k != 0.0 || f != 0.0))
                        return 2;
                    if (!(k >= 0.0 && f >= 0.0 && k <= most) && good)
                        return 3;
                    refused += code == TEST_GUARD_REFUSED;
                }
    return refused ? 0 : 4;
}
"""


@pytest.mark.parametrize(
    "compiler",
    [
        ["gcc", "-std=c99", "-O2", *CHECKED],
        ["g++", "-std=c++17", "-O2", *CHECKED],
        ["gcc", "-std=c99", "-O3", "-ffast-math"],
        ["gcc", "-std=c99", "-O0"],
    ],
    ids=["C99, sanitized", "C++17, sanitized", "fast-math", "not optimised"],
)
def test_numbers_that_are_none_and_numbers_out_of_range_leave_no_gains(
    compiler: list[str], folder: Path
) -> None:
    """-ffast-math leaves out comparisons with NaN; the header asks the bits."""
    if shutil.which(compiler[0]) is None:
        pytest.skip(f"there is no {compiler[0]}")
    source = folder / f"hostile.{'c' if compiler[0] == 'gcc' else 'cpp'}"
    source.write_text(HOSTILE)
    program = folder / "hostile"
    warned = [word for word in STRICT if "-ffast-math" not in compiler]
    subprocess.run([*compiler, *warned, source, "-o", program], check=True)
    assert subprocess.run([program], check=False).returncode == 0


@pytest.mark.parametrize(
    ("example", "name"),
    first(
        [
            ("chai3d_guard.cpp", "omega_guard"),
            ("openhaptics_guard.cpp", "touch_guard"),
            ("ros2_control_guard.cpp", "joint_guard"),
        ],
        1,
    ),
)
@pytest.mark.usefixtures("little_work")
def test_examples_compile_against_stubs(example: str, name: str, tmp_path: Path) -> None:
    if shutil.which("g++") is None:
        pytest.skip("there is no g++")
    guard = build_guard(LIGHT, HandRange(), mass=(0.099, 0.101), delay=(0.0, 1e-4), cells=(1, 1, 2))
    (tmp_path / f"{name}.h").write_text(guard.header(name))
    words = ["g++", "-std=c++17", *STRICT, f"-I{tmp_path}", f"-I{ROOT / 'tests' / 'stubs'}"]
    source = ROOT / "docs" / "examples" / example
    subprocess.run([*words, "-c", source, "-o", tmp_path / "example.o"], check=True)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"mass": (0.3, 0.2)}, "mass is"),
        ({"mass": (0.0, 0.2)}, "mass is"),
        ({"delay": (1e-3, 1e-3)}, "delay is"),
        ({"delay": (-1e-3, 1e-3)}, "delay is -0.001"),
        ({"cells": (3, 1, 1)}, "powers of two"),
        ({"cells": (1, 2, 1)}, "give 1 of delay, or constant_delay"),
        ({"lost": -1}, "lost is -1"),
        ({"lost": 500}, "lost is 500, of delays to 1 samples; give fewer"),
        ({"lost": 1, "constant_delay": True}, "with a constant delay no sample is lost"),
        ({"hands": HandRange(mass=(1.0, 0.0))}, "hands.mass"),
    ],
)
def test_bad_ranges_are_refused(change: dict[str, Any], words: str) -> None:
    given: dict[str, Any] = {
        "loop": LOOP,
        "hands": HANDS,
        "mass": (0.2, 0.3),
        "delay": (0.0, 1e-3),
        "cells": (1, 1, 1),
    }
    with pytest.raises(ValueError, match=words):
        build_guard(**given | change)


def test_bad_names_are_refused(guard: Guard) -> None:
    for name in ("", "9lives", "a-b", "a b", "ä"):
        with pytest.raises(ValueError, match="name is"):
            guard.header(name)


@pytest.mark.usefixtures("little_work")
def test_the_command_writes_a_header_and_a_picture(tmp_path: Path) -> None:
    words = [
        "guard", "--mass", "0.249:0.251", "--damping", "0.5", "--sample-time", "0.001",
        "--window-samples", "4", "--delay", "0.99e-3:1.01e-3", "-o", tmp_path / "my_guard.h",
        "--plot", tmp_path / "a.svg", "--cells", "1,1,4",
    ]  # fmt: skip
    for kind, said, parameters in (
        ([], "delay, varying from sample to sample: 0.00099 to 0.00101 s", "double mass)"),
        (["--constant-delay"], "delay, constant during contact: 0.00099", "mass, double delay)"),
    ):
        answer = run(*words, *kind)
        assert answer.exit_code == 0, answer.output
        header = (tmp_path / "my_guard.h").read_text()
        assert parameters in header.split("int my_guard_clamp")[1].split("{")[0]
        assert (tmp_path / "a.svg").stat().st_size > 1000
        assert "It grants" in answer.output
        assert " hand of " not in answer.output  # no hand
        assert said in answer.output


@pytest.mark.usefixtures("little_work")
def test_the_range_around_one_mass_holds_the_ends_that_are_printed(tmp_path: Path) -> None:
    words = ["guard", "--mass", "0.07", "--damping", "0.5", "--rate", "1000", "--cells", "1,1,2"]
    answer = run(*words, "-o", tmp_path / "g.h")
    assert answer.exit_code == 0, answer.output
    assert "device: 0.056 to 0.0875 kg" in answer.output
    assert "#define G_LOWEST_MASS 0.056 " in (tmp_path / "g.h").read_text()


@pytest.mark.usefixtures("little_work")
def test_the_command_tells_its_work_once(tmp_path: Path) -> None:
    loop = ["--mass", "0.25", "--damping", "0.1", "--rate", "1000", "--delay", "0.001"]
    answer = run("guard", *loop, "--cells", "1,1,1", "-o", tmp_path / "a.h")
    plan, refusal = answer.stderr.splitlines()
    assert plan.startswith("1 cell of mass, delay and damping, for all hands and frequencies: ")
    assert "no wall was proved stable" in refusal


@pytest.mark.parametrize(
    "words",
    [
        ["--mass", "0.3:0.2"],
        ["--cells", "1,2"],
        ["--cells", "3,3,3"],
        ["--output", "my-guard.h"],
        ["--json"],
        ["--lost-samples", "-1"],
        ["--lost-samples", "1", "--constant-delay"],
    ],
)
def test_the_command_refuses_in_one_sentence(words: list[str], tmp_path: Path) -> None:
    scene = ["--mass", "0.25", "--damping", "0.5", "--sample-time", "0.001"]
    answer = run("guard", *scene, "-o", tmp_path / "a.h", *words)
    assert answer.exit_code != 0
    assert_one_sentence(answer.stderr)


@pytest.mark.campaign
def test_a_guard_takes_the_range_of_its_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    work = jaxstab.lab.guard.build._OF_MASS._replace(most=20_000)
    monkeypatch.setattr(jaxstab.lab.guard.build, "_OF_MASS", work)
    header, text = tmp_path / "g.h", "[device]\nmass = 0.1\ndamping = 0.05\n[controller]\n"
    file = tmp_path / "scene.toml"
    for keys, options, words in (
        ("", [], "delay, varying from sample to sample: 0.0009 to 0.0011 s"),
        ("lost_samples = 1", [], "varying from sample to sample, up to 1 in a row lost: "),
        ("delay_is = 'constant'", [], "delay, constant during contact: 0.0009 to 0.0011 s"),
        ("", ["--constant-delay"], "delay, constant during contact: 0.0009 to 0.0011 s"),
        ("", ["--delay", "1e-3", "--lost-samples", "1"], "in a row lost: 0.001 to 0.002 s"),
    ):
        file.write_text(f"{text}sample_time = 0.001\ndelay = [0.9e-3, 1.1e-3]\n{keys}\n", "utf-8")
        narrow = ["--mass", "0.0999:0.1", "--cells", "1,1,16", "-o", header]
        answer = run("guard", file, *options, *narrow)
        assert answer.exit_code == 0, answer.stderr
        assert words in answer.stdout


@pytest.mark.parametrize("name", ["", "1a", "a-b", "a b", "a\n", "a" * 41])
def test_a_guard_has_a_short_name_of_c(name: str) -> None:
    with pytest.raises(ValueError, match=r"name is .*; give at most 40 letters"):
        checked_name(name)
