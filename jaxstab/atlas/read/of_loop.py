"""An atlas asked in SI units, about the walls of one loop. No JAX."""

from importlib import import_module
from math import ulp
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.atlas.format import schema
from jaxstab.atlas.read.answer import AtlasAnswer, Floats, Numbers, QueryStatus, all_checked
from jaxstab.atlas.read.points import find_outside
from jaxstab.atlas.read.shown import ShownAtlas
from jaxstab.conventions import AXES
from jaxstab.numbers import checked_word

if TYPE_CHECKING:
    from jaxstab.atlas.read.atlas import Atlas

Outside = Literal["error", "undecided"]

# There and back between K and alpha are six roundings of half an ulp each, at most.
_ROUNDINGS = 4.0 * float(np.finfo(np.float64).eps)
_ULPS_ASIDE = 4  # of numbers that the roundings of SI units move


class LargestStiffness(NamedTuple):
    """The largest stable stiffness of a loop, by the proofs of an atlas; NaN where there is none.

    The loop is stable at ``damping`` and every stiffness just below ``stiffness``, and at no
    stiffness above ``bound`` and no damping of the atlas. Where the stable set may go on beyond the
    atlas, across its largest stiffness or an end of the damping, ``bound`` is infinite.

    Example:
        >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
        >>> loop = jaxstab.HapticLoop(
        ...     device_mass=0.1, device_damping=1.0, sample_time=1e-3, delay=1.5e-3
        ... )
        >>> largest = atlas.for_loop(loop).largest_stiffness()
        >>> print(f"{largest.stiffness:.0f} N/m, none above {largest.bound:.0f} N/m")
        9449 N/m, none above 9585 N/m
    """

    stiffness: float
    damping: float
    bound: float


