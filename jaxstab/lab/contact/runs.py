"""Contacts of a loop in SI units: what a hand would feel, simulated, and summed up.

One run or a few are computed with their path; many without it, in bounded memory.
The kind of a run is read off its last two quarters (``jaxstab.motion.contact``). Nothing here is
proved: another start, another phase of the encoder or a longer run may end differently.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Int8

from jaxstab.arrays import Array, Numbers, is_any_traced, named
from jaxstab.conventions import Status
from jaxstab.drawing import BLACK, BLUE, OCHRE, ORANGE, new_axes
from jaxstab.loop.jitter import turn_of
from jaxstab.model import LoopParameters, checked_gain, require_x64
from jaxstab.model.device.mechanics import handle_equations
from jaxstab.model.filters import given_filters
from jaxstab.motion.contact import (
    FASTEST,
    LIMIT,
    Handle,
    Mechanism,
    Runs,
    Sides,
    Summary,
    SwitchedMass,
    contacts,
    paths,
)
from jaxstab.motion.response import Column, Controller, Response, answer_text, controller_for
from jaxstab.numbers import checked, checked_number, checked_word, require_together

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class ContactKind(Status):
    """The end of a simulated contact.

    Example:
        >>> jaxstab.results.ContactKind(1).words
        'rests'
    """

    NOT_COMPUTED = 0, "not computed"
    RESTS = 1, "rests"
    OSCILLATES = 2, "oscillates in contact with the wall"
    BOUNCES = 3, "leaves the wall and returns to it"
    GROWS = 4, "the motion grows"
    DECAYS = 5, "still moves, less and less"
    OUTSIDE = 6, "outside of the wall at the end"
    PUSHED_THROUGH = 7, "pushed through the wall, whose force stays at its limit"
    UNTOUCHED = 8, "does not touch the wall"


class Contact(NamedTuple):
    """Simulated contacts with walls: their ends, in the last quarter of the run.

    Attributes:
        kind: codes of ``ContactKind``.
        amplitude: half of the peak-to-peak position at the end in m; infinite if it was given up.
        frequency: of the maxima of the position at the end in Hz; NaN if it rests, or has not two.
        time_to_rest: the time in s from which on it rests, in the wall or outside; infinite if it
            does not.
        penetration: the largest position of the run in m; 0 if none is positive.
        largest_force: the largest modulus of the wall's force in N.
        energy: given by the wall to device and hand, in J; negative if it took.
        path: the motion at the samples, the force as it is computed there, or None.

    Example:
        >>> loop = jaxstab.HapticLoop(
        ...     device_mass=0.25, device_damping=0.1, sample_time=1e-3, delay=1e-3,
        ...     velocity=jaxstab.Velocity.difference(window=0.02),
        ... )
        >>> jaxstab.contact(loop, 5000.0, 30.0, friction=0.3, push=1.0)
        Contact: rests after 53 ms, penetration 0.2635 mm, largest force 1.713 N (rests)
        >>> jaxstab.contact(loop, 3000.0, 15.0, push=1.0).kind
        <ContactKind.BOUNCES: 3>
    """

    kind: Int8[Array, "*grid"]
    amplitude: Float64[np.ndarray, "*grid"]
    frequency: Float64[np.ndarray, "*grid"]
    time_to_rest: Float64[np.ndarray, "*grid"]
    penetration: Float64[np.ndarray, "*grid"]
    largest_force: Float64[np.ndarray, "*grid"]
    energy: Float64[np.ndarray, "*grid"]
    path: Response | None = None

    def __repr__(self) -> str:
        moving = np.where(np.isinf(self.time_to_rest), self.amplitude, np.nan)
        values = self.time_to_rest, moving, *self[2:3], *self[4:6]
        return answer_text("Contact", values, _COLUMNS, self.kind, ContactKind)

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Draw position and force of one run over time; axes of a new figure by default.

        Example:
            >>> loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
            >>> axes = jaxstab.contact(loop, 1000.0, 2.0, push=1.0).plot()
        """
        path = self.path
        if path is None or path.position.ndim != 1:
            raise ValueError(
                f"there is no single path to draw: {self!r}; call jaxstab.contact with one wall."
            )
        panel = new_axes() if ax is None else ax
        panel.axhline(0.0, color=BLACK, lw=0.6)
        panel.plot(path.time, 1000.0 * path.position, color=BLUE, lw=1.0)
        panel.set_xlabel("time (s)")
        if self.kind == ContactKind.RESTS:  # what follows is a straight line
            panel.set_xlim(0.0, min(path.time[-1], 3.0 * float(self.time_to_rest)))
        panel.set_ylabel("position (mm), positive inside the wall", color=BLUE)
        beside = panel.twinx()
        beside.plot(path.time, path.force, color=ORANGE, lw=0.6)
        beside.set_ylabel("force of the wall (N)", color=OCHRE)
        panel.set_title(f"simulated: {ContactKind(int(self.kind)).words}", fontsize=9)
        return panel


