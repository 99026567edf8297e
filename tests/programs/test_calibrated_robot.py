"""The calibrated robot: it knows postures as controllers do, and a corrected program lands where it says."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calflow.deployment.conventions import angle_between, pose_matrix, pose_values
from calflow.estimation.needed_conditions import NeededCondition
from calflow.measurements.measurements import Measurements
from calflow.model import build
from calflow.programs import correction
from calflow.programs.aims import FilterSettings
from calflow.programs.calibrated_robot import CalibratedRobot
from calflow.programs.filtering import filter_program
from calflow.programs.formats import parsed, read_project
from calflow.programs.target import KrlConfiguration, RapidConfiguration
from calflow.robot.mechanism import nominal_posture
from estimation.data import calibration
from programs.samples import filtered
from robots import ASKEW, industrial, robot, ur10

TOOL = pose_matrix([0.0974, 0.0, 0.2231, 0.924, 0.0, 0.383, 0.0], "quaternion")
NUMBERS = "[[97.4,0,223.1],[0.924,0,0.383,0]]"
NO_AXES = "[9E9,9E9,9E9,9E9,9E9,9E9]"


def calibrated(of, effects=("geometry",), sizes=0.0, **conditions):
    """A robot whose errors are known, of so many prior standard deviations."""
    robot = replace(of, base=ASKEW)

    def rows(q):
        load = {"payload": "load"} if robot.payloads else {}
        return Measurements.from_arrays(robot, q, None, pose=np.arange(len(q)), **load, **conditions)

    model = build(robot, effects, tuple(conditions))
    rng = np.random.default_rng(3)
    p = np.clip(model.nominal + sizes * model.prior_sd * rng.standard_normal(len(model.nominal)), *model.bounds.T)
    return CalibratedRobot(calibration(model, p, 1e-16 * np.eye(len(p)), sigma=1e-5), rows)


def rapid_program(corrector, readings):
    """A program in RAPID that goes to readings, as poses and as joints."""
    lines = ["MODULE Weld", f"  PERS tooldata gun:=[TRUE,{NUMBERS},[5,[23,0,75],[1,0,0,0],0,0,0]];"]
    for k, (q, flange) in enumerate(zip(readings, corrector.flange(readings), strict=True)):
        values = pose_values(flange @ TOOL, "quaternion", np.array([0, 0, 0, 1, 0, 0, 0.0]))
        place, turn = (",".join(f"{v:.{n}f}" for v in part) for part, n in ((1e3 * values[:3], 5), (values[3:], 9)))
        flags = ",".join(RapidConfiguration(()).of(corrector.postures(q[None])[0]))
        lines.append(f"  CONST robtarget p{k}:=[[{place}],[{turn}],[{flags}],{NO_AXES}];")
    joints = ",".join(f"{v:.6f}" for v in np.rad2deg(readings[0]))
    lines += [f"  CONST jointtarget home:=[[{joints}],{NO_AXES}];", "  PROC main()", "    MoveAbsJ home,v100,fine,gun;"]
    lines += [f"    MoveL p{k},v100,fine,gun;" for k in range(len(readings))]
    return "\r\n".join([*lines, "  ENDPROC", "ENDMODULE", ""]).encode()


def usual(corrector, n, seed=5):
    """Joint readings far from limits and singularities."""
    low, high = corrector.robot.limits.T
    q = np.random.default_rng(seed).uniform(np.maximum(low, -1.2), np.minimum(high, 1.2), (n, corrector.n_joints))
    q[:, 4] = np.where(np.abs(q[:, 4]) < 0.4, 0.7, q[:, 4])
    return q


def test_a_model_that_changes_nothing_leaves_a_program_to_the_last_byte():
    """Fails if the way through joint readings and back changes a target."""
    corrector = calibrated(industrial())
    source = rapid_program(corrector, usual(corrector, 4))
    done = filtered(parsed(source, Path("weld.mod")), corrector, FilterSettings({}, {}))
    assert done.source == source
    assert [row.outcome for row in done.rows] == ["unchanged"] * 5


def test_a_corrected_program_lands_where_it_says():
    """Fails if the real tool, at readings that the controller works out by itself, misses a target by more than digits do."""
    corrector = calibrated(industrial(), ("geometry", "joint-compliance"), 0.3)
    readings = usual(corrector, 4)
    program = parsed(rapid_program(corrector, readings), Path("weld.mod"))
    done = filtered(program, corrector, FilterSettings({}, {}))
    assert {row.outcome for row in done.rows} == {"moved"}
    assert max(row.moved_mm for row in done.rows) > 1
    before = [pose_matrix(target.values, "quaternion") for target in program.targets[:4]]
    after = [target.values for target in parsed(done.source, Path("weld.mod")).targets]
    commands = [inverted(pose_matrix(values, "quaternion") @ np.linalg.inv(TOOL), q)
                for values, q in zip(after[:4], readings, strict=True)]  # fmt: skip
    landed = truly(corrector, np.array([*commands, after[4]])) @ TOOL
    for place, aim in zip(landed, [*before, corrector.flange(readings[:1])[0] @ TOOL], strict=True):
        assert np.linalg.norm(place[:3, 3] - aim[:3, 3]) < 3e-6
        assert angle_between(place, aim) < 5e-6


def test_what_is_promised_of_a_tool_is_not_what_is_known_of_the_marker():
    """Fails if what positions of one marker leave open of the flange, its turn, is not in the error promised of another point."""
    corrector, turn = calibrated(industrial(), sizes=0.1), 2e-3
    known = corrector.calibrated
    covariance, names = np.zeros_like(known.covariance), [parameter.name for parameter in known.model.parameters]
    k = names.index("joint6.theta")
    covariance[k, k] = turn**2
    corrector = replace(corrector, calibrated=replace(known, covariance=covariance))
    source = rapid_program(corrector, usual(corrector, 4))
    done = filtered(parsed(source, Path("weld.mod")), corrector, FilterSettings({}, {}))
    off_axis = 1e3 * np.hypot(*TOOL[:2, 3])
    assert [row.promised_mm for row in done.rows if row.kind == "pose"] == pytest.approx(
        [turn * off_axis] * 4, rel=1e-3
    )
    assert any("how flange and marker lie to each other" in note for note in done.notes)


def inverted(flange, near):
    """The controller's readings at a pose, by plain numpy of the maker's figures."""
    alpha, a, d = np.deg2rad((0, -90, 0, -90, 90, -90)), (0, 0.312, 1.075, 0.225, 0, 0), (0.67, 0, 0, 1.28, 0, 0.215)
    theta = np.deg2rad((0, -90, 0, 0, 0, 180))

    def off(q):
        pose = np.eye(4)
        for k in range(6):
            turn = Rotation.from_euler("x", alpha[k]) * Rotation.from_euler("z", theta[k] + q[k])
            step = np.eye(4)
            step[:3, :3] = turn.as_matrix()
            step[:3, 3] = np.array([a[k], 0, 0]) + step[:3, :3] @ [0, 0, d[k]]
            pose = pose @ step
        apart = Rotation.from_matrix(flange[:3, :3].T @ pose[:3, :3]).as_rotvec()
        return np.concatenate([pose[:3, 3] - flange[:3, 3], apart])

    return least_squares(off, near, xtol=1e-15, ftol=1e-15, gtol=1e-15).x


def truly(corrector, readings):
    """Where the flange is by the calibrated model, in the base that it found, read off where its marker is."""
    known, model = corrector.calibrated, corrector.calibrated.model
    conditions = corrector.rows(readings).conditions
    parameter = dict(zip([p.name for p in model.parameters], known.estimate, strict=True))
    base = np.eye(4)
    base[:3, 3] = [parameter[f"base.{axis}"] for axis in "xyz"]
    base[:3, :3] = Rotation.from_euler("XYZ", [parameter[f"base.r{axis}"] for axis in "xyz"]).as_matrix()
    stands = np.eye(4)
    stands[:3, 3], stands[:3, :3] = ASKEW.origin, Rotation.from_euler("XYZ", ASKEW.rotation).as_matrix()
    marker = np.array(corrector.robot.markers["E"].point)
    marker = marker + [parameter[f"E.{axis}"] for axis in "xyz"]
    flange = np.tile(np.eye(4), (len(readings), 1, 1))
    flange[:, :3, :3] = model.rotation(known.estimate, conditions)
    flange[:, :3, 3] = model.point(known.estimate, conditions) - flange[:, :3, :3] @ marker
    return np.linalg.inv(stands @ base) @ flange


R2000 = {  # of an R-2000iB/165F, counted as its controller counts; its world is where axes 1 and 2 meet in height
    "alpha_deg": (0, -90, 0, -90, 90, -90), "a_m": (0, 0.312, 1.075, 0.225, 0, 0), "d_m": (0, 0, 0, 1.28, 0, 0.27),
    "theta_deg": (0, -90, 0, 0, 0, 0), "sign": (1, 1, -1, -1, -1, -1),
    "limits_deg": ((-180, 180), (-60, 76), (-132, 230), (-360, 360), (-125, 125), (-360, 360)),
}  # fmt: skip
SHOWN = """/PROG  POSES
/ATTR
/MN
   1:J P[1] 100% FINE    ;
