"""Loops of a held device on the unit circle, over boxes of masses, delays, walls, arms and angles.

With s = i theta, position over force N/D (``HeldDevice``) and the wall's H = alpha P + beta V,

    F = D(s) + H e^(-i theta (d + 1/2)) (sinc(theta/2) N(s) + 2 sin(theta/2) D(s) R),

R the sum of aliases, vanishes on the circle where the characteristic polynomial does (lemma B20 of
docs/proofs.md). F is real at theta = 0, where a free device has its root without a wall.

If the delay moves from sample to sample, from d to d + J samples, F has to be farther from 0 than

    rho = J |2 sin(theta/2)| |H| (|N| + |D| R'),

R' the sum of the moduli of the aliases' responses (lemma J3): a disc around F. Along the stiffness
F is affine and rho convex, so a straight line that parts the discs of two walls from 0 parts those
of all walls between them.
"""

from collections.abc import Callable
from dataclasses import replace
from math import hypot, inf, pi, prod
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Complex128, Float64

from jaxstab.boxes.enclosures import (
    HAND,
    THETA,
    LinearModel,
    Moving,
    ParameterBoxes,
    Quotient,
    Rows,
    clearances,
    conjugate,
    disc,
    on_axes_of,
    phasor,
    quotients,
    sinc,
    sine,
)
from jaxstab.conventions import Range
from jaxstab.model import Device, LoopParameters
from jaxstab.model import Hand as Arm
from jaxstab.model.device.parts import (
    MassSpringDamper,
    Modes,
    Ports,
    Rational,
    Shapes,
    working_precision,
)
from jaxstab.model.device.sampling import in_samples
from jaxstab.model.filters import known_filters
from jaxstab.rounding import PARAMETER, RAISED_MUCH

# A device with its vibration modes, actuators and a held grip, of any mass, for any hand.
#
# In units of one sample, with s = i theta or any other number, position over force is N(s)/D(s).
# Both are polynomials that are affine in the mass of the device and in what the arm is made of.

_BITS = 192  # of coefficients, before they are rounded to float64

Function = Any  # a number, an array or a model of a function over boxes


class Arms(NamedTuple):
    """The parts of the arm: mass in kg; stiffness and damping in units of one sample, too."""

    mass: Function
    stiffness: Function
    damping: Function


