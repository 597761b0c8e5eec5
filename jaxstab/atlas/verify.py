"""Check an atlas file: that it is whole, as the schema says, and right at a sample of points.

One slice is in memory at a time, however large the atlas is. Half of the sample is next to where
the verdict changes, where a wrong one would be.
"""

from collections.abc import Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from jaxtyping import Float64, Int8, Int64
from numpy.typing import NDArray

from jaxstab.atlas.answer import AtlasAnswer
from jaxstab.atlas.digest import content_digest, digest_of
from jaxstab.atlas.file import TooLargeError, checked_datasets, inconsistency, opened, text_of
from jaxstab.atlas.query import Atlas, open_atlas
from jaxstab.atlas.schema import CELL_VERDICT, RADIUS_ERROR, SPECTRAL_RADIUS, VERDICT
from jaxstab.conventions import AXES, NOT_COMPUTED, STABLE, UNDECIDED, UNSTABLE
from jaxstab.model import require_x64
from jaxstab.stability import spectral_radius, verdict

_SLICES = 16  # that are looked at

Datasets = Mapping[str, h5py.Dataset]
Axes = Mapping[str, NDArray[Any]]
Place = Sequence[int]  # numbers along gamma, delta and delay


class Check(NamedTuple):
    """What was looked at, whether it was right, and what was found in words."""

    name: str
    passed: bool
    words: str

    def __str__(self) -> str:
        return f"{self.name}: {'ok' if self.passed else 'WRONG'}, {self.words}"


def verify_atlas(path: str | PathLike[str], sample: int = 1000, seed: int = 0) -> Iterator[Check]:
    """Yield one check after the other; the first that fails may be the last.

    Args:
        path: of the file.
        sample: about how many nodes, and as many points in cells, are computed again.
        seed: of the sample.

    Raises:
        OSError: the file is missing or unreadable.
        RuntimeError: JAX's x64 mode is off.

    Source: ``jaxstab.verdict`` with resolve="exact", and ``jaxstab.spectral_radius``.
    """
    require_x64()
    chance = np.random.default_rng(seed)
    try:
        with opened(Path(path)) as file:
            yield Check("file", True, "whole by its SHA-256, of this version of the schema")
            datasets = checked_datasets(file)
            axes = {name: datasets[name][()] for name in AXES}
            shapes = {name: dataset.shape for name, dataset in datasets.items()}
            problem = inconsistency(shapes, axes)
            yield Check("schema", not problem, problem or f"{len(shapes)} variables as it says")
            if not problem:
                yield _content(file, datasets)
                for name in (name for name in _COMPARED if name in datasets):
                    yield _sampled(name, datasets, axes, sample, chance)
        yield _answers(open_atlas(path), sample, chance)
    except TooLargeError:
        return
    except ValueError as error:
        yield Check("file", False, str(error))


def _content(file: h5py.File, datasets: Datasets) -> Check:
    found = content_digest(digest_of(name, dataset) for name, dataset in datasets.items())
    return Check("content", found == text_of(file, "content_sha256"), f"its digest is {found}")