/POS
P[1]{
   GP1:
\tUF : 0, UT : 0,\t\tCONFIG : 'N U T, 0, 0, 0',
\tX =  1500.000  mm,\tY =     0.000  mm,\tZ =   360.000  mm,
\tW =   135.000 deg,\tP =   -45.000 deg,\tR =     0.000 deg
};
P[2]{
   GP1:
\tUF : 0, UT : 0,\t\tCONFIG : 'F U T, 0, 0, 0',
\tX =  1500.000  mm,\tY =     0.000  mm,\tZ =   360.000  mm,
\tW =   135.000 deg,\tP =   -45.000 deg,\tR =     0.000 deg
};
/END
"""


def test_a_controller_shows_the_readings_that_its_configuration_means():
    """Fails if W, P, R or N and F are taken otherwise than by the controller whose display these figures are from."""
    joints = [dict(zip(R2000, values, strict=True)) for values in zip(*R2000.values(), strict=True)]
    corrector = calibrated(robot("modified-dh", joints, couplings=[{"joint": 3, "source": 2, "factor": -1.0}]))
    asked: list[np.ndarray] = []

    class Watched(CalibratedRobot):
        def corrected(self, readings, tools, names, runs):
            asked.append(readings)
            return super().corrected(readings, tools, names, runs)

    watched = Watched(corrector.calibrated, corrector.rows)
    done = filtered(parsed(SHOWN.encode(), Path("poses.ls")), watched, FilterSettings({}, {}))
    assert [row.outcome for row in done.rows] == ["unchanged"] * 2
    shown = [(7.962, -5.284, -36.25, 77.661, -51.975, -79.273), (7.962, -5.284, -36.25, -102.339, 51.975, 100.727)]
    np.testing.assert_allclose(np.rad2deg(asked[0]), shown, atol=0.02)


@pytest.mark.parametrize(("sign", "turned"), [(1, False), (-1, False), (1, True)])
def test_the_coupling_that_a_note_states_keeps_the_forearm_level(tmp_path, sign, turned):
    """Fails if the note on FANUC's joint 3 states a factor with which joint 2 still turns the forearm."""
    joints = [dict(zip(R2000, values, strict=True)) for values in zip(*R2000.values(), strict=True)]
    joints[1]["sign"] = sign
    if turned:  # joint 3's axis, the other way round
        joints[2]["alpha_deg"], joints[3]["alpha_deg"] = 180.0, joints[3]["alpha_deg"] + 180.0
    program = tmp_path / "weld.ls"
    program.write_bytes(fanuc_joints(np.zeros((1, 6)), [0]).encode())
    (note,) = [
        note for note in filter_program(calibrated(robot("modified-dh", joints)).calibrated, program).notes
        if "[[couplings]]" in note
    ]  # fmt: skip
    numbers = {key: int(value) for key, value in re.findall(r"(joint|source|factor) = (-?\d+)", note)}
    coupled = robot("modified-dh", joints, couplings=[numbers])
    level, leaning = (
        np.array(ca.DM(nominal_posture(coupled, coupled.reading_matrix @ reading).joints[2][:3, :3]))
        for reading in ([0, 0.0, 0.2, 0, 0, 0], [0, 0.4, 0.2, 0, 0, 0])
    )
    np.testing.assert_allclose(leaning, level, atol=1e-12)


