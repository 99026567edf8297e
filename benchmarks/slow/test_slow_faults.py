"""Mistakes that are settled before causes are looked for, and more kinds of those that the tests make once."""

from __future__ import annotations

from dataclasses import replace

from calflow.calibration import identify
from calflow.deployment.in_space import is_no_better
from deployment.test_in_space import missed
from faults import test_flipped_image
from faults.test_setup_mistakes import assert_typed, loaded, swapped
from faults.test_stated_lens import STRAIGHT, TOO_LONG, seen, turned
from observations.test_camera import lens_stated, study
from test_studies import measured_data

CATALOGUE = ("joint-eccentricity", "base-compliance", "board-bent")


def test_a_wrong_lens_names_nothing_of_the_robot(tmp_path):
    """Fails if what a wrong lens leaves is called the robot's, the robot's cause is lost beside it, or the promise is too good.

    Nor may commands, which depend on no lens, be called wrong for it, once for each of its figures.
    """
    made = seen(24, True)
    kept = study(tmp_path, made, "ur5e", True, lens_stated(replace(STRAIGHT, focal=TOO_LONG.focal)))
    found = identify(kept.robot, kept.measurements(), ["geometry"], starts=1).diagnose(catalogue=CATALOGUE)
    causes = [(finding.status, finding.cause, finding.joint) for finding in found.findings]
    assert causes == [("data_fault", "stated-lens", None), ("named", "joint-eccentricity", 3)]
    assert [told.startswith("Correct the set-up: the stated lens") for told in found.warnings] == [True]
    rows = found.in_space
    assert missed(found, made, turned) < 1.6 * rows[-1].rms_mm
    assert not is_no_better(rows)


def test_payloads_of_each_others_name_are_settled_before_causes(tmp_path):
    """Fails if stiffness or masses are named where two payloads were taken for each other."""
    data = swapped(loaded(tmp_path))
    diagnosed = identify(data.robot, data, ["geometry", "joint-compliance"], starts=1).diagnose(
        catalogue=["payload-mass", "link-mass", "nonlinear-joint-stiffness"]
    )
    assert [finding.cause for finding in diagnosed.findings if finding.status in ("named", "one_of")] == []
    assert diagnosed.findings[0].cause == "payloads-exchanged"
    assert "settle this first" in diagnosed.findings[0].statement


def test_an_image_that_is_mirrored_is_told(tmp_path):
    """Fails if its rows are called outliers alone, or those of other images are with it, or single outliers are forgotten."""
    test_flipped_image.assert_told(tmp_path, ["px_x_mm"], "mirrored along x")


@measured_data
def test_a_length_of_the_ur10_is_told_however_wrong():
    """Fails if a fit from the typed figure ends far from the right one."""
    assert_typed("ur10-tmac", 0.0127 / 0.6127)
