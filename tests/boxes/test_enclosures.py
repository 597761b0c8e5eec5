"""Bounds of what expansions leave (lemmas B13, B14 and B20): none too small, each attained.

Functions are taken at the end of a box that is worst for them, in exact fractions or 50 digits. A
bound is attained if it is at most ``SHARP`` times what it bounds there: halved, it would be wrong.
"""

from collections.abc import Callable
from fractions import Fraction
from itertools import product

import mpmath
import numpy as np
import pytest

from jaxstab import Filter, Velocity
from jaxstab.boxes.enclosures import (
    LinearModel,
    Moving,
    ParameterBoxes,
    phasor,
    quotients,
    sinc,
    sine,
    variable,
)
from jaxstab.boxes.plant import (
    Arms,
    DeviceBoxes,
    Extent,
    HeldDevice,
    _Aliases,
    _moving_s,
    _polynomial,
)
from jaxstab.model.device.parts import Ports, Shapes
from jaxstab.rounding import ELEMENTARY, LINEAR_MODEL, PARAMETER

SHARP = 1.5
ROUNDED = 1.0 + 1e-12  # the bounds are float64, too


def model(centre: float, slope: float, rest: float, half: float) -> LinearModel:
    """A function of one variable over one box."""
    return LinearModel(np.array([centre]), np.array([[slope * half]]), np.array([rest]))


def at(made: LinearModel, move: float) -> Fraction:
    """What a model says where its variable has moved by so much."""
    return Fraction(float(made.centre[0])) + Fraction(float(made.slope[0, 0])) * Fraction(move)


def ends(centre: float, slope: float, rest: float, half: float) -> list[tuple[float, Fraction]]:
    """Both ends of a box, and values there that a model allows."""
    exact = Fraction(centre), Fraction(slope), Fraction(rest)
    return [
        (side, exact[0] + side * exact[1] * Fraction(half) + way * exact[2])
        for side, way in product((-1, 1), (-1, 1))
    ]


NUMBERS = [
    (1.5, 0.5, 0.25, 0.5),
    (-1.5, 0.5, 0.0, 0.25),
    (2.0, -0.75, 0.5, 0.5),
    (-1.75, -0.5, 0.125, 0.25),
    (1.25, 0.0, 0.5, 0.5),
]


@pytest.mark.parametrize("one", NUMBERS)
@pytest.mark.parametrize("other", NUMBERS)
def test_the_rest_of_a_product_is_attained(
    one: tuple[float, ...], other: tuple[float, ...]
) -> None:
    other = (*other[:3], one[3])
    made = model(*one) * model(*other)
    errors = [
        abs(f * g - at(made, move))
        for (move, f), (again, g) in product(ends(*one), ends(*other))
        if move == again
    ]
    assert max(errors) <= made.rest[0]
    # Where slopes and centres have opposite signs, not all terms add up.
    assert made.rest[0] <= 4.0 * max(errors)
    if min(one[0] * one[1], other[0] * other[1]) >= 0.0 or one == other:
        assert made.rest[0] <= SHARP * max(errors)


@pytest.mark.parametrize("numbers", NUMBERS)
def test_the_rest_of_an_inverse_is_attained(numbers: tuple[float, ...]) -> None:
    made = model(*numbers).reciprocal()
    errors = [abs(1 / f - at(made, move)) for move, f in ends(*numbers)]
    assert max(errors) <= made.rest[0] <= max(errors) + Fraction(1, 10**13)


def test_what_may_vanish_has_no_inverse() -> None:
    assert np.isinf(model(1.0, 2.0, 0.25, 0.375).reciprocal().rest[0])
    assert np.isfinite(model(1.0, 2.0, 0.25, 0.37).reciprocal().rest[0])


@pytest.mark.parametrize("numbers", NUMBERS)
def test_sums_keep_what_their_terms_leave(numbers: tuple[float, ...]) -> None:
    twice, other = model(*numbers) - model(0.5, -0.25, 1.0, numbers[3]), 2.0 * model(*numbers)
    assert numbers[2] + 1.0 <= twice.rest[0] <= (numbers[2] + 1.0) * ROUNDED
    assert 2.0 * numbers[2] <= other.rest[0] <= 2.0 * numbers[2] + 1e-13
    low, high = min(f for _, f in ends(*numbers)), max(f for _, f in ends(*numbers))
    made = model(*numbers)
    assert made.low[0] == float(low)
    assert made.size[0] == max(abs(low), abs(high))


