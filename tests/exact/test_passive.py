"""Passive walls (C6), against forms of energy, aliased frequencies and numbers by hand."""

from collections.abc import Iterator
from math import sqrt
from typing import Any, NamedTuple

import numpy as np
import pytest
from campaign import many
from scipy.linalg import toeplitz
from scipy.signal import lfilter

import jaxstab
from jaxstab import Device, Filter, Hand, HapticLoop, Velocity

T, DAMPER = 1e-3, 0.1


def loop(delay: float = 0.0, damper: float = DAMPER, **filters: Any) -> HapticLoop:
    """One mass with a damper; the delay in samples."""
    return HapticLoop(
        device_mass=0.25, device_damping=damper, sample_time=T, delay=delay * T, **filters
    )


def largest(own: HapticLoop, damping: float) -> float:
    """The largest passive stiffness at a damping, by halving."""
    low, high = 0.0, 1e6
    for _ in range(70):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if own.is_passive(middle, damping) else (low, middle)
    return low


# ----------------------------------------------------------------------------------- known numbers
def test_a_spring_without_filter_is_passive_up_to_colgates_condition() -> None:
    assert largest(loop(), 0.0) == pytest.approx(2.0 * DAMPER / T, rel=1e-12)
    assert largest(loop(), 0.02) == pytest.approx(2.0 * (DAMPER - 0.02) / T, rel=1e-12)
    for whole in (1, 2, 5):  # b >= K T (1/2 + n)
        at_0 = DAMPER / (T * (0.5 + whole))
        assert largest(loop(float(whole)), 0.0) == pytest.approx(at_0, rel=1e-12)


def test_half_a_sample_of_delay_costs_more_than_its_lag() -> None:
    # b >= K T + (K T)^2/(16 b)
    assert largest(loop(0.5), 0.0) == pytest.approx(4.0 * (sqrt(5.0) - 2.0) * DAMPER / T, rel=1e-12)


def test_the_stiffest_passive_wall_of_one_sample_of_delay() -> None:
    stiffest = loop(1.0).passive_region(tolerance=1e-7).stiffest
    assert stiffest[0] == pytest.approx(2.0 * (sqrt(2.0) - 1.0) * DAMPER / T, rel=1e-6)
    assert stiffest[1] == pytest.approx((1.0 - 1.0 / sqrt(2.0)) * DAMPER, rel=1e-3)


@pytest.mark.parametrize(
    ("samples", "delay", "damping", "stiffness"),
    [(5, 1.0, 0.02, 67.648576626), (20, 1.0, 0.02, 63.456355791)],
)
def test_windows_have_their_own_limit(
    samples: int, delay: float, damping: float, stiffness: float
) -> None:
    own = loop(delay, velocity=Velocity.difference(samples))
    assert largest(own, damping) == pytest.approx(stiffness, rel=1e-10)


def test_a_smoothed_position_is_later() -> None:
    # The mean lag of (1 - a)/(1 - a/z) is a/(1 - a) samples: b >= K T (1/2 + 1 + 7/3).
    smooth = Filter.exponential(0.3)
    own = loop(1.0, velocity=Velocity.difference(5), position=smooth)
    assert largest(own, 0.0) == pytest.approx(26.086956522, rel=1e-10)
    assert largest(own, 0.02) == pytest.approx(31.304347826, rel=1e-10)


# --------------------------------------------------------------------------------- forms of energy
class Case(NamedTuple):
    """A loop, and numerator and denominator of P and of V by powers of 1/z."""

    loop: HapticLoop
    position: tuple[list[float], list[float]]
    velocity: tuple[list[float], list[float]]
    delay: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "Case":
        delay = float(rng.choice([0.0, 1.0, 2.0, rng.uniform(0.0, 3.0)]))
        position: tuple[list[float], list[float]] = [1.0], [1.0]
        chosen: dict[str, Any] = {}
        if rng.random() < 0.4:
            a = float(rng.uniform(0.1, 0.7))
            position = [1.0 - a, 0.0], [1.0, -a]
            chosen["position"] = Filter.transfer_function(*position)
        if rng.random() < 0.5:
            n = int(rng.integers(1, 8))
            velocity = [1.0 / (n * T), *[0.0] * (n - 1), -1.0 / (n * T)], [1.0]
            chosen["velocity"] = Velocity.difference(n)
        else:
            a, b = rng.uniform(0.0, 0.8, 2).tolist()
            gain = (1.0 - a) * (1.0 - b) / T
            velocity = [gain, -gain, 0.0], [1.0, -a - b, a * b]
            chosen["velocity"] = Velocity.transfer_function(*velocity)
        return cls(loop(delay, **chosen), position, velocity, delay)

    def least_energy(self, wall: tuple[float, float], samples: int) -> float:
        """The least eigenvalue of the energy that wall and damper take, over the damper's own."""
        impulse = np.r_[1.0, np.zeros(samples - 1)]
        force = sum(
            gain * lfilter(*own, impulse)
            for gain, own in zip(wall, (self.position, self.velocity), strict=True)
        )
        whole, late = divmod(self.delay, 1.0)
        before = np.tril(np.ones((samples, samples)), -1)  # ways of periods, to positions
        forces = toeplitz(np.asarray(force), np.zeros(samples)) @ before

        def shifted(by: int) -> np.ndarray:
            return np.r_[np.zeros((min(by, samples), samples)), forces[: max(samples - by, 0)]]

        shares = [(late, shifted(int(whole) + 1)), (1.0 - late, shifted(int(whole)))]
        shares = [(share, acting) for share, acting in shares if share > 0.0]
        scale = [np.sqrt(share * T / DAMPER) for share, _ in shares]  # of ways of energy 1
        form = np.block(
            [
                [own * acting * other for other in scale]
                for own, (_, acting) in zip(scale, shares, strict=True)
            ]
        )
        return 1.0 + float(np.linalg.eigvalsh(0.5 * (form + form.T))[0])