def test_base_and_flange_of_the_controller_may_be_elsewhere():
    """Fails if a program whose poses are counted from another base, to another flange, is not reached or moved otherwise."""
    corrector = calibrated(industrial(), ("geometry",), 0.3)
    source = rapid_program(corrector, usual(corrector, 3))
    plain = filtered(parsed(source, Path("w.mod")), corrector, FilterSettings({}, {}))
    base, flange = pose_matrix([0, 0, 0.67, 0, 0, 0], "xyz"), pose_matrix([0, 0, 0, 0, 0, np.pi], "xyz")
    tool = np.linalg.inv(flange) @ TOOL
    other = filtered(
        parsed(source, Path("w.mod")),
        corrector,
        FilterSettings({"gun": tool}, {"wobj0": np.linalg.inv(base)}, base=base, flange=flange),
    )
    assert other.source == plain.source


def test_flags_of_no_way_are_said():
    """Fails if a target whose flags fit nothing is moved unasked, or cannot be moved when it is asked for."""
    corrector = calibrated(industrial(), ("geometry",), 0.3)
    source = rapid_program(corrector, usual(corrector, 2))
    flags = ",".join(RapidConfiguration(()).of(corrector.postures(usual(corrector, 2))[1]))
    wrong = source.replace(f",[{flags}],".encode(), b",[3,3,3,0],")
    assert wrong != source
    done = filtered(parsed(wrong, Path("w.mod")), corrector, FilterSettings({}, {}))
    (row,) = [row for row in done.rows if row.outcome == "left alone"]
    assert "configuration" in row.note
    done = filtered(parsed(wrong, Path("w.mod")), corrector, FilterSettings({}, {}, any_configuration=True))
    assert [row.outcome for row in done.rows].count("moved") == 3
    assert any("configuration" in row.note for row in done.rows)


