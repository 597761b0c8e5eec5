"""Answers from an atlas: the table where it is clear, a computed verdict everywhere else.

``Atlas`` answers in dimensionless numbers, ``LoopAtlas`` in SI units for the walls of one loop. A
query asks the table of limits first (``atlas.table``): where a wall is clear of the interpolated
limits by four times their measured error, that is its verdict. All other points, also those outside
of the nodes, are computed by the dense kernel, which proves what it says; balls decide what it
leaves open. So hardly anything is undecided.

No JAX is imported for answers of the table.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxstab import model, point
from jaxstab.arrays import Array, named
from jaxstab.atlas import file
from jaxstab.atlas.picture import plot_verdicts, raster
from jaxstab.atlas.table import PLANT, AlphaLimits, LimitTable
from jaxstab.conventions import AXES, Status, Verdict
from jaxstab.drawing import (
    ALPHA_LABEL,
    BETA_LABEL,
    DAMPING_LABEL,
    STIFFNESS_LABEL,
    hand_label,
    html_of,
)
from jaxstab.durable import identity_of, named_errors, target_of
from jaxstab.numbers import checked, require_kind, require_together
from jaxstab.shown import table_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]
Numbers = ArrayLike | float | int


class QueryStatus(Status):
    """The origin of an atlas's answer for a point.

    Example:
        >>> [status.name for status in jaxstab.results.QueryStatus]
        ['INTERPOLATED', 'COMPUTED']
    """

    INTERPOLATED = 1, "clear of the interpolated limits by four times their measured error"
    COMPUTED = 2, "computed for this very point"


@dataclass(frozen=True)
class AtlasAnswer:
    """The answer of an atlas about points; two arrays of the broadcast shape of the query.

    Attributes:
        verdict: the ``jaxstab.Verdict`` on one point, int8 codes of several.
        status: a ``QueryStatus`` or codes likewise: how this is known.

    Example:
        >>> atlas = jaxstab.open_atlas("data/golden/atlas-v5.h5")
        >>> answer = atlas.query([0.05, 0.18], 0.3, gamma=0.0005, delta=0.01, delay=7.0)
        >>> [jaxstab.results.QueryStatus(int(code)).name for code in answer.status]
        ['COMPUTED', 'COMPUTED']
    """

    verdict: Array
    status: Array


class Atlas:
    """An atlas; ``open_atlas`` makes it.

    Attributes:
        table: the limits at nodes, with the errors of cells, as arrays (``atlas.table``).
        spec: the TOML text from which the atlas was built.
        created_by: the program and version that built it.
        filters_in_words: the velocity estimator and the position filter of its loops.
        tested: random walls of the build: their number, the number that the table answered wrongly
            (0, or the build fails), that it left to be computed, and that stayed undecided.
        has_fields: True with ``fields``.

    Example:
        >>> atlas = jaxstab.open_atlas("data/golden/atlas-v5.h5")
        >>> atlas.table.delay.tolist(), atlas.filters is None
        ([0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5], True)
        >>> hand = {"gamma": 0.0005, "delta": 0.01, "delay": 1.0}
        >>> answer = atlas.query([0.05, 0.2], beta=0.3, **hand)
        >>> statuses = map(jaxstab.results.QueryStatus, answer.status.tolist())
        >>> answer.verdict.tolist(), [status.name for status in statuses]
        ([1, 2], ['INTERPOLATED', 'INTERPOLATED'])
        >>> limits = atlas.alpha_limits([0.3, 0.5], **hand)
        >>> limits.upper.round(3).tolist()
        [0.137, 0.144]
        >>> atlas.fields["spectral_radius"].shape  # alpha, beta, gamma, delta, delay
        (10, 9, 3, 3, 3)
        >>> axes = atlas.plot(delay=1.0)
    """

    def __init__(self, path: Path) -> None:
        with named_errors("read", path):
            self._path, self._identity = path, identity_of(target_of(path)[0])
        contents = file.read_limits(path)
        self.table = LimitTable(**contents.arrays)
        self.spec, self.created_by = contents.spec, contents.created_by
        self.filters_in_words = contents.filters
        self.tested, self.has_fields = contents.tested, contents.has_fields

    @cached_property
    def filters(self) -> tuple[Any, Any] | None:
        """The Velocity and the Filter, per sample; None for the one-sample difference alone."""
        from jaxstab.atlas.spec import filters_of

        return filters_of(self.spec)

    @cached_property
    def fields(self) -> dict[str, NDArray[Any]]:
        """The fields and their axes by name, as arrays, read when they are first used.

        Raises: ValueError if the atlas has none, they take more than 2 GiB, or the file was
        replaced since the atlas was opened.
        """
        if not self.has_fields:
            raise ValueError("this atlas has no fields; build one from a spec with [fields].")
        if identity_of(target_of(self._path)[0]) != self._identity:
            raise ValueError(f"{self._path} was replaced since it was opened; open it again.")
        return file.read_fields(self._path)

    def query(
        self, alpha: Numbers, beta: Numbers, *, gamma: Numbers, delta: Numbers, delay: Numbers
    ) -> AtlasAnswer:
        """Verdicts of points of any broadcast shape, and the origin of each.

        The atlas answers for its own estimator and filter (``filters``; ``for_loop`` checks them).
        Between the nodes the table answers where a point is clear of the interpolated limits by
        four times their measured error, also beyond these limits. Every other point is computed,
        wherever it is.

        Args and Raises: see ``jaxstab.conventions``.

        Source: ``jaxstab.atlas.table``; ``jaxstab.verdict``.
        """
        point = _checked((alpha, beta, gamma, delta, delay))
        shape = np.broadcast_shapes(*(values.shape for values in point))
        is_shared = all(values.size == 1 for values in point[2:])
        flat = [
            values.reshape(-1)
            if is_shared and values.size == 1
            else np.broadcast_to(values, shape).reshape(-1)
            for values in point
        ]
        codes = self.table.verdicts(*flat)
        status = np.full(codes.shape, QueryStatus.INTERPOLATED, np.int8)
        pending = np.flatnonzero(codes == Verdict.UNDECIDED)
        if pending.size:
            own = [np.broadcast_to(values, codes.shape)[pending] for values in flat]
            codes[pending] = self._computed(own)
            status[pending] = QueryStatus.COMPUTED
        return AtlasAnswer(
            named(codes.reshape(shape), Verdict), named(status.reshape(shape), QueryStatus)
        )

    def _computed(self, places: Sequence[Floats]) -> NDArray[np.int8]:
        velocity, position = self.filters or (None, None)
        alpha, beta, gamma, delta, delay = places
        codes = point.verdict(
            alpha,
            beta,
            gamma=gamma,
            delta=delta,
            delay=delay,
            velocity=velocity,
            position=position,
            resolve="exact",
        )
        return np.asarray(codes, np.int8)

    def alpha_limits(
        self, beta: Numbers, *, gamma: Numbers, delta: Numbers, delay: Numbers
    ) -> AlphaLimits:
        """The smallest and the largest stable alpha, interpolated, with measured errors.

        NaN, with infinite errors, where no alpha is stable, where more than one interval is, and
        outside of the nodes. Args and Raises: see ``jaxstab.conventions``. Source:
        ``jaxstab.atlas.table``.
        """
        points = np.broadcast_arrays(*_checked((beta, gamma, delta, delay), AXES[1:]))
        limits = self.table.limits(*(values.reshape(-1) for values in points))
        return AlphaLimits(*(values.reshape(points[0].shape) for values in limits))

    def for_loop(self, loop: Any) -> "LoopAtlas":
        """This atlas for a loop's walls (K, B), in SI units.

        Raises: TypeError if it is no HapticLoop, JAX traces it, or its device and hand are not one
        mass; ValueError if its estimator or filter is another.

        Source: Table I of Hulin, Preusche, Hirzinger (2008).

        Example:
            >>> atlas = jaxstab.open_atlas("data/golden/atlas-v5-window.h5")
            >>> window = jaxstab.Velocity.difference(window=0.005)
            >>> device = {"device_mass": 0.2, "device_damping": 2.0, "sample_time": 1e-3}
            >>> loop = jaxstab.HapticLoop(**device, delay=1e-3, velocity=window)
            >>> jaxstab.Verdict(atlas.for_loop(loop).query(2000.0, 20.0).verdict)
            <Verdict.STABLE: 1>
        """
        return LoopAtlas(self, loop)

    def __repr__(self) -> str:
        table, tested = self.table, self.tested
        rows = [
            (
                f"  {name}",
                f"{nodes.size} node{'s' * (nodes.size > 1)}",
                f"{nodes[0]:.4g} to {nodes[-1]:.4g}",
            )
            for name, nodes in zip(PLANT, table.axes, strict=True)
        ]
        points = max(tested["tested_points"], 1)
        answered = 100.0 * (1.0 - tested["tested_computed"] / points)
        return "\n".join(
            [
                f"Atlas, made by {self.created_by}",
                f"  {self.filters_in_words}",
                f"  limits of alpha in {table.row.size} rows{', and fields' * self.has_fields}",
                table_text(rows),
                f"  of {points} random walls {answered:.2f} % from the table, "
                f"{tested['tested_wrong']} wrong",
            ]
        )

    def _repr_html_(self) -> str:
        return html_of(self, self.plot)

    def plot(
        self,
        ax: "Axes | None" = None,
        *,
        gamma: float | None = None,
        delta: float | None = None,
        delay: float | None = None,
    ) -> "Axes":
        """Draw the verdicts of one plane of alpha and beta.

        Args:
            ax: the axes of matplotlib to draw in; None makes a figure with matplotlib.pyplot.
            gamma: of the plane; None for the node in the middle.
            delta: of the plane; None for the node in the middle.
            delay: in samples; None for the first node.

        Raises: ValueError if gamma, delta or delay is outside of the atlas, or nothing is stable
        there.
        """
        table = self.table
        hand = (
            float(table.gamma[table.gamma.size // 2]) if gamma is None else gamma,
            float(table.delta[table.delta.size // 2]) if delta is None else delta,
        )
        samples = float(table.delay[0]) if delay is None else delay
        alpha, beta = raster(table, *hand, samples)
        plant = dict(zip(PLANT, (*hand, samples), strict=True))
        plane = alpha, beta, self.query(alpha, beta[:, None], **plant).verdict
        words = f"{hand_label(*hand)}, $d = {samples:g}$"
        return plot_verdicts(ax, plane, (ALPHA_LABEL, BETA_LABEL), self.filters_in_words, words)


def open_atlas(path: str | PathLike[str]) -> Atlas:
    """Open an atlas: its limits are read and checked, its fields when they are first used.

    Raises: OSError if the file is missing or unreadable; ValueError if it is foreign, damaged, or
    of another version of the format.

    Example:
        >>> jaxstab.open_atlas("data/golden/atlas-v5.h5").has_fields
        True
    """
    return Atlas(Path(path))


class LoopAtlas:
    """An atlas for the walls of one loop, in SI units; ``Atlas.for_loop`` makes it.

    K is in N/m and B in N s/m (N m/rad and N m s/rad for a rotational loop).

    Attributes:
        atlas: the atlas.
        loop: the loop.

    Example:
        >>> atlas = jaxstab.open_atlas("data/golden/atlas-v5.h5")
        >>> device = {"device_mass": 0.1, "device_damping": 1.0}
        >>> loop = jaxstab.HapticLoop(**device, sample_time=1e-3, delay=1e-3)
        >>> walls = atlas.for_loop(loop)
        >>> walls.query([5000.0, 18000.0], 30.0).verdict.tolist()
        [1, 2]
        >>> walls.stiffness_limits(30.0).round(-2).tolist()
        [0.0, 13700.0]
        >>> jaxstab.results.QueryStatus(int(walls.query(5000.0, 30.0).status)).name
        'INTERPOLATED'
        >>> axes = walls.plot()
    """

    def __init__(self, atlas: Atlas, loop: Any) -> None:
        from jaxstab.atlas.spec import AtlasSpec, words_of

        require_kind("loop", loop, model.LoopParameters, "HapticLoop")
        self.atlas, self.loop = atlas, loop.in_floats()  # by its properties all is converted
        if self.loop.body is None:
            raise TypeError(
                f"an atlas covers devices that are one mass with their hand, and this one is not "
                f"({self.loop.device}); use the methods of the loop."
            )
        own = AtlasSpec(**self.loop.filters).filters  # per sample, as an atlas writes them
        if own != atlas.filters:
            raise ValueError(
                f"the loop has {words_of(own)}, but this atlas was built for "
                f"{atlas.filters_in_words}; use another atlas, or build one."
            )
        self._slice: dict[str, Any] = dict(self.loop.slice)

    def __repr__(self) -> str:
        return f"{self.atlas!r}\nfor {self.loop!r}"

    def query(self, stiffness: Numbers, damping: Numbers) -> AtlasAnswer:
        """Verdicts of walls (K, B) of any broadcast shape, and the origin of each.

        Args and Raises: see ``jaxstab.conventions``. Source: as ``Atlas.query``.
        """
        return self.atlas.query(*self._wall(stiffness, damping), **self._slice)

    def stiffness_limits(self, damping: Numbers) -> Floats:
        """The interval of stable stiffness, interpolated.

        Returns:
            Array (*grid, 2) in N/m; NaN as ``Atlas.alpha_limits``.

        Raises: as ``Atlas.alpha_limits``. Source: ``jaxstab.atlas.table``; Table I.
        """
        _, beta = self._wall(0.0, damping)
        limits = self.atlas.alpha_limits(beta, **self._slice)
        return np.asarray(self.loop.stiffness(np.stack([limits.lower, limits.upper], axis=-1)))

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Draw the verdicts of the walls (K, B), in SI units.

        Args:
            ax: the axes of matplotlib to draw in; None makes a figure with matplotlib.pyplot.

        Raises: ValueError if the loop is outside of the atlas. Source: as ``query``.
        """
        loop, atlas = self.loop, self.atlas
        alpha, beta = raster(atlas.table, *loop.slice.values())
        stiffness, damping = loop.stiffness(alpha), loop.damping(beta)
        plane = stiffness, damping, self.query(stiffness, damping[:, None]).verdict
        words = f"{loop.mass:g} kg, delay {1e3 * loop.delay:g} ms"
        labels = STIFFNESS_LABEL, DAMPING_LABEL
        return plot_verdicts(ax, plane, labels, atlas.filters_in_words, words)

    def _wall(self, stiffness: Numbers, damping: Numbers) -> tuple[Floats, Floats]:
        gains = _checked((stiffness, damping), ("stiffness", "damping"))
        return np.asarray(self.loop.alpha(gains[0])), np.asarray(self.loop.beta(gains[1]))


def _checked(values: Sequence[Numbers], names: Sequence[str] = AXES) -> list[Floats]:
    """Return real, finite numbers, or raise TypeError or ValueError for the first others."""
    given = dict(zip(names, values, strict=True))
    require_together(**given)
    return [np.asarray(checked(*pair), np.float64) for pair in given.items()]
