"""Every notebook runs from top to bottom and reads like a text.

The quick suite runs one of them, `make slow` the others.
"""

from pathlib import Path

import nbformat
import pytest
from conftest import measured
from nbclient import NotebookClient

FOLDER = Path(__file__).parents[1] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
QUICK = "03_friction_without_a_model"


@pytest.fixture(params=NOTEBOOKS, ids=lambda file: file.stem)
def notebook(request):
    return nbformat.read(request.param, as_version=4)


@pytest.mark.parametrize(
    "file",
    [pytest.param(f, marks=[] if f.stem == QUICK else pytest.mark.slow) for f in NOTEBOOKS],
    ids=lambda file: file.stem,
)
def test_the_notebook_runs(file):
    """Records that it needs are named in its metadata; skipped without them."""
    notebook = nbformat.read(file, as_version=4)
    for name in notebook.metadata.get("ivtools", {}).get("needs", []):
        measured(name)
    resources = {"metadata": {"path": str(FOLDER)}}
    NotebookClient(notebook, timeout=240, kernel_name="python3", resources=resources).execute()


def test_the_notebook_opens_with_its_title_and_explains_itself(notebook):
    first, *_ = notebook.cells
    assert first.cell_type == "markdown" and first.source.startswith("# ")
    kinds = [cell.cell_type for cell in notebook.cells]
    assert kinds.count("markdown") * 3 >= len(kinds)


def test_the_committed_output_is_whole(notebook):
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.execution_count for cell in cells), "run the notebook before committing it"
    for output in (output for cell in cells for output in cell.outputs):
        assert output.output_type != "error"
        assert output.get("name") != "stderr", "a warning was committed"
        assert "/home/" not in str(output) and "/root/" not in str(output)
