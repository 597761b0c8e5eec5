"""All loops between two: enclosures, verdicts, polygons and limits against exact loops between."""

from dataclasses import replace
from typing import Any

import flint
import jax
import numpy as np
import pytest
from matplotlib.path import Path

from benchmarks.truth import devices, filtered
from benchmarks.truth.filtered import without_zeros
from benchmarks.truth.random_loops import device_of
from jaxstab import (
    Device,
    Filter,
    Hand,
    HandRange,
    HapticLoop,
    LoopsBetween,
    Mode,
    Velocity,
    Verdict,
    common_region,
)
from jaxstab.proofs.exclusion import Models
from jaxstab.proofs.linear_circle import (
    FamilyBoxes,
    PieceBoxes,
    family_cells,
)
from jaxstab.proofs.linear_circle import family_models as models
from jaxstab.results import RobustStatus

PERIOD = 2.0**-10
DRAWN = devices.Drawn(
    0.25, 0.1, [(80.0, 0.02, 0.5)], (1.0, 5.0, 300.0, (4.0, 2000.0)), 400.0, PERIOD, 1.0
)
HALF_OF_A_BOUND = 0.5  # at a corner of some box more than that is attained
CUTOFF = 0.1  # per sample


def loop_of(drawn: devices.Drawn = DRAWN, cutoff: float = CUTOFF) -> HapticLoop:
    return HapticLoop(
        device=device_of(drawn),
        sample_time=PERIOD,
        delay=drawn.delay * PERIOD,
        velocity=Velocity.low_pass(cutoff / PERIOD),
    )


def drawn_at(name: str, value: float) -> tuple[devices.Drawn, float]:
    """The device, and the cut-off, of which one number has another value."""
    modes, hand, cutoff = [list(one) for one in DRAWN.modes], list(DRAWN.hand), CUTOFF
    fields: dict[str, Any] = {}
    if name in ("frequency", "damping_ratio", "modal_mass"):
        modes[0][("frequency", "damping_ratio", "modal_mass").index(name)] = value
    elif name in ("hand_mass", "hand_damping", "hand_stiffness"):
        hand[("hand_mass", "hand_damping", "hand_stiffness").index(name)] = value
    elif name == "grip":
        hand[3] = (hand[3][0], value)
    elif name == "cutoff":
        cutoff = value
    else:
        fields[name] = value
    drawn = DRAWN._replace(modes=[tuple(one) for one in modes], hand=tuple(hand), **fields)
    return drawn, cutoff


ENDS = {
    "mass": (0.2, 0.3),
    "damping": (0.0, 2.0),
    "frequency": (60.0, 120.0),
    "damping_ratio": (0.001, 0.1),
    "modal_mass": (0.3, 2.0),
    "bandwidth": (250.0, 500.0),
    "hand_mass": (0.5, 2.0),
    "hand_damping": (0.0, 20.0),
    "hand_stiffness": (0.0, 700.0),
    "grip": (500.0, 5000.0),
    "delay": (1.75, 0.25),
    "cutoff": (0.05, 0.2),
}


def quickly(*names: str) -> list[Any]:
    """The parameters, of which all but some belong to the campaign."""
    return [
        name if name in names else pytest.param(name, marks=pytest.mark.campaign) for name in ENDS
    ]


def between(name: str) -> LoopsBetween:
    return LoopsBetween(*(loop_of(*drawn_at(name, end)) for end in ENDS[name]))


def truth_at(name: str, share: float) -> Any:
    """p(z) in balls of the loop at a share of the way, for K in N/m and B in N s/m."""
    first, last = ENDS[name]
    drawn, cutoff = drawn_at(name, first + share * (last - first))
    velocity = filtered.times(filtered.difference(1), filtered.low_pass(cutoff, order=1))
    system = drawn.mechanism.system()
    return devices.DeviceLoop(system, PERIOD, drawn.delay, velocity, filtered.average(1)).balls()


