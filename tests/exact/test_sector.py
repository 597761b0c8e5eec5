"""Forces that only push, clip or harden (C7): worked numbers, attacks in time on what is proved."""

from collections.abc import Iterator
from functools import partial
from math import exp, pi
from typing import Any, NamedTuple

import numpy as np
import pytest
from campaign import many

from jaxstab import Device, Hand, HapticLoop, Mode, Velocity
from jaxstab.exact.sector import OneSidedWall, Taps, multiplier, proves
from jaxstab.model.balls import ball_triple
from tests.truth.one_sided import Body, Forces, Sampled, T, attacked, run


def wall_of(loop: HapticLoop, stiffness: float, damping: float) -> OneSidedWall:
    """No force and the linear wall, both gains behind the function."""
    return OneSidedWall(partial(ball_triple, loop), (0.0, 0.0), (stiffness, damping))


def held(delay: float, velocity: Velocity) -> HapticLoop:
    return HapticLoop(
        device_mass=0.25,
        device_damping=0.1,
        hand_stiffness=100.0,
        sample_time=T,
        delay=delay * T,
        velocity=velocity,
    )


# ----------------------------------------------------------------------------------- known numbers
FIXED: list[Taps] = [(), ((1, 0.5),), ((1, 0.99),), ((1, 0.999),)]
SMOOTH = Velocity.low_pass(100.0)
WORKED = [
    (
        held(1.0, Velocity.difference(1)),
        5e-3,
        29805.566404,
        [4.3220193297, 4.4178581234, 25.361980567, 24353.133697],
    ),
    (
        held(1.0, Velocity.difference(5)),
        5e-3,
        10912.55484,
        [4.3020633592, 4.3973942112, 25.164768376, 7222.3585877],
    ),
    (
        held(1.0, Velocity.difference(20)),
        5e-3,
        1924.6693137,
        [4.2221771954, 4.3153185012, 24.190762477, 1087.9227351],
    ),
    (
        held(1.5, SMOOTH),
        8e-3,
        10914.900261,
        [4.5074116384, 4.6125752674, 33.887161659, 7461.5629663],
    ),
    (
        held(0.0, Velocity.difference(1)),
        5e-4,
        9918.5202083,
        [4.0394423098, 4.122689484, 17.83267173, 231.62781122],
    ),
]


@pytest.mark.parametrize(("loop", "ratio", "linear", "limits"), WORKED)
def test_a_given_multiplier_proves_up_to_its_limit_and_not_beyond(
    loop: HapticLoop, ratio: float, linear: float, limits: list[float]
) -> None:
    for taps, limit in zip(FIXED, limits, strict=True):
        for share, is_proved in ((1.0 - 1e-9, True), (1.0 + 1e-9, False)):
            wall = wall_of(loop, share * limit, share * limit * ratio)
            assert proves(taps, wall) == is_proved
    assert multiplier([wall_of(loop, 1.0001 * linear, 1.0001 * linear * ratio)]) is None
    found = multiplier([wall_of(loop, 0.998 * linear, 0.998 * linear * ratio)])
    assert (found is not None) == (loop.delay > 0.0)  # without a delay the gap is real or unknown


def test_weights_that_are_none_prove_nothing() -> None:
    wall = wall_of(held(1.0, Velocity.difference(1)), 1.0, 0.0)
    assert proves((), wall)
    for taps in (((1, -0.1),), ((0, 0.1),), ((1, 0.5), (-1, 0.5))):
        assert not proves(taps, wall)


def test_a_loop_that_is_unstable_without_the_force_is_not_proved() -> None:
    pushed = HapticLoop(
        device=Device.transfer_function([1.0], [1.0, 0.5, -20.0]), sample_time=T, delay=T
    )
    assert pushed.verdict(200.0, 3.0)
    assert multiplier([wall_of(pushed, 200.0, 3.0)]) is None


# --------------------------------------------------------------- stable for every slope, and swings
SWINGING = Body(
    0.2953188008,
    1.706221609,
    104.479974634,
    (32.86207064, 0.02760925431, 0.9709085399, 1.0, -0.5, 0.7),
)
CUTOFF = 35.10019347
GAINS = 4114.59, 14.110


def loop_of(body: Body, delay: float, velocity: Velocity) -> HapticLoop:
    device = Device.mass_spring_damper(mass=body.mass, damping=body.damping)
    if body.mode is not None:
        frequency, ratio, mass, motor, encoder, handle = body.mode
        mode = Mode(
            frequency=frequency,
            damping_ratio=ratio,
            modal_mass=mass,
            motor=motor,
            encoder=encoder,
            handle=handle,
        )
        device = Device.modes([mode], mass=body.mass, damping=body.damping)
    hand = Hand.mass_spring_damper(stiffness=body.spring)
    return HapticLoop(
        device=device.held_by(hand), sample_time=T, delay=delay * T, velocity=velocity
    )


