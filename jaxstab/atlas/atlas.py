"""Answers from an atlas in memory: stored values at nodes, proofs elsewhere.

``Atlas`` answers in dimensionless numbers, ``LoopAtlas`` in SI units for the walls of one loop. A
query marks the points outside first. Inside, the limits of alpha decide most points, then nodes and
their cells; functions of cells bound the spectral radius. What is left undecided
stays so, or is computed on request (``exact``).

A verdict alone goes the short way: if all points are inside of the limits of alpha, one lookup in
their table answers, and nothing else is touched. NumPy alone: no JAX, no HDF5, and nothing else
that takes time to import.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from math import ulp
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxstab.arrays import tree_map
from jaxstab.atlas import file
from jaxstab.atlas.file import GridIndex, Integers, Mask, PackedArrays
from jaxstab.atlas.lookup import AlphaLimits, LimitTable, MaxAlpha, OutsideError
from jaxstab.atlas.product import SPEC
from jaxstab.atlas.products.limits import ALPHA_LIMITS, LIMIT_RANGE, LIMIT_WHOLE
from jaxstab.atlas.products.slices import AtlasOutline, outline_at
from jaxstab.atlas.products.table import PRODUCTS
from jaxstab.atlas.products.verdicts import CELL_VERDICT, VERDICT, decided_share
from jaxstab.conventions import AXES, Range, Status, Verdict
from jaxstab.numbers import checked, checked_number, checked_word, real_numbers
from jaxstab.rounding import STIFFNESS
from jaxstab.shown import table_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes


# The answers of the arrays of an atlas about points: at nodes, in cells, outside. NumPy alone.
#
# A query fills in one ``AtlasAnswer``. ``find_outside`` marks points beyond the atlas; axes that
# hold the whole stable set have no end. ``answer_by_limits`` gives the verdicts of columns,
# ``answer_at_delay`` those of nodes and their cells at the delays of the atlas; ``settle`` computes
# the rest.

Floats = NDArray[np.float64]
Numbers = ArrayLike | float | int


class QueryStatus(Status):
    """The origin of an atlas's answer for a point.

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
    """The answer of an atlas about points; two arrays of the broadcast shape of the query.

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


def all_checked(values: Sequence[Numbers], names: Sequence[str] = AXES) -> list[Floats]:
    """Return real, finite numbers, or raise TypeError or ValueError for the first others."""
    return [np.asarray(checked(*pair), np.float64) for pair in zip(names, values, strict=False)]


_REMEDY = "give a value in this range, or set outside to 'undecided'."


class BeyondError(OutsideError):
    """Which of some points, flattened, is beyond which axis of an atlas, and the ends there."""

    def __init__(self, axis: str, index: int, ends: Range, words: str) -> None:
        super().__init__(f"{words}; {_REMEDY}")
        self.axis, self.index, self.ends = axis, index, ends


def check_inside(
    name: str,
    values: Floats,
    low: Floats | float,
    high: Floats | float,
    at: Floats | None = None,
    members: Integers | None = None,
) -> None:
    """Raise BeyondError for the first value, of some ``members``, beyond the ends of an atlas."""
    beyond = np.flatnonzero(~((values >= low) & (values <= high)))
    if beyond.size:
        first = int(beyond[0])
        value, least, most = (
            float(np.broadcast_to(v, values.shape).flat[first]) for v in (values, low, high)
        )
        where = "" if at is None else f" at delay {float(at.flat[first]):g}"
        words = f"{name} is {value!r}, and this atlas covers {least!r} to {most!r}{where}"
        raise BeyondError(
            name, first if members is None else int(members[first]), (least, most), words
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
    pending = np.flatnonzero(is_open)
    if pending.size:
        from jaxstab.point import verdict

        points: dict[str, Any] = {name: where[name][pending] for name in AXES}
        answer.verdict[pending] = np.asarray(verdict(**points, resolve="exact", **filters))
        answer.status[pending] = QueryStatus.EXACT


Points = Mapping[str, Floats]
_WALLS = ("alpha", "beta", "gamma", "delta")


def nodes_of(arrays: PackedArrays, delay_number: int) -> dict[str, Floats]:
    """Return the nodes along alpha, beta, gamma and delta at one delay."""
    return {
        "alpha": arrays["alpha"][:, delay_number],
        "beta": arrays["beta"][:, delay_number],
        "gamma": arrays["gamma"],
        "delta": arrays["delta"],
    }


def find_outside(
    arrays: PackedArrays,
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
            delays = where["delay"][members] if name in ("alpha", "beta") else None
            check_inside(name, values, low, high, delays, members)
        outside = ~((values >= low) & (values <= high))
        status[members[outside]] = QueryStatus.OUTSIDE

    everywhere = np.arange(status.size)
    for name in ("gamma", "delta", "delay"):
        check(name, arrays[name][0], arrays[name][-1], everywhere)
    if table is not None:
        covered = np.flatnonzero(table.delays.covers(where["delay"]))
        cell = table.delays.cells_at(where["delay"][covered])
        is_inside = ~table.delays.beyond(cell, where["alpha"][covered], where["beta"][covered])
        covered, cell = covered[is_inside], cell[is_inside]
        for name in ("alpha", "beta"):
            check(name, *table.delays.walls(name, cell), covered)
        return
    for index, delay in enumerate(arrays["delay"].tolist()):
        here = np.flatnonzero(where["delay"] == delay)
        for name in ("alpha", "beta"):
            nodes = arrays[name][:, index]
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
    arrays: PackedArrays, index: int, where: Points, here: Integers, answer: AtlasAnswer
) -> None:
    """Fill in what nodes and their cells know of the points ``here``, all at one delay.

    Limits of alpha have given the verdicts of ``answer`` that they know.
    """
    nodes = nodes_of(arrays, index)
    for name in ("alpha", "beta"):  # limits of alpha may reach beyond the nodes
        values = where[name][here]
        here = here[(values >= nodes[name][0]) & (values <= nodes[name][-1])]
    if not here.size:
        return
    points = {name: where[name][here] for name in _WALLS}
    place = GridIndex.from_axes([(along, points[name]) for name, along in nodes.items()])
    codes, status = answer.verdict[here], answer.status[here]
    if ALPHA_LIMITS not in arrays:
        status = np.full(here.size, QueryStatus.UNDECIDED_CELL, np.int8)
        if CELL_VERDICT in arrays:
            codes = _codes_at(arrays, CELL_VERDICT, place.cell, index)
            status[(codes == Verdict.STABLE) | (codes == Verdict.UNSTABLE)] = QueryStatus.CELL
    pending = place.at_node & (codes == Verdict.UNDECIDED)
    if VERDICT in arrays and pending.any():
        nodes_pending = [along[pending] for along in place.node]
        codes[pending] = _codes_at(arrays, VERDICT, nodes_pending, index)
    status[place.at_node] = QueryStatus.NODE
    answer.verdict[here], answer.status[here] = codes, status


def _codes_at(
    arrays: PackedArrays, name: str, place: Sequence[Integers], delay: int
) -> NDArray[np.int8]:
    return arrays.codes_at(name, (*place, np.full(place[0].shape, delay)))


Outside = Literal["error", "undecided"]

_ULPS_ASIDE = 4  # of numbers that the roundings of SI units move


class LargestStiffness(NamedTuple):
    """The largest stable stiffness of a loop, by the proofs of an atlas; NaN where there is none.

    The loop is stable at ``damping`` and every stiffness just below ``stiffness``, and at no
    stiffness above ``bound`` and no damping of the atlas. Where the stable set may continue beyond
    the atlas, across its largest stiffness or an end of the damping, ``bound`` is infinite.

    Example:
        >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
        >>> device = {"device_mass": 0.1, "device_damping": 1.0}
        >>> loop = jaxstab.HapticLoop(**device, sample_time=1e-3, delay=1.5e-3)
        >>> largest = atlas.for_loop(loop).largest_stiffness()
        >>> print(f"{largest.stiffness:.0f} N/m, none above {largest.bound:.0f} N/m")
        9449 N/m, none above 9585 N/m
    """

    stiffness: float
    damping: float
    bound: float


class LoopAtlas:
    """An atlas for the walls of one loop, in SI units; ``Atlas.for_loop`` makes it.

    K is in N/m and B in N s/m (N m/rad and N m s/rad for a rotational loop). Answers are proved for
    the dimensionless numbers of the loop, which are right to some roundings: gamma, delta or a
    delay that is a node up to four of them is taken for the node.

    Attributes:
        atlas: the atlas.
        loop: the loop.

    Example:
        >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
        >>> device = {"device_mass": 0.1, "device_damping": 1.0}
        >>> loop = jaxstab.HapticLoop(**device, sample_time=1e-3, delay=1e-3)
        >>> walls = atlas.for_loop(loop)
        >>> walls.verdict([5000.0, 18000.0], 30.0).tolist()
        [1, 2]
        >>> walls.stiffness_limits(30.0).round(-1).tolist()
        [0.0, 13600.0]
        >>> jaxstab.results.QueryStatus(int(walls.query(5000.0, 30.0).status)).name
        'CELL'
        >>> round(walls.largest_stiffness().damping)
        43
        >>> axes = walls.plot()
    """

    def __init__(self, atlas: "Atlas", loop: Any) -> None:
        self.atlas = atlas
        self.loop = _checked_loop(loop)
        _check_filters(atlas, self.loop)
        numbers = self.loop.slice.items()
        self._slice: dict[str, Any] = {
            name: _node_or(atlas.arrays[name], value) for name, value in numbers
        }
        for name, value in self._slice.items():
            nodes = atlas.arrays[name]
            if not nodes[0] <= value <= nodes[-1]:
                raise ValueError(
                    f"{name} of the loop is {value!r}, and this atlas has {float(nodes[0])!r} to "
                    f"{float(nodes[-1])!r}; open another atlas, or build one."
                )
        self._alphas, self._betas = _ends(atlas, self._slice["delay"])

    def __repr__(self) -> str:
        return f"{self.atlas!r}\nfor {self.loop!r}"

    def query(
        self,
        stiffness: Numbers,
        damping: Numbers,
        outside: Outside = "error",
        *,
        exact: bool = False,
    ) -> AtlasAnswer:
        """Verdicts of walls (K, B) of any broadcast shape.

        Other arguments, errors and source: as ``Atlas.query``.
        """
        with self._wall(stiffness, damping) as wall:
            return self.atlas.query(*wall, **self._slice, outside=outside, exact=exact)

    def verdict(
        self,
        stiffness: Numbers,
        damping: Numbers,
        outside: Outside = "error",
        *,
        exact: bool = False,
    ) -> NDArray[np.int8]:
        """The verdicts of ``query`` alone, faster: int8 codes of ``jaxstab.Verdict``.

        Arguments, errors and source: as ``query``.
        """
        with self._wall(stiffness, damping) as wall:
            return self.atlas.verdict(*wall, **self._slice, outside=outside, exact=exact)

    def stiffness_limits(self, damping: Numbers) -> Floats:
        """The interval of stiffness in which every wall is proved stable, rounded inwards.

        Returns:
            Array (*grid, 2) in N/m, an open interval within that of ``HapticLoop.stiffness_limits``
            and within the atlas; NaN where no stiffness is proved stable.

        Raises: as ``Atlas.alpha_limits``. Source: ``jaxstab.proofs.columns``; Table I.
        """
        with self._wall(0.0, damping) as (_, beta):
            return self._limits(np.asarray(beta))

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Draw the verdicts of the walls (K, B), in SI units: stable, unstable, undecided.

        Args:
            ax: the axes of matplotlib to draw in; None makes a figure with matplotlib.pyplot.

        Raises: as ``verdict``. Source: as ``verdict``.
        """
        from jaxstab.pictures.atlas import plot_walls

        return plot_walls(self, ax)

    def largest_stiffness(self) -> LargestStiffness:
        """The largest stable stiffness, its damping, and a proved bound.

        Raises: ValueError if the atlas holds no limits of alpha.

        Source: ``jaxstab.proofs.columns``; Table I.
        """
        largest = self.atlas.max_alpha(**self._slice)
        if np.isnan(largest.alpha):
            return LargestStiffness(np.nan, np.nan, np.nan)
        # It is on an edge between two cells of beta, of which a rounded damping is in either.
        damping = float(self.loop.damping(float(largest.beta)))
        near = damping + np.spacing(damping) * np.arange(-_ULPS_ASIDE, _ULPS_ASIDE + 1)
        beta = self.loop.beta(near)
        near, beta = (v[(beta >= self._betas[0]) & (beta <= self._betas[1])] for v in (near, beta))
        upper = np.nan_to_num(self._limits(beta)[:, 1], nan=-np.inf)
        best = int(np.argmax(upper))
        bound = self.loop.stiffness(float(largest.bound))
        return LargestStiffness(
            float(upper[best]), float(near[best]), bound + STIFFNESS * abs(bound)
        )

    @np.errstate(invalid="ignore")  # infinite limits may have infinite errors
    def _limits(self, beta: Floats) -> Floats:
        """Return the stiffnesses between which all is proved stable, at values of beta."""
        limits = self.atlas.alpha_limits(beta, **self._slice)
        lower = np.maximum(limits.lower + limits.lower_error, self._alphas[0])
        upper = np.minimum(limits.upper - limits.upper_error, self._alphas[1])
        ends = self.loop.stiffness(np.stack([lower, upper], axis=-1))
        ends += STIFFNESS * np.abs(ends) * np.array([1.0, -1.0])
        ends[~(ends[..., 0] < ends[..., 1])] = np.nan
        return ends

    @contextmanager
    def _wall(self, stiffness: Numbers, damping: Numbers) -> Iterator[tuple[Numbers, Numbers]]:
        """Yield alpha and beta of walls, checked; what the atlas refuses is said in SI units."""
        gains = all_checked((stiffness, damping), ("stiffness", "damping"))
        alpha, beta = np.asarray(self.loop.alpha(gains[0])), np.asarray(self.loop.beta(gains[1]))
        try:
            if alpha.ndim == beta.ndim == 0:  # one wall is answered faster as plain numbers
                yield float(alpha), float(beta)
            else:
                yield alpha, beta
        except BeyondError as error:
            k = int(error.axis == "beta")
            name, in_units = (
                ("stiffness", "damping")[k],
                (self.loop.stiffness, self.loop.damping)[k],
            )
            gain = float(np.broadcast_arrays(*gains)[k].flat[error.index])
            low, high = map(in_units, error.ends)
            raise ValueError(
                f"{name} is {gain!r}, and this atlas covers {low:.9g} to {high:.9g} for this loop; "
                f"{_REMEDY}"
            ) from None


