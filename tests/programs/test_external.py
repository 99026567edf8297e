"""External axes of programs: a rail's value says where the arm stands, a robot without one keeps the bytes and says so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calflow.deployment.conventions import angle_between, pose_matrix, pose_values
from calflow.programs.aims import FilterSettings
from calflow.programs.calibrated_robot import Axes
from calflow.programs.formats import parsed
from calflow.programs.target import External, RapidConfiguration
from calflow.robot.frames import modified_dh
from calflow.robot.parts import Joint
from programs.samples import FILES, SIX, Hand, filtered
from programs.test_calibrated_robot import NUMBERS, TOOL, calibrated, inverted, truly, usual
from robots import industrial

RAILS = (-1.25, 0.4, 0.4, 1.75)  # m
AWAY = "[{mm},9E9,9E9,9E9,9E9,9E9]"


def on_rail():
    """The arm of the other tests on a rail along -y of the base."""
    arm = industrial()
    rail = Joint(modified_dh(alpha=np.pi / 2), kind="prismatic", limits=(-2, 2), external=1, mass=100, name="rail")
    figures = {**arm.joints[0].frame.figures, "alpha": -np.pi / 2}
    swivel = replace(arm.joints[0], frame=modified_dh(**figures))
    return replace(arm, joints=(rail, swivel, *arm.joints[1:]))


def program(corrector, arms, axes=AWAY):
    """A program in RAPID that goes to readings of the arm from places along the rail, as poses and as joints."""
    lines = ["MODULE Weld", f"  PERS tooldata gun:=[TRUE,{NUMBERS},[5,[23,0,75],[1,0,0,0],0,0,0]];"]
    readings = np.column_stack([RAILS, arms])
    for k, (q, flange) in enumerate(zip(readings, corrector.flange(readings), strict=True)):
        values = pose_values(flange @ TOOL, "quaternion", np.array([0, 0, 0, 1, 0, 0, 0.0]))
        place, turn = (",".join(f"{v:.{n}f}" for v in part) for part, n in ((1e3 * values[:3], 5), (values[3:], 9)))
        flags = ",".join(RapidConfiguration(()).of(corrector.postures(q[None])[0]))
        away = axes.format(mm=f"{1e3 * q[0]:.1f}")
        lines.append(f"  CONST robtarget p{k}:=[[{place}],[{turn}],[{flags}],{away}];")
    joints = ",".join(f"{v:.6f}" for v in np.rad2deg(arms[0]))
    lines += [f"  CONST jointtarget home:=[[{joints}],{axes.format(mm=f'{1e3 * RAILS[0]:.1f}')}];", "  PROC main()"]
    lines += ["    MoveAbsJ home,v100,fine,gun;", *(f"    MoveL p{k},v100,fine,gun;" for k in range(len(arms)))]
    return "\r\n".join([*lines, "  ENDPROC", "ENDMODULE", ""]).encode()


@pytest.fixture(scope="module")
def arms():
    """Readings of the arm."""
    return usual(calibrated(industrial()), len(RAILS))


def test_a_model_that_changes_nothing_leaves_a_program_on_a_rail(arms):
    """Fails if the rail's place is not the target's when its joint readings are looked for."""
    corrector = calibrated(on_rail())
    source = program(corrector, arms)
    done = filtered(parsed(source, Path("weld.mod")), corrector, FilterSettings({}, {}))
    assert done.source == source
    assert [row.outcome for row in done.rows] == ["unchanged"] * 5
    assert not any("external" in note for note in done.notes)


def test_a_corrected_program_on_a_rail_lands_where_it_says(arms):
    """Fails if a correction moves the rail, or the errors of rail and arm are not those of the place along it."""
    corrector = calibrated(on_rail(), ("geometry",), 0.3)
    read = parsed(program(corrector, arms), Path("weld.mod"))
    done = filtered(read, corrector, FilterSettings({}, {}))
    assert {row.outcome for row in done.rows} == {"moved"}
    again = parsed(done.source, Path("weld.mod"))
    assert [target.external for target in again.targets] == [target.external for target in read.targets]
    commands, aims = [], []
    for before, after, rail, q in zip(read.targets, again.targets, RAILS, arms, strict=False):
        wagon = np.eye(4)
        wagon[1, 3] = -rail
        flange = pose_matrix(after.values, "quaternion") @ np.linalg.inv(TOOL)
        commands.append([rail, *inverted(np.linalg.inv(wagon) @ flange, q)])
        aims.append(pose_matrix(before.values, "quaternion"))
    commands.append([RAILS[0], *again.targets[4].values])
    aims.append(corrector.flange(np.array([[RAILS[0], *read.targets[4].values]]))[0] @ TOOL)
    for place, aim in zip(truly(corrector, np.array(commands)) @ TOOL, aims, strict=True):
        assert np.linalg.norm(place[:3, 3] - aim[:3, 3]) < 3e-6
        assert angle_between(place, aim) < 5e-6


def test_a_target_that_does_not_say_where_the_rail_is_is_left_alone(arms):
    """Fails if a rail of which the program says nothing counts as at 0."""
    corrector = calibrated(on_rail(), ("geometry",), 0.3)
    source = program(corrector, arms, "[9E9,9E9,9E9,9E9,9E9,9E9]")
    done = filtered(parsed(source, Path("weld.mod")), corrector, FilterSettings({}, {}))
    assert done.source == source
    assert {(row.outcome, row.note) for row in done.rows} == {
        ("left alone", "gives no value of external axis 1, which the robot file has")
    }


SAID = {  # what the samples give of external axes other than 0, the others have none; and what is told of it
    "weld.mod": (
        [{1: External(11.0), 2: External(12.3)}] * 4,
        "4 targets give values of external axes 1, 2: these stay",
    ),
    "weld.dat": ([{1: External(812.25)}], "1 target gives values of external axis 1: these stay"),
    "weld.ls": ([{1: External(12.0, "mm")}], "1 target gives values of external axis 1: these stay"),
}


@pytest.mark.parametrize("name", SAID)
def test_values_of_axes_that_the_robot_has_not_stay_and_are_told(name):
    """Fails if external axes' bytes change, are taken for the arm's, or a user hears nothing of a rail that he has."""
    text, choices = FILES[name]
    said, words = SAID[name]
    source = text.replace("T 35,E1 0.0", "T 35,E1 812.25").encode()
    read = parsed(source, Path(name))
    given = [{k: one for k, one in target.external.items() if one.value} for target in read.targets]
    assert [one for one in given if one] == said
    for shift in ((0.0,) * 6, (0.001,) * 6):
        done = filtered(read, Hand(shift), choices)
        assert [target.external for target in parsed(done.source, Path(name)).targets] == [
            t.external for t in read.targets
        ]
        assert [note for note in done.notes if note.startswith(words)] == list(done.notes)
        assert len(done.notes) == 1


def test_zeros_of_external_axes_are_not_told():
    """Fails if every program of KUKA's, which writes E1 0.0 … of axes that there are not, makes a note."""
    text, choices = FILES["weld.dat"]
    assert filtered(parsed(text.encode(), Path("weld.dat")), Hand(), choices).notes == ()


def test_an_axis_in_another_unit_than_the_robots_is_left_alone():
    """Fails if degrees of a table move a rail by millimetres."""
    turning, sliding = (
        Axes(replace(SIX, joints=(Joint(modified_dh(), kind=kind, limits=(-3, 3), external=1), *SIX.joints)))
        for kind in ("revolute", "prismatic")
    )
    read = parsed(FILES["weld.ls"][0].encode(), Path("weld.ls"))
    assert turning.external_problem(read.targets[0]) == "gives external axis 1 in mm, which by the robot file is in deg"
    assert sliding.external_readings(read.targets[0])[0] == pytest.approx(0.012)
