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

from jaxstab.model import Device, LoopParameters
from jaxstab.model import Hand as Arm
from jaxstab.model.device.parts import MassSpringDamper, Modes
from jaxstab.model.filters import known_filters
from jaxstab.proofs.enclosures import (
    LinearModel,
    Moving,
    clearances,
    conjugate,
    disc,
    on_axes_of,
    phasor,
    sinc,
    sine,
    variable,
)
from jaxstab.proofs.filters import OverCells, filter_cells
from jaxstab.rounding import PARAMETER, RAISED_MUCH

# A device with its vibration modes, actuators and a held grip, of any mass, for any hand.
#
# In units of one sample, with s = i theta or any other number, position over force is N(s)/D(s).
# Both are polynomials that are affine in the mass of the device and in what the arm is made of.

_ALIASES = 4  # on either side, that responses without a bound add up

Function = Any  # a number, an array or a model of a function over boxes


class Arms(NamedTuple):
    """What the arm is made of: mass in kg; stiffness and damping in units of one sample, too."""

    mass: Function
    stiffness: Function
    damping: Function


class HeldDevice(NamedTuple):
    """A device of any mass in the hand of any arm, in units of one sample and kg.

    The rigid body has the damping b T and the stiffness k T^2 to the ground. ``modes`` are angular
    frequency, damping ratio and mass of the vibration modes, ``lags`` angular frequencies of the
    actuators, ``grip`` its stiffness and damping; None if the arm is rigidly attached.
    """

    damping: float
    stiffness: float
    modes: tuple[tuple[float, float, float], ...]
    lags: tuple[float, ...]
    grip: tuple[float, float] | None

    @classmethod
    def from_device(cls, device: Device, period: float) -> "HeldDevice":
        """A device, for some sampling period in s.

        NotImplementedError: the device has no mass that could change, or the hand is not one mass,
        spring and damper, or slips out of its grip.
        """
        body = _body_of(device)
        springs = body.stiffness if isinstance(body, MassSpringDamper) else 0.0
        modes = body.modes if isinstance(body, Modes) else ()
        grips = [hand.grip for hand in device.hands if hand.grip is not None]
        return cls(
            body.damping * period,
            springs * period**2,
            tuple(
                (2.0 * pi * mode.frequency * period, mode.damping_ratio, mode.modal_mass)
                for mode in modes
            ),
            tuple(2.0 * pi * hertz * period for hertz in device.bandwidths),
            (grips[0].stiffness * period**2, grips[0].damping * period) if grips else None,
        )

    def parts(self, s: Function, mass: Function, arm: Arms) -> tuple[Function, Function]:
        """Return N(s) and D(s) in 1/kg, of numbers, arrays or models."""
        # The square comes last: only it takes from the stiffness, which is rounded.
        body = (s * self.damping + self.stiffness) + s * s * mass
        held = s * (s * arm.mass + arm.damping) + arm.stiffness
        above, below = 1.0, body
        if self.modes:
            give, whole = self._vibrations(s)
            above, below = body * give + whole, body * whole
        if self.grip is None:
            below = below + held * above
        else:
            # Of a unit of the stiffer one, so that a pure spring and a pure damper are of size 1.
            unit = 1.0 / (self.grip[0] + self.grip[1])
            between = s * (self.grip[1] * unit) + self.grip[0] * unit
            both = held * unit + between
            below = below * both + held * between * above
            above = both * above
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
        """Whether device and arm, without actuators, are passive."""
        return all(moved > 0.0 for _, _, moved in self.modes)

    def _vibrations(self, s: Function) -> tuple[Function, Function]:
        """Return numerator and denominator of the sum of the modes' displacements over force."""
        give, whole = 0.0, 1.0
        for frequency, damping_ratio, moved in self.modes:
            ratio = s * (1.0 / frequency)
            below = ratio * (ratio + 2.0 * damping_ratio) + 1.0
            give, whole = below * give + whole * (1.0 / (moved * frequency**2)), below * whole
        return give, whole

    def response(
        self,
        mass: float,
        arm: Arms,
        delay: Float64[np.ndarray, " delay"],
        theta: Float64[np.ndarray, " angle"],
    ) -> Complex128[np.ndarray, "delay arm angle"]:
        """Sampled position over force on the unit circle, to about 1e-3 (lemma B20)."""
        turns = theta + 2.0 * pi * np.arange(-_ALIASES, _ALIASES + 1)[:, None]
        arms = Arms(*(np.reshape(values, (-1, 1, 1)) for values in arm))
        above, below = self.parts(1j * turns, mass, arms)
        terms = above / below * (2.0 * np.sin(0.5 * theta) / turns)
        phases = np.exp(-1j * (turns * delay[:, None, None] + 0.5 * theta))
        sums: np.ndarray = np.einsum("hka,dka->dha", terms, phases, optimize=True)
        return sums

    def largest_compliance(
        self, mass: tuple[float, float], arm: tuple[float, float], beyond: float
    ) -> float:
        """A bound of w^2 |N/D| at s = i w for w >= beyond; infinite if unknown (lemma B20).

        ``mass`` is the smallest and the largest one of the device, ``arm`` the largest stiffness
        and the smallest damping of the arm, of any mass; ``beyond`` an angle in rad per sample.
        """
        light = off = 0.0
        for moved, damper, spring in self._bodies(mass[0], beyond):
            if damper + spring >= 1.0:
                return inf
            light += 1.0 / moved
            off += (damper + spring) / (abs(moved) * (1.0 - damper - spring))
        stiff = arm[0]
        if self.grip is not None:
            grip = self.grip[0] + beyond * self.grip[1]
            damped = beyond * (self.grip[1] + arm[1])
            stiff = grip * (1.0 + grip / damped) if damped else inf
        clear = 1.0 / (light + off) - stiff / beyond**2
        weaker = prod(hypot(1.0, beyond / lag) for lag in self.lags)
        is_known = off < light - (1.0 / mass[0] - 1.0 / mass[1]) and clear > 0.0
        return 1.0 / (clear * weaker) if is_known else inf

    def _bodies(self, mass: float, beyond: float) -> list[tuple[float, float, float]]:
        """Return moving masses, each with bounds of its damping and spring forces over inertia."""
        own = mass, self.damping / (mass * beyond), self.stiffness / (mass * beyond**2)
        ratios = [frequency / beyond for frequency, _, _ in self.modes]
        return [own] + [
            (moved, 2.0 * damping_ratio * ratio, ratio**2)
            for (_, damping_ratio, moved), ratio in zip(self.modes, ratios, strict=True)
        ]