class HeldDevice(NamedTuple):
    """A device of any mass in the hand of any arm, in units of one sample and kg.

    The rigid body has the damping b T and the stiffness k T^2 to the ground. ``modes`` are angular
    frequency, damping ratio and mass of the vibration modes, ``shapes`` where they are at motor,
    encoder and handle, if these are not one point, ``lags`` angular frequencies of the actuators,
    ``grip`` its stiffness and damping; None if the arm is rigidly attached. Another linear device
    has, in place of body and modes, ``own`` ports, highest powers of s first, the denominator
    monic.
    """

    damping: float
    stiffness: float
    modes: tuple[tuple[float, float, float], ...]
    lags: tuple[float, ...]
    grip: tuple[float, float] | None
    own: Ports | None = None
    shapes: tuple[Shapes, ...] | None = None

    @classmethod
    def from_device(cls, device: Device, period: float) -> "HeldDevice":
        """A device, for some sampling period in s.

        NotImplementedError: the hand is not one mass, spring and damper, or slips out of its grip.
        """
        hands, body = device.hands, device.mechanism
        grips = [hand.grip for hand in hands if hand.grip is not None]
        fits = len(hands) <= 1 and all(isinstance(h.dynamics, MassSpringDamper) for h in hands)
        if not fits or any(not grip.stiffness > 0.0 for grip in grips):
            raise NotImplementedError(
                "ranges are proved for a device in one hand of mass, spring and damper, behind a "
                f"grip with a spring or rigidly attached; this is {device}."
            )
        lags = tuple(2.0 * pi * hertz * period for hertz in device.bandwidths)
        grip = (grips[0].stiffness * period**2, grips[0].damping * period) if grips else None
        if isinstance(body, MassSpringDamper):
            return cls(body.damping * period, body.stiffness * period**2, (), lags, grip)
        if isinstance(body, Modes) and body.mass is not None:
            modes = tuple(
                (2.0 * pi * mode.frequency * period, mode.damping_ratio, mode.modal_mass)
                for mode in body.modes
            )
            shapes = tuple(mode.shapes for mode in body.modes) if body.has_shapes else None
            return cls(body.damping * period, 0.0, modes, lags, grip, None, shapes)
        with working_precision(_BITS):
            own = _in_floats(body.ports().reduced(), period)
        return cls(0.0, 0.0, (), lags, grip, own)

    def parts(self, s: Function, mass: Function, arm: Arms) -> tuple[Function, Function]:
        """Return N(s) and D(s) in 1/kg, of numbers, arrays or models."""
        held, both = s * (s * arm.mass + arm.damping) + arm.stiffness, 1.0
        if self.grip is not None:
            # Of a unit of the stiffer one, so that a pure spring and a pure damper are of size 1.
            unit = 1.0 / (self.grip[0] + self.grip[1])
            between = s * (self.grip[1] * unit) + self.grip[0] * unit
            held, both = held * between, held * unit + between
        ports = self._ports(s, mass).held_by(held, both)
        above, below = ports.encoder, ports.below
        if self.lags:
            below = below * self.lag(s)
        return above, below

    def lag(self, s: Function) -> Function:
        """Return the denominator of the actuators."""
        product = 1.0
        for lag in self.lags:
            product = (s * (1.0 / lag) + 1.0) * product
        return product

    @property
    def is_passive(self) -> bool:
        """True if device and arm, without actuators, are passive."""
        is_one_point = self.own is None and self.shapes is None
        return is_one_point and all(moved > 0.0 for _, _, moved in self.modes)

    def _ports(self, s: Function, mass: Function) -> Ports:
        """The responses to forces at motor and handle, without the arm."""
        if self.own is not None:
            return Ports(*(None if x is None else _polynomial(x, s) for x in self.own))
        # The square comes last: only it takes from the stiffness, which is rounded.
        body = (s * self.damping + self.stiffness) + s * s * mass
        if self.shapes is not None:
            ports = Ports(body, 1.0, 1.0, 1.0, 1.0, 0.0)
            for mode, shapes in zip(self.modes, self.shapes, strict=True):
                frequency, _, moved = mode
                share = 1.0 / (moved * frequency**2)
                ports = ports.beside((share, _vibration(mode, s)), shapes)
            return ports
        if not self.modes:
            return Ports.at_one_point(1.0, body)
        give, whole = 0.0, 1.0  # numerator and denominator of the sum of the modes' displacements
        for mode in self.modes:
            (frequency, _, moved), below = mode, _vibration(mode, s)
            give, whole = below * give + whole * (1.0 / (moved * frequency**2)), below * whole
        return Ports.at_one_point(body * give + whole, body * whole)

    def response(
        self,
        mass: float,
        arm: Arms,
        delay: Float64[np.ndarray, " delay"],
        theta: Float64[np.ndarray, " angle"],
    ) -> Complex128[np.ndarray, "delay arm angle"]:
        """Sampled position over force on the unit circle, to about 1e-3 (lemma B20)."""
        aliases = 4  # on either side, that responses without a bound add up
        turns = theta + 2.0 * pi * np.arange(-aliases, aliases + 1)[:, None]
        arms = Arms(*(np.reshape(values, (-1, 1, 1)) for values in arm))
        above, below = self.parts(1j * turns, mass, arms)
        terms = above / below * (2.0 * np.sin(0.5 * theta) / turns)
        phases = np.exp(-1j * (turns * delay[:, None, None] + 0.5 * theta))
        return np.einsum("hka,dka->dha", terms, phases, optimize=True)

    def largest_compliance(
        self, mass: tuple[float, float], arm: tuple[float, float], beyond: float
    ) -> float:
        """A bound of w^2 |N/D| at s = i w for w >= beyond; infinite if unknown (lemma B20).

        ``mass`` is the smallest and the largest one of the device, ``arm`` the largest stiffness
        and the smallest damping of the arm, of any mass; ``beyond`` an angle in rad per sample.
        """
        light, off, _ = self._response_bounds(mass[0], beyond, "handle", "handle")
        least = light - (1.0 / mass[0] - 1.0 / mass[1]) - off  # of w^2 |h_h/d|, without the arm
        if not least > 0.0:
            return inf
        stiff = arm[0]
        if self.grip is not None:
            grip = self.grip[0] + beyond * self.grip[1]
            damped = beyond * (self.grip[1] + arm[1])
            stiff = grip * (1.0 + grip / damped) if damped else inf
        clear = 1.0 / (light + off) - stiff / beyond**2
        if not clear > 0.0:
            return inf
        most = 1.0 / clear  # of the handle that is held
        if self.shapes is not None or (self.own is not None and self.own.excess is not None):
            # G_em - G_eh G_hm Z/(1 + Z G_hh), and that quotient is (1 - held/free)/free.
            ways = ("encoder", "motor"), ("handle", "motor"), ("encoder", "handle")
            seen, moved, pushed = (self._response_bounds(mass[0], beyond, *w)[2] for w in ways)
            most = seen + moved * pushed / least * (1.0 + most / least)
        weaker = prod(hypot(1.0, beyond / lag) for lag in self.lags)
        return most / weaker

    def _response_bounds(
        self, mass: float, beyond: float, to: str, by: str
    ) -> tuple[float, float, float]:
        """The limit of -w^2 times a response of the device alone, as of the handle by the motor.

        Then for w >= beyond the largest distance from it, and the largest modulus.
        """
        if self.own is not None:
            above = getattr(self.own, to + "_by_hand" * (by == "handle"))
            over, under = (
                sum(abs(c) * beyond**-k for k, c in enumerate(side, start=1))
                for side in (above[2:], self.own.below[1:])
            )
            if above[0] or under >= 1.0:  # of one degree less than the denominator
                return 0.0, inf, inf
            off = (over + abs(above[1]) * under) / (1.0 - under)
            return above[1], off, abs(above[1]) + off
        light = off = most = 0.0
        rigid = mass, self.damping / mass, self.stiffness / mass, Shapes()
        shapes = self.shapes or (Shapes(),) * len(self.modes)
        modes = (
            (moved, 2.0 * damping_ratio * frequency, frequency**2, shape)
            for (frequency, damping_ratio, moved), shape in zip(self.modes, shapes, strict=True)
        )
        for moved, damper, spring, shape in (rigid, *modes):
            rest = damper / beyond + spring / beyond**2
            if rest >= 1.0:
                return 0.0, inf, inf
            share = getattr(shape, to) * getattr(shape, by) / moved
            light, off = light + share, off + abs(share) * rest / (1.0 - rest)
            most += abs(share) / (1.0 - rest)
        return light, off, most


