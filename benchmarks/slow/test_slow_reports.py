"""Reports of large data."""

from __future__ import annotations

from pathlib import Path

from reporting.case import Case, context, with_sample
from reporting.test_report import built


def test_large_data_are_reported(tmp_path: Path) -> None:
    """Fails if a report of several markers, repeats and thousands of rows is too large to be sent."""
    given = with_sample(context(tmp_path, Case(poses=400, repeats=4, markers=("1", "2"))))
    files = built(given, tmp_path / "out")
    assert files["report.pdf"].startswith(b"%PDF")
    assert len(files["report.pdf"]) < 3e6
    assert len(files.pop("report.html")) < 2e6  # with every figure and its numbers, to be sent by mail
    assert max(map(len, files.values())) < 2e6  # crowds of points are pictures
