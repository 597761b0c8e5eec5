"""Files from strangers are refused in a sentence, or answered as what they were made from.

By Python, by C under the sanitizers of addresses and undefined behaviour, and by Octave.
"""

import shutil
import subprocess
import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from campaign import many
from counts import note
from hostile import Arrays, assembled, hostile_files, mutants
from hostile_images import IMAGES, with_another_image
from programs_in_c import compiled

from jaxstab import Atlas, AtlasSpec, FittedAxis, build_atlas, open_atlas
from jaxstab.atlas import file
from jaxstab.atlas.product import NODE
from jaxstab.atlas.products.table import PRODUCTS
from jaxstab.model import by_name

ROOT = Path(__file__).resolve().parents[1]
GOLDEN = ROOT / "data" / "golden" / "atlas-v3.h5"
READERS = ROOT / "data" / "readers"
SANITIZED = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g"]
OUTSIDE = -1
CI, CAMPAIGN = 500, many(20_000, small=1000)
MOST_MEMORY = 200 * 2**20  # bytes

Said = tuple[bool, str]
"""Whether a file was answered, and the codes of points or the words of the refusal."""


class Base(NamedTuple):
    """What hostile files are made from: arrays, points to ask about, and the right answers."""

    arrays: Arrays
    points: np.ndarray
    codes: np.ndarray


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Base:
    """A tenth of the cells of the golden atlas: a file of 20 kB."""
    arrays: Arrays = dict(open_atlas(GOLDEN).arrays)
    arrays["alpha_limits"] = np.ascontiguousarray(arrays["alpha_limits"][::10])
    arrays["limit_cell"] = np.arange(4, dtype=np.int32)
    path = tmp_path_factory.mktemp("base") / "base.h5"
    path.write_bytes(assembled(arrays))
    rng = np.random.default_rng(20120412)
    ends = [(axis.min(), axis.max()) for axis in (arrays[name] for name in ("alpha", "beta"))]
    sides = [*ends, (0.0, 0.0011), (0.0, 0.016)]
    points = np.stack([rng.uniform(*side, 300) for side in sides], axis=1)
    points = np.insert(
        points, 4, rng.choice([0.0, 1.0, 1.5, *rng.uniform(0.0, 1.5, 9)], 300), axis=1
    )
    atlas = open_atlas(path)
    on_limits = points[codes_of(atlas, points) != OUTSIDE][:100].copy()
    for point in on_limits:
        upper = atlas.alpha_limits(**by_name(*map(float, point[1:]))).upper
        point[0] = upper if np.isfinite(upper) else point[0]
    points = np.concatenate([points, on_limits])
    return Base(arrays, points, codes_of(atlas, points))


def codes_of(atlas: Atlas, points: np.ndarray) -> np.ndarray:
    """What Python says, with the code of the other readers outside of the limits of alpha.

    They read nothing else.
    """
    answer = atlas.query(**by_name(*points.T), outside="undecided")
    early, late = atlas.arrays["limit_range"][:, :2].T
    has_limits = ((points[:, 4:] >= early) & (points[:, 4:] <= late)).any(axis=1)
    return np.where(has_limits & (answer.status < 4), answer.verdict, OUTSIDE)


def said_by_python(path: Path, points: np.ndarray) -> Said:
    """As C does, and every array is asked for."""
    try:
        atlas = open_atlas(path)
        arrays = dict(atlas.arrays)
    except ValueError as refusal:
        words = str(refusal)
    else:
        return True, answered(atlas, arrays, points)
    assert words.startswith(str(path))
    assert words.endswith(".")
    assert words.isprintable()
    return False, words


def answered(atlas: Atlas, arrays: Arrays, points: np.ndarray) -> str:
    assert atlas.created_by.isprintable()
    assert set(arrays) == set(atlas.arrays)
    assert np.all(arrays["alpha_limits"][..., [9, 19]] >= 0.0)
    return words_of(codes_of(atlas, points))


def words_of(codes: np.ndarray) -> str:
    return "".join(map(str, codes + 1))


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    source, folder = Path(__file__).with_name("open_many.c"), tmp_path_factory.mktemp("c")
    warned = ["-O1", "-Wall", "-Wextra", "-Werror"]
    return compiled(source, folder, [*warned, *SANITIZED], warned)  # some have no sanitizers