@pytest.mark.parametrize("name", quickly("frequency", "cutoff"))
def test_boxes_hold_the_polynomials_of_all_loops(name: str, rng: np.random.Generator) -> None:
    """g over boxes of every size, against the exact polynomials of loops in them."""
    family = between(name).family
    cells = family_cells(family)
    assert cells is not None
    count = 12
    piece = rng.integers(len(cells.pieces), size=count)
    low, high = cells.ends[piece].T
    by_t = 0.5 * (high - low) * 10.0 ** rng.uniform(-6, -0.5, count)
    t = low + by_t + (high - low - 2.0 * by_t) * rng.random(count)
    by_theta = 0.5 * np.pi * 10.0 ** rng.uniform(-6, -0.5, count)
    theta = by_theta + (np.pi - 2.0 * by_theta) * rng.random(count)
    gains = 10.0 ** rng.uniform(-4, 0, (2, count))
    edge = gains * 10.0 ** rng.uniform(-4, 0, (2, count)) * rng.choice([-1.0, 1.0], (2, count))
    place = PieceBoxes(piece, t, theta, by_t, by_theta)
    found = models(cells, FamilyBoxes(gains, edge, cells.lags[piece], place))
    shared = flint.arb(np.exp(-2.0 * np.pi * CUTOFF))
    unit = family.first.stiffness_unit / family.first.damping_unit / PERIOD
    for number in range(count):
        for x in (*rng.uniform(-1.0, 1.0, (2, 3)), rng.choice([-1.0, 1.0], 3)):
            with flint.ctx.workprec(300):
                place = flint.acb(flint.arb(t[number] + by_t[number] * x[1]))
                whole = int(cells.lags[piece[number]]) - 1
                parts = family.polynomials(place, whole)
                z = flint.acb(0, flint.arb(theta[number] + by_theta[number] * x[2])).exp()
                free, stiff, damp = (
                    one(z) / z ** one.degree() for one in (parts[0], parts[1], parts[-1])
                )
                velocity = (1 - 1 / z) * flint.arb(unit)
                if name != "cutoff":
                    velocity *= (1 - shared) / (1 - shared / z)
                alpha, beta = (
                    flint.arb(a) + flint.arb(b * x[0])
                    for a, b in zip(gains[:, number], edge[:, number], strict=True)
                )
                g = free + z ** -(whole + 1) * (alpha * stiff + beta * velocity * damp)
                linear = found.value[number] + found.moves[:, number] @ x
                assert abs(complex(g) - linear) <= found.rest[number]


def check_boxes(
    found: Models, delay: np.ndarray, gains: np.ndarray, theta: np.ndarray, sides: np.ndarray
) -> None:
    """Compare g over boxes of one loop with its equations of motion, at points of the boxes.

    Halved, the bounds would be smaller than what they bound at a corner of some box.

    ``gains`` are alpha, beta; all have shape (..., point, box), ``sides`` the place in the box.
    """
    sampled = loop_of().sampled
    assert sampled is not None
    units = sampled.stiffness_unit, sampled.damping_unit
    velocity = filtered.times(filtered.difference(1), filtered.low_pass(CUTOFF, order=1))
    system = DRAWN.mechanism.system()
    shares = []
    for point, box in np.ndindex(theta.shape):
        late = float(delay[point, box])
        balls = devices.DeviceLoop(system, PERIOD, late, velocity, filtered.average(1)).balls()
        with flint.ctx.workprec(400):
            z = flint.acb(0, flint.arb(theta[point, box])).exp()
            walls = [
                flint.arb(gain) / flint.arb(unit)
                for gain, unit in zip(gains[:, point, box], units, strict=True)
            ]
            p = balls.base + balls.stiffness * walls[0] + balls.damping * walls[1]
            # Over the power of z and the filter's denominator, as g.
            g = p(z) / z ** p.degree() / (1 - flint.arb(-2.0 * np.pi * CUTOFF).exp() / z)
        linear = found.value[box] + found.moves[:, box] @ sides[:, point, box]
        shares.append(abs(complex(g) - linear) / found.rest[box])
    assert HALF_OF_A_BOUND < max(shares) <= 1.0


def random_boxes(rng: np.random.Generator, count: int) -> tuple[np.ndarray, ...]:
    """Angles, their half-widths, gains, and places in boxes of two axes, some of them corners."""
    by_theta = 0.5 * np.pi * 10.0 ** rng.uniform(-7, -0.5, count)
    theta = by_theta + (np.pi - 2.0 * by_theta) * rng.random(count)
    gains = 10.0 ** rng.uniform(-4, 0, (2, count))
    corners = rng.choice([-1.0, 1.0], (2, 1, count))
    sides = np.concatenate([rng.uniform(-1, 1, (2, 2, count)), corners], axis=1)
    return theta, by_theta, gains, sides


