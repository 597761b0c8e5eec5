"""Bounds of what expansions leave (lemmas B10, B13, B14 and B20): none too small, each attained.

Functions are taken at the end of a box that is worst for them, in exact fractions or 50 digits. A
bound is attained if it is at most ``SHARP`` times what it bounds there: halved, it would be wrong.
"""

from collections.abc import Callable
from fractions import Fraction
from itertools import product

import mpmath
import numpy as np
import pytest

from benchmarks.truth import filtered
from jaxstab import Filter, Velocity
from jaxstab.boxes.box import ParameterBoxes
from jaxstab.boxes.enclosures import LinearModel, phasor, sinc, sine, variable
from jaxstab.boxes.filters import quotients
from jaxstab.boxes.plant import (
    Arms,
    DeviceBoxes,
    HeldDevice,
    _Aliases,
    _Place,
)
from jaxstab.proofs import filters
from jaxstab.proofs.curve_patches import _waves
from jaxstab.rounding import ELEMENTARY, EPS, LINEAR_MODEL, SERIES

SHARP = 1.5
ROUNDED = 1.0 + 1e-12  # the bounds are float64, too


def model(centre: float, slope: float, rest: float, half: float) -> LinearModel:
    """A function of one variable over one box."""
    return LinearModel(
        np.array([centre]), np.array([[slope]]), np.array([rest]), np.array([[half]])
    )


def at(made: LinearModel, move: float) -> Fraction:
    """What a model says where its variable has moved by so much."""
    return Fraction(float(made.centre[0])) + Fraction(float(made.slope[0, 0])) * Fraction(move)


