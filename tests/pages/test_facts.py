"""The numbers of the pages are those of the records, and none comes from nowhere."""

from functools import cache

import pytest

from benchmarks import record, table
from docs import contact, facts, robots

RECORDS = record.read_all(record.RESULTS)


@cache
def phrases() -> dict[str, list[str]]:
    known = facts.facts()
    return {page: known.get(page, []) + facts.STATED.get(page, []) for page in facts.PAGES}


def page(name: str) -> str:
    return (facts.ROOT / name).read_text(encoding="utf-8")


def test_each_fact_is_of_a_page() -> None:
    assert {*facts.facts(), *facts.STATED} <= set(facts.PAGES)


@pytest.mark.parametrize("name", facts.PAGES)
def test_a_page_says_what_the_records_say(name: str) -> None:
    assert facts.missing(page(name), phrases()[name]) == []


@pytest.mark.parametrize("name", facts.PAGES)
def test_every_number_of_a_page_is_known(name: str) -> None:
    is_mathematics = name == facts.MATHEMATICS
    assert facts.unknown(page(name), phrases()[name], is_mathematics=is_mathematics) == []


@pytest.mark.parametrize(
    ("name", "stated", "changed"),
    [
        ("README.md", "36,168 N/m", "36,160 N/m"),
        ("docs/paper.md", "34 were undecided", "13.4 % were undecided"),
        ("docs/paper.md", "9,910.", "550,826."),
        ("docs/paper.md", "717 times", "1,000 times"),
        ("docs/paper.md", "17 published", "19 published"),
        ("docs/accuracy.md", "731,292 points", "727,741 points"),
        ("docs/contact.md", "69% of its", "73% of its"),
    ],
)
def test_a_number_that_differs_from_its_record_is_found(
    name: str, stated: str, changed: str
) -> None:
    text = page(name).replace(stated, changed)
    assert text != page(name)
    assert facts.missing(text, phrases()[name])
    assert facts.unknown(text, phrases()[name])


@pytest.mark.parametrize(
    "claim",
    [
        *("It takes 2.7 s of CPU time.", "The first trace takes\n17 s.", "It needs 0.6 GB."),
        *("It is 2 times faster.", "1 % are undecided.", "Of 250 loops none was wrong."),
        *("A region of 10,000 samples each.", "| limits | 1.3 ms |", "It is stable up to 245 N/m."),
        *("It is more than a thousand times faster.", "It takes a third of the time."),
        *("The scripts have 2,500 lines.", "Of 10^8 calls the slowest took 0.19 us."),
    ],
)
def test_what_was_measured_needs_a_record(claim: str) -> None:
    assert facts.unknown(claim, [])


@pytest.mark.parametrize(
    "text",
    [
        *("Python 3.11 to 3.14, MuJoCo 4.0.0 and CF-1.8 (IROS 2008)", "eqs. (1) to (3), 21(5)"),
        *("windows of 5 and 20 samples at 1 kHz, a delay of 4 ms", "## 3. Tune it", "z = -1"),
        *("`0.5 s`, $K = 17$", "to 50 digits, within 1e-9", "x in [it](a34.md#b12)"),
        "A device of 0.25 kg and a window of 20 ms:\n\n```\nmass = 0.25\nwindow = 0.02\n```\n",
    ],
)
def test_settings_names_and_examples_need_none(text: str) -> None:
    assert facts.unknown(text, []) == []


def test_tables_of_pages_are_those_of_the_records() -> None:
    (contacts,), joints = (
        next(one["rows"] for one in RECORDS if one["benchmark"] == name)
        for name in ("contact", "robots")
    )
    for made in contact.tables(contacts).values():
        assert made in page("docs/contact.md")
    assert robots.table(joints) in page("docs/robots.md")
    for made in (table.moving_delays(RECORDS), table.unresolved(RECORDS)):
        assert made in page("docs/accuracy.md")
    devices = [one for one in RECORDS if one["benchmark"] == "accelerator"]
    assert table.accelerated(devices) in page("docs/accuracy.md")