def with_parts(device: Device, mass: float | None, arm: Arms) -> Device:
    """Return a device with another mass, if given, in another arm behind the same grip, if any."""
    dynamics = MassSpringDamper(arm.mass, arm.damping, arm.stiffness)
    hands = device.hands or (Arm.mass_spring_damper(),)
    body: Any = device.mechanism
    mechanism = body if mass is None else replace(body, mass=mass)
    return replace(device, mechanism=mechanism, hands=(replace(hands[0], dynamics=dynamics),))


def _in_floats(ports: Ports, period: float) -> Ports:
    """Ports in units of one sample, coefficients highest power first."""
    below, *numerators = ports
    units = 2, 2, 2, 2, 4  # powers of the period: the excess is a compliance squared
    sides = [None if x is None else in_samples(Rational(x, below), period) for x in numerators]
    falling = [
        side and tuple(float((c / period**unit).mid()) for c in side[0][::-1])
        for side, unit in zip(sides, units, strict=True)
    ]
    assert sides[0] is not None
    return Ports(tuple(float(c.mid()) for c in sides[0][1][::-1]), *falling)


def _vibration(mode: tuple[float, float, float], s: Function) -> Function:
    """The denominator of a mode, 1 at s = 0."""
    frequency, damping_ratio, _ = mode
    ratio = s * (1.0 / frequency)
    return ratio * (ratio + 2.0 * damping_ratio) + 1.0


