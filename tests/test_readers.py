"""The readers in data/readers, and xarray, answer as Python does: on the atlas in data/golden."""

import os
import shutil
import subprocess
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from textwrap import dedent
from typing import Any, NamedTuple

import numpy as np
import pytest
from atlases import write_cut, write_whole
from footers import sealed
from hostile import assembled, retold, sub
from programs_in_c import READER, compiled

from benchmarks import truth
from benchmarks.truth.filtered import FilteredLoop, average, difference
from jaxstab import Atlas, AtlasSpec, Verdict, open_atlas
from jaxstab.atlas.file import table_of
from jaxstab.atlas.product import SLICE
from jaxstab.atlas.products.table import PRODUCTS
from jaxstab.atlas.schema import (
    SCHEMA_VERSION,
    VARIABLES,
    content_digest,
    stored_of,
)
from jaxstab.atlas.write.variables import checked_datasets, opened, text_of
from jaxstab.model import by_name
from jaxstab.results import QueryStatus

DATA = Path(__file__).resolve().parents[1] / "data"
GOLDEN = DATA / "golden" / "atlas-v3.h5"
WINDOW = DATA / "golden" / "atlas-v3-window.h5"
OUTSIDE = -1
CASES = 500  # points of each kind at each delay
NO_NUMBER = (np.nan, np.inf, -np.inf, 1e300, -1e300)


class Answers(NamedTuple):
    """What a reader says about points: a code, and the limits of alpha with their errors."""

    codes: np.ndarray
    limits: np.ndarray  # (point, 4)


GOLDEN_FILES = ["version 3", "window"]