def with_parts(device: Device, mass: float | None, arm: Arms) -> Device:
    """Return a device with another mass, if given, in another arm behind the same grip, if any."""
    dynamics = MassSpringDamper(arm.mass, arm.damping, arm.stiffness)
    hands = device.hands or (Arm.mass_spring_damper(),)
    body: Any = device.mechanism
    mechanism = body if mass is None else replace(body, mass=mass)
    return replace(device, mechanism=mechanism, hands=(replace(hands[0], dynamics=dynamics),))


def _body_of(device: Device) -> MassSpringDamper | Modes:
    body, hands = device.mechanism, device.hands
    fits = isinstance(body, MassSpringDamper) or (isinstance(body, Modes) and body.mass is not None)
    fits &= len(hands) <= 1 and all(isinstance(hand.dynamics, MassSpringDamper) for hand in hands)
    fits &= all(hand.grip is None or hand.grip.stiffness > 0.0 for hand in hands)
    if not fits or not isinstance(body, MassSpringDamper | Modes):
        raise NotImplementedError(
            "a guard is proved for a mass with vibration modes, actuators and one hand of mass, "
            f"spring and damper, behind a grip with a spring or rigidly attached; this is {device}."
        )
    return body


# Where a straight line parts all loops of a box, and of all stiffnesses up to a limit, from 0.

Boxes = Float64[np.ndarray, "axis box"]

NAMES = "mass", "delay", "damping", "hand_mass", "hand_stiffness", "hand_damping", "theta"
AXES = len(NAMES)
_HAND = slice(3, 6)
BEYOND = 1e-9  # boxes extend the angles and a hand's values by this share
_ANY_WAY = 0.05  # of how far an axis moves g: halving it may help in another direction


def parted(none: LinearModel, most: LinearModel) -> tuple[Bool[np.ndarray, " box"], Boxes]:
    """Say where a straight line parts all of g from 0, and what each axis takes from the distance.

    Between the loops without stiffness and those at the limit g is on straight lines.
    """
    between = most.centre - none.centre
    hand = none.slope[_HAND]
    largest = np.take_along_axis(hand, np.abs(hand).argmax(axis=0)[None], axis=0)[0]
    # Across a value, or along what moves g most: the stiffness, the damping, the angle, the hand,
    # whose parts move it along the sides of a rectangle
    normals = [none.centre + most.centre, most.centre, none.centre, largest]
    normals += [1j * way for way in (between, most.slope[2], most.slope[6], largest)]
    clear = np.full(between.shape, -np.inf)
    shares = np.zeros(none.slope.shape)
    for normal in normals:
        distances, moves = clearances(normal, (none, most))
        nearest = np.minimum(*distances)
        better = nearest > clear
        clear = np.where(better, nearest, clear)
        parts = [taken(model, by) for model, by in zip((none, most), moves, strict=True)]
        shares = np.where(better, np.where(distances[0] < distances[1], *parts), shares)
    return clear > 0.0, shares + _ANY_WAY * np.abs(most.slope)


