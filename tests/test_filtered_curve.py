"""The curve of loops with filters and devices: points, lift and slopes, against exact polynomials.

The wall that puts roots at e^(+-i theta) comes from balls, by Cramer's rule; slopes come from such
walls on either side.
"""

import flint
import numpy as np
import pytest

from benchmarks.truth.balls import BallLoop
from benchmarks.truth.random_loops import MassLoop
from jaxstab.region.curve import curve_and_lift, minus_offset, minus_slope, plus_offset
from jaxstab.region.filtered_curve import FilteredCurve, filtered_curve, mass_system
from jaxstab.region.pieces import slice_angles

ANGLES = np.concatenate([np.linspace(0.05, 1.5, 7), np.linspace(1.65, 3.05, 7)])
LOOPS = range(1, 25)


def drawn(number: int) -> tuple[FilteredCurve, BallLoop]:
    loop = MassLoop.drawn(np.random.default_rng([20121120, number]))
    return filtered_curve(*mass_system(*loop.plant, loop.filters[:2])), loop.balls


def walls(balls: BallLoop, angles: np.ndarray) -> np.ndarray:
    return np.array([balls.wall_with_roots_at(theta) for theta in angles.tolist()]).T


def value_at(balls: BallLoop, place: int) -> tuple[float, float, float]:
    """Base, stiffness and damping at z = 1 or -1."""
    with flint.ctx.workprec(max(balls.bits, 1000)):
        return tuple(float(flint.arb_poly(part)(place).mid()) for part in balls[:3])


@pytest.mark.parametrize("number", LOOPS)
def test_walls_of_the_curve_have_roots_at_its_angles(number: int) -> None:
    c, balls = drawn(number)
    alpha, beta, lift = curve_and_lift(c, ANGLES)
    true = walls(balls, ANGLES)
    size = np.max(np.abs(true), axis=0)
    assert np.max(np.abs(np.stack([alpha, beta]) - true) / size) < 1e-10
    base, stiffness, _ = value_at(balls, 1)
    assert plus_offset(c) == pytest.approx(-base / stiffness, rel=1e-10, abs=1e-13)
    far = ANGLES > 1.0  # next to 0 the difference has no digits
    exact = (true[0] + base / stiffness) / (1.0 - np.cos(ANGLES))
    assert lift[far] == pytest.approx(exact[far], rel=1e-9, abs=1e-9 * size[far].max())


@pytest.mark.parametrize("number", LOOPS)
def test_slopes_of_the_curve_are_those_of_walls_on_either_side(number: int) -> None:
    """A complex step of theta adds the slopes; central differences of h and 2 h, extrapolated."""
    c, balls = drawn(number)
    step = 1e-30
    moved = np.stack(curve_and_lift(c, ANGLES + 1j * step)[:2]).imag / step
    h = 1e-4
    near, far = (
        (walls(balls, ANGLES + k * h) - walls(balls, ANGLES - k * h)) / (2.0 * k * h)
        for k in (1, 2)
    )
    exact = (4.0 * near - far) / 3.0
    size = np.max(np.abs(exact), axis=0) + np.max(np.abs(walls(balls, ANGLES)), axis=0)
    bend = np.max(np.abs(near - far), axis=0)
    assert np.all(np.abs(moved - exact) < 1e-6 * size + bend)


@pytest.mark.parametrize("number", LOOPS)
def test_the_line_of_a_root_at_minus_one_is_that_of_the_polynomial(number: int) -> None:
    c, balls = drawn(number)
    base, stiffness, damping = value_at(balls, -1)
    if abs(stiffness) > 1e-9 * abs(damping):
        assert minus_offset(c) == pytest.approx(-base / stiffness, rel=1e-9)
        assert minus_slope(c) == pytest.approx(damping / stiffness, rel=1e-9)


def test_a_scan_looks_on_either_side_of_poles_and_where_beta_is_steep() -> None:
    """The curve changes within the distance of a pole from the circle, on both of its sides."""
    looked = 0
    for number in LOOPS:
        c, _ = drawn(number)
        angles = np.sort(np.abs(slice_angles(c, c.parts.shape[1] - 2, 1)))
        for place in np.concatenate([c.poles[0], c.steep]):
            if angles[0] + 1e-3 < place < angles[-1] - 1e-3:
                away = angles - place
                assert np.min(away[away > 0.0]) < 1e-6
                assert np.max(away[away < 0.0]) > -1e-6
                looked += 1
    assert looked > 5
