"""The stage select: poses for what the study asks, over the task that it names, and what it refuses."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest

from calflow.files.units import RADIAN
from calflow.measurements.measurements import Measurements
from calflow.robot.robot import Robot
from calflow.stage_settings import SelectSettings
from calflow.stages.select import planned_of
from calflow.study import load_study

JOINTS = ["q1_deg", "q2_deg", "q3_deg"]
TASK = """
[stages.select.task]
region_min_mm = [300, -400, 200]
region_max_mm = [1300, 400, 1200]
payloads = ["heavy", ""]
"""


def selected(small, asked, task=TASK, out="runs"):
    """The table of what poses are worth, the certificate, and what was said, where a study asks so."""
    small.edit("study.toml", ("poses = 8\n", f'poses = 8\npayload = "light"\n{asked}\n{task}'))
    answer = small.calflow("run", "--stage", "select", "--out", small / out)
    small.edit("study.toml", (f'payload = "light"\n{asked}\n{task}', ""))
    assert answer.code == 0, answer.err
    folder = small / out / "select"
    certificate = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    return pd.read_csv(folder / "observability.csv").iloc[-1], certificate, answer.out


def test_poses_are_best_for_what_is_asked(small):
    """Fails if a criterion is taken for another: each is the best of the three in its own figure, over one task."""
    worth, certificates = {}, {}
    for aim in ("parameters", "tool", "worst"):
        worth[aim], certificates[aim], said = selected(small, f'criterion = "{aim}"', out=aim)
        assert certificates[aim]["criterion"] == aim
        assert f"by more than {certificates[aim]['could_gain_percent']:.2g} %" in said
    assert max(worth, key=lambda aim: worth[aim]["O1"]) == "parameters"
    assert min(worth, key=lambda aim: worth[aim]["expected_sd_mm"]) == "tool"
    assert min(worth, key=lambda aim: worth[aim]["worst_sd_mm"]) == "worst"
    assert certificates["tool"]["loss"] == pytest.approx(worth["tool"]["expected_sd_mm"], rel=1e-6)
    assert certificates["worst"]["loss"] == pytest.approx(worth["worst"]["worst_sd_mm"], rel=1e-6)
    for aim, name in (("tool", "expected_sd_mm"), ("worst", "worst_sd_mm")):
        assert all(certificates[aim]["least_loss"] <= worth[other][name] for other in worth)


def test_the_task_is_what_the_study_names(small):
    """Fails if the task's payloads or its poses do not count, or a task does not make the tool what poses are for."""
    loaded, certificate, _ = selected(small, "")
    assert certificate["criterion"] == "tool"
    bare, _, _ = selected(small, "", TASK.replace('["heavy", ""]', '[""]'), "bare")
    assert bare["expected_sd_mm"] < loaded["expected_sd_mm"]  # compliance is not asked for
    (small / "task.csv").write_text("q1_deg,q2_deg,q3_deg\n0,-90,90\n", encoding="utf-8")
    stated, _, _ = selected(small, "", '[stages.select.task]\nposes = "task.csv"\n', "stated")
    assert stated["expected_sd_mm"] == pytest.approx(stated["worst_sd_mm"])  # a single point


def test_suspected_causes_are_planned_for(small):
    """Fails if what is only suspected does not count among the parameters and in the tool's error."""
    without, plain, _ = selected(small, "")
    with_them, certificate, _ = selected(small, 'also_effects = ["link-bending"]', out="suspected")
    assert certificate["n_parameters"] > plain["n_parameters"]
    assert with_them["expected_sd_mm"] > without["expected_sd_mm"]


def test_the_noise_that_a_study_states_of_its_measurements_is_planned_with(small):
    """Fails if a plan promises what another device would give, or that of the stage does not come first."""
    planned = {}
    asked = 'criterion = "parameters"'
    for out, stated in (("usual", ""), ("same", "sigma_mm = 0.05"), ("noisier", "sigma_mm = 0.5")):
        small.edit("study.toml", ('file = "measurements.csv"', f'file = "measurements.csv"\n{stated}'))
        planned[out], _, _ = selected(small, asked, out=out)
        planned[f"{out}, of the stage"], _, _ = selected(small, f"{asked}\nsigma_mm = 0.05", out=f"{out} stage")
        small.edit("study.toml", (f'file = "measurements.csv"\n{stated}', 'file = "measurements.csv"'))
    expected = {name: row["expected_sd_mm"] for name, row in planned.items()}
    assert expected["noisier"] > 2 * expected.pop("usual")
    assert len({float(f"{value:.9g}") for name, value in expected.items() if name != "noisier"}) == 1
    small.edit("study.toml", ('file = "measurements.csv"', 'file = "measurements.csv"\nsigma_px = 0.2'))
    (small / "measurements.csv").unlink()
    (told,) = small.refused("run", "--stage", "select", "--out", small / "px")
    assert told.endswith(
        "measurements.sigma_px: expected the unit of what is measured: sigma_m or sigma_mm or sigma_um"
    )


