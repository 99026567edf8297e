"""The controllers' own files: what is pasted makes the controller read what the calibrated robot says, and nothing else changes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calflow.files.problems import InputError
from calflow.model import build
from calflow.robot.formats.controller_files import CONTROLLER_FILES, pasted
from calflow.robot.parts import Base
from robots import industrial

GEARS = np.array([-120.5, 118.0, 95.25, -80.0, 77.5, 50.0])  # turns of a motor over turns of its joint
COUNTS = 2048 * 32 * GEARS / 360  # of an encoder, a degree
OFFSETS = np.array([0.5, 3.25, -1.75, 6.0, 2.5, 0.125])
OFF = np.array([0.02, -0.015, 0.03, 0.05, -0.04, 0.01])  # deg
QUARTER = 2**-0.5


def moc():
    """A backup's MOC.cfg: instances go on after a backslash, what is at its default is left out."""
    calibrations = "\n\n".join(
        f'      -name "rob1_{k}" -valid_com_offset  -com_offset 1.5708 -valid_cal_offset \\\n      -cal_offset {offset}'
        for k, offset in enumerate(OFFSETS, start=1)
    )
    gears = "\n".join(f'      -name "rob1_{k}" -transm_joint {gear}' for k, gear in enumerate(GEARS, start=1))
    return (
        f"MOC:CFG_1.0:6:0::\n#\nMOTOR_CALIB:\n\n{calibrations}\n#\nROBOT:\n\n"
        '      -name "ROB_1" -use_robot_type "ROB1_2400" -base_frame_pos_x 1.5 \\\n      -base_frame_pos_y 0.25'
        " -base_frame_pos_z 0.5 -base_frame_orient_u0 1 -base_frame_orient_u1 0 \\\n      -base_frame_orient_u2 0"
        f' -base_frame_orient_u3 0\n#\nTRANSMISSION:\n\n{gears}\n#\nARM:\n\n      -name "rob1_1" -cal_offset 99\n'
    )


def krc():
    """$machine.dat and $config.dat."""
    offsets = "\r\n".join(f"$MAMES[{k}]={offset} ;mastering" for k, offset in enumerate(OFFSETS, start=1))
    return (
        f"DEFDAT $MACHINE PUBLIC\r\n{offsets}\r\n$ROBROOT={{X 0.0,Y 0.0,Z 0.0,A 0.0,B 0.0,C 0.0}}\r\nENDDAT\r\n"
        'TOOL_NAME[1,]="gun"\r\nTOOL_NAME[2,]="probe"\r\nTOOL_DATA[1]={X 1.0,Y 2.0,Z 3.0,A 4.0,B 5.0,C 6.0}\r\n'
        "TOOL_DATA[2]={X 0.0,Y 0.0,Z 0.0,A 0.0,B 0.0,C 90.0}\r\n"
    )


def listing():
    """SYSMAST.VA and SYSTEM.VA; master counts are whole."""
    counts = "\n".join(f"      [{k}] = {round(1e5 * offset)}" for k, offset in enumerate(OFFSETS, start=1))
    scales = "\n".join(f"      [{k}] = {scale:.6e}" for k, scale in enumerate(COUNTS, start=1))
    return (
        "[*SYSTEM*]$DMR_GRP  Storage: SHADOW  Access: RW  : ARRAY[1] OF DMR_GRP_T\n"
        "     Field: $DMR_GRP[1].$MASTER_DONE Access: RW: BOOLEAN = TRUE\n"
        f"     Field: $DMR_GRP[1].$MASTER_COUN  ARRAY[9] OF INTEGER\n{counts}\n"
        "     Field: $DMR_GRP[1].$REF_COUNT ARRAY[9] OF INTEGER\n      [1] = 7\n"
        f"     Field: $PARAM_GROUP[1].$ENCSCALES ARRAY[9] OF REAL\n{scales}\n"
    )


def read_by(maker, offsets, motor):
    """What a controller reads [deg] at motor positions: radians of the motor, degrees beyond the mark, counts."""
    if maker == "abb-moc":
        return np.rad2deg((motor - offsets) / GEARS)
    return motor + offsets if maker == "kuka-dat" else (motor - offsets) / COUNTS