_COLUMNS = [
    Column("rests after", "ms", 1000),
    Column("amplitude", "mm", 1000),
    Column("", "Hz"),
    Column("penetration", "mm", 1000),
    Column("largest force", "N"),
]


class _Setup(NamedTuple):
    """Runs of a loop: their numbers for T = m = 1, arrays of one shape, and what is fixed."""

    plant: Mechanism
    controller: Controller
    runs: Runs
    samples: int
    sides: Sides
    period: float
    unit: float  # N that are 1

    @property
    def last(self) -> int:
        """The sample at which the last quarter of the run begins."""
        return self.samples - self.samples // 4

    def answer(self, summary: Summary, path: Response | None = None) -> Contact:
        """Return the answer to runs that are summed up."""
        values = Summary(*(np.reshape(value, self.runs.alpha.shape) for value in summary))
        is_far = values.deepest >= LIMIT
        rests = ~is_far & (values.since <= self.last)
        with np.errstate(all="ignore"):
            cycles = np.where(values.maxima > 1.0, values.maxima - 1.0, np.nan)
            duration = self.period * (values.last_maximum - values.first_maximum)
            frequency = np.where(is_far | rests, np.nan, cycles / duration)
        return Contact(
            named(self._kinds(values), ContactKind),
            np.where(is_far, np.inf, 0.5 * (values.high - values.low)),
            frequency,
            np.where(rests, self.period * values.since, np.inf),
            np.where(is_far, np.inf, np.maximum(values.deepest, 0.0)),
            np.where(is_far, np.inf, values.strongest * self.unit),
            np.where(is_far, np.nan, values.energy * self.unit),
            path,
        )

    def _kinds(self, values: Summary) -> Int8[np.ndarray, "*grid"]:
        growth = 1.5  # of the amplitude, from one quarter of a run to the next
        size, earlier = values.high - values.low, values.earlier_high - values.earlier_low
        is_one_sided = self.sides.one_sided
        is_idle = values.strongest == 0.0  # a wall gated by its force acts before the surface
        surface = -self.runs.tolerance - 0.5 * self.runs.encoder  # further outside nothing acts
        cases = [
            (values.deepest >= LIMIT, ContactKind.GROWS),
            (values.limited_since <= self.last, ContactKind.PUSHED_THROUGH),
            (is_one_sided & (values.deepest < surface) & is_idle, ContactKind.UNTOUCHED),
            (is_one_sided & (values.high < surface), ContactKind.OUTSIDE),
            (values.since <= self.last, ContactKind.RESTS),
            (size > growth * earlier, ContactKind.GROWS),
            (earlier > growth * size, ContactKind.DECAYS),
            (is_one_sided & (values.low <= 0.0), ContactKind.BOUNCES),
        ]
        conditions, kinds = zip(*cases, strict=True)
        chosen = np.select(conditions, kinds, ContactKind.OSCILLATES)
        return np.asarray(chosen, np.int8)


