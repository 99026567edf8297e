"""What was found of every robot, read from the run folders, and runs that were changed since."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd

from calflow.files.tables import from_frame, with_checksum
from calflow.fleet.engine import FleetFolder
from calflow.fleet.fleet import load_fleet
from calflow.fleet.fleet_report import write_summary
from calflow.fleet.standing import Outcome, forget_stale, outcomes
from calflow.fleet.types import collected
from calflow.run_folder import NAME, read_manifest
from fleet.plant import ROBOTS, broken, calibrated


def test_parameters_and_covariances_are_those_of_the_runs(plant):
    """Fails if a figure is another robot's or stands in another order."""
    fleet, folder = load_fleet(plant.file), FleetFolder(plant.out)
    calibrated(fleet, folder, ["C-3", "A-1"])
    found = [collected(fleet.robot(name), folder) for name in ("A-1", "C-3")]
    assert [(one.robot, one.type) for one in found] == [("A-1", "small"), ("C-3", "small")]
    for one in found:
        names = [parameter.name for parameter in one.calibration.parameters]
        table = pd.read_csv(folder.run(one.robot) / "identify" / "parameters.csv")
        assert names == list(table["parameter"])
        np.testing.assert_array_equal(one.calibration.estimate, table["estimate"])
        kept = pd.read_csv(folder.run(one.robot) / "identify" / "covariance.csv").set_index("parameter")
        np.testing.assert_array_equal(one.calibration.covariance, kept.loc[names, names])
    assert not np.array_equal(found[0].calibration.estimate, found[1].calibration.estimate)


def test_a_diagnosis_of_another_identification_is_not_taken(plant):
    """Fails if a robot that was identified anew is pooled by what was diagnosed before."""
    fleet, folder = load_fleet(plant.file), FleetFolder(plant.out)
    calibrated(fleet, folder, ["A-1"])
    run = folder.run("A-1")
    manifest = read_manifest(run)
    diagnosed = manifest.stages["identify"].model_copy(update={"key": {"after identify": "another"}})
    manifest = manifest.model_copy(update={"stages": {**manifest.stages, "diagnose": diagnosed}})
    (run / NAME).write_text(json.dumps(with_checksum(manifest.model_dump(exclude_none=True))))
    table = pd.read_csv(run / "identify" / "parameters.csv")
    np.testing.assert_array_equal(collected(fleet.robot("A-1"), folder).calibration.estimate, table["estimate"])


def test_a_run_that_was_changed_is_told_and_made_anew(plant):
    """Fails if one folder in which somebody wrote keeps all others from a report, or is taken as it is for ever."""
    broken(plant, "B-2")
    fleet, folder = load_fleet(plant.file), FleetFolder(plant.out)
    calibrated(fleet, folder, ROBOTS)
    (folder.run("C-3") / "identify" / "parameters.csv").write_text("", encoding="utf-8")
    write_summary(fleet, folder, outcomes(fleet, folder))
    rows = {one.robot: one for one in from_frame(pd.read_csv(plant.out / "fleet.csv"), Outcome)}
    assert [rows[name].status for name in ROBOTS] == ["calibrated", "failed", "failed"]
    assert "identify/parameters.csv was changed by hand" in rows["C-3"].reason
    forget_stale(fleet, folder)
    assert [folder.outcome(name).exists() for name in ROBOTS] == [True, False, False]


def test_an_outcome_of_another_version_is_no_reason_to_stop(plant):
    """Fails if a fleet cannot be run any more after calflow was renewed."""
    fleet, folder = load_fleet(plant.file), FleetFolder(plant.out)
    folder.outcome("A-1").parent.mkdir(parents=True)
    for name, text in (("A-1", "{"), ("B-2", '{"robot": "B-2"}')):
        folder.outcome(name).write_text(text, encoding="utf-8")
    forget_stale(fleet, folder)
    assert not any(folder.outcome(name).exists() for name in ROBOTS)
