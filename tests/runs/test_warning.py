"""A model that its own report tells nobody to use says so wherever it is used."""

from __future__ import annotations

import pandas as pd
import pytest

from applied import compensate, export_run, filter_program, predict
from runs.test_filter import PROGRAM


@pytest.fixture
def asked(finished):
    """A finished run with targets, rows to predict and a program."""
    rows = finished.rows[:4:2].drop(columns=["sigma_mm", "repeat"])
    finished.measure(rows, "targets.csv")
    finished.measure(rows.drop(columns=["x_mm", "y_mm", "z_mm"]), "rows.csv")
    (finished / "points.ls").write_bytes(PROGRAM.replace("\n", "\r\n").encode())
    return finished


def first_notes(run):
    """What each of the commands that use a model says first; nothing where it has nothing to say."""
    notes = [
        compensate(run / "runs", run / "targets.csv").attrs["notes"],
        predict(run / "runs", run / "rows.csv").attrs["notes"],
        filter_program(run / "runs", run / "points.ls", payload="heavy").notes,
        export_run(run / "runs", "dh").notes,
    ]
    return [own[0] if own else "" for own in notes]


def test_a_model_that_gained_nothing_is_said_to_be_useless_first(asked):
    """Fails if a command uses a model whose report says that it is not to be used, and says so late or never."""
    assert not any(said.startswith("Do not use") for said in first_notes(asked))
    table = pd.read_csv(asked / "runs" / "identify" / "accuracy.csv")
    table["mean_mm"] = table.groupby("split")["mean_mm"].transform("first")
    asked.rewrite("identify/accuracy.csv", table)
    assert all(said.startswith("Do not use this model: ") for said in first_notes(asked))


def test_a_verdict_of_another_version_is_not_taken_for_a_good_one(asked):
    """Fails if a table from which the verdict cannot be read ends a command, or passes for one that says nothing bad."""
    table = pd.read_csv(asked / "runs" / "identify" / "accuracy.csv")
    asked.rewrite("identify/accuracy.csv", table.drop(columns="mean_mm"))
    assert all("cannot be told from identify/accuracy.csv" in said for said in first_notes(asked))