def contact(
    loop: LoopParameters,
    stiffness: Numbers,
    damping: Numbers,
    *,
    friction: Numbers = 0.0,
    static_friction: Numbers = None,
    encoder: Numbers = 0.0,
    phase: Numbers = 0.0,
    force_step: Numbers = 0.0,
    max_force: Numbers = None,
    push: Numbers = 0.0,
    speed: Numbers = 0.0,
    position: Numbers = 0.0,
    one_sided: bool = True,
    pulls: bool = False,
    gate: str = "position",
    duration: int | float = 4.0,
    delays: Sequence[float] | np.ndarray | None = None,
    tolerance: Numbers = 1e-6,
    path: bool = True,
) -> Contact:
    """Simulate a contact as it is felt: a one-sided wall, friction, encoder, saturation.

    The motion between samples is exact, friction included. The answer is simulated, not proved:
    it is that of this start and this duration. Every turn of the motion is followed: behind a
    grip of 1e9 N/m, that swings many times in a sample, a second takes 12 s of CPU time. Before
    time 0 the device was at rest where it starts, and no force was on its way. The numbers may
    be arrays that broadcast.

    Args:
        loop: any device with a mass at its handle.
        stiffness, damping: see ``jaxstab.conventions``.
        friction: Coulomb friction of the device in N, at its handle.
        static_friction: the largest force in N that does not move the device from rest, at
            least ``friction``; None for the same.
        encoder: resolution of the position in m, which is rounded to the nearest step; 0 for
            none.
        phase: place of the encoder's steps, as a share of its resolution.
        force_step: resolution of the force in N; 0 for none.
        max_force: the largest force of the actuator in N; None for no limit.
        push: constant force of the hand in N, from time 0 on, positive into the wall.
        speed: at which device and hand arrive as a whole at time 0, in m/s, positive into the
            wall; as ``initial_velocity`` of ``HapticLoop.simulate``.
        position: position at time 0 in m, the penetration if positive.
        one_sided: the wall acts only where the sampled position is positive.
        pulls: True for a one-sided wall that may pull; otherwise such forces are 0.
        gate: "force" for a one-sided wall that acts wherever its force K x + B v pushes: the wall
            that ``HapticLoop.one_sided`` proves. It begins to brake before the surface.
        duration: of the simulation in s, 16 samples at least.
        delays: as for ``HapticLoop.simulate``.
        tolerance: the device rests while it stays within this distance of one place, in m.
        path: False for the ends alone. Many runs are then one program of JAX, in float64
            whatever its flag says, on all cores, tile by tile: about ten million samples of one
            mass per second and core, in little memory.

    Returns:
        Contact of NumPy arrays of the broadcast shape: the end of each run, and its path.

    Raises: TypeError also if JAX traces anything. ValueError also if nothing moves, a push
    meets neither wall nor hand stiffness, static friction is below Coulomb friction, or no mass
    is at the device's handle.

    Source: eqs. (1)-(5) of Hulin, Preusche, Hirzinger (2008), with Coulomb friction.

    Example:
        >>> loop = jaxstab.HapticLoop(
        ...     device_mass=0.25, device_damping=0.1, sample_time=1e-3, delay=1e-3,
        ...     velocity=jaxstab.Velocity.difference(window=0.02),
        ... )
        >>> loop.verdict(3000.0, 15.0)
        <Verdict.UNSTABLE: 2>
        >>> jaxstab.contact(loop, 3000.0, 15.0, push=1.0, friction=0.1).kind
        <ContactKind.RESTS: 1>
        >>> frictions = [0.0, 0.1, 0.3]
        >>> ends = jaxstab.contact(loop, 3000.0, 15.0, push=1.0, friction=frictions, path=False)
        >>> (ends.kind == jaxstab.results.ContactKind.RESTS).tolist()
        [False, True, True]
    """
    setup = setup_of(
        loop, stiffness, damping, friction=friction, static_friction=static_friction,
        encoder=encoder, phase=phase, force_step=force_step, max_force=max_force, push=push,
        speed=speed, position=position, one_sided=one_sided, pulls=pulls, gate=gate,
        duration=duration, delays=delays, tolerance=tolerance,
    )  # fmt: skip
    runs = setup.runs
    shape = runs.alpha.shape
    if not path:
        runs = Runs(*(column.ravel() for column in runs))
        return setup.answer(
            contacts(setup.plant, setup.controller, runs, setup.samples, setup.sides)
        )
    if not shape and isinstance(setup.plant, SwitchedMass):
        # Numbers of Python are several times faster here.
        runs = Runs(*(column.item() for column in runs))
    summary, (x, v, f) = paths(setup.plant, setup.controller, runs, setup.samples, setup.sides)
    x, v, f = (np.moveaxis(own, 0, -1).reshape(*shape, len(own)) for own in (x, v, f))
    x = np.where(x < LIMIT, x, np.nan)  # given up
    time = setup.period * np.arange(setup.samples)
    return setup.answer(summary, Response(time, x, v / setup.period, f * setup.unit))