def ends(centre: float, slope: float, rest: float, half: float) -> list[tuple[float, Fraction]]:
    """Moves to both ends of a box, and values there that a model allows."""
    exact = Fraction(centre), Fraction(slope), Fraction(rest)
    return [
        (side * half, exact[0] + side * exact[1] * Fraction(half) + way * exact[2])
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
    assert (made.low[0], made.high[0]) == (float(low), float(high))
    assert made.size[0] == max(abs(low), abs(high))
    assert made.is_off(float(high) + 1e-9, 9.0)[0]
    assert made.is_off(-9.0, float(low) - 1e-9)[0]
    assert not made.is_off(float(high), 9.0)[0]
    assert not made.is_off(-9.0, float(low))[0]


@pytest.mark.parametrize("seed", range(8))
def test_products_with_t_are_exact_up_to_third_order(seed: int) -> None:
    """Variables x, t, t^2 - h^2/2 and t x: what a product of functions of x and t leaves is x^2."""
    rng = np.random.default_rng(seed)
    numbers = rng.integers(-8, 9, (2, 3)) / 8.0 + [[4.0, 0.0, 0.0], [2.0, 0.0, 0.0]]
    half = np.array([0.25, 0.5, 0.125, 0.125])  # of t^2 - 1/8, and of t x
    made = [
        LinearModel(
            np.array([centre]),
            np.array([[by_x], [by_t], [0.0], [0.0]]),
            np.zeros(1),
            half[:, None],
            has_products=True,
        )
        for centre, by_x, by_t in numbers
    ]
    pairs = {"product": made[0] * made[1], "inverse": made[0].reciprocal()}
    worst = dict.fromkeys(pairs, 0.0)
    for x, t in product(np.linspace(-0.25, 0.25, 5), np.linspace(-0.5, 0.5, 9)):
        moves = np.array([x, t, t * t - 0.125, t * x])
        f, g = (centre + by_x * x + by_t * t for centre, by_x, by_t in numbers)
        for name, true in (("product", f * g), ("inverse", 1.0 / f)):
            model_ = pairs[name]
            error = abs(true - model_.centre[0] - model_.slope[:, 0] @ moves)
            assert error <= model_.rest[0] + 1e-14
            worst[name] = max(worst[name], error)
    x_square = abs(numbers[0, 1] * numbers[1, 1]) * 0.25**2
    assert worst["product"] == pytest.approx(x_square, abs=1e-14)
    assert pairs["product"].rest[0] == pytest.approx(x_square, abs=1e-12)
    swing = abs(numbers[0, 1]) * 0.25 + abs(numbers[0, 2]) * 0.5
    left = (numbers[0, 1] * 0.25) ** 2 / numbers[0, 0] ** 3
    left += swing**3 / (numbers[0, 0] ** 3 * (numbers[0, 0] - swing))
    assert pairs["inverse"].rest[0] == pytest.approx(left, abs=1e-12)


@pytest.mark.parametrize(
    ("of", "true", "centre"),
    [
        (phasor, lambda x: mpmath.exp(-1j * x), 0.7),
        (phasor, lambda x: mpmath.exp(-1j * x), -2.0),
        (sine, lambda x: 2 * mpmath.sin(x / 2), np.pi),
        (lambda x: sinc(x).value, lambda x: mpmath.sinc(x / 2), 0.0),
        (lambda x: sinc(x).rate, lambda x: mpmath.diff(lambda y: mpmath.sinc(y / 2), x), 0.0),
    ],
    ids=["phasor", "phasor of a negative phase", "sine", "sinc", "its derivative"],
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


# --------------------------------------------------------------------------------- Taylor series


def series(value: list[float], error: list[float]) -> filters.Series:
    length = [0.0] * (filters.ORDERS - len(value))
    return filters.Series(
        np.array([*value, *length])[:, None], np.array([*error, *length])[:, None]
    )


def coefficients(made: filters.Series) -> list[Fraction]:
    return [Fraction(float(number)) for number in made.value[:, 0]]


def fractions(one: filters.Series, way: int) -> list[Fraction]:
    """Coefficients moved to one end of their errors."""
    errors = [Fraction(float(number)) for number in one.error[:, 0]]
    return [c + way * e for c, e in zip(coefficients(one), errors, strict=True)]


def times(one: list[Fraction], other: list[Fraction]) -> list[Fraction]:
    return [sum(one[i] * other[k - i] for i in range(k + 1)) for k in range(len(one))]


def inverse(one: list[Fraction]) -> list[Fraction]:
    result = [1 / one[0]]
    for k in range(1, len(one)):
        result.append(-sum(one[i] * result[k - i] for i in range(1, k + 1)) / one[0])
    return result


def test_errors_of_sums_and_products_of_series_are_attained() -> None:
    one = series([1.0, 0.5, 0.25, 2.0], [0.125, 0.0, 0.5, 0.25])
    other = series([0.75, 1.0, 0.5, 0.125], [0.0, 0.25, 0.125, 0.5])
    for made, exact in (
        (one * other, times(fractions(one, 1), fractions(other, 1))),
        (one + other, [a + b for a, b in zip(fractions(one, 1), fractions(other, 1), strict=True)]),
    ):
        errors = [a - b for a, b in zip(exact, coefficients(made), strict=True)]
        for error, bound in zip(errors, made.error[:, 0], strict=True):
            assert error <= bound <= error * ROUNDED + Fraction(1, 10**12)


def test_rounding_of_products_and_inverses_of_series_is_within_their_errors() -> None:
    """Of complex series that are exact; their truth has 50 digits."""
    assert SERIES == (filters.ORDERS + 4) * EPS  # as many products are in a sum
    rng = np.random.default_rng(12)
    values = rng.normal(size=(2, 2, filters.ORDERS, 200)) * 10 ** rng.uniform(-2, 2, (2, 1, 1, 200))
    one, other = (
        filters.Series(real + 1j * imag, np.zeros((filters.ORDERS, 200))) for real, imag in values
    )
    shares = list[float]()
    with mpmath.workdps(50):
        for made, exact in (
            (one * other, lambda a, b: times(a, b)),
            (one.reciprocal(), lambda a, _: inverse(a)),
        ):
            for k in range(200):
                a, b = ([mpmath.mpmathify(c) for c in s.value[:, k].tolist()] for s in (one, other))
                for true, near, bound in zip(
                    exact(a, b), made.value[:, k].tolist(), made.error[:, k].tolist(), strict=True
                ):
                    shares.append(float(abs(true - near) / bound))
    assert 0.05 < max(shares) <= 1.0


def test_errors_of_inverses_of_series_are_attained() -> None:
    """Where all coefficients of 1/f have one sign, errors of one sign add up."""
    one = series([2.0, -0.5, -0.25, -0.125], [0.25, 0.125, 0.0625, 0.0])
    moved = fractions(one, 1)
    least = [
        moved[0] - 2 * Fraction(1, 4),
        *[
            c - 2 * e
            for c, e in zip(moved[1:], [Fraction(float(e)) for e in one.error[1:, 0]], strict=True)
        ],
    ]
    made = one.reciprocal()
    exact = inverse(least)
    for true, centre, bound in zip(exact, coefficients(made), made.error[:, 0], strict=True):
        assert true - centre <= bound * ROUNDED
    assert made.error[0, 0] <= SHARP * float(exact[0] - coefficients(made)[0])
    assert made.error[1, 0] <= 2.0 * float(exact[1] - coefficients(made)[1])
    vanishing = series([1.0, 1.0], [1.0, 0.0])
    with np.errstate(invalid="ignore"):
        assert np.all(np.isinf(vanishing.reciprocal().error[:, 0]))


@pytest.mark.parametrize("middle", [0.0, 0.3, 2.5, np.pi])
@pytest.mark.parametrize("half", [0.01, 0.1])
def test_series_of_sums_of_turns_hold_in_all_of_their_cell(middle: float, half: float) -> None:
    weights = [0.5, 0.25, 0.25, 1.0, -0.5]
    cell = np.array([middle]), np.array([half])
    cases = [
        (filters.power_sum(weights, *cell), weights),
        (filters.difference(*cell), [1.0, -1.0]),
    ]
    with mpmath.workdps(60):
        for (narrow, wide), numbers in cases:
            for m in range(filters.ORDERS):
                centre = mpmath.mpmathify(complex(narrow.value[m, 0]))
                errors = []
                for x in (middle, middle - half, middle + half):
                    true = mpmath.fsum(
                        w * mpmath.mpc(0, -k) ** m * mpmath.exp(mpmath.mpc(0, -k) * mpmath.mpf(x))
                        for k, w in enumerate(numbers)
                    )
                    errors.append(abs(true / mpmath.factorial(m) - centre))
                assert errors[0] <= narrow.error[m, 0] <= 1e-13
                assert max(errors) <= wide.error[m, 0] * ROUNDED
                assert wide.error[m, 0] <= SHARP * max(errors) or half > 0.01


# ------------------------------------------------------- filters on the circle (lemmas B10 and B12)


def response(rational: filtered.Rational, theta: mpmath.mpf) -> mpmath.mpc:
    """A transfer function at z = e^(i theta)."""
    z = mpmath.expj(theta)
    above, below = (
        mpmath.polyval([mpmath.mpf(int(c.p)) / int(c.q) for c in part], z, asc=True)
        for part in rational
    )
    return above / below


def real_parts(rational: filtered.Rational, theta: mpmath.mpf) -> tuple[mpmath.mpf, mpmath.mpf]:
    """Rise and slope of F = F(1) + h rise + s slope, s = 1 - 1/z, h = 1 - cos(theta)."""
    value = response(rational, theta)
    slope, h = value.imag / mpmath.sin(theta), 1 - mpmath.cos(theta)
    return (value.real - response(rational, mpmath.mpf(0)).real - h * slope) / h, slope


CHAINS = {
    "low pass and Butterworth": (
        (Velocity.low_pass(0.1), Filter.butterworth(0.2, order=2)),
        (
            filtered.times(filtered.difference(1), filtered.low_pass(0.1, order=1)),
            filtered.butterworth(0.2, order=2),
        ),
    ),
    "a window and an average": (
        (Velocity.difference(samples=5), Filter.average(samples=3)),
        (filtered.difference(5), filtered.average(3)),
    ),
}
PATCHES = [0.01, 0.2, 0.6, 1.3, 2.2, 2.95, 3.12]


@pytest.mark.parametrize("name", CHAINS)
def test_models_of_filters_hold_at_the_ends_of_patches(name: str) -> None:
    given, (velocity, position) = CHAINS[name]
    theta, half = np.array(PATCHES), np.full(len(PATCHES), 1e-3)
    models = filters.filter_models(given, theta, np.stack([half, 0.0 * half]))
    made = [
        (models.position_rise, models.position_slope),
        (models.velocity_rise, models.velocity_slope),
    ]
    with mpmath.workdps(50):
        for rational, parts in zip((position, velocity), made, strict=True):
            for k, middle in enumerate(PATCHES):
                for which, part in enumerate(parts):

                    def true(x: mpmath.mpf, rational=rational, which=which) -> mpmath.mpf:
                        return real_parts(rational, x)[which]

                    for kind, order in ((part.value, 0), (part.rate, 1)):
                        errors = []
                        for move in (-1e-3, 0.0, 1e-3):
                            linear = mpmath.mpf(float(kind.centre[k])) + mpmath.mpf(
                                float(kind.slope[0, k])
                            ) * mpmath.mpf(move)
                            at_end = mpmath.mpf(middle) + mpmath.mpf(move)
                            errors.append(abs(mpmath.diff(true, at_end, order) - linear))
                        assert max(errors) <= kind.rest[k] + 1e-40
                        if order == 0 and not 0.25 < middle < np.pi - 0.25 and max(errors) > 1e-12:
                            assert kind.rest[k] <= SHARP * max(errors)


@pytest.mark.parametrize("name", CHAINS)
def test_responses_of_filters_are_right_to_what_they_say_they_lost(name: str) -> None:
    given, rationals = CHAINS[name]
    theta = np.array([0.0, *PATCHES, 0.5 * np.pi, np.pi])
    value, slope, lost = filters.responses(filters.filter_cells(given), theta)
    with mpmath.workdps(50):
        for which, rational in enumerate(rationals[::-1]):
            for k, x in enumerate(theta.tolist()):
                for order, made in ((0, value), (1, slope)):
                    true = mpmath.diff(lambda y, of=rational: response(of, y), mpmath.mpf(x), order)
                    away = abs(true - mpmath.mpmathify(complex(made[which, k])))
                    assert away <= lost[2 * order + which, k] <= 1e-12


def test_values_of_filters_at_the_ends_of_the_circle() -> None:
    for given, (velocity, position) in CHAINS.values():
        ends = filters.filter_ends(given)
        with mpmath.workdps(50):
            assert ends.position_at_one == pytest.approx(1.0, abs=1e-15)
            exact = [response(one, mpmath.pi).real for one in (position, velocity)]
            for value, true in zip(ends.at_minus_one, exact, strict=True):
                assert abs(value - true) <= ends.error * abs(true) + 1e-30
        assert ends.error < 1e-12


# ------------------------------------------------------------- functions of the angle alone (B12)

WAVES = {
    "h": lambda x, m: 1 - mpmath.cos(x),
    "cos_turns": lambda x, m: mpmath.cos(m * x),
    "sine_ratio": lambda x, m: mpmath.fsum(mpmath.cos(k * x) for k in range(m - 1, -m, -2)),
    "lag_ratio": lambda x, m: mpmath.fsum(
        (2 if k else 1) * (m - k) * mpmath.cos(k * x) for k in range(m)
    ),
}


@pytest.mark.parametrize("name", WAVES)
@pytest.mark.parametrize("turns", [1, 2, 5])
def test_waves_and_their_derivatives_hold_over_patches(name: str, turns: int) -> None:
    """The largest second and third derivatives are those at 0, and at pi/2 for one turn."""
    theta, by = np.array([0.0, 0.4, 0.5 * np.pi, 2.3, np.pi]), 1e-3
    half = np.stack([np.full(theta.size, by), np.zeros(theta.size)])
    made = getattr(_waves(theta, turns, half), name)
    attained = {0: 0.0, 1: 0.0}
    with mpmath.workdps(40):
        for order, kind in enumerate((made.value, made.rate)):
            for k, middle in enumerate(theta.tolist()):
                for move in (-by, 0.0, by):
                    x = mpmath.mpf(middle) + mpmath.mpf(move)
                    true = mpmath.diff(lambda y: WAVES[name](y, turns), x, order)
                    linear = mpmath.mpf(float(kind.centre[k])) + mpmath.mpf(
                        float(kind.slope[0, k])
                    ) * mpmath.mpf(move)
                    assert abs(true - linear) <= kind.rest[k] + 1e-30
                    attained[order] = max(attained[order], abs(true - linear) / kind.rest[k])
    if name in ("h", "cos_turns") or turns > 2:
        assert attained[0] > 0.5
    x = mpmath.mpf("0.7")  # the two ratios are those of the sines
    ratio = mpmath.sin(turns * x) / mpmath.sin(x)
    assert WAVES["sine_ratio"](x, turns) == pytest.approx(ratio)
    ratio = (1 - mpmath.cos(turns * x)) / (1 - mpmath.cos(x))
    assert WAVES["lag_ratio"](x, turns) == pytest.approx(ratio)


# ------------------------------------------------------- aliases of a held device (lemmas B20, J3)


@pytest.mark.parametrize(
    ("grip", "modes"), [(None, ()), ((0.3, 0.05), ()), (None, ((0.8, 0.02, 0.6),))]
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
    boxes._device = HeldDevice(0.0, 0.0, (), (), None)
    aliases = _Aliases.from_device(boxes._device, (mass, mass), (0.0, 0.0), 4, 3.0)
    place = ParameterBoxes((), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(3, int))
    none, *constants = (place.constant(value) for value in (0.0, mass, delay))
    angle_of = place.constant(theta)
    others = boxes._others(_Place(*constants, Arms(none, none, none), angle_of), aliases)
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
        assert moduli <= others.moduli[k] <= SHARP * (moduli + 2.0 * beyond)
        assert abs(others.total.centre[k] + complex(total)) <= others.total.rest[k] + beyond**2


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
    theta = variable(0, 1, angle, half)
    for chain, quotient, is_velocity in zip(chains, quotients(given), (False, True), strict=True):

        def value(x: object, chain: object = chain, is_velocity: bool = is_velocity) -> object:
            z = mpmath.expj(x)
            total = 1 - 1 / z if is_velocity else mpmath.mpf(1)
            for section in chain:  # type: ignore[attr-defined]
                for *sides, times in section.rational_factors():
                    above, below = (
                        sum(mpmath.mpf(c.numerator) / c.denominator * z**k for k, c in enumerate(p))
                        for p in (map(Fraction, side) for side in sides)
                    )
                    total *= (above / below) ** times
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