def _sampled(
    name: str, datasets: Datasets, axes: Axes, sample: int, chance: np.random.Generator
) -> Check:
    """Compare a variable with what is computed at points of some slices."""
    counts = datasets[name].shape[2:]
    places = chance.integers(0, counts, (min(_SLICES, sample), 3)).tolist()
    each = -(-sample // len(places))
    wrong = sum(_COMPARED[name](datasets, axes, place, each, chance) for place in places)
    return Check(name, wrong == 0, f"{wrong} of {each * len(places)} points are wrong")


def _wrong_nodes(
    datasets: Datasets, axes: Axes, place: Place, count: int, chance: np.random.Generator
) -> int:
    gamma, delta, delay = place
    codes = datasets[VERDICT][:, :, gamma, delta, delay]
    i, j = _some(codes, count, chance)
    return _wrong_codes(codes[i, j], _nodes(axes, i, j, place))


def _wrong_cells(
    datasets: Datasets, axes: Axes, place: Place, count: int, chance: np.random.Generator
) -> int:
    gamma, delta, delay = place
    codes = datasets[CELL_VERDICT][:, :, gamma, delta, delay]
    i, j = _some(codes, count, chance)
    inside = [
        _within(nodes, cell, chance)
        for nodes, cell in (
            (axes["alpha"][:, delay], i),
            (axes["beta"][:, delay], j),
            (axes["gamma"], np.full(count, gamma)),
            (axes["delta"], np.full(count, delta)),
        )
    ]
    return _wrong_codes(codes[i, j], (*inside, axes["delay"][delay]))


def _wrong_radii(
    datasets: Datasets, axes: Axes, place: Place, count: int, chance: np.random.Generator
) -> int:
    gamma, delta, delay = place
    value, error = (
        datasets[name][:, :, gamma, delta, delay] for name in (SPECTRAL_RADIUS, RADIUS_ERROR)
    )
    i, j = _some(value < 1.0, count, chance)
    radius = spectral_radius(*_nodes(axes, i, j, place))
    difference = np.abs(value[i, j] - np.asarray(radius.value))
    return int(np.sum(~(difference <= error[i, j] + np.asarray(radius.error))))


def _some(
    values: NDArray[Any], count: int, chance: np.random.Generator
) -> tuple[Int64[np.ndarray, " count"], Int64[np.ndarray, " count"]]:
    """Return places in a slice, half of them where the value changes along beta."""
    i, j = (chance.integers(0, length, count) for length in values.shape)
    changes = np.argwhere(values[:, 1:] != values[:, :-1])
    if len(changes):
        near = chance.choice(changes, count // 2)
        i[: count // 2], j[: count // 2] = near[:, 0], near[:, 1] + chance.integers(0, 2)
    return i, j


def _nodes(
    axes: Axes, i: Int64[np.ndarray, " point"], j: Int64[np.ndarray, " point"], place: Place
) -> tuple[Any, ...]:
    gamma, delta, delay = place
    gains = axes["alpha"][i, delay], axes["beta"][j, delay]
    return (*gains, axes["gamma"][gamma], axes["delta"][delta], axes["delay"][delay])


def _within(
    nodes: Float64[np.ndarray, " node"],
    cell: Int64[np.ndarray, " point"],
    chance: np.random.Generator,
) -> Float64[np.ndarray, " point"]:
    """Return a random point of each cell; a single node is its cell."""
    lower, upper = nodes[cell], nodes[np.minimum(cell + 1, nodes.size - 1)]
    inside: np.ndarray = np.clip(lower + chance.random(cell.size) * (upper - lower), lower, upper)
    return inside


def _wrong_codes(codes: Int8[np.ndarray, " point"], point: tuple[Any, ...]) -> int:
    """Count codes that are none, and those that say the opposite of a verdict for the point."""
    exact = np.asarray(verdict(*point, resolve="exact"))
    both = np.isin(codes, (STABLE, UNSTABLE)) & np.isin(exact, (STABLE, UNSTABLE))
    return int(np.sum((both & (codes != exact)) | (codes == NOT_COMPUTED)))


def _answers(atlas: Atlas, sample: int, chance: np.random.Generator) -> Check:
    """Ask the atlas about random points of each delay, as its users do."""
    each, wrong = -(-sample // atlas.delays.size), 0
    for number, delay in enumerate(atlas.delays):
        ends = [(nodes[0], nodes[-1]) for nodes in atlas.nodes(number).values()]
        point = (*(chance.uniform(*side, each) for side in ends), delay)
        answer = atlas.query(*point)
        codes = np.where(answer.verdict == NOT_COMPUTED, np.int8(UNDECIDED), answer.verdict)
        wrong += _wrong_codes(codes, point) + _wrong_bounds(answer, point)
    points = each * atlas.delays.size
    return Check("answers", wrong == 0, f"{wrong} of {points} points are wrong")


def _wrong_bounds(answer: AtlasAnswer, point: tuple[Any, ...]) -> int:
    """Count spectral radii that are farther from the computed ones than is said."""
    radius = spectral_radius(*point)
    difference = np.abs(answer.spectral_radius - np.asarray(radius.value))
    return int(np.sum(difference > answer.radius_error + np.asarray(radius.error)))


_COMPARED = {VERDICT: _wrong_nodes, CELL_VERDICT: _wrong_cells, SPECTRAL_RADIUS: _wrong_radii}
