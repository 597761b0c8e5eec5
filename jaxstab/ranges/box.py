"""Proof and search of claims about every loop of a range, over boxes of its parameters.

A range is a box of loops. Each axis is one quantity that varies: a mass, a stiffness or a damping
of device or hand, the delay, a cut-off, the position along an edge of walls, and always theta, the
angle of a root on the unit circle. Hands of a range, loops between two, robust regions, margins and
guards differ in their axes and in how the characteristic function g is enclosed over a box
(``jaxstab.proofs``); the three arguments below are the same for all of them.

1. *No root on the circle.* Boxes are halved, along the axis that moves g most, until each of them
   is proved free of roots on the unit circle (``ParameterBox.paved``; a box without roots: lemma
   B3 of docs/proofs.md, with filters B10, any device B13 and B20, loops between two B17).
2. *One proof of stability is enough.* The roots move continuously with the loop, and a range is
   connected: if no loop of it has a root on the circle, all have the same number of roots outside
   of it, and the verdict on a single one holds for all (``verdicts_of_range``, ``worst_of_range``;
   B6 for hands of one mass, B17 between two loops, B21 for hands of a device). For a closed polygon
   it is enough that no wall on its edges has such a root: no curve of walls with a root on the
   circle can lie inside without crossing the edges (B7, with filters and any device B11).
3. *Sampled loops bound the answer, the proof confirms it.* The stiffest wall, or the polygon of
   walls, that all sampled loops allow is too large, so it is pulled in a little and proved for the
   whole range. Where the proof fails, loops from there join the sample; where that adds none, it is
   pulled in further (``search``).

A sampled loop that is proved unstable refutes a wall. A box that can be neither halved nor proved
free shows nothing: the wall is undecided. The walls that the samples suggest, the order in which
boxes are halved and the work after which a proof is given up decide how much is proved, but never
whether a proof is valid.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import inf, nan
from typing import Any, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Bool, Float64, Int8, Int64

from jaxstab.conventions import Status, Verdict
from jaxstab.proofs.device_boxes import NAMES, DeviceBoxes
from jaxstab.proofs.exclusion import Exclusion, Loops

Reals = Float64[np.ndarray, " box"]
Points = Float64[np.ndarray, "point 2"]
Moves = Float64[np.ndarray, "axis 6 box"]
Smallest = float | Float64[np.ndarray, " axis"]

_AT_ONCE = 1 << 14  # boxes that are proved at once
_ATTEMPTS = 24  # proofs of a search
PULLS = 0.01, 0.02, 0.04, 0.08

"""Shares of the stiffness by which the wall that is proved lies below the limit."""


class Proof(NamedTuple):
    """Which boxes are proved free of roots, and how much each axis contributes where one fails."""

    free: Bool[np.ndarray, " box"]
    share: Float64[np.ndarray, "box axis"]


@dataclass(frozen=True)
class ParameterBox:
    """Boxes of loops, center +- half along named axes; an axis of half-width 0 stays whole.

    ``index`` is the number of the wall or edge, for example, to which each box belongs.
    """

    axes: tuple[str, ...]
    center: Float64[np.ndarray, "box axis"]
    half: Float64[np.ndarray, "box axis"]
    index: Int64[np.ndarray, " box"]

    @classmethod
    def from_axes(cls, index: Int64[np.ndarray, " box"], **axes: tuple[Any, Any]) -> "ParameterBox":
        """One box for each index, from the middle and the half-width of each named axis."""
        center, half = (
            np.stack([np.broadcast_to(np.float64(v), index.shape) for v in values], axis=-1)
            for values in zip(*axes.values(), strict=True)
        )
        return cls(tuple(axes), center, half, index)

    def __getitem__(self, axis: str) -> tuple[Reals, Reals]:
        """The middles and the half-widths along an axis."""
        row = self.axes.index(axis)
        return self.center[:, row], self.half[:, row]

    @property
    def count(self) -> int:
        """The number of boxes."""
        return len(self.index)

    def select(self, chosen: np.ndarray | slice) -> "ParameterBox":
        """Return chosen boxes."""
        return ParameterBox(self.axes, *(x[chosen] for x in (self.center, self.half, self.index)))

    def paved(
        self,
        prove: Callable[["ParameterBox"], Proof],
        smallest: Smallest,
        *,
        most: int | float = inf,
        most_each: int | float = inf,
        effort: int | float = inf,
    ) -> "Paving":
        """Halve boxes, each along the axis that matters most, until they are proved free of roots.

        Axes are not halved at or below the half-widths ``smallest``, of each axis or of all. The
        proof is given up where more than ``most`` boxes are open at once; of the boxes of one
        index, where ``most_each`` are, or ``effort`` were judged in all. These two make the result
        for an index independent of the others.
        """
        boxes, unproved = self, [self.select(slice(0))]
        finished, judged = True, np.zeros(int(self.index.max(initial=-1)) + 1, np.int64)
        while boxes.count:
            open_boxes = np.bincount(boxes.index, minlength=judged.size)
            is_over = (open_boxes > most_each) | (judged + open_boxes > effort)
            given_up = is_over[boxes.index] | (boxes.count > most)
            if given_up.any():
                unproved.append(boxes.select(given_up))
                boxes, finished = boxes.select(~given_up), False
                open_boxes = np.bincount(boxes.index, minlength=judged.size)
            judged += open_boxes
            free, share = boxes._proof(prove)
            divisible = boxes.half > smallest
            is_divisible = divisible.any(axis=1)
            unproved.append(boxes.select(~free & ~is_divisible))
            going = ~free & is_divisible
            axis = np.argmax(np.where(divisible, share, -1.0), axis=1)[going]
            boxes = boxes.select(going)._halved(axis)
        return Paving(joined(unproved), finished, judged)

    def _proof(self, prove: Callable[["ParameterBox"], Proof]) -> Proof:
        """The proof of the boxes in blocks: each box needs about 100 numbers."""
        starts = range(0, max(self.count, 1), _AT_ONCE)
        proofs = (prove(self.select(slice(start, start + _AT_ONCE))) for start in starts)
        return Proof(*map(np.concatenate, zip(*proofs, strict=True)))

    def _halved(self, axis: Int64[np.ndarray, " box"]) -> "ParameterBox":
        rows = np.arange(self.count)
        half = self.half.copy()
        half[rows, axis] /= 2
        shift = np.zeros_like(half)
        shift[rows, axis] = half[rows, axis]
        lower = ParameterBox(self.axes, self.center - shift, half, self.index)
        return joined([lower, ParameterBox(self.axes, self.center + shift, half, self.index)])

    def moved(self, moves: Mapping[tuple[str, str], Reals]) -> Moves:
        """How far each axis moves each parameter of a loop, from names of both."""
        by_axis = np.zeros((len(self.axes), len(Loops._fields), self.count))
        for (axis, parameter), far in moves.items():
            by_axis[self.axes.index(axis), Loops._fields.index(parameter)] = far
        return by_axis


class Paving(NamedTuple):
    """The boxes that paving could not prove: too small to be halved, or of proofs given up.

    ``finished`` says that none was given up, ``judged`` how many boxes of each index were judged.
    """

    boxes: ParameterBox
    finished: bool
    judged: Int64[np.ndarray, " index"]


def joined(parts: Sequence[ParameterBox]) -> ParameterBox:
    """The boxes of one, then of the next, all with the same axes."""
    columns = zip(*((boxes.center, boxes.half, boxes.index) for boxes in parts), strict=True)
    return ParameterBox(parts[0].axes, *map(np.concatenate, columns))


def excluded(
    test: Callable[[Loops, Loops], Exclusion],
    center: Loops,
    by_axis: Moves,
    radius: Loops | None = None,
) -> Proof:
    """The proof, by a test, that loops of one mass have no root on the unit circle.

    The test is ``proofs.exclusion.exclude``, or one like it. The axes of the boxes move their
    centers ``by_axis``; ``radius`` covers the loops of a box, by default the sum over the axes.
    """
    radius = radius or Loops(*by_axis.sum(axis=0))
    exclusion = test(center, radius)
    share = by_axis / np.maximum(np.stack(radius), 1e-300)
    return Proof(exclusion.free, np.sum(exclusion.moves * share, axis=1).T)


def paved_device(
    loops: DeviceBoxes,
    index: Int64[np.ndarray, " box"],
    ends: Sequence[tuple[Any, Any]],
    smallest: float,
    **limits: int,
) -> Paving:
    """The paving of boxes of a held device, from the ends along its axes.

    Axes are not halved at or below ``smallest`` of their first half-width; ``limits`` are those of
    ``ParameterBox.paved``.
    """
    pairs = [(low, 0.5 * (high - low)) for low, high in ends]
    axes = {n: (low + half, half) for n, (low, half) in zip(NAMES, pairs, strict=True)}
    boxes = ParameterBox.from_axes(index, **axes)

    def prove(boxes: ParameterBox) -> Proof:
        free, shares = loops.judged(boxes.center.T, boxes.half.T)
        return Proof(free, shares.T)

    return boxes.paved(prove, smallest * boxes.half[0], **limits)


# One proof of stability is enough: verdicts on walls, and the worst loop of a range.

_Worst = TypeVar("_Worst", bound=Any)  # a named tuple with a verdict, a loop and a radius


def verdicts_of_range(
    sampled: Int8[np.ndarray, "wall loop"],
    prove: Callable[[Int64[np.ndarray, " likely"]], Int8[np.ndarray, " likely"]],
) -> Int8[np.ndarray, " wall"]:
    """Codes of ``Verdict`` for walls and all loops of a range, from those in sampled loops.

    ``prove`` returns the codes of walls, given by their numbers, that are stable in one loop:
    STABLE where no loop of the range has a root on the circle.
    """
    codes = np.full(len(sampled), Verdict.UNDECIDED, np.int8)
    unstable = np.any(sampled == Verdict.UNSTABLE, axis=1)
    codes[unstable] = Verdict.UNSTABLE
    likely = np.flatnonzero(np.any(sampled == Verdict.STABLE, axis=1) & ~unstable)
    codes[likely] = prove(likely)
    return codes


def worst_of_range(
    sampled: Sequence[_Worst],
    unproved: Callable[[list[int]], Mapping[int, np.ndarray]],
    judge: Callable[[int, np.ndarray], _Worst],
    most: int,
) -> list[_Worst]:
    """The verdicts on walls for all loops of a range, and the worst loop of each.

    ``sampled`` has the worst of the sampled loops for each wall. ``unproved`` takes numbers of
    walls and returns, for those that are not proved, loops at which a root on the circle could not
    be excluded, if any are known; ``judge`` returns the worst of such loops for a wall, at ``most``
    of them, spread over all.
    """
    answers = list(sampled)
    hopeful = [n for n, answer in enumerate(answers) if answer.verdict == Verdict.STABLE]
    for wall, failed in unproved(hopeful).items():
        worst, count = answers[wall], min(len(failed), most)
        if count:
            other = judge(wall, failed[np.arange(count) * len(failed) // count])
            is_worse = other.verdict == Verdict.UNSTABLE or other.radius > worst.radius
            worst = other if is_worse else worst
        is_refuted = worst.verdict == Verdict.UNSTABLE
        answers[wall] = worst if is_refuted else worst._replace(verdict=Verdict.UNDECIDED)
    return answers


# Sampled loops bound the answer, the proof confirms it: limits and regions.


class RobustStatus(Status):
    """The status of a robust region.

    Example:
        >>> jaxstab.results.RobustStatus(1).words
        'every wall of the outline is proved stable for every hand or loop'
    """

    NOT_COMPUTED = 0, "not computed"
    PROVED = 1, "every wall of the outline is proved stable for every hand or loop"
    EMPTY = 2, "no wall was found that is stable for all of the sampled hands or loops"
    UNPROVED = 3, "stable for the sampled hands or loops, but not proved between them"


class RobustLimit(NamedTuple):
    """The stiffest wall for all hands of a range, in SI units; NaN where there is none.

    Attributes:
        stiffness: K of a wall 1 % below the stiffest wall of the search, or up to 8 % below where
            the proof failed closer to it.
        damping: B of that wall.
        is_proved: whether that wall is proved stable for every hand.
        limit: no stiffer wall with B >= 0 is stable for every hand: every such wall above it,
            within the span of the sampled hands' stable regions, is proved unstable for one of
            these hands. With an estimator or a filter the span is that of the components with
            small gains.
        loop: the loop with the hand that sets the limit.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> limit = loop.robust_limit(jaxstab.HandRange(mass=(0.0, 1.0)))
        >>> limit.is_proved, limit.stiffness < limit.limit
        (True, True)
    """

    stiffness: float
    damping: float
    is_proved: bool
    limit: float
    loop: Any  # of the class of the given one


class Guess(NamedTuple):
    """Walls that all sampled loops of a range allow, pulled in a little: one, or a polygon.

    No row if nothing is allowed. ``limit`` is the largest stiffness that they allow, ``loop`` the
    sampled loop that allows least there.
    """

    walls: Points
    limit: float = nan
    loop: Any = None


NOTHING = Guess(np.zeros((0, 2)))


class SearchResult(NamedTuple):
    """The last guess of a search, by how much it was pulled in, and whether it is proved."""

    guess: Guess | None
    pull: float
    is_proved: bool

    @property
    def status(self) -> RobustStatus:
        """The status of a polygon."""
        if self.is_proved:
            return RobustStatus.PROVED
        is_empty = self.guess is not None and not len(self.guess.walls)
        return RobustStatus.EMPTY if is_empty else RobustStatus.UNPROVED


Unproved = Callable[[Points], Sequence[Any] | np.ndarray | None]


def search(
    guess: Callable[[float], Guess | None],
    unproved: Unproved,
    add: Callable[[Any], bool],
    pulls: Sequence[float],
) -> SearchResult:
    """Walls that sampled loops allow, and whether they are proved for the whole range.

    ``guess`` returns the walls that the sampled loops allow, pulled in by a share; None if unknown.
    ``unproved`` returns loops at which a wall, or a polygon with all that is inside, is not proved;
    none is a proof, and None says that nothing can be proved. ``add`` adds such loops to the sample
    and says whether one is new; where none is, the next one of the ``pulls`` is tried.
    """
    index = 0
    for _ in range(_ATTEMPTS):
        current = guess(pulls[index])
        if current is None or not len(current.walls):
            break
        failed = unproved(current.walls)
        if failed is not None and not len(failed):
            return SearchResult(current, pulls[index], True)
        if failed is None:
            break
        if not add(failed):
            if index + 1 == len(pulls):
                break
            index += 1
    return SearchResult(current, pulls[index], False)


def limit_for_hands(
    loops: list[Any],
    guess: Callable[[list[Any], float], Guess | None],
    worst: Callable[[float, float], Any],
) -> RobustLimit:
    """The stiffest wall for all hands of a range.

    ``loops`` have sampled hands; those that refute a wall are added. ``guess`` returns the stiffest
    wall that loops allow, pulled down by a share, ``worst`` the worst hand of a wall (K, B), and
    whether all hands are proved.
    """

    def unproved(walls: Points) -> list[Any]:
        hand = worst(*walls[0].tolist())
        return [] if hand.verdict == Verdict.STABLE else [hand]

    def add(hands: list[Any]) -> bool:
        new = [hand.loop for hand in hands if hand.verdict == Verdict.UNSTABLE]
        new = [loop for loop in new if loop not in loops]
        loops.extend(new)
        return bool(new)

    return limit_of(search(partial(guess, loops), unproved, add, PULLS), loops[0])


def limit_of(result: SearchResult, loop: Any) -> RobustLimit:
    """The limit from the result of a search; ``loop`` is returned where no loop sets it."""
    guess = result.guess or NOTHING
    stiffness, damping = guess.walls[0].tolist() if len(guess.walls) else (nan, nan)
    return RobustLimit(stiffness, damping, result.is_proved, guess.limit, guess.loop or loop)
