"""Random and adversarial loops by the ten thousands against certified roots: no claim is wrong."""

import pytest
from campaign import many

from benchmarks.stress import Findings, Tally, share_of, tasks_of
from tests.truth.judge import CERTIFIED

pytestmark = pytest.mark.campaign

LOOPS = many(600_000, small=20_000)
DELAYS = {0.0: 2, 0.5: 1}  # and shares of the loops: each delay is compiled


@pytest.fixture(scope="module")
def findings() -> Findings:
    found = Findings()
    for task in tasks_of(LOOPS, DELAYS):
        found.add(share_of(task))
    return found


def of_delays(found: Findings, method: str) -> list[Tally]:
    return [
        tally for (axis, _, m), tally in found.tallies.items() if (axis, m) == ("delay", method)
    ]


def test_the_campaign_is_as_large_as_it_says(findings: Findings) -> None:
    assert findings.points >= LOOPS
    judged = findings.points - sum(tally.unjudged for tally in of_delays(findings, "verdict"))
    assert judged > 0.99 * findings.points


@pytest.mark.parametrize("method", CERTIFIED)
def test_no_certified_answer_is_wrong(method: str, findings: Findings) -> None:
    for tally in of_delays(findings, method):
        assert tally.wrong == 0, tally.worst["wrong"]
        assert tally.share_of_bound <= 1.0, tally.worst["share_of_bound"]


def test_most_loops_are_decided_and_the_campaign_can_find_wrong_answers(
    findings: Findings,
) -> None:
    for method, most in (("verdict", 0.5), ("verdict, exact", 0.2)):
        undecided = sum(tally.undecided for tally in of_delays(findings, method))
        assert undecided < most * findings.points
    assert any(tally.wrong for tally in of_delays(findings, "numpy.roots"))