def _checked_loop(loop: Any) -> Any:
    """Return a loop of plain numbers, by whose properties all is converted."""
    from jaxstab.model.loop import LoopParameters

    if not isinstance(loop, LoopParameters):
        raise TypeError(f"loop is {loop!r}; give a jaxstab.HapticLoop.")
    plain = loop.in_floats()
    if plain.body is None:
        raise TypeError(
            f"an atlas covers devices that are one mass with their hand, and this one is not "
            f"({loop.device}); use the methods of the loop."
        )
    return plain


def _node_or(nodes: Floats, value: float) -> float:
    """Return the node that a number of a loop is up to some roundings, or else the number."""
    nearest = float(nodes[np.argmin(np.abs(nodes - value))])
    return nearest if abs(nearest - value) <= _ULPS_ASIDE * ulp(value) else value


def _check_filters(atlas: "Atlas", loop: Any) -> None:
    """Refuse a loop of another estimator or filter, written per sample as an atlas writes it."""
    from jaxstab.atlas.spec import AtlasSpec, words_of

    own = AtlasSpec(**loop.filters).filters
    if own != atlas.filters:
        raise ValueError(
            f"the loop has {words_of(own)}, but this atlas was built for {atlas.filters_in_words}; "
            "use another atlas, or build one."
        )