@pytest.mark.parametrize(
    ("of", "true", "centre"),
    [
        (phasor, lambda x: mpmath.exp(-1j * x), 0.7),
        (phasor, lambda x: mpmath.exp(-1j * x), -2.0),
        (sine, lambda x: 2 * mpmath.sin(x / 2), np.pi),
        (lambda x: sinc(x).value, lambda x: mpmath.sinc(x / 2), 0.0),
        (lambda x: sinc(x).value, lambda x: mpmath.sinc(x / 2), 5e-4),
        (lambda x: sinc(x).value, lambda x: mpmath.sinc(x / 2), 0.8),
        (lambda x: sinc(x).rate, lambda x: mpmath.diff(lambda y: mpmath.sinc(y / 2), x), 0.0),
        (lambda x: sinc(x).rate, lambda x: mpmath.diff(lambda y: mpmath.sinc(y / 2), x), 0.8),
    ],
    ids=[
        "phasor",
        "phasor of a negative phase",
        "sine",
        *("sinc" + where for where in ("", " beside 0", " far from 0")),
        *("its derivative" + where for where in ("", " far from 0")),
    ],
)
@pytest.mark.parametrize("half", [0.01, 0.05, 0.2])
def test_the_rest_of_a_bent_function_is_attained(
    of: Callable[..., LinearModel], true: Callable[..., mpmath.mpf], centre: float, half: float
) -> None:
    with mpmath.workdps(50):
        made = of(variable(0, 1, np.array([centre]), np.array([half])))
        for way in (-1, 1):
            linear = mpmath.mpmathify(complex(made.centre[0])) + way * mpmath.mpmathify(
                complex(made.slope[0, 0])
            )
            error = abs(true(mpmath.mpf(centre) + way * mpmath.mpf(half)) - linear)
            assert error <= made.rest[0] <= SHARP * error


@pytest.mark.parametrize(
    ("of", "true", "centre"),
    [
        (phasor, lambda x: mpmath.exp(-1j * x), 0.7),
        (sine, lambda x: 2 * mpmath.sin(x / 2), 0.0),
    ],
)
def test_what_an_argument_leaves_is_left(
    of: Callable[..., LinearModel], true: Callable[..., mpmath.mpf], centre: float
) -> None:
    made = of(model(centre, 0.0, 0.125, 1.0))
    error = abs(true(centre + 0.125) - mpmath.mpmathify(complex(made.centre[0])))
    assert error <= made.rest[0] <= SHARP * error


def test_a_phase_that_is_hardly_known_leaves_the_unit_disc() -> None:
    made = phasor(model(0.3, 1.5, 0.0, 1.0))
    assert made.centre[0] == 0.0
    reached = [made.slope[0, 0] * way for way in (-1.0, 0.0, 1.0)]
    assert made.rest[0] >= 1.0 + max(map(abs, reached))
    assert made.rest[0] <= SHARP


def test_roundings_are_counted_with_the_rest() -> None:
    """3 x / 3 in float64 is wrong by a unit now and then; the rest is of that size, not above."""
    x = variable(0, 1, np.full(1, 1.0 / 3.0), np.full(1, 1e-3))
    rest = (x * 3.0).rest[0]
    assert LINEAR_MODEL <= rest <= 1.01 * LINEAR_MODEL * 1.003
    assert phasor(model(0.0, 0.0, 0.0, 1.0)).rest[0] == ELEMENTARY