@pytest.mark.parametrize("name", quickly("mass", "cutoff"))
def test_polynomials_in_t_are_those_of_each_loop(name: str, rng: np.random.Generator) -> None:
    """D and N of loops between, against equations of motion in mpmath."""
    family = between(name).family
    share = float(rng.random())
    delay = family.delay.first + share * (family.delay.last - family.delay.first)
    balls = truth_at(name, share)
    with flint.ctx.workprec(400):
        free, force = family.polynomials(flint.acb(flint.arb(share)), int(delay))[:2]
        if name != "cutoff":
            filtered_by = flint.acb_poly([-flint.arb(np.exp(-2.0 * np.pi * CUTOFF)), 1])
            free, force = free * filtered_by, force * filtered_by
        scale = 1 / free.coeffs()[-1]
        force *= flint.arb(family.first.stiffness_unit)
        for ours, theirs in ((free * scale, balls.base), (force * scale, balls.stiffness)):
            falling = [
                without_zeros([one.real for one in ours.coeffs()[::-1]]),
                without_zeros(theirs.coeffs()[::-1]),
            ]
            for one, other in zip(*falling, strict=True):
                assert float(abs(one - other)) < 1e-12 * float(abs(other))


@pytest.mark.campaign
@pytest.mark.parametrize("name", quickly("grip", "delay"))
def test_verdicts_hold_for_every_loop_between(name: str, rng: np.random.Generator) -> None:
    loops = between(name)
    outline = np.concatenate(
        [(one.main or one).outline for one in (loops.loop(0.5).region(), loops.first.region())]
    )
    middle = outline.mean(axis=0)
    walls = outline[rng.integers(len(outline), size=40)]
    aside = 10.0 ** rng.uniform(-7, -1, (40, 1)) * rng.choice([-1.0, 1.0], (40, 1))
    walls = middle + (walls - middle) * (1.0 + aside)
    codes = loops.verdict(*walls.T)
    assert np.sum(codes == Verdict.UNDECIDED) <= 1
    shares = [0.0, 1.0, *rng.random(20)]
    single = np.array([np.asarray(loops.loop(share).verdict(*walls.T)) for share in shares])
    assert not np.any((codes == Verdict.STABLE) & (single != Verdict.STABLE))
    balls = truth_at(name, float(rng.random()))
    assert all(balls.is_stable(*map(float, wall)) for wall in walls[codes == Verdict.STABLE][:5])


@pytest.mark.parametrize(
    ("name", "is_inner"),
    [pytest.param("mass", False, marks=pytest.mark.campaign), ("frequency", True)],
)
def test_what_is_unstable_has_a_loop_that_is(name: str, is_inner: bool) -> None:
    loops = between(name)
    found = loops.robust_limit()
    assert found.is_proved
    dense = [loops.loop(share) for share in np.linspace(0.0, 1.0, 41)]
    assert all(loop.verdict(found.stiffness, found.damping) == Verdict.STABLE for loop in dense)
    worst = loops.worst_loop(1.001 * found.limit, found.damping)
    assert worst.verdict == Verdict.UNSTABLE
    assert not truth_at(name, worst.share).is_stable(1.001 * found.limit, found.damping)
    assert (0.0 < worst.share < 1.0) == is_inner
    ends = common_region([loops.first, loops.last]).stiffest.stiffness
    assert found.stiffness < 1.05 * ends


@pytest.mark.parametrize(
    "name", ["grip", *(pytest.param(one, marks=pytest.mark.campaign) for one in ENDS)]
)
def test_the_polygon_is_that_of_a_dense_list(name: str, rng: np.random.Generator) -> None:
    loops = between(name)
    common = common_region(loops)
    assert common.status == RobustStatus.PROVED
    assert common.between is loops
    low, high = common.outline.min(axis=0), common.outline.max(axis=0)
    walls = rng.uniform(low - 0.1 * (high - low), high + 0.1 * (high - low), (400, 2))
    inside = Path(common.outline).contains_points(walls)
    dense = [loops.loop(share) for share in np.linspace(0.0, 1.0, 33)]
    stable = np.all(
        [np.asarray(loop.verdict(*walls.T) == Verdict.STABLE) for loop in dense], axis=0
    )
    assert not np.any(inside & ~stable)
    assert np.sum(inside) > (1.0 - 5.0 * common.tolerance) * np.sum(stable)
    codes = common.verdict(*walls.T)
    assert np.mean((codes == Verdict.STABLE) != stable) < 0.01
    assert np.mean(codes == Verdict.UNDECIDED) < 0.01


def test_one_mass_is_a_loop_like_others() -> None:
    light, heavy = (
        HapticLoop(device_mass=mass, device_damping=1.5, sample_time=1e-3) for mass in (0.1, 0.2)
    )
    loops = LoopsBetween(light, heavy)
    assert loops.robust_limit().limit == pytest.approx(light.limits().stiffness, rel=1e-4)
    common = common_region(loops)
    assert common.contains(0.9 * light.limits().stiffness, light.limits().at_damping)
    assert loops.loop(0.5).device_mass == pytest.approx(0.15)
    assert (loops.loop(0.0), loops.loop(1.0)) == (light, heavy)


