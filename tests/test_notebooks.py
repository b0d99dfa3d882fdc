"""Every notebook is kept without results, says what it shows, and runs to the end of its own claim without a word of warning."""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from strip_notebooks import FOLDER, stripped

NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
each_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def read(path: Path) -> nbformat.NotebookNode:
    return nbformat.read(path, as_version=4)


def test_there_are_notebooks():
    assert NOTEBOOKS


@each_notebook
def test_is_a_notebook_without_results(path):
    nbformat.validate(read(path))
    text = path.read_text(encoding="utf-8")
    assert text == stripped(text), (
        f"{path.name} holds results or settings: python -m tests.strip_notebooks takes them out"
    )


@each_notebook
def test_begins_with_a_title_and_ends_with_its_claim(path):
    cells = read(path).cells
    code = [cell.source for cell in cells if cell.cell_type == "code"]
    assert cells[0].cell_type == "markdown"
    assert cells[0].source.startswith("# ")
    assert any(line.startswith("assert ") for line in code[-1].splitlines())


@each_notebook
def test_is_listed(path):
    assert f"]({path.name})" in (FOLDER / "README.md").read_text(encoding="utf-8")


@pytest.mark.slow
@each_notebook
def test_runs_without_a_warning_and_leaves_nothing_behind(path, tmp_path):
    notebook = read(path)
    NotebookClient(
        notebook, timeout=900, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    said = [o.text for o in outputs if o.output_type == "stream" and o.name == "stderr"]
    assert said == []
    assert not [o for o in outputs if o.output_type == "error"]
    assert list(tmp_path.iterdir()) == []
