"""Slow filters of high order, of which float64 knows nothing, against balls of python-flint."""

from functools import cache, partial
from itertools import pairwise

import flint
import numpy as np
import pytest
from mpmath import mp, mpf

import jaxstab
from benchmarks.loops import probes
from benchmarks.truth.filtered import FilteredLoop, average, difference
from benchmarks.truth.random_loops import DeviceLoop, MassLoop
from jaxstab.model import Velocity, by_name
from jaxstab.model.double_double import DoubleDouble
from jaxstab.region import RegionStatus
from jaxstab.region import region as region_of_slices
from jaxstab.region.curve import (
    hardly_moved,
    parts_in_pairs,
    stretches_around,
    to_rescaled,
    true_angles,
)
from jaxstab.region.exact import _about, angles_on_circle, polished_angles, polished_modes
from jaxstab.region.pieces import scan_angles
from jaxstab.region.points import curve_and_lift, exact_walls

SLOW = [1646, 2638, 2649]  # low passes and Butterworth filters of order 6 to 8, below 0.016


@cache
def drawn(number, kind=MassLoop):
    """A loop of the benchmark, its region, and numbers to go on with."""
    rng = np.random.default_rng([20121120, number])
    loop = kind.drawn(rng)
    return loop, loop.region(), rng


def assert_right_next_to_the_boundary(loop, region, rng):
    points = probes(region, loop.balls, rng)
    truths = [loop.balls.is_stable(*point) for point in points.tolist()]
    assert None not in truths
    assert np.array_equal(region.contains(*points.T), truths)


@pytest.mark.campaign
@pytest.mark.parametrize("number", SLOW)
def test_regions_of_slow_filters_are_right(number):
    loop, region, rng = drawn(number)
    assert region.status == RegionStatus.COMPLETE
    assert_right_next_to_the_boundary(loop, region, rng)


def test_a_curve_that_turns_as_soon_as_it_sets_out_is_followed():
    """beta is least at theta = 0.0051, below 3e-8 of its range: no vertex was there."""
    loop, region, _ = drawn(762)
    walls = np.array([loop.balls.wall_with_roots_at(theta) for theta in (0.0045, 0.0051, 0.0055)])
    aside = 1e-9 * np.ptp(region.points[:, 1])
    for alpha, beta in walls.tolist():
        for wall in ((alpha, beta - aside), (alpha, beta + aside)):
            assert region.contains(*wall) == loop.balls.is_stable(*wall)


@pytest.mark.parametrize("wrong", [{"size": 0}, {"resolved": np.False_}])
def test_more_digits_are_tried_before_nothing_is_called_stable_or_resolved(wrong, monkeypatch):
    answer = partial(
        jaxstab.stable_region,
        **by_name(0.5, 0.1, 1.0),
        velocity=Velocity.difference(samples=4),
    )
    expected, real = answer().area, region_of_slices._audited

    def audited(c, *arguments):
        outline, pieces = real(c, *arguments)
        return outline if c.is_exact else outline._replace(**wrong), pieces

    monkeypatch.setattr(region_of_slices, "_audited", audited)
    region = answer()
    assert region.curve.is_exact
    assert region.status == RegionStatus.COMPLETE
    assert region.area == pytest.approx(expected, rel=1e-6)


@pytest.mark.campaign
@pytest.mark.parametrize("number", [617, 3049, 3072])
def test_outlines_of_devices_that_stray_from_the_curve(number):
    """The first had a wrong point 6e-11 of the region's size from the boundary, the last one 5e-9.

    There a vertex of the outline rounded to the end of its piece, and came after that corner.
    """
    loop, region, rng = drawn(number, DeviceLoop)
    assert region.curve.is_exact
    assert_right_next_to_the_boundary(loop, region, rng)


