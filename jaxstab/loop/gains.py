"""The answers that all loops of two gains share: p(z) = base + a S + b R, with any polynomials.

A wall on a held device is such a loop, and so are those of ``jaxstab.Loop``. Verdicts, radii, poles
and intervals are those of lemmas E1 to E3 of docs/proofs.md, which ask nothing of the three parts
but that the leading coefficient of p(z) does not vanish. A pair of gains takes 0.1 to some
milliseconds in balls (``jaxstab.exact``); more than a hundred, and gains that JAX has, are a grid
for ``jaxstab.point``.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from math import inf
from typing import TYPE_CHECKING, Any, ClassVar, overload

import numpy as np
from jaxtyping import Complex128, Float64, Int8

from jaxstab import exact, motion, point
from jaxstab.arrays import Array, Numbers, is_any_jax, is_any_traced, is_jax, named, namespace
from jaxstab.conventions import Verdict
from jaxstab.exact.line import LineStatus
from jaxstab.exact.roots import affine_verdict
from jaxstab.model.affine import AffineParts, Chart, affine_triple
from jaxstab.model.balls import Factored, Triple
from jaxstab.model.gain import Gain
from jaxstab.model.linear_loop import LinearLoop
from jaxstab.model.plant import wall_grid
from jaxstab.numbers import checked_number

if TYPE_CHECKING:
    from jaxstab.model.loop import LoopParameters

_FEW = 100  # pairs of gains, which balls answer one by one

_ON_GRIDS: dict[str, Callable[..., Any]] = {
    "verdict": point.linear_verdict,
    "spectral_radius": point.linear_spectral_radius,
    "closed_loop_poles": point.linear_poles,
}


def _over_leading(gains: tuple[Gain, Gain], chart: Chart) -> tuple[Gain, Gain]:
    """The gains of a chart, named by what they are over the leading coefficient."""
    names, units = ("", *(gain.name for gain in gains)), ("", *(gain.unit for gain in gains))
    terms = [
        f"{'-' if weight < 0.0 else '+'} {abs(weight):.4g} {name}".rstrip().replace(" 1 ", " ")
        for weight, name in zip(chart.weights, names, strict=True)
        if weight
    ]
    leading = " ".join(terms).removeprefix("+ ")
    per = f"/({units[chart.by]})" if units[chart.by] else ""
    first, second = (
        Gain(f"{name or 1}/({leading})", f"{unit or 1}{per}" if per else unit)
        for k, (name, unit) in enumerate(zip(names, units, strict=True))
        if k != chart.by
    )
    return first, second


class TwoGains(ABC):
    """A loop that is affine in two gains.

    A kind of loop supplies ``gains``, ``sample_time``, the ``parts`` of p(z) in balls, and, for
    grids, these in pairs of float64 by gains of a unit of its own.
    """

    gains: tuple[Gain, Gain]
    sample_time: Any  # a number, or arrays of many loops
    shape: Any = ()  # of many loops
    bounded: tuple[Gain, Gain] | None = None
    _by_place: ClassVar[bool] = False  # gains need no names
    has_delay: ClassVar[bool] = False  # margins have that of a delay
    _held: Any = None  # the held device whose delay may be of any length
    _linear_rule: Any = None  # a damping in N s/m and a time in s, of the paper's linear rule
    _spring: Any = (0.0, 0.0)  # what holds the device beside the first gain; the same in units

    if TYPE_CHECKING:  # a field of some: an abstract property would be its default

        @property
        def parts(self) -> AffineParts:
            """The parts of p(z), in balls of the precision that is set."""

    @property
    @abstractmethod
    def _source(self) -> "LoopParameters | AffineParts":
        """What the boundary is traced of."""

    @property
    @abstractmethod
    def _chart(self) -> Chart:
        """The coordinates in which p(z) is monic."""

    @property
    @abstractmethod
    def _scale(self) -> tuple[float, float]:
        """Gains of the chart that are 1 in ``_pairs`` and regions."""

    @property
    @abstractmethod
    def _pairs(self) -> LinearLoop:
        """The parts of a monic p(z) in pairs of float64, by gains of size 1."""

    @abstractmethod
    def _in_units(self, first: Numbers, second: Numbers) -> tuple[Array, Array]:
        """Gains, checked, as those of ``_pairs``."""

    @property
    def coordinates(self) -> tuple[Gain, Gain]:
        """The coordinates in which the stable gains are bounded, and drawn.

        Example:
            >>> robot = jaxstab.admittance(1e4, sample_time=1e-3, delay_samples=4)
            >>> [gain.label for gain in robot.coordinates]
            ['1/mass (1/kg)', 'damping/mass (1/s)']
        """
        if self._chart.are_gains:
            return self.gains
        return self.bounded or _over_leading(self.gains, self._chart)

    @property
    def _only_few(self) -> bool:
        return not self._chart.are_gains  # float64 has no digits for a grid of gains

    def _triple(self) -> Triple:
        return affine_triple(self.parts)

    def _opened(self, first: float, second: float) -> tuple[Factored, Factored]:
        """D and N of the open loop N/D."""
        return self.parts.opened(first, second)

    def _verdict(self, first: float, second: float) -> Verdict:
        return affine_verdict(self.parts, first, second)

    def _but_for_drift(self, first: float, second: float) -> Verdict | None:
        """The verdict without the position, where gains do not hold that; None where they do."""
        return None

    def _is_stable(self, first: float, second: float) -> bool:
        """True for stable gains, the position of a device that nothing holds aside."""
        code = self._but_for_drift(first, second)
        return (self._verdict(first, second) if code is None else code) == Verdict.STABLE

    @property
    def _charted(self) -> "TwoGains":
        """The same loop by its coordinates."""
        return self

    def _line(self, start: tuple[float, float], along: tuple[float, float]) -> exact.StableLine:
        line = exact.stable_line(self._triple, start, along)
        if line.status == LineStatus.UNDECIDED and self.parts.is_reciprocal(start, along):
            return line._replace(status=LineStatus.PROVED, horizon=inf)
        return line

    def _row(self, name: str, value: float) -> exact.StableLine:
        """All stable values of one gain at a value of the other, which is named."""
        return self._line(*self._along(name, checked_number(name, value)))

    def _along(self, name: str, value: float) -> tuple[tuple[float, float], tuple[float, float]]:
        """Where that row starts, and along which gain it goes."""
        is_first = name == self.gains[0].name
        return ((value, 0.0), (0.0, 1.0)) if is_first else ((0.0, value), (1.0, 0.0))

    @overload
    def verdict(self, *wall: float, **gains: float) -> Verdict: ...
    @overload
    def verdict(self, *wall: Numbers, **gains: Numbers) -> Int8[Array, "*grid"]: ...
    def verdict(self, *wall: Numbers, **gains: Numbers) -> Verdict | Int8[Array, "*grid"]:
        """Proved verdicts on gains: codes of ``jaxstab.Verdict``, of any shape.

        Each takes about 0.1 ms; more than a hundred, and JAX arrays, are a grid that takes less
        than 0.1 us each where the gains do not move the leading coefficient of p(z). UNDECIDED
        where 3,072 bits do not tell (JAX: pairs of float64), where interval coefficients leave it
        open, and where the leading coefficient vanishes: the loop is algebraic there.

        Raises: TypeError for other names, gains that are not numbers, and JAX arrays where the
        gains move the leading coefficient; ValueError for gains that are not finite.

        Source: the criterion of Schur and Cohn; lemma E1 of docs/proofs.md.

        Example:
            >>> loop = jaxstab.simulated_pd(0.1, step=2e-3)
            >>> loop.verdict(kp=1000.0, kd=[0.0, 10.0, 200.0]).tolist()
            [2, 1, 2]
        """
        pair = self._named(wall, gains)
        grid = self._few(pair)
        codes = self._codes(pair) if grid is None else self._verdicts(grid)
        if grid is None and not is_jax(codes):
            codes, grid = np.array(codes), wall_grid(**pair)
            for place in np.flatnonzero(codes == Verdict.UNDECIDED):
                codes.flat[place] = self._verdict(*grid.reshape(-1, 2)[place].tolist())
        return named(codes, Verdict)

    def spectral_radius(self, *wall: Numbers, **gains: Numbers) -> "point.SpectralRadius":
        """The largest modulus of the loop's poles per sample, with a proved error bound.

        Args and Raises: see ``jaxstab.conventions``; a wall goes by place, other gains by their
        names. Bound and status: see ``jaxstab.spectral_radius``.

        Source: lemma E2 of docs/proofs.md.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> loop.spectral_radius(1000.0, 10.0)
            0.9407239707335... +/- ... (proved)
            >>> loop = jaxstab.simulated_pd(0.1, step=2e-3)
            >>> round(float(loop.spectral_radius(kp=1000.0, kd=20.0).value), 6)
            0.871652
        """
        pair = self._named(wall, gains)
        grid = self._few(pair)
        if grid is None:
            radii: point.SpectralRadius
            radii = self._on_grid("spectral_radius", self._in_units(*pair.values()))
            return radii
        found = [exact.spectral_radius(self._triple, *own) for own in grid.reshape(-1, 2).tolist()]
        return point.with_status(*np.reshape(np.transpose(found), (2, *grid.shape[:-1])))

    def poles(self, *wall: Numbers, **gains: Numbers) -> Complex128[Array, "*grid pole"]:
        """The poles of the loop per sample, the one of the largest modulus first.

        Those of few gains are proved to all digits unless some of them coincide; all others are as
        accurate as those of ``jaxstab.closed_loop_poles``.

        Args and Raises: as ``spectral_radius``.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> abs(loop.poles(1000.0, 10.0)).round(4).tolist()
            [0.9407, 0.9407, 0.0559]
            >>> loop = jaxstab.simulated_pd(0.1, step=2e-3)
            >>> loop.poles(kp=1000.0, kd=20.0).round(6).tolist()
            [(0.871652+0j), (0.688348+0j)]
        """
        pair = self._named(wall, gains)
        grid = self._few(pair)
        if grid is not None and grid.size:
            every = grid.reshape(-1, 2).tolist()
            values = [exact.poles(self._triple, *own).values for own in every]
            if not np.any(np.isnan(values)):
                return np.reshape(values, (*grid.shape[:-1], -1))
        found: Array = self._on_grid("closed_loop_poles", self._in_units(*pair.values()))
        return found

    def oscillation(self, *wall: Numbers, **gains: Numbers) -> "motion.Oscillation":
        """Damping ratio and frequency in Hz of the slowest mode of the loop.

        Args and Raises: as ``spectral_radius``. Source: as ``jaxstab.dominant_mode``; Table I.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> round(float(loop.oscillation(20000.0, 20.0).frequency), 1)  # Hz
            77.5
        """
        mode = motion.mode_of(self.poles(*wall, **gains))
        frequency = mode.frequency / (2.0 * np.pi * self.sample_time)
        return motion.Oscillation(mode.damping_ratio, frequency)

    def _named(self, wall: tuple[Any, ...], gains: Mapping[str, Any]) -> dict[str, Any]:
        """Both gains by their names, in their order."""
        names = [gain.name for gain in self.gains]
        places = [*(names if self._by_place else ()), *["one without a name"] * len(wall)]
        given = [*zip(places, wall, strict=False), *gains.items()]
        if sorted(name for name, _ in given) != sorted(names):
            words = ", ".join(name for name, _ in given) or "none"
            raise TypeError(f"gains given: {words}; give both {names[0]} and {names[1]}.")
        return {name: dict(given)[name] for name in names}

    def _few(self, pair: Mapping[str, Any]) -> Float64[np.ndarray, "*grid 2"] | None:
        """Gains to be answered one by one; None for a grid."""
        if is_any_jax(self, *pair.values()) or self.shape:
            return None
        grid = wall_grid(**pair)
        return grid if 0 < grid.size <= 2 * _FEW or self._only_few else None

    def _on_grid(self, question: str, units: tuple[Array, Array], **options: Any) -> Any:
        """The answer of ``jaxstab.point`` to many gains, in units."""
        return _ON_GRIDS[question](*units, self._pairs, **options)

    def _codes(self, pair: Mapping[str, Any], **options: Any) -> Any:
        """Verdicts on many gains; UNDECIDED where float64, in units, changes the sign of p(1)."""
        units = self._in_units(*pair.values())
        codes = self._on_grid("verdict", units, **options)
        if self._only_few:  # JAX traces gains that are not those of the chart
            return codes
        (first, _), (alpha, _), (spring, gamma) = pair.values(), units, self._spring
        if not is_any_traced(first, alpha, spring):  # JAX would take tiny numbers for 0
            first, alpha, spring, gamma = map(np.asarray, (first, alpha, spring, gamma))
        xp = namespace(first, alpha, spring)
        is_lost = (first + spring > 0.0) != (alpha + gamma > 0.0)
        if xp is np and not np.any(is_lost):
            return codes
        return namespace(codes, is_lost).where(is_lost, np.int8(Verdict.UNDECIDED), codes)

    def _verdicts(self, grid: Float64[np.ndarray, "*grid 2"]) -> Any:
        codes = [self._verdict(*own) for own in grid.reshape(-1, 2).tolist()]
        return np.array(codes, np.int8).reshape(grid.shape[:-1])


def by_gain(answer: Any, name: str, values: Mapping[str, Any]) -> Any:
    """A value of an answer by a name that its gains give it; AttributeError for another name."""
    if name not in values:
        raise AttributeError(
            f"{type(answer).__name__} has no {name!r}; its gains give {', '.join(values)}."
        )
    return values[name]
