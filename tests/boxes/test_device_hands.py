"""All hands of a range, and all masses of a device: proofs attacked by exact hands of the range."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm

from jaxstab import Device, Hand, HandRange, HapticLoop, Mode, Velocity, Verdict
from jaxstab.boxes.plant import Arms, HeldDevice, with_parts
from jaxstab.boxes.search import unproved_members
from tests.campaign import many
from tests.truth import devices, filtered
from tests.truth.random_loops import device_of

PERIOD = 1e-3
CASES = many(200, small=2)
NEAR = 1e-7  # of a radius: closer to 1, balls decide

Floats = NDArray[np.float64]


class Case(NamedTuple):
    """A device with the ranges of its hand (mass, stiffness, damping) and of its mass."""

    drawn: devices.Drawn
    window: int
    ends: Floats  # (4, 2)

    @property
    def loop(self) -> HapticLoop:
        delay = self.drawn.delay * PERIOD
        velocity = Velocity.difference(samples=self.window)
        device = device_of(self.drawn)
        return HapticLoop(device=device, sample_time=PERIOD, delay=delay, velocity=velocity)

    @property
    def hands(self) -> HandRange:
        mass, stiffness, damping = map(tuple, self.ends[:3].tolist())
        return HandRange(mass=mass, stiffness=stiffness, damping=damping)

    @property
    def mass(self) -> tuple[float, float]:
        low, high = self.ends[3].tolist()
        return low, high

    def system(self, body: Floats) -> devices.System:
        """Equations of motion with a hand, and a mass of the device; no arm is without mass."""
        mass, stiffness, damping, own = body.tolist()
        grip = None if self.drawn.hand is None else self.drawn.hand[3]
        hand = (mass if grip is None else max(mass, 1e-7), damping, stiffness, grip)
        return self.drawn._replace(mass=own, hand=hand).mechanism.system()

    def radius(self, wall: tuple[float, float], body: Floats) -> float:
        """The spectral radius by the matrix exponential and the eigenvalues of NumPy."""
        a, b, c = (np.array(part.tolist(), float) for part in self.system(body))
        order, n = len(a), self.window
        whole = int(self.drawn.delay)
        part = self.drawn.delay - whole

        def held(time: float) -> tuple[Floats, Floats]:
            block = np.zeros((order + 1, order + 1))
            block[:order, :order], block[:order, order:] = a * time, b * time
            moved = expm(block)
            return moved[:order, :order], moved[:order, order]

        late, last = held((1.0 - part) * PERIOD)
        early, first = held(part * PERIOD)
        # States: the plant's, then positions before, then forces before.
        size = order + n + whole + 1
        step = np.zeros((size, size))
        force = np.zeros(size)
        force[:order] = -(wall[0] + wall[1] / (n * PERIOD)) * c[0]
        force[order + n - 1] = wall[1] / (n * PERIOD)
        before = order + n
        step[:order, :order] = late @ early
        now = force if whole == 0 else np.eye(size)[before + whole - 1]
        step[:order] += np.outer(last, now)
        step[:order] += np.outer(late @ first, np.eye(size)[before + whole])
        step[order, :order] = c[0]
        step[order + 1 : before, order : before - 1] = np.eye(n - 1)
        step[before] = force
        step[before + 1 :, before : size - 1] = np.eye(whole)
        return float(np.abs(np.linalg.eigvals(step)).max())

    def is_stable(self, wall: tuple[float, float], body: Floats) -> bool:
        """True if a wall is stable with a hand; by balls where the radius is next to 1."""
        radius = self.radius(wall, body)
        if abs(radius - 1.0) > NEAR:
            return radius < 1.0
        velocity, position = filtered.difference(self.window), filtered.average(1)
        exact = devices.DeviceLoop(self.system(body), PERIOD, self.drawn.delay, velocity, position)
        return exact.code(*wall) == Verdict.STABLE


def case_of(seed: int) -> Case:
    """Light and heavy devices, modes, actuators, grips; hands from 0 on and hands in part fixed."""
    rng = np.random.default_rng(seed)
    mass = 10.0 ** rng.uniform(-1.7, 0.3)
    modes = [
        (rng.uniform(20.0, 400.0), 10.0 ** rng.uniform(-3.0, -1.0), mass * rng.uniform(0.5, 6.0))
        for _ in range(rng.integers(0, 3))
    ]
    grip = (rng.uniform(0.5, 30.0), 10.0 ** rng.uniform(2.0, 4.5))
    drawn = devices.Drawn(
        mass=mass,
        damping=float(rng.choice([0.0, rng.uniform(0.0, 1.0)])),
        modes=modes,
        hand=(0.1, 1.0, 10.0, grip if rng.random() < 0.7 else None),
        bandwidth=float(rng.uniform(40.0, 800.0)) if rng.random() < 0.4 else None,
        sample_time=PERIOD,
        delay=float(rng.choice([0.0, 1.0, 2.0, rng.uniform(0.0, 4.0)])),
    )
    most = np.array([10.0 ** rng.uniform(-2.0, 0.3), 10.0 ** rng.uniform(1, 3), 8.0])
    low = np.where(rng.random(3) < 0.6, 0.0, most * rng.random(3))
    high = np.where(rng.random(3) < 0.2, low, most)
    own = [mass, mass * rng.uniform(1.0, 1.6)] if rng.random() < 0.5 else [mass, mass]
    ends = np.vstack([np.transpose([low, high]), own])
    return Case(drawn, int(rng.choice([1, 2, 5, 20])), ends)


def climbed(case: Case, wall: tuple[float, float], seed: int, steps: int) -> Floats:
    """The worst hand that is found: corners, hands at random, then steps up from the best."""
    rng = np.random.default_rng(seed)
    low, high = case.ends.T
    corners = np.array(np.meshgrid(*[[0.0, 1.0]] * 4)).reshape(4, -1).T
    shares = np.vstack([corners, rng.random((steps, 4)), rng.random((steps, 4)) ** 4])
    radii = [case.radius(wall, low + (high - low) * share) for share in shares]
    best = int(np.argmax(radii))
    share, radius, size = shares[best], radii[best], 0.2
    for _ in range(4 * steps):
        other = np.clip(share + size * rng.normal(size=4), 0.0, 1.0)
        found = case.radius(wall, low + (high - low) * other)
        share, radius, size = (
            (other, found, 1.5 * size) if found > radius else (share, radius, 0.85 * size)
        )
    return low + (high - low) * share


def attacked(seed: int, steps: int) -> list[str]:
    """Ask for the limit of a case and for walls beside it; return what was said of them."""
    case = case_of(seed)
    rng = np.random.default_rng(seed)
    limit = case.loop.robust_limit(case.hands, mass=case.mass)
    said = ["PROVED" if limit.is_proved else "none" if np.isnan(limit.limit) else "TRIED"]
    if np.isnan(limit.limit):
        return said
    walls = [(limit.stiffness, limit.damping)] if limit.is_proved else []
    share = rng.uniform(0.02, 1.1, (2, 2))
    walls += [(limit.limit * k, limit.damping * b) for k, b in share.tolist()]
    for wall in walls:
        worst = case.loop.worst_hand(case.hands, *wall, mass=case.mass)
        said.append(worst.verdict.name)
        if worst.verdict == Verdict.STABLE:
            body = climbed(case, wall, seed, steps)
            assert case.is_stable(wall, body), (seed, wall, body.tolist())
        if worst.verdict == Verdict.UNSTABLE:
            arm, own = worst.loop.device.hands[0].dynamics, worst.loop.device.mechanism.mass
            body = np.array([arm.mass, arm.stiffness, arm.damping, own])
            assert not case.is_stable(wall, body), (seed, wall, body.tolist())
    return said


# Masses from nothing, several ranges at once, ranges of the device's own mass.

GRIP = Hand.mass_spring_damper(0.1).with_grip(stiffness=2000.0, damping=4.0)
HANDS = HandRange(mass=(0.0, 0.5), stiffness=(0.0, 300.0), damping=(0.0, 5.0))  # of the guide
LOOP = HapticLoop(
    device=Device.mass_spring_damper(0.25, damping=0.1).held_by(GRIP),
    sample_time=PERIOD,
    delay=PERIOD,
    velocity=Velocity.difference(samples=20),
)


def test_a_mass_from_nothing_behind_a_grip_is_proved() -> None:
    hands = replace(HANDS, stiffness=(300.0, 300.0), damping=(5.0, 5.0))
    assert LOOP.worst_hand(hands, 1000.0, 10.0).verdict == Verdict.STABLE


def test_several_ranges_of_a_hand_on_a_device_are_proved() -> None:
    found = LOOP.robust_limit(HANDS)
    assert found.is_proved
    assert found.stiffness > 1800.0
    wall = found.stiffness, found.damping
    assert LOOP.worst_hand(HANDS, *wall).verdict == Verdict.STABLE
    case = Case(
        devices.Drawn(0.25, 0.1, [], (0.1, 0.0, 0.0, (4.0, 2000.0)), None, PERIOD, 1.0),
        20,
        np.array([HANDS.mass, HANDS.stiffness, HANDS.damping, (0.25, 0.25)]),
    )
    assert case.is_stable(wall, climbed(case, wall, 1, 10))
    higher = 1.02 * found.limit, found.damping
    worst = LOOP.worst_hand(HANDS, *higher)
    assert worst.verdict == Verdict.UNSTABLE
    arm = worst.loop.device.hands[0].dynamics
    assert not case.is_stable(higher, np.array([arm.mass, arm.stiffness, arm.damping, 0.25]))


def test_the_masses_of_a_device_are_proved_with_its_hands() -> None:
    one = LOOP.robust_limit(HANDS)
    found = LOOP.robust_limit(HANDS, mass=(0.2, 0.3))
    assert found.is_proved
    assert found.loop.device.mechanism.mass == 0.2
    assert found.stiffness < 0.9 * one.stiffness
    worst = LOOP.worst_hand(HANDS, one.stiffness, one.damping, mass=(0.2, 0.3))
    assert worst.verdict == Verdict.UNSTABLE
    assert worst.loop.verdict(one.stiffness, one.damping) != Verdict.STABLE


@pytest.mark.campaign
def test_the_masses_of_one_mass_are_proved_with_its_hands() -> None:
    """Glued, the device's mass and the hand's are one: as a range of the hand alone."""
    loop = HapticLoop(
        device_mass=0.25, device_damping=0.1, sample_time=PERIOD, delay=PERIOD,
        velocity=Velocity.difference(samples=20),
    )  # fmt: skip
    found = loop.robust_limit(HANDS, mass=(0.2, 0.3))
    assert found.is_proved
    lighter = replace(loop, device_mass=0.2)
    same = lighter.robust_limit(replace(HANDS, mass=(0.0, 0.6)))
    assert found.limit == pytest.approx(same.limit, rel=1e-9)
    for wall in ((found.stiffness, found.damping), (1.1 * found.limit, found.damping)):
        worst = loop.worst_hand(HANDS, *wall, mass=(0.2, 0.3))
        other = lighter.worst_hand(replace(HANDS, mass=(0.0, 0.6)), *wall)
        assert worst.verdict == other.verdict
        assert 0.2 <= worst.loop.device_mass <= 0.3
        assert 0.0 <= worst.loop.hand_mass <= 0.5
    assert worst.verdict == Verdict.UNSTABLE
    assert worst.loop.verdict(*wall) != Verdict.STABLE


def test_what_nothing_damps_is_tried_and_not_proved() -> None:
    bare = Hand.mass_spring_damper(0.1).with_grip(stiffness=2000.0)
    loop = replace(LOOP, device=Device.mass_spring_damper(0.25, damping=0.1).held_by(bare))
    light = replace(HANDS, mass=(0.0, 0.0))
    assert loop.worst_hand(light, 500.0, 5.0).verdict == Verdict.UNDECIDED
    limit = loop.robust_limit(light)
    assert not limit.is_proved
    assert np.isnan(limit.stiffness)
    assert repr(limit).startswith("RobustLimit: no wall is proved\n  limit of hands tried  ")
    damped = replace(HANDS, damping=(2.0, 5.0), mass=(0.1, 0.1), stiffness=(9.0, 9.0))
    assert loop.worst_hand(damped, 500.0, 5.0).verdict == Verdict.STABLE


@pytest.mark.parametrize(
    "device",
    [
        Device.transfer_function([1.0], [0.25, 0.1, 0.0]),
        *(
            pytest.param(device, marks=pytest.mark.campaign)
            for device in (
                Device.transfer_function(
                    [1.0, 0.2, 3e4], np.polymul([0.25, 0.1, 0.0], [1.0, 20.0, 1e5])
                ),
                Device.state_space([[0.0, 1.0], [-40.0, -3.0]], [0.0, 2.0], [1.0, 0.0]),
                Device.modes([Mode(frequency=30.0, damping_ratio=0.05, modal_mass=0.3)]),
            )
        ),
    ],
)
def test_any_linear_device_is_proved_for_all_hands(device: Device) -> None:
    loop = replace(LOOP, device=device)
    limit = loop.robust_limit(HANDS)
    assert limit.is_proved
    assert 0.9 * limit.limit < limit.stiffness < limit.limit
    rng, ends = np.random.default_rng(5), np.array([*vars(HANDS).values()])
    for hand in rng.uniform(*ends.T, (20, 3)).tolist():
        arm = Hand.mass_spring_damper(hand[0], stiffness=hand[1], damping=hand[2])
        held = replace(loop, device=device.held_by(arm))
        assert held.verdict(limit.stiffness, limit.damping) == Verdict.STABLE
    assert loop.worst_hand(HANDS, 1.1 * limit.limit, limit.damping).verdict == Verdict.UNSTABLE


def test_walls_that_all_hands_share_may_be_thin() -> None:
    """A collision: up to 202 N s/m each hand has walls, and below 1 N s/m both share some."""
    loop = HapticLoop(device_mass=0.1, device_damping=1.5, sample_time=PERIOD)
    limit = loop.robust_limit(HandRange(stiffness=(0.0, 987000.0)))
    assert limit.is_proved
    assert 3300.0 < limit.stiffness < limit.limit < 3360.0
    assert limit.damping < 1.0


@pytest.mark.parametrize(
    "loop",
    [
        HapticLoop(device_mass=0.1, device_damping=0.5, sample_time=PERIOD),
        pytest.param(LOOP, marks=pytest.mark.campaign),
    ],
    ids=["mass", "grip"],
)
def test_all_hands_with_all_constant_delays_of_a_range(loop: HapticLoop) -> None:
    """Against loops at random, and one on each side of the limit."""
    for delays in ({"delay": (0.5 * PERIOD, 1.5 * PERIOD)},):
        limit = loop.robust_limit(HANDS, **delays)
        wall = limit.stiffness, limit.damping
        assert limit.is_proved
        assert limit.stiffness < loop.robust_limit(HANDS).stiffness
        rng, ends = np.random.default_rng(6), np.array([*vars(HANDS).values()])
        for hand in rng.uniform(*ends.T, (20, 3)).tolist():
            held = dict(zip(("hand_mass", "hand_stiffness", "hand_damping"), hand, strict=True))
            if loop is LOOP:
                held = {"device": with_parts(loop.held_device, None, Arms(*hand))}
            delay = float(rng.choice([*delays["delay"], rng.uniform(*delays["delay"])]))
            assert replace(loop, **held, delay=delay).verdict(*wall) == Verdict.STABLE
        worst = loop.worst_hand(HANDS, 1.1 * limit.limit, limit.damping, **delays)
        assert worst.verdict == Verdict.UNSTABLE
        assert worst.loop.verdict(1.1 * limit.limit, limit.damping) == Verdict.UNSTABLE
    with pytest.raises(ValueError, match="give the shortest one first"):
        LOOP.worst_hand(HANDS, 1.0, 1.0, delay=(2e-3, 1e-3))
    with pytest.raises(TypeError, match="beside delays"):
        LOOP.worst_hand(HANDS, 1.0, 1.0, delay=(1e-3, 2e-3), delays=(1e-3, 2e-3))


@pytest.mark.parametrize(
    ("device", "mass", "words"),
    [
        (Device.transfer_function([1.0], [0.25, 0.1, 0.0]), (0.2, 0.3), "none that could vary"),
        (Device.mass_spring_damper(0.2), (0.3, 0.2), "give the lowest mass"),
        (Device.mass_spring_damper(0.2), (0.0, 0.2), "give the lowest mass"),
    ],
)
def test_masses_that_are_no_range_are_refused(
    device: Device, mass: tuple[float, float], words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        HapticLoop(device=device, sample_time=PERIOD).worst_hand(HANDS, 100.0, 1.0, mass=mass)


def test_a_wall_without_stiffness_and_one_that_pulls_are_not_called_stable() -> None:
    free = replace(HANDS, stiffness=(0.0, 100.0))
    for stiffness in (0.0, -1.0, -50.0):
        assert LOOP.worst_hand(free, stiffness, 5.0).verdict != Verdict.STABLE
    held = replace(HANDS, stiffness=(100.0, 300.0))  # behind the grip at least 95.2 N/m
    assert LOOP.worst_hand(held, -90.0, 5.0).verdict == Verdict.STABLE
    assert LOOP.worst_hand(held, -96.0, 5.0).verdict == Verdict.UNSTABLE


def test_a_free_device_without_stiffness_has_a_root_at_1_that_boxes_leave() -> None:
    """p(1) is 0 where nothing has a stiffness, whatever is damped; a little of it is enough."""
    loop = HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=PERIOD)
    hands, fixed = HandRange(damping=(5.0, 5.0)), ((0.25, 0.25), (0.0, 0.0))
    for stiffness, is_proved in ((0.0, False), (1e-3, True)):
        wall = np.array([[stiffness, 5.0]])
        left = unproved_members(loop.held_device, loop, hands, *fixed, wall)
        assert (not len(left)) == is_proved


def test_a_soft_grip_is_a_grip() -> None:
    soft = Hand.mass_spring_damper(0.1).with_grip(stiffness=0.1, damping=4.0)
    device = HeldDevice.from_device(Device.mass_spring_damper(0.25).held_by(soft), PERIOD)
    assert device.grip == pytest.approx((0.1 * PERIOD**2, 4.0 * PERIOD))


def test_proofs_hold_for_hands_that_are_looked_for() -> None:
    assert attacked(2, 2) == ["PROVED", "STABLE", "STABLE", "UNSTABLE"]


@pytest.mark.campaign
def test_the_limit_of_a_device_that_boxes_do_not_know_is_proved_too() -> None:
    loop = replace(LOOP, device=Device.transfer_function([1.0], [0.25, 0.1, 0.0]))
    assert loop.robust_limit(HandRange(stiffness=(0.0, 300.0))).is_proved


@pytest.mark.campaign
def test_many_proofs_hold_for_hands_that_are_looked_for() -> None:
    said = [word for seed in range(100, 100 + CASES) for word in attacked(seed, 30)]
    assert said.count("PROVED") > 0.9 * CASES