def test_orientations_are_planned_with_their_stated_noise(small):
    """Fails if that of the study's measurements is passed over, or does not give way to the stage's."""
    for stated, expected in (("", 1e-4), ("sigma_rotation_mrad = 0.7", 7e-4)):
        small.edit("study.toml", ('file = "measurements.csv"', f'file = "measurements.csv"\nkind = "pose"\n{stated}'))
        study = load_study(small / "study.toml")
        settings = study.validated_settings("select", SelectSettings)
        assert planned_of(study, settings).further[RADIAN] == pytest.approx(expected)
        assert planned_of(study, settings.model_copy(update={"sigma_rotation": 2e-4})).further[RADIAN] == 2e-4
        small.edit("study.toml", (f'file = "measurements.csv"\nkind = "pose"\n{stated}', 'file = "measurements.csv"'))


def test_what_cannot_be_planned_is_refused(small):
    """Fails if a cause that poses cannot tell of, or a payload of the task that nobody knows, is passed over."""
    causes = 'also_effects = ["session-frame", "joint-error-map"]'
    small.edit("study.toml", ("poses = 8", f"poses = 8\n{causes}\n{TASK}"), ('"heavy", ""', '"heavi"'))
    said = "\n".join(small.refused())
    for words in (
        "unknown payload 'heavi'; there are light, heavy, did you mean 'heavy'?",
        "poses cannot be chosen for 'session-frame', which needs a column session",
        "'joint-error-map' has no parameters before there are measurements",
    ):
        assert words in said


def test_taught_poses_are_what_is_chosen_of(small):
    """Fails if a pose is chosen that is not in the file, or one beyond the limits; or if a changed file goes unnoticed."""
    rng = np.random.default_rng(1)
    taught = pd.DataFrame(rng.uniform([-200, -90, 0], [200, 30, 120], (40, 3)).round(3), columns=JOINTS)
    taught.to_csv(small / "taught.csv", index=False)
    selected(small, 'candidates_file = "taught.csv"', "", "taught")
    chosen = pd.read_csv(small / "taught" / "select" / "poses.csv")[JOINTS]
    assert chosen.merge(taught).shape == chosen.shape
    assert (chosen["q1_deg"].abs() <= 170).all()
    _, _, said = selected(small, 'candidates_file = "taught.csv"', "", "taught")
    assert "reused" in said
    taught.head(30).to_csv(small / "taught.csv", index=False)
    _, _, said = selected(small, 'candidates_file = "taught.csv"', "", "taught")
    assert "reused" not in said
    taught.head(5).to_csv(small / "taught.csv", index=False)
    small.edit("study.toml", ("poses = 8\n", 'poses = 8\ncandidates_file = "taught.csv"\n'))
    (said,) = small.refused("run", "--stage", "select")
    assert "of 5 stated poses" in said


def test_poses_are_added_to_those_measured(small):
    """Fails if what was measured does not count, or the poses added to it are not better there than those chosen without."""
    _, alone, _ = selected(small, "")
    worth, added, _ = selected(small, "add_to_measured = true", out="added")
    curve = pd.read_csv(small / "added" / "select" / "observability.csv")
    assert curve["n_poses"].iloc[0] == 0
    assert (curve["expected_sd_mm"].diff().dropna() < 0).all()
    assert added["loss"] < alone["loss"]
    assert curve["expected_sd_mm"].iloc[0] < 1.2 * alone["loss"]  # 40 poses were measured
    assert worth["n_poses"] == 8


def test_the_number_that_meets_a_tolerance(small):
    """Fails if a plan of as many poses as are said to be enough does not meet the tolerance, or unit or study's key is lost."""
    _, before, _ = selected(small, "tolerance_um = 90")
    said = json.loads((small / "runs" / "select" / "how_many.json").read_text(encoding="utf-8"))
    assert said["tolerance_mm"] == pytest.approx(0.09)
    assert said["expected_sd_mm"] == pytest.approx(before["loss"])
    assert said["needed_poses"] <= said["enough_poses"]
    assert said["next_ten_mm"] > 0


def test_refined_poses_are_said_to_be_better(small):
    """Fails if refinement is not asked for by its key, or its gain is not what the table of poses' worth says."""
    worth, plain, _ = selected(small, "")
    better, certificate, _ = selected(small, "refine = true", out="refined")
    assert plain["refined_percent"] is None
    gained = 100 * (1 - better["expected_sd_mm"] / worth["expected_sd_mm"])
    assert certificate["refined_percent"] == pytest.approx(gained, abs=1e-6)
    assert gained > 0


CELL = """
[stages.select.cell]
reflector_axis = [1.0, 0.0, 0.0]
acceptance_deg = 80
floor_mm = 100
link_radii_mm = [60, 50, 40]

[[stages.select.cell.stations]]
origin_mm = [3000, 500, 300]
range_max_m = 3.5
elevation_max_deg = 25

[[stages.select.cell.boxes]]
min_mm = [500, 300, 0]
max_mm = [900, 700, 600]

[[stages.select.cell.cylinders]]
start_mm = [600, -500, 0]
end_mm = [600, -500, 800]
radius_mm = 80
"""