@pytest.mark.parametrize(("switched", "moved"), [("ConfL\\Off;", 3), ("ConfJ\\Off;", 2), ("ConfL\\On;", 2)])
def test_flags_that_the_controller_does_not_heed_do_not_bind(switched, moved):
    """Fails if a move under ConfL\\Off, stays as it is because its flags fit nothing; or another does not."""
    corrector = calibrated(industrial(), ("geometry",), 0.3)
    source = rapid_program(corrector, usual(corrector, 2))
    flags = ",".join(RapidConfiguration(()).of(corrector.postures(usual(corrector, 2))[1]))
    wrong = source.replace(f",[{flags}],".encode(), b",[3,3,3,0],")
    switched_off = wrong.replace(b"  PROC main()", f"  PROC main()\r\n    {switched}".encode())
    done = filtered(parsed(switched_off, Path("w.mod")), corrector, FilterSettings({}, {}))
    assert [row.outcome for row in done.rows].count("moved") == moved


def test_joints_at_a_singularity_are_told_from_what_is_out_of_reach():
    """Fails if joint targets at which a small correction would turn the wrist far look as if the base were elsewhere."""
    corrector = calibrated(industrial(), ("geometry",), 0.3)
    straight = usual(corrector, 1)[0]
    straight[4] = 0.0
    joints = ",".join(f"{v:.6f}" for v in np.rad2deg(straight))
    source = f"MODULE M\n  CONST jointtarget home:=[[{joints}],{NO_AXES}];\nENDMODULE\n".encode()
    (row,) = filtered(parsed(source, Path("m.mod")), corrector, FilterSettings({}, {})).rows
    assert (row.outcome, row.reason) == ("not reached", "singularity")


def with_play(b: float) -> CalibratedRobot:
    """An arm that is as its maker says but for play b [rad] of joint 2, and moves in the order of its programs."""
    plain = calibrated(industrial(), ("geometry", "joint-backlash"))
    names = [parameter.name for parameter in plain.calibrated.model.parameters]
    estimate = np.zeros(len(names))
    estimate[next(k for k, name in enumerate(names) if name.startswith("joint2") and name.endswith(".b"))] = b
    given = ("approach", "travel")
    known = replace(plain.calibrated, estimate=estimate, model=replace(plain.calibrated.model, given=given))
    needed = NeededCondition(condition="approach", effects=("joint-backlash",), columns="approach1", spread_mm=1.0)
    return CalibratedRobot(replace(known, needed=(needed,)), plain.rows, in_order=True)


