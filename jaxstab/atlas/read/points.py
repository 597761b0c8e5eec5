"""What the arrays of an atlas say about points: at nodes, in cells, and outside. NumPy alone."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.format import schema
from jaxstab.atlas.read.answer import AtlasAnswer, Floats, QueryStatus, check_inside
from jaxstab.atlas.read.cells import Integers, Mask, Place, picked
from jaxstab.atlas.read.limits import LimitTable
from jaxstab.conventions import STABLE, UNDECIDED, UNSTABLE

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


def find_outside(arrays: Arrays, where: Points, status: NDArray[np.int8], *, refuse: bool) -> None:
    """Mark points outside of the atlas, or refuse the first.

    Raises:
        ValueError: a point is outside, and that is refused.
    """

    def check(name: str, nodes: Floats, members: Mask, at: str = "") -> None:
        if refuse:
            check_inside(name, where[name][members], nodes[0], nodes[-1], at)
        outside = ~((where[name] >= nodes[0]) & (where[name] <= nodes[-1]))
        status[members & outside] = QueryStatus.OUTSIDE

    for name in ("gamma", "delta", "delay"):
        check(name, arrays[name], np.ones(status.shape, bool))
    for number, delay in enumerate(arrays["delay"].tolist()):
        for name in ("alpha", "beta"):
            nodes = arrays[name][:, number]
            check(name, nodes, where["delay"] == delay, f" at delay {delay:g}")


def answer_at_delay(
    arrays: Arrays,
    number: int,
    table: LimitTable | None,
    where: Points,
    here: Integers,
    answer: AtlasAnswer,
) -> None:
    """Fill in the answer for the points numbered ``here``, all at one delay and inside.

    Args:
        arrays: of the atlas.
        number: of the delay.
        table: of the limits of alpha at this delay, where there are any.
        where: the coordinates of all points.
        here: which of them are at the delay.
        answer: to fill in.
    """
    points = {name: where[name][here] for name in _WALLS}
    place = Place.of([(nodes, points[name]) for name, nodes in nodes_of(arrays, number).items()])
    status = np.where(place.at_node, QueryStatus.NODE, QueryStatus.UNDECIDED_CELL)
    if table is not None or schema.VERDICT in arrays:
        codes = _between_nodes(arrays, number, table, points, place)
        proved = ~place.at_node & ((codes == STABLE) | (codes == UNSTABLE))
        status[proved] = QueryStatus.CELL
        left = place.at_node & (codes == UNDECIDED)
        if schema.VERDICT in arrays and left.any():
            codes[left] = picked(arrays[schema.VERDICT][..., number], place.node, left)
        answer.verdict[here] = codes
    if schema.SPECTRAL_RADIUS in arrays:
        radius = arrays[schema.SPECTRAL_RADIUS][..., number]
        answer.spectral_radius[here] = place.interpolated(radius)
        for name, numbers, members in (
            (schema.RADIUS_ERROR, place.node, place.at_node),
            (schema.CELL_RADIUS_ERROR, place.cell, ~place.at_node),
        ):
            if members.any():
                error = arrays[name][..., number]
                answer.radius_error[here[members]] = picked(error, numbers, members)
    answer.status[here] = status


def _between_nodes(
    arrays: Arrays, number: int, table: LimitTable | None, points: Points, place: Place
) -> NDArray[np.int8]:
    if table is None:
        codes: NDArray[np.int8] = arrays[schema.CELL_VERDICT][..., number][place.cell]
        return codes
    return table.verdicts(*(points[name] for name in _WALLS))
