"""Gross mistakes of readings and set-up that photographs of a board show; arm, camera and board are simulated by NumPy alone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from calflow.estimation.accuracy import distances, leading_errors
from calflow.estimation.registration import registered_model
from calflow.faults import examined
from calflow.files.problems import InputError
from calflow.measurements.measurements import Measurements
from calflow.robot.frames import angles
from observations.photographed import PANDA, UR5E, Arm, Photographs, board, frame, photographed
from observations.test_camera import study

POINTS = board(4, 3, 0.07)
Change = Callable[[pd.DataFrame], pd.DataFrame]


ARMS = {"camera in hand": (UR5E, "ur5e", True), "board in gripper": (PANDA, "franka-panda", False)}


@pytest.fixture(scope="module", params=ARMS)
def made(request) -> tuple[Photographs, str, bool]:
    """Thirty photographs by an arm with a camera in its hand, or by one with the board in its gripper."""
    arm, name, in_hand = ARMS[request.param]
    return photographed(arm, in_hand, 30, np.random.default_rng(8), points=POINTS), name, in_hand


def checked(folder, made, change: Change):
    """The faults of the photographs after a change of their rows."""
    seen, name, in_hand = made
    rows = change(seen.rows.copy())
    return examined(study(folder, Photographs(rows, *list(vars(seen).values())[1:]), name, in_hand).measurements())


def negated(rows: pd.DataFrame) -> pd.DataFrame:
    return rows.assign(q3_rad=-rows["q3_rad"])


def exchanged(rows: pd.DataFrame) -> pd.DataFrame:
    return rows.rename(columns={"q1_rad": "q2_rad", "q2_rad": "q1_rad"})


def of_other_readings(rows: pd.DataFrame) -> pd.DataFrame:
    """Each image beside the readings of the one before."""
    readings = rows.filter(regex=r"^q\d").columns
    before = rows.groupby("pose")[readings].first().shift(1).bfill()
    return rows.drop(columns=readings).join(before, on="pose")


@pytest.mark.parametrize("made", ["camera in hand"], indirect=True)
def test_a_sign_is_named_and_corrected(made, tmp_path):
    """Fails if images of a joint that counts the other way are fitted by another robot, or the fit breaks down on them."""
    data, faults = checked(tmp_path, made, negated)
    assert [(fault.cause, fault.joint, fault.action) for fault in faults] == [("joint-sign", 3, "corrected")]
    turned = data.table.groupby("pose")["q3"].first().to_numpy()
    assert turned == pytest.approx(made[0].rows.groupby("pose")["q3_rad"].first().to_numpy())


@pytest.mark.parametrize("made", ["camera in hand"], indirect=True)
def test_a_sign_is_named_by_the_images_of_one_of_two_targets(made, tmp_path):
    """Fails if only a single camera and target are searched: a robot metres long was fitted to several."""
    _, (fault,) = checked(
        tmp_path, made, lambda rows: negated(rows).assign(target=np.where(rows["pose"] > 12, "a", "b"))
    )
    assert (fault.cause, fault.joint, fault.action) == ("joint-sign", 3, "corrected")


@pytest.mark.parametrize("made", ["camera in hand"], indirect=True)
def test_a_target_that_is_held_out_alone_is_refused(made, tmp_path):
    """Fails if it ends in a traceback where the target with most images, whose place no fit can tell, has none to fit."""

    def of_two(rows: pd.DataFrame) -> pd.DataFrame:
        second = rows["pose"] > 12
        return rows.assign(target=np.where(second, "b", "a"), split=np.where(second, "holdout", "train"))

    with pytest.raises(InputError, match="from where any robot like this one has"):
        checked(tmp_path, made, of_two)


@pytest.mark.parametrize(
    ("made", "change"), [("board in gripper", exchanged), ("camera in hand", of_other_readings)], indirect=["made"]
)
def test_what_no_fit_can_settle_stops_the_run(made, tmp_path, change):
    """Fails if images that are no such robot's are fitted all the same, and it comes out metres long."""
    told = "columns q1 and q2 are exchanged" if change is exchanged else "beside its own joint readings"
    with pytest.raises(InputError, match=told):
        checked(tmp_path, made, change)


def test_an_arm_built_by_hand_is_no_mistake(tmp_path):
    """Fails if zeros degrees off count as a mistake."""
    loose = UR5E.worn(np.random.default_rng(1), turn=0.03, shift=2e-3)
    made = photographed(UR5E, True, 30, np.random.default_rng(2), points=POINTS, worn=loose)
    assert not checked(tmp_path, (made, "ur5e", True), lambda rows: rows)[1]


def test_a_board_that_was_moved_is_told(tmp_path):
    """Fails if nobody says that the board lies elsewhere from the middle on."""
    far = 0.02

    class Pushed(Arm):
        def links(self, q):
            there = super().links(q)
            there[-1] = np.where(np.arange(len(q))[:, None, None] < 15, there[-1], frame(None, (far, 0, 0)) @ there[-1])
            return there

    pushed = photographed(
        UR5E, True, 30, np.random.default_rng(3), points=POINTS, worn=Pushed(UR5E.figures, False, UR5E.limits)
    )
    named = pushed.rows.assign(image=[f"{pose}.png" for pose in pushed.rows["pose"]])
    (told,) = checked(tmp_path, (pushed, "ur5e", True), lambda rows: named)[1]
    assert (told.cause, told.action) == ("device-moved", "unsettled")
    assert "from line 182 (image 16.png) on" in told.statement
    assert "(column 'target')" in told.statement


@pytest.mark.parametrize("made", ["camera in hand"], indirect=True)
def test_a_stated_place_of_the_camera_is_used_and_one_that_is_far_off_is_told(made, tmp_path):
    """Fails if a lens that nobody stated is not found where the camera's place is, or a bracket's other drawing blames all else."""
    seen, name, in_hand = made
    turn = angles(Rotation.from_matrix(seen.camera[:3, :3])).tolist()

    def stated(off: float, sd: str = "") -> Measurements:
        origin = (1e3 * seen.camera[:3, 3] + [0, 0, off]).tolist()
        more = f"\ncamera_origin_mm = {origin}\ncamera_rotation_rad = {turn}\n{sd}"
        return study(tmp_path, seen, name, in_hand, more).measurements()

    assert examined(stated(0.0))[1] == ()
    model, here = registered_model(stated(0.0, "camera_origin_sd_mm = 5\ncamera_rotation_sd_deg = 1\n"))
    assert (
        np.nanmedian(distances(leading_errors(model, model.nominal, here))) < 10.0
    )  # 54 px with its place fitted, and put back
    with pytest.raises(InputError, match=r"the camera is not where .* camera_origin_mm = \[(29|30|31)\."):
        examined(stated(300.0))
