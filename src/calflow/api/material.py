"""What figures and the report are made from, where no study is on disk."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from calflow.api.diagnosed import Diagnosis
from calflow.api.fit import Fit
from calflow.reporting.material import Material
from calflow.study import Study, StudyFile, WorkflowFile

NOWHERE = Path()


def material_of(found: Fit | Diagnosis, title: str = "") -> Material:
    """Return what a fit's or a diagnosis' figures and report are made from."""
    fit = found.fit if isinstance(found, Diagnosis) else found
    data, known = fit.identification.data, found.model.known
    results = fit.results | found.results
    stages: dict[str, dict[str, Any]] = {"identify": {"starts": fit.identification.starts}}
    if isinstance(found, Diagnosis):
        stages["diagnose"] = {"false_alarm": found.false_alarm}
    study = _study(fit, title, stages)
    return Material(study, data.only(data.train | data.held_out), known, results, NOWHERE)


def _study(fit: Fit, title: str, stages: dict[str, dict[str, Any]]) -> Study:
    """The study that asks for what was asked for in Python."""
    name = "python"
    file = StudyFile(
        name=name, title=title or f"Calibration of {fit.measured.robot.name}", robot="robot.toml", seed=fit.seed,
        effects=fit.effects, stages=stages,
    )  # fmt: skip
    return Study(NOWHERE, file, fit.measured.robot, NOWHERE, WorkflowFile(name=name, stages=tuple(stages)), NOWHERE)