def _polynomial(falling: tuple[float, ...], s: Function) -> Function:
    """A polynomial of rounded coefficients, highest power of s first."""
    value = s * 0.0 + falling[0]
    for c in falling[1:]:
        value = value * s + c
    if not isinstance(s, Moving | LinearModel):
        return value
    terms = list(zip(map(abs, falling), range(len(falling))[::-1], strict=True))
    own, rate = (
        sum(c * power**k * _size(s) ** max(power - k, 0) for c, power in terms) for k in (0, 1)
    )
    if isinstance(s, LinearModel):
        return _widened(value, PARAMETER * own)
    moved = _widened(value.rate, PARAMETER * rate * s.rate.size)
    return Moving(_widened(value.value, PARAMETER * own), moved)


# Where a straight line parts all loops of a box, and of all stiffnesses up to a limit, from 0.

BEYOND = 1e-9  # boxes extend the angles and a hand's values by this share


def parted(
    none: LinearModel, most: LinearModel, axes: tuple[str, ...]
) -> tuple[Bool[np.ndarray, " box"], Rows]:
    """True where a straight line parts all of g from 0, and what each axis takes from the distance.

    Between the loops without stiffness and those at the limit g is on straight lines.
    """
    any_way = 0.05  # of how far an axis moves g: halving it may help in another direction
    models = (most,) if none is most else (none, most)
    # Across a value, or along what moves g most: the stiffness, the damping, the angle, the hand,
    # whose parts move it along the sides of a rectangle.
    normals = [most.centre]
    if none is not most:
        normals = [none.centre + most.centre, most.centre, none.centre]
        normals.append(1j * (most.centre - none.centre))
    normals += [1j * most.slope[row] for row, axis in enumerate(axes) if axis in _ALONE]
    hand = none.slope[[row for row, axis in enumerate(axes) if axis in HAND]]
    if len(hand):
        largest = np.take_along_axis(hand, np.abs(hand).argmax(axis=0)[None], axis=0)[0]
        normals += [largest, 1j * largest]
    clear = np.full(most.centre.shape, -np.inf)
    shares = np.zeros(most.slope.shape)
    for normal in normals:
        distances, moves = clearances(normal, models)
        nearest = np.minimum(distances[0], distances[-1])
        better = nearest > clear
        clear = np.where(better, nearest, clear)
        parts = [taken(model, by) for model, by in zip(models, moves, strict=True)]
        share = parts[0] if none is most else np.where(distances[0] < distances[1], *parts)
        shares = np.where(better, share, shares)
    return clear > 0.0, shares + any_way * np.abs(most.slope)


def taken(model: LinearModel, moves: Rows) -> Rows:
    """The share of each axis: its move along a normal, and its part of the rest.

    The rest counts as that of the axes that move the model in any direction.
    """
    size = np.abs(model.slope)
    rest = np.where(np.isfinite(model.rest), model.rest, 0.0)
    return moves + rest * size / np.maximum(size.sum(axis=0), 1e-300)


_AT_ONCE = 2048
_ALONE = "damping", "edge", THETA  # axes along which g moves on a line of its own
_FAST = 0.3  # up to this angle all aliases are small
_FEWEST, _MOST = 2, 32  # aliases on either side that are followed, beyond that angle
_LAST = pi * (1.0 + 2.0 * BEYOND)  # no angle is larger
_FAR = 2.0  # times its swing: a larger value is far from 0


