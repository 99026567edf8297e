"""Every table of a run is declared, and told in the documents."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path

import pandas as pd
import pytest

from calflow.files.data_package import table_schema
from calflow.files.tables import columns, from_frame, to_frame
from calflow.measurements.source import sha256
from calflow.run_folder import read_manifest
from calflow.stage_settings import SETTINGS
from calflow.stages.catalogue import STAGES
from made.contents import renewed

FILES = Path(__file__).parents[2] / "docs" / "files.md"
KNOWN = {path: row_type for stage in STAGES.values() for path, row_type in (stage.tables | stage.documents).items()}


def test_the_documents_tell_what_the_code_declares():
    """Fails if docs/files.md was not renewed: python docs/made/contents.py docs/files.md."""
    text = FILES.read_text(encoding="utf-8")
    assert renewed(text) == text


def test_every_column_has_a_meaning_and_the_unit_of_its_name():
    """Fails if a column cannot be understood from the document."""
    for path, row_type in KNOWN.items():
        assert row_type.__doc__, path
        declared = [declared.metadata.get("spread", ("itself",)) for declared in fields(row_type)]
        assert len(columns(row_type)) == sum(map(len, declared)), path
        for column in columns(row_type):
            assert column.meaning, (path, column.name)
            for unit in ("mm", "mrad", "um", "urad", "deg", "m"):
                assert not column.name.endswith(f"_{unit}") or column.unit.startswith(unit), (path, column.name)


def test_a_run_keeps_what_is_declared_with_its_schema(finished):
    """Fails if a table of a run lacks its schema or holds what is not declared, or a summary is no JSON."""
    run = finished / "runs"
    package = json.loads((run / "datapackage.json").read_text(encoding="utf-8"))
    resources = {resource["path"]: resource for resource in package["resources"]}
    assert set(resources) == {name for entry in read_manifest(run).stages.values() for name in entry.outputs}
    assert all(resource["hash"] == f"sha256:{sha256(run / name)}" for name, resource in resources.items())
    assert all(resource["bytes"] == (run / name).stat().st_size for name, resource in resources.items())
    made = {path.relative_to(run).as_posix() for path in run.rglob("*") if path.suffix in (".csv", ".json")}
    for name in (name for name in made if name.endswith(".csv")):
        table = pd.read_csv(run / name)
        assert list(to_frame(from_frame(table, KNOWN[name]), KNOWN[name])) == list(table), name
        assert [field["name"] for field in resources[name]["schema"]["fields"]] == list(table)
        assert resources[name]["schema"] == table_schema(table, KNOWN[name])
    assert {"identify/summary.json", "sample/summary.json"} <= made
    summary = json.loads((run / "identify" / "summary.json").read_text(encoding="utf-8"))
    assert summary["converged"] is True
    assert isinstance(summary["sigma_mm"], float)


def test_other_programs_read_a_runs_data_package(finished):
    """Fails if Frictionless finds a fault in the package, a file's bytes or hash, or a cell that is not of its column's type."""
    frictionless = pytest.importorskip("frictionless")
    report = frictionless.validate(str(finished / "runs" / "datapackage.json"))
    assert report.valid, report.flatten(["title", "fieldName", "rowNumber", "message"])
    assert len(report.tasks) > 20


def test_every_stage_has_its_settings_among_those_of_a_study_file():
    """Fails if a stage was added or renamed and the schema of a study file does not say so."""
    assert {name: stage.settings for name, stage in STAGES.items()} == SETTINGS
