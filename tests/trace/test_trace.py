"""The traced boundary against the closed form, certified roots and counts of unstable roots."""

from math import pi

import jax
import numpy as np
import pytest
from mpmath import mp
from scipy.spatial import KDTree

from jaxstab import Device, Filter, HapticLoop, Mode, Velocity
from jaxstab.paper import minus_line
from jaxstab.region import boundary_curve
from jaxstab.region.pieces import Branch
from jaxstab.trace import TraceStatus, trace_boundary
from tests.truth import filtered
from tests.truth import loop as truth

LOOP = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)

# plane, window, fixed, and how the parameters follow from the axes
PLANES = {
    "alpha-beta": (
        ("alpha", "beta"),
        ((-0.05, 0.2), (-0.1, 0.9)),
        {"gamma": 1e-3, "delta": 0.015, "delay": 1.0},
        lambda x, y: (x, y, 1e-3, 0.015, 1.0),
    ),
    "gamma-alpha": (
        ("gamma", "alpha"),
        ((0.0, 1.0), (-0.5, 0.5)),
        {"beta": 0.2, "delta": 0.1, "delay": 1.0},
        lambda x, y: (y, 0.2, x, 0.1, 1.0),
    ),
    "gamma-delta": (
        ("gamma", "delta"),
        ((0.0, 12.0), (1e-3, 1.0)),
        {"alpha": 0.2, "beta": 0.1, "delay": 1.0},
        lambda x, y: (0.2, 0.1, x, y, 1.0),
    ),
    "gamma-delay": (
        ("gamma", "delay"),
        ((0.0, 12.0), (0.0, 6.0)),
        {"alpha": 0.2, "beta": 0.1, "delta": 0.2},
        lambda x, y: (0.2, 0.1, x, 0.2, y),
    ),
    "stiffness-sample_time": (
        ("stiffness", "sample_time"),
        ((0.0, 2e4), (1e-4, 5e-3)),
        {"mass": 0.1, "physical_damping": 1.5, "physical_stiffness": 0.0}
        | {"damping": 10.0, "time_delay": 1e-3},
        lambda x, y: (x * y**2 / 0.1, 10 * y / 0.1, 0.0, 1.5 * y / 0.1, 1e-3 / y),
    ),
    "stiffness-time_delay": (
        ("stiffness", "time_delay"),
        ((0.0, 2e4), (0.0, 5e-3)),
        {"mass": 0.1, "physical_damping": 1.5, "physical_stiffness": 0.0}
        | {"damping": 10.0, "sample_time": 1e-3},
        lambda x, y: (x * 1e-5, 0.1, 0.0, 0.015, y / 1e-3),
    ),
}


def few_and_campaign(table, *few):
    """Names of a table: a few, and the others as a campaign."""
    yield from few
    yield from (pytest.param(x, marks=pytest.mark.campaign) for x in table if x not in few)


@pytest.fixture(
    scope="module", params=[*few_and_campaign(PLANES, "gamma-delta", "stiffness-time_delay")]
)
def traced(request):
    plane, window, fixed, loop_of = PLANES[request.param]
    return trace_boundary(plane, window, **fixed), np.array(window), loop_of


def roots_outside(loop):
    """By NumPy's companion eigenvalues; a root within 1e-6 of the circle counts as none."""
    coefficients = [float(c) for c in truth.polynomial(*loop)]
    moduli = np.abs(np.roots(coefficients))
    return None if np.any(np.abs(moduli - 1) < 1e-6) else int(np.sum(moduli > 1))


def in_window(points, window):
    """In units of the window."""
    return (points - window[:, 0]) / (window[:, 1] - window[:, 0])


def distance_to_segment(points, start, end):
    chord = end - start
    along = np.clip((points - start) @ chord / (chord @ chord), 0.0, 1.0)
    return np.linalg.norm(points - start - along[:, None] * chord, axis=1)


