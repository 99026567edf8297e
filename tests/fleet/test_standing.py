"""What of a fleet is still to be done."""

from __future__ import annotations

import os

from calflow.fleet.fleet import load_fleet
from calflow.fleet.fleet_folder import FleetFolder
from calflow.fleet.standing import forget_stale


def test_other_measurements_are_noticed_whatever_their_date(plant):
    """Fails if a file that was copied with its old date, or written after a clock was set back, leaves a robot as it was."""
    assert plant.fleet("work", "A-1", "B-2").code == 0
    loaded, folder = load_fleet(plant.file), FleetFolder(plant.out)
    forget_stale(loaded, folder)
    assert folder.outcome("A-1").exists()
    measured = plant.measurements("A-1")
    measured.write_text(measured.read_text() + "\n")
    os.utime(measured, (1e9, 1e9))  # of the year 2001
    forget_stale(loaded, folder)
    assert not folder.outcome("A-1").exists()
    assert folder.outcome("B-2").exists()
