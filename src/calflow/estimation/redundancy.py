"""Redundancy: figures of full origins that are no parameters, since others do the same whatever the pose."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from calflow.effects.geometry import Geometry
from calflow.files.tables import column, to_frame
from calflow.robot.robot import Robot

BASE = "the base's place and turn"


@dataclass(frozen=True, kw_only=True)
class Redundant:
    """A figure of a joint's origin that is no parameter: no pose tells its error from those of others, which stand for it."""

    figure: str = column("its name, as a parameter would be called")
    joint: int = column("number of its joint")
    symbol: str = column("its symbol")
    same: str = column("what moves the tool in exactly the same way whatever the pose, with the joint's own parameters")


def redundant(robot: Robot) -> pd.DataFrame:
    """Return the figures that are left out, as a table of `Redundant`; without rows where joints are stated otherwise."""
    rows = []
    for figure in Geometry(robot).left_out:
        part, symbol = figure.split(".")
        joint = int(part.removeprefix("joint"))
        rows.append(Redundant(figure=figure, joint=joint, symbol=symbol, same=_same(robot, joint)))
    return to_frame(rows, Redundant)


def _same(robot: Robot, joint: int) -> str:
    """What does the same as the figures left out of a joint, counted from 1."""
    if joint == 1:
        return BASE
    slides = robot.joints[joint - 2].kind == "prismatic"
    shifts = "shifts of slide" if slides else "a shift along and a turn about the axis of joint"
    return f"{shifts} {joint - 1}{' and a turn about its axis' if slides else ''}"
