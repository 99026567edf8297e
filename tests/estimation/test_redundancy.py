"""Redundancy: figures that are no parameters are named, and truly do what others do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import robots
from calflow.deployment.run_outcome import RunOutcome
from calflow.estimation.identifiability import redundant
from calflow.files.tables import Results
from calflow.model import build
from calflow.reporting.blocks import Table
from calflow.reporting.sections.parameters import left_out_words
from calflow.robot.robot import Robot
from robot.formats import urdfs


def test_what_is_left_out_does_what_the_parameters_do(tmp_path: Path) -> None:
    """Fails if a figure is called redundant whose error moves the tool as no parameter does, or one is not named."""
    path = tmp_path / "tree.urdf"
    path.write_text(urdfs.tree(1))
    robot = Robot.from_urdf(path, tip="tip")
    table = redundant(robot)
    own = build(robot, ("geometry",))
    packed = robots.rows(own, robots.poses(robot, 40), marker="tip")
    slopes = own.position_jacobian(own.nominal, packed).reshape(-1, len(own.nominal))
    rank = np.linalg.matrix_rank(slopes, tol=1e-8)
    for named in table.itertuples(index=False):
        frame = robot.frames[named.joint - 1]

        def freed(step, symbol=named.symbol):
            return replace(step, free=("first", "middle", "last")) if step.symbol == symbol else step

        parts = {part: tuple(map(freed, getattr(frame, part))) for part in ("reach", "mount", "body")}
        joints = list(robot.joints)
        joints[named.joint - 1] = replace(
            joints[named.joint - 1], frame=replace(frame, turn=freed(frame.turn), **parts)
        )
        model = build(replace(robot, joints=tuple(joints)), ("geometry",))
        assert len(model.nominal) == len(own.nominal) + 1
        more = model.position_jacobian(model.nominal, packed).reshape(-1, len(model.nominal))
        assert np.linalg.matrix_rank(more, tol=1e-8) == rank


def test_the_report_has_a_row_a_joint(tmp_path: Path) -> None:
    """Fails if the page on what the data tell is silent on figures left out, or speaks of them where there are none."""
    path = tmp_path / "tree.urdf"
    path.write_text(urdfs.tree(1))
    robot = Robot.from_urdf(path, tip="tip")
    *_, told = left_out_words(RunOutcome(Results({"identify/redundant.csv": redundant(robot)})))
    assert isinstance(told, Table)
    assert [row[0] for row in told.rows] == [str(i + 1) for i in range(robot.n_joints)]
    assert told.rows[0][2] == "the base's place and turn"
    slides = [i for i, joint in enumerate(robot.joints[:-1], start=2) if joint.kind == "prismatic"]
    for joint, _, same in told.rows:
        assert ("slide" in same) == (int(joint) in slides)
    assert left_out_words(RunOutcome(Results({}))) == []
    assert redundant(robots.ur10()).empty
