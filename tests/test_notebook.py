"""The notebook of the documentation runs from its first cell to its last."""

from __future__ import annotations

import json
from pathlib import Path

import matplotlib
import pytest

from made.notebook import run_cell

NOTEBOOK = Path(__file__).parents[1] / "docs" / "first_calibration.ipynb"


def code_cells() -> list[dict]:
    """The cells of code."""
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    return [cell for cell in cells if cell["cell_type"] == "code"]


@pytest.fixture
def names(monkeypatch, tmp_path):
    """The names of a fresh kernel in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with matplotlib.rc_context():
        yield {"__name__": "__main__"}


def test_every_cell_runs(names):
    """Fails if a cell of the notebook raises, shows nothing, or tells another story than the text beside it.

    Its report, which test_calibration.py has written as well, is written where the site is built.
    """
    sources = ("".join(cell["source"]) for cell in code_cells())
    printed, results = zip(*(run_cell(one, names) for one in sources if ".report(" not in one), strict=True)
    assert sum(bool(repr(result)) for result in results if result is not None) >= 8
    assert "effect 'joint-backlash' needs columns approach1" in "".join(printed)
    first = names["better"].findings[0]
    assert (first.cause, first.joint) == ("joint-backlash", 1)
    assert names["commands"].reached.all()
    assert names["proof"].summary.status == "met"
    same, cause = next(result for result in results if isinstance(result, tuple) and isinstance(result[0], bool))
    assert (same, cause) == (True, "joint-backlash")


def test_it_is_kept_without_outputs():
    """Fails if somebody's outputs, with their paths, are kept with the notebook."""
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code_cells())
