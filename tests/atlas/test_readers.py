"""Verdicts and atlases in C: against roots of 50 digits, and against Python."""

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import flint
import numpy as np
import pytest
from atlases import UNSOUND, edited, small_file, write_small
from campaign import many
from mpmath import mpf
from programs_in_c import READER, STRICT, compiled, hdf5_options

import jaxstab
from benchmarks.answers import points_of
from jaxstab import Verdict, boundary_curve
from jaxstab.results import QueryStatus
from tests.truth import loop as truth

HERE = Path(__file__).parents[1]
GOLDEN = READER.parents[1] / "golden"
CLEAN = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
FAST = ["-O2", *STRICT]
ODD = [0.0, -0.0, 5e-324, 1e-300, 1.0, -1.0, 59.9, 60.0, 1e4, 1e100, 1e300, np.inf, -np.inf, np.nan]


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("verdict")
    return compiled(HERE / "verdict_points.c", folder, [*FAST, *CLEAN], FAST)


def asked(program: Path, numbers: np.ndarray, *mode: str) -> np.ndarray:
    done = subprocess.run(
        [program, *mode], input=numbers.tobytes(), capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr.decode()
    return np.frombuffer(done.stdout)


def exact_codes(points: np.ndarray) -> np.ndarray:
    alpha, beta, gamma, delta, delay = points.T
    plant = {"gamma": gamma, "delta": delta, "delay": delay}
    return np.asarray(jaxstab.verdict(alpha, beta, **plant, resolve="exact"))


def near_curve(rng: np.random.Generator, count: int) -> np.ndarray:
    """Walls of the haptic range next to the boundary, from 1e-12 to 1e-6 of alpha aside."""
    gamma, delta = rng.uniform(0.0, 1e-3, count), rng.uniform(0.0, 0.015, count)
    delay = rng.uniform(0.0, 3.0, count)
    theta = rng.uniform(0.0, 0.5, count) * np.pi / (delay + 1.0)
    alpha, beta = map(np.asarray, boundary_curve(theta, gamma=gamma, delta=delta, delay=delay))
    aside = 1.0 + rng.choice([-1.0, 1.0], count) * 10.0 ** rng.uniform(-12.0, -6.0, count)
    return np.stack([alpha * aside, beta, gamma, delta, delay], axis=-1)


def wild(rng: np.random.Generator, count: int) -> np.ndarray:
    """Any devices and gains, some without spring or damper, alpha on both sides of -gamma."""
    gamma = 10.0 ** rng.uniform(-6.0, 4.0, count) * rng.choice([0.0, 1.0, 1.0], count)
    delta = 10.0 ** rng.uniform(-6.0, 3.0, count) * rng.choice([0.0, 1.0, 1.0], count)
    alpha, beta = rng.normal(size=(2, count)) * 10.0 ** rng.uniform(-4.0, 1.0, (2, count))
    return np.stack([alpha - gamma, beta, gamma, delta, rng.uniform(0.0, 25.0, count)], axis=-1)


@pytest.mark.parametrize(("points", "undecided"), [(near_curve, 0.08), (wild, 0.03)])
def test_no_verdict_in_c_is_wrong(
    points: Callable[..., np.ndarray], undecided: float, program: Path, rng: np.random.Generator
) -> None:
    cases = points(rng, 4000)
    codes, exact = asked(program, cases), exact_codes(cases)
    assert set(np.unique(codes).tolist()) <= {1.0, 2.0, 3.0}
    known = (codes != Verdict.UNDECIDED) & (exact != Verdict.UNDECIDED)
    assert (codes[known] == exact[known]).all()
    assert np.mean(codes == Verdict.UNDECIDED) < undecided
    assert min(np.mean(codes == Verdict.STABLE), np.mean(codes == Verdict.UNSTABLE)) > 0.05


@pytest.mark.campaign
@pytest.mark.parametrize("points", [near_curve, wild])
def test_no_verdict_in_c_of_a_million_is_wrong(
    points: Callable[..., np.ndarray], program: Path
) -> None:
    rng, total = np.random.default_rng(17), 0
    while total < many(1_000_000, 30_000):
        cases = points(rng, 15_000)
        codes, exact = asked(program, cases), exact_codes(cases)
        known = (codes != Verdict.UNDECIDED) & (exact != Verdict.UNDECIDED)
        assert (codes[known] == exact[known]).all()
        total += len(cases)


@pytest.mark.parametrize("count", [60, pytest.param(many(10_000, 250), marks=pytest.mark.campaign)])
def test_bounds_of_coefficients_hold_against_50_digits(
    count: int, program: Path, rng: np.random.Generator
) -> None:
    cases = np.concatenate([near_curve(rng, 60), wild(rng, count)])
    cases[:30, 4] = np.round(cases[:30, 4])
    found = asked(program, cases, "loops").reshape(len(cases), 2, -1)
    ratios = []
    for point, (values, errors) in zip(cases.tolist(), found, strict=True):
        exact = truth.polynomial(*point)
        exact += [0] * (int(point[4]) + 5 - len(exact))
        for value, error, right in zip(values, errors, exact, strict=False):
            miss = abs(float(value - right))
            assert miss <= error
            ratios.append(miss / error if error else 0.0)
    assert 0.02 < max(ratios) < 0.7  # the assumption has room, but not much more than it needs


def test_verdicts_on_any_polynomial_are_those_of_exact_roots(
    program: Path, rng: np.random.Generator
) -> None:
    roots = rng.uniform(0.2, 1.2, (600, 3)) * np.exp(1j * rng.uniform(0.0, np.pi, (600, 3)))
    falling = np.array([np.poly([*row, *row.conj()]).real for row in roots])
    falling *= rng.choice([-3.0, 1.0], (600, 1))
    codes = asked(program, falling, "polynomials")
    for own, code in zip(falling.tolist(), codes, strict=True):
        exact = flint.fmpq_poly([truth.as_fmpq(mpf(c)) for c in own[::-1]])
        is_stable = all(abs(root) < 1 for root, _ in exact.complex_roots())
        assert code in (Verdict.STABLE if is_stable else Verdict.UNSTABLE, Verdict.UNDECIDED)
    assert np.mean(codes == Verdict.UNDECIDED) < 0.05
    odd = np.array([[0.0] * 7, [np.nan] * 7, [1.0] + [np.inf] * 6, [1.0] * 7])
    assert asked(program, odd, "polynomials").tolist() == [Verdict.UNDECIDED] * 4
    lost = 5e-324 * np.array([[56.0, -44.0, 48.0, 5.0, -12.0, 1.0, 0.0]])  # 1.0033 is a modulus
    assert asked(program, lost, "polynomials") != Verdict.STABLE


def test_extreme_numbers_are_answered_without_a_fault(program: Path) -> None:
    cases = np.stack(np.meshgrid(*[ODD] * 5), axis=-1).reshape(-1, 5)[::17]
    codes = asked(program, cases)
    bad = ~np.isfinite(cases).all(axis=1) | (cases[:, 2:] < 0.0).any(axis=1)
    assert (codes[bad] == Verdict.UNDECIDED).all()
    assert set(codes.tolist()) == {1.0, 2.0, 3.0}


@pytest.mark.parametrize("option", ["-ffast-math", "-ffinite-math-only"])
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_compilers_that_leave_out_comparisons_with_nan_are_refused(
    compiler: str, option: str
) -> None:
    """By either option NaN passed, decided by clang's program, and a crash of gcc's."""
    if shutil.which(compiler) is None:
        pytest.skip(f"there is no {compiler}")
    words = [compiler, "-std=c99", "-fsyntax-only", f"-I{READER}", HERE / "verdict_points.c"]
    assert subprocess.run(words, capture_output=True, check=False).returncode == 0
    done = subprocess.run([*words, option], capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "no -ffast-math, no -ffinite-math-only" in done.stderr


def test_the_left_edge_needs_no_rounding(program: Path) -> None:
    gamma = np.array([0.0, 1e-3, 3.0])
    plant = np.stack([np.full(3, 0.2), gamma, np.full(3, 0.01), np.full(3, 1.0)], axis=-1)
    for alpha, code in ((-gamma, Verdict.UNSTABLE), (np.nextafter(-gamma, 1.0), Verdict.STABLE)):
        found = asked(program, np.concatenate([alpha[:, None], plant], axis=1))
        assert found[:2].tolist() == [code] * 2


# ------------------------------------------------------------------------------- atlases by libhdf5


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("reader")
    options, libraries = ["-O2", "-Wall", "-Wextra", "-Werror"], hdf5_options()
    return compiled(
        READER / "jaxstab_query.c", folder, [*options, *CLEAN], options, libraries=libraries
    )


def lines_of(reader: Path, path: Path, points: np.ndarray, *mode: str) -> np.ndarray:
    text = "\n".join(" ".join(map(repr, row)) for row in points.tolist())
    done = subprocess.run(
        [reader, path, *mode], input=text, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return np.array([list(map(float, line.split())) for line in done.stdout.splitlines()])


@pytest.mark.parametrize("name", ["small", "golden", "window"])
def test_answers_in_c_are_those_in_python(
    name: str, reader: Path, tmp_path: Path, rng: np.random.Generator
) -> None:
    golden = {"golden": GOLDEN / "atlas-v5.h5", "window": GOLDEN / "atlas-v5-window.h5"}
    path = golden.get(name) or write_small(tmp_path)
    atlas = jaxstab.open_atlas(path)
    kinds = ("random", "near", "faces", "whole")
    points = np.concatenate(
        [np.stack(points_of(atlas.table, kind, 400, rng), axis=-1) for kind in kinds]
    )
    points[::10, 2:] *= rng.uniform(0.9, 1.3, (160, 3))  # some beyond the nodes
    codes = lines_of(reader, path, points)[:, 0]
    alpha, beta, gamma, delta, delay = points.T
    answer = atlas.query(alpha, beta, gamma=gamma, delta=delta, delay=delay)
    known = codes != Verdict.UNDECIDED
    assert (codes[known] == answer.verdict[known]).all()
    by_table = answer.status == QueryStatus.INTERPOLATED
    assert np.mean(known[by_table]) > 0.999  # rounding at four times the error alone
    if name == "window":  # of other loops C knows the table alone
        assert np.mean(known[~by_table]) < 0.15  # C has less room for rounding
    else:
        assert known.mean() > 0.98
    limits = lines_of(reader, path, points[:, 1:], "--limits")
    own = atlas.alpha_limits(beta, gamma=gamma, delta=delta, delay=delay)
    expected = np.stack([own.lower, own.upper, own.lower_error, own.upper_error], axis=-1)
    inside = ~np.isnan(expected[:, 1]) & ~np.isnan(limits[:, 1])
    np.testing.assert_allclose(limits[inside], expected[inside], rtol=1e-9, atol=1e-15)
    assert np.sum(np.isnan(expected[:, 1]) != np.isnan(limits[:, 1])) < 5  # at the ends of beta


@pytest.mark.parametrize("name", UNSOUND)
def test_what_python_refuses_c_refuses_or_does_not_use(
    name: str, reader: Path, tmp_path: Path
) -> None:
    path = edited(tmp_path / "bad.h5", UNSOUND[name])
    done = subprocess.run([reader, path], input="", capture_output=True, text=True, check=False)
    unused = {"rows that are not even", "another code", "an infinite limit"}
    unused |= {"words that are numbers", "no count", "words that are not UTF-8"}
    unused |= {"no checksum", "a link"}  # which libhdf5 follows
    assert done.returncode == 1 or (name in unused and done.returncode == 0), done.stderr
    assert "Sanitizer" not in done.stderr


@pytest.mark.campaign
def test_mutants_are_refused_or_right_in_c(reader: Path, tmp_path: Path) -> None:
    """300 at full size: bytes of a file changed."""
    chance, data = np.random.default_rng(23), small_file()
    atlas = jaxstab.open_atlas(write_small(tmp_path))
    points = np.stack(points_of(atlas.table, "random", 50, chance), axis=-1)
    text = "\n".join(" ".join(map(repr, row)) for row in points.tolist())
    right = subprocess.run(
        [reader, tmp_path / "small.h5"], input=text, capture_output=True, text=True, check=True
    ).stdout
    refused = 0
    for _ in range(many(300)):
        mutant = bytearray(data)
        mutant[int(chance.integers(len(mutant)))] ^= 1 << int(chance.integers(8))
        (tmp_path / "m.h5").write_bytes(mutant)
        done = subprocess.run(
            [reader, tmp_path / "m.h5"], input=text, capture_output=True, text=True, check=False
        )
        assert done.returncode in (0, 1), done.stderr
        assert done.returncode == 1 or done.stdout == right
        refused += done.returncode
    assert refused > 0