def wrong(seed: int) -> Iterator[str]:
    rng = np.random.default_rng([62, seed])
    case = Case.drawn(rng)
    direction = np.array([1.0 / T, rng.uniform(-1.0, 2.0)])
    low, high = 0.0, 100.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        is_passive = case.loop.is_passive(*(middle * direction).tolist())
        low, high = (middle, high) if is_passive else (low, middle)
    if not 1e-4 < low < 50.0:
        yield f"{seed}: the limit is {low}"
    inside, outside = (tuple((share * low * direction).tolist()) for share in (0.98, 1.1))
    if case.least_energy(inside, 250) < -1e-9:
        yield f"{seed}: energy is drawn from {inside}"
    if case.least_energy(outside, 900) > 0.0:
        yield f"{seed}: no energy is drawn from {outside}"


@pytest.mark.parametrize("seed", range(6))
def test_no_motion_draws_energy_below_the_limit_and_some_does_above(seed: int) -> None:
    assert list(wrong(seed)) == []


@pytest.mark.campaign
def test_passive_walls_are_those_of_the_forms_of_energy() -> None:
    found = [text for seed in range(many(300, small=20)) for text in wrong(100 + seed)]
    # At angle 0 only slow motions draw energy, longer ones than the form has.
    assert [text for text in found if "no energy" not in text] == []
    assert len(found) <= 0.05 * many(300, small=20)


# ----------------------------------------------------------------------------------------- regions
@pytest.mark.parametrize(
    "own",
    [
        loop(1.0, velocity=Velocity.difference(5)),
        loop(0.5, velocity=Velocity.low_pass(100.0)),
        loop(2.25, velocity=Velocity.difference(10), position=Filter.exponential(0.5)),
    ],
)
def test_a_region_is_convex_proved_and_tight(own: HapticLoop) -> None:
    region = own.passive_region(tolerance=1e-3)
    outline = region.outline
    edges = np.diff(np.r_[outline, outline[:2]], axis=0)
    turns = edges[:-1, 0] * edges[1:, 1] - edges[:-1, 1] * edges[1:, 0]
    assert (turns > -1e-9 * np.ptp(outline[:, 0]) * np.ptp(outline[:, 1])).all()
    for corner, after in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        assert own.is_passive(*corner.tolist())
        assert own.is_passive(*(0.5 * (corner + after)).tolist())
        beyond = 1.002 * corner
        assert own.is_passive(*beyond.tolist()) is False
    grid = np.array(region.stiffest[0] * np.linspace(0.0, 1.2, 7)), region.stiffest[1]
    assert region.contains(*grid).tolist() == [
        *map(own.is_passive, grid[0].tolist(), [grid[1]] * 7)
    ]


def test_mass_and_hand_play_no_part() -> None:
    heavy = HapticLoop(
        device_mass=5.0,
        device_damping=DAMPER,
        hand_mass=1.0,
        hand_damping=3.0,
        hand_stiffness=200.0,
        sample_time=T,
        delay=T,
    )
    device = Device.mass_spring_damper(mass=0.1, damping=DAMPER, stiffness=50.0)
    arm = Hand.mass_spring_damper(mass=1.0, damping=5.0, stiffness=300.0)
    held = HapticLoop(device=device.held_by(arm), sample_time=T, delay=T)
    for own in (heavy, held):
        assert largest(own, 0.01) == pytest.approx(largest(loop(1.0), 0.01), rel=1e-12)


def test_a_passive_wall_is_stable_with_any_hand(rng: np.random.Generator) -> None:
    region = loop(1.0, velocity=Velocity.difference(5)).passive_region()
    for stiffness, damping in region.outline[::7].tolist():
        for mass, spring in 10.0 ** rng.uniform([-3.0, 0.0], [1.0, 5.0], (5, 2)):
            own = HapticLoop(
                device_mass=float(mass),
                device_damping=DAMPER,
                hand_stiffness=float(spring),
                sample_time=T,
                delay=T,
                velocity=Velocity.difference(5),
            )
            assert own.verdict(stiffness, damping)


# ---------------------------------------------------------------------------------------- refusals
def test_what_has_no_passive_walls() -> None:
    assert loop().is_passive(-1.0, 0.01) is False
    assert loop().is_passive(0.0, 0.0) is True
    assert loop(damper=0.0).is_passive(1.0, 0.0) is False
    assert not len(loop(damper=0.0).passive_region().outline)


def test_devices_and_filters_without_an_answer_are_refused() -> None:
    modes = Device.modes(
        [jaxstab.Mode(frequency=80.0, damping_ratio=0.01, modal_mass=0.5)], mass=0.25, damping=0.1
    )
    slow = Device.mass_spring_damper(mass=0.25, damping=0.1).with_actuator(200.0)
    for device in (modes, slow):
        with pytest.raises(ValueError, match="passive walls are known of one mass alone"):
            HapticLoop(device=device, sample_time=T).is_passive(1.0, 0.0)
    turned = loop(position=Filter.transfer_function([-1.0], [1.0]))
    with pytest.raises(ValueError, match="no wall is known to be passive"):
        turned.passive_region()
    with pytest.raises(ValueError, match="stiffness"):
        loop().is_passive(float("nan"), 0.0)
    with pytest.raises(ValueError, match="tolerance"):
        loop().passive_region(tolerance=0.0)
    with pytest.raises(TypeError, match="shape"):
        HapticLoop(device_mass=[0.1, 0.2], device_damping=0.1, sample_time=T).is_passive(1.0, 0.0)