@pytest.mark.parametrize(
    ("number", "status"), [(861, RegionStatus.EMPTY), (40, RegionStatus.COMPLETE)]
)
def test_modes_that_nothing_damps_leave_the_circle_with_the_first_gain(number, status):
    """Next to no gain they are next to the circle: not each wall there is on the boundary."""
    loop, region, rng = drawn(number, DeviceLoop)
    assert region.status == status
    assert_right_next_to_the_boundary(loop, region, rng)


@pytest.mark.campaign
@pytest.mark.parametrize("number", [25, 180, 371, 722, 978])
def test_arcs_that_the_curve_passes_in_an_instant(number):
    """Fast roots that slow filters hardly move: between two angles in float64 lie whole arcs."""
    loop, region, rng = drawn(number)
    assert region.status == RegionStatus.COMPLETE
    assert region.curve.stretches
    assert_right_next_to_the_boundary(loop, region, rng)


def test_modes_that_walls_hardly_move_are_known_to_all_digits():
    loop = DeviceLoop.hardly_moved(np.random.default_rng([20121120, 329]))
    system = loop.sampled.plant, *loop.sampled.transfers(loop.filters[:2]), 1.0
    narrow = polished_modes(parts_in_pairs(system), hardly_moved(loop.sampled.plant))
    truths = loop.balls.modes()
    assert len(truths) == 4  # of which walls move one
    for high, low in zip(narrow.hi.tolist(), narrow.lo.tolist(), strict=True):
        assert min(abs(float(truth - high - low)) for truth in truths) < 1e-28


def test_stretches_stand_for_angles():
    centers = DoubleDouble(np.array([0.3, 2.5]), np.array([1e-17, -2e-17]))
    stretches = stretches_around(centers, np.array([2.4]))
    assert [one.half_width for one in stretches] == pytest.approx([0.05, 0.045])
    size = np.array([0.1, 0.3, 0.301, 0.3499, 2.46, 2.5 + 1e-9, 2.6])
    nothing = np.zeros_like(size)
    angles, speed = true_angles(stretches, size, nothing)
    np.testing.assert_allclose(to_rescaled(stretches, angles), size, rtol=1e-11)
    for k, one in ((2, stretches[0]), (5, stretches[1])):
        growth = mp.log(2 * mpf(one.half_width) / mpf(10) ** -24)
        share = (mpf(size[k]) - mpf(one.angle)) / mpf(one.half_width)
        offset = mpf(one.half_width) * mp.sinh(growth * share) / mp.sinh(growth)
        truth = mpf(one.angle) + mpf(one.low) + offset
        gap = mpf(angles.hi[k]) + mpf(angles.lo[k]) - truth
        assert abs(gap) < 1e-11 * abs(offset) + mpf(10) ** -30
        slope = growth * mp.cosh(growth * share) / mp.sinh(growth)
        assert speed[k] == pytest.approx(float(slope), rel=1e-11)
    assert angles.hi[[0, 1, 6]].tolist() == size[[0, 1, 6]].tolist()
    assert angles.lo[1] == 1e-17


@pytest.mark.parametrize("number", SLOW)
def test_the_curve_of_slow_filters_has_all_digits(number):
    loop, region, _ = drawn(number)
    outline = region.outline
    angles = outline.angles[:, 0][outline.branches == 0][::20]
    assert len(angles) > 10
    gains = np.array(curve_and_lift(region.curve, angles)[:2])
    truth = np.array([loop.balls.wall_with_roots_at(float(angle)) for angle in angles]).T
    size = np.ptp(region.points, axis=0)[:, None]
    assert np.max(abs(gains - truth) / size) < 1e-12


@pytest.mark.parametrize("theta", [0.007, 0.8, 2.3, 3.1])
def test_slopes_of_the_curve_are_those_of_its_points(theta):
    """Also in the half next to z = -1, which is unfolded."""
    loop, region, _ = drawn(SLOW[0])
    curve = region.curve
    step = 1e-6
    moved = [np.array(loop.balls.wall_with_roots_at(theta + sign * step)) for sign in (1, -1)]
    complex_step = 1e-200
    values = np.array(curve_and_lift(curve, np.array([theta + 1j * complex_step]))[:2])
    slopes = values[:, 0].imag / complex_step
    np.testing.assert_allclose(slopes, (moved[0] - moved[1]) / (2 * step), rtol=1e-6)