FILES = {"abb-moc": moc, "kuka-dat": krc, "fanuc-mastering": listing}


def calibrated(nominal):
    """The robot with other zeros and tool, placed elsewhere."""
    joints = [
        replace(joint, frame=replace(joint.frame, turn=replace(joint.frame.turn, value=joint.frame.turn.value + off)))
        for joint, off in zip(nominal.joints, np.deg2rad(OFF), strict=True)
    ]
    base = Base(origin=(1.501, 0.25, 0.499), rotation=(0.0, 0.0, np.pi / 2), known=True)
    (marker,) = nominal.markers.values()
    markers = {"probe": replace(marker, point=(0.1, -0.02, 0.3))}
    return replace(nominal, joints=tuple(joints), base=base, markers=markers, tool_rotation=(0.1, -0.2, 0.3))


@pytest.fixture
def robot():
    """The maker's, whose base is known."""
    robot = industrial()
    (marker,) = robot.markers.values()
    return replace(robot, markers={"probe": marker}, base=Base(origin=(0, 0, 0), rotation=(0, 0, 0), known=True))


def values(maker, text):
    """The numbers of a file by name."""
    return {k: v for one in CONTROLLER_FILES[maker].statements(text) for k, v in one.values.items()}


@pytest.mark.parametrize("maker", FILES)
def test_the_controller_then_reads_where_the_robot_is(maker, robot):
    """Fails if a zero has the wrong sign, unit or gear, or another number of the file changes with it."""
    kept, text = CONTROLLER_FILES[maker], FILES[maker]()
    truth = calibrated(robot)
    made = pasted(maker, {Path("file"): text}, robot, truth).text
    before, after = values(maker, text), values(maker, made)
    names = [kept.zero.format(k) for k in range(1, 7)]
    old, new = (np.array([of[name] for name in names]) for of in (before, after))
    motor = np.random.default_rng(1).uniform(-90, 90, 6) * (COUNTS if maker == "fanuc-mastering" else 1.0)
    q = [np.deg2rad(read_by(maker, offsets, motor)) for offsets in (old, new)]
    np.testing.assert_allclose(np.rad2deg(q[1] - q[0]), robot.angle_matrix @ OFF, atol=2e-4)
    zeros = replace(robot, joints=truth.joints)
    seen = [build(one, ()).point(np.zeros(0), np.concatenate([angles, [0.0] * len(one.payloads), [1.0]])[:, None])
            for one, angles in ((zeros, q[0]), (robot, q[1]))]  # fmt: skip
    np.testing.assert_allclose(*seen, atol=2e-5)
    assert made.count("before: ") >= 6
    assert "cal_offset 99" not in made
    assert "REF_COUNT" not in made


def test_base_and_tool_are_read_back(robot):
    """Fails if a frame is written in another order, unit or sense, or a tool of another name is overwritten."""
    truth = calibrated(robot)
    abb = values("abb-moc", pasted("abb-moc", {Path("MOC.cfg"): moc()}, robot, truth).text)
    frame = [
        abb[f"ROB_1 base_frame_{name}"] for name in ("pos_x", "pos_y", "pos_z", *(f"orient_u{k}" for k in range(4)))
    ]
    np.testing.assert_allclose(frame, [1.501, 0.25, 0.499, QUARTER, 0, 0, QUARTER], atol=1e-6)
    made = pasted("kuka-dat", {Path("$machine.dat"): krc()}, robot, truth)
    assert made.holds_tool
    assert "TOOL_DATA[1]" not in made.text
    assert "TOOL_DATA[2]={X 100.000000,Y -20.000000,Z 300.000000,A " in made.text
    kuka = values("kuka-dat", krc().replace('"probe"', '"x"') + 'TOOL_NAME[2,]="probe"\n' + made.text)
    assert [kuka[f"$ROBROOT {axis}"] for axis in "XYZABC"] == pytest.approx([1501, 250, 499, 90, 0, 0])
    turn = Rotation.from_euler("ZYX", [kuka[f"TOOL_DATA probe {axis}"] for axis in "ABC"], degrees=True)
    np.testing.assert_allclose(turn.as_matrix(), Rotation.from_euler("XYZ", [0.1, -0.2, 0.3]).as_matrix(), atol=1e-6)


