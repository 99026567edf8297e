"""Rows measured since: further files of a study's first series, which its own file does not hold yet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from calflow.measurements.source import MeasurementSource
from calflow.study import Study


def with_rows(study: Study, files: Sequence[Path]) -> Study:
    """Return a study with rows measured since; without measurements of its own these are its measurements."""
    if study.file.sources or not files:
        return replace(study, further=tuple(files))
    file = study.file.model_copy(update={"measurements": MeasurementSource(file=str(files[0].resolve()))})
    return replace(study, file=file, further=tuple(files[1:]))
