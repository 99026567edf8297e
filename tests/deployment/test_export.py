"""Export: what is read back by other readers is the calibrated robot, and what a format cannot hold is told with its cost."""

from __future__ import annotations

import io
import json
import re
import warnings
from dataclasses import replace
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from calflow.deployment.export import export
from calflow.deployment.figures_alone import MEANT, EffortLevel, FiguresAlone, Levels, beyond_figures
from calflow.files.problems import InputError
from calflow.model import build
from calflow.robot.formats.rigid_chain import properties_text, rigid_chain, urdf_text
from calflow.robot.formats.robot_file import drives
from calflow.robot.frames import at_origin, dh
from calflow.robot.parts import Joint, Marker
from calflow.robot.robot import Robot
from estimation.data import calibration
from robot.formats import urdfs
from robots import ASKEW, base_frame, figures, frames, hh800, industrial, marker_position, placed, poses, rows, ur10

MICROMETRE = 1e-6
EXACT = Levels({}, (), tuple(
    EffortLevel(level=level, split="train", unit="mm", mean=mean, rms=mean, max=mean, promised=mean)
    for level, mean in (("nothing", 1.0), ("figures", 0.1), ("commands", 0.1))
))  # fmt: skip
NUMBER = 1000


def turned_round():
    """A robot in modified DH that stands askew and whose second joint counts backwards."""
    robot = replace(industrial(), base=ASKEW, tool_rotation=(0.1, 0.2, -0.3))
    joints = tuple(replace(joint, sign=-1) if i == 1 else joint for i, joint in enumerate(robot.joints))
    return replace(robot, joints=joints)


def identified(robot, effects=("geometry",)):
    """A robot whose parameters are all off."""
    model = build(robot, effects)
    rng = np.random.default_rng(2)
    estimate = np.clip(model.nominal + 0.3 * model.prior_sd * rng.standard_normal(len(model.nominal)), *model.bounds.T)
    return calibration(model, estimate, 1e-12 * np.eye(len(estimate)), sigma=1e-5)


@pytest.fixture(scope="module", params=[ur10, turned_round, hh800], ids=["dh", "modified-dh", "loop"])
def posed(request):
    """A calibrated robot, 1,000 readings and where its marker is there; and the same robot as its DH file reads."""
    known = identified(request.param())
    robot = known.model.robot
    angles = poses(robot, NUMBER)
    readings = angles @ np.linalg.inv(robot.reading_matrix).T
    packed = rows(known.model, readings, marker=next(iter(robot.markers)))
    return known, packed, angles, known.model.point(known.estimate, packed)


def as_file(known, packed, folder):
    """The robot that the exported DH file states."""
    path = folder / "robot.toml"
    path.write_text(export(known, "dh", EXACT, conditions=packed).text, encoding="utf-8")
    return Robot.from_toml(path)


def variables(robot, angles):
    """The variables of a rigid chain (n, n_joints) at driven joint angles: a loop's joint by where its frames are."""
    own = angles.copy()
    if robot.loop:
        k = robot.loop.joint - 1
        at, figs = frames(robot, angles), figures(robot)
        before = at.ends[k] @ placed(np.array([0, 0, 0, figs["alpha"][k], figs["beta"][k], 0]))
        turn = np.linalg.inv(before) @ at.joints[k]
        own[:, k] = np.arctan2(turn[:, 1, 0], turn[:, 0, 0]) - figs["theta"][k]
    return own * [joint.sign for joint in robot.joints]


def by_product(origins, axes, base, flange, marker, values):
    """Where a marker (3,) in the flange is by the product of a chain's transforms."""
    at = np.tile(base, (len(values), 1, 1))
    for origin, axis, own in zip(origins, axes, values.T, strict=True):
        turns = np.tile(np.eye(4), (len(values), 1, 1))
        turns[:, :3, :3] = Rotation.from_rotvec(np.outer(own, axis)).as_matrix()
        at = at @ origin @ turns
    return (at @ flange @ [*marker, 1.0])[:, :3]


def test_a_dh_file_reads_back(posed, tmp_path):
    """Fails if a figure, the base, the tool or the loop's bars are not as calibrated: by DH products of the test's own."""
    known, packed, angles, there = posed
    np.testing.assert_allclose(
        marker_position(as_file(known, packed, tmp_path), angles), there, rtol=0, atol=MICROMETRE
    )