@pytest.mark.parametrize("theta", [0.003, 0.02, 0.7, 2.3])
def test_roots_on_the_circle_are_found_and_polished_to_all_digits(theta):
    """Of a wall on the curve: near z = 1 from the polynomial in powers of z - 1."""
    _, region, _ = drawn(SLOW[0])
    curve = region.curve
    walls = exact_walls(curve, np.array([theta]))
    step = np.exp(1j * theta) - 1.0
    near = step * (1.0 + np.array([1e-7, 1e-9j, -1e-8]))
    angles, excess = polished_angles(curve.pairs, *(wall[[0, 0, 0]] for wall in walls), near)
    assert angles.rounded() == pytest.approx(theta, rel=1e-15)
    assert np.max(np.abs(excess)) < 1e-20
    every = angles_on_circle(curve, *walls, within=1e-20).rounded()
    assert np.min(np.abs(every - theta)) < 1e-14 * theta


def test_angles_of_a_scan_are_close_to_the_poles_that_float64_misses():
    loop, region, _ = drawn(SLOW[0])
    curve = region.curve
    angles = np.abs(scan_angles(curve, 1))
    signs = []
    for theta in np.geomspace(1e-3, 0.5, 60):
        with flint.ctx.workprec(600):
            z = flint.acb(0, theta).exp()
            stiffness, damping = (flint.acb_poly(part)(z) for part in loop.balls[1:3])
            signs.append((theta, (stiffness.conjugate() * damping).imag > 0))
    poles = [(low, high) for (low, one), (high, two) in pairwise(signs) if one != two]
    assert len(poles) == 3
    for low, high in poles:
        assert np.sum((angles > low) & (angles < high)) > 8


def test_slice_that_its_own_form_does_not_resolve():
    """gamma next to (2 pi)^2: a cosine of the hand's own frequency loses all digits."""
    plant = 39.48888856851112, 0.0, 5.153715254681396
    region = jaxstab.stable_region(**by_name(*plant))
    assert region.status == RegionStatus.COMPLETE
    rng = np.random.default_rng(3)
    size = np.ptp(region.points, axis=0)
    near = region.points[rng.integers(0, len(region.points), 40)]
    points = near + size * 1e-6 * rng.normal(size=near.shape)
    balls = FilteredLoop(*plant, difference(1), average(1)).balls()
    truths = [balls.is_stable(*point) for point in points.tolist()]
    assert np.array_equal(region.contains(*points.T), truths)


@pytest.mark.parametrize("samples", [2, 10, 20])
def test_a_root_that_no_wall_moves_leaves_nothing(samples):
    """An undamped hand at the Nyquist frequency: pi^2 in float64 moves its root at -1 by 1e-32."""
    window = jaxstab.Velocity.difference(samples=samples)
    region = jaxstab.stable_region(gamma=float(np.pi**2), delta=0.0, delay=0.0, velocity=window)
    assert region.status == RegionStatus.EMPTY


def test_polynomials_are_moved_to_all_digits(rng):
    hi = rng.normal(size=(30, 3))
    moved = _about(DoubleDouble.from_value(hi), 0.1)
    with mp.workdps(60):
        step = mpf(0.1)
        for part in range(3):
            rising = [mpf(value) for value in hi[::-1, part]]
            for j in range(30):
                terms = [mp.binomial(k, j) * step ** (k - j) * rising[k] for k in range(j, 30)]
                found = mpf(moved.hi[29 - j, part]) + mpf(moved.lo[29 - j, part])
                assert abs(found - sum(terms)) < 1e-30 * sum(map(abs, terms))