class Extent(NamedTuple):
    """Models over boxes, in units of the plant.

    Mass of the device in kg, delay in samples, the arm, the wall's largest stiffness and its
    damping, and the angle; T is the unit of time.
    """

    mass: LinearModel
    delay: LinearModel
    arm: Arms
    stiffness: LinearModel
    damping: LinearModel
    theta: LinearModel

    def as_discs(self) -> "Extent":
        """The plant without moves along the axes."""
        theta, arm = disc(self.theta), Arms(*map(disc, self.arm))
        return self._replace(mass=disc(self.mass), delay=disc(self.delay), arm=arm, theta=theta)


class FirstRow(NamedTuple):
    """Boxes whose walls are all multiples of others and begin with no wall.

    ``holds`` says which boxes are of that kind; ``walls`` returns for such boxes the largest
    stiffness and the damping per unit of the multiple, in units of the plant.
    """

    holds: Callable[[ParameterBoxes], Bool[np.ndarray, " box"]]
    walls: Callable[[ParameterBoxes], tuple[LinearModel, LinearModel]]


class DeviceBoxes:
    """Loops of a held device over boxes.

    Args:
        device: the device; its mass and its arm are not used.
        loop: its loop; the delay is not used.
        mass: the smallest and the largest mass of the device in kg.
        arm: the largest stiffness in N/m and the smallest damping in N s/m of the arm.
        extent: the ``Extent`` of boxes.
        first_row: which of them begin with no wall; then boxes hold all stiffnesses from none up
            to that of the extent. Without it they hold that stiffness alone.
        jitter: by how many samples the delay may exceed that of the extent, in each sample anew.

    Raises:
        NotImplementedError: the device is of another kind, or has modes far above half of the
            sampling rate, or has a hand without damping.
    """

    def __init__(
        self,
        device: Device,
        loop: LoopParameters,
        mass: Range,
        arm: Range,
        extent: Callable[[ParameterBoxes], Extent],
        first_row: FirstRow | None = None,
        jitter: float = 0.0,
    ) -> None:
        self._jitter = jitter * RAISED_MUCH
        period = float(loop.sample_time)
        self._device = HeldDevice.from_device(device, period)
        self._extent, self._first_row = extent, first_row
        filters = known_filters(**loop.filters)
        self._quotients = None if filters is None else quotients(filters)
        self._gain_at_rest = _gain_at_rest(self._quotients)
        arm = arm[0] * period**2, arm[1] * period
        self._slow, self._fast = (
            _Aliases.from_device(self._device, mass, arm, fewest, last)
            for fewest, last in ((0, _FAST), (_FEWEST, _LAST))
        )

    def judged(self, boxes: ParameterBoxes) -> tuple[Bool[np.ndarray, " box"], Rows]:
        """True for boxes that are free of roots, and what halving along each axis would help."""
        beyond = [1.0 + BEYOND * (axis == THETA or axis in HAND) for axis in boxes.axes]
        boxes = replace(boxes, half=boxes.half * np.array(beyond)[:, None])  # ends are rounded
        theta, by_theta = boxes.ends(THETA)
        is_fast = theta + by_theta > _FAST
        free, shares = np.zeros(is_fast.shape, bool), np.zeros(boxes.center.shape)
        for aliases, which in ((self._slow, ~is_fast), (self._fast, is_fast)):
            numbers = np.flatnonzero(which)
            for start in range(0, numbers.size, _AT_ONCE):
                chunk = numbers[start : start + _AT_ONCE]
                parts = self._over(boxes.select(chunk), aliases)
                free[chunk], shares[:, chunk] = parted(*parts, boxes.axes)
        is_near = (theta <= by_theta) & ~is_fast & (self._gain_at_rest.low[0] > 0.0)
        begins = self._begin_without_wall(boxes) & ~is_fast
        for among, method in (
            (is_near, self._are_slow),
            (is_near & begins, self._grow_slowly),
            (begins & (theta > by_theta), self._grow),
        ):
            chosen = np.flatnonzero(among & ~free)
            if chosen.size:
                clear, taken_there = method(boxes.select(chosen))
                free[chosen] = clear
                hopeful = taken_there.any(axis=0)
                shares[:, chosen[hopeful]] = taken_there[:, hopeful]
        return free, shares

    def _over(self, boxes: ParameterBoxes, aliases: "_Aliases") -> tuple[LinearModel, LinearModel]:
        """Return F over boxes, at the least stiffness and at the largest one."""
        place = self._extent(boxes)
        above, below = self._device.parts(place.theta * 1j, place.mass, place.arm)
        total, moduli = self._others(place, aliases)
        force = sinc(place.theta).value * above + sine(place.theta) * below * total
        force = phasor(place.theta * (place.delay + 0.5)) * force
        position, velocity = self._filters(place.theta)
        damper, spring = place.damping * velocity.value, place.stiffness * position.value
        late = sine(place.theta).size * self._late(above, below, moduli)
        wall = damper + spring
        most = _widened(below + wall * force, _times(late, wall.size))
        if self._first_row is None:
            return most, most
        return _widened(below + damper * force, _times(late, damper.size)), most

    def _are_slow(self, boxes: ParameterBoxes) -> tuple[Bool[np.ndarray, " box"], Rows]:
        """True for boxes in which the imaginary part of F grows with theta, from 0 on, where F > 0.

        Walls from no stiffness on begin with a device that may be free; there F(0) is 0 by itself.
        With modes of unlike shapes a stiffness may push the encoder away, N(0) < 0.
        """
        place = self._extent(boxes)
        above, below = self._device.parts(_moving_s(place.theta), place.mass, place.arm)
        damper, most = self._walls(place.theta, place.stiffness, place.damping)
        least = most if self._first_row is None else damper
        force, (total, moduli) = self._force(place, above), self._others(place, self._slow)
        taken_away = below.value.size * total.size + self._late(above, below, moduli)
        free, shares = _rising(
            [((below + wall * force).rate, wall.value.size * taken_away) for wall in (least, most)]
        )
        above, below = self._device.parts(place.theta.constant(0.0), place.mass, place.arm)
        above = place.theta.constant(1.0) * above
        holds = (below + place.stiffness * self._gain_at_rest * above).low > 0.0
        if self._first_row is not None:  # D(0) >= 0, and any stiffness adds to it
            holds |= above.low > 0.0
        return free & holds, shares

    def _begin_without_wall(self, boxes: ParameterBoxes) -> Bool[np.ndarray, " box"]:
        """True for boxes in a first row that begins without a wall, of a passive device."""
        if self._first_row is None or not self._device.is_passive:
            return np.zeros(boxes.index.shape, bool)
        return self._first_row.holds(boxes)

    def _grow(self, boxes: ParameterBoxes) -> tuple[Bool[np.ndarray, " box"], Rows]:
        """True for boxes of a first row in which all walls dissipate energy (lemma B20)."""
        place, aliases = self._extent(boxes), self._slow
        above, below = self._device.parts(place.theta * 1j, place.mass, place.arm)
        turned = conjugate(boxes.constant(1.0) * above * self._device.lag(place.theta * 1j))
        total, moduli = self._others(place, aliases)
        force = sinc(place.theta).value * above + sine(place.theta) * below * total
        force = phasor(place.theta * (place.delay + 0.5)) * force * turned
        late = _times(sine(place.theta).size * self._late(above, below, moduli), turned.size)
        walls = self._walls(place.theta, *self._wall_of_first_row(boxes))
        return _rising(
            [(wall.value * force, _times(late, wall.value.size)) for wall in walls], below
        )

    def _grow_slowly(self, boxes: ParameterBoxes) -> tuple[Bool[np.ndarray, " box"], Rows]:
        """The same next to theta = 0, by the derivative."""
        place = self._extent(boxes)
        s = _moving_s(place.theta)
        above, below = self._device.parts(s, place.mass, place.arm)
        turned = Moving(boxes.constant(1.0), boxes.constant(0.0)) * above * self._device.lag(s)
        turned = Moving(conjugate(turned.value), conjugate(turned.rate))
        force = self._force(place, above) * turned
        total, moduli = self._others(place, self._slow)
        taken_away = below.value.size * total.size + self._late(above, below, moduli)
        taken_away = taken_away * turned.value.size
        walls = self._walls(place.theta, *self._wall_of_first_row(boxes))
        rates = [((wall * force).rate, wall.value.size * taken_away) for wall in walls]
        return _rising(rates, below.value)

    def _late(self, above: Function, below: Function, moduli: np.ndarray) -> np.ndarray:
        """Return a bound of J (|N| + |D| R')."""
        if not self._jitter:
            return np.zeros_like(moduli)  # though a size may be infinite
        late: np.ndarray = self._jitter * (_size(above) + _size(below) * moduli)
        return late * RAISED_MUCH

    def _force(self, place: Extent, above: Any) -> Moving:
        """Return the held force behind the delay times N, without aliases."""
        lag = place.delay + 0.5
        wave = phasor(place.theta * lag)
        return sinc(place.theta) * above * Moving(wave, wave * lag * -1j)

    def _walls(
        self, theta: LinearModel, alpha: LinearModel, beta: LinearModel
    ) -> tuple[Moving, Moving]:
        """Return H without stiffness and at the limit."""
        position, velocity = self._filters(theta)
        damper = velocity * beta
        return damper, damper + position * alpha

    def _wall_of_first_row(self, boxes: ParameterBoxes) -> tuple[LinearModel, LinearModel]:
        """Return the wall per unit of the multiple, in boxes that begin without a wall."""
        assert self._first_row is not None
        return self._first_row.walls(boxes)

    def _filters(self, theta: LinearModel) -> tuple[Moving, Moving]:
        """Return P and V in units of one sample, with their derivatives by theta."""
        if self._quotients is not None:
            position, velocity = (quotient.over(theta) for quotient in self._quotients)
            return position, velocity
        one, back = theta.constant(1.0), phasor(theta)
        return Moving(one, theta.constant(0.0)), Moving(1.0 - back, back * 1j)

    def _others(self, place: Extent, aliases: "_Aliases") -> tuple[LinearModel, np.ndarray]:
        """Return R, and a bound of R'; ``_late`` counts the rounding of that sum."""
        discs = place.as_discs()
        total = _widened(place.theta.constant(0.0 + 0.0j), aliases.tail)
        moduli = np.full(place.theta.centre.shape, aliases.tail_of_moduli)
        for turns, nearest, most in aliases.followed:
            # The nearest one is followed along the axes.
            alias = self._alias(place if turns == -1 else discs, turns)
            angle = place.theta + 2.0 * pi * turns
            moduli = moduli + np.minimum(alias.size * angle.size, most * nearest)
            is_known = alias.swing < most
            centre = np.where(is_known, alias.centre, 0.0)
            slope = np.where(is_known, alias.slope, 0.0)
            alias = LinearModel(centre, slope, np.where(is_known, alias.rest, most))
            total = total + on_axes_of(alias, total)
        return total, moduli

    def _alias(self, place: Extent, turns: int) -> LinearModel:
        angle = place.theta + 2.0 * pi * turns
        above, below = self._device.parts(angle * 1j, place.mass, place.arm)
        wave = phasor(place.delay * (2.0 * pi * turns))
        return above * wave * (below * angle).reciprocal()