def test_a_urdf_reads_back(posed, tmp_path):
    """Fails if an origin, an axis, a sign or the base is not as calibrated: by pinocchio."""
    known, packed, angles, there = posed
    found = export(known, "urdf", EXACT, conditions=packed)
    model = pin.buildModelFromXML(found.text)
    data, robot = model.createData(), as_file(known, packed, tmp_path)
    measuring, marker = (model.getFrameId(name) for name in ("measuring_frame", f"marker_{next(iter(robot.markers))}"))
    seen = []
    for row in variables(robot, angles):
        q = [
            part
            for joint, value in zip(model.joints[1:], row, strict=True)
            for part in ([value] if joint.nq == 1 else [np.cos(value), np.sin(value)])
        ]
        pin.framesForwardKinematics(model, data, np.array(q))
        seen.append(data.oMf[measuring].actInv(data.oMf[marker]).translation)
    np.testing.assert_allclose(seen, there, rtol=0, atol=MICROMETRE)
    assert any("four-bar loop" in note for note in found.notes) == bool(robot.loop)


def test_json_and_xacro_properties_read_back(posed, tmp_path):
    """Fails if a transform is another's, or in another order than stated."""
    known, packed, angles, there = posed
    robot = as_file(known, packed, tmp_path)
    values = variables(robot, angles)
    document = json.loads(export(known, "json", EXACT, conditions=packed).text)
    origins = [np.array(joint["origin"]) for joint in document["joints"]]
    axes = [joint["axis"] for joint in document["joints"]]
    marker = next(iter(document["markers_in_flange"].values()))
    base, flange = (np.array(document[name]) for name in ("base_in_measuring_frame", "flange_in_last_joint"))
    seen = by_product(origins, axes, base, flange, marker, values)
    np.testing.assert_allclose(seen, there, rtol=0, atol=MICROMETRE)
    root = ElementTree.fromstring(export(known, "xacro-properties", EXACT, conditions=packed).text)
    said = {one.get("name"): np.array(one.get("value").split(), dtype=float) for one in root}

    def place(name):
        return pin.SE3(pin.rpy.rpyToMatrix(*said[f"{name}_rpy"]), said[f"{name}_xyz"]).homogeneous

    names = [f"joint{i + 1}" for i in range(robot.n_joints)]
    seen = by_product(
        [place(name) for name in names], [said[f"{name}_axis"] for name in names], np.linalg.inv(place("measuring_frame")),
        place("flange"), said[f"marker_{next(iter(robot.markers))}_xyz"], values,
    )  # fmt: skip
    np.testing.assert_allclose(seen, there, rtol=0, atol=MICROMETRE)


def test_a_controller_s_figures_read_back(posed):
    """Fails if a figure is in another unit than stated, or the base's angles are another maker's."""
    known, packed, angles, there = posed
    robot = known.model.robot
    table = pd.read_csv(io.StringIO(export(known, "controller", EXACT, conditions=packed).text)).set_index(
        ["part", "figure"]
    )
    told, figs = table["calibrated"], figures(robot)
    for i in range(robot.n_joints):
        for name in ("alpha", "theta", "beta"):
            figs[name][i] = np.deg2rad(told[f"joint {i + 1}", name])
        for name in ("a", "d"):
            figs[name][i] = told[f"joint {i + 1}", name] / 1e3
    if robot.loop:
        figs["bars"] = np.array([told["loop", name] / 1e3 for name in ("crank", "rod", "rocker")])
    marker = next(iter(robot.markers))
    figs["markers"] = np.array([[told[f"marker {marker}", axis] / 1e3] for axis in "xyz"])
    a, b, c = (told["base", name] for name in "ABC")
    base = np.eye(4)
    base[:3, :3] = pin.rpy.rpyToMatrix(*np.deg2rad([c, b, a]))  # KUKA: A about z, B about the new y, C about the new x
    base[:3, 3] = [told["base", axis] / 1e3 for axis in "xyz"]
    seen = marker_position(robot, angles, figs)
    at_base = (seen - base_frame(robot, figs)[:3, 3]) @ base_frame(robot, figs)[:3, :3]
    np.testing.assert_allclose(at_base @ base[:3, :3].T + base[:3, 3], there, rtol=0, atol=MICROMETRE)
    assert table["difference"].abs().max() > 0


