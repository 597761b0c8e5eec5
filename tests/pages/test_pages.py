"""The pages of docs/ run as they stand there, and say what is so."""

import os
import re
import shlex
import tomllib
from collections.abc import Iterator
from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest
from calls import COMPUTING_CALLS, PUBLIC
from campaign import some
from commands import run, run_code
from scipy.linalg import expm
from transforms import ESTIMATORS, check_values, rows, with_estimator

import jaxstab
from benchmarks import record, table
from jaxstab.app.scene import any_scene
from jaxstab.lab.guard import build

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
PRINTED = "<!-- printed by the lines above -->"  # before a table


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
    for lines in re.findall(rf"{PRINTED}\n.*\n.*\n((?:\|.*\n)+)", page.read_text("utf-8")):
        assert set(lines.splitlines()) <= set(completed.stdout.splitlines())


def scenes(page: Path) -> Iterator[str]:
    """The scenes of a page that have a device and a controller, or a loop."""
    yield from (t for t in blocks(page, "toml") if "[controller]" in t or "[loop]" in t)


@pytest.mark.parametrize(
    "page", [page for page in PAGES if any(scenes(page))], ids=lambda page: page.name
)
def test_the_scenes_are_read_and_nothing_about_them_is_unusual(page: Path) -> None:
    for text in scenes(page):
        assert any_scene(tomllib.loads(text)).unusual() == []


@pytest.mark.campaign
@pytest.mark.parametrize("page", list(pages_with("sh")))
def test_the_commands_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside data/, and the scenes of the page whose first line is a file's name."""
    (tmp_path / "data").symlink_to(ROOT / "data")
    for text in scenes(page):
        for name in re.findall(r"\A# (\w+\.toml)\n", text):
            (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    for work in ("_OF_MASS", "_OF_DEVICE"):  # so many boxes prove something
        few = getattr(build, work)._replace(most=100_000)
        monkeypatch.setattr(build, work, few)
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


def test_every_method_of_a_loop_is_on_its_page() -> None:
    (listed,) = re.findall(r"members: \[(.+)\]", (DOCS / "api" / "loop.md").read_text("utf-8"))
    loop = jaxstab.HapticLoop
    methods = {name for name in dir(loop) if name[0] != "_" and callable(getattr(loop, name))}
    assert methods - set(listed.split(", ")) == {"in_floats", "tree_flatten", "tree_unflatten"}


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


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[] if name == "verdict" else pytest.mark.campaign)
        for name in some(dict.fromkeys(["verdict", *COMPUTING_CALLS]), 14)
    ],
)
def test_what_jax_makes_of_a_function_has_the_right_values(name: str) -> None:
    """The "yes" of the table: against plain answers, and differences of these."""
    check_values(name)
    if COMPUTING_CALLS[name][0] == "loop":
        check_values(name, with_estimator(ESTIMATORS[-1]))


def anchors(page: Path) -> set[str]:
    """What a page's headings, and its names and their members, are called in links."""
    text = re.sub(r"(?ms)^```.*?^```", "", page.read_text(encoding="utf-8"))
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    slugs = [re.sub(r"[^\w\s-]", "", heading).strip().lower() for heading in headings]
    names = re.findall(r"^::: jaxstab\.(.+)$", text, re.MULTILINE)
    members = [f"{name}.{member}" for name in names for member in dir(attrgetter(name)(jaxstab))]
    headed = {re.sub(r"[-\s]+", "-", slug) for slug in slugs}
    return headed | {f"jaxstab.{name}" for name in [*names, *members]}


@pytest.mark.parametrize("page", [*PAGES, *sorted(ROOT.glob("*.md"))], ids=lambda page: page.name)
def test_links_lead_to_a_file_and_a_heading(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]*[.#][^)\s]*)\)", page.read_text(encoding="utf-8")):
        if not re.match(r"https?://", target):
            file, _, anchor = target.partition("#")
            file = page.parent / file if file else page
            assert file.exists(), target
            assert not anchor or anchor in anchors(file), target


def test_the_paper_cites_what_its_bibliography_has() -> None:
    cited = set(re.findall(r"@(\w+)", (DOCS / "paper.md").read_text(encoding="utf-8")))
    has = re.findall(r"^@\w+{(\w+),", (DOCS / "paper.bib").read_text("utf-8"), re.MULTILINE)
    assert cited == set(has)
    assert len(has) == len(cited)


def test_the_tables_of_accuracy_are_those_of_the_records() -> None:
    records, page = record.read_all(record.RESULTS), (DOCS / "accuracy.md").read_text("utf-8")
    assert table.rivals(records) in page
    assert table.markdown(records) in page


def test_interpolated_forces_are_late_by_half_a_period() -> None:
    """The limit of such a loop, by its own step matrix, and of loops with more delay (the FAQ)."""
    period, mass, damping = 1.0 / 60.0, 0.25, 0.1
    rates = np.array([[0, 1, 0, 0], [0, -damping / mass, 1 / mass, 0], [0, 0, 0, 1], [0, 0, 0, 0]])
    step = expm(rates * period)[:2]  # of position, velocity, force and its slope

    def is_stable(stiffness: float, wall_damping: float) -> bool:
        """With the last position and the last force as states."""
        by_difference = wall_damping / period
        force = np.array([-stiffness - by_difference, 0.0, by_difference, 0.0])
        last_force = np.eye(4)[3]
        acting = np.vstack([np.eye(4)[:2], last_force, (force - last_force) / period])
        loop = np.vstack([step @ acting, np.eye(4)[0], force])
        return bool(abs(np.linalg.eigvals(loop)).max() < 1.0)

    dampings, stiffnesses = np.linspace(8.0, 9.0, 21), np.linspace(1.0, 300.0, 300)
    largest = max(
        next(k for k in stiffnesses if not is_stable(k, b)) - 1.0 for b in dampings.tolist()
    )
    half, whole = (
        jaxstab.HapticLoop(
            device_mass=mass, device_damping=damping, sample_time=period, delay=periods * period
        ).limits()
        for periods in (0.5, 1.0)
    )
    assert largest == pytest.approx(250.0, abs=1.0)
    assert half.stiffness == pytest.approx(largest, rel=0.03)
    assert whole.stiffness < 0.6 * largest


def test_included_files_are_there() -> None:
    for page in PAGES:
        for file in re.findall(r'^--8<-- "(.+)"$', page.read_text(encoding="utf-8"), re.MULTILINE):
            assert os.path.exists(ROOT / file), (page, file)


@pytest.mark.campaign
def test_the_first_page_of_the_site_has_the_explorer(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mkdocs")
    from mkdocs.config import load_config
    from mkdocs.structure.files import Files

    monkeypatch.chdir(ROOT)
    config = load_config(str(ROOT / ".mkdocs.yml"))
    (page,) = config.plugins.on_files(Files([]), config=config)  # the hook among them
    assert f'src="{page.src_uri}"' in (DOCS / "index.md").read_text(encoding="utf-8")
    assert '"mass": 0.25' in page.content_string