def test_neighbours_are_as_near_as_the_resolution_says(traced):
    trace, window, _ = traced
    assert np.all(trace.status == TraceStatus.CONVERGED)
    unit = in_window(trace.points, window)
    assert np.all((unit > -1e-9) & (unit < 1 + 1e-9))
    same = np.diff(trace.piece) == 0
    steps = np.linalg.norm(np.diff(unit, axis=0), axis=1)[same]
    assert np.max(steps) <= trace.resolution * (1 + 1e-6)


def test_points_have_their_root_on_the_circle(traced, rng):
    trace, _, loop_of = traced
    assert np.max(trace.residual) < 1e-14
    for number in rng.choice(len(trace.points), 12, replace=False):
        loop = [max(v, 0.0) if i > 1 else v for i, v in enumerate(loop_of(*trace.points[number]))]
        value = truth.evaluate(truth.polynomial(*loop), mp.expj(trace.theta[number]))
        assert abs(value) < 1e-14
        if truth.unstable_count(*loop) is not None:
            outside = [abs(root) for root in truth.roots(*loop) if abs(root) > 1 + 1e-7]
            assert trace.edge[number] == (not outside)


def test_the_number_of_unstable_roots_changes_at_each_vertex(traced, rng):
    trace, window, loop_of = traced
    inner = np.all(np.abs(in_window(trace.points, window) - 0.5) < 0.499, axis=1)
    checked = 0
    for number in rng.choice(np.flatnonzero(inner), 12, replace=False):
        around = trace.points[number] + 1e-4 * np.ptp(window, axis=1) * np.array(
            [[np.cos(turn), np.sin(turn)] for turn in np.linspace(0, 2 * pi, 8, endpoint=False)]
        )
        counts = {roots_outside(loop_of(*point)) for point in around} - {None}
        assert len(counts) > 1
        changed = 2 if trace.branch[number] == Branch.CURVE else 1
        if len(counts) == 2:  # no corner is as near
            assert max(counts) - min(counts) == changed
            assert trace.edge[number] == (0 in counts)
            checked += 1
    assert checked > 0


def test_the_number_of_unstable_roots_changes_only_across_the_trace(traced, rng):
    trace, window, loop_of = traced
    unit = in_window(trace.points, window)
    changes = 0
    for start, move in zip(rng.uniform(0, 1, (60, 2)), rng.normal(0, 0.05, (60, 2)), strict=True):
        ends = np.stack([start, np.clip(start + move, 0, 1)])
        counts = [
            roots_outside(loop_of(*(window[:, 0] + end * np.ptp(window, axis=1)))) for end in ends
        ]
        if None not in counts and counts[0] != counts[1]:
            changes += 1
            assert np.min(distance_to_segment(unit, *ends)) < trace.resolution
    assert changes > 0


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("window", "gamma", "delta", "delay"),
    [
        (((-0.05, 0.2), (-0.1, 0.9)), 1e-3, 0.015, 1.0),
        (((-12.0, 4.0), (-4.0, 12.0)), 3.0, 0.015, 5.5),
        (((-0.5, 0.8), (-0.1, 2.1)), 0.0, 0.0, 0.0),
    ],
)
def test_in_the_plane_of_gains_the_trace_is_the_closed_form(window, gamma, delta, delay):
    trace = trace_boundary(("alpha", "beta"), window, gamma=gamma, delta=delta, delay=delay)
    scale = np.maximum(1.0, np.abs(trace.points))
    pair = trace.branch == Branch.CURVE
    curve = np.stack(
        boundary_curve(trace.theta[pair], gamma=gamma, delta=delta, delay=delay), axis=1
    )
    assert np.max(np.abs(curve - trace.points[pair]) / scale[pair]) < 1e-12
    plus, minus = (trace.points[trace.branch == b] for b in (Branch.Z_PLUS_ONE, Branch.Z_MINUS_ONE))
    assert np.max(np.abs(plus[:, 0] + gamma), initial=0.0) < 1e-12
    line = minus_line(minus[:, 1], gamma=gamma, delta=delta, delay=delay)
    assert np.max(np.abs(line - minus[:, 0]), initial=0.0) < 1e-12 * np.max(scale)
    # All of the curve in the window is there.
    box = np.array(window)
    unit = in_window(trace.points, box)
    dense = np.stack(
        boundary_curve(np.linspace(0, pi, 2001)[1:-1], gamma=gamma, delta=delta, delay=delay),
        axis=1,
    )
    dense = in_window(dense, box)
    for point in dense[np.all((dense >= 0) & (dense <= 1), axis=1)]:
        assert np.min(np.linalg.norm(unit - point, axis=1)) < trace.resolution


