"""Camera: images of a target against a pinhole written apart, where it begins, and whole robots found by photographs alone."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import calflow as cf
from calflow.deployment.check_poses import choose_check_poses
from calflow.estimation.fit import Fit
from calflow.estimation.identification import fit_effects
from calflow.files.problems import InputError
from calflow.importing.target_detection import detect_targets
from calflow.measurements.measurements import Measurements
from calflow.measurements.series import Series
from calflow.observations.camera import Camera
from calflow.observations.hand_eye import focal_length, sighting
from calflow.observations.hand_eye_methods import METHODS, camera_by
from calflow.observations.lens import Lens
from calflow.robot.frames import placement_matrix
from calflow.robot.robot import Robot
from calflow.study import load_study
from calflow.templates import library_file
from observations.graph import through_json
from observations.photographed import PANDA, SIZE, UR5E, Arm, Optics, Photographs, board, frame, photographed

COARSE = board(4, 3, 0.07)  # as large as the usual one, of a quarter of its points
COLUMNS = ["px_x", "px_y", "px_z"]
SETTINGS = """
kind = "camera"

[measurements.settings]
camera_on = "{camera}"
target_on = "{target}"
size_px = [1280, 960]
"""


def study(folder, made: Photographs, robot: str, in_hand: bool, more: str = ""):
    """A study of photographs."""
    made.rows.to_csv(folder / "measurements.csv", index=False)
    said = library_file(robot).replace(
        "known = false                   # false: estimated from the measurements; of images", "known = true  #"
    )
    (folder / "robot.toml").write_text(said, encoding="utf-8")
    on = {"camera": "tool", "target": "world"} if in_hand else {"camera": "world", "target": "tool"}
    text = 'name = "seen"\nrobot = "robot.toml"\nworkflow = "diagnose"\nseed = 1\neffects = ["geometry"]\n\n'
    text += f'[stages.identify]\nstarts = 1\n\n[measurements]\nfile = "measurements.csv"{SETTINGS.format(**on)}{more}'
    (folder / "study.toml").write_text(text, encoding="utf-8")
    return load_study(folder / "study.toml")


def lens_stated(lens: Optics) -> str:
    """A lens as a study states it."""
    return f"focal_px = {[*lens.focal]}\ncentre_px = {[*lens.centre]}\ndistortion = {[*lens.bend]}\n"


def test_a_place_in_the_world_is_near_beside_a_base_that_nothing_places():
    """Fails if it is taken for exact, which a zero of joint 1 turns, or what is on the arm or has a deviation for near."""
    places = {f"{what}_{of}": (0.1, 0.2, 0.3) for what in ("camera", "target") for of in ("origin", "rotation")}
    stated = {**places, "target_size": (0.2, 0.1), "focal": (1e3, 1e3), "focal_sd": 0.0, "centre": (500.0, 400.0), "centre_sd": 0.0,
              "distortion": (), "distortion_sd": 0.0}  # fmt: skip
    for sd, of_origin in ((0.0, 0.02), (1e-3, 1e-3)):
        camera = Camera.planned(Series.of("", "camera", {**stated, "camera_origin_sd": sd}))
        assert len(camera.declared) == (3 if sd else 0)
        near = camera.beside_base().declared
        assert [p.prior_sd for p in near] == [of_origin] * 3 + [0.02] * 3
        assert all(p.meaning.startswith("place of the camera") for p in near)


def test_a_series_called_as_a_marker_is_refused(tmp_path):
    """Fails if the place of a series' camera and that of a marker may be called the same, of which one would be lost."""
    made = photographed(UR5E, True, 6, np.random.default_rng(1))
    study(tmp_path, made, "ur5e", True)
    path = tmp_path / "study.toml"
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("[measurements]", '[measurements]\nname = "tool"'), encoding="utf-8")
    with pytest.raises(InputError, match=r"measurements\.name: .*another name than a marker"):
        load_study(path).measurements()


def test_every_start_sees_the_board(tmp_path):
    """Fails if a fit starts where the board is behind the camera, or the lens turned inside out: none finds back from there."""
    made = photographed(UR5E, True, 20, np.random.default_rng(5), points=COARSE)
    found = fit_effects(study(tmp_path, made, "ur5e", True).measurements(), ["geometry"], starts=8)
    assert found.agreeing == 8


