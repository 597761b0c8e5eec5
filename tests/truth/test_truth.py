"""The truth of the tests, checked by other routes: closed forms, back substitution."""

import importlib.util
from math import floor, nextafter, pi
from pathlib import Path

import numpy as np
import pytest
from mpmath import mp, mpf

from benchmarks.eigenvalues import printed_plant
from tests.truth import loop as truth

REFERENCE = Path(__file__).parents[2] / "data" / "reference"
PLANTS = [
    (1e-3, 0.015),
    (40.0, 10.0),
    (1.0, nextafter(2.0, 3.0)),
    ((2 * pi) ** 2, 0.0),
    (1e-300, 1e-8),
    (1e-12, 1e-300),
]
FRACTIONS = [0.0, 0.25, 1e-12]
SCENES = [
    (0.1, 0.5, 1e-3, 0.015, 1.0),
    (0.07, 0.4, 0.0, 0.0, 0.0),
    (0.02, 0.1, pi**2 / 4, 0.1, 3.75),
    (1e-300, 1e-300, 1e-3, 0.015, 3.0),
    (-3.0, 0.2, 40.0, 10.0, 60.0),
]


def step(gamma, delta, time):
    """Position after a unit step of force, in closed form; not at gamma = 0 or critical damping."""
    split = mp.sqrt(mp.mpc(mpf(delta) ** 2 / 4 - gamma))
    wave = mp.cosh(split * time) + delta / (2 * split) * mp.sinh(split * time)
    return ((1 - mp.exp(-mpf(delta) * time / 2) * wave) / gamma).real


def agree(values, others):
    """To 50 digits of each."""
    with mp.workdps(100):
        return all(
            value == other or abs(value / other - 1) < mpf(10) ** -truth.DIGITS
            for value, other in zip(values, others, strict=True)
        )


@pytest.mark.parametrize("fraction", FRACTIONS)
@pytest.mark.parametrize(("gamma", "delta"), PLANTS)
def test_plant_is_the_closed_form_with_time_reversal(gamma, delta, fraction):
    with mp.workdps(1500):
        d1 = (
            -2
            * mp.exp(-mpf(delta) / 2)
            * mp.cosh(mp.sqrt(mp.mpc(mpf(delta) ** 2 / 4 - gamma))).real
        )
        d0 = mp.exp(-mpf(delta))
        total = (1 + d1 + d0) / gamma
        n2 = step(gamma, delta, 1 - mpf(fraction))
        if fraction:
            n0 = d0 * step(gamma, -delta, mpf(fraction))
            n1 = total - n2 - n0
        else:
            n1, n0 = d0 * step(gamma, -delta, 1), mpf(0)
        difference = n2 - n1 + n0 if delta or fraction else mpf(0)
        assert agree(truth.plant(gamma, delta, fraction), (d1, d0, n2, n1, n0, total, difference))


@pytest.mark.parametrize(("gamma", "delta"), [(0.0, 0.0), (0.0, 0.1), (0.25, 1.0), (1e-3, 0.015)])
def test_motion_is_the_matrix_exponential(gamma, delta):
    with mp.workdps(100):
        time = mpf(3) / 4
        flow = mp.expm(mp.matrix([[0, 1, 0], [-gamma, -delta, 1], [0, 0, 0]]) * time, "taylor")
        assert agree(truth.motion(gamma, delta, time), (flow[0, 2], flow[1, 2]))


def test_plant_without_spring_and_damper_is_rational():
    assert truth.plant(0.0, 0.0) == (-2, 1, 0.5, 0.5, 0, 1, 0)
    assert truth.plant(0.0, 0.0, 0.5) == (-2, 1, 0.125, 0.75, 0.125, 1, -0.5)


@pytest.mark.parametrize("scene", SCENES)
def test_roots_expand_to_the_polynomial(scene):
    coefficients = truth.polynomial(*scene)
    whole = floor(scene[-1])
    assert (
        len(coefficients) - 1 == truth.degree(scene[-1]) == whole + (3 if whole == scene[-1] else 4)
    )
    product = [mp.mpc(1)]
    with mp.workdps(60):
        for root in truth.roots(*scene):
            product = [a - root * b for a, b in zip([*product, 0], [0, *product], strict=True)]
        for got, expected in zip(product, coefficients, strict=True):
            assert abs(got - expected) < mpf(10) ** -45


