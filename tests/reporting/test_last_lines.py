"""What a run ends with: the verdict, what was found with its size and gain, and the accuracy with it."""

from __future__ import annotations

import subprocess
import sys

import pytest

from calflow.deployment.run_outcome import RunOutcome
from calflow.design.next_poses import MeasuringVerdict, Suspect
from calflow.files.tables import Results
from calflow.reporting.terminal import last_lines, next_lines
from reporting.case import BACKLASH, COUPLED, MISFIT, OR_HYSTERESIS, OUTLIERS, context, with_diagnosis
from reporting.test_advice import in_space


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """CalibratedModel."""
    return context(tmp_path_factory.mktemp("study"))


def test_findings_are_told_with_cause_joint_size_probability_and_gain(given):
    """Fails if a reader of the last lines does not learn what was found, where, how large, how surely, and what it is worth."""
    lines = last_lines(RunOutcome(with_diagnosis(given, BACKLASH, OR_HYSTERESIS, COUPLED, OUTLIERS).results))
    found = [line for line in lines if line.startswith("found: ")]
    gain = "it takes 0.040 mm off the mean error at held-out poses (95 % interval 0.020 to 0.060 mm)"
    assert found == [
        f"found: backlash of joint 2, 100.0 ± 4.0 µrad, with probability 97 %; {gain}",
        "found: backlash of joint 2 or hysteresis of joint 2, 100.0 ± 4.0 µrad, the first with probability "
        f"97 %; {gain}",
        f"found: something unexplained that depends on the angles of joints 2 and 3; {gain}",
        "found: 2 rows are far off (lines 12, 31)",
    ]
    assert "Usable for the poses, tools and loads that were measured; a part of the error is unexplained." in lines


def test_a_lack_of_fit_is_told_with_its_place(given):
    """Fails if a misfit that no input explains ends without a word, or as a dependence on nothing."""
    (found,) = (
        line for line in last_lines(RunOutcome(with_diagnosis(given, MISFIT).results)) if line.startswith("left over: ")
    )
    assert found == (
        "left over: The error left is larger than measurement noise explains. It is largest where joint 2 is between "
        "20 and 45 deg: 0.2 mm against 0.1 mm elsewhere."
    )


def test_accuracy_goes_on_after_diagnosis(given):
    """Fails if the last lines stop at the study's own model, or repeat it with each cause's name."""
    results = with_diagnosis(given, BACKLASH).results
    lines = last_lines(RunOutcome(results))
    rows = [line.rsplit(None, 3) for line in lines[1 : 1 + len(results.tables["diagnose/accuracy.csv"])]]
    assert [row[0].strip() for row in rows if row[1] == "holdout"][-1] == "+ backlash of joint 2"
    assert [float(row[2]) for row in rows] == [round(v, 3) for v in results.tables["diagnose/accuracy.csv"]["mean_mm"]]


def test_errors_in_space_are_not_told_as_if_the_board_were_known(given):
    """Fails if a board printed too large, which no image shows, makes the tool certain to a tenth of what it is off by."""
    results = with_diagnosis(given).results
    by_images = {
        name: {**said, "new_poses_mm": None}
        for name, said in results.documents.items()
        if name.endswith("/summary.json")
    }
    for documents, told in (({}, False), (by_images, True)):  # lengths that were measured show the size
        of_space = Results({"identify/in_space.csv": in_space(0.2, 0.3, 0.9)}, documents)
        assert any("if the board is" in line for line in last_lines(RunOutcome(results | of_space))) == told


def test_nothing_found_is_said(given):
    """Fails if a diagnosis that found nothing looks like none."""
    assert "found: nothing that the model lacks" in last_lines(RunOutcome(with_diagnosis(given).results))
    assert not any(line.startswith("found") for line in last_lines(RunOutcome(given.results)))
    assert last_lines(RunOutcome(Results())) == []


def test_to_tell_what_came_out_no_drawing_is_loaded() -> None:
    """Fails if a run without a report waits for Matplotlib, which takes as long to load as a small robot to be fitted."""
    code = "import sys, calflow.reporting.terminal; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_the_lines_of_next_say_in_words_what_is_suspected():
    """Fails if an effect's id is printed for its name, or what is only suspected is said to be found."""
    verdict = MeasuringVerdict(
        status="measure", poses=30, fitted_poses=21, measure="rms", tolerance_mm=0.1, confidence=0.95, probability=0.4,
        error_mm=0.1, error_most_mm=0.2, noise_known=True, left_out=("gravity deflection of joint 2, 1.0 ± 0.2 mrad",),
        suspected=(
            Suspect(name="eccentricity of joint 3", kind="rival", cause="joint-eccentricity", joint=3, probability=0.31),
            Suspect(name="q2", kind="background", probability=0.12),
        ),
        untested=("joint-backlash", "thermal-growth"),
    )  # fmt: skip
    lines = next_lines(verdict)
    assert "found: nothing that the model lacks" in lines
    assert "suspected: gravity deflection of joint 2, 1.0 ± 0.2 mrad" in lines
    assert (
        "suspected, not proven (probability): eccentricity of joint 3 instead of what was found (0.31), a smooth error by q2 (0.12)"
        in lines
    )
    (untested,) = [line for line in lines if line.startswith("not tested")]
    assert untested.endswith(": backlash, thermal growth")
