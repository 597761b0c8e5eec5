"""Answers from an atlas in memory: at a node what it holds, elsewhere only what is proved.

NumPy alone: no JAX, no HDF5, and nothing else that takes time to import.
"""

from collections.abc import Sequence
from functools import cached_property
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.format import schema
from jaxstab.atlas.read import file
from jaxstab.atlas.read.answer import (
    AtlasAnswer,
    Numbers,
    QueryStatus,
    all_checked,
    check_inside,
    checked_range,
    no_answer,
    settle,
)
from jaxstab.atlas.read.cells import decided_share
from jaxstab.atlas.read.held import HeldAtlas, of_filters
from jaxstab.atlas.read.limits import AlphaLimits, LimitTable, MaxAlpha, OutsideError
from jaxstab.atlas.read.of_loop import Outside
from jaxstab.atlas.read.points import (
    answer_at_delay,
    answer_by_limits,
    answer_radii,
    find_outside,
)
from jaxstab.atlas.read.radii import RadiusTable
from jaxstab.conventions import AXES, UNDECIDED
from jaxstab.numbers import checked_number, checked_word, real_numbers

Floats = NDArray[np.float64]
Range = tuple[float, float]

_MOST = 1e300  # of numbers that are answered without a check: floats hold them


class Atlas(HeldAtlas):
    """An atlas in memory; ``open_atlas`` makes it.

    Attributes:
        arrays: the variables of the file by name (``jaxstab.atlas.format.schema`` describes them),
            each unpacked when it is first asked for; one of more than 2 GiB is refused then.
        spec: the TOML text from which the atlas was built.
        created_by: the program and version that built it.
        filters_in_words: the velocity estimator and the position filter of its loops.

    Example:
        >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
        >>> atlas.query([0.05, 0.2], beta=0.3, gamma=0.0005, delta=0.01, delay=1.0).verdict.tolist()
        [1, 2]
        >>> jaxstab.Verdict(atlas.verdict(0.05, 0.3, gamma=0.0005, delta=0.01, delay=1.0))
        <Verdict.STABLE: 1>
        >>> round(float(atlas.alpha_limits(0.3, gamma=0.0005, delta=0.01, delay=1.0).upper), 6)
        0.136525
        >>> hands = {"gamma": (0.0, 0.001), "delta": (0.0, 0.015)}
        >>> jaxstab.Verdict(atlas.worst_verdict(0.05, 0.3, **hands, delay=1.0))
        <Verdict.STABLE: 1>
    """

    def decided_fraction(self, delay_number: int) -> float:
        """Return the share of the volume at one delay in which a query between nodes is decided.

        Example:
            >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
            >>> round(atlas.decided_fraction(1), 1)
            1.0
        """
        nodes = self.nodes(delay_number)
        if self._table is not None:
            return self._table.decided_share(float(self.delays[delay_number]))
        if schema.CELL_VERDICT not in self.arrays:
            return 0.0
        if isinstance(self.arrays, file.PackedArrays):
            blocks = self.arrays.blocks(schema.CELL_VERDICT, delay_number)
            return decided_share(blocks, [*nodes.values()])
        codes = self.arrays[schema.CELL_VERDICT][..., delay_number : delay_number + 1]
        return decided_share([((0, 0, 0, 0, 0), codes)], [*nodes.values()])

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
        velocity: Any = None,
        position: Any = None,
    ) -> AtlasAnswer:
        """Answer for points of any broadcast shape, never with a guess.

        At a node of the grid the verdict is what was computed there. Between nodes it is given
        where the limits of alpha, or the proof for the whole cell, decide it, and is UNDECIDED
        elsewhere. So it is at all delays for which limits are held, or else at those of ``delays``.
        Spectral radii are functions of cells, at nodes and between them, each with a proved bound.

        Args:
            alpha: wall stiffness K T^2/m.
            beta: wall damping B T/m.
            gamma: physical stiffness k T^2/m.
            delta: physical damping b T/m.
            delay: time delay t_d/T in samples.
            outside: "error" to refuse points outside of the atlas, "undecided" to answer so.
            exact: settle UNDECIDED points inside by computation.
            velocity: the velocity estimator that you mean, in units of one sample; an atlas of
                another one refuses. Without it and ``position`` the atlas answers for its own.
            position: likewise, the position filter.

        Raises:
            TypeError: an argument is not made of real numbers.
            ValueError: a value is NaN or infinite or, unless ``outside`` is "undecided", outside of
                the atlas; or the atlas has another estimator or filter than the named one.

        Source: ``jaxstab.proofs.columns``.

        Example:
            >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
            >>> answer = atlas.query([0.05, 0.2], beta=0.3, gamma=0.0005, delta=0.01, delay=1.0)
            >>> answer.verdict.tolist(), [jaxstab.QueryStatus(int(s)).name for s in answer.status]
            ([1, 2], ['CELL', 'CELL'])
        """
        checked_word("outside", outside, ("error", "undecided"))
        self._check_filters(velocity, position)
        points = np.broadcast_arrays(*all_checked((alpha, beta, gamma, delta, delay)))
        shape = points[0].shape
        answer = no_answer(points[0].size, has_verdicts=self._has_verdicts)
        where = dict(zip(AXES, (point.reshape(-1) for point in points), strict=True))
        find_outside(self.arrays, self._table, where, answer.status, refuse=outside == "error")
        inside = answer.status != QueryStatus.OUTSIDE
        if self._table is not None:
            answer_by_limits(self._table, where, inside, answer)
        for number, node in enumerate(self.delays.tolist()):
            here = np.flatnonzero(inside & (where["delay"] == node))
            if here.size:
                answer_at_delay(self.arrays, number, where, here, answer)
        if schema.SPECTRAL_RADIUS in self.products:
            answer_radii(self._radii, where, inside, answer)
        if exact:
            own = self.filters or (None, None)
            settle(where, answer, dict(zip(("velocity", "position"), own, strict=True)))
        return answer.reshaped(shape)

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
        velocity: Any = None,
        position: Any = None,
    ) -> NDArray[np.int8]:
        """Return the verdicts of ``query`` alone, by the limits of alpha where the atlas has them.

        With limits of alpha, points are answered many times faster.

        Args, errors and source: as ``query``.

        Returns:
            int8 codes of ``jaxstab.Verdict`` of the broadcast shape.

        Example:
            >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
            >>> atlas.verdict([0.05, 0.2], 0.3, gamma=0.0005, delta=0.01, delay=1.0).tolist()
            [1, 2]
        """
        self._check_filters(velocity, position)
        given = (alpha, beta, gamma, delta, delay)
        if outside == "error":
            codes = self._verdict_by_limits(given)
            if codes is not None and not (exact and np.any(codes == UNDECIDED)):
                return codes
        return self.query(
            **dict(zip(AXES, given, strict=True)), outside=outside, exact=exact
        ).verdict

    def alpha_limits(
        self, beta: Numbers, *, gamma: Numbers, delta: Numbers, delay: Numbers
    ) -> AlphaLimits:
        """Return the smallest and largest stable alpha, with proved errors.

        Args:
            beta: wall damping B T/m; like the others it broadcasts.
            gamma: physical stiffness k T^2/m.
            delta: physical damping b T/m.
            delay: time delay t_d/T in samples.

        Raises:
            TypeError: an argument is not made of real numbers.
            ValueError: a value is NaN, infinite or outside of the atlas, or this holds no limits of
                alpha.

        Source: ``jaxstab.proofs.columns``.

        Example:
            >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
            >>> limits = atlas.alpha_limits([0.3, 0.5], gamma=0.0005, delta=0.01, delay=1.0)
            >>> (limits.upper - limits.upper_error).round(4).tolist()  # proved stable up to here
            [0.1358, 0.1435]
        """
        table, points = self._asked(delay, gamma=gamma, delta=delta, beta=beta)
        gamma, delta, beta, delay = points
        found = table.known_limits(*(p.reshape(-1) for p in (beta, gamma, delta, delay)))
        is_empty = found.lower == np.inf
        limits = (np.where(is_empty, np.nan, limit) for limit in (found.lower, found.upper))
        errors = (error.astype(float) for error in (found.lower_error, found.upper_error))
        parts = zip(limits, errors, strict=True)
        return AlphaLimits(*(v.reshape(beta.shape) for pair in parts for v in pair))

    def max_alpha(self, *, gamma: Numbers, delta: Numbers, delay: Numbers) -> MaxAlpha:
        """Return the largest stable alpha of hands, where it is, and a proved bound.

        Args:
            gamma: physical stiffness k T^2/m; like the others it broadcasts.
            delta: physical damping b T/m.
            delay: time delay t_d/T in samples.

        Raises:
            TypeError, ValueError: as ``alpha_limits``.

        Source: ``jaxstab.proofs.columns``.

        Example:
            >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
            >>> largest = atlas.max_alpha(gamma=0.0005, delta=0.01, delay=1.5)
            >>> bool(largest.alpha <= largest.bound), round(float(largest.beta), 2)
            (True, 0.35)
        """
        table, points = self._asked(delay, gamma=gamma, delta=delta)
        found = table.max_alpha(*(point.reshape(-1) for point in points))
        return MaxAlpha(*(value.reshape(points[0].shape) for value in found))

    def worst_verdict(
        self, alpha: float, beta: float, *, gamma: Range, delta: Range, delay: float
    ) -> np.int8:
        """Return the verdict on one wall for a box of hands.

        Args:
            alpha: wall stiffness K T^2/m.
            beta: wall damping B T/m.
            gamma: lowest and highest physical stiffness k T^2/m.
            delta: lowest and highest physical damping b T/m.
            delay: time delay t_d/T in samples.

        Returns:
            STABLE if proved for every hand of the box, UNSTABLE if proved for one, else UNDECIDED.

        Raises:
            TypeError, ValueError: as ``alpha_limits``; or a range has its ends swapped.

        Source: ``jaxstab.proofs.columns``.

        Example:
            >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
            >>> hands = {"gamma": (0.0, 0.001), "delta": (0.0, 0.015)}
            >>> jaxstab.Verdict(atlas.worst_verdict(0.05, 0.3, **hands, delay=1.0)).name
            'STABLE'
        """
        table = self._asked_over(alpha, beta, gamma, delta, delay)
        return np.int8(table.worst_verdict(alpha, beta, gamma, delta, delay))

    def common_alpha_limits(
        self, beta: float, *, gamma: Range, delta: Range, delay: float
    ) -> Range:
        """Return the interval of alpha in which every hand of a box is proved stable.

        Args:
            beta: wall damping B T/m.
            gamma: lowest and highest physical stiffness k T^2/m.
            delta: lowest and highest physical damping b T/m.
            delay: time delay t_d/T in samples.

        Returns:
            The lowest and the highest alpha, an open interval; empty where the first is not less.

        Raises:
            TypeError, ValueError: as ``worst_verdict``.

        Source: ``jaxstab.proofs.columns``.

        Example:
            >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
            >>> low, high = atlas.common_alpha_limits(
            ...     0.3, gamma=(0.0, 0.001), delta=(0.0, 0.015), delay=1.0
            ... )
            >>> low < high, round(high, 2)
            (True, 0.13)
        """
        table = self._asked_over(None, beta, gamma, delta, delay)
        return table.common_limits(beta, gamma, delta, delay)

    def _check_filters(self, velocity: Any, position: Any) -> None:
        """Refuse a question about loops with others than those of the atlas."""
        if velocity is None and position is None:
            return
        asked = import_module("jaxstab.model.filters").known_filters(velocity, position)
        if asked != self.filters:
            raise ValueError(
                f"the question is about {of_filters('words_of')(asked)}, and this atlas is of "
                f"{self.filters_in_words}; ask another atlas, or build one."
            )

    def _verdict_by_limits(self, given: Sequence[Numbers]) -> NDArray[np.int8] | None:
        """Return what the limits of alpha say; None where they are missing or do not reach."""
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

    @property
    def _has_verdicts(self) -> bool:
        return schema.VERDICT in self.arrays or schema.ALPHA_LIMITS in self.arrays

    @cached_property
    def _radii(self) -> RadiusTable:
        """The spectral radii, where the atlas has them."""
        return RadiusTable(self.arrays)

    @cached_property
    def _table(self) -> LimitTable | None:
        """The limits of alpha, where the atlas has them."""
        if schema.ALPHA_LIMITS not in self.arrays:
            return None
        names = schema.ALPHA_LIMITS, schema.LIMIT_RANGE, schema.LIMIT_WHOLE
        hands = {name: self.arrays[name] for name in ("gamma", "delta")}
        return LimitTable(*(self.arrays[name] for name in names), **hands)

    def _asked(self, delay: Numbers, **given: Numbers) -> tuple[LimitTable, list[Floats]]:
        """Return the limits, and what is asked of them with the delays as the last; all checked."""
        table = self._table
        if table is None:
            raise ValueError(
                "this atlas holds no limits of alpha; build one with the product "
                f"{schema.ALPHA_LIMITS!r}."
            )
        names = [*given, "delay"]
        points = np.broadcast_arrays(*all_checked((*given.values(), delay), names))
        asked = dict(zip(names, points, strict=True))
        for name in ("gamma", "delta", "delay"):
            check_inside(name, asked[name], self.arrays[name][0], self.arrays[name][-1])
        between = ~table.delays.covers(asked["delay"])
        if np.any(between):
            delays = ", ".join(f"{node:g}" for node in self.delays.tolist())
            raise ValueError(
                f"delay is {float(asked['delay'][between].flat[0])!r}; this atlas has limits at "
                f"{delays} alone."
            )
        cell = table.delays.of(asked["delay"])
        for name in {"alpha", "beta"} & set(given):
            check_inside(name, asked[name], *table.delays.walls(name, cell))
        return table, list(points)

    def _asked_over(
        self, alpha: float | None, beta: float, gamma: Range, delta: Range, delay: float
    ) -> LimitTable:
        ranges = {"gamma": checked_range("gamma", gamma), "delta": checked_range("delta", delta)}
        walls = {"beta": beta} | ({} if alpha is None else {"alpha": alpha})
        numbers = {name: checked_number(name, value) for name, value in walls.items()}
        return self._asked(checked_number("delay", delay), **ranges, **numbers)[0]


def open_atlas(path: str | PathLike[str]) -> Atlas:
    """Load an atlas into memory; all of its bytes are checked.

    An array over nodes or cells is unpacked by the first question that needs it.

    Raises:
        OSError: the file is missing or unreadable.
        ValueError: it is foreign, damaged, of another version of the schema, or beyond 2 GiB.

    Example:
        >>> jaxstab.open_atlas("data/golden/atlas-v3.h5").delays.tolist()
        [0.0, 1.0, 1.5]
    """
    return Atlas(file.read(Path(path)))
