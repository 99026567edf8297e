"""What of a fleet is still to be done."""

from __future__ import annotations

import os

from calflow.fleet.engine import FleetFolder
from calflow.fleet.fleet import load_fleet
from calflow.fleet.standing import forget_stale
from fleet.plant import ROBOTS, broken, calibrated


def test_other_measurements_are_noticed_whatever_their_date(plant):
    """Fails if a file that was copied with its old date, or written after a clock was set back, leaves a robot as it was.

    Nor may what failed not be tried again.
    """
    loaded, folder = load_fleet(plant.file), FleetFolder(plant.out)
    broken(plant, "C-3")
    found = calibrated(loaded, folder, ROBOTS)
    assert [found[name].status for name in ROBOTS] == ["calibrated", "calibrated", "failed"]
    forget_stale(loaded, folder)
    assert [folder.outcome(name).exists() for name in ROBOTS] == [True, True, False]
    measured = plant.measurements("A-1")
    measured.write_text(measured.read_text() + "\n")
    os.utime(measured, (1e9, 1e9))  # of the year 2001
    forget_stale(loaded, folder)
    assert not folder.outcome("A-1").exists()
    assert folder.outcome("B-2").exists()


def test_what_was_changed_since_is_told(plant):
    """Fails if a figure of an outcome that was changed is passed on, or a robot of a changed run left out without a word."""
    calibrated(load_fleet(plant.file), FleetFolder(plant.out), ["A-1", "B-2"])
    told = plant.fleet("report")
    assert (told.code, "A-1" in told.out) == (0, False)
    table = plant.out / "robots" / "A-1" / "identify" / "parameters.csv"
    before = table.read_bytes()
    table.write_bytes(before.replace(b"1", b"2", 1))
    told = plant.fleet("report")
    assert "! A-1 (small): Failed" in told.out
    assert "identify/parameters.csv was changed by hand" in told.out
    assert "B-2" not in told.out
    table.write_bytes(before)
    outcome = plant.out / "outcomes" / "A-1.json"
    outcome.write_bytes(outcome.read_bytes().replace(b'_mm": 0.', b'_mm": 1.', 1))
    for command in ("status", "report"):
        answer = plant.fleet(command)
        assert answer.code == 2
        assert "A-1.json: cannot be read (it was changed since it was written)" in answer.err