def test_numbers_that_differ_move_together() -> None:
    """The light mass with the long delay is not between the two, and unstable with the wall."""
    loops = [
        HapticLoop(device_mass=mass, device_damping=1.0, sample_time=1e-3, delay=delay)
        for mass, delay in ((0.1, 0.0), (0.3, 2e-3))
    ]
    wall = LoopsBetween(*loops).robust_limit()
    worse = replace(loops[0], delay=2e-3)
    assert wall.is_proved
    assert worse.verdict(wall.stiffness, wall.damping) == Verdict.UNSTABLE


@pytest.mark.campaign
def test_a_cut_off_of_a_position_filter_may_differ() -> None:
    loops = [
        replace(loop_of(), position=Filter.butterworth(cutoff, order=2)) for cutoff in (150, 300)
    ]
    between_both = LoopsBetween(*loops)
    found = between_both.robust_limit()
    assert found.is_proved
    dense = [between_both.loop(share) for share in np.linspace(0.0, 1.0, 21)]
    assert all(loop.verdict(found.stiffness, found.damping) == Verdict.STABLE for loop in dense)


# ------------------------------------------------------------------------------------------ hands


@pytest.mark.campaign
def test_a_hand_of_a_device_is_replaced_by_those_of_an_interval(rng: np.random.Generator) -> None:
    loop, hands = (
        loop_of(),
        HandRange(mass=(0.8, 1.2), stiffness=(300.0, 300.0), damping=(5.0, 5.0)),
    )
    assert loop.device is not None
    found = loop.robust_limit(hands)
    assert found.is_proved
    worst = loop.worst_hand(hands, found.stiffness, found.damping)
    assert worst.verdict == Verdict.STABLE
    for mass in rng.uniform(0.8, 1.2, 8):
        arm = Hand.mass_spring_damper(float(mass), damping=5.0, stiffness=300.0).with_grip(
            stiffness=2000.0, damping=4.0
        )
        other = replace(loop, device=replace(loop.device, hands=(arm,)))
        assert other.verdict(found.stiffness, found.damping) == Verdict.STABLE
    assert loop.worst_hand(hands, 1.01 * found.limit, found.damping).verdict == Verdict.UNSTABLE


def test_a_device_of_several_hands_is_refused() -> None:
    hand = Hand.mass_spring_damper(1.0)
    device = Device.mass_spring_damper(0.2).held_by(hand).held_by(hand)
    with pytest.raises(ValueError, match="held by 2 hands"):
        HapticLoop(device=device, sample_time=1e-3).worst_hand(HandRange(), 100.0, 1.0)


MODE = Mode(frequency=80.0, damping_ratio=0.02, modal_mass=0.5)
PLAIN = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=1e-3)


@pytest.mark.parametrize(
    ("last", "message"),
    [
        (replace(PLAIN, sample_time=2e-3), "sample_time is 0.001 s in one loop and 0.002 s"),
        (replace(PLAIN, velocity=Velocity.low_pass(100.0)), "differ in numbers alone"),
        (loop_of(), "sample_time"),
    ],
)
def test_loops_with_nothing_between_are_refused(last: HapticLoop, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        LoopsBetween(PLAIN, last)
    assert "\n" not in str(caught.value)


def test_parts_that_differ_are_named() -> None:
    device = Device.mass_spring_damper(0.25, damping=0.1)
    loop = HapticLoop(device=device, sample_time=1e-3, velocity=Velocity.difference(5))
    for other in (
        replace(loop, velocity=Velocity.difference(6)),
        replace(loop, device=device.with_actuator(100.0)),
        replace(loop, device=Device.modes([MODE], mass=0.25)),
        replace(loop, device=Device.state_space([[0, 1], [0, -0.4]], [[0], [4]], [[1, 0]])),
    ):
        with pytest.raises(ValueError, match="give two loops that differ in numbers alone"):
            LoopsBetween(loop, other)
    with pytest.raises(TypeError, match="HapticLoop"):
        LoopsBetween(loop, device)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="traced"):
        jax.jit(lambda one: LoopsBetween(PLAIN, one).verdict(1.0, 1.0))(PLAIN)
    with pytest.raises(ValueError, match="share"):
        LoopsBetween(PLAIN, PLAIN).loop(1.5)
    with pytest.raises(ValueError, match="stiffness"):
        LoopsBetween(PLAIN, PLAIN).verdict(np.nan, 1.0)