def rapid_joints(readings: np.ndarray, moves: Sequence[int]) -> str:
    joints = [",".join(f"{v:.6f}" for v in np.rad2deg(one)) for one in readings]
    lines = [f"  CONST jointtarget j{k}:=[[{one}],{NO_AXES}];" for k, one in enumerate(joints)]
    goes = [f"    MoveAbsJ j{k},v100,fine,tool0;" for k in moves]
    return "\n".join(["MODULE M", *lines, "  PROC main()", *goes, "  ENDPROC", "ENDMODULE", ""])


def fanuc_joints(readings: np.ndarray, moves: Sequence[int]) -> str:
    goes = [f"   {n}:J P[{k + 1}] 100% FINE    ;" for n, k in enumerate(moves, 1)]
    lines = []
    for k, one in enumerate(np.rad2deg(readings), 1):
        axes = ", ".join(f"J{j} = {v:.6f} deg" for j, v in enumerate(one, 1))
        lines += [f"P[{k}]{{", "   GP1:", f"    UF : 0, UT : 1,    {axes}", "};"]
    return "\n".join(["/PROG  P", "/ATTR", "/MN", *goes, "/POS", *lines, "/END", ""])


def test_joints_that_come_from_either_side_are_told_apart():
    """Fails if play is not made up for by the side from which a joint comes, as the order of the targets has it."""
    b, corrector = 1e-3, with_play(1e-3)
    readings = np.tile(usual(corrector, 1), (3, 1))
    readings[1, 1] += 0.2
    program = parsed(rapid_joints(readings, ()).encode(), Path("m.mod"))
    done = filtered(program, corrector, FilterSettings({}, {}))
    after = parsed(done.source, Path("m.mod")).targets
    moved = [new.values[1] - old.values[1] for old, new in zip(program.targets, after, strict=True)]
    np.testing.assert_allclose(moved, [0, -b / 2, b / 2], atol=2e-8)


@pytest.mark.parametrize(("written", "name"), [(rapid_joints, "m.mod"), (fanuc_joints, "p.ls")])
def test_sides_of_approach_follow_from_the_moves_not_from_the_declarations(written, name):
    """Fails if play is made up for by the order in which targets are declared, or by one side where moves come from both."""
    b, corrector = 1e-3, with_play(1e-3)
    readings = np.tile(usual(corrector, 1), (4, 1))
    readings[:, 1] += [0.0, 0.1, 0.2, 0.3]
    moves = [0, 2, 1, 3, 2, 3]  # joint 2 comes to number 1 from above, to 2 from either side, to 3 from below
    program = parsed(written(readings, moves).encode(), Path(name))
    done = filtered(program, corrector, FilterSettings({}, {}))
    after = parsed(done.source, Path(name)).targets
    moved = np.array([new.values[1] - old.values[1] for old, new in zip(program.targets, after, strict=True)])
    sides = np.array([0, -1, 0, 1])
    np.testing.assert_allclose(moved, -sides * b / 2, atol=2e-8)
    remaining = {row.name: row.remaining_mm for row in done.rows}
    (between,) = [mm for mm in remaining.values() if mm > 0.01]
    assert between == remaining[program.targets[2].name]


def test_sides_of_approach_follow_in_each_file_of_a_project():
    """Fails if a KUKA module, whose moves and data are two files, has no order, or the side goes on from file to file."""
    b, corrector = 1e-3, with_play(1e-3)
    readings = np.tile(usual(corrector, 1), (4, 1))
    readings[:, 1] += [0.0, 0.1, 0.2, 0.3]
    j = ["{" + ", ".join(f"A{k} {v:.6f}" for k, v in enumerate(np.rad2deg(q), 1)) + "}" for q in readings]
    files = {
        "a.dat": f"DEFDAT A\nDECL E6AXIS X1={j[1]}\nDECL E6AXIS X0={j[0]}\nENDDAT\n",
        "a.src": f"DEF A( )\nPTP X0\nPTP X1\nPTP {j[2]}\nEND\n",
        "b.src": f"DEF B( )\nPTP {j[3]}\nPTP {j[2]}\nEND\n",
    }
    programs, _ = read_project({name: text.encode() for name, text in files.items()}, Path())
    done = correction.filtered(programs, corrector, FilterSettings({}, {}))
    later, _ = read_project(done.files, Path())
    moved = [
        new.values[1] - old.values[1]
        for before, after in zip(programs, later, strict=True)
        for old, new in zip(before.targets, after.targets, strict=True)
    ]
    np.testing.assert_allclose(moved, np.array([-1, 0, -1, 0, 1]) * b / 2, atol=2e-8)


