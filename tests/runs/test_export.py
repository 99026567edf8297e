"""Export from a run folder: what a format leaves out is told over the rows that were fitted, as they were fitted."""

from __future__ import annotations

import re

from applied import export_run


def figures(notes):
    """The costs that notes tell [mm]."""
    return [float(one) for note in notes for one in re.findall(r"([\d.]+) mm", note)]


def test_a_robot_file_that_changed_since_does_not_change_what_is_told(small):
    """Fails if rows are packed for the payloads of a robot file that the run has not seen, or random ones go without a word."""
    assert small.calflow("run", "--stage", "identify").code == 0
    before = export_run(small / "runs", "dh")
    small.edit("robot.toml", ("[payloads.light]", "[payloads.crate]\nmass_kg = 90\n\n[payloads.light]"))
    assert export_run(small / "runs", "dh") == before
    (small / "measurements.csv").unlink()
    gone = export_run(small / "runs", "dh")
    assert figures(gone.notes)
    (without,) = [note for note in gone.notes if note.startswith("the measurements are no longer there")]
    assert "random poses" in without
    assert gone.text == before.text
    told = small.calflow("export", small / "runs", "--to", "dh").err
    assert "note: the measurements are no longer there" in told


def test_the_controller_s_figures_are_beside_the_robot_file(finished):
    """Fails if what stands as nominal is not the robot file's."""
    text = export_run(finished / "runs", "controller").text
    assert re.search(r"^marker tool,x,mm,600,", text, flags=re.MULTILINE)
