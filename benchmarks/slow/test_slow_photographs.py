"""What photographs tell of their devices, at length: one camera or plate alone, and each that errs beside one that does not."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calflow.calibration import Calibration, identify
from calflow.deployment.in_space import is_no_better
from calflow.deployment.usability import judgement
from calflow.reporting.sections.verdict import how_sure
from conftest import in_process
from deployment.test_in_space import missed
from effects.boards import BOARD, findings_of, of_plates
from effects.test_board_bent import assert_bent_and_stretched, bent
from effects.test_camera_slip import SLIP, assert_slipped, slipped
from effects.test_lens_growth import CENTRE, FOCAL, assert_grown, findings, warming
from effects.test_time_offset import ONLY, moving, rests_without_speeds
from observations.photographed import (
    BESIDE,
    IN_GRIPPER,
    IN_HAND,
    ON_TABLE,
    PANDA,
    SIZE,
    UR5E,
    Arm,
    Photographs,
    board,
    photographed,
)
from observations.test_camera import COARSE, COLUMNS, study
from observations.test_wrong_size import assert_not_doubted

RIVALS = '\n[stages.diagnose]\ncatalogue = ["joint-eccentricity", "periodic-joint-error", "target-slip"]\n'


class Eccentric(Arm):
    """An arm whose joint 3 errs once a turn, by too little to be told from its rivals in few images."""

    def links(self, q):
        return super().links(q + np.eye(6)[2] * 4e-4 * np.cos(q[:, [2]] + 0.4))


def eccentric(folder) -> Photographs:
    """A study of photographs by such an arm."""
    rng = np.random.default_rng(7)
    worn = Eccentric(UR5E.worn(rng).figures, False, UR5E.limits)
    made = photographed(UR5E, True, 18, rng, points=BOARD, worn=worn)
    study(folder, made, "ur5e", True, RIVALS)
    return made


def test_images_that_may_be_before_a_slip_are_judged_nowhere(tmp_path):
    """Fails if held-out images count, in space or on page one, of which no fitted one tells whether the camera had slipped."""
    made = slipped(4, camera=SLIP)
    held = made.rows["pose"].isin([3, 8, 12, 13, 14, 15, 18])
    rows = made.rows.assign(split=np.where(held, "holdout", "train"))
    kept = study(tmp_path, replace(made, rows=rows), "ur5e", True)
    found = identify(kept.robot, kept.measurements(), ["geometry"], starts=1).diagnose(catalogue=["camera-slip"])
    assert [finding.cause for finding in found.findings] == ["camera-slip"]
    assert [row.n for row in found.in_space if row.where == "holdout"] == [3, 3]
    said = dict(how_sure(found.material()))["Errors:"]
    assert "at the 3 held-out poses (4 more may be before a step, and are not judged)" in said


def test_the_lens_of_one_of_two_cameras_that_warms_up_is_found(tmp_path):
    """Fails if growth is missed where another camera is steady, or is of that one."""
    assert_grown(findings(tmp_path, warming(7, FOCAL, CENTRE, cameras=2)), ", camera camera2)")


@pytest.mark.parametrize("cameras", [1, 2])
def test_no_lens_of_steady_cameras_grows(cameras, tmp_path):
    """Fails if a worn arm's errors are taken for the growth of a lens, or of one of two, each of which has figures of its own."""
    assert findings(tmp_path, warming(8, 0.0, 0 * CENTRE, cameras=cameras)).empty


def test_a_plate_that_is_not_flat_and_longer_one_way_is_both(tmp_path):
    """Fails if a bow or a stretched print (`print-scale`) is missed beside the other, taken for another cause, or of another size:
    the plate's height, and how much longer the print is one way than the other.
    """
    assert_bent_and_stretched(findings_of(tmp_path, of_plates(11, bent(4e-4) * [1.0, 1.003, 1.0])))