def test_branches_go_on_through_folds():
    plane, window, fixed, _ = PLANES["gamma-delay"]
    trace = trace_boundary(plane, window, **fixed)
    turns = 0
    for piece in range(trace.piece.max() + 1):
        step = np.diff(trace.points[trace.piece == piece], axis=0)
        turns += np.sum(np.diff(np.sign(step), axis=0) != 0)
    assert turns >= 2


def test_a_loop_gives_the_physical_quantities():
    plane, window, fixed, _ = PLANES["stiffness-time_delay"]
    by_name = trace_boundary(plane, window, **fixed)
    by_loop = trace_boundary(plane, window, loop=LOOP, damping=10.0)
    assert np.allclose(by_name.points, by_loop.points, rtol=1e-12, atol=0)


@pytest.mark.campaign
def test_lists_of_fixed_values_give_the_trace_of_each():
    plane, window, fixed, _ = PLANES["gamma-delay"]
    alphas = [0.1, 0.2, 0.3]
    traces = trace_boundary(plane, window, **(fixed | {"alpha": alphas}))
    assert len(traces) == len(alphas)
    for alpha, trace in zip(alphas, traces, strict=True):
        alone = trace_boundary(plane, window, **(fixed | {"alpha": alpha}))
        assert np.array_equal(np.bincount(trace.piece) > 0, np.bincount(alone.piece) > 0)
        for one, other in ((trace, alone), (alone, trace)):
            unit, others = (in_window(each.points, np.array(window)) for each in (one, other))
            away = np.linalg.norm(unit[:, None] - others, axis=-1).min(axis=1)
            assert np.max(away) < trace.resolution
        assert np.max(trace.residual) < 1e-14


def test_a_new_plane_compiles_nothing():
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda name, _, **__: compiled.append(name) if "backend_compile" in name else None
    )
    one, other, third, *_ = PLANES.values()
    trace_boundary(*one[:2], **one[2], resolution=0.1)
    compiled.clear()
    for plane, window, fixed, _ in (other, third, PLANES["stiffness-time_delay"]):
        trace_boundary(plane, window, **fixed, resolution=0.1)
    assert not compiled


def test_what_lies_between_the_nodes_of_the_grid_is_missed():
    # At gamma = pi^2, delta = 0 every loop without delay has a root at z = -1; beside it none has.
    trace = trace_boundary(
        ("gamma", "delta"), ((9.0, 11.0), (0.0, 1.0)), alpha=0.2, beta=0.1, delay=1.0
    )
    assert trace.points.shape == (0, 2)


def test_where_newton_fails_the_vertex_is_known_to_the_resolution(monkeypatch):
    monkeypatch.setattr("jaxstab.trace._BEYOND", -1.0)  # whatever it returns is too far away
    gamma, delta = 1e-3, 0.015
    trace = trace_boundary(
        ("alpha", "beta"), ((0.0, 0.2), (0.05, 0.8)), gamma=gamma, delta=delta, delay=1.0
    )
    assert np.all(trace.status == TraceStatus.BRACKETED)
    theta = np.linspace(1e-3, pi - 1e-3, 400_001)
    curve = np.stack(boundary_curve(theta, gamma=gamma, delta=delta, delay=1.0), axis=1)
    away, _ = KDTree(curve / [0.2, 0.75]).query(trace.points / [0.2, 0.75])
    assert 1e-6 < np.max(away) < trace.resolution / 256


