"""Verdicts of nodes and cells, proved column by column.

A column is a cell along beta over a box of hands. Between the pieces of the boundary that pass
through it lie gaps, each with one proved verdict (``jaxstab.proofs.columns``). A node in a gap of a
column beside it has the verdict of the gap, and so has a cell that lies in one gap of its column.
The few nodes in no gap are computed one by one.
"""

import numpy as np
from jaxtyping import Float64, Int8, Int64

from jaxstab.conventions import Verdict
from jaxstab.model import by_name
from jaxstab.model.filters import Filters, as_keywords
from jaxstab.point import verdict
from jaxstab.proofs.columns import column_gaps
from jaxstab.proofs.curve_patches import Domain
from jaxstab.proofs.plant import HandBoxes

AlphaNodes = Float64[np.ndarray, " alpha_node"]
BetaNodes = Float64[np.ndarray, " beta_node"]
Hands = Float64[np.ndarray, " hand"]


def node_verdicts(
    alpha: AlphaNodes,
    beta: BetaNodes,
    gamma: Hands,
    delta: Hands,
    delay: float,
    filters: Filters | None = None,
) -> Int8[np.ndarray, "hand alpha_node beta_node"]:
    """The verdicts of all (alpha, beta) for each pair (gamma, delta); two or more nodes of beta."""
    codes = _proved_nodes(alpha, beta, gamma, delta, delay, filters)
    hand, j, i = np.nonzero(codes == Verdict.UNDECIDED)
    if hand.size:
        point = alpha[i], beta[j], gamma[hand], delta[hand]
        codes[hand, j, i] = verdict(
            **by_name(*point, delay), resolve="exact", **as_keywords(filters)
        )
    return codes.swapaxes(1, 2)


def undecided_nodes(
    alpha: AlphaNodes,
    beta: BetaNodes,
    gamma: Hands,
    delta: Hands,
    delay: float,
    filters: Filters | None = None,
) -> Int64[np.ndarray, " hand"]:
    """Count for each hand the nodes that are in no gap; arguments and errors of node_verdicts."""
    codes = _proved_nodes(alpha, beta, gamma, delta, delay, filters)
    counts: np.ndarray = np.sum(codes == Verdict.UNDECIDED, axis=(1, 2))
    return counts


def cell_verdicts(
    alpha: AlphaNodes,
    beta: BetaNodes,
    hands: HandBoxes,
    delay: float,
    filters: Filters | None = None,
) -> Int8[np.ndarray, "box alpha_cell beta_cell"]:
    """The verdicts proved for whole cells, else UNDECIDED, for each box of (gamma, delta)."""
    codes = _codes(alpha, beta, hands, delay, filters, nodes=2)
    return codes.swapaxes(1, 2)


def _proved_nodes(
    alpha: AlphaNodes,
    beta: BetaNodes,
    gamma: Hands,
    delta: Hands,
    delay: float,
    filters: Filters | None,
) -> Int8[np.ndarray, "hand beta_node alpha_node"]:
    still = np.zeros_like(gamma)
    hands = HandBoxes(gamma, delta, still, still)
    beside = _codes(alpha, beta, hands, delay, filters, nodes=1)
    codes = np.concatenate([beside, beside[:, -1:]], axis=1)
    np.minimum(codes[:, 1:], beside, out=codes[:, 1:])  # UNDECIDED is the largest code
    return codes


def _codes(
    alpha: AlphaNodes,
    beta: BetaNodes,
    hands: HandBoxes,
    delay: float,
    filters: Filters | None,
    nodes: int,
) -> Int8[np.ndarray, "box beta_cell along_alpha"]:
    """Return a code for each run of ``nodes`` neighbours along alpha that is in one gap."""
    domain = Domain((float(alpha[0]), float(alpha[-1])), (float(beta[0]), float(beta[-1])))
    gaps = column_gaps(beta, hands, delay, domain, filters)
    first = np.searchsorted(alpha, gaps.low, "right")
    stop = np.searchsorted(alpha, gaps.high, "left") + 1 - nodes
    known = (first < stop) & np.isin(gaps.verdict, (Verdict.STABLE, Verdict.UNSTABLE))
    ends = np.stack([first, stop], axis=-1) * known[..., None]
    shape = hands.gamma.size, beta.size - 1, alpha.size + 1 - nodes
    return _filled(ends.reshape(*shape[:2], -1), gaps.verdict, shape[-1])


def _filled(
    ends: Int64[np.ndarray, "box column end"], codes: Int8[np.ndarray, "box column gap"], count: int
) -> Int8[np.ndarray, "box column count"]:
    """Return the code of each gap from its first index to its last; between gaps UNDECIDED."""
    ends = np.maximum.accumulate(ends, axis=-1)  # a gap that holds nothing begins where it ends
    lengths = np.diff(ends, axis=-1, prepend=0, append=count)
    runs = np.full(lengths.shape, Verdict.UNDECIDED, np.int8)
    runs[..., 1::2] = codes
    return np.repeat(runs.ravel(), lengths.ravel()).reshape(*ends.shape[:-1], count)
