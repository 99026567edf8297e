"""In space: what studies by cameras say in millimetres, held against arms whose errors are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.calibration import identify
from calflow.deployment.in_space import ALONE, RANGES, _taught, _untaught, is_no_better, space_words
from calflow.design.candidates import candidates
from calflow.observations.camera import LEAST_SQUARES, Camera, Eye
from calflow.observations.hand_eye_methods import METHODS
from calflow.robot.frames import placement_matrix
from observations.photographed import PANDA, UR5E, photographed
from observations.test_camera import COARSE, COLUMNS, seen_from_nowhere, study


@pytest.mark.parametrize(("arm", "in_hand"), [(UR5E, True), (PANDA, False)])
def test_images_tell_where_what_moves_really_is(arm, in_hand):
    """Fails if a camera, or a target, that is some millimetres aside shows otherwise in space, whatever it is in pixels."""
    made = photographed(arm, in_hand, 5, np.random.default_rng(2), noise=0.0, points=COARSE, worn=arm)
    on = {"camera_on": "tool", "target_on": "world"} if in_hand else {}
    known = {"focal": made.lens.focal, "centre": made.lens.centre, "distortion": made.lens.bend}
    camera = seen_from_nowhere(made, arm, on | known)
    rows = made.rows.rename(columns={f"{name}_mm": name for name in COLUMNS} | {"u_px": "u", "v_px": "v"}).assign(
        repeat=1
    )
    rows[COLUMNS] /= 1e3
    hand = arm.links(rows.filter(like="q").to_numpy())[-1]
    off = np.array([0.6e-3, -0.3e-3, 0.8e-3])
    (eye,) = camera.cameras
    place = np.array(eye.place)
    place[:3] += placement_matrix(place)[:3, :3] @ off
    aside = Camera(camera.series, (Eye("", tuple(place), eye.lens),), camera.targets)
    error = np.array([shown_error(aside, hand[i], rows.iloc[[i]], in_hand) for i in range(len(rows))])
    found = aside.in_space(np.zeros(len(aside.declared)), lambda link: hand, rows, error)
    assert len(found) == rows["pose"].nunique()
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), np.linalg.norm(off), rtol=0.02)


def shown_error(camera: Camera, hand: np.ndarray, row, in_hand: bool) -> np.ndarray:
    """Predicted minus seen of one row (2,), in plain numpy."""
    eye, board = placement_matrix(camera.cameras[0].place), placement_matrix(camera.targets[0].place)
    seen = np.linalg.inv(hand @ eye) @ board if in_hand else np.linalg.inv(eye) @ hand @ board
    point = seen @ np.append(row[COLUMNS].to_numpy(float)[0], 1.0)
    return camera.lens(0).image(point[None, :3])[0] - row[["u", "v"]].to_numpy(float)[0]


def missed(found, made, turned=lambda q: q) -> float:
    """What a calibrated UR5e errs by over the joints' ranges [mm, rms], base and tool taught; turned: its joints, by readings."""
    readings, conditions = candidates(found.model, 200, "", "tool", None, np.random.default_rng(2))
    tool = np.append(found.model.robot.markers["tool"].point, 1.0)
    nominal = UR5E.links(readings)[-1]
    taught = _taught((nominal @ tool)[:, :3], nominal[:, :3, :3])
    truth = (made.arm.links(turned(readings))[-1] @ tool)[:, :3]
    off = _untaught((found.model.point(found.estimate, conditions) - truth)[:, :, None], taught)
    return 1e3 * float(np.sqrt((off**2).sum(axis=1).mean()))


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    """Photographs by a camera in the hand, their study, and what is identified of a tool that is known."""
    made = photographed(UR5E, True, 30, np.random.default_rng(1), points=COARSE)
    kept = study(tmp_path_factory.mktemp("in_hand"), made, "ur5e", True)
    return made, kept, identify(kept.robot, kept.measurements(), ["geometry"], starts=1)


def test_what_is_promised_holds_and_hand_eye_alone_is_told(calibrated):
    """Fails if the tool's promise over the joints' ranges is not what the arm errs by there, base and tool taught."""
    made, _, found = calibrated
    rows = found.in_space
    assert 0.5 < missed(found, made) / rows[-1].rms_mm < 1.6
    held_out = {row.model: row.mean_mm for row in rows if row.where == "holdout"}
    assert held_out["geometry"] < 0.5 * held_out[ALONE]
    by_method = [row for row in rows if row.method and row.where == "holdout"]
    assert [row.method for row in by_method] == [*METHODS, LEAST_SQUARES]
    fitted = [row.rms_px for row in rows if row.method and row.where == "train"]
    assert fitted[-1] < min(fitted[:-1])  # it is the fit of all points
    geometry = next(row for row in rows if row.model == "geometry" and row.where == "holdout")
    for row in by_method:  # of the same robot as its maker says, with a better lens than is fitted to that one
        assert 2 * geometry.mean_mm < row.mean_mm < held_out[ALONE]
        assert row.rms_px > 5 * geometry.rms_px
    assert 0.2 * np.sqrt(2) * 0.9 < geometry.rms_px < 0.2 * np.sqrt(2) * 1.5
    assert not is_no_better(rows)
    assert len(space_words(rows)) == 2
    untold = [
        row if row.where == RANGES else replace(row, n=0, mean_mm=float("nan"), max_mm=float("nan")) for row in rows
    ]
    assert "nan" not in " ".join(space_words(untold))  # as of images that show points of one line alone


def test_a_tool_that_nobody_knows_takes_nothing_off_the_promise(calibrated):
    """Fails if a tool's point, which no image tells, counts as an error of the robot once it is taught."""
    _, kept, known = calibrated
    robot = replace(kept.robot, markers={"tool": replace(kept.robot.markers["tool"], known=False)})
    unknown = identify(robot, kept.measurements(), ["geometry"], starts=1)
    assert not is_no_better(unknown.in_space)
    promised = [
        next(row.rms_mm for row in found.in_space if row.where == RANGES and row.model != ALONE)
        for found in (known, unknown)
    ]
    assert promised[1] == pytest.approx(promised[0], rel=0.1)
