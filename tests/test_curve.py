"""The curve of loops with filters and devices: points, lift and slopes, against exact polynomials.

The wall that puts roots at e^(+-i theta) comes from balls, by Cramer's rule; slopes come from such
walls on either side.
"""

import flint
import numpy as np
import pytest

from benchmarks.truth import filtered
from benchmarks.truth.balls import BallLoop
from benchmarks.truth.random_loops import MassLoop
from jaxstab.conventions import Verdict
from jaxstab.model import Filter, Velocity, by_name
from jaxstab.model.filters import known_filters
from jaxstab.region import RegionStatus, stable_region
from jaxstab.region.curve import (
    Curve,
    curve_of_system,
    mass_system,
    parts_in_pairs,
)
from jaxstab.region.pieces import find_pieces, scan_angles
from jaxstab.region.points import curve_and_lift, is_oriented

ANGLES = np.concatenate([np.linspace(0.05, 1.5, 7), np.linspace(1.65, 3.05, 7)])
LOOPS = range(1, 25)


def drawn(number: int) -> tuple[Curve, BallLoop]:
    loop = MassLoop.drawn(np.random.default_rng([20121120, number]))
    return curve_of_system(mass_system(*loop.plant, loop.filters[:2])), loop.balls


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
    assert c.plus_offset == pytest.approx(-base / stiffness, rel=1e-10, abs=1e-13)
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
        own_base, own_stiffness, own_damping = c.at_minus_one
        assert own_base / own_stiffness == pytest.approx(base / stiffness, rel=1e-9)
        assert own_damping / own_stiffness == pytest.approx(damping / stiffness, rel=1e-9)


@pytest.mark.parametrize("number", LOOPS)
def test_angles_have_the_sign_of_the_imaginary_part_of_the_estimator(number: int) -> None:
    c, balls = drawn(number)
    z = np.exp(1j * ANGLES)
    stiffness, damping = (
        np.polyval([float(x.mid()) for x in list(part)[::-1]], z) for part in balls[1:3]
    )
    ratio = damping / stiffness
    clear = np.abs(ratio.imag) > 1e-6 * np.abs(ratio)
    for sign in (1.0, -1.0):
        expected = (ratio.imag > 0.0) == (sign > 0.0)
        assert is_oriented(c, sign * ANGLES)[clear].tolist() == expected[clear].tolist()


@pytest.mark.parametrize("number", LOOPS)
def test_parts_in_pairs_are_the_polynomial_of_the_loop_on_both_halves(number: int) -> None:
    """In powers of zeta and of zeta - 1, with z = zeta and z = -zeta."""
    loop = MassLoop.drawn(np.random.default_rng([20121120, number]))
    pairs = parts_in_pairs(mass_system(*loop.plant, loop.filters[:2]))
    zeta = np.exp(0.4j)
    for half, z in ((0, zeta), (1, -zeta)):
        with flint.ctx.workprec(1000):
            at = flint.acb(z.real, z.imag)
            true = [complex(flint.acb_poly(part)(at)) for part in loop.balls[:3]]
        for form, base in ((0, zeta), (1, zeta - 1.0)):
            rows = pairs[half, form, 0]
            values = rows @ base ** np.arange(rows.shape[-1])
            size = np.abs(rows) @ np.abs(base) ** np.arange(rows.shape[-1])
            cross = values * true[0] - values[0] * np.array(true)
            assert np.all(np.abs(cross) < 1e-13 * (size * abs(true[0]) + size[0] * np.abs(true)))


def test_a_scan_looks_on_either_side_of_poles_and_where_beta_is_steep() -> None:
    """The curve changes within the distance of a pole from the circle, on both of its sides."""
    looked = 0
    for number in LOOPS:
        c, _ = drawn(number)
        angles = np.sort(np.abs(scan_angles(c, 1)))
        for place in np.concatenate([c.poles[0], c.steep]):
            if angles[0] + 1e-3 < place < angles[-1] - 1e-3:
                away = angles - place
                assert np.min(away[away > 0.0]) < 1e-6
                assert np.max(away[away < 0.0]) > -1e-6
                looked += 1
    assert looked > 5


