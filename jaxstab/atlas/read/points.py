"""What the arrays of an atlas say about points: at nodes, in cells, and outside. NumPy alone.

A query fills in one ``AtlasAnswer``. ``find_outside`` marks points beyond the atlas; axes that hold
the whole stable set have no end. ``answer_by_limits`` gives the verdicts of columns,
``answer_at_delay`` those of nodes and their cells at the delays of the atlas; ``settle`` computes
the rest.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxstab.atlas.products.limits import ALPHA_LIMITS, LimitTable
from jaxstab.atlas.products.verdicts import CELL_VERDICT, VERDICT
from jaxstab.atlas.read.file import Integers, Mask, PackedArrays, Place
from jaxstab.conventions import AXES, Status, Verdict
from jaxstab.numbers import checked

Floats = NDArray[np.float64]
Numbers = ArrayLike | float | int


class QueryStatus(Status):
    """How an atlas knows what it answers for a point.

    Example:
        >>> [status.name for status in jaxstab.results.QueryStatus]
        ['NODE', 'CELL', 'UNDECIDED_CELL', 'BETWEEN_DELAYS', 'OUTSIDE', 'EXACT']
    """

    NODE = 1, "a node: the verdict, if any, is that of this very point"
    CELL = 2, "between nodes: the verdict is proved for a cell or column around the point"
    UNDECIDED_CELL = 3, "between nodes: no verdict is proved"
    BETWEEN_DELAYS = 4, "between two delays of an atlas that says nothing there"
    OUTSIDE = 5, "outside of the atlas: it says nothing here"
    EXACT = 6, "not decided by the atlas: the verdict was computed for this very point"


@dataclass(frozen=True)
class AtlasAnswer:
    """What an atlas says about points; two arrays of the broadcast shape of the query.

    Attributes:
        verdict: int8 codes of ``jaxstab.Verdict``, proved or UNDECIDED; NOT_COMPUTED if the atlas
            holds no verdicts.
        status: int8 codes of ``QueryStatus``: how this is known.

    Example:
        >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
        >>> answer = atlas.query([0.05, 0.18], 0.3, gamma=0.0005, delta=0.01, delay=1.0)
        >>> [jaxstab.results.QueryStatus(int(code)).name for code in answer.status]
        ['CELL', 'CELL']
    """

    verdict: NDArray[np.int8]
    status: NDArray[np.int8]


def no_answer(size: int, *, has_verdicts: bool) -> AtlasAnswer:
    """Return an answer that says nothing yet."""
    return AtlasAnswer(
        verdict=np.full(size, Verdict.UNDECIDED if has_verdicts else Verdict.NOT_COMPUTED, np.int8),
        status=np.full(size, QueryStatus.BETWEEN_DELAYS, np.int8),
    )


def all_checked(values: Sequence[Numbers], names: Sequence[str] = AXES) -> list[Floats]:
    """Return real, finite numbers, or raise TypeError or ValueError for the first others."""
    return [np.asarray(checked(*pair), np.float64) for pair in zip(names, values, strict=False)]


def check_inside(
    name: str, values: Floats, low: Floats | float, high: Floats | float, at: Floats | None = None
) -> None:
    """Raise ValueError for the first value beyond the ends of an atlas, perhaps at some delays."""
    beyond = np.flatnonzero(~((values >= low) & (values <= high)))
    if beyond.size:
        first, least, most = (
            float(np.broadcast_to(v, values.shape).flat[beyond[0]]) for v in (values, low, high)
        )
        where = "" if at is None else f" at delay {float(at.flat[beyond[0]]):g}"
        raise ValueError(
            f"{name} is {first!r}, and this atlas covers {least!r} to {most!r}{where}; "
            "give a value in this range, or set outside to 'undecided'."
        )


def checked_range(name: str, ends: Any) -> Floats:
    """Return the lowest and the highest value of a range, or raise TypeError or ValueError."""
    values = np.asarray(checked(name, ends), np.float64)
    if values.shape != (2,):
        raise TypeError(f"{name} is {ends!r}; give its lowest and its highest value.")
    if values[0] > values[1]:
        raise ValueError(f"{name} is {ends!r}; give its lowest and its highest value.")
    return values


def settle(where: Mapping[str, Floats], answer: AtlasAnswer, filters: Mapping[str, Any]) -> None:
    """Compute what the atlas left open inside of it; the filters are keywords of ``verdict``."""
    is_open = (answer.verdict == Verdict.UNDECIDED) & (answer.status != QueryStatus.OUTSIDE)
    left = np.flatnonzero(is_open)
    if left.size:
        from jaxstab.point import verdict

        points: dict[str, Any] = {name: where[name][left] for name in AXES}
        answer.verdict[left] = np.asarray(verdict(**points, resolve="exact", **filters))
        answer.status[left] = QueryStatus.EXACT


Arrays = Mapping[str, NDArray[Any]]
Points = Mapping[str, Floats]
_WALLS = ("alpha", "beta", "gamma", "delta")


def nodes_of(arrays: Arrays, delay_number: int) -> dict[str, Floats]:
    """Return the nodes along alpha, beta, gamma and delta at one delay."""
    return {
        "alpha": arrays["alpha"][:, delay_number],
        "beta": arrays["beta"][:, delay_number],
        "gamma": arrays["gamma"],
        "delta": arrays["delta"],
    }


def find_outside(
    arrays: Arrays,
    table: LimitTable | None,
    where: Points,
    status: NDArray[np.int8],
    *,
    refuse: bool,
) -> None:
    """Mark points outside of the atlas, or raise ValueError for the first.

    Alpha and beta end where the limits of alpha do, or else where the nodes of a delay do; axes
    that hold the whole stable set have no end.
    """

    def check(name: str, low: Floats | float, high: Floats | float, members: Integers) -> None:
        values = where[name][members]
        if refuse:
            at = where["delay"][members] if name in ("alpha", "beta") else None
            check_inside(name, values, low, high, at)
        outside = ~((values >= low) & (values <= high))
        status[members[outside]] = QueryStatus.OUTSIDE

    everywhere = np.arange(status.size)
    for name in ("gamma", "delta", "delay"):
        check(name, arrays[name][0], arrays[name][-1], everywhere)
    if table is not None:
        covered = np.flatnonzero(table.delays.covers(where["delay"]))
        cell = table.delays.cells_at(where["delay"][covered])
        known = ~table.delays.beyond(cell, where["alpha"][covered], where["beta"][covered])
        covered, cell = covered[known], cell[known]
        for name in ("alpha", "beta"):
            check(name, *table.delays.walls(name, cell), covered)
        return
    for number, delay in enumerate(arrays["delay"].tolist()):
        here = np.flatnonzero(where["delay"] == delay)
        for name in ("alpha", "beta"):
            nodes = arrays[name][:, number]
            check(name, nodes[0], nodes[-1], here)


def answer_by_limits(table: LimitTable, where: Points, inside: Mask, answer: AtlasAnswer) -> None:
    """Fill in the verdicts of points inside of an atlas, where there are limits of alpha."""
    here = np.flatnonzero(inside & table.delays.covers(where["delay"]))
    walls = (where[name][here] for name in ("alpha", "beta"))
    beyond = table.delays.beyond(table.delays.cells_at(where["delay"][here]), *walls)
    codes = np.full(here.size, Verdict.UNSTABLE, np.int8)
    codes[~beyond] = table.verdicts([where[name][here[~beyond]] for name in AXES])
    answer.verdict[here] = codes
    proved = (codes == Verdict.STABLE) | (codes == Verdict.UNSTABLE)
    answer.status[here] = np.where(proved, QueryStatus.CELL, QueryStatus.UNDECIDED_CELL)


def answer_at_delay(
    arrays: Arrays, number: int, where: Points, here: Integers, answer: AtlasAnswer
) -> None:
    """Fill in what nodes and their cells know of the points ``here``, all at one delay.

    Limits of alpha have given the verdicts of ``answer`` that they know.
    """
    nodes = nodes_of(arrays, number)
    for name in ("alpha", "beta"):  # limits of alpha may reach beyond the nodes
        values = where[name][here]
        here = here[(values >= nodes[name][0]) & (values <= nodes[name][-1])]
    if not here.size:
        return
    points = {name: where[name][here] for name in _WALLS}
    place = Place.from_axes([(along, points[name]) for name, along in nodes.items()])
    codes, status = answer.verdict[here], answer.status[here]
    if ALPHA_LIMITS not in arrays:
        status = np.full(here.size, QueryStatus.UNDECIDED_CELL, np.int8)
        if CELL_VERDICT in arrays:
            codes = _codes_at(arrays, CELL_VERDICT, place.cell, number)
            status[(codes == Verdict.STABLE) | (codes == Verdict.UNSTABLE)] = QueryStatus.CELL
    left = place.at_node & (codes == Verdict.UNDECIDED)
    if VERDICT in arrays and left.any():
        nodes_left = [along[left] for along in place.node]
        codes[left] = _codes_at(arrays, VERDICT, nodes_left, number)
    status[place.at_node] = QueryStatus.NODE
    answer.verdict[here], answer.status[here] = codes, status


def _codes_at(arrays: Arrays, name: str, place: Sequence[Integers], delay: int) -> NDArray[np.int8]:
    index = (*place, np.full(place[0].shape, delay))
    codes: NDArray[np.int8] = (
        arrays.codes_at(name, index) if isinstance(arrays, PackedArrays) else arrays[name][index]
    )
    return codes