def test_after_a_move_to_an_unknown_place_the_side_of_approach_is_unknown():
    """Fails if play is made up for as if the robot came from the target before, or is not in what is promised."""
    b, corrector = 1e-3, with_play(1e-3)
    readings = np.tile(usual(corrector, 1), (3, 1))
    readings[:, 1] += [0.0, 0.1, 0.2]
    source = rapid_joints(readings, range(3)).replace(
        "    MoveAbsJ j2", "    MoveAbsJ jUnknown,v9,fine,tool0;\n    MoveAbsJ j2"
    )
    program = parsed(source.encode(), Path("m.mod"))
    done = filtered(program, corrector, FilterSettings({}, {}))
    after = parsed(done.source, Path("m.mod")).targets
    moved = [new.values[1] - old.values[1] for old, new in zip(program.targets, after, strict=True)]
    np.testing.assert_allclose(moved, [0, -b / 2, 0], atol=2e-8)
    promised = {row.name: row.promised_mm for row in done.rows if row.kind}
    assert promised["j1"] < 0.5 < min(promised["j0"], promised["j2"])  # spread_mm is 1


def test_what_nothing_tells_follows_the_target_before():
    """Fails if a way without flags leaves the joint positions that it goes on in, or that it was assumed is not said."""
    corrector = calibrated(ur10(), ("geometry",), 0.3)
    way = usual(corrector, 1)[0] + np.linspace(0, 0.3, 5)[:, None] * np.array([1, -0.5, 0.7, 0.3, 0.4, -0.6])
    poses = [pose_values(one, "vector", np.zeros(6)) for one in corrector.flange(way)]
    lines = [f"movel(p[{','.join(f'{v:.9f}' for v in one)}])" for one in poses[1:]]
    start = f"movej([{','.join(f'{v:.9f}' for v in way[0])}])"
    source = "\n".join(["set_tcp(p[0,0,0,0,0,0])", start, *lines, ""]).encode()
    done = filtered(parsed(source, Path("p.script")), corrector, FilterSettings({}, {}))
    assert [row.outcome for row in done.rows] == ["moved"] * 5
    assert all("nearest to the target before" in row.note for row in done.rows[1:])
    plain = corrector.corrected(way, np.zeros((5, 3)), list("abcde"), [range(5)])
    told = np.rad2deg(np.abs(plain.readings - way).max(axis=1))
    np.testing.assert_allclose([row.largest_deg for row in done.rows], told, rtol=1e-4)


def test_a_nearer_way_is_taken_where_the_search_found_but_one(monkeypatch):
    """Fails if the one solution that a search found stands where another is nearer, or the search never ends."""
    from calflow.programs import postures

    whole, sought = ur10(), postures._nearer
    arm = replace(whole, joints=tuple(replace(joint, limits=(-3.1, 3.1)) for joint in whole.joints))
    corrector = calibrated(arm, ("geometry",), 0.3)
    turns = iter(range(9))  # one more than targets without flags, of which each may lead the next elsewhere

    def few(*arguments):
        assert next(turns, None) is not None, "the search does not end"
        return sought(*arguments)

    monkeypatch.setattr(postures, "_nearer", few)
    monkeypatch.setattr(postures, "STARTS_ALONE", 1)
    way = usual(corrector, 1, seed=7)[0] + np.linspace(0, 0.3, 8)[:, None] * np.array([1, -0.5, 0.7, 0.3, 0.4, -0.6])
    start = f"movej([{','.join(f'{v:.9f}' for v in way[0])}])"
    poses = [pose_values(one, "vector", np.zeros(6)) for one in corrector.flange(way)[1:]]
    lines = [f"movel(p[{','.join(f'{v:.9f}' for v in one)}])" for one in poses]
    source = "\n".join(["set_tcp(p[0,0,0,0,0,0])", start, *lines, ""]).encode()
    done = filtered(parsed(source, Path("p.script")), corrector, FilterSettings({}, {}))
    told = np.abs(corrector.corrected(way, np.zeros((8, 3)), list("abcdefgh"), [range(8)]).readings - way).max(axis=1)
    np.testing.assert_allclose([row.largest_deg for row in done.rows], np.rad2deg(told), rtol=1e-4)