def _gain_at_rest(of: tuple[Quotient, Quotient] | None) -> LinearModel:
    """P(1), with the rounding of its coefficients."""
    still = LinearModel(np.zeros(1), np.zeros((1, 1)), np.zeros(1))
    if of is None:
        return still.constant(1.0)
    value = of[0].over(still).value
    return replace(value, centre=value.centre.real)


class _Aliases(NamedTuple):
    """The aliases whose sum is R.

    ``followed`` are those that are followed, as k of theta + 2 pi k, each with the least modulus of
    that angle and a bound; ``tail`` is a bound of the sum of all others, ``tail_of_moduli`` of what
    they add to R'.
    """

    followed: tuple[tuple[int, float, float], ...]
    tail: float
    tail_of_moduli: float

    @classmethod
    def from_device(
        cls,
        device: HeldDevice,
        mass: tuple[float, float],
        arm: tuple[float, float],
        fewest: int,
        last: float,
    ) -> "_Aliases":
        """Return aliases for angles up to ``last``, enough that those left out are bounded."""
        for count in range(fewest, _MOST + 1):
            near, far = 2.0 * pi * (count + 1) - last, 2.0 * pi * (count + 1)
            most = device.largest_compliance(mass, arm, near)
            if most < np.inf:
                break
        else:
            raise NotImplementedError(
                "a guard is proved for devices whose modes are not far above the sampling rate, "
                "and for hands that a grip or an arm damps; this one has no bound at high "
                f"frequencies: {device}."
            )
        tail = most * (near**-3 + far**-3 + 1.0 / (2.0 * pi * far**2)) * RAISED_MUCH
        moduli = most * (near**-2 + far**-2 + 1.0 / (pi * far)) * RAISED_MUCH
        followed = []
        for turns in [sign * k for k in range(1, count + 1) for sign in (-1, 1)]:
            nearest = 2.0 * pi * abs(turns) - (last if turns < 0 else 0.0)
            most = device.largest_compliance(mass, arm, nearest)
            followed.append((turns, nearest, most / nearest**3 * RAISED_MUCH))
        return cls(tuple(followed), tail, moduli)