def test_a_controller_s_figures_are_beside_the_maker_s_file():
    """Fails if a place counts from where the calibration began, or a base that turns past half a turn differs by a whole one."""
    maker = replace(
        ur10(), base=replace(ASKEW, rotation=tuple(np.deg2rad((0.0, 0.0, 180.0)))), tool_rotation=(0.0, np.pi / 2, 0.0)
    )
    began = replace(
        maker, base=replace(maker.base, origin=(0.6, -1.2, 0.3), rotation=tuple(np.deg2rad((0.0, 0.0, -179.9))))
    )
    known = identified(began)
    known = replace(known, estimate=0.0 * known.estimate)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        packed = rows(known.model, poses(began, 3), marker=next(iter(began.markers)))
        text = export(known, "controller", EXACT, conditions=packed, maker=maker).text
    table = pd.read_csv(io.StringIO(text)).set_index(["part", "figure"])
    assert table["nominal"]["base", "x"] == pytest.approx(500.0)
    assert table["difference"]["base", "x"] == pytest.approx(100.0)
    for figure in ("rz", "A", "R"):
        assert table["difference"]["base", figure] == pytest.approx(0.1)
    assert table["difference"]["base"][["q1", "q2", "q3", "q4"]].abs().max() < 1e-3
    assert table["difference"]["base"][["vx", "vy", "vz"]].abs().max() == pytest.approx(np.deg2rad(0.1))
    assert table["difference"]["tool"].abs().max() == pytest.approx(0.0, abs=1e-9)


def test_names_of_the_user_s_make_no_file_that_cannot_be_read():
    """Fails if two joints get one name, a property's name is none, or a note ends the comment that it stands in."""
    joints = [
        replace(joint, name=name)
        for joint, name in zip(ur10().joints, ("joint2", "", "A 1", "A-1", "软", "x"), strict=True)
    ]
    marker = next(iter(ur10().markers.values()))
    chain = rigid_chain(replace(ur10(), joints=tuple(joints), markers={"Marke 1": marker, "目标": marker, "E": marker}))
    assert [joint.name for joint in chain.joints] == ["joint1", "joint2", "joint3", "joint4", "joint5", "x"]
    assert pin.buildModelFromXML(urdf_text(chain, "a --- b")).nq == 12 - sum(
        joint.limits is not None for joint in joints
    )
    names = [one.get("name") for one in ElementTree.fromstring(properties_text(chain, "--- c"))]
    assert all(re.fullmatch(r"\w+", name, flags=re.ASCII) for name in names)
    assert names[-3:] == ["marker_Marke_1_xyz", "marker_2_xyz", "marker_E_xyz"]


def test_what_is_left_out_is_told_with_its_cost():
    """Fails if compliance goes without a word, its cost is another's, or figures count as left out."""
    known = identified(hh800(), ("geometry", "joint-compliance"))
    robot = known.model.robot
    packed = rows(known.model, poses(robot, 50), "rated", next(iter(robot.markers)))
    stiff = known.estimate.copy()
    stiff[known.model.columns(known.model.effects[1])] = 0.0
    off = known.model.point(known.estimate, packed) - known.model.point(stiff, packed)
    figures = known.model.columns(known.model.effects[0])
    rows_of = tuple(SimpleNamespace(estimate=value, fixed=False) for value in known.estimate[figures])
    alone = FiguresAlone(build(robot, ("geometry",)), rows_of)
    levels = replace(EXACT, alone={"figures": alone}, left_out=beyond_figures(known.model))
    found = export(known, "dh", levels, conditions=packed)
    (one,) = found.left_out
    assert (one.effect, one.parts[0]) == ("joint-compliance", "joint1")
    assert one.max_mm == pytest.approx(1e3 * np.linalg.norm(off, axis=1).max())
    joints = "joint 1, joint 2, joint 3, joint 4, joint 5 and joint 6"
    (said,) = (note for note in found.notes if f"left out: joint compliance ({joints}): the tool" in note)
    assert f"{one.max_mm:.3f} mm at most" in said
    exact = export(identified(robot), "dh", EXACT, conditions=packed)
    assert exact.left_out == ()
    assert [note.partition(" misses ")[0] for note in exact.notes] == [  # a line each
        f"given {MEANT[level.level]}, the robot" for level in EXACT.every
    ]


