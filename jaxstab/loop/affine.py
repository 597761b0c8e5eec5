"""Any sampled loop that is affine in two gains, its answers named by the gains, and its doors.

What it shares with walls stands in ``loop.gains`` and ``loop.answers``.

Coefficients that are exact numbers have one more proof: where some roots have the product 1 for
all gains, as without damping, no precision of balls decides, and fractions do.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property, partial, wraps
from inspect import signature
from math import inf
from typing import Any, ParamSpec

import numpy as np
from jaxtyping import Float64

from jaxstab.arrays import Array, Numbers, float_arrays, namespace, repeat_and_keep
from jaxstab.conventions import HORIZON, Range, Verdict
from jaxstab.exact.response import motion_settled_after
from jaxstab.loop.answers import Answers
from jaxstab.loop.backwards import StableValues, range_of_number
from jaxstab.loop.margins import stable_pairs
from jaxstab.loop.region import TOLERANCE, Gains, Region, Tuned, region_of_loop
from jaxstab.model import LoopParameters
from jaxstab.model.affine import (
    RULES,
    AdmittanceParts,
    AffineParts,
    Chart,
    Coefficient,
    CouplingParts,
    GivenParts,
    PidParts,
    SimulatedParts,
    affine_triple,
    chart_of,
)
from jaxstab.model.balls import rounded_triple
from jaxstab.model.device.device import Device, in_steps
from jaxstab.model.device.parts import working_precision
from jaxstab.model.filters import Filter, Velocity, filter_on
from jaxstab.model.gain import Gain
from jaxstab.model.linear_loop import LinearLoop
from jaxstab.model.plant import LONGEST_DELAY, checked_gain, wall_grid
from jaxstab.motion.bounds import SettlingTime, checked_level, settled_answer
from jaxstab.numbers import (
    checked_count,
    checked_number,
    checked_word,
    has_shape,
    require_kind,
    require_together,
)
from jaxstab.shown import shortened
from jaxstab.tuning import TuningStatus, Walls, family_of_loop, smallest_radius

Given = ParamSpec("Given")


@dataclass(frozen=True, repr=False)
class Loop(Answers):
    """A sampled loop whose characteristic polynomial is affine in two gains.

    p(z) = base + a S + b R, with any polynomials. Make one with ``from_coefficients``, or by
    ``jaxstab.simulated_pd`` (PD control in a simulator), ``jaxstab.admittance`` (a robot that moves
    like a mass and a damper), ``jaxstab.pid`` (two gains of PID on a held device) and
    ``jaxstab.coupling`` (a spring and a damper between two devices). A wall on a held device is
    ``jaxstab.HapticLoop``. Gains are given by their names.

    Source, of all methods: eq. (9) of Hulin, Preusche, Hirzinger (2008) is affine in alpha and
    beta; all that follows from that, as its D-decomposition, holds for any two gains. Lemmas E1 to
    E3 of docs/proofs.md.

    Attributes:
        gains: names, units, and whether the largest or the least value is looked for.
        sample_time: of the controller in s.

    Example:
        >>> loop = jaxstab.simulated_pd(0.1, step=2e-3, substeps=4)
        >>> loop
        Loop of (kp, kd): PD of a simulated joint (semi-implicit), outside of it, every 4 steps
        >>> [gain.name for gain in loop.coordinates]
        ['kp', 'kd']
        >>> line = loop.intervals(kd=10.0)
        >>> [(low.value, round(high.value, 6)) for low, high in line.intervals]
        [(0.0, 3333.333333)]
    """

    parts: AffineParts = field(repr=False)
    gains: tuple[Gain, Gain]
    sample_time: float
    words: str = "a loop"
    bounded: tuple[Gain, Gain] | None = field(default=None, repr=False)
    made: Any = field(default=None, repr=False, compare=False)  # the call of its door

    @classmethod
    def from_coefficients(
        cls,
        *,
        base: Sequence[Coefficient],
        first: Sequence[Coefficient],
        second: Sequence[Coefficient],
        sample_time: float,
        gains: tuple[str, str] = ("a", "b"),
        units: tuple[str, str] = ("", ""),
    ) -> "Loop":
        """A loop with p(z) = base + a first + b second, the highest power of z first.

        Args:
            base: its coefficients: float64 and fractions are taken as exact, a pair (low, high) is
                an interval; the answers then hold for all of its numbers.
            first: those of S, which a multiplies.
            second: those of R, which b multiplies.
            sample_time: in s.
            gains: the names of a and b.
            units: of a and b.

        Raises: TypeError for what is not a number, ValueError for one that is not finite, parts
        without any coefficient but 0, and names that are not two different identifiers.

        Example:
            >>> double = jaxstab.Loop.from_coefficients(
            ...     base=[1, -2, 1], first=[1, 0], second=[1, -1],
            ...     sample_time=1.0, gains=("kp", "kd"),
            ... )
            >>> double.verdict(kp=1.0, kd=1.0)
            <Verdict.STABLE: 1>
        """
        checked = []
        for name, side in (("base", base), ("first", first), ("second", second)):
            if not isinstance(side, Sequence | np.ndarray):
                raise TypeError(f"{name} is {shortened(side)}; give a list of coefficients.")
            checked.append(tuple(_coefficient(f"{name}[{k}]", c) for k, c in enumerate(side)))
            if not any(c != 0 and c != (0, 0) for c in checked[-1]):
                raise ValueError(f"{name} is 0; give a polynomial with a coefficient that is not.")
        given: Any = gains
        names = tuple(map(str, given)) if isinstance(given, Sequence) else ()
        if not len(set(names)) == len(names) == 2 or not all(name.isidentifier() for name in names):
            raise ValueError(
                f'gains is {shortened(gains)}; give two different names such as ("kp", "kd").'
            )
        period = checked_number("sample_time", sample_time, 0.0, is_open=True, unit="s")
        if not has_shape(units, 2):
            raise ValueError(f'units is {shortened(units)}; give two, such as ("N/m", "N s/m").')
        named_gains = Gain(gains[0], units[0]), Gain(gains[1], units[1])
        return cls(GivenParts(*checked), named_gains, period, "given polynomials")

    def __repr__(self) -> str:
        names = ", ".join(gain.name for gain in self.gains)
        return f"Loop of ({names}): {self.words}"

    def range_of(
        self, quantity: str, *, between: Range | None = None, count: int = 500, **gains: float
    ) -> StableValues:
        """The values of one number of the loop with which gains are stable.

        It is an argument of the function that made the loop, such as "inertia", "environment" or,
        of PID, "delay", scanned from 1e-4 to 1e4 times what it is now; what is 0 now, from 0 on.
        See ``HapticLoop.range_of``.

        Raises: as ``verdict``; ValueError also for what is no number of the loop.

        Source: lemma E1 of docs/proofs.md.

        Example:
            >>> loop = jaxstab.simulated_pd(0.1, step=2e-3)
            >>> round(loop.range_of("inertia", kp=1000.0, kd=10.0).least, 9)  # kd h/2 + kp h^2/4
            0.011
        """
        pair = Gains(*(checked_number(name, x) for name, x in self._named((), gains).items()))
        return range_of_number(self, quantity, pair, between, count)

    def region(self, *, tolerance: float = TOLERANCE) -> Region:
        """The set of all stable gains, in its connected parts.

        It is computed, and drawn, in coordinates in which it is bounded: where the gains move the
        leading coefficient l of p(z), these are two of 1/l, a/l and b/l. For admittances, where
        light and heavy masses may both be stable, they are 1/mass and damping/mass.

        Args:
            tolerance: largest distance between outline and boundary, as a share of the diameter.

        Raises: ValueError for a tolerance below 1e-10, and for gains that act alike.

        Example:
            >>> jaxstab.simulated_pd(0.1, step=2e-3).region()
            Region (kp, kd): the boundary closes to loops
              largest  kp = 99999 N m/rad at kd = 0.0005 N m s/rad
              largest  kd = 99.999 N m s/rad at kp = 0.5 N m/rad
              islands  none found
        """
        tolerance = checked_number("tolerance", tolerance, 1e-10, is_open=True)
        return region_of_loop(self, tolerance)

    def tune(self) -> Tuned:
        """The gains >= 0 of the smallest spectral radius: the fastest decay.

        The search covers the component that contains small gains; where these are not stable, all
        gains, and the status says so. It is that of ``HapticLoop.tune("radius")``, whose
        remarks on rounded gains hold here, too. Gains are infinite where ever larger ones
        decay ever faster, as in simulators that are implicit.

        Raises: as ``region``.

        Source: the theorem of Blondel et al. (2012), IEEE TAC 57(12).

        Example:
            >>> robot = jaxstab.admittance(1e4, sample_time=1e-3, delay_samples=4)
            >>> best = robot.tune()
            >>> f"{best.damping:.2f} N s/m, radius {best.radius:.4f}"
            '110.95 N s/m, radius 0.7808'
        """
        region = self.region().region
        shares = self._chart.shares[0] * self._scale[0], self._chart.shares[1] * self._scale[1]
        walls = Walls.of_loop(self._pairs, region)._replace(lowest=0.0, shares=shares)
        best = smallest_radius(walls)
        with np.errstate(all="ignore"):
            pair = [float(gain) for gain in self._chart.gains(*np.array(best.wall) * self._scale)]
        gains = dict(zip((gain.name for gain in self.gains), pair, strict=True))
        if not np.all(np.isfinite(pair)):
            status = TuningStatus.ENDLESS if best.radius < 1.0 else best.status
            return Tuned(pair[0], pair[1], np.nan, np.inf, status, names=self.gains)
        radius = self.spectral_radius(**gains)
        errors = float(radius.value), float(radius.error)
        return Tuned(pair[0], pair[1], *errors, best.status, names=self.gains)

    def simulate(self, *, samples: int = 200, **gains: Numbers) -> Float64[Array, "*grid sample"]:
        """The motion of the loop's poles from an impulse, sample by sample.

        It is the recursion that p(z) is: c_0 y_k + c_1 y_(k-1) + ... + c_n y_(k-n) = 0 from y_0 = 1
        on, with y_k = 0 before, so that all poles take part. The motion of a position depends on
        where the loop is entered and left, which p(z) does not say. In float64.

        Args:
            samples: their number, from y_0 on, at the loop's sample time.
            **gains: both, of any shapes; JAX may trace them.

        Raises: as ``verdict``; ValueError also if there is no sample.

        Example:
            >>> loop = jaxstab.simulated_pd(0.1, step=2e-3)
            >>> loop.simulate(samples=4, kp=1000.0, kd=20.0).round(4).tolist()
            [1.0, 1.56, 1.8336, 1.9244]
        """
        count = checked_count("samples", samples, 1)
        polynomial = family_of_loop(self._pairs).polynomial(
            *self._in_units(*self._named((), gains).values())
        )
        xp = namespace(polynomial)

        def step(past: Array) -> tuple[Array, Array]:
            following = -xp.sum(polynomial[..., 1:] * past, axis=-1, keepdims=True)
            return xp.concatenate([following, past[..., :-1]], axis=-1), past[..., 0]

        unit = xp.zeros_like(polynomial[..., 1:]) + np.eye(1, polynomial.shape[-1] - 1)[0]
        return xp.moveaxis(repeat_and_keep(count, step, unit)[1], 0, -1)

    def settling_time(
        self, *, level: float = 0.02, horizon: int = HORIZON, **gains: Numbers
    ) -> SettlingTime:
        """The time in s until the motion that ``simulate`` gives stays within a share of its peak.

        Args:
            level: that share, between 0 and 1.
            horizon: samples; a loop that is not proved to have settled by then is given up.
            **gains: both, of any shapes.

        Raises: as ``verdict``; TypeError for JAX arrays.

        Source: lemma E4 of docs/proofs.md.

        Example:
            >>> loop = jaxstab.simulated_pd(0.1, step=2e-3)
            >>> loop.settling_time(kp=1000.0, kd=20.0)
            Settling: 72 ms (settled)
        """
        level, horizon = checked_level(level, "impact"), checked_count("horizon", horizon, 1)
        grid = wall_grid(**self._named((), gains))
        codes = self._verdicts(grid)
        samples = np.where(codes == Verdict.UNSTABLE, inf, np.nan)
        for k, pair in stable_pairs(codes, grid):
            samples.flat[k] = motion_settled_after(self._triple, *pair, level, horizon)
        return SettlingTime(*settled_answer(samples * self.sample_time))

    def _in_units(self, first: Numbers, second: Numbers) -> tuple[Array, Array]:
        """Gains as those of ``_pairs``: without rounding where they are those of the chart."""
        pair = dict(zip((gain.name for gain in self.gains), (first, second), strict=True))
        require_together(**pair)
        given = float_arrays(*(checked_gain(name, value) for name, value in pair.items()))
        with np.errstate(divide="ignore", invalid="ignore"):  # where p(z) has a lower degree
            of_chart = self._chart.of_gains(*given)
        return of_chart[0] / self._scale[0], of_chart[1] / self._scale[1]

    @property
    def _charted(self) -> "Loop":
        if self._chart.are_gains:
            return self
        return replace(self, parts=self._chart, gains=self.coordinates)

    @cached_property
    def _chart(self) -> Chart:
        return chart_of(self.parts)

    @property
    def _source(self) -> Chart:
        return self._chart

    @cached_property
    def _scale(self) -> tuple[float, float]:
        """Units in which gains of the chart are of size 1."""
        return _units(self._chart)

    @cached_property
    def _pairs(self) -> LinearLoop:
        first, second = self._scale
        chart = partial(affine_triple, self._chart)
        return rounded_triple(lambda: chart().monic(), 1.0 / first, 1.0 / second)


def _coefficient(name: str, value: Any) -> Coefficient:
    if not isinstance(value, tuple):
        return _exact_number(name, value)
    if len(value) != 2:
        raise TypeError(f"{name} is {shortened(value)}; give its lowest and its highest value.")
    low, high = (_exact_number(name, end) for end in value)
    if not low <= high:
        raise ValueError(f"{name} is {value}; give (lowest, highest).")
    return low, high


def _exact_number(name: str, value: Any) -> float | Fraction:
    """A number as it is: float64 does not hold every whole one."""
    is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    return (
        Fraction(value) if is_whole or isinstance(value, Fraction) else checked_number(name, value)
    )


def _units(chart: AffineParts) -> tuple[float, float]:
    """Units in which gains of a loop are of size 1: powers of two."""
    least = 2.0**-900  # products of numbers in such units are float64 still
    with working_precision(128):
        _, *sides = affine_triple(chart).monic()
        sizes = [sum(abs(float(c.mid())) for c in side.polynomial().coeffs()) for side in sides]
    for size in filter(None, sizes):
        if not least < size < 1.0 / least:
            raise ValueError(
                f"the coefficients of a gain are of size {size:g} beside the first one of p(z), "
                "which float64 does not hold together; give the gain in another unit."
            )
    first, second = (2.0 ** -round(float(np.log2(size or 1.0))) for size in sizes)
    return first, second


# The doors: each checks numbers that its users know, and makes the parts of p(z) with the names and
# units of the gains.


def rebuilt(door: Callable[Given, Loop]) -> Callable[Given, Loop]:
    """Let the loops of a door know what they were made of."""
    named_by = signature(door)

    @wraps(door)
    def made(*values: Given.args, **options: Given.kwargs) -> Loop:
        given = named_by.bind(*values, **options)
        given.apply_defaults()
        return replace(door(*values, **options), made=partial(made, **given.arguments))

    return made


@rebuilt
def simulated_pd(
    inertia: float,
    *,
    step: float,
    damping: float = 0.0,
    stiffness: float = 0.0,
    integrator: str = "semi-implicit",
    outside: bool = False,
    substeps: int = 1,
    delay_steps: int = 0,
) -> Loop:
    """PD control of a joint in a physics engine; the gains are ``kp`` and ``kd``.

    The torque is -kp q - kd v, v the engine's own velocity. By default the PD is part of the
    engine's step, as a position actuator is. With ``outside``, ``substeps`` or ``delay_steps`` it
    is computed outside: its torque is held through ``substeps`` steps and acts ``delay_steps``
    later.

    Args:
        inertia: of the joint with its armature in kg m^2, > 0 (or a mass in kg). Of several joints
            under the same gains: 1 over the largest eigenvalue of the inverse mass matrix, not the
            diagonal.
        step: of the engine in s, > 0.
        damping: of the joint in N m s/rad, >= 0.
        stiffness: of a passive spring in N m/rad, >= 0.
        integrator: "semi-implicit", MuJoCo's Euler with eulerdamp disabled; "implicit-joint", its
            Euler as shipped, in which joint damping is implicit; "implicit-damping", its implicit
            and implicitfast, in which kd is implicit, too; "implicit", kp and kd both, the stable
            PD of Tan, Liu, Turk (2011), a passive spring explicit; "explicit", forward Euler;
            "rk4", Runge-Kutta, outside only.
        outside: True for a PD that is computed outside of the engine.
        substeps: engine steps per control step, from 1 on; more than 1 is outside.
        delay_steps: engine steps by which the torque is late, 0 or more; not 0 is outside.

    Raises: see ``jaxstab.conventions``; ValueError also for "rk4" inside of the engine: p(z) is not
    affine in the gains there.

    Source: eq. (9), likewise, with an engine's step in place of the exact one.

    Example:
        >>> loop = jaxstab.simulated_pd(2.216e-5, step=5e-3)
        >>> round(loop.limits().kp, 2)
        3.55
    """
    joint: Any = Device.simulated(
        inertia, step=step, damping=damping, stiffness=stiffness, integrator=integrator
    ).mechanism
    substeps = checked_count("substeps", substeps, 1, 1000)
    delay_steps = checked_count("delay_steps", delay_steps, 0, int(LONGEST_DELAY) * substeps)
    is_outside = outside or substeps > 1 or delay_steps > 0
    if integrator == "rk4" and not is_outside:
        raise ValueError(
            'integrator is "rk4" and the PD is inside of the engine, whose stages ask for it '
            "again: p(z) is not affine in the gains; give outside=True if the torque is held, or "
            "another integrator."
        )
    parts = SimulatedParts(joint, is_outside, substeps, delay_steps)
    gains = Gain("kp", "N m/rad"), Gain("kd", "N m s/rad")
    where = f"outside of it, every {substeps} steps" if is_outside else "inside its step"
    words = f"PD of a simulated joint ({integrator}), {where}"
    return Loop(parts, gains, joint.step * substeps, words)


@rebuilt
def admittance(
    environment: float,
    *,
    sample_time: float,
    delay_samples: int = 0,
    rule: str = "forward",
    stiffness: float = 0.0,
    robot: Filter | None = None,
    force_filter: Filter | None = None,
) -> Loop:
    """A robot that moves like a mass and a damper under the measured force: ``mass``, ``damping``.

    At every sample the force of an environment of stiffness Ke moves the virtual mass, and the
    robot follows it ``delay_samples`` later: F = -Ke x. Stiff environments ask for a large mass and
    damping; below a damping of Ke times the whole delay in s the mass has a largest value, too.

    Args:
        environment: its stiffness Ke in N/m, > 0.
        sample_time: T in s, > 0.
        delay_samples: samples by which the robot follows its command, 0 or more.
        rule: "forward", v + T/M (F - D v), then x + T v with the new v; "backward", with the new v
            in the damper's force; "explicit", x with the old v; "trapezoid", Tustin's rule, which
            takes the mean of old and new for v, x and F. The exact exponential of D T/M is not
            affine in the gains.
        stiffness: of a virtual spring beside mass and damper in N/m, >= 0.
        robot: its response from command to position, a filter; None for the delay alone.
        force_filter: of the measured force; None for none.

    Raises: see ``jaxstab.conventions``.

    Source: eq. (9), likewise; the virtual mass in place of the device's.

    Example:
        >>> loop = jaxstab.admittance(1e3, sample_time=2e-3, delay_samples=10)
        >>> line = loop.intervals(mass=10.0)
        >>> [(round(low.value, 6), round(high.value, 6)) for low, high in line.intervals]
        [(19.870572, 9999.0)]
    """
    wall = checked_number("environment", environment, 0.0, is_open=True, unit="N/m")
    period = checked_number("sample_time", sample_time, 0.0, is_open=True, unit="s")
    late = checked_count("delay_samples", delay_samples, 0, int(LONGEST_DELAY))
    checked_word("rule", rule, RULES)
    spring = checked_number("stiffness", stiffness, 0.0, unit="N/m")
    filters = [_filter("robot", robot, period), _filter("force_filter", force_filter, period)]
    parts = AdmittanceParts(wall, period, late, rule, spring, filters[0], filters[1])
    gains = Gain("mass", "kg", "least"), Gain("damping", "N s/m", "least")
    sides = {"backward": " + T damping", "trapezoid": " + T damping/2"}.get(rule, "")
    sides += " + T^2 stiffness/4" if spring and rule == "trapezoid" else ""
    mass = f"(mass{sides})" if sides else "mass"
    chart = Gain(f"1/{mass}", "1/kg"), Gain(f"damping/{mass}", "1/s")
    return Loop(parts, gains, period, f"admittance control against {wall:g} N/m", chart)


def _filter(name: str, value: Any, period: float) -> Filter:
    if value is None:
        return Filter()
    require_kind(name, value, Filter)
    value.checked(period)
    return value


@rebuilt
def pid(
    loop: LoopParameters,
    *,
    kp: float | None = None,
    ki: float | None = None,
    kd: float | None = None,
    rule: str = "backward",
    kd_delay: float | None = None,
) -> Loop:
    """PID control of a held device, one gain given; the gains are the two others.

    The force is -(kp x + ki I + kd v), x the position, filtered if there is a filter, v the
    estimated velocity, and I the sum of T x by a rule of integration. Without a spring a free
    device has no stable integrator alone: kp must exceed about (m/(kd + b)) ki. Given ki = 0 there
    is no integrator: kp and kd are those of a wall, and may have delays of their own.

    Args:
        loop: device, sample time, delay, estimator and filter; its hand belongs to the device.
        kp: in N/m, if it is the gain that is given.
        ki: in N/(m s), if it is.
        kd: in N s/m, if it is.
        rule: of the integrator: "backward" adds the new sample, "forward" the last one,
            "trapezoid" the mean of both. With "forward" and the difference over one sample the
            stable ki and kd at one kp are polygons.
        kd_delay: delay of the derivative's force in s; None for that of the loop.

    Raises: TypeError unless one gain is given; see also ``jaxstab.conventions``.

    Source: eq. (9), likewise.

    Example:
        >>> device = jaxstab.HapticLoop(
        ...     device_mass=0.25, device_damping=0.1, sample_time=1e-3, delay=1e-3
        ... )
        >>> line = jaxstab.pid(device, kd=50.0).intervals(kp=5000.0)
        >>> [(low.value, round(high.value, 4)) for low, high in line.intervals]
        [(0.0, 1024414.8031)]
        >>> fast = jaxstab.pid(device, ki=0.0, kd_delay=0.0)  # the drive adds the damping itself
        >>> [round(loop.limits().kp) for loop in (jaxstab.pid(device, ki=0.0), fast)]
        [36168, 171706]
    """
    require_kind("loop", loop, LoopParameters, "HapticLoop")
    given = {
        name: value for name, value in (("kp", kp), ("ki", ki), ("kd", kd)) if value is not None
    }
    if len(given) != 1:
        raise TypeError(
            f"gains given: {', '.join(given) or 'none'}; give one of kp, ki and kd, the two others "
            "are the gains of the loop."
        )
    ((name, value),) = given.items()
    number = checked_number(name, value)
    checked_word("rule", rule, tuple(rule for rule in RULES if rule != "explicit"))
    units = {"kp": "N/m", "ki": "N/(m s)", "kd": "N s/m"}
    others = [Gain(other, unit) for other, unit in units.items() if other != name]
    plain = loop.in_floats()
    late = plain
    if kd_delay is not None:
        late = replace(plain, delay=checked_number("kd_delay", kd_delay, 0.0, unit="s"))
    parts = PidParts(plain, late, name, number, rule)
    words = f"PID with {name} = {number:g} {units[name]}"
    return Loop(parts, (others[0], others[1]), float(parts.loop.sample_time), words)


@rebuilt
def coupling(
    first: Device,
    second: Device,
    *,
    sample_time: float,
    delays_samples: Sequence[float] = (1.0, 0.0),
    velocity: Velocity | None = None,
) -> Loop:
    """A virtual spring and damper between two devices; the gains are ``stiffness`` and ``damping``.

    Both devices are computed in one place: the force on the one is the opposite of that on the
    other, each behind its own hold and delay. A rigid motion that both share, a common
    drift, is moved by no gain: it is left out, and the answers are about all other roots.

    Args:
        first: a device, hands included, or one in z, such as a tool of a simulation.
        second: the other one.
        sample_time: T in s, > 0.
        delays_samples: of each device, from its position to its force, in samples.
        velocity: the estimator of the relative velocity; None for the difference over one sample,
            ``Velocity.measured()`` if both devices have a velocity of their own.

    Raises: see ``jaxstab.conventions``.

    Source: eq. (9), likewise, for the plant G1 + G2.

    Example:
        >>> left = jaxstab.Device.mass_spring_damper(mass=0.25, damping=0.1)
        >>> right = jaxstab.Device.mass_spring_damper(mass=0.5, damping=0.2)
        >>> loop = jaxstab.coupling(left, right, sample_time=1e-3, delays_samples=(1.0, 2.0))
        >>> line = loop.intervals(damping=30.0)
        >>> [(low.value, round(high.value, 6)) for low, high in line.intervals]
        [(0.0, 12779.059143)]
        >>> tool = jaxstab.Device.simulated(0.05, step=1e-3)
        >>> line = jaxstab.coupling(left, tool, sample_time=1e-3).intervals(damping=8.0)
        >>> [(round(low.value), round(high.value)) for low, high in line.intervals]
        [(0, 34312), (130060, 184003)]
    """
    for name, device in (("first", first), ("second", second)):
        require_kind(name, device, Device)
    period = checked_number("sample_time", sample_time, 0.0, is_open=True, unit="s")
    if not has_shape(delays_samples, 2):
        raise ValueError(
            f"delays_samples is {shortened(delays_samples)}; give one delay for each device."
        )
    delays = [
        checked_number("delays_samples", delay, 0.0, LONGEST_DELAY) for delay in delays_samples
    ]
    if velocity is not None:
        require_kind("velocity", velocity, Velocity)
        filter_on(velocity, first.mechanism, second.mechanism).checked(period)
    for device, delay in zip((first, second), delays, strict=True):
        if own := in_steps(device):
            own.steps(period, delay)
    parts = CouplingParts((first, second), period, (delays[0], delays[1]), velocity)
    gains = Gain("stiffness", "N/m"), Gain("damping", "N s/m")
    return Loop(parts, gains, period, "a coupling between two devices")