def test_polynomial_at_a_root_of_the_loop_closes_the_loop():
    alpha, beta, gamma, delta, delay = 0.1, 0.5, 1e-3, 0.015, 2.25
    p = truth.plant(gamma, delta, 0.25)
    for z in truth.roots(alpha, beta, gamma, delta, delay):
        force = mpf(alpha) + beta * (1 - 1 / z)
        numerator = truth.evaluate((p.n2, p.n1, p.n0), z)
        denominator = truth.evaluate((1, p.d1, p.d0), z)
        assert abs(force * numerator / denominator / z**3 + 1) < mpf(10) ** -45


@pytest.mark.parametrize("delay", [0.0, 1.0, 2.5])
def test_boundary_point_has_its_root_and_marks_the_verdict(delay):
    gamma, delta, theta = 1e-3, 0.015, 0.2
    gains = truth.boundary_point(theta, gamma, delta, delay)
    assert truth.unstable_count(*gains, gamma, delta, delay) is None
    modulus = [abs(abs(r) - 1) for r in truth.roots(*gains, gamma, delta, delay)]
    assert min(modulus) < mpf(10) ** -50
    alpha, beta = gains
    assert truth.unstable_count(alpha * mpf("0.999"), beta, gamma, delta, delay) == 0
    assert truth.unstable_count(alpha * mpf("1.001"), beta, gamma, delta, delay) == 2


def test_multiple_roots_are_certified():
    assert truth.roots(0.0, 0.0, 0.0, 0.0, 1.0) == [1, 1, 0, 0]
    assert truth.unstable_count(0.0, 0.0, 0.0, 0.0, 1.0) is None
    first, second, *rest = truth.roots(0.0, 0.0, 1.0, 2.0, 0.0)
    assert first == second
    assert agree([first.real], [mp.exp(-1)])
    assert rest == [0]


def test_spectral_radius_bounds_are_tight():
    lower, upper = truth.spectral_radius(0.1, 0.5, 1e-3, 0.015, 1.0)
    assert 0 <= upper - lower < mpf(10) ** -50
    with mp.workdps(200):
        assert lower <= abs(truth.roots(0.1, 0.5, 1e-3, 0.015, 1.0)[0]) <= upper


def test_printed_equation_is_right_where_it_is_well_conditioned():
    exact, printed = truth.plant(1.5, 0.75), printed_plant(1.5, 0.75)
    wanted = (exact.d1, exact.d0, exact.n2, exact.n1)
    assert all(truth.ulps(float(x), y) < 50 for x, y in zip(printed, wanted, strict=True))
    assert np.isnan(printed_plant(0.25, 1.0)[2])
    assert np.isnan(printed_plant(0.0, 1.0)[2])


def test_ulps_measure_the_relative_error():
    assert truth.ulps(1 + 3 * 2.0**-52, mpf(1)) == 3
    assert truth.ulps(0.0, mpf(0)) == 0
    assert truth.ulps(1e-320, mpf(0)) == truth.ulps(float("nan"), mpf(1)) == float("inf")


# ------------------------------------------------------------------------------ the tables of data/


@pytest.fixture(scope="module")
def reference():
    spec = importlib.util.spec_from_file_location("make_reference", REFERENCE / "make_reference.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["coefficients.tsv", "roots.tsv", "boundary.tsv", "anchors.tsv"])
def test_committed_tables_are_what_the_script_makes(reference, name):
    table = reference.TABLES[name]
    lines = (REFERENCE / name).read_text(encoding="utf-8").splitlines(keepends=True)
    header = [line for line in lines if line.startswith("#")]
    assert lines[len(header)].split() == table.columns.split()
    rng = np.random.default_rng(20)
    for i in rng.choice(len(table.points), size=8, replace=False):
        for line in table.lines(table.points[i]):
            assert line in lines


def test_anchors_are_the_closed_forms_without_delay(reference):
    _, _, alpha, beta = reference.largest_alpha(0.0, 0.0, 0.0)
    assert agree((alpha, beta), (12 - 8 * mp.sqrt(2), 2 * mp.sqrt(2) - 2))
    _, radius, alpha, beta = reference.smallest_radius(0.0, 0.0, 0.0)
    triple = mp.cbrt(4) - 1
    assert agree((radius, alpha, beta), (triple, 6 * triple**2 - 2, 2 * triple**3))