def test_markers_have_names_that_xacro_takes():
    """Fails if a blank or a dot in a marker's name makes a file that xacro refuses, or two markers get the same name."""
    robot = ur10()
    robot = replace(robot, markers=dict.fromkeys(("ball 1.5", "ball-1.5", "tip"), next(iter(robot.markers.values()))))
    known = identified(robot)
    packed = rows(known.model, poses(robot, 3), marker="tip")
    root = ElementTree.fromstring(export(known, "xacro-properties", EXACT, conditions=packed).text)
    markers = [one.get("name") for one in root if one.get("name", "").startswith("marker_")]
    assert markers == ["marker_1_xyz", "marker_2_xyz", "marker_tip_xyz"]


def test_a_robot_of_a_urdf_reads_back(tmp_path):
    """Fails if calibrated origins are not written, as a robot file, as URDF (by pinocchio) or as figures to type in."""
    (tmp_path / "tree.urdf").write_text(urdfs.tree(5))
    known = identified(Robot.from_urdf(tmp_path / "tree.urdf", tip="tip", base=ASKEW))
    robot = known.model.robot
    angles = poses(robot, NUMBER)
    packed = rows(known.model, angles, marker="tip")
    there = known.model.point(known.estimate, packed)
    assert np.abs(there - known.model.point(known.model.nominal, packed)).max() > 1e-3
    read = as_file(known, packed, tmp_path)
    np.testing.assert_allclose(build(read, ()).point(np.zeros(0), packed), there, rtol=0, atol=MICROMETRE)
    written = tmp_path / "written.urdf"
    written.write_text(export(known, "urdf", EXACT, conditions=packed).text)
    reference = urdfs.Reference(written, [joint.name for joint in robot.joints])
    seen = [reference.frame(row, "marker_tip", "measuring_frame")[:3, 3] for row in angles]
    np.testing.assert_allclose(seen, there, rtol=0, atol=MICROMETRE)
    table = pd.read_csv(io.StringIO(export(known, "controller", EXACT, conditions=packed).text)).set_index(
        ["part", "figure"]
    )
    for error, value in zip(known.model.effects[0].errors, known.estimate, strict=True):
        if error.field == "steps":
            said = table.loc[error.parameter.part.replace("joint", "joint "), error.parameter.symbol]
            assert said["difference"] == pytest.approx((1e3 if said["unit"] == "mm" else np.rad2deg(1)) * value)


def test_a_tree_reads_back(tmp_path):
    """Fails if a branch is written on another link, a marker elsewhere than on its own, or several arms go to a controller."""
    (tmp_path / "arms.urdf").write_text(urdfs.arms(1))
    markers = {name: Marker((0.1, 0.0, 0.2), on=name) for name in ("left_tip", "torso", "eye")}
    known = identified(
        Robot.from_urdf(tmp_path / "arms.urdf", tip=["left_tip", "eye", "right_tip"], markers=markers, base=ASKEW)
    )
    robot = known.model.robot
    readings = poses(robot, NUMBER) * [joint.driven for joint in robot.joints]
    written, read = tmp_path / "written.urdf", tmp_path / "read.toml"
    packed = rows(known.model, readings, marker="eye")
    written.write_text(export(known, "urdf", EXACT, conditions=packed).text)
    read.write_text(export(known, "dh", EXACT, conditions=packed).text)
    reference = urdfs.Reference(written, [joint.name for joint in robot.joints])
    document = json.loads(export(known, "json", EXACT, conditions=packed).text)
    on = {one["joint"]: list(one["markers"]) for one in document["further_flanges"]}
    assert on == {"to_torso": ["torso"], "left4": ["left_tip"], "head2": ["eye"]}
    for name in markers:
        packed = rows(known.model, readings, marker=name)
        there = known.model.point(known.estimate, packed)
        assert np.abs(there - known.model.point(known.model.nominal, packed)).max() > 1e-3
        seen = [
            reference.frame(row, f"marker_{name}", "measuring_frame")[:3, 3]
            for row in readings @ robot.reading_matrix.T
        ]
        np.testing.assert_allclose(seen, there, rtol=0, atol=MICROMETRE)
        again = build(Robot.from_toml(read), ()).point(np.zeros(0), packed)
        np.testing.assert_allclose(again, there, rtol=0, atol=MICROMETRE)
    with pytest.raises(InputError, match="of one arm, this robot has several"):
        export(known, "controller", EXACT, conditions=packed)