def test_a_lens_shows_points_as_brown_says_and_finds_the_way_back():
    """Fails if a coefficient is in another place than OpenCV's, or the way back does not end where it began."""
    optics = Optics(bend=(-0.2, 0.1, 2e-3, -1e-3, 0.02))
    lens = Lens("brown", optics.focal, optics.centre, optics.bend)
    points = np.random.default_rng(1).uniform((-0.4, -0.3, 0.8), (0.4, 0.3, 1.2), (50, 3))
    image = lens.image(points)
    np.testing.assert_allclose(image, optics.image(points), atol=1e-9)
    np.testing.assert_allclose(lens.rays(image), points[:, :2] / points[:, 2:], atol=1e-9)


@pytest.mark.parametrize("model", ["brown", "fisheye"])
def test_a_lens_agrees_with_opencv(model):
    """Fails if either model bends an image otherwise than OpenCV does."""
    cv2 = pytest.importorskip("cv2")
    points = np.random.default_rng(2).uniform((-0.7, -0.6, 0.8), (0.7, 0.6, 1.2), (40, 3))
    bend = (-0.2, 0.05, 1e-3, -2e-3, 0.01) if model == "brown" else (-0.03, 0.01, -0.004, 0.001)
    lens = Lens(model, (900.0, 910.0), (640.0, 470.0), bend)
    matrix = np.array([[900.0, 0, 640], [0, 910, 470], [0, 0, 1]])
    project = cv2.projectPoints if model == "brown" else cv2.fisheye.projectPoints
    there = project(points[:, None], np.zeros((3, 1)), np.zeros((3, 1)), matrix, np.array(bend))[0][:, 0]
    np.testing.assert_allclose(lens.image(points), there, atol=1e-6)


def test_a_small_board_has_two_places():
    """Fails if the place that a board really has is not among the two that explain its image, or the mirrored one is not found."""
    points = board(5, 4, 0.01)
    seen = frame(Rotation.from_euler("XYZ", (0.25, -0.2, 0.4)), (0.03, -0.02, 0.9))
    there = points @ seen[:3, :3].T + seen[:3, 3]
    found = sighting(points, there[:, :2] / there[:, 2:])
    np.testing.assert_allclose(found[0], seen, atol=1e-6)
    turned = Rotation.from_matrix(found[1][:3, :3].T @ seen[:3, :3]).magnitude()
    assert 0.3 < turned < 1.0


def test_a_body_of_points_has_one_place():
    """Fails if a target that is no plane is taken for one."""
    points = np.random.default_rng(3).uniform(-0.1, 0.1, (12, 3))
    seen = frame(Rotation.from_euler("XYZ", (0.5, 0.3, 1.0)), (0.05, 0.02, 0.8))
    there = points @ seen[:3, :3].T + seen[:3, 3]
    (only,) = sighting(points, there[:, :2] / there[:, 2:])
    np.testing.assert_allclose(only, seen, atol=1e-8)


