"""Lemmas: each names its test; V7's bounds against balls, the derivation of their constants."""

import re
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from campaign import many

from docs import rounding
from docs.rounding import UNIT, Zone
from jaxstab.model import DoubleDouble
from jaxstab.model.plant import may_cancel, pairs_error
from tests.truth import plants_in_balls

# The worst factors of a long search: their product is wrong by 2^-101.6.
WORST = (4503614388135502.0, 0.4999936223031387), (4503934500569479.0, 0.499998506378226)


ROOT = Path(__file__).parents[2]


def lemmas() -> list[str]:
    page = (ROOT / "docs" / "proofs.md").read_text(encoding="utf-8")
    return page.split("\n### Lemma ")[1:]


LEMMA = re.compile(
    r"""(?P<name>[A-Z]\d+)\ \(.+\)\n\n
    -\ \*\*In\ words\*\*:\ (?P<words>.+\n(\ \ .+\n)?)
    -\ \*\*Used\ by\*\*\ `(?P<code>jaxstab/[\w/]+\.py)::(?P<function>\w+)`\.\n
    -\ \*\*If\ false\*\*,\ `(?P<file>tests/[\w/]+\.py)::(?P<test>test_\w+)`\ fails\.\n\n""",
    re.VERBOSE,
)


@pytest.mark.parametrize("lemma", lemmas(), ids=lambda lemma: lemma.split()[0])
def test_each_lemma_opens_with_words_the_code_that_uses_it_and_a_test_of_it(lemma: str) -> None:
    opening = LEMMA.match(lemma)
    assert opening, lemma[:300]
    code, test = ((ROOT / opening[part]).read_text(encoding="utf-8") for part in ("code", "file"))
    assert re.search(rf"^ *(def|class) {opening['function']}\b", code, re.MULTILINE)
    assert f"\ndef {opening['test']}(" in test
    assert f"@pytest.mark.campaign\ndef {opening['test']}(" not in test, "it runs in campaigns only"
    numbers = re.findall(r"\b([A-Z])(\d+)(?: to \1(\d+))?\b", code)
    cited = {f"{k}{n}" for k, a, b in numbers for n in range(int(a), int(b or a) + 1)}
    assert opening["name"] in cited, f"{opening['code']} does not cite it"


def exact(number: DoubleDouble) -> Fraction:
    return Fraction(float(number.hi)) + Fraction(float(number.lo))


@pytest.mark.parametrize("make", [float, np.float64], ids=["floats", "arrays"])
def test_a_product_of_pairs_is_right_to_33_units_and_no_better_than_18(make: type) -> None:
    one, other = (DoubleDouble(*map(make, pair)) for pair in WORST)
    true = exact(one) * exact(other)
    error = abs(exact(one * other) - true) / true
    assert 2.0**-102 < error < rounding.PRODUCT < 2.0**-100.9


@pytest.mark.parametrize(
    "count", [100, pytest.param(many(10_000, 500), marks=pytest.mark.campaign)]
)
def test_no_bound_is_smaller_than_the_error_that_it_bounds(count: int) -> None:
    rng = np.random.default_rng(20081012)
    for number in range(count):
        for found in plants_in_balls.polynomial(rng, number % 2 == 1):
            assert found.slack >= 1.0, found


@pytest.mark.parametrize("factor", [1e-3, 1e-12])
def test_a_bound_that_is_too_small_is_noticed(
    factor: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        plants_in_balls.verdicts, "pairs_error", lambda *hand: pairs_error(*hand) * factor
    )
    rng = np.random.default_rng(1)
    findings = [f for n in range(80) for f in plants_in_balls.polynomial(rng, n % 2 == 1)]
    small = [f for f in findings if f.slack < 1.0]
    assert small
    assert {f.lemma for f in small} >= {"V7 D"}


@pytest.mark.parametrize("zone", rounding.ZONES.values(), ids=rounding.ZONES.keys())
def test_what_is_derived_is_what_the_verdicts_use(zone: Zone) -> None:
    for gamma in (np.nextafter(zone.gamma[0], 1e5), zone.gamma[1]):
        for delta in (np.nextafter(zone.delta[0], 1e5), zone.delta[1]):
            assert float(pairs_error(gamma, delta)) >= zone.bound
            assert bool(may_cancel(gamma, delta)) == zone.root


@pytest.mark.parametrize("name", ["soft", "soft, N may cancel"])
def test_the_bounds_of_soft_hands_are_derived_for_whole_delays(name: str) -> None:
    derived = rounding.derive(rounding.ZONES[name], with_fraction=False)
    assert derived.open == 0
    assert 0.01 * rounding.ZONES[name].bound < derived.of_d < rounding.ZONES[name].bound


@pytest.mark.parametrize("seed", range(20))
def test_values_and_errors_of_plants_lie_within_the_bounds_of_their_boxes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    gamma, delta, fraction = plants_in_balls.hand(rng, seed % 2 == 1)
    around = [(x * (1.0 - 1e-9), x * (1.0 + 1e-9)) for x in (0.5 * delta, gamma, fraction)]
    bounds = rounding.fractional(*around) if fraction else rounding.whole(*around[:2])
    findings = {f.lemma: f for f in plants_in_balls.plant_findings(gamma, delta, fraction)}
    assert findings["V7 D"].error <= bounds.of_d
    assert findings["V7 N"].error <= bounds.of_n
    assert findings["V7 N(-1)"].error <= bounds.of_n
    assert bounds.of_n < 1e-12
    assert UNIT == 2.0**-53
