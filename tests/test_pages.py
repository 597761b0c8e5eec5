"""The pages of docs/ run as they stand there, and say what is so."""

import os
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest
from commands import run, run_code
from transforms import rows

from benchmarks.calls import PUBLIC

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))


def blocks(page: Path, language: str) -> list[str]:
    pattern = rf"^```{language}\n(.*?)^```"
    return re.findall(pattern, page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


def pages_with(language: str) -> Iterator[object]:
    for page in PAGES:
        if blocks(page, language) and page.name != "guide.md":  # test_guide
            yield pytest.param(page, id=page.relative_to(DOCS).as_posix())


@pytest.mark.campaign
@pytest.mark.parametrize("page", list(pages_with("python")))
def test_the_lines_of_python_run_one_after_the_other(page: Path) -> None:
    code = "\n".join(blocks(page, "python"))
    completed = run_code(code, ROOT)
    assert completed.returncode == 0, completed.stderr
    for promised in re.findall(r"^print\(.*\)  # (.*)$", code, re.MULTILINE):
        assert promised in completed.stdout, completed.stdout


@pytest.mark.campaign
@pytest.mark.parametrize("page", list(pages_with("sh")))
def test_the_commands_run(page: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    for line in "".join(blocks(page, "sh")).splitlines():
        program, *arguments = shlex.split(line, comments=True)
        if program == "jaxstab":
            completed = run(*arguments)
            # 1: answered, and a wall is not proved stable.
            assert completed.exit_code in (0, 1), line


def test_every_public_name_is_on_a_page_of_the_api() -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in (DOCS / "api").glob("*.md"))
    listed = re.findall(r"^::: jaxstab\.([\w.]+)$", text, re.MULTILINE)
    assert sorted(listed) == sorted(set(PUBLIC) - {"paper", "results"} | {"conventions"})


@pytest.mark.campaign
def test_the_table_of_transformations_is_what_jax_does() -> None:
    text = (DOCS / "transforms.md").read_text(encoding="utf-8")
    shown = {
        cells[0].strip("`"): tuple(cells[1:])
        for line in text.splitlines()
        if line.startswith("| `")
        for cells in [[cell.strip() for cell in line.strip("|").split("|")]]
    }
    assert shown == rows()


def test_links_between_pages_lead_somewhere() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#]+\.[^)#]+)[^)]*\)", page.read_text(encoding="utf-8")):
            assert target.startswith("http") or (page.parent / target).exists(), (page, target)


def test_included_files_are_there() -> None:
    for page in PAGES:
        for file in re.findall(r'^--8<-- "(.+)"$', page.read_text(encoding="utf-8"), re.MULTILINE):
            assert os.path.exists(ROOT / file), (page, file)