class LoopAtlas:
    """What an atlas says about the walls of one loop, in SI units; ``Atlas.for_loop`` makes it.

    In all answers K is in N/m and B in N s/m (N m/rad and N m s/rad for a loop that turns). They
    are proved for the dimensionless numbers of the loop, which are right to some roundings: gamma,
    delta or a delay that is a node up to four of them is taken for the node.

    Attributes:
        atlas: the atlas.
        loop: the loop.

    Example:
        >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
        >>> loop = jaxstab.HapticLoop(
        ...     device_mass=0.1, device_damping=1.0, sample_time=1e-3, delay=1e-3
        ... )
        >>> walls = atlas.for_loop(loop)
        >>> walls.verdict([5000.0, 18000.0], 30.0).tolist()
        [1, 2]
        >>> walls.stiffness_limits(30.0).round(-1).tolist()
        [0.0, 13600.0]
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
                    f"{name} of the loop is {value!r}, and this atlas reaches from "
                    f"{float(nodes[0])!r} to {float(nodes[-1])!r}; ask another atlas, or build one."
                )
        self._alphas, self._betas = _ends(atlas, self._slice["delay"])

    def __repr__(self) -> str:
        """Return the atlas, and the loop."""
        return f"{self.atlas!r}\nasked about {self.loop!r}"

    def query(
        self,
        stiffness: Numbers,
        damping: Numbers,
        outside: Outside = "error",
        *,
        exact: bool = False,
    ) -> AtlasAnswer:
        """Answer for walls: verdicts, and radii where the atlas holds them; see ``Atlas.query``.

        Args:
            stiffness: K in N/m, any shape; broadcasts with the damping.
            damping: B in N s/m.
            outside: "error" to refuse walls outside of the atlas, "undecided" to answer so.
            exact: settle UNDECIDED walls inside by computation.

        Raises:
            TypeError: a gain is not made of real numbers.
            ValueError: a gain is NaN or infinite or, unless ``outside`` is "undecided", outside of
                the atlas.

        Source: ``jaxstab.proofs.columns``; Table I.

        Example:
            >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
            >>> loop = jaxstab.HapticLoop(
            ...     device_mass=0.1, device_damping=1.0, sample_time=1e-3, delay=1e-3
            ... )
            >>> answer = atlas.for_loop(loop).query(5000.0, 30.0)
            >>> jaxstab.QueryStatus(int(answer.status)).name, jaxstab.Verdict(answer.verdict).name
            ('CELL', 'STABLE')
        """
        wall = self._asked(stiffness, damping, outside)
        return self.atlas.query(*wall, **self._slice, outside=outside, exact=exact)

    def verdict(
        self,
        stiffness: Numbers,
        damping: Numbers,
        outside: Outside = "error",
        *,
        exact: bool = False,
    ) -> NDArray[np.int8]:
        """Return the verdicts of ``query`` alone, faster: int8 codes of ``jaxstab.Verdict``.

        Args, errors and source: as ``query``.
        """
        wall = self._asked(stiffness, damping, outside)
        return self.atlas.verdict(*wall, **self._slice, outside=outside, exact=exact)

    def stiffness_limits(self, damping: Numbers) -> Floats:
        """Return the interval of stiffness in which every wall is proved stable, rounded inwards.

        Args:
            damping: B in N s/m, any shape.

        Returns:
            Array (*grid, 2) in N/m, an open interval within that of ``HapticLoop.stiffness_limits``
            and within the atlas; NaN where no stiffness is proved stable.

        Raises:
            TypeError: a damping is not a real number.
            ValueError: a damping is NaN, infinite or outside of the atlas, or this holds no limits
                of alpha.

        Source: ``jaxstab.proofs.columns``; Table I.
        """
        (given,) = all_checked([damping], ["damping"])
        beta = np.asarray(self.loop.beta(given))
        self._check_inside("damping", given, beta, self._betas, self.loop.damping)
        return self._limits(beta)

    def largest_stiffness(self) -> LargestStiffness:
        """Return the largest stable stiffness, where it is, and a proved bound.

        Raises:
            ValueError: this holds no limits of alpha.

        Source: ``jaxstab.proofs.columns``; Table I.

        Example:
            >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3.h5")
            >>> loop = jaxstab.HapticLoop(
            ...     device_mass=0.1, device_damping=1.0, sample_time=1e-3, delay=1e-3
            ... )
            >>> largest = atlas.for_loop(loop).largest_stiffness()
            >>> largest.stiffness <= largest.bound, round(largest.damping)
            (True, 43)
        """
        found = self.atlas.max_alpha(**self._slice)
        if np.isnan(found.alpha):
            return LargestStiffness(np.nan, np.nan, np.nan)
        # It is on an edge between two cells of beta, of which a rounded damping is in either.
        damping = float(self.loop.damping(float(found.beta)))
        near = damping + np.spacing(damping) * np.arange(-_ULPS_ASIDE, _ULPS_ASIDE + 1)
        beta = self.loop.beta(near)
        near, beta = (v[(beta >= self._betas[0]) & (beta <= self._betas[1])] for v in (near, beta))
        upper = np.nan_to_num(self._limits(beta)[:, 1], nan=-np.inf)
        best = int(np.argmax(upper))
        bound = self.loop.stiffness(float(found.bound))
        return LargestStiffness(
            float(upper[best]), float(near[best]), bound + _ROUNDINGS * abs(bound)
        )

    @np.errstate(invalid="ignore")  # infinite limits may have infinite errors
    def _limits(self, beta: Floats) -> Floats:
        """Return the stiffnesses between which all is proved stable, at values of beta."""
        found = self.atlas.alpha_limits(beta, **self._slice)
        lower = np.maximum(found.lower + found.lower_error, self._alphas[0])
        upper = np.minimum(found.upper - found.upper_error, self._alphas[1])
        ends = self.loop.stiffness(np.stack([lower, upper], axis=-1))
        ends += _ROUNDINGS * np.abs(ends) * np.array([1.0, -1.0])
        ends[~(ends[..., 0] < ends[..., 1])] = np.nan
        return ends

    def _asked(
        self, stiffness: Numbers, damping: Numbers, outside: Outside
    ) -> tuple[Numbers, Numbers]:
        """Return alpha and beta of walls, checked; one wall as two plain numbers."""
        checked_word("outside", outside, ("error", "undecided"))
        wall = all_checked((stiffness, damping), ("stiffness", "damping"))
        alpha, beta = np.asarray(self.loop.alpha(wall[0])), np.asarray(self.loop.beta(wall[1]))
        if outside == "error" and not self._knows_all(alpha, beta):
            self._check_inside("stiffness", wall[0], alpha, self._alphas, self.loop.stiffness)
            self._check_inside("damping", wall[1], beta, self._betas, self.loop.damping)
        if alpha.ndim == beta.ndim == 0:
            return float(alpha), float(beta)
        return alpha, beta

    def _knows_all(self, alpha: Floats, beta: Floats) -> bool:
        """Whether the atlas says something of all walls."""
        walls = {"alpha": alpha, "beta": beta} | self._slice
        points = np.broadcast_arrays(*(walls[name] for name in AXES))
        where = dict(zip(AXES, (point.reshape(-1) for point in points), strict=True))
        status = np.zeros(points[0].size, np.int8)
        find_outside(self.atlas.arrays, self.atlas._table, where, status, refuse=False)
        return not np.any(status == QueryStatus.OUTSIDE)

    @staticmethod
    def _check_inside(
        name: str, gains: Floats, numbers: Floats, ends: tuple[float, float], in_units: Any
    ) -> None:
        """Raise ValueError for the first gain whose dimensionless number is not in the atlas."""
        low, high = ends
        beyond = np.flatnonzero(~((numbers >= low) & (numbers <= high)))
        if beyond.size:
            raise ValueError(
                f"{name} is {float(gains.flat[beyond[0]])!r}, and this atlas reaches from "
                f"{in_units(low):.9g} to {in_units(high):.9g} for this loop; ask inside of it, or "
                "set outside to 'undecided'."
            )


class AskedByLoops(ShownAtlas):
    """An atlas that is asked about loops in SI units."""

    def for_loop(self, loop: Any) -> LoopAtlas:
        """Return this atlas for questions about a loop's walls (K, B), in SI units.

        Args:
            loop: a HapticLoop whose device and hand are one mass; gamma, delta, delay and its
                estimator must be those of the atlas.

        Raises:
            TypeError: it is no HapticLoop, JAX traces it, or its device is not one mass.
            ValueError: its gamma, delta or delay is outside of the atlas, its delay is one of which
                the atlas says nothing, or its estimator or filter is another.

        Source: Table I of Hulin, Preusche, Hirzinger (2008).

        Example:
            >>> atlas = jaxstab.open_atlas("data/golden/atlas-v3-window.h5")
            >>> window = jaxstab.Velocity.difference(window=0.005)
            >>> device = {"device_mass": 0.2, "device_damping": 2.0, "sample_time": 1e-3}
            >>> loop = jaxstab.HapticLoop(**device, delay=1e-3, velocity=window)
            >>> jaxstab.Verdict(atlas.for_loop(loop).verdict(2000.0, 20.0))
            <Verdict.STABLE: 1>
        """
        return LoopAtlas(self, loop)  # type: ignore[arg-type]


def _checked_loop(loop: Any) -> Any:
    """Return a loop of plain numbers, by whose properties all is converted."""
    # By name at run time: who reads an atlas without a loop does not wait for this import.
    if not isinstance(loop, import_module("jaxstab.model.loop").LoopParameters):
        raise TypeError(f"loop is {loop!r}; give a jaxstab.HapticLoop.")
    plain = loop.in_floats()
    if plain.body is None:
        raise TypeError(
            f"an atlas is of devices that are one mass with their hand, and this one is not "
            f"({loop.device}); ask the loop itself."
        )
    return plain


def _node_or(nodes: Floats, value: float) -> float:
    """Return the node that a number of a loop is up to some roundings, or else the number."""
    nearest = float(nodes[np.argmin(np.abs(nodes - value))])
    return nearest if abs(nearest - value) <= _ULPS_ASIDE * ulp(value) else value


def _check_filters(atlas: "Atlas", loop: Any) -> None:
    """Refuse a loop of another estimator or filter, written per sample as an atlas writes it."""
    own = import_module("jaxstab.atlas.format.spec").AtlasSpec(**loop.filters).filters
    if own != atlas.filters:
        words = import_module("jaxstab.atlas.format.filters").words_of(own)
        raise ValueError(
            f"the loop has {words}, and this atlas is of {atlas.filters_in_words}; ask another "
            "atlas, or build one."
        )


def _ends(atlas: "Atlas", delay: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the ends of alpha and of beta at a delay, of which the atlas must say something."""
    arrays = atlas.arrays
    if schema.ALPHA_LIMITS in arrays:
        rows = arrays[schema.LIMIT_RANGE]
        row = rows[np.searchsorted(rows[:, 0], delay, "right") - 1]
        if delay <= row[1]:
            return (float(row[2]), float(row[3])), (float(row[4]), float(row[5]))
    elif delay in atlas.delays:
        nodes = atlas.nodes(int(np.searchsorted(atlas.delays, delay)))
        alpha, beta = ((float(axis[0]), float(axis[-1])) for axis in list(nodes.values())[:2])
        return alpha, beta
    known = ", ".join(f"{node:g}" for node in atlas.delays.tolist())
    raise ValueError(
        f"delay of the loop is {delay!r} samples, and this atlas answers at {known} alone; ask "
        "another atlas, or build one."
    )