def test_a_window_without_boundary_has_no_points():
    trace = trace_boundary(
        ("alpha", "beta"), ((1.0, 2.0), (10.0, 12.0)), gamma=0.1, delta=0.0, delay=1.0
    )
    assert trace.points.shape == (0, 2)
    assert trace.theta.shape == trace.edge.shape == trace.status.shape == (0,)


HELD = {"mass": 0.25, "physical_damping": 0.1, "physical_stiffness": 0.0, "sample_time": 1e-3}


def held(stiffness, mass=0.25, hand=0.0, delay=1e-3, damping=10.0):
    """The five numbers of a device in SI units at 1 kHz."""
    unit = 1e-3 / mass
    return stiffness * 1e-3 * unit, damping * unit, hand * 1e-3 * unit, 0.1 * unit, delay / 1e-3


# plane, window, fixed; estimator and filter here and, exactly, those of the truth; the five numbers
ESTIMATORS = {
    "time_delay-stiffness, a window of 20": (
        (("time_delay", "stiffness"), ((0.0, 4.5e-3), (-100.0, 4e3)), HELD | {"damping": 10.0}),
        (Velocity.difference(window=0.02), None),
        (filtered.difference(20), filtered.average(1)),
        lambda x, y: held(y, delay=x),
    ),
    "mass-stiffness, low pass behind a window": (
        (
            ("mass", "stiffness"),
            ((0.05, 0.5), (-100.0, 1e4)),
            HELD | {"damping": 10.0, "time_delay": 1.3e-3, "mass": None},
        ),
        (Velocity.difference(samples=5) * Filter.low_pass(150.0), Filter.exponential(0.7)),
        (
            filtered.times(filtered.difference(5), filtered.low_pass(0.15, 1)),
            filtered.exponential(0.7),
        ),
        lambda x, y: held(y, mass=x, delay=1.3e-3),
    ),
    "physical_stiffness-stiffness, Butterworth": (
        (
            ("physical_stiffness", "stiffness"),
            ((0.0, 2e3), (-3e3, 1e4)),
            HELD | {"damping": 10.0, "time_delay": 1e-3, "physical_stiffness": None},
        ),
        (Velocity.butterworth(100.0, order=2), Filter.average(samples=3)),
        (
            filtered.times(filtered.difference(1), filtered.butterworth(0.1, 2)),
            filtered.average(3),
        ),
        lambda x, y: held(y, hand=x),
    ),
    "damping-stiffness, a transfer function": (
        (
            ("damping", "stiffness"),
            ((-20.0, 60.0), (-500.0, 1e4)),
            HELD | {"time_delay": 0.5e-3},
        ),
        (Velocity.transfer_function([250.0, -250.0, 0.0], [1.0, -1.0, 0.25]), None),
        (
            filtered.rational(
                [filtered.exact(v) for v in (0.25, -0.25, 0.0)],
                [filtered.exact(v) for v in (1.0, -1.0, 0.25)],
            ),
            filtered.average(1),
        ),
        lambda x, y: held(y, damping=x, delay=0.5e-3),
    ),
    "alpha-beta, islands of a window of 10": (
        (("alpha", "beta"), ((-0.05, 0.5), (-1.2, 0.6)), {"gamma": 0.0, "delta": 0.0, "delay": 0}),
        (Velocity.difference(samples=10), None),
        (filtered.difference(10), filtered.average(1)),
        lambda x, y: (x, y, 0.0, 0.0, 0.0),
    ),
}
SECOND = "mass-stiffness, low pass behind a window"