@pytest.mark.parametrize("x", [0.5, 8.0])
def test_what_coefficients_were_rounded_by_is_left_beside_the_arithmetic(x: float) -> None:
    """Each of them may be wrong by ``PARAMETER`` of itself; in the derivative, too."""
    falling, theta = (1.0, -2.0, 0.5, 3.0), model(x, 0.0, 0.0, 0.0)
    moving = Moving(theta, theta.constant(1.0))
    exact = moving * 0.0 + falling[0]  # by Horner's rule, of the coefficients as they are
    for c in falling[1:]:
        exact = exact * moving + c
    made, alone = _polynomial(falling, moving), _polynomial(falling, theta)
    sizes = [(k, abs(c)) for k, c in enumerate(falling[::-1])]
    value = sum(c * x**k for k, c in sizes)
    rate = sum(k * c * x ** (k - 1) for k, c in sizes if k)
    for known, arithmetic, most in (
        (alone, exact.value, value),
        (made.value, exact.value, value),
        (made.rate, exact.rate, rate),
    ):
        left = known.rest[0] - arithmetic.rest[0]
        assert left == pytest.approx(PARAMETER * most, rel=1e-6)


PATCHES = [0.01, 0.2, 0.6, 1.3, 2.2, 2.95, 3.12]


# ------------------------------------------------------- aliases of a held device (lemmas B20, J3)


@pytest.mark.parametrize(
    ("grip", "modes"),
    [(None, ()), ((0.3, 0.05), ()), (None, ((0.8, 0.02, 0.6),))],
)
def test_the_compliance_at_high_frequencies_is_nearly_attained(
    grip: tuple[float, float] | None, modes: tuple[tuple[float, float, float], ...]
) -> None:
    """w^2 |N/D| of a mass with a spring and a damper, held by an arm whose mass is 0 at least."""
    device = HeldDevice(0.01, 0.02, modes, (), grip)
    stiffest, least_damping = 0.05, 0.02
    for beyond in (3.0, 10.0):
        bound = device.largest_compliance((0.5, 0.5), (stiffest, least_damping), beyond)
        w = np.geomspace(beyond, 1e4, 4000)
        values = [
            np.abs(np.divide(*device.parts(1j * w, 0.5, Arms(0.0, stiffness, least_damping))))
            for stiffness in (0.0, stiffest)
        ]
        attained = np.max(w**2 * values)
        assert attained <= bound <= SHARP * attained


PLACES = "motor", "handle"
BODIES = {
    "modes": HeldDevice(
        0.2,
        0.3,
        ((0.8, 0.05, 0.6), (1.5, 0.1, 2.0)),
        (),
        None,
        shapes=(Shapes(1.0, -0.5, 0.7), Shapes(0.4, 1.0, -1.0)),
    ),
    "another system": HeldDevice(
        0.0,
        0.0,
        (),
        (),
        None,
        Ports(
            (1.0, 0.5, 0.02, 0.01),
            encoder=(0.0, 2.0, -0.3),
            handle=(0.0, 1.0, -0.1),
            encoder_by_hand=(0.0, -0.7, 0.2),
            handle_by_hand=(0.0, 1.5, -0.5),
            excess=(0.0, 0.0, 1.6, -0.2),
        ),
    ),
}


def responses(device: HeldDevice, mass: float, s: np.ndarray, to: str, by: str) -> np.ndarray:
    """The response of a device alone: of its body and its modes, or a quotient in s."""
    if device.own is not None:
        above = getattr(device.own, to + "_by_hand" * (by == "handle"))
        return np.polyval(above, s) / np.polyval(device.own.below, s)
    sum_of_modes = 1.0 / (mass * s**2 + device.damping * s + device.stiffness)
    every = device.shapes or (Shapes(),) * len(device.modes)
    for (w, ratio, moved), shapes in zip(device.modes, every, strict=True):
        seen = getattr(shapes, to) * getattr(shapes, by)
        sum_of_modes = sum_of_modes + seen / (moved * (s**2 + 2.0 * ratio * w * s + w**2))
    return sum_of_modes


@pytest.mark.parametrize("shapes", [None, BODIES["modes"].shapes])
@pytest.mark.parametrize("grip", [None, (0.3, 0.05)])
def test_the_plant_is_that_of_its_parts(
    shapes: tuple[Shapes, ...] | None, grip: tuple[float, float] | None, rng: np.random.Generator
) -> None:
    """G_em - G_eh G_hm Z/(1 + Z G_hh), Z of the arm behind the grip, at any s."""
    device = BODIES["modes"]._replace(grip=grip, shapes=shapes, lags=(0.7, 2.0))
    s, mass, arm = rng.normal(size=(2, 20)).T @ [1.0, 1j], 0.5, Arms(0.2, 0.4, 0.6)
    held = arm.mass * s**2 + arm.damping * s + arm.stiffness
    if grip is not None:
        between = grip[0] + grip[1] * s
        held = held * between / (held + between)
    encoder, by_hand, handle, there = (
        responses(device, mass, s, *way) for way in product(("encoder", "handle"), PLACES)
    )
    true = encoder - by_hand * handle * held / (1.0 + held * there)
    true = true / ((1.0 + s / 0.7) * (1.0 + s / 2.0))
    assert np.divide(*device.parts(s, mass, arm)) == pytest.approx(true, rel=1e-10)