def test_a_loop_stable_for_each_slope_swings_behind_a_force_that_only_pushes() -> None:
    loop = loop_of(SWINGING, 0.5, Velocity.low_pass(CUTOFF))
    own = Sampled.of(SWINGING, 0.5, smoothing=exp(-2.0 * pi * CUTOFF * T))
    linear = loop.stiffness_intervals(GAINS[1])
    assert linear.holding(GAINS[0])
    radii = [own.radius(share * GAINS[0], share * GAINS[1]) for share in np.linspace(0, 1, 201)]
    assert max(radii) == pytest.approx(float(loop.spectral_radius(*GAINS).value), abs=1e-12)
    assert max(radii) < 0.9973
    assert not loop.one_sided(*GAINS)
    proved = loop.one_sided_limit(ratio=GAINS[1] / GAINS[0])
    assert 0.57 < proved.stiffness / 4571.75 < 0.6
    # max(0, y) from random starts: from some the motion stays as it is, for ten seconds and more.
    rng, count = np.random.default_rng(4), 40
    forces = Forces(np.full((5, count), -0.02), np.repeat([[0.0], [1.0]], [1, 5], axis=0))
    forces = Forces(forces.knots, np.tile(forces.slopes, count))
    starts = rng.standard_normal((len(own.matrix), count))
    wall = own.read(*GAINS)
    starts, _ = run(own, wall, forces, starts / np.abs(wall @ starts), 8000)
    last, ratio = run(own, wall, forces, starts, 10000)
    swings = np.abs(ratio - 1.0) < 1e-3
    assert 5 < swings.sum() < count
    assert np.abs(last[:, ~swings]).max() < 1e-9


# ----------------------------------------------------------------------------------------- attacks
class Case(NamedTuple):
    """A loop, its truth, a form, and a direction of gains."""

    loop: HapticLoop
    truth: Sampled
    form: str
    ratio: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "Case":
        mass, spring = 10.0 ** rng.uniform([-1.0, 1.0], [0.5, 3.0])
        damping = mass * rng.uniform(0.3, 10.0)
        mode = None
        if rng.random() < 1 / 3:
            frequency, of_mass = 10.0 ** rng.uniform(1.3, 2.2), mass * rng.uniform(0.3, 4.0)
            shape = float(rng.choice([1.0, -0.5, 0.5]))
            mode = (frequency, rng.uniform(0.01, 0.1), of_mass, 1.0, shape, rng.uniform(0.3, 1.0))
            mode = tuple(map(float, mode))
        body = Body(float(mass), float(damping), float(spring), mode)
        delay = float(rng.choice([rng.integers(0, 6), rng.uniform(0.0, 5.0), 0.0]))
        given: dict[str, Any]
        if rng.random() < 0.6:
            window = int(rng.choice([1, 2, 5, 10, 20]))
            velocity, given = Velocity.difference(window), {"window": window}
        else:
            cutoff = float(10.0 ** rng.uniform(1.0, 2.5))
            velocity, given = Velocity.low_pass(cutoff), {"smoothing": exp(-2.0 * pi * cutoff * T)}
        form = str(rng.choice(["force", "force", "spring", "row"]))
        ratio = float(10.0 ** rng.uniform(-3.7, -0.9))
        return cls(loop_of(body, delay, velocity), Sampled.of(body, delay, **given), form, ratio)

    def linear(self) -> float:
        """The first stiffness along the ray at which the linear loop is not stable."""
        stable = self.loop._line((0.0, 0.0), (1.0, self.ratio)).holding(0.0)
        assert stable is not None
        return stable.high.value

    def limit(self) -> Any:
        """The largest stiffness that is proved."""
        if self.form == "force":
            return self.loop.one_sided_limit(ratio=self.ratio)
        at = {"damping": 0.5 * self.ratio * self.linear()}
        return self.loop.one_sided_limit(form="force" if self.form == "row" else "spring", **at)

    def attacked(
        self, gains: tuple[float, float], rng: np.random.Generator, **effort: Any
    ) -> float:
        """The largest ratio of a search."""
        if self.form == "spring":
            own = self.truth.damped(gains[1])
            return attacked(own, own.read(gains[0], 0.0), rng, **effort)
        return attacked(self.truth, self.truth.read(*gains), rng, **effort)


def findings(seed: int, **effort: Any) -> Iterator[str]:
    rng = np.random.default_rng([86, seed])
    case = Case.drawn(rng)
    proved = case.limit()
    if not proved:
        yield f"{seed}: nothing is proved"
        return
    late = float(case.loop.delay) + 1.5 * T
    if case.form == "force" and case.ratio > late and proved.stiffness < 0.9 * case.linear():
        yield f"{seed}: far below the linear limit"
    share = rng.uniform(0.5, 0.97) if case.form == "row" else 0.97
    damping = proved.damping * (share if case.form == "force" else 1.0)
    gains = share * proved.stiffness, damping
    radius = case.truth.radius(*gains)
    if abs(radius - float(case.loop.spectral_radius(*gains).value)) > 1e-6:
        yield f"{seed}: the truth is another loop"
    if not case.attacked(gains, rng, **effort) < 1.0:
        yield f"{seed}: {gains} is proved and swings"
    beyond = 1.03 * case.linear()
    power = case._replace(form="force").attacked((beyond, case.ratio * beyond), rng, **effort)
    if power < 1.0:
        yield f"{seed}: beyond the linear limit nothing is found"


@pytest.mark.parametrize("seed", range(3))
def test_no_motion_goes_on_where_it_is_proved_to_rest(seed: int) -> None:
    assert [text for text in findings(seed, generations=2) if "swings" in text] == []


@pytest.mark.campaign
def test_bred_forces_and_pushes_keep_no_proved_loop_moving() -> None:
    count = many(300, small=8)
    found = [text for seed in range(count) for text in findings(100 + seed)]
    assert [text for text in found if "swings" in text or "another" in text] == []
    assert len([text for text in found if "nothing is found" in text]) <= 0.02 * count
    assert len([text for text in found if "nothing is proved" in text]) <= 0.05 * count
    assert len([text for text in found if "far below" in text]) <= 0.05 * count