@pytest.fixture(scope="module", params=[*few_and_campaign(ESTIMATORS, SECOND)])
def with_filters(request):
    (plane, window, fixed), (velocity, position), (true_velocity, true_position), loop_of = (
        ESTIMATORS[request.param]
    )
    fixed = {name: value for name, value in fixed.items() if value is not None}
    trace = trace_boundary(plane, window, velocity=velocity, position=position, **fixed)

    def polynomial(point):
        alpha, beta, gamma, delta, delay = loop_of(*(float(value) for value in point))
        hand = max(gamma, 0.0), delta, max(delay, 0.0)
        loop = filtered.FilteredLoop(*hand, true_velocity, true_position)
        return loop.balls(400).polynomial(alpha, beta)

    return trace, np.array(window), polynomial


@pytest.mark.campaign
def test_with_filters_counts_change_only_across_the_trace(with_filters, rng):
    trace, window, polynomial = with_filters
    assert np.all(trace.status == TraceStatus.CONVERGED)
    unit, changes = in_window(trace.points, window), 0
    for start, move in zip(rng.uniform(0, 1, (60, 2)), rng.normal(0, 0.1, (60, 2)), strict=True):
        ends = np.stack([start, np.clip(start + move, 0, 1)])
        moduli = [
            np.abs(np.roots([float(c) for c in polynomial(window[:, 0] + end * np.ptp(window, 1))]))
            for end in ends
        ]
        if all(np.all(np.abs(roots - 1.0) > 1e-6) for roots in moduli):
            is_crossed = np.sum(moduli[0] > 1.0) != np.sum(moduli[1] > 1.0)
            changes += is_crossed
            assert (
                not is_crossed or np.min(distance_to_segment(unit, *ends)) < 2.0 * trace.resolution
            )
    assert changes > 0


def test_with_filters_points_have_a_root_on_the_circle(with_filters, rng):
    trace, _, polynomial = with_filters
    checked = 0
    for number in rng.choice(len(trace.points), 12, replace=False):
        falling = [truth.as_mpf(c) for c in polynomial(trace.points[number])]
        z, degree = mp.expj(trace.theta[number]), len(falling) - 1
        slopes = [(degree - power) * c for power, c in enumerate(falling[:-1])]
        # A root of p lies within degree |p / p'|.
        step = degree * abs(truth.evaluate(falling, z) / truth.evaluate(slopes, z))
        assert step < 1e-10
        moduli = np.abs(np.roots([float(c) for c in falling]))
        outside = np.sort(moduli)[::-1] - 1.0
        if not np.any((outside > 1e-9) & (outside < 1e-5)):
            assert trace.edge[number] == (outside[0] < 1e-9)
            checked += 1
    assert checked > 0


@pytest.mark.parametrize(
    "velocity",
    [
        Velocity.low_pass(100.0),
        *(
            pytest.param(x, marks=pytest.mark.campaign)
            for x in (None, Velocity.difference(samples=5))
        ),
    ],
    ids=str,
)
def test_a_trace_over_delays_has_the_exact_limits_of_each_loop(velocity, rng):
    given = {"device_mass": 0.25, "device_damping": 0.1, "sample_time": 1e-3, "velocity": velocity}
    window = (1e-4, 4e-3), (10.0, 2e4)
    loop = HapticLoop(**given, delay=1e-3)
    trace = trace_boundary(("time_delay", "stiffness"), window, loop=loop, damping=10.0)
    edge = trace.points[trace.edge]
    for delay, stiffness in edge[rng.choice(len(edge), 6, replace=False)]:
        ends = HapticLoop(**given, delay=delay).stiffness_limits(10.0)
        assert np.min(np.abs(ends / stiffness - 1.0)) < 1e-9


