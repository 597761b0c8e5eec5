"""What has no region: G(0) = 0, P(1) = 0, filters whose poles float64 takes for 1."""

from typing import Any

import numpy as np
import pytest

from jaxstab import (
    Device,
    Filter,
    HandRange,
    HapticLoop,
    Mode,
    Velocity,
    Verdict,
)

WASHED = HapticLoop(
    device=Device.transfer_function([1.0, 0.0], [1.0, 20.0, 500.0]), sample_time=1e-3, delay=1e-3
)


@pytest.mark.parametrize(
    "ask",
    [
        lambda loop: loop.region(),
        lambda loop: loop.limits(),
        lambda loop: loop.stiffness_limits(1.0),
        lambda loop: loop.damping_limits(1.0),
        lambda loop: loop.boundary_distance(1.0, 1.0),
        lambda loop: loop.tune(),
        lambda loop: loop.settling_time(1.0, 1.0),
        lambda loop: loop.simulate(1.0, 1.0, force=1.0),
        lambda loop: loop.amplitude(1.0, 1.0, encoder=1e-5),
    ],
)
def test_what_needs_a_rest_is_refused_in_a_sentence(ask: Any) -> None:
    with pytest.raises(ValueError, match="zero DC gain") as caught:
        ask(WASHED)
    assert "\n" not in str(caught.value)


def test_its_walls_have_verdicts_radii_and_margins() -> None:
    margins = WASHED.margins(60.0, 0.0)
    assert margins.verdict == Verdict.STABLE
    least, most = margins.stiffness
    assert WASHED.verdict(least + 1e-6 * abs(least), 0.0) == Verdict.STABLE
    for gain in (least - 1e-4 * abs(least), most * (1.0 + 1e-4)):
        assert WASHED.verdict(gain, 0.0) == Verdict.UNSTABLE
    later = HapticLoop(
        device=WASHED.device, sample_time=1e-3, delay=1e-3 + 0.999 * float(margins.extra_delay)
    )
    assert later.verdict(60.0, 0.0) == Verdict.STABLE
    assert np.isinf(WASHED.margins(10.0, 0.0).extra_delay)  # |K G| < 1 at all frequencies
    mode = WASHED.oscillation(60.0, 0.0)
    radius = float(WASHED.spectral_radius(60.0, 0.0).value)
    assert radius < 1.0
    assert np.isfinite(float(mode.frequency))


PLAIN = {"device_mass": 0.25, "device_damping": 0.1, "hand_stiffness": 10.0}
SHAKING = {"device": Device.modes([Mode(frequency=80.0, damping_ratio=0.01, modal_mass=0.5)])}


@pytest.mark.parametrize("body", [PLAIN, SHAKING])
@pytest.mark.parametrize(
    ("filters", "reason"),
    [
        ({"position": Filter.transfer_function([1.0, -1.0], [1.0, 0.0])}, "P\\(1\\) = 0"),
        ({"position": Filter.butterworth(1e-9, order=40)}, "position filter is so slow"),
        ({"velocity": Velocity.low_pass(1e-9, order=40)}, "velocity estimator is so slow"),
    ],
)
@pytest.mark.parametrize(
    "ask",
    [
        lambda loop: loop.region(),
        lambda loop: loop.limits(),
        lambda loop: loop.tune(),
        lambda loop: loop.robust_limit(HandRange(mass=(0.0, 1.0))),
    ],
)
def test_filters_without_a_region_are_refused_in_a_sentence(
    ask: Any, filters: dict[str, Any], reason: str, body: dict[str, Any]
) -> None:
    with pytest.raises(ValueError, match=reason) as caught:
        ask(HapticLoop(**body, **filters, sample_time=1e-3, delay=1e-3))
    assert "\n" not in str(caught.value)


def test_a_factor_that_float64_loses_is_refused() -> None:
    for make in (Velocity.exponential, Filter.exponential):
        with pytest.raises(ValueError, match="factor is 1e-200"):
            make(1e-200)
    assert Velocity.exponential(2.0**-53)