@pytest.mark.parametrize("kind", BODIES)
@pytest.mark.parametrize("grip", [None, (0.3, 0.05)])
def test_the_parts_of_a_plant_are_known_with_their_slopes(
    kind: str, grip: tuple[float, float] | None
) -> None:
    """N(i theta), D(i theta) and the slopes by theta, for two modes of unlike shapes, too."""
    device, arm, x = BODIES[kind]._replace(grip=grip, lags=(0.7,)), (0.2, 0.4, 0.6), 0.3
    theta = model(x, 1.0, 0.0, 1e-9)
    arms = Arms(*map(theta.constant, arm))
    made = device.parts(_moving_s(theta), theta.constant(0.5), arms)
    before, there, after = (
        np.array(device.parts(1j * at, 0.5, Arms(*arm))) for at in (x - 1e-4, x, x + 1e-4)
    )
    values, rates = ([getattr(part, of).centre[0] for part in made] for of in ("value", "rate"))
    assert values == pytest.approx(there, rel=1e-12, abs=1e-12)
    assert rates == pytest.approx((after - before) / 2e-4, rel=1e-6, abs=1e-7)


@pytest.mark.parametrize(
    ("kind", "beyond"),
    [("modes", 4.0), ("modes", 2.0), ("another system", 4.0), ("another system", 0.8)],
)
def test_bounds_of_responses_at_high_frequencies_are_nearly_attained(
    kind: str, beyond: float
) -> None:
    """-w^2 times the responses of a device alone, from sums of modes or quotients in s."""
    device, mass = BODIES[kind], 0.5
    s = 1j * np.geomspace(beyond, 1e4, 2000)
    for to, by in product(("encoder", "handle"), PLACES):
        true = responses(device, mass, s, to, by)
        light, off, most = device._response_bounds(mass, beyond, to, by)
        assert s[-1] ** 2 * true[-1] == pytest.approx(light, rel=1e-3)
        away, largest = np.max(abs(s**2 * true - light)), np.max(abs(s**2 * true))
        assert away <= off < np.inf
        assert largest <= most < np.inf
        if beyond == 4.0 and (device.own is not None or to == by):  # else terms take from another
            assert off <= 2.0 * away
            assert most <= SHARP * largest
        assert device._response_bounds(mass, 0.3, to, by)[1:] == (np.inf, np.inf)


def test_a_response_that_falls_by_one_degree_has_no_bound() -> None:
    own = Ports((1.0, 0.1, 0.2), *[(1.0, 2.0)] * 4, excess=(0.0, 0.0, 0.0))
    device = HeldDevice(0.0, 0.0, (), (), None, own)
    assert device._response_bounds(0.5, 9.0, "handle", "motor")[1:] == (np.inf, np.inf)


def test_the_compliance_of_a_motor_that_moves_the_handle_more_is_bounded() -> None:
    """w^2 |G_em - G_eh G_hm Z/(1 + Z G_hh)| over arms Z = m s^2 + b s + k; these are quotients."""
    below, beyond, stiffest, damping = (1.0, 0.05, 0.01, 0.001), 20.0, 0.05, 0.02
    limits = {"encoder": -1.0, "handle": 1.5, "encoder_by_hand": 3.5, "handle_by_hand": 2.25}
    own = Ports(below, **{k: (0.0, x, 0.01) for k, x in limits.items()}, excess=(0.0, 0.0, 1.0))
    device = HeldDevice(0.0, 0.0, (), (), None, own)
    bound = device.largest_compliance((0.5, 0.5), (stiffest, damping), beyond)
    s = 1j * np.geomspace(beyond, 1e4, 400)
    encoder, handle, by_hand, there = (
        np.polyval(above, s) / np.polyval(below, s) for above in own[1:5]
    )
    arms = product([0.0, 0.1, 1.0, 1e3], [damping, 1.0], [0.0, stiffest])
    attained = max(
        np.max(abs(s**2 * (encoder - by_hand * handle * arm / (1.0 + arm * there))))
        for arm in (m * s**2 + b * s + k for m, b, k in arms)
    )
    assert attained <= bound <= 2.0 * attained


