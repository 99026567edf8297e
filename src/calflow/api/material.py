"""What figures and the report are made from, where no study is on disk."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from calflow.api.model import Model
from calflow.files.results import Results
from calflow.reporting.material import Calibration, Material
from calflow.study import Study
from calflow.study_file import StudyFile, WorkflowFile

NOWHERE = Path()
NAME = "python"
Settings = dict[str, dict[str, Any]]


def material_of(
    model: Model, results: Results, effects: tuple[str, ...], seed: int, settings: Settings, title: str
) -> Material:
    """Return what a fit's or a diagnosis' figures and report are made from; settings are those of each stage, in order."""
    title = title or f"Calibration of {model.robot.name}"
    file = StudyFile(name=NAME, title=title, robot="robot.toml", seed=seed, effects=effects, stages=settings)
    workflow = WorkflowFile(name=NAME, stages=tuple(settings))
    study = Study(NOWHERE, file, model.robot, NOWHERE, workflow, NOWHERE)
    used = model.data.only(model.data.train | model.data.held_out)
    return Material(study, results, NOWHERE, Calibration(used, model.known))
