"""The haptic loop: one value in SI units, its answers as methods."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from jaxtyping import Float64

from jaxstab import ranges
from jaxstab.arrays import Array, Numbers, is_any_traced, pytree
from jaxstab.loop.region import (
    TOLERANCE,
    WallLimits,
    WallRegion,
    traced_region,
    wall_region,
)
from jaxstab.loop.tune import OptimalWall, checked_chatter, optimal_wall
from jaxstab.loop.walls import LoopWithWalls
from jaxstab.motion.settling import Excitation
from jaxstab.numbers import checked_number
from jaxstab.ranges import HandRange, RobustLimit, WorstHand
from jaxstab.ranges.hands import Range

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@pytree
@dataclass(frozen=True, kw_only=True, repr=False, eq=False)  # a mistake names this class
class HapticLoop(LoopWithWalls):
    """A haptic device held by a hand, and the sampled loop that renders a virtual wall on it.

    At every sample the wall's force is -(K P(z) + B V(z)) x: K times the position, filtered if
    there is a filter, and B times the estimated velocity. The loop answers questions by methods:
    about a wall (K, B) ``verdict``, ``is_stable``, ``spectral_radius``, ``poles``, ``margins``,
    ``settling_time``, ``oscillation``, ``simulate``; about all walls ``region``, ``limits``,
    ``stiffness_limits``, ``damping_limits``, ``boundary_distance``, ``tune``; about all hands
    ``worst_hand``, ``robust_limit``; and ``to_control``. Numbers are finite and in SI units.

    A loop is a pytree: JAX traces its numbers, the cut-offs of filters among them, but not windows
    nor how many whole samples the delay has (``jax.grad(f)(loop).delay`` is the derivative by t_d).
    So a loop is made outside of jit, vmap and grad and given to the function as an argument, or
    made inside with a delay and a sample time that are concrete. Fields that are traced are not
    checked.

    The fields ``device_mass`` to ``hand_stiffness`` describe device and hand as one mass;
    ``device`` alone takes any linear system, with its hands. With a ``device``, ``worst_hand`` and
    ``robust_limit`` put other hands in place of its own; ask ``jaxstab.LoopsBetween`` about other
    intervals, ``jaxstab.common_region`` about lists of loops. A device that does not give way to a
    constant force, G(0) = 0, has only verdicts, radii, poles and margins.

    Source: eqs. (1) and (12), Table I.

    Args:
        sample_time: sampling period T in s, > 0.
        device_mass: effective mass of the device at the handle in kg, > 0.
        device_damping: physical damping of the device in N s/m, >= 0.
        hand_mass: mass of the hand and arm in kg, >= 0.
        hand_damping: damping of the hand in N s/m, >= 0.
        hand_stiffness: stiffness of the hand in N/m, >= 0.
        delay: time delay t_d of the loop in s, >= 0, beside the half sample of the hold.
        velocity: how the controller estimates the velocity, windows in samples or s, cut-offs in
            Hz; None for the difference over one sample, the wall of the paper.
        position: how the controller filters the position; None for no filter.
        device: any linear device, in place of the masses, dampings and stiffness above. A device
            that is one mass with hands glued to it gets the same answers, bit for bit.

    Raises:
        TypeError: a value is not a real number, or not of its class, or ``device`` is given beside
            fields of device or hand.
        ValueError: a value is NaN, infinite or outside its range; a window is no whole number of
            samples, or a filter does not go with the sampling period.

    Example:
        >>> loop = jaxstab.HapticLoop(
        ...     device_mass=0.25, device_damping=0.1, sample_time=1e-3, delay=1e-3,
        ...     velocity=jaxstab.Velocity.difference(window=0.02),
        ... )
        >>> round(loop.limits().stiffness)
        2035
    """

    def region(self, *, tolerance: float = TOLERANCE) -> WallRegion:
        """Return the set of all stable walls, in its connected parts.

        Args:
            tolerance: largest distance between the outline and the boundary, as a share of the
                region's diameter, > 1e-10. Everything else is measured on the exact boundary.

        Returns:
            WallRegion of NumPy arrays, with its status. A loop that JAX traces, without estimator
            and filter, is answered by ``jaxstab.region_outline``.

        Raises:
            ValueError: the dimensionless parameters are out of range, the delay is longer than 500
                samples, or the device does not give way to a constant force, G(0) = 0: the
                boundary is computed from 1/G(0) on.
            TypeError: JAX traces a loop with an estimator or a filter; ``limits`` takes it.

        Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) by the D-decomposition; see
        ``jaxstab.stable_region``.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> loop.region().status.words
            'the boundary closes to loops'
        """
        if is_any_traced(self):
            return traced_region(self)
        return wall_region(self.in_floats(), tolerance)

    def limits(self) -> WallLimits:
        """Return the largest stiffness and the largest damping that the loop allows.

        They hold for the walls that are reached by turning gains up from 0; the limits of islands,
        which are not reached so, follow separately. For a loop that JAX traces, the limits are
        differentiable once in all numbers of the loop, and islands are left out.

        Raises:
            ValueError: as ``region``.

        Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) by the D-decomposition.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> round(loop.limits().damping, 3)
            202.009
        """
        if is_any_traced(self):
            from jaxstab.loop.moving import moving_limits

            return moving_limits(self)
        return self.region().limits()

    def stiffness_limits(self, damping: Numbers) -> Float64[Array, "*grid 2"]:
        """Return the smallest and the largest stable stiffness at given dampings.

        Args:
            damping: B in N s/m, any shape.

        Returns:
            Array (*grid, 2) in N/m, for the walls reached by turning gains up from 0 if there are
            any. NaN where no stiffness is stable, and everywhere if the loop's region is
            UNRESOLVED. Of several intervals the one that reaches farthest is given. JAX arrays and
            tracers give differentiable JAX arrays.

        Raises:
            ValueError: a damping is infinite or NaN, or a parameter of the loop is out of range.
            RuntimeError: JAX arrays are given without x64.

        Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) by the D-decomposition.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> loop.stiffness_limits(20.0).round(1).tolist()
            [0.0, 35325.0]
        """
        return self._reachable().stiffness_limits(damping)

    def damping_limits(self, stiffness: Numbers) -> Float64[Array, "*grid 2"]:
        """Return the smallest and the largest stable damping at given stiffnesses.

        Args:
            stiffness: K in N/m, any shape.

        Returns:
            Array (*grid, 2) in N s/m, otherwise as for ``stiffness_limits``.

        Raises:
            ValueError: a stiffness is infinite or NaN, or a parameter of the loop is out of range.
            RuntimeError: JAX arrays are given without x64.

        Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) by the D-decomposition.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> loop.damping_limits(20000.0).round(3).tolist()
            [9.457, 181.026]
        """
        return self._reachable().damping_limits(stiffness)

    def boundary_distance(self, stiffness: Numbers, damping: Numbers) -> Float64[Array, "*grid"]:
        """Return how far walls are from the edge of the stable set, in the (alpha, beta) plane.

        Args:
            stiffness: K in N/m, any shape; broadcasts with the damping.
            damping: B in N s/m.

        Returns:
            The Euclidean distance to the edge of the stable set in units of alpha and beta,
            positive for a stable wall. For an unstable wall it is negative, and its size is the
            distance to the nearest stable walls; places where a root crosses the circle while
            another one is outside do not count. It is -inf where no wall is stable and NaN if the
            loop's region is UNRESOLVED. JAX arrays and tracers of gains give JAX arrays,
            differentiable once in the gains.

        Raises:
            ValueError: a gain is infinite or NaN, or a parameter of the loop is out of range.
            RuntimeError: JAX arrays are given without x64.

        Source: eq. (9) of Hulin, Preusche, Hirzinger (2008) by the D-decomposition.

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
    ) -> OptimalWall:
        """Return the wall (K, B) that comes to rest fastest, or the best B for a given K.

        This is a search for one loop, without vmap or derivatives; ``jaxstab.minimize_radius`` has
        both over gamma and delta. The best gains for the radius are sensitive: next to a triple
        pole the radius grows with the cube root of a change, so gains of six digits may miss the
        smallest radius by 0.01. With an estimator, a filter or a device that is not one mass, the
        search covers the walls reached by turning gains up from 0; where small gains are not
        stable, it covers an island, and the status says so. With such a device, a wall that keeps
        ringing within the band and decays sixteen times more slowly than the wall of the smallest
        radius does not count as settled.

        Args:
            goal: "radius", the smallest spectral radius, or "settling", the smallest settling time.
            stiffness: K in N/m if it is given; only the damping is then chosen.
            level: half width of the band of the settling time, between 0 and 1.
            excitation: what the settling time refers to, see ``jaxstab.settling_samples``.
            encoder: resolution of the position in m, if it is known; see ``amplitude``.
            chatter: how far the encoder may drive the position, in m. Where it would drive the best
                wall further, the best wall on grids of walls that are proved to stay within this
                limit is returned.

        Returns:
            OptimalWall: stiffness in N/m, damping in N s/m, spectral radius per sample with its
            bound, settling time in s (infinite without a stable wall), a TuningStatus, and how far
            in m the encoder can drive the position, proved.

        Raises:
            ValueError: an argument is outside its range, infinite or NaN, or an unknown word, or
                the device does not give way to a constant force.
            TypeError: an argument is not one number.
            RuntimeError: JAX arrays are given without x64.

        Source: eq. (9); settling as in later papers of the same authors.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> best = loop.tune()
            >>> print(f"settles in {1e3 * best.settling_time:.0f} ms")
            settles in 6 ms
        """
        self._refuse_tracers("tune")
        disturbed = checked_chatter(encoder, chatter)
        return optimal_wall(self, goal, stiffness, level, excitation, disturbed)

    def worst_hand(
        self,
        hands: HandRange,
        stiffness: float,
        damping: float,
        *,
        mass: Range | None = None,
    ) -> WorstHand:
        """Return whether a wall is stable for every hand of a range, and the worst of them.

        Each hand, like the rest of the loop, is constant while the wall is touched.

        Args:
            hands: the range of hands, which replace the hand of the loop.
            stiffness: K in N/m.
            damping: B in N s/m.
            mass: the device's lowest and highest mass in kg over its postures; None for its own.

        Returns:
            WorstHand; UNDECIDED where sampled hands are stable, but others could not be proved. A
            ``device`` is proved if it is a mass with or without modes and actuators, a grip has a
            spring, and grip or hand a damper; any other one if a single number varies.

        Raises:
            TypeError: a gain is not one real number.
            ValueError: a gain is infinite or NaN, or a range is out of order; a ``device`` has
                several hands, or no mass that could vary.

        Source: sec. VIII of Hulin, Preusche, Hirzinger (2008); lemmas B6, B21 of docs/proofs.md.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> hands = jaxstab.HandRange(mass=(0.0, 1.0), stiffness=(0.0, 700.0))
            >>> loop.worst_hand(hands, 1000.0, 10.0).verdict.name
            'STABLE'
        """
        self._refuse_tracers("worst_hand")
        if self.device is not None:
            from jaxstab.loop.other_hands import LoopsWithHands

            wall = (checked_number("stiffness", stiffness), checked_number("damping", damping))
            return LoopsWithHands(self, self.device, hands, mass).worst(*wall)
        return ranges.worst_hand(self, hands, stiffness, damping, mass)

    def robust_limit(self, hands: HandRange, *, mass: Range | None = None) -> RobustLimit:
        """Return the largest stiffness, and its damping, that every hand of a range allows.

        The corners of the range, and the hands at which a proof failed, set the limit. With a
        ``device`` it is that of their exact regions: computed, and no proof.

        Args:
            hands: the range of hands, which replace the hand of the loop.
            mass: the device's lowest and highest mass in kg over its postures; None for its own.

        Raises:
            ValueError: a range is out of order; a ``device`` has several hands, or no such mass.

        Source: sec. VIII of Hulin, Preusche, Hirzinger (2008); eq. (9) for each hand.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> loop.robust_limit(jaxstab.HandRange(mass=(0.0, 1.0))).is_proved
            True
        """
        self._refuse_tracers("robust_limit")
        if self.device is not None:
            from jaxstab.loop.other_hands import LoopsWithHands

            return LoopsWithHands(self, self.device, hands, mass).robust_limit()
        return ranges.robust_limit(self, hands, mass)

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Draw the stable walls, the stiffest of them, islands and, if it applies, the linear rule.

        Args:
            ax: the axes of matplotlib to draw in; None makes a figure with matplotlib.pyplot.

        Returns:
            The axes, K in N/m and B in N s/m.

        Raises:
            ValueError: no wall is stable, or the region is unresolved.
            TypeError: JAX traces the loop.

        Source: sec. V and VI of Hulin, Preusche, Hirzinger (2008).

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> loop.plot().get_xlabel()
            'stiffness K (N/m)'
        """
        self._refuse_tracers("plot")
        from jaxstab.pictures.shown import plot_loop

        return plot_loop(self, ax)

    def to_control(self, stiffness: float, damping: float) -> Any:
        """Return the open loop of a wall as a transfer function in z of python-control.

        It is G(z) (K P(z) + B V(z)), with device, hold and delay in G: closed with a feedback of -1
        it has the poles of the loop, and its frequency response shows the margins in a Nyquist
        plot.

        Args:
            stiffness: K in N/m.
            damping: B in N s/m.

        Returns:
            ``control.TransferFunction`` with dt = T; coefficients rounded to float64.

        Raises:
            ImportError: python-control is not installed.
            TypeError: a gain is not one real number, or JAX traces the loop.
            ValueError: a gain is infinite or NaN.

        Source: eq. (9) of Hulin, Preusche, Hirzinger (2008), before the loop is closed.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> loop.to_control(1000.0, 10.0).dt  # doctest: +SKIP
        """
        self._refuse_tracers("to_control")
        try:
            from control import TransferFunction
        except ImportError as error:
            raise ImportError(
                "python-control is not installed; pip install 'jaxstab[control]'."
            ) from error
        alpha = self.alpha(checked_number("stiffness", stiffness))
        beta = self.beta(checked_number("damping", damping))
        loop = self.linear
        columns = zip(loop.stiffness, loop.damping, strict=True)
        above = [float((one * alpha + other * beta).rounded()) for one, other in columns]
        below = [float(one.rounded()) for one in loop.base]
        return TransferFunction(above, below, dt=float(self.sample_time))

    def _reachable(self) -> WallRegion:
        region = self.region()
        return region if is_any_traced(self) else region.main or region
