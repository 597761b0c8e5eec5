"""Random loops of all kinds: no answer in balls is wrong by mpmath."""

import pytest
from campaign import many

from benchmarks.exact import QUESTIONS, rows

pytestmark = pytest.mark.campaign


def test_no_answer_in_balls_is_wrong() -> None:
    found = [row for row in rows(small=True, points=many(2000, small=5)) if "wrong" in row]
    assert {row["section"].split()[0] for row in found} == set(QUESTIONS)
    assert all(row["wrong"] == 0 for row in found)
    assert sum(row["judged"] for row in found) > 200
    assert sum(row["open"] for row in found) <= 0.005 * sum(row["points"] for row in found)