def test_a_tree_of_dh_figures_reads_back(tmp_path):
    """Fails if where an arm stands on another's link is not as calibrated, or its convention refuses these figures."""
    joints = [
        Joint(dh(d=0.5, alpha=1.5), limits=(-3, 3), link="torso"),
        Joint(dh(a=0.3), limits=(-3, 3), link="left"),
        Joint(at_origin(dh(a=0.2, d=0.1), (0.0, -0.1, 0.25), (0.0, 1.6, 0.2)), limits=(-3, 3), parent="torso"),
    ]
    markers = {"left": Marker((0.1, 0.0, 0.2), on="left"), "right": Marker((0.0, 0.1, 0.1))}
    known = identified(Robot(joints, markers=markers, base=ASKEW))
    readings = poses(known.model.robot, NUMBER)
    packed = rows(known.model, readings, marker="right")
    read = tmp_path / "read.toml"
    read.write_text(export(known, "dh", EXACT, conditions=packed).text)
    model = pin.buildModelFromXML(export(known, "urdf", EXACT, conditions=packed).text)
    data = model.createData()
    for name in markers:
        packed = rows(known.model, readings, marker=name)
        there = known.model.point(known.estimate, packed)
        assert np.abs(there - known.model.point(known.model.nominal, packed)).max() > 1e-3
        frames_of = [model.getFrameId(called) for called in ("measuring_frame", f"marker_{name}")]
        for reading, place in zip(readings, there, strict=True):
            pin.framesForwardKinematics(model, data, reading)
            measuring, marker = (data.oMf[frame] for frame in frames_of)
            np.testing.assert_allclose(measuring.actInv(marker).translation, place, rtol=0, atol=MICROMETRE)
        again = build(Robot.from_toml(read), ()).point(np.zeros(0), packed)
        np.testing.assert_allclose(again, there, rtol=0, atol=MICROMETRE)


def test_a_planner_can_move_what_it_reads(tmp_path):
    """Fails if the source's efforts and velocities are lost, or 0 stands in their place, or a placeholder without a word."""
    limited = replace(ur10(), joints=tuple(replace(joint, limits=(-3.0, 3.0)) for joint in ur10().joints))
    text = urdf_text(rigid_chain(limited), "").replace(
        'effort="1000.0" velocity="1.0"', 'effort="150" velocity="2.5"', 1
    )
    (tmp_path / "arm.urdf").write_text(text.replace('effort="1000.0" velocity="1.0"', 'effort="0" velocity="0"', 1))
    (tmp_path / "robot.toml").write_text(
        '[urdf]\nfile = "arm.urdf"\ntip = "tool0"\n[markers.E]\npoint_mm = [0, 0, 9]\n'
    )
    robot = Robot.from_toml(tmp_path / "robot.toml")
    known = identified(robot)
    packed = rows(known.model, poses(robot, 3), marker="E")
    told = export(known, "urdf", EXACT, conditions=packed, drives=drives(tmp_path / "robot.toml"))
    limits = [one.attrib for one in ElementTree.fromstring(told.text).iter("limit")]
    assert [(float(one["effort"]), float(one["velocity"])) for one in limits] == [(150, 2.5)] + 5 * [(1000, 1)]
    said = [note for note in told.notes if "placeholder" in note]
    assert [note.split(" of ")[0] for note in said] == ["effort 1000 (Nm or N)", "velocity 1 (rad/s or m/s)"]
    assert (
        said[0].split(" of ")[1].split(" is ")[0] == robot.joints[1].name
    )  # the source states 1000 and 1 of the others
