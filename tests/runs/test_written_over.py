"""What commands write: nothing of somebody else's is written over unasked, and what they say is in the words of their options."""

from __future__ import annotations

import pandas as pd
import pytest

import calflow.commands.check
import calflow.commands.study
from calflow.files.problems import InputError
from calflow.files.writing import write_text
from conftest import in_process
from runs.test_filter import PROGRAM

WRITTEN = {
    "compensate": ("measurements.csv", "--out"),
    "predict": ("rows.csv", "--out"),
    "export": ("--to", "dh", "--out"),
    "check-poses": ("measurements.csv", "--out"),
    "filter": ("points.ls", "--payload", "heavy", "--summary"),
}


def asked(folder, command, written):
    """A call of a command that writes to a file of the folder."""
    (folder / "points.ls").write_text(PROGRAM, encoding="utf-8")
    folder.measure(folder.rows.drop(columns=["x_mm", "y_mm", "z_mm"]), "rows.csv")
    own = (folder / one if one.endswith((".csv", ".ls")) else one for one in WRITTEN[command])
    return (command, folder / "runs", *own, folder / written)


@pytest.mark.parametrize("command", WRITTEN)
def test_a_file_that_holds_something_else_is_left_unless_forced(finished, command):
    """Fails if a result takes the place of a file that its user has not offered, or of the same result only when forced."""
    (finished / "mine").write_text("mine", encoding="utf-8")
    *_, told = finished.refused(*asked(finished, command, "mine"))  # after notes
    assert told == "mine: is there already and holds something else; give --force to write over it, or another name"
    assert (finished / "mine").read_text(encoding="utf-8") == "mine"
    assert finished.calflow(*asked(finished, command, "mine"), "--force").code == 0
    made = (finished / "mine").read_bytes()
    assert made != b"mine"
    assert finished.calflow(*asked(finished, command, "mine")).code == 0
    assert (finished / "mine").read_bytes() == made


@pytest.mark.parametrize(
    ("command", "option", "there"),
    [(command, written[-1], "a folder") for command, written in WRITTEN.items()]
    + [(command, "--out", "a file") for command in ("drift", "next", "validate")],
)
def test_a_place_of_another_kind_is_refused_before_anything_is_computed(finished, monkeypatch, command, option, there):
    """Fails if a folder in place of a file, or a file in place of a folder, shows after minutes, or as trouble of the machine."""
    monkeypatch.setattr(calflow.commands.check.cf.Calibration, "load", None)
    monkeypatch.setattr(calflow.commands.study.cf, "load_study", None)
    mine = finished / "mine"
    if there == "a folder":
        mine.mkdir()
    else:
        mine.write_text("mine", encoding="utf-8")
    needed = {"export": ("--to", "dh"), "next": ()}.get(command, ("measurements.csv",))
    *_, told = finished.refused(command, finished / "runs", *needed, option, mine)
    assert told.startswith(f"Error: Invalid value for '{option}': ")
    assert "mine" in told


def test_a_folder_that_cannot_be_made_is_the_users_and_not_the_machines(finished):
    """Fails if a name below a file, or that of a folder, is trouble of the machine, with exit code 1."""
    (finished / "mine").write_text("mine", encoding="utf-8")
    rows = finished / "measurements.csv"
    *_, told = finished.refused("check-poses", finished / "runs", rows, "--out", finished / "mine" / "poses.csv")
    assert told == "mine/poses.csv: cannot be written: mine is no folder"
    with pytest.raises(InputError, match="is a folder: expected the name of a file"):
        write_text(finished / "runs", "mine")


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("check-poses", "--number", 2), "--number: expected 3 to 20"),
        (("drift", "--false-alarm", 2), "--false-alarm: expected 0.001 to 0.5"),
        (("validate", "--tolerance-mm", 0), "--tolerance-mm: expected more than 0"),
        (("validate", "--task", 0), "--task: expected a number greater than or equal to 1"),
    ],
)
def test_an_option_is_called_by_its_name(finished, arguments, told):
    """Fails if a user is told of a name that no option has."""
    command, *options = arguments
    (said,) = finished.refused(command, finished / "runs", finished / "measurements.csv", *options)
    assert said.startswith(told)


def test_an_interrupted_command_that_cannot_resume_does_not_say_so(finished, monkeypatch):
    """Fails if the user of a command that begins anew is told that it goes on."""

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("calflow.runs.given_rows.rows_to_predict", interrupted)
    answer = in_process("predict", finished / "runs", finished / "measurements.csv")
    assert (answer.code, answer.err.strip()) == (130, "interrupted: the same command begins anew")


def test_a_pose_that_is_called_as_a_formula_is_no_formula(finished):
    """Fails if a name in a stranger's measurements is computed by the spreadsheet that opens the predictions, or is lost there."""
    rows = finished.rows.drop(columns=["x_mm", "y_mm", "z_mm"])
    finished.measure(rows.assign(pose="=1+" + rows["pose"]), "rows.csv")
    told = finished.calflow("predict", finished / "runs", finished / "rows.csv", "--out", finished / "predicted.csv")
    assert told.code == 0, told
    written = pd.read_csv(finished / "predicted.csv", dtype=str)["pose"]
    assert written.tolist() == ("'=1+" + rows["pose"]).tolist()
    finished.measure(rows.assign(pose=written), "rows.csv")
    again = finished.calflow("predict", finished / "runs", finished / "rows.csv")
    assert again.out == (finished / "predicted.csv").read_text(encoding="utf-8")