def test_filters_of_one_kind_share_a_program():
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda name, _, **__: compiled.append(name) if "backend_compile" in name else None
    )
    slices = {"gamma": 0.0, "delta": 0.01, "resolution": 0.1}
    trace_boundary(
        ("delay", "alpha"),
        ((0.0, 3.0), (0.0, 0.1)),
        beta=0.1,
        velocity=Velocity.low_pass(0.1),
        **slices,
    )
    window = (0.0, 0.1), (0.0, 0.5)
    for velocity in (
        Velocity.low_pass(0.2),
        Velocity.difference(samples=20),
        Velocity.butterworth(0.1, order=4),
    ):
        compiled.clear()
        trace_boundary(("alpha", "beta"), window, delay=1.0, velocity=velocity, **slices)
    assert not compiled


def test_a_device_gives_the_physical_quantities_of_its_one_mass():
    window, chosen = ((0.0, 1e3), (0.0, 5e-3)), {"damping": 10.0, "resolution": 0.1}
    plane = "physical_stiffness", "time_delay"
    device = Device.mass_spring_damper(0.1, damping=1.5)
    given = HapticLoop(device=device, sample_time=1e-3)
    one, other = (
        trace_boundary(plane, window, loop=loop, stiffness=1e3, **chosen) for loop in (given, LOOP)
    )
    assert np.array_equal(one.points, other.points)
    mode = Mode(frequency=100.0, damping_ratio=0.02, modal_mass=0.05)
    soft = Device.modes([mode], mass=0.1, damping=1.5)
    with pytest.raises(TypeError, match="is not one mass"):
        trace_boundary(
            plane,
            window,
            loop=HapticLoop(device=soft, sample_time=1e-3),
            stiffness=1e3,
            **chosen,
        )


def test_filters_in_s_have_one_sampling_period():
    plane, window, fixed, _ = PLANES["stiffness-sample_time"]
    with pytest.raises(ValueError, match="change with sample_time"):
        trace_boundary(plane, window, velocity=Velocity.low_pass(100.0), **fixed)
    counted = Velocity.difference(samples=3)
    assert trace_boundary(plane, window, velocity=counted, resolution=0.1, **fixed).edge.any()


@pytest.mark.parametrize(
    ("plane", "window", "fixed", "message"),
    [
        (("alpha", "betta"), ((0.0, 1.0), (0.0, 1.0)), {}, "'betta' is not a quantity of this"),
        (("alpha", "alpha"), ((0.0, 1.0), (0.0, 1.0)), {}, "alpha is given twice"),
        (("alpha", ""), ((0.0, 1.0), (0.0, 1.0)), {}, "'' is not a quantity of this"),
        (("alpha", "beta"), ((0.0, 1.0), (0.0, 1.0)), {"gamma": 0.0}, "delta has no value"),
        (("alpha", "beta"), ((1.0, 1.0), (0.0, 1.0)), {}, "the window of alpha"),
        (("alpha", "gamma"), ((0.0, 1.0), (-1.0, 1.0)), {"beta": 0.0}, "gamma is -1"),
        (("alpha", "beta"), ((0.0, float("nan")), (0.0, 1.0)), {}, "alpha is nan"),
        (
            ("alpha", "beta"),
            ((0.0, 1.0), (0.0, 1.0)),
            {"gamma": [0.0, 0.1], "delta": [0.0, 0.1, 0.2], "delay": 1.0},
            "give numbers, or lists of one length",
        ),
    ],
)
def test_tracing_refuses_bad_input(plane, window, fixed, message):
    complete = {"gamma": 0.0, "delta": 0.0, "delay": 0.0} if "window" in message else {}
    more = {"delta": 0.0, "delay": 0.0} if "gamma is" in message else {}
    nan = {"gamma": 0.0, "delta": 0.0, "delay": 0.0} if "nan" in message else {}
    with pytest.raises(ValueError, match=message):
        trace_boundary(plane, window, **(fixed | complete | more | nan))


def test_a_resolution_out_of_range_is_refused():
    with pytest.raises(ValueError, match="resolution is 0"):
        trace_boundary(
            ("alpha", "beta"),
            ((0.0, 1.0), (0.0, 1.0)),
            resolution=0.0,
            gamma=0.0,
            delta=0.0,
            delay=0.0,
        )