def test_two_plates_that_are_as_stated_are_silent(tmp_path):
    """Fails if a worn arm's errors are taken for those of one of two plates, each of which has figures of its own."""
    assert findings_of(tmp_path, of_plates(12, BOARD, BOARD)).empty


def test_one_of_two_cameras_that_slipped_is_found(tmp_path):
    """Fails if the slip is missed beside a camera that stood still, called that one's or a device's step, put within an image or
    between images of either camera, or is of another size than the hidden one.
    """
    made = slipped(4, SLIP, images=40, of=slice(21, None, 2))
    rows = made.rows.assign(camera=np.where(made.rows["pose"] % 2, "left", "right"))
    assert_slipped(tmp_path, replace(made, rows=rows), "camera-slip", "the image of pose 20, camera right")


def test_an_image_at_the_right_moment_has_no_offset(tmp_path):
    """Fails if the errors of a worn arm are taken for an offset."""
    study(tmp_path, moving(4, 0.0), "ur5e", True, ONLY)
    assert in_process("run", tmp_path / "study.toml", "--out", tmp_path / "runs").code == 0
    assert pd.read_csv(tmp_path / "runs" / "diagnose" / "findings.csv").empty


def test_a_tool_that_nobody_knows_is_no_error_of_the_makers_robot(tmp_path):
    """Fails if a tool that may be anywhere, which both robots are taught alike, makes the calibrated one seem the nearer."""
    rng = np.random.default_rng(6)
    made = photographed(UR5E, True, 11, rng, worn=UR5E.worn(rng, 3e-4, 1.5e-4))
    kept, nearer = study(tmp_path, made, "ur5e", True), []
    for known in (True, False):
        robot = replace(kept.robot, markers={"tool": replace(kept.robot.markers["tool"], known=known)})
        nearer.append(identify(robot, kept.measurements(), ["geometry"], starts=1).in_space[-1].better)
    assert nearer[0] < 0.8
    assert nearer[1] == pytest.approx(nearer[0], abs=0.1)


def test_what_a_board_errs_by_is_carried_to_the_tool(tmp_path):
    """Fails if a plate bowed by 1 mm leaves the promise as it is for what is white or the arm's."""
    rng = np.random.default_rng(1)
    flat = board()
    bowed = flat + np.outer((flat[:, 0] / flat[:, 0].max() - 0.5) ** 2, [0, 0, 4e-3])
    arm = UR5E.worn(rng, 3e-4, 1.5e-4)
    made = photographed(UR5E, True, 20, rng, points=bowed, worn=arm)
    made.rows["px_z_mm"] = 0.0
    kept = study(tmp_path, made, "ur5e", True)
    found = identify(kept.robot, kept.measurements(), ["geometry"], starts=1)
    rows = found.in_space
    assert 0.8 < missed(found, made) / rows[-1].rms_mm < 1.3
    assert not is_no_better(rows)


def test_poses_that_part_rivals_show_the_target(tmp_path):
    """Fails if there are no poses to measure next, or the camera sees less than the whole board at some, or from behind."""
    made = eccentric(tmp_path)
    assert in_process("run", tmp_path / "study.toml", "--out", tmp_path / "runs").code == 0
    poses = pd.read_csv(tmp_path / "runs" / "diagnose" / "next_poses.csv")
    assert (poses["separation_after_sd"] > poses["separation_before_sd"]).all()
    readings = np.radians(poses.filter(regex=r"^q\d_deg").to_numpy())
    assert len(readings) > 5
    for seen in np.linalg.inv(made.arm.links(readings)[-1] @ IN_HAND) @ ON_TABLE:
        there = BOARD @ seen[:3, :3].T + seen[:3, 3]
        image = made.lens.image(there)
        assert (there[:, 2] > 0).all()
        assert ((image > 0) & (image < SIZE)).all()
        assert seen[2, 2] < 0  # from its front, where its z axis leads to the camera