def test_poses_keep_to_the_cell_of_the_study(small):
    """Fails if a key of the cell is lost or its unit, or if nobody is told how many poses each rule refused."""
    _, _, said = selected(small, "", CELL)
    for rule in ("range", "elevation", "acceptance of the reflector", "floor, boxes or cylinders"):
        assert f"{rule} " in said.partition("refused by")[2].splitlines()[0]
    chosen = pd.read_csv(small / "runs" / "select" / "poses.csv")
    reflector = chosen[["nominal_x_mm", "nominal_y_mm", "nominal_z_mm"]].to_numpy()
    way = reflector - [3000, 500, 300]
    assert (np.linalg.norm(way, axis=1) < 3500.1).all()
    assert (np.degrees(np.arctan2(way[:, 2], np.hypot(way[:, 0], way[:, 1]))) < 25.1).all()


def test_a_cell_that_does_not_fit_the_robot_is_refused(small):
    """Fails if the wrong number of radii, a configuration of three joints or torque without rated torque is passed over."""
    wrong = CELL.replace("40]", "40, 30]\nconfiguration_deg = [0, -90, 90]\ntorque_share = 0.8")
    small.edit("study.toml", ("poses = 8\n", f"poses = 8\n{wrong}\n"))
    said = "\n".join(small.refused())
    for words in (
        "stages.select.cell.link_radii: expected 3 radii, one per joint, found 4",
        "elbow and wrist are defined only for arms with six",
        "needs masses and rated_torque",
    ):
        assert words in said
    assert any("cell" in line and "study.toml:" in line for line in said.splitlines())


def test_impossible_cells_are_refused(small):
    """Fails if a box inside out, a range that ends before it begins, or a cone that nobody looks into is taken."""
    for changed, words in (
        (CELL.replace("max_mm = [900", "max_mm = [400"), "expected min < max along every axis"),
        (CELL.replace("range_max_m = 3.5", "range_max_m = 3.5\nrange_min_m = 4"), "range_min must lie below range_max"),
        ("[stages.select.cell]\nacceptance_deg = 80", "acceptance needs a station"),
        ("[stages.select.cell]\nacceptence_deg = 80", "unknown key, did you mean 'acceptance_deg'"),
    ):
        small.edit("study.toml", ("poses = 8\n", f"poses = 8\n{changed}\n"))
        assert words in "\n".join(small.refused())
        small.edit("study.toml", (f"poses = 8\n{changed}\n", "poses = 8\n"))


def test_what_one_thing_more_is_worth_and_what_drift_pulls_is_told(small):
    """Fails if an addition that the robot file allows is missing, or the order asked for is not the one that is taken."""
    said = selected(small, 'order = "random"\ndrift_um = 20')[2]
    worth = pd.read_csv(small / "runs" / "select" / "worth.csv").fillna("")
    for words in ("payload 'heavy'", "second marker", "second station", "twice", "further poses"):
        assert worth["addition"].str.contains(words).sum() == 1
    assert (worth["gain_mm"] >= -1e-9).sum() >= len(worth) - 1  # a lighter payload may tell less
    assert worth["addition"].iloc[1] in said
    order = pd.read_csv(small / "runs" / "select" / "order.csv")
    assert set(order.loc[order["taken"], "order"]) == {"random"}
    assert (order["drift_mm"] == 0.02).all()
    assert "a drift of the device by 0.02 mm" in said


def test_poses_below_the_foot_are_told_where_nothing_keeps_them_above(small):
    """Fails if poses in the floor come without a word, or words come where a region or a cell was stated."""
    words = "have the marker below the robot's foot"
    assert words in selected(small, "", "", "bare")[2]
    poses = pd.read_csv(small / "bare" / "select" / "poses.csv")
    below = int((poses["nominal_z_mm"] < 0).sum())
    assert f"{below} of {len(poses)} poses {words}" in selected(small, "", "", "again")[2]
    region = "region_min_mm = [-2000, -2000, -2000]\nregion_max_mm = [2000, 2000, 2000]"
    assert words not in selected(small, region, "", "region")[2]


def test_play_is_planned_for_by_vias(small):
    """Fails if a cause that shows by the side that joints come from is refused, or poses.csv has no vias for it or is no data."""
    said = selected(small, 'also_effects = ["joint-backlash"]')[2]
    assert "for backlash each joint comes from a via" in said
    poses = pd.read_csv(small / "runs" / "select" / "poses.csv")
    assert (np.sign(poses["q2_deg"] - poses["via2_deg"]) == poses["approach2"]).all()
    filled = poses.assign(x_mm=poses["nominal_x_mm"], y_mm=poses["nominal_y_mm"], z_mm=poses["nominal_z_mm"])
    filled.to_csv(small / "measurements.csv", index=False)
    given = Measurements.from_csv(small / "measurements.csv", Robot.from_toml(small / "robot.toml")).given
    assert {"approach", "travel"} <= set(given)