@pytest.mark.parametrize(
    ("samples", "average", "delay"),
    [(3, 1, 1.0), (5, 1, 2.0), (8, 1, 1.5), (4, 3, 0.5), (6, 4, 1.0)],
)
def test_walls_of_a_line_and_of_the_curve_beside_it_have_roots_at_its_angles(
    samples: int, average: int, delay: float
) -> None:
    """Undamped, behind windows: whole lines of walls have one pair of roots on the circle.

    The slopes are central differences. A simple pole's line begins where its curve ends; at a
    double one both are infinite.
    """
    position = Filter.average(samples=average) if average > 1 else None
    filters = known_filters(Velocity.difference(samples=samples), position)
    c = curve_of_system(mass_system(0.5, 0.0, delay, filters))
    windows = filtered.difference(samples), filtered.average(average)
    loop = filtered.FilteredLoop(0.5, 0.0, delay, *windows)
    assert len(c.lines)
    for line in c.lines:
        share = np.concatenate([np.linspace(0.03, 0.47, 12), np.linspace(0.53, 0.97, 12)])
        size = line.angle + line.half_width * np.concatenate([-share, share])
        (alpha, beta, angle), slopes = line.gains(size)
        for wall in zip(alpha, beta, angle, strict=True):
            falling = [float(c.mid()) for c in loop.polynomial(*wall[:2])]
            assert abs(np.polyval(falling, np.exp(1j * wall[2]))) < 1e-13 * np.abs(falling).sum()
        straight = line.is_straight(size)
        assert np.all(angle[straight] == line.angle)
        assert np.all(abs(angle[~straight] - line.angle) > 0.0)
        step = 1e-5 * line.half_width
        ahead, behind = (np.stack(line.gains(size + k * step)[0]) for k in (1.0, -1.0))
        expected, scale = (ahead - behind) / (2.0 * step), np.abs(ahead) + np.abs(behind)
        assert np.all(abs(np.stack(slopes) - expected) < 1e-6 * (abs(expected) + scale))
        lift = curve_and_lift(c, size)[2]
        assert lift == pytest.approx((alpha - c.plus_offset) / (1.0 - np.cos(angle)), rel=1e-9)
        moved = curve_and_lift(c, size + 1e-30j)[2].imag / 1e-30
        ahead, behind = (curve_and_lift(c, size + k * step)[2] for k in (1.0, -1.0))
        expected, scale = (ahead - behind) / (2.0 * step), np.abs(ahead) + np.abs(behind)
        assert np.all(abs(moved - expected) < 1e-6 * (abs(expected) + scale))
        for knot in line.knots:
            before, after = (np.stack(line.gains(np.array([knot + k]))[0]) for k in (-1e-9, 1e-9))
            assert after == pytest.approx(before, rel=1e-5)


@pytest.mark.parametrize(
    ("samples", "average", "gamma", "delay"),
    [
        *[(4, 1, 2.0, 1.5), (5, 4, 2.0, 0.5), (7, 1, 0.5, 3.0), (8, 4, 0.5, 2.0), (3, 1, 0.3, 1.0)],
        (5, 2, 9.0, 1.5),  # the curve bounds the set up to z = -1
    ],
)
def test_regions_between_lines_are_resolved_and_hold_the_walls_that_certified_roots_hold(
    samples: int, average: int, gamma: float, delay: float
) -> None:
    """Their boundaries turn from the curve into whole lines and back."""
    named = {"velocity": Velocity.difference(samples=samples)}
    if average > 1:
        named["position"] = Filter.average(samples=average)
    region = stable_region(**by_name(gamma, 0.0, delay), **named)
    assert region.status == RegionStatus.COMPLETE
    windows = filtered.difference(samples), filtered.average(average)
    loop = filtered.FilteredLoop(gamma, 0.0, delay, *windows)
    outline = region.points
    low, high = outline.min(axis=0), outline.max(axis=0)
    rng = np.random.default_rng(samples)
    walls = rng.uniform(low - 0.1 * (high - low), high + 0.1 * (high - low), (60, 2))
    inside = [loop.code(*wall) == Verdict.STABLE for wall in walls.tolist()]
    assert 5 < sum(inside) < 55
    assert np.asarray(region.contains(*walls.T)).tolist() == inside


@pytest.mark.parametrize("number", [18, 20, 30])
def test_pieces_do_not_close_to_a_loop_if_the_scan_misses_one_of_them(number: int) -> None:
    c, balls = drawn(number)
    angles = scan_angles(c, 1)
    pieces = find_pieces(c, angles)
    assert pieces.resolved
    assert sorted(pieces.successor.tolist()) == list(range(len(pieces.begin))) != [0]
    for begin, end, low, high in zip(*pieces[:4], strict=True):
        for theta in (begin + low, end + high):  # a third root comes to the circle
            if 0.0 < abs(theta) < np.pi:
                assert np.sum(np.abs(np.abs(roots_at(balls, theta)) - 1.0) < 1e-5) >= 3
        others = angles[(angles < begin) | (angles > end)]
        assert not find_pieces(c, others).resolved


def roots_at(balls: BallLoop, theta: float) -> np.ndarray:
    falling = balls.polynomial(*balls.wall_with_roots_at(theta))
    return np.roots([float(c.mid()) for c in falling])