@pytest.fixture(scope="module", params=[*GOLDEN_FILES, "cut", "whole"])
def golden(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The golden files, one that ends within the stable set, and one whose axes hold all of it."""
    known = {"version 3": GOLDEN, "window": WINDOW}
    if request.param in known:
        return known[request.param]
    path = tmp_path_factory.mktemp("made") / "atlas.h5"
    return write_cut(path) if request.param == "cut" else write_whole(path)


@pytest.fixture(scope="module")
def atlas(golden: Path) -> Atlas:
    return open_atlas(golden)


@pytest.fixture(scope="module")
def points(atlas: Atlas) -> np.ndarray:
    """Points of all kinds, (point, 5): inside, on edges and limits, outside, and no points."""
    rng = np.random.default_rng(20120412)
    kinds = []
    for number, delay in enumerate(atlas.delays):
        nodes = list(atlas.nodes(number).values())
        cells = atlas.arrays["limit_cell"].size
        edges = [nodes[0], np.linspace(nodes[1][0], nodes[1][-1], cells + 1), *nodes[2:]]
        inside = np.stack([rng.uniform(axis[0], axis[-1], CASES) for axis in nodes], axis=1)
        on_edges = np.stack([rng.choice(axis, CASES) for axis in edges], axis=1)
        on_limits = inside.copy()
        at = atlas.alpha_limits(**by_name(*inside.T[1:], delay))
        on_limits[: CASES // 2, 0] = (at.lower + at.lower_error)[: CASES // 2]
        on_limits[CASES // 2 :, 0] = (at.upper - at.upper_error)[CASES // 2 :]
        on_limits = on_limits[np.isfinite(on_limits[:, 0])]
        beyond = inside.copy()
        row, column = np.arange(CASES), rng.integers(4, size=CASES)
        beyond[row, column] = [
            rng.choice([np.nextafter(axis[0], -np.inf), np.nextafter(axis[-1], np.inf), *NO_NUMBER])
            for axis in (nodes[i] for i in column)
        ]
        free = inside[:50] * np.array([0.0, 1.0, 0.0, 1.0])  # nothing holds the device
        kinds += [
            np.insert(kind, 4, delay, axis=1)
            for kind in (inside, on_edges, on_limits, beyond, free)
        ]
    between = kinds[0].copy()
    between[:, 4] = rng.uniform(atlas.delays[0], atlas.delays[-1], CASES)
    edges = kinds[0].copy()
    edges[:, 4] = rng.choice(atlas.arrays["limit_range"][:, :2].ravel(), CASES)
    kinds += [between, edges]
    elsewhen = kinds[0].copy()
    elsewhen[:, 4] = rng.choice([-1.0, -0.0, 0.5, np.nextafter(1.0, 2.0), 7.0, *NO_NUMBER], CASES)
    return np.concatenate([*kinds, elsewhen])


@pytest.fixture(scope="module")
def expected(atlas: Atlas, points: np.ndarray) -> Answers:
    """What Python says; it refuses to answer for what is outside."""
    answers = Answers(
        np.full(len(points), OUTSIDE), np.tile([np.nan, np.inf, np.nan, np.inf], (len(points), 1))
    )
    for place, (alpha, *hand) in enumerate(points.tolist()):
        try:
            at = atlas.alpha_limits(**by_name(*hand))
            answers.limits[place] = [at.lower, at.lower_error, at.upper, at.upper_error]
        except ValueError:
            pass
        try:
            code = atlas.verdict(**by_name(alpha, *hand))
        except ValueError:
            continue
        if code == Verdict.UNSTABLE or not np.isinf(answers.limits[place, [1, 3]]).all():
            answers.codes[place] = code  # elsewhere Python says that it does not know
    return answers


@pytest.mark.parametrize("golden", GOLDEN_FILES, indirect=True)
def test_the_points_are_of_all_kinds(expected: Answers) -> None:
    lower, _, upper, _ = expected.limits[expected.codes != OUTSIDE].T
    assert np.isnan(lower).sum() > 50  # no alpha is stable
    assert np.isinf(upper).sum() > 50  # the limit is beyond the atlas
    for code in (OUTSIDE, Verdict.STABLE, Verdict.UNSTABLE, Verdict.UNDECIDED):
        assert np.mean(expected.codes == code) > 0.04


@pytest.mark.parametrize("golden", GOLDEN_FILES, indirect=True)
def test_the_golden_atlas_is_read_today(
    golden: Path, atlas: Atlas, rng: np.random.Generator
) -> None:
    assert AtlasSpec.from_toml(atlas.spec) == AtlasSpec.from_file(golden.with_suffix(".toml"))
    with opened(golden) as file:
        datasets = checked_datasets(file, table_of(golden))
        lines = [stored_of(name, data).line for name, data in datasets.items()]
        assert content_digest(lines) == text_of(file, "content_sha256")
    for delay in atlas.delays.tolist():
        nodes = atlas.nodes(atlas.delays.tolist().index(delay)).values()
        for _ in range(8):
            point = (*(float(rng.uniform(axis[0], axis[-1])) for axis in nodes), delay)
            answer = atlas.query(**by_name(*point))
            radius = _true_radius(point, is_windowed=golden == WINDOW)
            if answer.verdict != Verdict.UNDECIDED:
                assert (answer.verdict == Verdict.STABLE) == (radius < 1)


def _true_radius(point: tuple[float, ...], *, is_windowed: bool) -> float:
    if not is_windowed:
        return truth.spectral_radius(*point)[0]
    alpha, beta, *slice_of = point
    return float(FilteredLoop(*slice_of, difference(5), average(1)).radius(alpha, beta).mid())


def test_the_page_of_the_format_names_everything() -> None:
    page = (DATA / "README.md").read_text(encoding="utf-8")
    assert f"This is schema version {SCHEMA_VERSION};" in page
    assert [name for name in VARIABLES if f"`{name}`" not in page] == []
    with opened(GOLDEN) as file:
        assert [name for name in file.attrs if f"`{name}`" not in page] == []


def run(*words: str | Path, points: np.ndarray | None = None) -> subprocess.CompletedProcess[str]:
    given = "" if points is None else "\n".join(" ".join(map(repr, p)) for p in points.tolist())
    return subprocess.run([*map(str, words)], input=given, capture_output=True, text=True)


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example program in C."""
    folder = tmp_path_factory.mktemp("c")
    return compiled(READER / "jaxstab_query.c", folder, ["-pedantic-errors", "-O2"])


def test_c_answers_as_python_does(
    golden: Path, program: Path, points: np.ndarray, expected: Answers
) -> None:
    codes = run(program, golden, points=points)
    np.testing.assert_array_equal(np.fromstring(codes.stdout, int, sep=" "), expected.codes)
    limits = run(program, golden, "--limits", points=points[:, 1:])
    said = np.array(limits.stdout.split(), float).reshape(-1, 4)
    np.testing.assert_array_equal(said, expected.limits)


def test_c_tells_its_speed_and_what_is_wrong(program: Path, tmp_path: Path) -> None:
    assert "ns a query" in run(program, GOLDEN, "--bench").stdout
    wrong = run(program, GOLDEN, "--fast")
    assert wrong.returncode == 2
    assert "Lines of stdin: alpha beta gamma delta delay" in wrong.stderr
    assert run(program, GOLDEN, points=np.array([[0.1, 0.2, 0.3]])).returncode == 2
    for path, words in refused_files(tmp_path):
        answer = run(program, path)
        assert (answer.returncode, answer.stdout) == (1, "")
        assert answer.stderr.startswith(f"{path} {words}")


def test_c_refuses_every_change_of_the_file(
    program: Path, tmp_path: Path, rng: np.random.Generator
) -> None:
    whole = GOLDEN.read_bytes()
    damaged = tmp_path / "damaged.h5"
    for place in rng.integers(len(whole), size=30).tolist():
        bit = 1 << int(rng.integers(8))
        damaged.write_bytes(whole[:place] + bytes([whole[place] ^ bit]) + whole[place + 1 :])
        assert run(program, damaged).returncode == 1


def refused_files(folder: Path) -> Iterator[tuple[Path, str]]:
    """Yield files that no reader may take for an atlas, and the words of the refusal."""
    whole = GOLDEN.read_bytes()
    damage = "is damaged, or no jaxstab atlas"
    yield folder / "missing.h5", "cannot be read"
    for name, data, words in (
        ("empty", b"", damage),
        ("truncated", whole[:-1], damage),
        ("without-footer", whole[:-48], damage),
        ("older", sealed(bytes(1000)), "has another schema version than 3, or none"),
        ("newer", retold(whole, sub("atlas 3", "atlas 4")), "has another schema version than 3"),
        ("without-limits", edited(*PRODUCTS["alpha_limits"].names), "holds no limits"),
        ("without-gamma", edited("gamma"), damage),
    ):
        path = folder / f"{name}.h5"
        path.write_bytes(data)
        yield path, words
    os.mkfifo(folder / "pipe.h5")  # item 31 of an audit: it was waited for
    yield folder / "pipe.h5", "cannot be read"


def edited(*removed: str) -> bytes:
    """The golden atlas without some of its arrays."""
    arrays = open_atlas(GOLDEN).arrays
    return assembled({name: arrays[name] for name in arrays if name not in removed})


def octave(script: str) -> str:
    program = shutil.which("octave-cli")
    if program is None:
        pytest.skip("Octave is not installed")
    path = f"addpath('{DATA / 'readers' / 'octave'}');"
    words = [program, "--no-gui", "--norc", "--quiet", "--eval", path + script]
    done = subprocess.run(words, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    assert done.returncode == 0, done.stderr
    assert "warning" not in done.stderr
    return done.stdout


def test_octave_answers_as_python_does(
    golden: Path, tmp_path: Path, points: np.ndarray, expected: Answers
) -> None:
    points.astype("<f8").tofile(tmp_path / "points")
    octave(f"""
        atlas = jaxstab_query('{golden}');
        p = fread(fopen('{tmp_path}/points'), [5, Inf], 'double', 'ieee-le');
        [code, low, low_error, high, high_error] = ...
            jaxstab_query(atlas, p(1, :), p(2, :), p(3, :), p(4, :), p(5, :));
        fwrite(fopen('{tmp_path}/answers', 'w'), [code; low; low_error; high; high_error], ...
               'double', 'ieee-le');
        """)
    answers = np.fromfile(tmp_path / "answers", "<f8").reshape(-1, 5)
    np.testing.assert_array_equal(answers[:, 0], expected.codes)
    np.testing.assert_array_equal(answers[:, 1:], expected.limits)


def test_octave_keeps_the_shape_of_points_and_says_what_is_wrong(tmp_path: Path) -> None:
    files = dict(refused_files(tmp_path))
    listed = ", ".join(f"'{path}'" for path in files)
    said = octave(f"""
        atlas = jaxstab_query('{GOLDEN}');
        disp(size(jaxstab_query(atlas, zeros(2, 3), 0.3, 0.0, 0.0, 1)));
        for file = {{{listed}}}
          try
            jaxstab_query(file{{1}});
          catch problem
            disp(problem.message);
          end
        end
        """).splitlines()
    assert said[0].split() == ["2", "3"]
    for line, (path, words) in zip(said[1:], files.items(), strict=True):
        assert words in line
        assert str(path) in line


def test_xarray_finds_named_coordinates(golden: Path, atlas: Atlas) -> None:
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    with xarray.open_dataset(golden, engine="h5netcdf") as dataset:
        assert {"alpha", "beta", "gamma", "delta", "delay"} <= set(dataset.coords)
        assert set(dataset.data_vars) == set(atlas.arrays) - set(dataset.coords)
        for gamma, delta, delay in product(*(atlas.arrays[n].tolist() for n in SLICE)):
            plane = dataset.sel(gamma=gamma, delta=delta, delay=delay)
            gains = np.broadcast_arrays(*xarray.broadcast(plane.alpha, plane.beta))
            answer = atlas.query(*gains, gamma=gamma, delta=delta, delay=delay)
            assert np.all(answer.status == QueryStatus.NODE)
            decided = np.asarray(plane.verdict != Verdict.UNDECIDED)
            np.testing.assert_array_equal(answer.verdict[decided], plane.verdict.data[decided])
        assert dataset.verdict.attrs["flag_meanings"].split()[Verdict.STABLE] == "stable"
        page = (DATA / "README.md").read_text(encoding="utf-8")
        _, *lines = page.split('dataset = xarray.open_dataset("atlas.h5"')[1].splitlines()[:4]
        *first, last = dedent("\n".join(lines)).splitlines()
        names: dict[str, Any] = {"dataset": dataset}
        exec("\n".join(first), names)
        node = eval(last, names)
        place = {name: float(node[name]) for name in ("gamma", "delta", "delay")}
        said = atlas.query(float(node.alpha), float(node.beta), **place)
        assert int(node) == said.verdict
        assert abs(node.alpha - 0.1) == abs(names["plane"].alpha - 0.1).min()