def test_a_device_whose_motor_does_not_move_the_encoder_alone_is_not_passive() -> None:
    """The force of a damper at the encoder could drive it: Re (s N/D) < 0 at some frequency."""
    s = 1j * np.geomspace(1e-2, 1e2, 400)
    one_point = HeldDevice(0.2, 0.3, ((0.8, 0.05, 0.6),), (), None)
    for device in (one_point, *BODIES.values()):
        above, below = device.parts(s, 0.5, Arms(0.0, 0.0, 0.0))
        assert device.is_passive == (np.min((s * above / below).real) > 0.0)


def test_the_compliance_of_a_hand_that_resonates_with_its_grip_is_bounded() -> None:
    grip, beyond, damping = (4.0, 0.05), 10.0, 0.02
    masses = np.linspace(0.5, 1.5, 201) * grip[0] / beyond**2
    for lags, weaker in (((), 1.0), ((2.0,), np.hypot(1.0, beyond / 2.0))):
        device = HeldDevice(0.01, 0.02, (), lags, grip)
        bound = device.largest_compliance((0.5, 0.5), (0.0, damping), beyond)
        parts = device.parts(1j * beyond, 0.5, Arms(masses, 0.0, damping))
        attained = np.max(beyond**2 * np.abs(np.divide(*parts)))
        assert 1.1 / (0.5 * weaker) < attained <= bound <= 2.5 * attained


def test_no_compliance_is_known_where_some_mass_of_a_range_is_no_inertia() -> None:
    """A mode of negative mass: the heaviest device weighs less than nothing, and arms make it 0."""
    device = HeldDevice(0.01, 0.0, ((0.8, 0.02, -0.667),), (), None)
    beyond = 10.0
    known = device.largest_compliance((0.5, 0.5), (0.05, 0.02), beyond)
    assert device.largest_compliance((0.5, 1.0), (0.05, 0.02), beyond) == np.inf
    w = np.geomspace(beyond, 1e3, 4000)
    parts = device.parts(1j * w, 1.0, Arms(2.0, 0.05, 0.02))
    assert np.max(w**2 * np.abs(np.divide(*parts))) > 10.0 * known


def test_aliases_that_are_not_followed_are_bounded_by_their_sum() -> None:
    """Of a free mass: 1/(m |theta + 2 pi k|^3), and squares for the moduli, |k| above 2."""
    device, mass, last = HeldDevice(0.0, 0.0, (), (), None), 0.5, 3.0
    aliases = _Aliases.from_device(device, (mass, mass), (0.0, 0.0), 2, last)
    assert sorted(turns for turns, _, _ in aliases.followed) == [-2, -1, 1, 2]
    for turns, nearest, most in aliases.followed:
        angles = np.abs(np.linspace(0.0, last, 101) + 2.0 * np.pi * turns)
        assert nearest == pytest.approx(angles.min())
        assert 1.0 / (mass * nearest**3) <= most <= SHARP / (mass * nearest**3)
    for bound, power in ((aliases.tail, 3), (aliases.tail_of_moduli, 2)):
        exact = mpmath.nsum(
            lambda k, power=power: (
                (2 * mpmath.pi * k - last) ** -power + (2 * mpmath.pi * k + last) ** -power
            ),
            [3, mpmath.inf],
        )
        assert exact / mass <= bound <= SHARP * exact / mass