def test_homographies_tell_the_focal_length():
    """Fails if Zhang's equations are wrong, or if boards that all face the camera are believed."""
    points = board()
    rng = np.random.default_rng(4)

    def view(tilt: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        seen = frame(Rotation.from_euler("XYZ", tilt), (-0.1, -0.1, 0.6))
        there = points @ seen[:3, :3].T + seen[:3, 3]
        return points[:, :2], 800 * there[:, :2] / there[:, 2:]

    assert focal_length([view(rng.uniform(-0.6, 0.6, 3)) for _ in range(6)], 500.0) == pytest.approx(800, rel=1e-6)
    assert focal_length([view(np.zeros(3)) for _ in range(3)], 500.0) == 500.0


def seen_from_nowhere(made: Photographs, arm: Arm, settings: dict) -> Camera:
    """The camera of photographs by an arm as its maker says, found from nothing."""
    rows = made.rows.rename(columns={f"{name}_mm": name for name in COLUMNS} | {"u_px": "u", "v_px": "v"})
    rows[COLUMNS] /= 1e3
    q = rows.filter(like="q").to_numpy()
    frames = arm.links(q)
    begun = Camera.of(Series.of("", "camera", settings), rows.assign(repeat=1))
    zero = np.zeros((len(rows), 3))
    return begun.registered(zero, lambda link: frames[-1], rows.assign(repeat=1))


@pytest.mark.parametrize(("arm", "in_hand"), [(UR5E, True), (PANDA, False)])
def test_camera_board_and_lens_are_found_from_nothing(arm, in_hand):
    """Fails if closed form and robust fit do not end where camera, board and lens are, with a robot as its maker says."""
    made = photographed(arm, in_hand, 15, np.random.default_rng(5), worn=arm)
    on = {"camera_on": "tool", "target_on": "world"} if in_hand else {}
    found = seen_from_nowhere(made, arm, on | {"size": (1280.0, 960.0)})
    for place, truth in ((found.cameras[0].place, made.camera), (found.targets[0].place, made.target)):
        apart = np.linalg.inv(truth) @ placement_matrix(place)
        assert np.linalg.norm(apart[:3, 3]) < 2e-3
        assert Rotation.from_matrix(apart[:3, :3]).magnitude() < 5e-3
    np.testing.assert_allclose(found.cameras[0].lens[:4], [*made.lens.focal, *made.lens.centre], atol=8)
    assert found.targets[0].front == -1.0
    assert through_json(found) == found


def test_boards_turned_upside_down_do_not_lead_astray():
    """Fails if a few images whose points are counted from the other corner move the place of the camera."""
    made = photographed(UR5E, True, 18, np.random.default_rng(6), worn=UR5E)
    rows = made.rows.copy()
    for pose in (3, 8, 13):
        own = rows["pose"] == pose
        rows.loc[own, ["u_px", "v_px"]] = rows.loc[own, ["u_px", "v_px"]].to_numpy()[::-1]
    known = {
        "camera_on": "tool",
        "target_on": "world",
        "focal": made.lens.focal,
        "centre": made.lens.centre,
        "distortion": made.lens.bend,
    }
    found = seen_from_nowhere(Photographs(rows, UR5E, made.camera, made.target, made.lens), UR5E, known)
    apart = np.linalg.inv(made.camera) @ placement_matrix(found.cameras[0].place)
    assert np.linalg.norm(apart[:3, 3]) < 2e-3


@pytest.mark.skipif("CALFLOW_DATA" not in os.environ, reason="CALFLOW_DATA names no folder of measured data")
@pytest.mark.parametrize(
    ("folder", "on", "focal", "centre", "stated", "free"),
    [
        ("charuco", {}, (1352.02747, 1356.14287), (789.67065, 627.2995), 4.0, 1.6),
        ("10x10", {"camera_on": "tool", "target_on": "world"}, (550.0, 550.0), (320.0, 240.0), 3.5, 2.4),
    ],
)  # fmt: skip
def test_photographs_place_a_real_camera(folder, on, focal, centre, stated, free, tmp_path):
    """Fails if real photographs of a robot that is as it says do not place camera and board, no better lens is found, or the best
    of the five closed forms, refined by the points with the lens that was stated, shows images held out better than that does.
    """
    pytest.importorskip("cv2")
    from importing.test_target_detection import PHOTOGRAPHED, written

    place = Path(os.environ["CALFLOW_DATA"]) / "hand-eye" / folder
    found = detect_targets(
        [one for one in place.iterdir() if one.suffix != ".csv"], written(tmp_path, **PHOTOGRAPHED[folder])
    )
    rows = found.table.rename(columns={f"{name}_mm": name for name in COLUMNS} | {"u_px": "u", "v_px": "v"}).assign(
        repeat=1
    )
    rows[COLUMNS] /= 1e3
    flange = pd.read_csv(place / "flange_poses.csv").set_index("image").loc[rows["image"]]
    hand = np.tile(np.eye(4), (len(rows), 1, 1))
    hand[:, :3, :3] = Rotation.from_quat(flange[["qx", "qy", "qz", "qw"]].to_numpy()).as_matrix()
    hand[:, :3, 3] = flange[["x_m", "y_m", "z_m"]]
    held = rows["image"].str.extract(r"(\d+)", expand=False).astype(int).to_numpy() % 3 == 2
    known = {"focal": focal, "centre": centre, "distortion": (0.0,) * 5}
    points, image = rows[COLUMNS].to_numpy(), rows[["u", "v"]].to_numpy()
    camera_matrix = np.array([[focal[0], 0, centre[0]], [0, focal[1], centre[1]], [0, 0, 1]])

    def off_by(places, which):
        """Distances of the points [px] with camera and board at (2, 6) shifts and turns, the lens as stated."""
        eye, board_at = (frame(Rotation.from_rotvec(place[3:]), place[:3]) for place in np.reshape(places, (2, 6)))
        seen = np.linalg.inv(hand @ eye) @ board_at if on else np.linalg.inv(eye) @ hand @ board_at
        there = np.einsum("nij,nj->ni", seen[:, :3, :3], points) + seen[:, :3, 3]
        return ((there / there[:, 2:]) @ camera_matrix.T)[which, :2] - image[which]

    first = [np.flatnonzero(rows["image"] == name)[0] for name in rows["image"][~held].unique()]
    sighted = np.array([sighted_by_opencv(rows, k, points, image, camera_matrix) for k in first])
    moved = hand[first] if on else np.linalg.inv(hand[first])
    refined = []
    for method in METHODS:
        eye = camera_by(method, moved, sighted)
        begun = np.concatenate([as_vector(eye), as_vector(moved[0] @ eye @ sighted[0])])
        best = least_squares(lambda places: off_by(places, ~held).ravel(), begun, x_scale="jac").x
        refined.append(np.sqrt((off_by(best, held) ** 2).sum(axis=1).mean()))
    assert free < min(refined)
    for lens, most in ((known, stated), ({"size": (2 * centre[0], 2 * centre[1])}, free)):
        begun = Camera.of(Series.of("", "camera", on | lens), rows[~held])
        camera = begun.registered(np.zeros((0, 3)), lambda link: hand[~held], rows[~held])
        eye, board_at = placement_matrix(camera.cameras[0].place), placement_matrix(camera.targets[0].place)
        seen = np.linalg.inv(hand @ eye) @ board_at if on else np.linalg.inv(eye) @ hand @ board_at
        there = np.einsum("nij,nj->ni", seen[:, :3, :3], rows[COLUMNS].to_numpy()) + seen[:, :3, 3]
        off = np.linalg.norm(camera.lens(0).image(there) - rows[["u", "v"]].to_numpy(), axis=1)
        assert np.sqrt((off[held] ** 2).mean()) < most


def as_vector(placed: np.ndarray) -> np.ndarray:
    """A frame (4, 4) as shift and turn (6,)."""
    return np.concatenate([placed[:3, 3], Rotation.from_matrix(placed[:3, :3]).as_rotvec()])


def sighted_by_opencv(rows, k, points, image, camera_matrix):
    """The board (4, 4) in the camera's frame, by the image that row k is of."""
    cv2 = pytest.importorskip("cv2")
    of = (rows["image"] == rows["image"].iloc[k]).to_numpy()
    _, turn, shift = cv2.solvePnP(points[of], image[of], camera_matrix, None)
    return frame(Rotation.from_rotvec(turn.ravel()), shift.ravel())


def errors_in_sd(fit: Fit, made: Photographs, arm: Arm) -> np.ndarray:
    """What estimates of lens and geometry miss, in standard deviations; without figures that stand for several."""
    wrong = made.arm.figures - arm.figures
    lens = dict(
        zip(
            ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"),
            (*made.lens.focal, *made.lens.centre, *made.lens.bend),
            strict=True,
        )
    )
    parallel = arm is UR5E
    missed = []
    for k, parameter in enumerate(fit.model.parameters):
        if parameter.effect == "camera" and parameter.symbol in lens:
            truth = lens[parameter.symbol] - parameter.figure
        elif parameter.symbol in (names := ["alpha", "a", "theta", "d"]) and not (
            parallel and parameter.name in ("joint4.d", "joint3.alpha")
        ):
            truth = wrong[parameter.joint - 1, names.index(parameter.symbol)]
        else:
            continue
        missed.append((fit.estimate[k] - truth) / np.sqrt(fit.covariance[k, k]))
    return np.array(missed)


def test_photographs_alone_calibrate_an_arm(tmp_path):
    """Fails if geometry and lens are not found to what their standard deviations promise, or the noise is another."""
    arm, robot, in_hand = PANDA, "franka-panda", False  # benchmarks/cameras.py has others
    made = photographed(arm, in_hand, 40, np.random.default_rng(1), points=COARSE)
    data = study(tmp_path, made, robot, in_hand).measurements()
    found = fit_effects(data, ["geometry"], starts=1)
    missed = errors_in_sd(found.fit, made, arm)
    assert len(missed) > 20
    assert np.mean(np.abs(missed) < 1.96) > 0.8
    assert np.sqrt(np.mean(missed**2)) < 1.6
    held_out = next(row for row in reversed(found.steps) if row.split == "holdout")
    assert held_out.unit == "px"
    assert held_out.rms == pytest.approx(0.2 * np.sqrt(2), rel=0.2)
    assert found.noise.sigma[0] == pytest.approx(0.2, rel=0.15)


def test_a_known_tool_is_where_it_is_said_to_be(tmp_path):
    """Fails if a tool that no image shows is off by centimetres for all anyone knows, or check poses are chosen by no positions.

    Nor may an image's error be the mean of its points' and be compared with the root mean square that is promised.
    """
    rng = np.random.default_rng(2)
    made = photographed(UR5E, True, 24, rng, points=COARSE)
    data = study(tmp_path, made, "ur5e", True).measurements()
    found = cf.identify(data.robot, data, ["geometry"], starts=1)
    assert [row.fixed for row in found.parameters.rows if row.part == "tool"] == [True] * 3
    told = found.predict(data.joints[:1])
    assert (told.sd < 5e-3).all()
    assert "base and tool are taught" in told.notes[1]
    assert set(told.notes[:2]) <= set(found.compensate(told.position).notes)
    turn = found.model.rotation(found.estimate, data.conditions[:, :1])[0]
    pose = np.block([[turn, told.position.T], [np.zeros((1, 3)), np.ones((1, 1))]])
    of_tool = [note for note in found.compensate(pose, start=data.joints[0]).notes if "tool" in note]
    assert of_tool == [told.notes[1]]  # once, and not that orientations should be measured
    with pytest.raises(InputError, match="positions alone"):
        choose_check_poses(found, data)
    further = photographed(UR5E, True, 24, rng, points=board(), worn=made.arm)
    (tmp_path / "new").mkdir()
    judged = found.validate(study(tmp_path / "new", further, "ur5e", True).measurements())
    swapped = replace(further, rows=further.rows.rename(columns={"u_px": "v_px", "v_px": "u_px"}))
    (tmp_path / "swapped").mkdir()
    other = found.validate(study(tmp_path / "swapped", swapped, "ur5e", True).measurements())
    asked = ["are these rows of the robot" in " ".join(one.summary.notes) for one in (judged, other)]
    assert asked == [False, True]
    of_points = np.sqrt(np.mean([point.calibrated**2 for point in judged.poses]))
    assert judged.judged.rms == pytest.approx(of_points, rel=0.02)
    assert of_points > 1.1 * judged.judged.mean


def test_what_an_image_errs_by_as_a_whole_is_counted_once(tmp_path):
    """Fails if points of one image count as independent although the arm misses each pose: intervals are then too small."""

    class Loose(Arm):
        def links(self, q):
            return super().links(q + 3e-4 * np.random.default_rng(9).normal(size=q.shape))

    rng = np.random.default_rng(5)
    worn = UR5E.worn(rng)
    made = photographed(UR5E, True, 50, rng, points=COARSE, worn=Loose(worn.figures, False, UR5E.limits))
    data = study(tmp_path, made, "ur5e", True).measurements()
    found = fit_effects(data, ["geometry"], starts=1)
    assert found.noise.intraclass > 0.6
    assert np.sqrt(np.mean(errors_in_sd(found.fit, made, UR5E) ** 2)) < 1.6


def test_repeats_are_images_of_one_pose(tmp_path):
    """Fails if points of one image count as repeats of each other, or a second image of a pose does not repeat the first."""
    robot = Robot.from_toml(write(tmp_path / "robot.toml", library_file("ur5e")))
    one = pd.DataFrame({"pose": 1, **{f"q{i}_rad": 0.1 * i for i in range(1, 7)}, "u_px": [1.0, 2, 1.1, 2.1],
                        "v_px": [3.0, 4, 3.1, 4.1],
                        "px_x_mm": [0, 30, 0, 30], "px_y_mm": 0, "px_z_mm": 0})  # fmt: skip
    one.to_csv(tmp_path / "rows.csv", index=False)
    data = Measurements.from_csv(tmp_path / "rows.csv", robot, reports=Camera.columns)
    assert data.table["repeat"].tolist() == [1, 1, 2, 2]


def write(path, text: str):
    """Write a file and return its path."""
    path.write_text(text, encoding="utf-8")
    return path


def test_what_cannot_be_is_said(tmp_path):
    """Fails if a camera that moves with its target, a missing point's column or coefficients of another lens pass unsaid."""
    made = photographed(UR5E, True, 3, np.random.default_rng(7), worn=UR5E)
    for change, words in (
        (('target_on = "world"', 'target_on = "tool"'), "camera_on and target_on: both are 'tool'"),
        (("size_px", 'lens = "fisheye"\ndistortion = [0, 0, 0, 0, 0]\nsize_px'), "expected at most k1, k2, k3, k4"),
    ):
        study(tmp_path, made, "ur5e", True)
        path = tmp_path / "study.toml"
        path.write_text(path.read_text(encoding="utf-8").replace(*change), encoding="utf-8")
        with pytest.raises(InputError, match=words):
            load_study(path).measurements()
    kept = Photographs(made.rows.drop(columns="px_z_mm"), UR5E, made.camera, made.target, made.lens)
    with pytest.raises(InputError, match="missing column: expected px_z_m"):
        study(tmp_path, kept, "ur5e", True).measurements()


def test_planned_poses_show_the_whole_board(tmp_path):
    """Fails if poses are proposed at which the camera would not see all of the board, or from behind, or out of focus."""
    from calflow.design.candidates import candidates
    from calflow.model import build

    robot = Robot.from_toml(write(tmp_path / "robot.toml", library_file("ur5e")))
    said = {"camera_on": "tool", "target_on": "world", "size": (1280.0, 960.0), "focal": (1150.0, 1150.0), "centre": (640.0, 480.0),
            "camera_origin": (0.03, -0.07, 0.06), "camera_rotation": (0.0, 0.0, 1.6), "target_origin": (-0.45, 0.12, 0.02),
            "target_rotation": (np.pi, 0.0, 0.5), "target_size": (0.21, 0.15), "focus": (0.25, 0.7)}  # fmt: skip
    camera = Camera.planned(Series.of("", "camera", said))
    model = build(robot, ("geometry",), (), (camera,))
    readings, _ = candidates(model, 12, "", "tool", None, np.random.default_rng(1), camera)
    hand = UR5E.links(readings)[-1] @ placement_matrix((0.03, -0.07, 0.06, 0, 0, 1.6))
    seen = np.linalg.inv(hand) @ placement_matrix((-0.45, 0.12, 0.02, np.pi, 0, 0.5))
    assert (hand[:, 2, 3] > 0.1).all()  # above the table
    corners = np.array([(0, 0, 0), (0.21, 0, 0), (0, 0.15, 0), (0.21, 0.15, 0)])
    for pose in seen:
        there = corners @ pose[:3, :3].T + pose[:3, 3]
        assert ((there[:, 2] > 0.25) & (there[:, 2] < 0.7)).all()
        image = 1150 * there[:, :2] / there[:, 2:] + (640, 480)
        assert ((image > 0) & (image < SIZE)).all()


def test_where_no_pose_shows_the_target_it_is_said_why(tmp_path):
    """Fails if a region that nobody stated is asked about, or a figure that cannot be is found by drawing poses in vain."""
    from calflow.design.candidates import candidates
    from calflow.model import build

    robot = Robot.from_toml(write(tmp_path / "robot.toml", library_file("ur5e")))
    far = {"camera_on": "tool", "target_on": "world", "size": (1280.0, 960.0), "focal": (1150.0, 1150.0),
           "centre": (640.0, 480.0), "camera_origin": (0.03, -0.07, 0.06), "camera_rotation": (0.0, 0.0, 1.6),
           "target_origin": (-5.0, 0.12, 0.02), "target_rotation": (np.pi, 0.0, 0.5), "target_size": (0.21, 0.15),
           "focus": (0.25, 0.7)}  # fmt: skip
    camera = Camera.planned(Series.of("", "camera", far))
    with pytest.raises(InputError, match=r"0 can be measured, 12 are needed: as .* z axis turned away from the camera"):
        candidates(build(robot, ("geometry",), (), (camera,)), 12, "", "tool", None, np.random.default_rng(1), camera)
    made = photographed(UR5E, True, 4, np.random.default_rng(6), points=COARSE)
    for setting, told in (
        ("target_size_mm = [0, 90]", "target_size_mm: expected two"),
        ("focus_mm = [700, 250]", "focus_mm: expected"),
    ):
        with pytest.raises(InputError, match=told):
            study(tmp_path, made, "ur5e", True, setting).measurements()


def test_a_plan_of_images_counts_no_error_that_teaching_the_tool_removes(tmp_path):
    """Fails if a tool that no image shows counts as off, a second one is offered, or an image shows less than the whole board."""
    from calflow.design.planned import Planned, SelectionRequest, Task
    from calflow.design.selection import select
    from calflow.model import build

    said = library_file("ur5e").replace("known = false                   # false: est", "known = true  # est")
    robot = Robot.from_toml(write(tmp_path / "robot.toml", said))
    places = {"camera_on": "tool", "target_on": "world", "size": (1280.0, 960.0), "focal": (1150.0, 1150.0),
              "centre": (640.0, 480.0), "camera_origin": (0.03, -0.07, 0.06), "camera_rotation": (0.0, 0.0, 1.6),
              "target_origin": (-0.45, 0.12, 0.02), "target_rotation": (np.pi, 0.0, 0.5), "target_size": (0.21, 0.15)}  # fmt: skip
    camera = Camera.planned(Series.of("", "camera", places))
    model = build(robot, ("geometry",), (), (camera,))
    there = np.random.default_rng(3).uniform(-1.5, 1.5, (60, 6))
    asked = SelectionRequest(
        number=20, candidates=100, marker="tool", planned=Planned(camera, 0.2), task=Task.of(there, [""], "tool")
    )
    plan = select(model, asked)
    corners = np.array([(0, 0, 0), (0.21, 0, 0), (0, 0.15, 0), (0.21, 0.15, 0)]).T
    every = np.repeat(asked.rows(model, plan.readings), 4, axis=1)
    reported = np.vstack([np.zeros((2, 80)), np.tile(corners, 20), np.ones((2, 80))])
    rows = model.observed_jacobian(camera, model.nominal, every, reported).reshape(-1, len(model.parameters))
    rows *= model.prior_sd / 0.2
    root = np.linalg.cholesky(np.linalg.inv(rows.T @ rows + np.eye(rows.shape[1])))
    moved = model.point_jacobian(model.nominal, asked.rows(model, there)) * model.prior_sd @ root
    turned = UR5E.links(there)[-1][:, :3, :3].reshape(-1, 3)
    flat = moved.reshape(len(turned), -1)
    left = flat - turned @ np.linalg.lstsq(turned, flat, rcond=None)[0]
    assert plan.how_many.expected_sd_mm == pytest.approx(1e3 * np.sqrt((left**2).sum() / len(there)), rel=1e-6)
    assert plan.how_many.expected_sd_mm < 0.5
    assert not any("marker" in row.addition for row in plan.worth)
    unsure = Camera.planned(Series.of("", "camera", places | {"print_scale_sd": 3e-3}))
    model = build(robot, ("geometry",), (), (unsure,))
    measured, *additions = select(model, replace(asked, planned=Planned(unsure, 0.2))).worth
    assert measured.expected_sd_mm > 2 * plan.how_many.expected_sd_mm
    assert additions[0].addition == "the size of 'target' known exactly"  # no further image tells it
    assert additions[0].expected_sd_mm == pytest.approx(plan.how_many.expected_sd_mm, rel=0.3)


def test_a_task_is_promised_what_teaching_the_tool_leaves(tmp_path):
    """Fails if poses near a task are asked for since no image shows the tool, or more than the tool's own place is taught."""
    from calflow.sampling.task_points import TaskTolerances, point_errors, task_summary, task_table, taught

    data = study(
        tmp_path, photographed(UR5E, True, 24, np.random.default_rng(5), points=COARSE), "ur5e", True
    ).measurements()
    found = cf.identify(data.robot, data, ["geometry"], starts=1)
    drawn, fitted = found.sample(ess=200), data.only(data.train)
    task = fitted.only(~fitted.table.duplicated("pose").to_numpy())
    places = taught(found, task, fitted)
    with_tool, left = (
        point_errors(drawn, found, task.conditions, np.random.default_rng(1), places=of) for of in ((), places)
    )
    assert with_tool.expected[0].min() > 1e-3 > 5 * left.expected[0].max()
    axes = found.model.rotation(found.estimate, task.conditions)
    own = [np.einsum("nji,dnj->dni", axes, errors.drawn[0]) for errors in (with_tool, left)]
    np.testing.assert_allclose(own[1], own[0] - own[0].mean(axis=1, keepdims=True), atol=1e-12)
    np.testing.assert_allclose(left.drawn[1].mean(axis=1), 0.0, atol=1e-12)
    asked = TaskTolerances(tolerance=3e-4, turn_tolerance=5e-4)
    told = task_summary(found, task_table(found, task, fitted, left, asked, places), left, asked, ())
    assert told.likely_points == told.points
    assert told.orientation_measured