def _ends(atlas: "Atlas", delay: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the ends of alpha and of beta at a delay, of which the atlas must say something."""
    arrays = atlas.arrays
    if ALPHA_LIMITS in arrays:
        rows = arrays[LIMIT_RANGE]
        row = rows[int(np.searchsorted(rows[:, 0], delay, "right")) - 1]
        if delay <= row[1]:
            return (float(row[2]), float(row[3])), (float(row[4]), float(row[5]))
    elif delay in atlas.delays:
        nodes = atlas.nodes(int(np.searchsorted(atlas.delays, delay)))
        alpha, beta = ((float(axis[0]), float(axis[-1])) for axis in list(nodes.values())[:2])
        return alpha, beta
    delays = ", ".join(f"{node:g}" for node in atlas.delays.tolist())
    raise ValueError(
        f"delay of the loop is {delay!r} samples, but this atlas holds only {delays}; use "
        "another atlas, or build one."
    )


_MOST = 1e300  # of numbers that are answered without a check: floats hold them


class Atlas:
    """An atlas in memory; ``open_atlas`` makes it.

    Attributes:
        arrays: the variables of the file by name (``jaxstab.atlas.schema`` describes them),
            each unpacked at its first use; one of more than 2 GiB is refused then.
        spec: the TOML text from which the atlas was built.
        created_by: the program and version that built it.
        filters_in_words: the velocity estimator and the position filter of its loops.

    Example:
        >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
        >>> atlas.products, atlas.delays.tolist(), atlas.filters is None
        (('verdict', 'alpha_limits', 'fields'), [0.0, 1.0, 1.5], True)
        >>> {name: nodes.size for name, nodes in atlas.nodes(0).items()}
        {'alpha': 10, 'beta': 9, 'gamma': 3, 'delta': 3}
        >>> hand = {"gamma": 0.0005, "delta": 0.01, "delay": 1.0}
        >>> answer = atlas.query([0.05, 0.2], beta=0.3, **hand)
        >>> statuses = map(jaxstab.results.QueryStatus, answer.status.tolist())
        >>> answer.verdict.tolist(), [status.name for status in statuses]
        ([1, 2], ['CELL', 'CELL'])
        >>> jaxstab.Verdict(atlas.verdict(0.05, 0.3, **hand)), round(atlas.decided_fraction(1), 1)
        (<Verdict.STABLE: 1>, 1.0)
        >>> limits = atlas.alpha_limits([0.3, 0.5], **hand)
        >>> (limits.upper - limits.upper_error).round(4).tolist()  # proved stable up to here
        [0.1358, 0.1435]
        >>> largest = atlas.max_alpha(gamma=0.0005, delta=0.01, delay=1.5)
        >>> bool(largest.alpha <= largest.bound), round(float(largest.beta), 2)
        (True, 0.35)
        >>> hands = {"gamma": (0.0, 0.001), "delta": (0.0, 0.015)}
        >>> jaxstab.Verdict(atlas.worst_verdict(0.05, 0.3, **hands, delay=1.0))
        <Verdict.STABLE: 1>
        >>> low, high = atlas.common_alpha_limits(0.3, **hands, delay=1.0)
        >>> low < high, round(high, 2)
        (True, 0.13)
        >>> axes = atlas.plot(delay=1.0)
    """

    arrays: PackedArrays
    spec: str
    created_by: str
    filters_in_words: str

    def __init__(self, arrays: PackedArrays) -> None:
        self.arrays = arrays
        self.spec = b"\n".join(arrays[SPEC].tolist()).decode("utf-8") + "\n"
        self.created_by = arrays.table.created_by
        self.filters_in_words = arrays.table.filters

    @property
    def products(self) -> tuple[str, ...]:
        """The products that were computed, of ``jaxstab.atlas.schema.PRODUCTS``."""
        return tuple(name for name, product in PRODUCTS.items() if product.names[0] in self.arrays)

    @property
    def delays(self) -> Floats:
        """The delays t_d/T of the atlas, ascending."""
        return self.arrays["delay"]

    @cached_property
    def filters(self) -> tuple[Any, Any] | None:
        """The Velocity and the Filter, per sample; None for the one-sample difference alone."""
        from jaxstab.atlas.spec import filters_of

        return filters_of(self.spec)

    def nodes(self, delay_number: int) -> dict[str, Floats]:
        """The nodes along alpha, beta, gamma and delta at one delay of ``delays``."""
        return nodes_of(self.arrays, delay_number)

    def decided_fraction(self, delay_number: int) -> float:
        """Return the share of the volume at one delay in which a query between nodes is decided."""
        nodes = self.nodes(delay_number)
        if self._table is not None:
            return self._table.decided_share(float(self.delays[delay_number]))
        if CELL_VERDICT not in self.arrays:
            return 0.0
        blocks = self.arrays.blocks(CELL_VERDICT, delay_number)
        return decided_share(blocks, [*nodes.values()])

    def query(
        self,
        alpha: Numbers,
        beta: Numbers,
        *,
        gamma: Numbers,
        delta: Numbers,
        delay: Numbers,
        outside: Outside = "error",
        exact: bool = False,
    ) -> AtlasAnswer:
        """Verdicts of points of any broadcast shape, each proved or called undecided.

        The atlas answers for its own estimator and filter (``filters``; ``for_loop`` checks them).
        At a node of the grid the verdict is what was computed there. Between nodes it is given
        where the limits of alpha, or the proof for the whole cell, decide it, and is UNDECIDED
        elsewhere: at all delays for which there are limits, or else at those of ``delays``.

        Args:
            alpha, beta, gamma, delta, delay: see ``jaxstab.conventions``.
            outside: "error" to refuse points outside of the atlas, "undecided" to call them so.
            exact: settle UNDECIDED points inside by computation.

        Raises: see ``jaxstab.conventions``; ValueError also for points outside of the atlas, unless
        ``outside`` is "undecided".

        Source: ``jaxstab.proofs.columns``.
        """
        checked_word("outside", outside, ("error", "undecided"))
        points = np.broadcast_arrays(*all_checked((alpha, beta, gamma, delta, delay)))
        shape = points[0].shape
        has_verdicts = VERDICT in self.arrays or ALPHA_LIMITS in self.arrays
        unknown = Verdict.UNDECIDED if has_verdicts else Verdict.NOT_COMPUTED
        answer = AtlasAnswer(
            verdict=np.full(points[0].size, unknown, np.int8),
            status=np.full(points[0].size, QueryStatus.BETWEEN_DELAYS, np.int8),
        )
        where = dict(zip(AXES, (point.reshape(-1) for point in points), strict=True))
        find_outside(self.arrays, self._table, where, answer.status, refuse=outside == "error")
        inside = answer.status != QueryStatus.OUTSIDE
        if self._table is not None:
            answer_by_limits(self._table, where, inside, answer)
        for index, node in enumerate(self.delays.tolist()):
            here = np.flatnonzero(inside & (where["delay"] == node))
            if here.size:
                answer_at_delay(self.arrays, index, where, here, answer)
        if exact:
            own = self.filters or (None, None)
            settle(where, answer, dict(zip(("velocity", "position"), own, strict=True)))
        return tree_map(lambda values: values.reshape(shape), answer)

    def verdict(
        self,
        alpha: Numbers,
        beta: Numbers,
        *,
        gamma: Numbers,
        delta: Numbers,
        delay: Numbers,
        outside: Outside = "error",
        exact: bool = False,
    ) -> NDArray[np.int8]:
        """The verdicts of ``query`` alone (int8 codes), faster where limits of alpha decide.

        Arguments, errors and source: as ``query``.
        """
        given = (alpha, beta, gamma, delta, delay)
        if outside == "error":
            codes = self._verdict_by_limits(given)
            if codes is not None and not (exact and np.any(codes == Verdict.UNDECIDED)):
                return codes
        return self.query(
            **dict(zip(AXES, given, strict=True)), outside=outside, exact=exact
        ).verdict

    def alpha_limits(
        self, beta: Numbers, *, gamma: Numbers, delta: Numbers, delay: Numbers
    ) -> AlphaLimits:
        """The smallest and largest stable alpha, with proved errors.

        Arguments and source as ``query``.

        Raises: see ``jaxstab.conventions``; ValueError also for values outside of the atlas, and if
        it holds no limits of alpha.
        """
        table, points = self._table_and_points(delay, gamma=gamma, delta=delta, beta=beta)
        gamma, delta, beta, delay = points
        inner = table.limits_within(*(p.reshape(-1) for p in (beta, gamma, delta, delay)))
        is_empty = inner.lower == np.inf
        limits = (np.where(is_empty, np.nan, limit) for limit in (inner.lower, inner.upper))
        errors = (error.astype(float) for error in (inner.lower_error, inner.upper_error))
        parts = zip(limits, errors, strict=True)
        return AlphaLimits(*(v.reshape(beta.shape) for pair in parts for v in pair))

    def max_alpha(self, *, gamma: Numbers, delta: Numbers, delay: Numbers) -> MaxAlpha:
        """The largest stable alpha, the beta where it is, and a proved bound.

        Arguments, errors and source: as ``alpha_limits``.
        """
        table, points = self._table_and_points(delay, gamma=gamma, delta=delta)
        largest = table.max_alpha(*(point.reshape(-1) for point in points))
        return MaxAlpha(*(value.reshape(points[0].shape) for value in largest))

    def worst_verdict(
        self, alpha: float, beta: float, *, gamma: Range, delta: Range, delay: float
    ) -> np.int8:
        """The verdict on one wall over a box of (gamma, delta), each a (lowest, highest) pair.

        STABLE if proved for the whole box, UNSTABLE if proved at one point of it, else UNDECIDED.
        Source: as ``alpha_limits``; errors too, and ValueError for a range whose ends are swapped.
        """
        table = self._table_over(alpha, beta, gamma, delta, delay)
        return np.int8(table.worst_verdict(alpha, beta, gamma, delta, delay))

    def common_alpha_limits(
        self, beta: float, *, gamma: Range, delta: Range, delay: float
    ) -> Range:
        """The open interval of alpha that is proved stable for a whole box of (gamma, delta).

        It is empty where its first end is not less. Arguments, errors and source: as
        ``worst_verdict``.
        """
        table = self._table_over(None, beta, gamma, delta, delay)
        return table.common_limits(beta, gamma, delta, delay)

    def _verdict_by_limits(self, given: Sequence[Numbers]) -> NDArray[np.int8] | None:
        """The verdicts by the limits of alpha; None where they are missing or do not extend."""
        table = self._table
        if table is None:
            return None
        numbers = [v for v in given if isinstance(v, float | int) and not isinstance(v, bool)]
        if len(numbers) == len(given) and all(abs(v) < _MOST for v in numbers):
            point = tuple(map(float, numbers))
            return np.asarray(table.verdict(*point), np.int8) if table.holds(*point) else None
        points = [real_numbers(*pair) for pair in zip(AXES, given, strict=True)]
        np.broadcast(*points)  # refuses shapes that do not fit together
        try:
            return table.verdicts(points)
        except OutsideError:
            return None

    @cached_property
    def _table(self) -> LimitTable | None:
        if ALPHA_LIMITS not in self.arrays:
            return None
        names = ALPHA_LIMITS, LIMIT_RANGE, LIMIT_WHOLE
        hands = {name: self.arrays[name] for name in ("gamma", "delta")}
        return LimitTable(*(self.arrays[name] for name in names), **hands)

    def _table_and_points(
        self, delay: Numbers, **given: Numbers
    ) -> tuple[LimitTable, list[Floats]]:
        """The table of limits and the checked points of a query, the delays last."""
        table = self._table
        if table is None:
            raise ValueError(
                f"this atlas holds no limits of alpha; build one with the product {ALPHA_LIMITS!r}."
            )
        names = [*given, "delay"]
        points = np.broadcast_arrays(*all_checked((*given.values(), delay), names))
        query = dict(zip(names, points, strict=True))
        for name in ("gamma", "delta", "delay"):
            check_inside(name, query[name], self.arrays[name][0], self.arrays[name][-1])
        between = ~table.delays.covers(query["delay"])
        if np.any(between):
            delays = ", ".join(f"{node:g}" for node in self.delays.tolist())
            raise ValueError(
                f"delay is {float(query['delay'][between].flat[0])!r}; this atlas has limits at "
                f"{delays} alone."
            )
        cell = table.delays.cells_at(query["delay"])
        for name in {"alpha", "beta"} & set(given):
            check_inside(name, query[name], *table.delays.walls(name, cell))
        return table, list(points)

    def _table_over(
        self, alpha: float | None, beta: float, gamma: Range, delta: Range, delay: float
    ) -> LimitTable:
        ranges = {"gamma": checked_range("gamma", gamma), "delta": checked_range("delta", delta)}
        walls = {"beta": beta} | ({} if alpha is None else {"alpha": alpha})
        numbers = {name: checked_number(name, value) for name, value in walls.items()}
        return self._table_and_points(checked_number("delay", delay), **ranges, **numbers)[0]

    def outline(self, *, gamma: float, delta: float, delay: float) -> AtlasOutline:
        """The boundary of the stable region of a slice that is a node, with its corners.

        Args and Raises: see ``jaxstab.conventions``; ValueError also if a value is no node, or the
        atlas holds no outlines. Source: ``jaxstab.stable_region``.

        Example:
            >>> axes = {"gamma": (0.0,), "delta": (0.015,), "delay": (1.0,)}
            >>> spec = jaxstab.AtlasSpec(**axes, products=("outline",))
            >>> atlas = jaxstab.build_atlas(spec, "outlines.h5")  # doctest: +SKIP
            >>> atlas.outline(gamma=0.0, delta=0.015, delay=1.0)  # doctest: +SKIP
        """
        return outline_at(self.arrays, gamma, delta, delay)

    def for_loop(self, loop: Any) -> LoopAtlas:
        """This atlas for a loop's walls (K, B), in SI units.

        Raises: TypeError if it is no HapticLoop, JAX traces it, or its device and hand are not one
        mass; ValueError if its gamma, delta or delay is outside of the atlas or between its delays,
        or its estimator or filter is another.

        Source: Table I of Hulin, Preusche, Hirzinger (2008).

        Example:
            >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3-window.h5")
            >>> window = jaxstab.Velocity.difference(window=0.005)
            >>> device = {"device_mass": 0.2, "device_damping": 2.0, "sample_time": 1e-3}
            >>> loop = jaxstab.HapticLoop(**device, delay=1e-3, velocity=window)
            >>> jaxstab.Verdict(atlas.for_loop(loop).verdict(2000.0, 20.0))
            <Verdict.STABLE: 1>
        """
        return LoopAtlas(self, loop)

    def __repr__(self) -> str:
        atlas: Any = self
        delays = ", ".join(f"{delay:g}" for delay in atlas.delays)
        early, late = atlas.nodes(0), atlas.nodes(len(atlas.delays) - 1)
        ends = {
            name: (f"{axis.size} nodes", f"{axis[0]:.4g} to {axis[-1]:.4g}")
            for name, axis in early.items()
        }
        later = [f"{axis[0]:.4g} to {axis[-1]:.4g}" for axis in list(late.values())[:2]]
        one_plane = len(atlas.delays) == 1
        rows = [
            (f"  {name}", *ends[name], "" if one_plane else f"at the last delay {span}")
            for name, span in zip(("alpha", "beta"), later, strict=True)
        ]
        hand = ", ".join(f"{name} {' '.join(ends[name])}" for name in ("gamma", "delta"))
        return "\n".join(
            [
                f"Atlas of {', '.join(atlas.products)}, made by {atlas.created_by}",
                f"  {atlas.filters_in_words}",
                f"  delays {delays} samples",
                table_text(rows),
                f"  {hand}",
            ]
        )

    def _repr_html_(self) -> str:
        from jaxstab.pictures.style import html_of

        return html_of(self, self.plot, (5.0, 3.5))

    def plot(
        self,
        ax: "Axes | None" = None,
        *,
        gamma: float | None = None,
        delta: float | None = None,
        delay: float | None = None,
    ) -> "Axes":
        """Draw the verdicts of one plane of alpha and beta: stable, unstable, undecided.

        Args:
            ax: the axes of matplotlib to draw in; None makes a figure with matplotlib.pyplot.
            gamma: of the plane; None for the node in the middle.
            delta: of the plane; None for the node in the middle.
            delay: a delay of the atlas, in samples; None for its first one.

        Raises: ValueError if gamma or delta is outside of the atlas, the delay is not one of it,
        or it holds no verdicts.
        """
        from jaxstab.pictures.atlas import plot_atlas

        return plot_atlas(self, ax, gamma, delta, delay)


def open_atlas(path: str | PathLike[str]) -> Atlas:
    """Load an atlas into memory; all of its bytes are checked.

    An array over nodes or cells is unpacked by the first question that needs it.

    Raises: OSError if the file is missing or unreadable; ValueError if it is foreign, damaged, of
    another version of the schema, or beyond 2 GiB.

    Example:
        >>> jaxstab.open_atlas("data/golden/atlas-v3.h5").delays.tolist()
        [0.0, 1.0, 1.5]
    """
    return Atlas(file.read(Path(path)))