@pytest.fixture
def said_by_c(program: Path, base: Base, tmp_path: Path) -> Iterator[Callable[[Path], Said]]:
    """Ask the reader in C, which must not end before it is told to."""
    base.points.astype("<f8").tofile(tmp_path / "points")
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([program, tmp_path / "points"], **pipes) as child:

        def ask(path: Path) -> Said:
            child.stdin.write(f"{path}\n")
            child.stdin.flush()
            word, _, rest = child.stdout.readline().rstrip("\n").partition(" ")
            assert word in ("answered", "refused")
            return word == "answered", rest

        yield ask
        child.stdin.close()
        assert child.wait() == 0


def said_by_octave(paths: Sequence[Path], points: np.ndarray, folder: Path) -> list[Said]:
    program = shutil.which("octave-cli")
    if program is None:
        pytest.skip("Octave is not installed")
    points.astype("<f8").tofile(folder / "points")
    (folder / "names").write_text("".join(f"{path}\n" for path in paths), encoding="ascii")
    script = f"""
        addpath('{READERS / "octave"}');
        p = fread(fopen('{folder}/points'), [5, Inf], 'double', 'ieee-le');
        for name = strsplit(strtrim(fileread('{folder}/names')), "\\n")
          try
            atlas = jaxstab_query(name{{1}});
            code = jaxstab_query(atlas, p(1, :), p(2, :), p(3, :), p(4, :), p(5, :));
            printf('answered %s\\n', sprintf('%d', code + 1));
          catch problem
            printf('refused %s %s\\n', problem.identifier, problem.message);
          end
        end
        """
    words = [program, "--no-gui", "--norc", "--quiet", "--eval", script]
    done = subprocess.run(words, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    assert done.returncode == 0, done.stderr
    lines = [line.partition(" ") for line in done.stdout.splitlines()]
    for word, _, rest in lines:
        assert word == "answered" or rest.startswith("jaxstab:")
    return [(word == "answered", rest) for word, _, rest in lines]


@pytest.mark.campaign
def test_what_is_not_hostile_is_answered_alike(
    base: Base, said_by_c: Callable[[Path], Said], tmp_path: Path
) -> None:
    """With chunks of whole arrays, and with such as do not fit into them."""
    for number, chunk in enumerate([(4, 2, 2, 6, 20), (3, 2, 1, 4, 20), (1, 1, 1, 1, 3)]):
        path = tmp_path / f"{number}.h5"
        path.write_bytes(assembled(base.arrays, {"alpha_limits": chunk, "alpha": (7, 2)}))
        expected = True, words_of(base.codes)
        assert said_by_python(path, base.points) == expected
        assert said_by_c(path) == expected
        assert said_by_octave([path], base.points, tmp_path) == [expected]
    assert set(base.codes) == {-1, 1, 2, 3}


def test_no_reader_takes_a_hostile_file_for_an_atlas(
    base: Base, said_by_c: Callable[[Path], Said], tmp_path: Path
) -> None:
    paths = {}
    for number, (name, (data, by_all)) in enumerate(hostile_files(base.arrays).items()):
        paths[tmp_path / f"{number}.h5"] = name, by_all
        (tmp_path / f"{number}.h5").write_bytes(data)
    octave = said_by_octave([*paths], base.points, tmp_path)
    right = True, words_of(base.codes)
    tracemalloc.start()
    for (path, (name, by_all)), by_octave in zip(paths.items(), octave, strict=True):
        assert not said_by_python(path, base.points)[0], name
        for said in (said_by_c(path), by_octave):
            assert not said[0] or (not by_all and said == right), name
    assert tracemalloc.get_traced_memory()[1] < MOST_MEMORY
    tracemalloc.stop()


def test_28_many_codes_in_a_small_file_do_not_fill_the_memory(base: Base, tmp_path: Path) -> None:
    """252 MB of codes, unpacked from 4.2 MB at the first question."""
    counts, arrays = (2048, 2048, 1, 1, 60), dict(base.arrays)
    chosen = {*PRODUCTS["alpha_limits"].names, *PRODUCTS["fields"].names}
    arrays = {name: values for name, values in arrays.items() if name not in chosen}
    for name, count in zip(NODE[:2], counts, strict=False):
        cells = name.replace("node", "cell")
        arrays[name], arrays[cells] = (np.arange(n, dtype=np.int32) for n in (count, count - 1))
        nodes = np.linspace(0.0, 1.0, count)[:, None] * np.ones((1, 60))
        arrays[name.removesuffix("_node")] = nodes
    for name in ("gamma", "delta"):
        arrays |= {name: np.zeros(1), f"{name}_cell": np.zeros(1, np.int32)}
    arrays["delay"] = np.arange(60.0)
    cells = 2047, 2047, 1, 1, 60
    arrays["verdict"] = np.broadcast_to(np.int8(0), counts)
    arrays["cell_verdict"] = np.broadcast_to(np.int8(0), cells)
    chunks = {"verdict": (*counts[:4], 1), "cell_verdict": (*cells[:4], 1)}
    path = tmp_path / "codes.h5"
    path.write_bytes(assembled(arrays, chunks))
    assert path.stat().st_size < 5 * 10**6
    tracemalloc.start()
    atlas = open_atlas(path)
    answer = atlas.query([0.5, 0.0], [0.25, 0.0], gamma=0.0, delta=0.0, delay=[7.0, 59.0])
    assert atlas.decided_fraction(3) == 0.0
    assert tracemalloc.get_traced_memory()[1] < 100 * 2**20
    tracemalloc.stop()
    assert answer.verdict.tolist() == [0, 0]


def test_28_codes_are_the_same_chunk_by_chunk(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    spec = AtlasSpec(
        alpha=FittedAxis(24), beta=FittedAxis(20), gamma=[0.0, 0.0005, 0.001],
        delta=[0.0, 0.005, 0.015], delay=[0.0, 1.5], products=["verdict"],
    )  # fmt: skip
    atlas = build_atlas(spec, tmp_path / "a.h5")
    rng = np.random.default_rng(28)
    nodes = [*atlas.nodes(1).values()]
    points = np.array([rng.uniform(axis[0], axis[-1], 3000) for axis in nodes])
    points[:, :1000] = [rng.choice(axis, 1000) for axis in nodes]
    codes = atlas.query(**by_name(*points, 1.5)).verdict
    shares = [atlas.decided_fraction(number) for number in (0, 1)]
    assert set(codes) == {1, 2, 3}
    monkeypatch.setattr(file, "LARGEST_UNASKED", 0)
    chunked = open_atlas(tmp_path / "a.h5")
    np.testing.assert_array_equal(chunked.query(**by_name(*points, 1.5)).verdict, codes)
    assert [chunked.decided_fraction(number) for number in (0, 1)] == pytest.approx(shares)


def test_no_reader_is_misled_by_a_hostile_image(
    base: Base, said_by_c: Callable[[Path], Said], tmp_path: Path
) -> None:
    """The image is not looked at: a chunk is what its digest says, or the file is refused."""
    whole, paths = GOLDEN.read_bytes(), []
    for number, edit in enumerate(IMAGES.values()):
        paths.append(tmp_path / f"{number}.h5")
        paths[-1].write_bytes(with_another_image(whole, edit))
    right = True, words_of(codes_of(open_atlas(GOLDEN), base.points))
    for path, by_octave in zip(paths, said_by_octave(paths, base.points, tmp_path), strict=True):
        for said in (said_by_python(path, base.points), said_by_c(path), by_octave):
            assert not said[0] or said == right


def tally(base: Base, said_by_c: Callable[[Path], Said], path: Path, count: int) -> dict[str, int]:
    """Ask Python and C about mutants; each is refused, or answered alike by both."""
    counts = {"tried": 0, "refused": 0, "answered": 0}
    for data in mutants(base.arrays, np.random.default_rng(20120412), count):
        path.write_bytes(data)
        python, c = said_by_python(path, base.points), said_by_c(path)
        assert not python[0] or python == c, counts
        counts["tried"] += 1
        counts["answered" if python[0] else "refused"] += 1
    return counts


@pytest.mark.campaign
def test_mutants_with_right_checksums_are_refused_or_answered_alike(
    base: Base, said_by_c: Callable[[Path], Said], tmp_path: Path
) -> None:
    counts = tally(base, said_by_c, tmp_path / "mutant.h5", CI)
    assert counts["refused"] > 0.5 * counts["tried"]
    assert counts["answered"] > 10


@pytest.mark.campaign
def test_many_mutants(base: Base, said_by_c: Callable[[Path], Said], tmp_path: Path) -> None:
    counts = tally(base, said_by_c, tmp_path / "mutant.h5", CAMPAIGN)
    note("mutants with right checksums, through Python and C", **counts)