def test_a_base_that_nobody_knows_is_left_alone(robot):
    """Fails if the place of the robot before a tracker that stood anywhere is pasted as the controller's world."""
    anywhere = replace(robot, base=replace(robot.base, known=False))
    assert "$ROBROOT" not in pasted("kuka-dat", {Path("$machine.dat"): krc()}, anywhere, calibrated(robot)).text


def test_what_the_files_lack_is_said(robot):
    """Fails if an offset that is not there is taken for nothing, or counts are made up."""
    lacking = {Path("SYSMAST.VA"): listing().split("     Field: $PARAM_GROUP")[0]}
    with pytest.raises(InputError, match=r"ENCSCALES\[1\], in listings of SYSMAST and SYSTEM .*: SYSMAST.VA"):
        pasted("fanuc-mastering", lacking, robot, calibrated(robot))
    with pytest.raises(InputError, match="expected the controller's own file as it is today"):
        pasted("kuka-dat", {}, robot, calibrated(robot))


def test_a_slide_s_offset_is_counted_in_metres(robot):
    """Fails if what is added to a slide's reading is taken for an angle, whose gear is in radians of the motor a radian."""
    slide = replace(robot.joints[2], kind="prismatic", limits=(-1.0, 1.0))
    sliding = replace(robot, joints=(*robot.joints[:2], slide, *robot.joints[3:]))
    d = slide.frame.figures["d"]
    truth = replace(sliding.joints[2], frame=slide.frame.restated({"d": d + 2e-3}))
    off = replace(sliding, joints=(*sliding.joints[:2], truth, *sliding.joints[3:]))
    made = pasted("abb-moc", {Path("MOC.cfg"): moc()}, sliding, off).text
    assert "joint 3 reads +2.0000 more" in made
    assert values("abb-moc", made)["rob1_3 cal_offset"] == pytest.approx(OFFSETS[2] - 2e-3 * GEARS[2], abs=1e-6)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", r"expected rob1_1 cal_offset, in MOC.cfg"),
        ("DEFDAT $MACHINE PUBLIC", r"expected rob1_1 cal_offset"),
        (moc().replace("cal_offset 3.25", "cal_offset 3,25"), r"expected rob1_2 cal_offset"),
        (moc().replace("transm_joint 118.0", "transm_joint 0"), r"expected another rob1_2 transm_joint than 0: file"),
    ],
)
def test_what_is_no_such_file_is_refused(robot, text, told):
    """Fails if another file ends in a traceback, half of a number is changed, or a gear of nothing leaves a zero as it is."""
    with pytest.raises(InputError, match=told):
        pasted("abb-moc", {Path("file"): text}, robot, calibrated(robot))


def test_zeros_are_fitted_for_what_the_file_holds(finished):
    """Fails if a controller that takes zeros alone is given those of a model with springs, or its own file is not read."""
    axes = "\n".join(f"$MAMES[{k}]=0.0" for k in (1, 2, 3))
    (finished / "machine.dat").write_text(axes, encoding="utf-8")
    made = finished.calflow("export", finished / "runs", "--to", "kuka-dat", "--beside", finished / "machine.dat")
    assert made.code == 0, made
    assert "hold mastering offsets" in made.err
    assert "fitted anew for that" in made.err
    assert set(values("kuka-dat", made.out)) == {f"$MAMES[{k}]" for k in (2, 3)}  # the first turns the base
    (told,) = finished.refused("export", finished / "runs", "--to", "kuka-dat", "--beside", finished / "nowhere.dat")
    assert "no such file" in told
    (told,) = finished.refused("export", finished / "runs", "--to", "urdf", "--beside", finished / "machine.dat")
    assert told.endswith("beside: expected no file: 'urdf' states the whole robot")
    (told,) = finished.refused("export", finished / "runs", "--to", "kuka-dat")
    assert told.startswith("--beside: expected the controller's own file")
