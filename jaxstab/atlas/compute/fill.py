"""Verdicts of a whole slice from a few: what lies between the boundary's crossings is filled.

A line of constant alpha is cut by the boundary into runs of nodes with the same number of unstable
roots, known up to one constant for the whole slice (``polygon``). The least of these numbers alone
can be zero, and a certified verdict says whether it is. Nodes within reach of the boundary are
computed one by one. Nodes at the ends of runs are computed too, as samples: a slice in which one of
them speaks against what would be filled is computed throughout.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int8, Int64

from jaxstab.atlas.compute.polygon import Frame, Pieces, boundary_pieces
from jaxstab.conventions import UNDECIDED, UNSTABLE
from jaxstab.point import verdict

_SAMPLED_RUNS = 24  # that may be stable, and as many of the others
_FEWEST = 1024  # points of one call, and then powers of two: each size is compiled
_WORD = 8  # nodes that are filled at once


class Slice(NamedTuple):
    """All (alpha, beta) of a grid at one (gamma, delta, delay); nodes are numbered beta first."""

    alpha: Float64[np.ndarray, " alpha_node"]
    beta: Float64[np.ndarray, " beta_node"]
    gamma: float
    delta: float
    delay: float

    @property
    def shape(self) -> tuple[int, int]:
        """The number of nodes along alpha and beta."""
        return self.alpha.size, self.beta.size

    @property
    def size(self) -> int:
        """The number of nodes."""
        return self.alpha.size * self.beta.size

    def verdicts(self, nodes: Int64[np.ndarray, " node"]) -> Int8[np.ndarray, " node"]:
        """Compute the codes of some nodes."""
        if not nodes.size:
            return np.zeros(0, np.int8)
        count = max(_FEWEST, 1 << (nodes.size - 1).bit_length())
        i, j = np.divmod(np.resize(nodes, count), self.beta.size)
        point = (self.alpha[i], self.beta[j], self.gamma, self.delta, self.delay)
        return np.asarray(verdict(*point, resolve="exact"))[: nodes.size]

    def dense(self) -> Int8[np.ndarray, "alpha_node beta_node"]:
        """Compute the codes of all nodes, one by one."""
        point = (self.alpha[:, None], self.beta, self.gamma, self.delta, self.delay)
        return np.asarray(verdict(*point, resolve="exact"))


class Runs(NamedTuple):
    """Parts of lines with one number of unstable roots, each up to the first node of the next."""

    starts: Int64[np.ndarray, " run"]
    unstable: Int64[np.ndarray, " run"]  # roots, up to a constant of the slice


class Samples(NamedTuple):
    """Nodes to compute, and whether they are of the runs that may be stable."""

    nodes: Int64[np.ndarray, " sample"]
    inside: Bool[np.ndarray, " sample"]


@dataclass(frozen=True)
class Filling:
    """What of a slice is to be computed, and with what the rest is to be filled.

    Attributes:
        of: the slice.
        starts: the first nodes of runs.
        inside: whether a run may be stable; all of these are, or none.
        near: nodes within reach of the boundary, ascending.
        samples: other nodes that are computed, too.
    """

    of: Slice
    starts: Int64[np.ndarray, " run"]
    inside: Bool[np.ndarray, " run"]
    near: Int64[np.ndarray, " node"]
    samples: Samples

    @property
    def computed(self) -> int:
        """The number of nodes to compute."""
        return self.near.size + self.samples.nodes.size

    @property
    def filled_inside(self) -> int:
        """The number of nodes that are filled with the code of the region that may be stable."""
        lengths = np.diff(self.starts, append=self.of.size)
        run = np.searchsorted(self.starts, np.append(self.near, self.samples.nodes), "right") - 1
        return int(lengths[self.inside].sum() - self.inside[run].sum())

    def codes(self) -> Int8[np.ndarray, "alpha_node beta_node"]:
        """Compute the few, fill in the rest and return the codes of all nodes."""
        known = self.of.verdicts(np.concatenate([self.near, self.samples.nodes]))
        near, samples = known[: self.near.size], known[self.near.size :]
        code = np.append(samples[self.samples.inside], np.int8(UNSTABLE))[0]
        expected = np.where(self.samples.inside, code, np.int8(UNSTABLE))
        if code == UNDECIDED or np.any(samples != expected):
            return self.of.dense()
        nodes = _filled(self.starts, np.where(self.inside, code, np.int8(UNSTABLE)), self.of.size)
        nodes[self.near] = near
        return nodes.reshape(self.of.shape)


def plan_filling(of: Slice) -> Filling:
    """Find the runs of a slice, the nodes that are too near to the boundary, and samples.

    Raises:
        ValueError: gamma, delta or delay is outside the range of the model.
        RuntimeError: JAX's x64 mode is off.
    """
    frame = Frame.of(of.alpha, of.beta)
    met = _meetings(boundary_pieces(of.gamma, of.delta, of.delay, frame), frame)
    runs = _runs(met, of.shape)
    near = _near(met, of.beta.size)
    nears = np.diff(np.searchsorted(near, np.append(runs.starts, of.size)))
    clear = np.diff(runs.starts, append=of.size) - nears
    # A run that is all near may be the polygon's alone: its number says nothing.
    inside = runs.unstable <= np.min(runs.unstable, where=clear > 0, initial=of.size)
    return Filling(of, runs.starts, inside, near, _samples(runs, clear, inside, near, of.size))


class _Meetings(NamedTuple):
    """Lines of constant alpha and the pieces within reach of them, a pair each."""

    line: Int64[np.ndarray, " pair"]
    first: Int64[np.ndarray, " pair"]  # node along beta within reach of the piece
    last: Int64[np.ndarray, " pair"]  # the node after those within reach
    jump: Int64[np.ndarray, " pair"]  # of the number of unstable roots, upwards
    below: Int64[np.ndarray, " alpha_node"]  # what each line has crossed before its first node


def _meetings(pieces: Pieces, frame: Frame) -> _Meetings:
    (x0, x1), (y0, y1), flow, reach = pieces
    left, right = np.minimum(x0, x1) - reach, np.maximum(x0, x1) + reach
    width = x1 - x0
    slope = (y1 - y0) / np.where(np.abs(width) < reach, np.inf, width)  # upright ones: see spread
    ends = [
        y + (np.clip(x, -reach, frame.x[-1] + reach) - x) * slope for x, y in ((x0, y0), (x1, y1))
    ]
    low, high = np.minimum(*ends) - reach, np.maximum(*ends) + reach
    meets = (right >= 0.0) & (left <= frame.x[-1]) & (low <= frame.y[-1])
    below = _jumps_below(pieces, meets & (high < 0.0), frame)
    near = np.flatnonzero(meets & (high >= 0.0))

    begin = np.searchsorted(frame.x, left[near], "left")
    counts = np.searchsorted(frame.x, right[near], "right") - begin
    piece, line = np.repeat(near, counts), _counted_up(begin, counts)
    spread = reach + np.abs(y1 - y0) * np.minimum(reach / np.maximum(np.abs(width), reach), 1.0)
    at, x0, x1, spread = frame.x[line], x0[piece], x1[piece], spread[piece]
    y = y0[piece] + (at - x0) * slope[piece]
    first = np.searchsorted(frame.y, np.maximum(y - spread, low[piece]), "left")
    last = np.searchsorted(frame.y, np.minimum(y + spread, high[piece]), "right")
    way = (at <= x0).astype(np.int64) - (at <= x1)
    return _Meetings(line, first, last, way * flow[piece], below)


def _jumps_below(
    pieces: Pieces, chosen: Bool[np.ndarray, " piece"], frame: Frame
) -> Int64[np.ndarray, " alpha_node"]:
    """Return what the crossings of chosen pieces add up to on each line."""
    begin, end = np.searchsorted(frame.x, pieces.x[:, chosen], "right")
    changes = np.zeros(frame.x.size + 1, np.int64)
    np.add.at(changes, begin, -pieces.flow[chosen])
    np.add.at(changes, end, pieces.flow[chosen])
    return np.cumsum(changes)[:-1]


def _runs(met: _Meetings, shape: tuple[int, int]) -> Runs:
    lines, height = shape
    crosses = (met.jump != 0) & (met.first < height)
    line, jump = met.line[crosses], met.jump[crosses]
    # Node and jump in one number, which sorts faster than two.
    events = 8 * (line * height + met.first[crosses]) + jump + 4
    events = np.sort(np.concatenate([8 * height * np.arange(lines) + 4, events]))
    starts, jumps = events // 8, events % 8 - 4
    of_line = np.bincount(line, weights=jump, minlength=lines).astype(np.int64)
    unstable = np.cumsum(jumps) + (met.below - np.cumsum(of_line) + of_line)[starts // height]
    is_last = np.append(starts[1:] != starts[:-1], True)
    starts, unstable = starts[is_last], unstable[is_last]
    changes = np.append(True, unstable[1:] != unstable[:-1])
    return Runs(starts[changes], unstable[changes])


def _near(met: _Meetings, height: int) -> Int64[np.ndarray, " node"]:
    counts = met.last - met.first
    some = np.flatnonzero(counts > 0)
    nodes: np.ndarray = np.unique(
        _counted_up(met.line[some] * height + met.first[some], counts[some])
    )
    return nodes


def _samples(
    runs: Runs,
    clear: Int64[np.ndarray, " run"],
    inside: Bool[np.ndarray, " run"],
    near: Int64[np.ndarray, " node"],
    size: int,
) -> Samples:
    """Return the ends of some runs, and of the clearest one that may be stable a node for sure."""
    stops = np.append(runs.starts[1:], size)
    clearest = np.argmax(np.where(inside, clear, 0))
    if clear[clearest] == 0:
        return Samples(np.zeros(0, np.int64), np.zeros(0, bool))
    some = np.concatenate([_some(np.flatnonzero(part & (clear > 0))) for part in (inside, ~inside)])
    # One more node than are near: not all of them are.
    first = runs.starts[clearest]
    within = np.arange(first, stops[clearest] - clear[clearest] + 1)
    within = within[~np.isin(within, near)][:1]
    nodes = np.concatenate([within, runs.starts[some], stops[some] - 1])
    of_run = np.concatenate([np.full(within.size, clearest), some, some])
    is_clear = ~np.isin(nodes, near)
    return Samples(nodes[is_clear], inside[of_run[is_clear]])


def _some(runs: Int64[np.ndarray, " run"]) -> Int64[np.ndarray, " some"]:
    places = np.linspace(0, runs.size - 1, min(_SAMPLED_RUNS, runs.size)).astype(int)
    some: np.ndarray = runs[places]
    return some


def _counted_up(
    begin: Int64[np.ndarray, " range"], counts: Int64[np.ndarray, " range"]
) -> Int64[np.ndarray, " number"]:
    """Return the numbers of many ranges, one after the other."""
    offsets = np.repeat(begin + counts - np.cumsum(counts), counts)
    numbers: np.ndarray = np.arange(offsets.size) + offsets
    return numbers


def _filled(
    starts: Int64[np.ndarray, " run"], codes: Int8[np.ndarray, " run"], size: int
) -> Int8[np.ndarray, " node"]:
    """Return a code for each node: whole words at once, then what is left of cut ones."""
    changes = np.append(True, codes[1:] != codes[:-1])
    starts, codes = starts[changes], codes[changes]
    stops = np.append(starts[1:], size)
    words = -(-starts // _WORD)
    lengths = np.diff(words, append=-(-size // _WORD))
    nodes = np.repeat(np.repeat(codes, _WORD).view(np.uint64), lengths).view(np.int8)
    for part in range(_WORD - 1):
        cut = starts + part < np.minimum(words * _WORD, stops)
        nodes[starts[cut] + part] = codes[cut]
    return nodes[:size]