def test_the_sums_over_all_aliases_hold_the_true_ones() -> None:
    """Of a free mass, -e^(-2 pi i k d)/(m (theta + 2 pi k)^3), and their moduli times angles."""
    mass, delay, theta = 0.5, 0.3, np.array([0.05, 1.0, 3.0])
    boxes = object.__new__(DeviceBoxes)
    boxes._device, boxes._jitter = HeldDevice(0.0, 0.0, (), (), None), 0.4
    aliases = _Aliases.from_device(boxes._device, (mass, mass), (0.0, 0.0), 4, 3.0)
    place = ParameterBoxes((), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(3, int))
    none, *constants = (place.constant(value) for value in (0.0, mass, delay))
    angle_of = place.constant(theta)
    extent = Extent(*constants, Arms(none, none, none), none, none, angle_of)
    r, r_moduli = boxes._others(extent, aliases)
    late = boxes._late(1.0, -mass * theta**2, r_moduli)  # lemma J3
    for k, angle in enumerate(theta.tolist()):

        def alias(turns: float, sign: int, power: int, angle: float = angle) -> mpmath.mpf:
            turned = angle + 2 * mpmath.pi * sign * turns
            wave = mpmath.expj(-2 * mpmath.pi * sign * turns * delay) if power == 3 else 1
            return wave / (mass * turned**power)

        moduli, total = (
            sum(alias(turns, sign, power) for turns in range(1, 1000) for sign in (-1, 1))
            for power in (2, 3)
        )
        beyond = 1.0 / (mass * (2.0 * np.pi) ** 2 * 1000)
        assert moduli <= r_moduli[k] <= SHARP * (moduli + 2.0 * beyond)
        assert 0.4 * (1.0 + mass * angle**2 * moduli) <= late[k]
        assert abs(r.centre[k] + complex(total)) <= r.rest[k] + beyond**2


FILTERS = [
    (Velocity.difference(samples=20), Filter()),
    (Velocity.low_pass(0.02, order=2), Filter.average(samples=7)),
    (Velocity.butterworth(0.03, order=4), Filter.low_pass(0.1)),
    (Velocity.kalman(q=1e-4, r=1.0), Filter.exponential(0.2)),
    (Velocity.savitzky_golay(9, order=2), Filter.transfer_function([0.5, 0.5], [1.0, -0.3])),
]


@pytest.mark.parametrize("given", FILTERS, ids=str)
def test_filters_over_boxes_hold_their_values_and_derivatives(
    given: tuple[Velocity, Filter], rng: np.random.Generator
) -> None:
    """Lemma B14 against 40 digits of the quotients, at both ends of boxes and between them."""
    velocity, position = given
    chains = position.sections, velocity.filter.sections
    count = 60
    angle = rng.choice([0.0, np.pi, *rng.uniform(0.0, np.pi, 6), *rng.uniform(0.0, 0.1, 4)], count)
    half = 10.0 ** rng.uniform(-9.0, -1.0, count)
    is_known = rng.random(count) < 0.7  # elsewhere the angle moves without a slope
    theta = LinearModel(angle, np.where(is_known, half, 0.0)[None], np.where(is_known, 0.0, half))
    for chain, quotient, is_velocity in zip(chains, quotients(given), (False, True), strict=True):

        def value(x: object, chain: object = chain, is_velocity: bool = is_velocity) -> object:
            z = mpmath.expj(x)
            total = 1 - 1 / z if is_velocity else mpmath.mpf(1)
            for section in chain:  # type: ignore[attr-defined]
                for sides in section.factors(Fraction(float(section.number))):
                    above, below = (
                        sum(mpmath.mpf(c.numerator) / c.denominator / z**k for k, c in enumerate(p))
                        for p in (map(Fraction, side) for side in sides)
                    )
                    total *= above / below
            return total

        found = quotient.over(theta)
        with mpmath.workdps(40):
            closest = 0.0
            for k in range(count):
                for share in (-1.0, 0.3, 1.0):
                    x = mpmath.mpf(float(angle[k])) + mpmath.mpf(float(half[k])) * share
                    step = mpmath.mpf(10) ** -12
                    rate = (value(x + step) - value(x - step)) / (2 * step)
                    for model, true in ((found.value, value(x)), (found.rate, rate)):
                        known = mpmath.mpc(model.centre[k]) + mpmath.mpc(model.slope[0, k]) * share
                        away, rest = abs(true - known), model.rest[k]
                        assert away <= rest
                        if half[k] > 1e-3 and rest:
                            closest = max(closest, float(away / rest))
        assert closest > 0.2 or not (chain or is_velocity)
