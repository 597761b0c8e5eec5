"""The haptic loop: one value in SI units, its answers as methods."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, overload

import numpy as np
from jaxtyping import Float64, Int8

from jaxstab import motion, point
from jaxstab.arrays import Array, Numbers, is_any_jax, is_any_traced, named, pytree
from jaxstab.boxes import HandRange, RobustLimit
from jaxstab.conventions import HORIZON, Excitation, Range, Verdict
from jaxstab.exact import StableLine, wall_verdict
from jaxstab.loop.answers import Answers
from jaxstab.loop.backwards import StableValues, range_of
from jaxstab.loop.hands import HandFamily, WorstHand
from jaxstab.loop.jitter import (
    Jitter,
    MovingLimits,
    WorstDelays,
    each_wall,
    jitter_margin,
    turn_of,
)
from jaxstab.loop.many import given_loops
from jaxstab.loop.margins import (
    FrequencyMargins,
    Margins,
    in_si_units,
    loop_margins,
    margins,
    wall_frequency_margins,
)
from jaxstab.loop.passive import passive_wall
from jaxstab.loop.region import (
    TOLERANCE,
    Gains,
    Limits,
    Region,
    Tuned,
    reached_interval,
    region_of_loop,
)
from jaxstab.loop.tune import optimal_wall
from jaxstab.loop.usable import UsableLimits
from jaxstab.model import LoopParameters, by_name, checked_gain
from jaxstab.model.affine import Chart, WallParts
from jaxstab.model.device.device import in_steps
from jaxstab.model.device.parts import FIRST_BITS, working_precision
from jaxstab.model.filters import given_filters
from jaxstab.model.gain import WALL
from jaxstab.model.linear_loop import LinearLoop
from jaxstab.model.loop import array_fields, refuse_arrays
from jaxstab.model.plant import wall_grid
from jaxstab.numbers import checked, checked_number, checked_word, require_together
from jaxstab.region.passive import PassiveRegion, passive_region_of


@pytree
@dataclass(frozen=True, kw_only=True, repr=False, eq=False)  # a mistake names this class
class HapticLoop(LoopParameters, Answers):
    """A haptic device held by a hand, and the sampled loop that renders a virtual wall on it.

    At every sample the wall's force is -(K P(z) + B V(z)) x: K times the position, filtered if
    there is a filter, and B times the estimated velocity. Methods about one wall (K, B):
    ``verdict``, ``spectral_radius``, ``poles``, ``margins``, ``settling_time``, ``oscillation``,
    ``amplitude``, ``frequency_margins``, ``simulate``; about all walls: ``region``,
    ``limits``, ``stiffness_limits``, ``damping_limits``, ``stiffness_intervals``,
    ``damping_intervals``, ``boundary``, ``boundary_distance``, ``tune``; about all hands of a
    range: ``worst_hand``, ``robust_limit``; about every hand: ``is_passive``, ``passive_region``;
    about forces that only push: ``one_sided``, ``one_sided_limit``; and ``range_of``,
    ``to_control``. Numbers are in SI units.

    Fields may be arrays that broadcast; the loop then stands for many loops. The methods from
    ``verdict`` to ``amplitude`` broadcast them with the walls, if the device is one mass and the
    sample time a single number wherever there is an estimator or filter. ``jaxstab.limits_of`` and
    ``regions_of`` accept any such loop; all other methods need a single one.

    A loop is a pytree: JAX traces its numbers, the cut-offs of filters among them, but not windows
    nor how many whole samples the delay has (``jax.grad(f)(loop).delay`` is the derivative by t_d).
    So a loop is made outside of jit, vmap and grad and given to the function as an argument, or
    made inside with a delay and a sample time that are concrete. Fields that are traced are not
    checked.

    The fields ``device_mass`` to ``hand_stiffness`` describe device and hand as one mass;
    ``device`` alone takes any linear system, with its hands; ``worst_hand`` and ``robust_limit``
    then put other hands in place of these. Regions, limits, tuning and motions need a device that
    moves under a constant force: one with zero DC gain, G(0) = 0, raises ValueError.

    Source, of all methods: eqs. (1)-(5), (9) and (12), Table I of Hulin, Preusche, Hirzinger
    (2008); all walls by the D-decomposition. Methods say what they add to it, and what they refuse
    beside the errors of ``jaxstab.conventions``.

    Args:
        sample_time: sampling period T in s, > 0.
        device_mass: effective mass of the device at the handle in kg, > 0.
        device_damping: physical damping of the device in N s/m, >= 0.
        hand_mass: mass of the hand and arm in kg, >= 0.
        hand_damping: damping of the hand in N s/m, >= 0.
        hand_stiffness: stiffness of the hand in N/m, >= 0.
        delay: time delay t_d of the loop in s, >= 0, in addition to the half sample of the hold.
        velocity: the controller's velocity estimator, windows in samples or s, cut-offs in
            Hz; None for the difference over one sample, the wall of the paper.
        position: the controller's position filter; None for no filter.
        device: any linear device, in place of the masses, dampings and stiffness above. A device
            that is one mass with hands rigidly attached gets the same answers, bit for bit.

    Raises:
        TypeError: a value is not a real number, or not of its class, or ``device`` is given as well
            as fields of device or hand.
        ValueError: a value is NaN, infinite or outside its range; a window is not a whole number of
            samples, or a filter is incompatible with the sampling period.

    Example:
        >>> loop = jaxstab.HapticLoop(
        ...     device_mass=0.25, device_damping=0.1, sample_time=1e-3, delay=1e-3,
        ...     velocity=jaxstab.Velocity.difference(window=0.02),
        ... )
        >>> int(loop.limits().stiffness), loop.verdict(5000.0, 30.0)
        (2034, <Verdict.UNSTABLE: 2>)
        >>> plain = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
        >>> plain.mass, plain.gamma, round(plain.delta, 9), plain.delay_samples
        (0.1, 0.0, 0.015, 0.0)
        >>> round(plain.alpha(2000.0), 9), plain.beta(20.0), round(plain.damping(0.2), 9)
        (0.02, 0.2, 20.0)
    """

    gains = WALL
    _by_place = has_delay = True

    def region(self, *, tolerance: float = TOLERANCE) -> Region:
        """The set of all stable walls, in its connected parts.

        It takes some hundredths of a second; half a second with a window of more than 100 samples,
        some ten seconds if the device also swings at half of the sampling rate, and minutes where
        float64 does not resolve the boundary: above degree 80 a UserWarning says so first.

        Args:
            tolerance: largest distance between the outline and the boundary, as a share of the
                region's diameter, > 1e-10. Everything else is measured on the exact boundary.

        Returns:
            Region of NumPy arrays, with its status.

        Raises: ValueError also for a delay longer than 500 samples and for a device with zero DC
        gain: the boundary is computed from 1/G(0) on. TypeError if JAX traces the loop; ``limits``
        and ``jaxstab.regions_of`` take it.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> loop.region().status.words
            'the boundary closes to loops'
        """
        if is_any_traced(self):
            raise TypeError(
                "the loop is traced; its region and distances to it are searched outside of jit, "
                "vmap and grad: call limits or jaxstab.regions_of, which JAX may trace."
            )
        tolerance = checked_number("tolerance", tolerance, 1e-10, is_open=True)
        return region_of_loop(self.in_floats(), tolerance)

    @overload  # type: ignore[override]  # delays are no margins
    def limits(self) -> Limits[float]: ...

    @overload
    def limits(self, *, delays: Range, lost: int = 0) -> MovingLimits: ...

    @overload
    def limits(self, **margins: Any) -> UsableLimits: ...

    def limits(
        self, *, delays: Range | None = None, lost: int = 0, **margins: Any
    ) -> Limits[float] | MovingLimits | UsableLimits:
        """The largest stiffness and the largest damping that the loop allows, of walls K, B >= 0.

        They hold for the stable component that contains small gains; the limits of islands, which
        are not connected to it, follow separately. For a loop that JAX traces, the limits are
        differentiable once in all numbers of the loop, and islands are left out.

        Args:
            delays: as for ``verdict``; the answer is then the stiffest wall, of those that a
                search tries, that is proved for every sequence of these delays.
            lost: as for ``verdict``.
            **margins: those of ``is_usable``, without ``delays``; the limits are then the largest
                gains with these margins that a search finds, and each pair is proved to have them.

        Raises: as ``region`` and ``verdict``; ValueError for margins as of ``is_usable``.

        Source: lemma J1 of docs/proofs.md for delays that move; E5 for margins.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> round(loop.limits().damping, 3)
            202.009
            >>> loop.limits(delays=(0.0, 0.2e-3)).stiffness < loop.limits().stiffness
            True
            >>> loop.limits(phase_margin=30)
            UsableLimits: a phase margin of 30 degrees
              largest stiffness = ... N/m at damping = ... N s/m
              largest damping = ... N s/m at stiffness = ... N/m
        """
        if margins and (delays is not None or lost):
            raise ValueError("margins are given beside delays that move; give one of them.")
        if margins:
            return self._usable_limits(margins)
        if delays is not None or lost:
            return self._moving(delays, lost).limits()
        if is_any_traced(self):
            from jaxstab.loop.implicit import moved  # which imports JAX

            return moved(*given_loops(self, {}), outlines=False).limits._replace(is_single=True)
        return self.region().limits()

    def stiffness_limits(self, damping: Numbers) -> Float64[Array, "*grid 2"]:
        """The smallest and the largest stable stiffness at given dampings in N s/m, any shape.

        One number is answered by proved lines of walls, mostly within two milliseconds. Arrays are
        answered by the region, and so is a number whose line has several intervals.

        Returns:
            Array (*grid, 2) in N/m, for the component that contains small gains if there is one.
            NaN where no stiffness is stable, and wherever a region is asked that is UNRESOLVED. Of
            several intervals it is the one that extends farthest. JAX arrays and tracers give
            differentiable JAX arrays.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> loop.stiffness_limits(20.0).round(1).tolist()
            [0.0, 35325.0]
        """
        found = self._reached("damping", damping)
        return self.region().reachable.stiffness_limits(damping) if found is None else found

    def damping_limits(self, stiffness: Numbers) -> Float64[Array, "*grid 2"]:
        """The smallest and the largest stable damping at given stiffnesses in N/m, any shape.

        Array (*grid, 2) in N s/m, otherwise as for ``stiffness_limits``.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> loop.damping_limits(20000.0).round(3).tolist()
            [9.457, 181.026]
        """
        found = self._reached("stiffness", stiffness)
        return self.region().reachable.damping_limits(stiffness) if found is None else found

    def _reached(self, gain: str, value: Numbers) -> Float64[np.ndarray, "2"] | None:
        is_one = isinstance(value, int | float | np.floating | np.integer)
        if not is_one or is_any_jax(self) or array_fields(self):
            return None
        checked_gain(gain, value)
        return reached_interval(self, gain, float(value))

    def stiffness_intervals(self, damping: float) -> StableLine:
        """All stable stiffnesses in N/m at a damping in N s/m: each interval, complete and proved.

        Each end has a bound of its error and the angle of the root that crosses the circle there.

        Raises: TypeError also for arrays, and if JAX traces the loop.

        Source: lemma E3 of docs/proofs.md.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> [(low.value, round(high.value, 1)) for low, high in
            ...     loop.stiffness_intervals(20.0).intervals]
            [(0.0, 35325.0)]
        """
        return self.intervals(damping=damping)

    def damping_intervals(self, stiffness: float) -> StableLine:
        """All stable dampings in N s/m at a stiffness in N/m; as ``stiffness_intervals``.

        Without stiffness a device that nothing holds keeps a root at 1 (``drift``): the intervals
        are those in which all others are stable.

        Raises: as ``stiffness_intervals``.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> [(round(low.value, 3), round(high.value, 3)) for low, high in
            ...     loop.damping_intervals(20000.0).intervals]
            [(9.457, 181.026)]
        """
        return self.intervals(stiffness=stiffness)

    def range_of(
        self,
        quantity: str,
        stiffness: float,
        damping: float,
        *,
        hands: HandRange | None = None,
        mass: Range | None = None,
        between: Range | None = None,
        count: int | None = None,
    ) -> StableValues:
        """The values of one quantity with which a wall is stable, such as the least mass.

        Each end is proved from both sides; that there is no other interval is a scan. It takes a
        second or two of CPU time, with ``hands`` ten and more, and minutes where many ends of a
        device with modes are not proved.

        Args:
            quantity: a field of the loop that is a number, or "cutoff" in Hz or "window" in samples
                of its velocity. The delay in s stays where it is "sample_time".
            stiffness, damping: see ``jaxstab.conventions``.
            hands: a range of hands, for all of which the wall shall be stable.
            mass: a range of the device's mass beside it.
            between: the lowest and the highest value to try; None chooses them.
            count: the number of values to try; None for 500, or 5,000 where they are tried at once.

        Raises: ValueError also for a quantity the loop does not have.

        Source: lemma E1 of docs/proofs.md.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> f"{1e3 * loop.range_of('delay', 1000.0, 10.0).largest:.6f} ms"
            '7.136955 ms'
        """
        wall = Gains(*map(checked_number, ("stiffness", "damping"), (stiffness, damping)))
        options: Any = {"hands": hands, "mass": mass, "between": between, "count": count}
        return range_of(self.in_floats(), quantity, wall, **options)

    def boundary_distance(self, stiffness: Numbers, damping: Numbers) -> Float64[Array, "*grid"]:
        """The distance of walls from the edge of the stable set, in the (alpha, beta) plane.

        Args and Raises: see ``jaxstab.conventions``.

        Returns:
            The Euclidean distance to the edge of the stable set in units of alpha and beta,
            positive for a stable wall. For an unstable wall it is negative, and its size is the
            distance to the nearest stable walls; places where a root crosses the circle while
            another one is outside do not count. It is -inf where no wall is stable and NaN if the
            loop's region is UNRESOLVED. JAX arrays and tracers of gains give JAX arrays,
            differentiable once in the gains.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> round(float(loop.boundary_distance(1000.0, 10.0)), 6)
            0.01
        """
        return self.region().distance(stiffness, damping)

    def tune(
        self,
        goal: Literal["radius", "settling"] = "settling",
        *,
        stiffness: float | None = None,
        level: float = 0.02,
        excitation: Excitation = "force",
        encoder: float | None = None,
        chatter: float | None = None,
        **margins: Any,
    ) -> Tuned:
        """The wall (K, B) that comes to rest fastest, or the best B for a given K.

        Walls have K >= 0 and B >= 0. Where a gain of ``jaxstab.minimize_radius`` is negative, as
        with stiff or strongly damped hands, the best wall often has K = 0 or B = 0.

        This is a search for one loop, without vmap or derivatives; ``jaxstab.minimize_radius`` has
        both over gamma and delta. The best gains for the radius are sensitive: next to a triple
        pole the radius grows with the cube root of a change, so gains of six digits may miss the
        smallest radius by 0.01. With an estimator, a filter or a device that is not one mass, the
        search covers the stable component that contains small gains; where small gains are not
        stable, it covers an island, and the status says so. It takes seconds of CPU time, with
        windows or delays of 100 samples some thirty. With such a device, a wall that keeps
        ringing within the band and decays sixteen times more slowly than the wall of the smallest
        radius does not count as settled.

        Args:
            goal: "radius", the smallest spectral radius, or "settling", the smallest settling time.
            stiffness: K in N/m if it is given; only the damping is then chosen.
            level: half width of the band of the settling time, between 0 and 1.
            excitation: of the settling time, see ``jaxstab.settling_samples``.
            encoder: resolution of the position in m, if it is known; see ``amplitude``.
            chatter: the limit on the motion that the encoder may cause, in m. Where the best wall
                exceeds it, the best wall on grids of walls that are proved to stay within this
                limit is returned.
            **margins: phase_margin, gain_margin, sensitivity and delay_margin, as for
                ``is_usable``. Where the best wall lacks them, it is the best one on grids of walls
                that have them, proved.

        Returns:
            Tuned: stiffness in N/m, damping in N s/m, spectral radius per sample with its
            bound, settling time in s (infinite without a stable wall), a TuningStatus, and a proved
            bound in m of the motion that the encoder causes.

        Raises: ValueError also for an unknown word. All are single numbers.

        Source: settling as in later papers of the same authors.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> print(f"settles in {1e3 * loop.tune().settling_time:.0f} ms")
            settles in 6 ms
            >>> best = loop.tune(phase_margin=60)
            >>> best.status.name, loop.is_usable(best.stiffness, best.damping, phase_margin=60)
            ('SCANNED', True)
        """
        wanted = self._wanted("tune", margins)
        return optimal_wall(self, goal, stiffness, level, excitation, encoder, chatter, wanted)

    def worst_hand(
        self,
        hands: HandRange,
        stiffness: float,
        damping: float,
        *,
        mass: Range | None = None,
        delay: Range | None = None,
        delays: Range | None = None,
        lost: int = 0,
    ) -> WorstHand:
        """The verdict on a wall for every hand of a range, and the worst of the sampled hands.

        Each hand, like the rest of the loop, is constant while the wall is touched; with ``delays``
        the delay may change from sample to sample.

        Args:
            hands: the range of hands, which replace the hand of the loop.
            stiffness, damping: see ``jaxstab.conventions``.
            mass: the device's lowest and highest mass in kg over its postures; None for its own.
            delay: the shortest and the longest constant delay in s; None for that of the loop.
            delays: as for ``verdict``; the radius is then that at the longest delay.
            lost: as for ``verdict``.

        Returns:
            WorstHand; UNDECIDED where sampled hands are stable, but others could not be proved. A
            ``device`` is proved if a mass is at its handle, a grip has a spring, and grip or hand a
            damper.

        Raises: ValueError also if a range is out of order, or a ``device`` has several hands, or no
        mass that could vary.

        Source: sec. VIII of Hulin, Preusche, Hirzinger (2008); lemmas B20 and J3 of
        docs/proofs.md.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> hands = jaxstab.HandRange(mass=(0.0, 1.0), stiffness=(0.0, 700.0))
            >>> loop.worst_hand(hands, 1000.0, 10.0).verdict.name
            'STABLE'
        """
        wall = (checked_number("stiffness", stiffness), checked_number("damping", damping))
        return HandFamily(self, hands, mass, delay, delays, lost).worst(*wall)

    def robust_limit(
        self,
        hands: HandRange,
        *,
        mass: Range | None = None,
        delay: Range | None = None,
        delays: Range | None = None,
        lost: int = 0,
    ) -> RobustLimit:
        """The largest stiffness, and its damping, that every hand of a range allows.

        The corners of the range, and the hands at which a proof failed, set the limit, by their
        exact regions: computed, not proved. The wall is proved; NaN where none was.

        Args:
            hands: the range of hands, which replace the hand of the loop.
            mass: the device's lowest and highest mass in kg over its postures; None for its own.
            delay: the shortest and the longest constant delay in s; None for that of the loop.
            delays: as for ``verdict``; the limit is then that of constant delays at both ends, and
                the wall is proved for every sequence of them.
            lost: as for ``verdict``.

        Raises:
            ValueError: a range is out of order; a ``device`` has several hands, or no such mass.

        Source: sec. VIII of Hulin, Preusche, Hirzinger (2008); eq. (9) for each hand.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> loop.robust_limit(jaxstab.HandRange(mass=(0.0, 1.0))).is_proved
            True
        """
        return HandFamily(self, hands, mass, delay, delays, lost).robust_limit()

    @overload  # type: ignore[override] # of gains by place
    def verdict(
        self,
        stiffness: float,
        damping: float,
        *,
        delays: Range | None = None,
        lost: int = 0,
        resolve: str | None = None,
    ) -> Verdict: ...
    @overload
    def verdict(
        self,
        stiffness: Numbers,
        damping: Numbers,
        *,
        delays: Range | None = None,
        lost: int = 0,
        resolve: str | None = None,
    ) -> Int8[Array, "*grid"]: ...
    def verdict(
        self,
        stiffness: Numbers,
        damping: Numbers,
        *,
        delays: Range | None = None,
        lost: int = 0,
        resolve: str | None = None,
    ) -> Verdict | Int8[Array, "*grid"]:
        """Prove whether walls are stable: all roots of p(z) inside the unit circle.

        With ``delays`` the delay of the loop may change from sample to sample. STABLE then means
        stable for every sequence of delays of the range, UNSTABLE that a motion grows with one of
        them, constant or in turn.

        Args:
            stiffness, damping: see ``jaxstab.conventions``.
            delays: the shortest and the longest delay in s, in place of the loop's; the newest
                sample that has arrived sets the force.
            lost: the number of samples in a row that may never arrive, with ``delays``.
            resolve: "exact" decides more of the walls next to the boundary; see
                ``jaxstab.verdict``.

        Returns:
            int8 array of the broadcast shape: Verdict.STABLE, UNSTABLE or UNDECIDED. The first two
            are proofs: of up to a hundred walls for the exact numbers of the loop's fields, of more
            for its dimensionless numbers, which carry a few roundings. The int8 of one wall prints
            its name.

        Raises: ValueError also for an unknown ``resolve``, a range of delays that is out of order
        or too long; TypeError if JAX traces a loop with ``delays``.

        Source: Schur-Cohn criterion (Jury 1964) for eq. (9) of Hulin, Preusche, Hirzinger (2008);
        the small-gain theorem (Kao, Lincoln 2004) for delays that move: lemmas J1 and V10
        of docs/proofs.md.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> loop.verdict(50000.0, 20.0)
            <Verdict.UNSTABLE: 2>
            >>> loop.verdict(20000.0, 60.0, delays=(0.0, 0.2e-3))
            <Verdict.STABLE: 1>
        """
        checked_word("resolve", resolve or "exact", ("exact",))
        if delays is not None or lost:
            return self._moving(delays, lost).verdict(stiffness, damping)
        pair = {"stiffness": stiffness, "damping": damping}
        grid = self._few(pair)
        codes = self._codes(pair, resolve=resolve) if grid is None else self._verdicts(grid)
        return named(codes, Verdict)

    def margins(self, stiffness: Numbers, damping: Numbers) -> Margins:
        """The changes of stiffness, damping and delay, each alone, up to the loss of stability.

        Args and Raises: see ``jaxstab.conventions``; TypeError also if JAX traces gains and the
        device is not one mass.

        Returns:
            Margins in N/m, N s/m and s, all proved; see ``jaxstab.margins``, for JAX too.

        Example:
            >>> loop = jaxstab.HapticLoop(
            ...     device_mass=0.1, device_damping=1.5, sample_time=1e-3, delay=1.5e-3
            ... )
            >>> float(loop.margins(300.0, 2.0).stiffness_gain)
            5.719...
        """
        if self.body is None or not (self.shape or is_any_jax(self, stiffness, damping)):
            grid, plain = wall_grid(stiffness=stiffness, damping=damping), self.in_floats()
            return loop_margins(plain, plain._verdicts(grid), grid)
        plant = self.gamma, self.delta, self.delay_samples  # a delay that is traced may be any
        found = margins(*self._in_units(stiffness, damping), **by_name(*plant) | self.filters)
        units = self.stiffness(1.0), self.damping(1.0), self.sample_time
        return in_si_units(found, *units)

    def is_passive(self, stiffness: float, damping: float) -> bool | None:
        """Whether no passive hand can draw energy from a wall, up to the device's own damper.

        Such a wall is stable with every hand that is passive itself, however stiff or light. A wall
        that is not passive may still be stable with all hands of a range: ``worst_hand``. One-sided
        or clipped walls, delays that move, friction and quantisation are not covered.

        Args:
            stiffness, damping: see ``jaxstab.conventions``.

        Returns:
            True or False, both proved; None where it is not told. Without ``device_damping`` no
            wall is passive but the one of no gains.

        Raises: ValueError also for a ``device`` other than one mass, and for filters that are not
        stable, or do not pass a constant position.

        Source: sec. VII of Hulin, Preusche, Hirzinger (2008); Colgate and Schenkel (1997) for the
        difference and whole delays; lemma C6 of docs/proofs.md.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
            >>> loop.is_passive(190.0, 0.0), loop.is_passive(210.0, 0.0)
            (True, False)
        """
        wall = passive_wall(self.in_floats())
        gains = checked_number("stiffness", stiffness), checked_number("damping", damping)
        return wall.is_passive(*gains)

    def passive_region(self, *, tolerance: float = 1e-4) -> PassiveRegion:
        """The set of all walls that are passive: ``is_passive``.

        Args:
            tolerance: how far the region may bulge beyond its outline, as a share of its size; at
                least 1e-8.

        Raises: as ``is_passive``.

        Source: as of ``is_passive``.

        Example:
            >>> loop = jaxstab.HapticLoop(
            ...     device_mass=0.25, device_damping=0.1, sample_time=1e-3, delay=1e-3,
            ...     velocity=jaxstab.Velocity.difference(window=0.02),
            ... )
            >>> region = loop.passive_region()
            >>> print("{:.1f} N/m at {:.3f} N s/m".format(*region.stiffest))
            67.1 N/m at 0.001 N s/m
        """
        tolerance = checked_number("tolerance", tolerance, 1e-8)
        return passive_region_of(passive_wall(self.in_floats()), tolerance)

    def jitter_margin(
        self,
        stiffness: Numbers,
        damping: Numbers,
        *,
        hands: HandRange | None = None,
        mass: Range | None = None,
    ) -> Float64[np.ndarray, "*grid"]:
        """The proved range, in s, by which the delay of each sample may exceed the loop's own.

        The delay may change from sample to sample between ``delay`` and ``delay`` plus the margin;
        the wall is stable for every such sequence. A lost sample counts as one sampling period.
        ``margins`` has the margin of a delay that is constant, which cannot be smaller.

        Args:
            stiffness, damping: see ``jaxstab.conventions``.
            hands: a range of hands, in place of the hand of the loop: for every one of them.
            mass: with ``hands``, as for ``worst_hand``.

        Raises: TypeError also if JAX traces the loop, or for a mass without hands; with hands as
        ``worst_hand``.

        Returns:
            The margins in s; 0 where nothing is proved, infinite without a wall on a stable device.

        Source: the small-gain theorem (Kao, Lincoln 2004); lemmas J1 and J3 of docs/proofs.md.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> constant = loop.margins(1000.0, 20.0).extra_delay
            >>> print(f"{1e3 * loop.jitter_margin(1000.0, 20.0):.2f} of {1e3 * constant:.2f} ms")
            4.21 of 5.76 ms
        """
        if hands is None:
            if mass is not None:
                raise TypeError(f"mass is {mass} without hands; give hands=jaxstab.HandRange().")
            return jitter_margin(self.in_floats(), stiffness, damping)
        with_hands = HandFamily(self, hands, mass, delays=(self.delay, self.delay))
        return each_wall(with_hands.jitter_margin, np.float64, stiffness, damping)

    def worst_delays(
        self, stiffness: float, damping: float, *, delays: Range, lost: int = 0
    ) -> WorstDelays:
        """Search for delays in turn that make the motion grow, and prove that it does.

        All short patterns of the shortest and the longest delay are tried, and the best changed
        delay by delay. That no other sequence is worse is not proved; ``verdict`` proves STABLE.

        Args and Raises: as ``verdict``; the gains are single numbers.

        Returns:
            WorstDelays, whose delays ``simulate`` takes.

        Source: the theorem of Floquet for a force that switches within a sampling period; lemma
        V10 of docs/proofs.md.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=0.05, sample_time=1e-3)
            >>> loop.worst_delays(6669.1, 71.60, delays=(0.0, 1e-3)).delays
            (0.0, 0.001, 0.001, 0.001)
        """
        return self._moving(delays, lost).worst_delays(stiffness, damping)

    def settling_time(
        self,
        stiffness: Numbers,
        damping: Numbers,
        *,
        level: float = 0.02,
        excitation: Excitation = "force",
        horizon: int = HORIZON,
    ) -> "motion.Settling":
        """The time in s until the position stays within a tolerance of its final value.

        It is ``jaxstab.settling_samples`` times the sample time; ``level``, ``excitation`` and
        ``horizon`` are explained there, the walls in ``jaxstab.conventions``. A count of samples
        jumps from number to number, so it has no useful derivative; that of ``spectral_radius``
        says how the decay changes. The hand pushes at the handle, behind the actuators of a device;
        the velocity of an impact is as ``initial_velocity`` of ``simulate``.

        Returns:
            Settling with ``value`` in s and ``status``, a SettlingStatus.

        Filters and the horizon must be concrete.

        Source: lemma E4 of docs/proofs.md.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> round(float(loop.settling_time(1000.0, 20.0).value), 3)
            0.069
        """
        self._refuse_tracers("settling_time")
        options: dict[str, Any] = {"level": level, "excitation": excitation, "horizon": horizon}
        if self.body is None:
            samples = motion.loop_settling_samples(self.in_floats(), stiffness, damping, **options)
        else:
            alpha, beta = self._in_units(stiffness, damping)
            samples = motion.settling_samples(alpha, beta, **self.slice, **options, **self.filters)
        return motion.SettlingTime(samples.value * self.sample_time, samples.status)

    def amplitude(
        self,
        stiffness: Numbers,
        damping: Numbers,
        *,
        encoder: Numbers = 0.0,
        force_step: Numbers = 0.0,
        friction: Numbers = 0.0,
        noise: Numbers = 0.0,
    ) -> "motion.Amplitude":
        """Bound the effect of a quantised encoder, a quantised force, friction and noise at walls.

        They bound the distance from the same loop without any of these at all times, and so the
        chatter that the hand feels in the long run; see ``jaxstab.amplitude``.

        Args:
            stiffness, damping: see ``jaxstab.conventions``.
            encoder: resolution of the position in m, which is rounded to the nearest multiple.
            force_step: resolution of the force in N, which is rounded to the nearest multiple.
            friction: largest Coulomb friction of the device in N, treated as any force at the
                handle that is never larger.
            noise: largest error of the position in m, in addition to that of the resolution.

        Returns:
            Amplitude in m, m/s and N; infinite where nothing is proved, as at the boundary of
            stability and beyond it.

        Raises: ValueError also if nothing disturbs the loop. Filters must be concrete.

        Source: the l1 norm of a linear system (Vidyasagar 1986) for the loop of eqs. (1)-(5);
        lemmas E4 and M9 of docs/proofs.md.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> amplitude = loop.amplitude(1000.0, 20.0, encoder=1e-5)
            >>> f"{amplitude.position:.1e} m, {amplitude.force:.2f} N"
            '6.3e-06 m, 0.24 N'
        """
        self._refuse_tracers("amplitude")
        sizes = {"encoder": encoder, "force_step": force_step, "friction": friction, "noise": noise}
        if self.body is None:
            return motion.loop_amplitude(self.in_floats(), stiffness, damping, sizes)
        unit = self.mass / self.sample_time**2  # N that are 1 where 1 m is
        sizes = {name: checked(name, size, 0.0) for name, size in sizes.items()}
        sizes |= {name: sizes[name] / unit for name in ("force_step", "friction")}
        alpha, beta = self._in_units(stiffness, damping)
        amplitude = motion.amplitude(alpha, beta, **self.slice, **sizes, **self.filters)
        return motion.WallAmplitude(
            amplitude.position, amplitude.velocity / self.sample_time, amplitude.force * unit,
            amplitude.force_per_count * unit, amplitude.status,
        )  # fmt: skip

    def simulate(
        self,
        stiffness: Numbers,
        damping: Numbers,
        *,
        samples: int = 200,
        force: Numbers = 0.0,
        initial_velocity: Numbers = 0.0,
        initial_position: Numbers = 0.0,
        between: int = 0,
        unilateral: bool = False,
        delays: Sequence[float] | np.ndarray | None = None,
    ) -> "motion.Response":
        """Simulate the device, held by the hand, against a virtual wall at position 0.

        Device and hand move in continuous time. At every sample the wall computes -K x - B v from
        the position x, filtered if there is a filter, and the estimated velocity v; this force
        begins to act after the delay and is held for one sample. Before time 0 the device was at
        rest where it starts, held there by the hand, and no force was on its way. A device in z
        moves from step to step, where the hand's force acts as the wall's does.

        Args:
            stiffness, damping: see ``jaxstab.conventions``.
            samples: the number of samples to simulate, from time 0 on.
            force: a step in N from time 0 on: the hand begins to push, at the handle.
            initial_velocity: in m/s at time 0, of device and hand as a whole: all masses move, and
                vibration modes are at rest. Where masses are not known (a transfer function, a
                state space, a structure fixed to the ground) a blow at the handle gave it this
                velocity.
            initial_position: in m at time 0, the penetration if positive.
            between: the number of equidistant points to return between two samples.
            unilateral: the wall pushes or pulls only while the sampled position is positive
                (Remark 1); otherwise it holds the device from both sides, as in the rest of the
                paper.
            delays: of the samples in s, repeated in turn, in place of the loop's delay; infinite
                for a sample that is lost. The newest sample that has arrived sets the force. For
                random delays draw them: ``np.random.default_rng(1).uniform(0.0, 1e-3, samples)``.

        Returns:
            Response at samples * (between + 1) times; exact up to rounding at each of them, and
            differentiable in all arrays.

        Raises: ValueError also if nothing moves the device, a count is too small, or a blow cannot
        set the device in motion.

        Source: eqs. (1)-(5) and Fig. 2 of Hulin, Preusche, Hirzinger (2008); Remark 1.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> response = loop.simulate(1000.0, 20.0, samples=100, initial_velocity=0.1)
            >>> f"{1e3 * response.position.max():.3f} mm deep"
            '0.372 mm deep'
        """
        self._refuse_tracers("simulate")
        refuse_arrays(self)
        turn = None
        if delays is not None:
            if is_any_traced(stiffness, damping, force, initial_velocity, initial_position):
                raise TypeError(
                    "a value is traced; with delays give numbers, outside of jit and grad."
                )
            turn = turn_of(self.in_floats(), delays)
        return motion.simulate(
            self, stiffness, damping, samples=samples, force=force,
            initial_velocity=initial_velocity, initial_position=initial_position,
            between=between, unilateral=unilateral, delays=turn,
        )  # fmt: skip

    def _frequency_margins(self, first: Numbers, second: Numbers) -> FrequencyMargins:
        return wall_frequency_margins(self.in_floats(), first, second)

    def _in_units(self, first: Numbers, second: Numbers) -> tuple[Array, Array]:
        require_together(**array_fields(self), stiffness=first, damping=second)
        if np.ndim(self.sample_time) and (self.velocity or self.position):
            refuse_arrays(self)  # windows and cut-offs would be arrays per sample
        alpha = self.alpha(checked_gain("stiffness", first))
        return alpha, self.beta(checked_gain("damping", second))

    @property
    def parts(self) -> WallParts:
        """The parts of p(z), in balls of the precision that is set.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> loop.parts.triple().degree
            3
        """
        return WallParts(self.in_floats())

    def _but_for_drift(self, first: float, second: float) -> Verdict | None:
        if first != 0.0:
            return None
        with working_precision(FIRST_BITS):
            drifts = self._triple().at(0.0, second).at_one > 0
        return wall_verdict(self._triple, 0.0, second, may_drift=True).verdict if drifts else None

    @property
    def _source(self) -> LoopParameters:
        return self

    @property
    def _chart(self) -> Chart:
        return Chart(WallParts(self))

    @property
    def _pairs(self) -> LinearLoop:
        return self.linear

    @property
    def _scale(self) -> tuple[float, float]:
        return self.stiffness(1.0), self.damping(1.0)

    @property
    def _spring(self) -> tuple[Numbers, Numbers]:
        return (self.body.stiffness, self.gamma) if self.body else (0.0, 0.0)

    @property
    def _linear_rule(self) -> tuple[float, float] | None:
        """None with an estimator, a filter or a mode: the rule is for none of them."""
        if self.body is None or given_filters(**self.filters):
            return None
        return float(self.body.damping), float(self.delay + 0.5 * self.sample_time)

    @property
    def _held(self) -> LoopParameters | None:
        plain = self.in_floats()
        return None if in_steps(plain.held_device) else plain

    def _on_grid(self, question: str, units: tuple[Array, Array], **options: Any) -> Any:
        if self.body is None:
            return super()._on_grid(question, units)
        return getattr(point, question)(*units, **self.slice, **options, **self.filters)

    def _moving(self, delays: Range | None, lost: int) -> Jitter:
        return Jitter.from_loop(self, delays, lost)

    def _refuse_tracers(self, method: str) -> None:
        """Refuse a loop that JAX traces: the method searches outside of JAX."""
        if is_any_traced(self):
            raise TypeError(
                f"{method} takes no loop that JAX traces: give one of concrete numbers, made "
                "outside of jit, vmap and grad."
            )
