"""The notebooks run from the first cell to the last."""

import json
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


@pytest.mark.campaign
@pytest.mark.filterwarnings("default")  # of the kernel's own packages
@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)
def test_a_notebook_runs(file: Path) -> None:
    import nbclient
    import nbformat

    notebook = nbformat.read(file, as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells), "is kept without outputs"
    folder = {"metadata": {"path": str(file.parent)}}
    nbclient.NotebookClient(
        notebook, timeout=300, resources=folder, kernel_name="python3"
    ).execute()


def test_the_notebook_of_an_atlas_says_that_it_needs_a_checkout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    cells = json.loads((ROOT / "docs/notebooks/atlas_elsewhere.ipynb").read_text("utf-8"))["cells"]
    code = next("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    with pytest.raises(FileNotFoundError, match="run this notebook in a checkout of jaxstab"):
        exec(code, {})


def test_every_notebook_is_on_the_page() -> None:
    page = (ROOT / "docs" / "notebooks" / "index.md").read_text(encoding="utf-8")
    assert len(NOTEBOOKS) == 6
    for file in NOTEBOOKS:
        assert f"]({file.name})" in page
