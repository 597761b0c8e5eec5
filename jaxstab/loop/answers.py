"""Regions, limits, margins and pictures of all loops of two gains, as methods.

Each asks what the loop is (``loop.gains``) of the modules that know: its region and limits of
``loop.region``, its margins of ``loop.margins``, and pictures of ``jaxstab.drawing``.
"""

from abc import abstractmethod
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from jaxtyping import Float64

from jaxstab import exact
from jaxstab.arrays import Numbers
from jaxstab.drawing import draw_largest, draw_linear_rule, plot_open_loop, write_legend
from jaxstab.exact import StableLine
from jaxstab.loop.gains import TwoGains
from jaxstab.loop.margins import FrequencyMargins, Margins, loop_margins, wall_frequency_margins
from jaxstab.loop.one_sided import OneSided, one_sided, one_sided_limit
from jaxstab.loop.region import TOLERANCE, Limits, Region
from jaxstab.loop.usable import UsableLimits, judgement, usable_limits, usable_line
from jaxstab.loop.wanted import WantedMargins
from jaxstab.model.balls import Triple, rounded_triple
from jaxstab.model.gain import limit_text
from jaxstab.model.plant import checked_gain, wall_grid
from jaxstab.numbers import checked_number, checked_word
from jaxstab.region.stable_set import DIGITS

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class Answers(TwoGains):
    """A loop of two gains that answers about all of them."""

    @abstractmethod
    def region(self, *, tolerance: float = TOLERANCE) -> Region:
        """The set of all stable gains."""

    @overload
    def limits(self) -> Limits[float]: ...

    @overload
    def limits(self, **margins: Any) -> UsableLimits: ...

    def limits(self, **margins: Any) -> Limits[float] | UsableLimits:
        """The largest stable value of each gain, or the least, as of an admittance.

        They are read off the region: it is not proved that no stable gains were missed beyond.
        Printed, largest values are rounded down and least ones up, and each pair is stable.

        Args:
            **margins: those of ``is_usable``; the limits are then the largest gains with these
                margins that a search finds, and each pair is proved to have them.

        Raises: as ``region``; ValueError for margins as of ``is_usable``, and where gains move the
        leading coefficient of p(z).

        Example:
            >>> jaxstab.admittance(1e4, sample_time=1e-3, delay_samples=4).limits()
            Limits: the boundary closes to loops
              least    mass = 0.015851 kg at damping = 26.701 N s/m
              least    damping = 26.701 N s/m at mass = 0.015851 kg
              islands  none found
        """
        return self._usable_limits(margins) if margins else self.region().limits()

    def intervals(
        self,
        *,
        phase_margin: int | float | None = None,
        gain_margin: int | float | tuple[float, float] | None = None,
        sensitivity: int | float | None = None,
        delay_margin: int | float | None = None,
        **gain: float,
    ) -> StableLine:
        """All stable values of one gain at a value of the other: complete and proved.

        Each end has a bound of its error and the angle of the root that crosses the circle there.
        Without stiffness a device that nothing holds keeps a root at 1 (``drift``): the intervals
        are those in which all others are stable.

        With margins they are the intervals in which the loop has these: each is proved from end to
        end, less the errors of its ends; that there are no others is searched. Where a root stays
        at 1 there are none.

        Args:
            phase_margin: in degrees; this and the others as for ``is_usable``.
            gain_margin: a factor, or the least and the largest one.
            sensitivity: the largest peak of |S|.
            delay_margin: refused: it is not proved for whole intervals.
            **gain: the other gain, by its name.

        Raises: TypeError also unless one gain is given, for an array, and if JAX traces the loop;
        ValueError for margins as of ``is_usable``, and where gains move the leading coefficient of
        p(z).

        Source: lemma E3 of docs/proofs.md; with margins E7.

        Example:
            >>> loop = jaxstab.admittance(1e4, sample_time=1e-3, delay_samples=4)
            >>> line = loop.intervals(mass=2.0)
            >>> [(round(low.value, 9), high.value) for low, high in line.intervals]
            [(39.515919035, 3995.0)]
            >>> loop = jaxstab.simulated_pd(0.1, step=2e-3, substeps=4)
            >>> [(low.told, round(high.value, 6)) for low, high in
            ...     loop.intervals(kd=10.0, phase_margin=45).intervals]
            [(0.0, 437.241515)]
        """
        names = [each.name for each in self.gains]
        if len(gain) != 1 or not set(gain) <= set(names):
            given = ", ".join(gain) or "none"
            raise TypeError(f"gains given: {given}; give one of {names[0]} and {names[1]}.")
        ((name, value),) = gain.items()
        number = checked_number(name, value)
        wanted = WantedMargins.checked(phase_margin, gain_margin, sensitivity, delay_margin)
        if not wanted.texts:
            return self._row(name, number)
        return usable_line(self, *self._along(name, number), wanted)

    def boundary(self, *, tolerance: float = 1e-6) -> Float64[np.ndarray, "point 2"]:
        """The outline of the stable gains, loop after loop, each of them closed.

        It is the ``outline`` of ``region`` in the gains themselves: NaN or infinite where these
        are, as an admittance's endless mass.

        Args and Raises: as ``region``.

        Example:
            >>> robot = jaxstab.admittance(1e4, sample_time=1e-3, delay_samples=4)
            >>> mass, damping = robot.boundary().T
            >>> print(f"{mass[mass > 0].min():.4f} kg")
            0.0159 kg
        """
        outline = self.region(tolerance=tolerance).outline
        with np.errstate(all="ignore"):
            return np.stack(self._chart.gains(*outline.T), axis=-1)

    def margins(self, *wall: Numbers, **gains: Numbers) -> Margins:
        """Proved factors by which each gain, and both at once, may grow and shrink.

        A margin of the delay is that of a plant between samples, which a loop of given polynomials
        does not have: a wall on a held device has it.

        Args and Raises: as ``spectral_radius``; TypeError for JAX arrays.

        Source: lemma E3 of docs/proofs.md.

        Example:
            >>> loop = jaxstab.admittance(1e4, sample_time=1e-3, delay_samples=4)
            >>> loop.margins(mass=2.0, damping=50.0)
            Margins: stable  least   largest    factors
            mass (kg)        0.0275  unlimited  0.01375 to unlimited
            damping (N s/m)  39.516  3995       0.79032 to 79.9
            both                                0.78782 to unlimited
        """
        grid = wall_grid(**self._named(wall, gains))
        return loop_margins(self, self._verdicts(grid), grid)

    def frequency_margins(self, *wall: Numbers, **gains: Numbers) -> FrequencyMargins:
        """Gain, phase, delay and disk margin, and the peaks of |S| and |T|: proved.

        The loop is opened as by ``to_control``.

        Args and Raises: as ``spectral_radius``; TypeError also if JAX traces the loop or the gains.

        Returns:
            FrequencyMargins, each with the bound of its error and its frequency in Hz.

        Source: the criterion of Nyquist; lemma E5 of docs/proofs.md.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> phase = loop.frequency_margins(1000.0, 10.0).phase
            >>> print(f"{phase.value:.1f} degrees at {phase.frequency:.1f} Hz")
            52.9 degrees at 20.6 Hz
        """
        return self._frequency_margins(*self._named(wall, gains).values())

    def is_usable(
        self,
        *wall: float,
        phase_margin: int | float | None = None,
        gain_margin: int | float | tuple[float, float] | None = None,
        sensitivity: int | float | None = None,
        delay_margin: int | float | None = None,
        **gains: float,
    ) -> bool | None:
        """Whether a pair of gains is stable with margins: proved; None where it is not told.

        Args:
            *wall: that wall, K in N/m and B in N s/m.
            phase_margin: in degrees, above 0 and below 180: the loop stays stable with any lag or
                lead up to it.
            gain_margin: a factor above 1 by which the open loop may be multiplied; a pair such as
                (1/2, 2) for the least and the largest factor.
            sensitivity: the largest peak of |S|, above 1; 2 gives a gain margin of 2 and a phase
                margin of 29 degrees as well.
            delay_margin: by how much the delay may grow, in s.
            **gains: both gains of the pair, by their names.

        Raises: TypeError for a missing gain, ValueError for margins that make no sense, or if none
        is given.

        Source: the criterion of Nyquist; lemma E5 of docs/proofs.md.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> loop.is_usable(1000.0, 10.0, phase_margin=50)
            True
            >>> loop.is_usable(1000.0, 10.0, phase_margin=50, sensitivity=1.1)
            False
        """
        first, second = (
            checked_number(name, checked_gain(name, x))
            for name, x in self._named(wall, gains).items()
        )
        wanted = WantedMargins.checked(phase_margin, gain_margin, sensitivity, delay_margin)
        if not wanted.texts:
            raise ValueError(
                "no margin is given; give phase_margin, gain_margin, sensitivity or delay_margin, "
                "or ask verdict."
            )
        return judgement(self, (first, second), wanted).is_usable

    def one_sided(self, *wall: float, form: str = "force", **gains: float) -> OneSided:
        """Whether gains are proved to rest where their force only pushes, is clipped or hardens.

        The code computes the force -phi(y), y the linear one, such as max(0, y), max(0, y) that a
        motor clips, or a dead zone: phi is the same at all times and rises by at most 1 per 1.
        Proved, every start and every constant push of the hand end at the one place where forces
        balance; friction, encoder steps, jitter and delays that move aside. A wall that acts where
        the position is positive is none of these if it has a damper: gate by the force.

        Args:
            *wall: that wall, K in N/m and B in N s/m.
            form: "force" for phi(K x + B v), "spring" for phi(K x) beside a damper that is always
                on; so with the two gains of any loop.
            **gains: both gains of the pair, by their names.

        Returns:
            A proof, or that there is none: which does not say that the loop swings.

        Raises: as ``is_usable``; ValueError also where the device keeps a root on the circle
        without the force, as one that no spring holds, where the gains move the leading coefficient
        of p(z), and, with "force", where they have delays of their own.

        Source: Zames and Falb (1968), SIAM J. Control 6(1); lemma C7 of docs/proofs.md.

        Example:
            >>> loop = jaxstab.HapticLoop(
            ...     device_mass=0.25, device_damping=0.1, hand_stiffness=1.0, sample_time=1e-3,
            ...     delay=1e-3, velocity=jaxstab.Velocity.difference(window=0.02),
            ... )
            >>> bool(loop.one_sided(1900.0, 12.0)), bool(loop.one_sided(2100.0, 12.0))
            (True, False)
        """
        first, second = (checked_number(*gain) for gain in self._named(wall, gains).items())
        return one_sided(self, (first, second), form)

    def one_sided_limit(
        self, *, form: str = "force", ratio: float | None = None, **gain: float
    ) -> OneSided:
        """The largest first gain, such as K, that is proved as by ``one_sided``, with all below.

        It is searched up to the limit of the linear loop, and what is found is proved: along a ray
        all shares of both gains, in a row every first gain from 0 to it beside the second one.

        Args:
            form: as for ``one_sided``.
            ratio: the second gain over the first one, in s for a wall: a ray, with "force" alone.
            **gain: the second gain, by its name: a row. 0 for a spring alone.

        Raises: as ``one_sided``; TypeError unless one of ratio and the second gain is given.

        Source: as of ``one_sided``.

        Example:
            >>> loop = jaxstab.HapticLoop(
            ...     device_mass=0.25, device_damping=0.1, hand_stiffness=100.0, sample_time=1e-3,
            ...     delay=1e-3, velocity=jaxstab.Velocity.difference(5),
            ... )
            >>> print(f"{loop.one_sided_limit(ratio=5e-3).stiffness:.1f}")
            10911.5
        """
        return one_sided_limit(self, form, ratio, gain)

    def _usable_limits(self, margins: Mapping[str, Any]) -> UsableLimits:
        return usable_limits(self, self._wanted("limits", margins))

    def _wanted(self, function: str, margins: Mapping[str, Any]) -> WantedMargins:
        """The margins that a function is given."""
        if unknown := [name for name in margins if name not in WantedMargins._fields]:
            names = ", ".join(WantedMargins._fields)
            raise TypeError(f"{function} takes no {unknown[0]}; give {names}.")
        return WantedMargins.checked(**margins)

    def plot(
        self,
        kind: str = "region",
        *wall: float,
        ax: "Axes | None" = None,
        **gains: float,
    ) -> "Axes":
        """Draw the stable gains, or the open loop of one pair of gains over frequency.

        Args:
            kind: "region" for the stable gains, the largest of them, islands and, if it applies,
                the linear rule; "nyquist" and "bode" for the open loop of one pair.
            *wall: that wall, K in N/m and B in N s/m.
            ax: the axes of matplotlib to draw in; None makes a figure with matplotlib.pyplot.
            **gains: both gains of that pair, by their names.

        Raises:
            ValueError: no gains are stable, or the region is unresolved, or the kind is none.
            TypeError: JAX traces the loop, or a gain is missing, or one too many.

        Source: sec. V and VI of Hulin, Preusche, Hirzinger (2008); the criterion of Nyquist.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> loop.plot().get_xlabel(), loop.plot("nyquist", 1000.0, 10.0).get_xlabel()
            ('stiffness K (N/m)', 'Re L')
            >>> loop = jaxstab.simulated_pd(0.1, step=2e-3)
            >>> loop.plot().get_xlabel(), loop.plot("bode", kp=1000.0, kd=20.0).get_xlabel()
            ('kp (N m/rad)', 'frequency (Hz)')
        """
        checked_word("kind", kind, ("region", "nyquist", "bode"))
        if kind == "region":
            if wall or gains:
                raise TypeError('gains are given beside kind "region", which is of all gains.')
            return self._plot_region(ax)
        pair = [checked_number(*gain) for gain in self._named(wall, gains).items()]
        response = partial(exact.frequency_response, partial(self._opened, *pair))
        margins = self._frequency_margins(*pair)
        return plot_open_loop(kind, margins, response, float(self.sample_time), ax)

    def _plot_region(self, ax: "Axes | None") -> "Axes":
        region = self.region()
        panel = region.plot(ax)
        largest = region.reachable._printed[0]
        if np.dot(self._chart.shares, largest) < 1.0:
            first, second = region.names
            text = limit_text(first, largest[0], second, largest[1], DIGITS)
            draw_largest(panel, largest, f"{first.word or first.sense}: {text}")
        draw_linear_rule(panel, self._linear_rule)
        write_legend(panel)
        return panel

    def to_control(self, *wall: float, **gains: float) -> Any:
        """The open loop L(z) = (a S + b R)/base as a transfer function of python-control.

        Of a wall it is G(z) (K P(z) + B V(z)), with device, hold and delay in G; of PID control all
        three gains are in it, the given one as well. Closed with a feedback of -1 it has the poles
        of the loop, and its frequency response shows the margins in a Nyquist plot. Where the gains
        move the leading coefficient of p(z), the parts are those of p over it, by the
        ``coordinates``: an admittance is opened at its acceleration.

        Args and Raises: as ``spectral_radius``; ImportError without python-control. The gains are
        single numbers.

        Returns:
            ``control.TransferFunction`` with dt, the sample time; coefficients rounded to float64.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)
            >>> loop.to_control(1000.0, 10.0).dt  # doctest: +SKIP
        """
        pair = self._named(wall, gains)
        first, second = (checked_number(name, checked_gain(name, x)) for name, x in pair.items())
        try:
            from control import TransferFunction
        except ImportError as error:
            raise ImportError(
                "python-control is not installed; pip install 'jaxstab[control]'."
            ) from error

        def opened() -> Triple:
            below, above = self._opened(first, second)
            return Triple.from_parts(below, above, above.scaled(0)).monic()

        loop = rounded_triple(opened, 1.0, 1.0)
        above, below = ([float(c.rounded()) for c in side] for side in (loop.stiffness, loop.base))
        if not np.all(np.isfinite(above)):
            words = " and ".join(f"{name} is {number:g}" for name, number in pair.items())
            raise ValueError(f"{words}, where p(z) loses its highest power; give other gains.")
        return TransferFunction(above, below, dt=float(self.sample_time))

    def _frequency_margins(self, first: Numbers, second: Numbers) -> FrequencyMargins:
        return wall_frequency_margins(self, first, second)
