"""A hundred thousand hands and levels: is ``linear_validity`` the first rise of the error?

Hands of all sizes, a tenth of them without stiffness or without damping, levels from 0.1 to 100 %,
delays from 0 to 3, half of them whole. The truth is a polynomial of certified roots. ``error`` is
the largest relative error of the angle times the level, which is the condition of the question;
``wrong`` counts answers that are not the first rise, ``raised`` batches that gave an exception,
``not_proved`` answers that say so, ``unjudged`` questions whose roots are not told apart.
"""

from collections.abc import Iterator
from time import perf_counter

import numpy as np

from benchmarks.record import Row
from benchmarks.truth import NotCertain
from benchmarks.truth.validity import first_rise, random_questions
from jaxstab.model import by_name
from jaxstab.paper import LinearValidity, ValidityStatus, linear_validity

_QUESTIONS, _SMALL = 100_000, 200
_CHUNK = 10_000
_CLOSE = 1e-11  # over the level: a relative error of theta that is rounding alone


def rows(small: bool) -> Iterator[Row]:
    questions = _SMALL if small else _QUESTIONS
    for seed in range(max(1, questions // _CHUNK)):
        yield _row(seed, min(questions, _CHUNK))


def _row(seed: int, count: int) -> Row:
    questions = random_questions(np.random.default_rng([20120412, seed]), count)
    start, raised, answer = perf_counter(), 0, None
    try:
        answer = linear_validity(questions[0], **by_name(*questions[1:]))
    except (ArithmeticError, ValueError, RuntimeError) as error:
        raised = 1
        print(f"seed {seed}: {error!r}")
    seconds = perf_counter() - start
    wrong, unjudged, error = _judged(questions, answer) if answer else (count, 0, 0.0)
    return {
        "section": "linear_validity",
        "method": "linear_validity",
        "delay": 3.0,
        "points": count,
        "seconds": seconds,
        "seconds_quartiles": [seconds, seconds],
        "repeats": 1,
        "error": error,
        "error_measure": "largest relative error of theta, times the level",
        "seed": seed,
        "wrong": wrong,
        "raised": raised,
        "not_proved": int(np.sum(answer.status == ValidityStatus.NOT_PROVED)) if answer else 0,
        "unjudged": unjudged,
    }


def _judged(questions: np.ndarray, answer: LinearValidity) -> tuple[int, int, float]:
    """How many answers are wrong, how many cannot be judged, and the largest error."""
    wrong = unjudged = 0
    largest = 0.0
    for question, theta, status in zip(questions.T, answer.theta, answer.status, strict=True):
        try:
            true = first_rise(*map(float, question))
        except (NotCertain, ValueError):
            unjudged += 1
            continue
        if status == ValidityStatus.NOT_PROVED:
            continue
        if true is None or status == ValidityStatus.NEVER:
            wrong += true is not None or status != ValidityStatus.NEVER
            continue
        error = abs(float(theta / true.theta - 1)) * question[0]
        wrong += not error < _CLOSE
        largest = max(largest, error)
    return int(wrong), unjudged, float(largest)