def test_the_tools_unknown_point_is_no_error_where_next_poses_are_asked_for(tmp_path):
    """Fails if a tool whose point nobody knows, and that is to be taught, counts as an error of the arm."""
    eccentric(tmp_path)
    answer = in_process("next", tmp_path / "study.toml", "--tolerance-mm", "1", "--out", tmp_path / "next")
    assert answer.code == 0, answer.err
    verdict = json.loads((tmp_path / "next" / "verdict.json").read_text(encoding="utf-8"))
    assert 0.02 < verdict["error_mm"] < 1.0


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_lengths_that_err_each_in_its_own_way_do_not_contradict_a_board(seed, tmp_path):
    """Fails if a board that is as stated is doubted since an arm was put together with lengths 8 mm off."""
    assert_not_doubted(tmp_path, seed)


def test_a_tool_that_is_no_better_is_said(tmp_path):
    """Fails if few images from nearly one place, which fit to parts of a pixel, pass for a calibrated tool on page one or in px."""
    rng = np.random.default_rng(3)
    made = photographed(PANDA, False, 2, rng, points=COARSE, worn=PANDA.worn(rng, 2e-4, 1e-4))
    near = made.rows[made.rows["pose"] == 1]
    q = near.filter(like="q").iloc[0].to_numpy() + 0.05 * rng.standard_normal((14, 7))
    rows = []
    for k, one in enumerate(q, start=1):
        seen = np.linalg.inv(BESIDE) @ made.arm.links(one[None])[-1][0] @ IN_GRIPPER
        points = 1e-3 * near[[f"{name}_mm" for name in COLUMNS]].to_numpy() @ seen[:3, :3].T + seen[:3, 3]
        image = made.lens.image(points) + 0.2 * rng.standard_normal((len(points), 2))
        rows.append(
            near.assign(pose=k, u_px=image[:, 0], v_px=image[:, 1], **{f"q{i + 1}_rad": one[i] for i in range(7)})
        )
    narrow = type(made)(pd.concat(rows), made.arm, made.camera, made.target, made.lens)
    kept = study(tmp_path, narrow, "franka-panda", False)
    found = identify(kept.robot, kept.measurements(), ["geometry"], starts=1)
    assert next(row.mean for row in found.accuracy if row.split == "holdout" and row.model != "nominal") < 0.5
    assert is_no_better(found.in_space)
    assert "see what to do next" in judgement(found)
    assert "may be no nearer than the maker's robot" in found.validate(kept.measurements()).summary.notes[-1]


def rolling(seed: int, first: float, last: float) -> Photographs:
    """Photographs of which the first row was taken so much later [s] than the joints were read, the last row so much."""
    same = ["pose", "px_x_mm", "px_y_mm"]
    begin, end = (moving(seed, late) for late in (first, last))
    both = begin.rows.merge(end.rows[[*same, "u_px", "v_px"]], on=same, suffixes=("", "_end"))
    share = both["v_px"] / (SIZE[1] - both["v_px_end"] + both["v_px"])  # of the time at which its own row was exposed
    for name in ("u_px", "v_px"):
        both[name] += share * (both[f"{name}_end"] - both[name])
    return replace(begin, rows=both.drop(columns=["u_px_end", "v_px_end"]))


def test_a_rolling_shutter_is_told_by_its_rows(tmp_path):
    """Fails if images that were exposed row by row about the reading are taken for a cause of camera, board or joints."""
    study(tmp_path, rolling(3, -10e-3, 14e-3), "ur5e", True, ONLY)
    assert in_process("run", tmp_path / "study.toml", "--out", tmp_path / "runs").code == 0
    found = pd.read_csv(tmp_path / "runs" / "diagnose" / "findings.csv").set_index("cause")
    assert [*found.index] == ["time-offset"]
    assert found.loc["time-offset", "detail"] == "an image's rows one after the other"
    line = 24e-3 / SIZE[1]
    assert found.loc["time-offset", "estimate"] == pytest.approx(line, abs=4 * found.loc["time-offset", "sd"])
    rests_without_speeds(Calibration.load(tmp_path / "runs"))