def taken(model: LinearModel, moves: Boxes) -> Boxes:
    """Return what each axis takes: its move along a normal, and its part of the rest.

    The rest counts as that of the axes that move the model in any direction.
    """
    size = np.abs(model.slope)
    rest = np.where(np.isfinite(model.rest), model.rest, 0.0)
    shares: Boxes = moves + rest * size / np.maximum(size.sum(axis=0), 1e-300)
    return shares


Range = tuple[float, float]

MASS, DELAY, DAMPING = 0, 1, 2

"""The axes whose meaning is that of an extent; then follow the arm's three, and theta."""

_ARM, _THETA = 3, 6
_AT_ONCE = 2048
_FAST = 1.0  # up to this angle all aliases are small
_FEWEST, _MOST = 2, 32  # aliases on either side that are followed, beyond that angle
_LAST = pi * (1.0 + 2.0 * BEYOND)  # no angle is larger
_FAR = 2.0  # times its swing: a larger value is far from 0


class Extent(NamedTuple):
    """Models over boxes; the arm and the angle are axes of the boxes.

    Mass of the device in kg, delay in samples, the wall's largest stiffness in N/m and its damping
    in N s/m.
    """

    mass: LinearModel
    delay: LinearModel
    stiffness: LinearModel
    damping: LinearModel


class FirstRow(NamedTuple):
    """Boxes whose walls are all multiples of others and begin with no wall.

    ``holds`` says, by their middles, which boxes are of that kind; ``walls`` returns, for middles
    and half-widths of such boxes, the largest stiffness in N/m and the damping in N s/m per unit of
    the multiple.
    """

    holds: Callable[[Boxes], Bool[np.ndarray, " box"]]
    walls: Callable[[Boxes, Boxes], tuple[LinearModel, LinearModel]]


class _Place(NamedTuple):
    """What the plant depends on, over boxes."""

    mass: LinearModel
    delay: LinearModel
    arm: Arms
    theta: LinearModel

    def as_discs(self) -> "_Place":
        """Return the same without moves along the axes."""
        arm = Arms(*map(disc, self.arm))
        return _Place(disc(self.mass), disc(self.delay), arm, disc(self.theta))


