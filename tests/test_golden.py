"""The golden record: the same bits again from the same code, and the name of what changed."""

from functools import wraps
from typing import Any

import numpy as np
import pytest

import jaxstab
from benchmarks import golden
from benchmarks.golden import Question
from jaxstab.arrays import leaves

WALLS = [Question("verdict", form, number) for form in ("plain", "arrays") for number in range(3)]


@pytest.mark.campaign
def test_the_same_code_gives_the_same_bits_and_few_errors() -> None:
    answers = {question: question.answer() for question in golden.questions(quick=True)}
    again = [question for question in answers if question.number == 0]
    rows = golden.hashes(again)
    assert "".join(golden.hash_of(answers[question]) for question in again) == "".join(
        map("".join, map(dict.values, rows.values()))
    )
    assert list(golden.changes(rows, rows)) == []
    assert set(rows) == set(golden.COUNTS) - golden.SLOW
    # Errors are answers, too, but a record of errors alone would compare nothing.
    refused = [a for a in answers.values() if isinstance(a[0], str) and a[0].endswith("Error")]
    assert len(refused) < 0.1 * len(answers)


def test_what_changed_is_named_with_its_first_question_and_both_values(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before, answers = golden.hashes(WALLS), [question.answer() for question in WALLS]
    verdict = jaxstab.verdict

    @wraps(verdict)
    def other(*given: Any, **options: Any) -> Any:
        codes = np.array(verdict(*given, **options))
        if codes.size > 1:
            codes[7] = 3
        return codes

    monkeypatch.setattr(jaxstab, "verdict", other)
    (change,) = golden.changes(before, golden.hashes(WALLS))
    assert (change.question, change.changed, change.asked) == (WALLS[3], 3, 3)
    found = golden.first_difference(answers[3], change.question.answer())
    assert found == f"value 0, element 7, was {answers[3][0][7]} and is 3"


def test_an_ulp_and_the_sign_of_a_zero_are_changes_and_the_kind_of_nan_is_none() -> None:
    values = np.array([1.0, 0.0, np.nan])
    for place, value in enumerate([np.nextafter(1.0, 2.0), -0.0, -np.nan]):
        other = values.copy()
        other[place] = value
        answers = [[golden.canonical(leaf) for leaf in leaves([v])] for v in (values, other)]
        is_same = golden.hash_of(answers[0]) == golden.hash_of(answers[1])
        assert is_same == (place == 2)


def test_a_commit_that_git_does_not_have_shows_no_values() -> None:
    assert golden.recorded_answers("0" * 40, WALLS[:1]) is None
