"""Export from a run folder: what a format leaves out is told over the rows that were fitted, as they were fitted."""

from __future__ import annotations

import re

from calflow.runs.export import export_run


def figures(notes):
    """The costs that notes tell [mm]."""
    return [float(one) for note in notes for one in re.findall(r"([\d.]+) mm", note)]


def test_a_robot_file_that_changed_since_does_not_change_what_is_told(finished):
    """Fails if rows are packed for the payloads of a robot file that the run has not seen, or that goes without a word."""
    before = export_run(finished / "runs", "dh")
    finished.edit("robot.toml", ("[payloads.light]", "[payloads.crate]\nmass_kg = 90\n\n[payloads.light]"))
    after = export_run(finished / "runs", "dh")
    assert "the study's robot file has changed since" in after.notes[0]
    assert after.text == before.text
    (finished / "measurements.csv").unlink()
    gone = export_run(finished / "runs", "dh")
    assert "the measurements are not there any more" in gone.notes[0]
    assert figures(gone.notes) == figures(after.notes)


def test_the_controller_s_figures_are_beside_the_robot_file(finished):
    """Fails if what stands as nominal is not the robot file's."""
    text = export_run(finished / "runs", "controller").text
    assert re.search(r"^marker tool,x,mm,600,", text, flags=re.MULTILINE)