def setup_of(
    loop: LoopParameters,
    stiffness: Numbers,
    damping: Numbers,
    *,
    friction: Numbers = 0.0,
    static_friction: Numbers = None,
    encoder: Numbers = 0.0,
    phase: Numbers = 0.0,
    force_step: Numbers = 0.0,
    max_force: Numbers = None,
    push: Numbers = 0.0,
    speed: Numbers = 0.0,
    position: Numbers = 0.0,
    one_sided: bool = True,
    pulls: bool = False,
    gate: str = "position",
    duration: int | float = 4.0,
    delays: Any = None,
    tolerance: Numbers = 1e-6,
) -> _Setup:
    """Return the runs that arguments describe, checked."""
    shortest, longest = 16, 1e8  # samples
    conditions = friction, static_friction, encoder, phase, force_step, max_force, push, speed
    given = (stiffness, damping, *conditions, position, duration, delays, tolerance)
    if is_any_traced(loop, given):
        raise TypeError(
            "contacts are simulated outside of jit, vmap and grad: give concrete numbers, and a "
            "loop of such."
        )
    require_x64(*given)
    loop = loop.in_floats()
    period = float(loop.sample_time)
    turn = (float(loop.delay_samples),) if delays is None else turn_of(loop, delays)
    mechanism, unit, support = _mechanism(loop, period, turn)
    count = checked_number("duration", duration, 0.0, unit="s") / period
    if not shortest <= count <= longest:
        raise ValueError(
            f"duration is {duration:g} s, {count:.3g} samples; give {shortest} samples at least "
            f"and {longest:g} at most."
        )
    static = friction if static_friction is None else static_friction
    most = np.inf if max_force is None else checked("max_force", max_force, 0.0, is_open=True)
    columns = {
        "stiffness": checked_gain("stiffness", stiffness) / unit,
        "damping": checked_gain("damping", damping) / (unit * period),
        "friction": checked("friction", friction, 0.0) / unit,
        "static_friction": checked("static_friction", static, 0.0) / unit,
        "encoder": checked("encoder", encoder, 0.0),
        "phase": checked("phase", phase),
        "force_step": checked("force_step", force_step, 0.0) / unit,
        "max_force": most / unit,
        "push": checked("push", push) / unit,
        "position": checked("position", position),
        "speed": checked("speed", speed) * period,
        "tolerance": checked("tolerance", tolerance, 0.0),
    }
    require_together(**columns)
    runs = Runs(*map(np.array, np.broadcast_arrays(*columns.values())))
    _refuse_odd(runs, unit, support)
    controller = controller_for(given_filters(**loop.filters))
    is_by_force = checked_word("gate", gate, ("position", "force")) == "force"
    if is_by_force and (pulls or not one_sided):
        raise ValueError(
            'gate is "force", of a wall that only pushes; leave out one_sided=False and pulls.'
        )
    sides = Sides(bool(one_sided), bool(pulls), is_by_force)
    return _Setup(mechanism, controller, runs, round(count), sides, period, unit)


def _mechanism(
    loop: LoopParameters, period: float, turn: tuple[float, ...]
) -> tuple[Mechanism, float, float]:
    """The mechanism that moves, its unit of force in N, and its stiffness without a wall."""
    device: Any = loop.device
    is_mass = loop.body is not None
    gamma, delta = (float(loop.gamma), float(loop.delta)) if is_mass else (0.0, 0.0)
    speed = max(delta, gamma**0.5) if is_mass else handle_equations(device, period).ticks
    if speed > FASTEST:
        raise ValueError(
            f"the device without a wall moves at {speed:.3g} rad per sample; contacts are "
            f"simulated up to {FASTEST:g}: give a shorter sample_time."
        )
    if is_mass:
        return SwitchedMass.from_delays(gamma, delta, turn), float(loop.mass) / period**2, gamma
    return Handle.from_device(device, period, turn), 1.0, device.static_stiffness()


def _refuse_odd(runs: Runs, unit: float, support: float) -> None:
    """Refuse conditions that contradict each other, or under which nothing moves."""
    less = runs.static_friction < runs.friction
    if np.any(less):
        static, friction = (unit * x[less].flat[0] for x in (runs.static_friction, runs.friction))
        raise ValueError(
            f"static_friction is {static:g} N, below friction, {friction:g} N; give it at least "
            "as large."
        )
    if support == 0.0 and np.any((runs.push != 0.0) & (runs.alpha == 0.0)):
        raise ValueError(
            "push is given where stiffness is 0, so nothing holds the device; give a stiffness to "
            "the wall or to the hand."
        )
    if not np.all((runs.push != 0.0) | (runs.velocity != 0.0) | (runs.position != 0.0)):
        raise ValueError(
            "push, speed and position are all 0, so nothing moves: give one of them another value."
        )