class DeviceBoxes:
    """Loops of a held device over boxes.

    Args:
        device: the device; its mass and its arm are not used.
        loop: its loop; the delay is not used.
        mass: the smallest and the largest mass of the device in kg.
        arm: the largest stiffness in N/m and the smallest damping in N s/m of the arm.
        extent: returns the ``Extent`` of boxes, for their middles and half-widths.
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
        extent: Callable[[Boxes, Boxes], Extent],
        first_row: FirstRow | None = None,
        jitter: float = 0.0,
    ) -> None:
        self._jitter = jitter * RAISED_MUCH
        self._period = float(loop.sample_time)
        self._device = HeldDevice.from_device(device, self._period)
        self._extent, self._first_row = extent, first_row
        filters = known_filters(**loop.filters)
        self._cells = None if filters is None else filter_cells(filters)
        resting = self._filters(_constant(np.zeros(1)))[0].value
        self._passes_rest = bool(resting.centre.real[0] > resting.rest[0])  # P(1) > 0
        arm = arm[0] * self._period**2, arm[1] * self._period
        self._slow, self._fast = (
            _Aliases.from_device(self._device, mass, arm, fewest, last)
            for fewest, last in ((0, _FAST), (_FEWEST, _LAST))
        )

    def judged(self, center: Boxes, half: Boxes) -> tuple[Bool[np.ndarray, " box"], Boxes]:
        """Say which boxes are free of roots, and what halving along each axis would help."""
        half = np.concatenate([half[:3], half[3:] * (1.0 + BEYOND)])  # whose ends are rounded
        is_fast = center[_THETA] + half[_THETA] > _FAST
        free, shares = np.zeros(is_fast.shape, bool), np.zeros(center.shape)
        for aliases, which in ((self._slow, ~is_fast), (self._fast, is_fast)):
            boxes = np.flatnonzero(which)
            for start in range(0, boxes.size, _AT_ONCE):
                chunk = boxes[start : start + _AT_ONCE]
                parts = self.over(center[:, chunk], half[:, chunk], aliases)
                free[chunk], shares[:, chunk] = parted(*parts)
        is_near = (center[_THETA] <= half[_THETA]) & ~is_fast & self._passes_rest
        begins = self._begin_without_wall(center) & ~is_fast
        for among, method in (
            (is_near, self._are_slow),
            (is_near & begins, self._grow_slowly),
            (begins & (center[_THETA] > half[_THETA]), self._grow),
        ):
            chosen = np.flatnonzero(among & ~free)
            if chosen.size:
                clear, taken_there = method(center[:, chosen], half[:, chosen])
                free[chosen] = clear
                hopeful = taken_there.any(axis=0)
                shares[:, chosen[hopeful]] = taken_there[:, hopeful]
        return free, shares

    def over(
        self, center: Boxes, half: Boxes, aliases: "_Aliases"
    ) -> tuple[LinearModel, LinearModel]:
        """Return F over boxes, at the least stiffness and at the largest one."""
        place, alpha, beta = self._parts(center, half)
        above, below = self._device.parts(place.theta * 1j, place.mass, place.arm)
        others = self._others(place, aliases)
        force = sinc(place.theta).value * above + sine(place.theta) * below * others.total
        force = phasor(place.theta * (place.delay + 0.5)) * force
        position, velocity = self._filters(place.theta)
        damper, spring = beta * velocity.value, alpha * position.value
        none = below + damper * force
        most = none + spring * force
        late = sine(place.theta).size * self._late(above, below, others)
        none = _widened(none, late * damper.size)
        most = _widened(most, late * (damper + spring).size)
        return (most if self._first_row is None else none), most

    def _are_slow(self, center: Boxes, half: Boxes) -> tuple[Bool[np.ndarray, " box"], Boxes]:
        """Say in which boxes the imaginary part of F grows with theta, from 0 on, where F > 0."""
        place, alpha, beta = self._parts(center, half)
        above, below = self._device.parts(_moving_s(place.theta), place.mass, place.arm)
        damper, most = self._walls(place.theta, alpha, beta)
        least = most if self._first_row is None else damper
        force, others = self._force(place, above), self._others(place, self._slow)
        taken_away = below.value.size * others.total.size + self._late(above, below, others)
        free, shares = _rising(
            [((below + wall * force).rate, wall.value.size * taken_away) for wall in (least, most)]
        )
        return free & ((self._first_row is not None) | (alpha.low > 0.0)), shares

    def _begin_without_wall(self, center: Boxes) -> Bool[np.ndarray, " box"]:
        """Say which boxes are in a first row that begins without a wall, of a passive device."""
        if self._first_row is None or not self._device.is_passive:
            return np.zeros(center.shape[1], bool)
        return self._first_row.holds(center)

    def _grow(self, center: Boxes, half: Boxes) -> tuple[Bool[np.ndarray, " box"], Boxes]:
        """Say in which boxes of a first row all walls dissipate energy (lemma B20)."""
        place, aliases = self._parts(center, half)[0], self._slow
        above, below = self._device.parts(place.theta * 1j, place.mass, place.arm)
        ones = _constant(np.ones_like(center[0]))
        turned = conjugate(ones * above * self._device.lag(place.theta * 1j))
        others = self._others(place, aliases)
        force = sinc(place.theta).value * above + sine(place.theta) * below * others.total
        force = phasor(place.theta * (place.delay + 0.5)) * force * turned
        late = sine(place.theta).size * self._late(above, below, others) * turned.size
        walls = self._walls(place.theta, *self._wall_of_first_row(center, half))
        return _rising([(wall.value * force, wall.value.size * late) for wall in walls], below)

    def _grow_slowly(self, center: Boxes, half: Boxes) -> tuple[Bool[np.ndarray, " box"], Boxes]:
        """Say the same next to theta = 0, by the derivative."""
        place = self._parts(center, half)[0]
        s = _moving_s(place.theta)
        above, below = self._device.parts(s, place.mass, place.arm)
        ones = Moving(_constant(np.ones_like(center[0])), _constant(np.zeros_like(center[0])))
        turned = ones * above * self._device.lag(s)
        turned = Moving(conjugate(turned.value), conjugate(turned.rate))
        force = self._force(place, above) * turned
        others = self._others(place, self._slow)
        taken_away = below.value.size * others.total.size + self._late(above, below, others)
        taken_away = taken_away * turned.value.size
        walls = self._walls(place.theta, *self._wall_of_first_row(center, half))
        rates = [((wall * force).rate, wall.value.size * taken_away) for wall in walls]
        return _rising(rates, below.value)

    def _late(self, above: Function, below: Function, others: "_Others") -> np.ndarray:
        """Return a bound of J (|N| + |D| R')."""
        if not self._jitter:
            return np.zeros_like(others.moduli)  # though a size may be infinite
        late: np.ndarray = self._jitter * (_size(above) + _size(below) * others.moduli)
        return late * RAISED_MUCH

    def _force(self, place: _Place, above: Any) -> Moving:
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

    def _parts(self, center: Boxes, half: Boxes) -> tuple[_Place, LinearModel, LinearModel]:
        """Return what the plant depends on, and the largest alpha and beta, in units of 1 kg."""
        extent = self._extent(center, half)
        units = 1.0, self._period**2, self._period
        arm = [
            along(_ARM + k, center[_ARM + k] * unit, half[_ARM + k] * unit)
            for k, unit in enumerate(units)
        ]
        theta = along(_THETA, center[_THETA], half[_THETA])
        place = _Place(extent.mass, extent.delay, Arms(*arm), theta)
        return place, extent.stiffness * self._period**2, extent.damping * self._period

    def _wall_of_first_row(self, center: Boxes, half: Boxes) -> tuple[LinearModel, LinearModel]:
        """Return alpha and beta per unit of the multiple, in boxes that begin without a wall."""
        assert self._first_row is not None
        stiffness, damping = self._first_row.walls(center, half)
        return stiffness * self._period**2, damping * self._period

    def _filters(self, theta: LinearModel) -> tuple[Moving, Moving]:
        """Return P and V in units of one sample, with their derivatives by theta."""
        angle, half = theta.centre, theta.slope[_THETA]
        if self._cells is not None:
            over = OverCells.from_cells(self._cells, angle, half)
            position, velocity = map(Moving, over.values_along(AXES), over.rates_along(AXES))
            return position, velocity
        ones, zeros = _constant(np.ones_like(angle)), _constant(np.zeros_like(angle))
        back = phasor(theta)
        return Moving(ones, zeros), Moving(1.0 - back, back * 1j)

    def _others(self, place: _Place, aliases: "_Aliases") -> "_Others":
        """Return R and R'."""
        discs = place.as_discs()
        total = _widened(_constant(np.zeros(place.theta.centre.shape, complex)), aliases.tail)
        moduli = np.full(place.theta.centre.shape, aliases.tail_of_moduli)
        for turns, nearest, most in aliases.followed:
            # The nearest one is followed along the axes.
            alias = self._alias(place if turns == -1 else discs, turns)
            angle = place.theta + 2.0 * pi * turns
            moduli = moduli + np.minimum(alias.size * angle.size, most * nearest)
            is_known = alias.swing < most
            centre = np.where(is_known, alias.centre, 0.0)
            slope = np.where(is_known, alias.slope, 0.0)
            alias = LinearModel(centre, slope, np.where(is_known, alias.rest, most), alias.half)
            total = total + on_axes_of(alias, total)
        return _Others(total, moduli * RAISED_MUCH)

    def _alias(self, place: _Place, turns: int) -> LinearModel:
        angle = place.theta + 2.0 * pi * turns
        above, below = self._device.parts(angle * 1j, place.mass, place.arm)
        wave = phasor(place.delay * (2.0 * pi * turns))
        return above * wave * (below * angle).reciprocal()


class _Others(NamedTuple):
    """R, and a bound of R'."""

    total: LinearModel
    moduli: np.ndarray


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
) -> tuple[Bool[np.ndarray, " box"], Boxes]:
    """Say where all imaginary parts exceed the other terms, and what each axis takes.

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


def _widened(model: LinearModel, by: Any) -> LinearModel:
    """Return a model with a larger rest."""
    return replace(model, rest=model.rest + by)


def _size(function: Any) -> Any:
    """Return a bound of the modulus of a function, with its derivative or without, or a number."""
    function = function.value if isinstance(function, Moving) else function
    return function.size if isinstance(function, LinearModel) else abs(function)


def _moving_s(theta: LinearModel) -> Moving:
    """Return i theta, with its derivative."""
    return Moving(theta * 1j, _constant(1j * np.ones_like(theta.centre)))


def along(axis: int, centre: np.ndarray, half: np.ndarray) -> LinearModel:
    """Return a variable that runs along an axis."""
    exact = variable(axis, AXES, centre, half)
    return replace(exact, rest=PARAMETER * np.abs(centre))


def _constant(centre: np.ndarray) -> LinearModel:
    """Return functions that are constant in each box."""
    slope = np.zeros((AXES, centre.size))
    return LinearModel(centre, slope, np.zeros(centre.size), np.ones((AXES, 1)))
