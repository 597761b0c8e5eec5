"""Answers do not depend on the precision that is set in python-flint, and leave it as it was."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / "precisions.py"


def answers_at(bits: int, *options: str) -> dict[str, tuple[str, int]]:
    """The text of each answer, and the precision after it."""
    path = os.pathsep.join(map(str, (SCRIPT.parents[1], SCRIPT.parent)))
    done = subprocess.run(
        [sys.executable, SCRIPT, str(bits), *options],
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return {name: (text, after) for name, (text, after) in json.loads(done.stdout).items()}


def require_the_same(
    answers: dict[str, tuple[str, int]], others: dict[str, tuple[str, int]]
) -> None:
    assert answers.keys() == others.keys()
    assert [name for name in answers if answers[name][0] != others[name][0]] == []


def require_kept(answers: dict[str, tuple[str, int]], bits: int) -> None:
    assert [name for name, (_, after) in answers.items() if after != bits] == []


def test_answers_are_the_same_where_few_bits_are_set() -> None:
    few, usual = answers_at(4, "short"), answers_at(53, "short")
    require_the_same(few, usual)
    require_kept(few, 4)


@pytest.mark.campaign
def test_answers_are_the_same_where_few_or_many_bits_are_set() -> None:
    usual = answers_at(53)
    for bits in (4, 2000):
        answers = answers_at(bits)
        require_the_same(answers, usual)
        require_kept(answers, bits)