# ------------------------------------------------------------------------------------------ models
def _rising(
    rates: list[tuple[LinearModel, Any]], below: LinearModel | None = None
) -> tuple[Bool[np.ndarray, " box"], Rows]:
    """True where all imaginary parts exceed the other terms, and what each axis takes.

    That is 0 where halving cannot help, or need not because ``below`` is far from 0.
    """
    clear, shares, most = [], [], []
    for rate, others in rates:
        moves = np.abs(rate.slope.imag)
        clear.append(rate.centre.imag - moves.sum(axis=0) - rate.rest - others * RAISED_MUCH)
        most.append(rate.centre.imag + moves.sum(axis=0) + rate.rest)
        shares.append(taken(rate, moves))
    taken_there = np.where(clear[0] < clear[1], *shares)
    if below is not None:
        is_far = np.abs(below.centre) > _FAR * below.swing
        taken_there = np.where((np.minimum(*most) > 0.0) & ~is_far, taken_there, 0.0)
    return np.minimum(*clear) > 0.0, taken_there


def _times(late: Any, size: Any) -> Any:
    """Return a product of bounds; 0 where nothing is late, though a size may be infinite."""
    with np.errstate(invalid="ignore"):
        return np.where(late == 0.0, 0.0, late * size)


def _widened(model: LinearModel, by: Any) -> LinearModel:
    """Return a model with a larger rest."""
    return replace(model, rest=model.rest + by)


def _size(function: Any) -> Any:
    """Return a bound of the modulus of a function, with its derivative or without, or a number."""
    function = function.value if isinstance(function, Moving) else function
    return function.size if isinstance(function, LinearModel) else abs(function)


def _moving_s(theta: LinearModel) -> Moving:
    """Return i theta, with its derivative."""
    return Moving(theta * 1j, theta.constant(1j))