def test_what_cannot_be_reached_or_told_stays_and_is_named():
    """Fails if a target out of reach is moved, or a posture that the program does not tell is guessed."""
    corrector = calibrated(ur10(), ("geometry",), 0.3)
    q = usual(corrector, 2)
    poses = [pose_values(one, "vector", np.zeros(6)) for one in corrector.flange(q)]
    near, told = (",".join(f"{v:.9f}" for v in one) for one in (q[1], poses[1]))
    source = (
        "def P():\n  set_tcp(p[0,0,0,0,0,0])\n"
        f"  movel(p[{','.join(f'{v:.9f}' for v in poses[0])}])\n"
        f"  movej(get_inverse_kin(p[{told}], qnear=[{near}]))\n"
        "  movel(p[9.0,0.2,0.3,0,3.14,0])\nend\n"
    ).encode()
    done = filtered(parsed(source, Path("p.script")), corrector, FilterSettings({}, {}))
    rows = {row.line: row for row in done.rows}
    assert (rows[3].outcome, rows[4].outcome, rows[5].outcome) == ("left alone", "moved", "not reached")
    assert "--start" in rows[3].note
    kept, other = source.splitlines(), done.source.splitlines()
    assert [k for k, (a, b) in enumerate(zip(kept, other, strict=True), 1) if a != b] == [4]
    begun = filtered(parsed(source, Path("p.script")), corrector, FilterSettings({}, {}, start=tuple(q[0])))
    assert [row.outcome for row in begun.rows] == ["moved", "moved", "not reached"]


@pytest.mark.parametrize("flags", [RapidConfiguration, KrlConfiguration])
def test_flags_tell_all_ways_to_a_pose_apart(flags):
    """Fails if two ways to a pose have the same flags, or none has those of the readings that it was made from."""
    corrector = calibrated(industrial())
    for q, ways in zip(
        usual(corrector, 3),
        corrector.solutions(corrector.flange(usual(corrector, 3)), 60, [None] * 3, np.zeros((3, 6))),
        strict=True,
    ):
        assert np.abs(ways - q).max(axis=1).min() < 1e-6
        named = corrector.postures(ways)
        seen = [(one.front, one.elbow, *np.sign(one.readings)) for one in named]
        if flags is RapidConfiguration:
            seen = [flags(()).of(one) for one in named]
        assert len(set(seen)) == len(seen) >= 2


def test_a_joint_without_limits_has_the_turns_that_flags_count():
    """Fails if a target beyond half a turn of a joint without limits is not found by its flags, or by readings near it."""
    plain = industrial()
    endless = replace(plain, joints=(*plain.joints[:5], replace(plain.joints[5], limits=None)))
    corrector = calibrated(endless, ("geometry",), 0.3)
    readings = usual(corrector, 3)
    readings[1:, 5] = 4.0, -4.0  # cf6 = 2 and -3
    done = filtered(parsed(rapid_program(corrector, readings), Path("weld.mod")), corrector, FilterSettings({}, {}))
    assert [(row.outcome, row.note) for row in done.rows] == [("moved", "")] * 4
    pose = ",".join(f"{v:.9f}" for v in pose_values(corrector.flange(readings[1:2])[0], "vector", np.zeros(6)))
    near = ",".join(f"{v:.9f}" for v in readings[1])
    source = f"set_tcp(p[0,0,0,0,0,0])\nmovej(get_inverse_kin(p[{pose}], qnear=[{near}]))\n".encode()
    (row,) = filtered(parsed(source, Path("p.script")), corrector, FilterSettings({}, {})).rows
    assert row.outcome == "moved"
