"""Published claims: each agrees, or is shown as a misprint, by truths that are not jaxstab's."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
from mpmath import matrix, mp, mpf

from docs.reproduced.claims import CLAIMS as PUBLISHED
from docs.reproduced.claims import Claim, markdown

PAGE = Path(__file__).parents[2] / "docs" / "reproduced" / "index.md"
CLAIMS = tuple(replace(claim, find=cache(claim.find)) for claim in PUBLISHED)


LONG = "largest passive", "simulated contacts", "best 2 % settling", "of the best pair"  # to find


@pytest.mark.parametrize(
    "claim",
    [
        pytest.param(one, marks=pytest.mark.campaign if any(x in one.says for x in LONG) else ())
        for one in CLAIMS
    ],
    ids=lambda claim: f"{claim.source}, {claim.says}",
)
def test_a_claim_agrees_or_is_a_misprint(claim: Claim) -> None:
    assert claim.words(claim.find()) == ("misprint" if claim.is_misprint else "agrees")


def claim_of(place: str) -> Claim:
    (claim,) = [one for one in CLAIMS if one.source.endswith(place)]
    return claim


def test_the_plant_of_eq_2_is_that_of_the_equations_of_motion() -> None:
    with mp.workdps(40):
        m, b, k, T, z = mpf("0.1"), mpf("1.5"), mpf(100), mpf("0.01"), mpf(2)
        held = mp.expm(matrix([[0, 1, 0], [-k / m, -b / m, 1 / m], [0, 0, 0]]) * T)
        moved = mp.lu_solve(z * mp.eye(2) - held[:2, :2], held[:2, 2])
        exact = float(moved[0])
    answer = claim_of("eq. (2)").find().answer
    assert f"{exact:.6e} m/N" in answer
    assert f"with m/T: {exact:.6e}" in answer


def test_the_frequency_of_eq_25_is_that_of_the_roots() -> None:
    frequency = float(mp.sqrt(mpf(100) / mpf("0.1") - (mpf("1.5") / (2 * mpf("0.1"))) ** 2))
    assert claim_of("eq. (25)").find().answer.startswith(f"{frequency:.4f} rad/s")


@pytest.mark.campaign
def test_the_page_has_the_table_of_today() -> None:
    assert markdown(CLAIMS) in PAGE.read_text(encoding="utf-8")
