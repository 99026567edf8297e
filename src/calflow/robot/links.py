"""The ways along a chain: from a link's end to the next joint's axis, and from there to that link's own end."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import casadi as ca

from calflow.robot.dimensions import Dimensions
from calflow.robot.frames import Step
from calflow.robot.robot import Robot
from calflow.robot.transforms import elementary

Figures = Mapping[str, ca.SX]


def figures(robot: Robot, dims: Dimensions, joint: int) -> dict[str, ca.SX]:
    """Return the values of a joint's steps (its index from 0) by symbol [rad and m]."""
    return {step.symbol: dims.steps[robot.step_index(joint, step.symbol)] for step in robot.frames[joint].steps}


def along(at: ca.SX, steps: Iterable[Step], values: Figures) -> ca.SX:
    """Return the frame (4, 4) to which steps lead from a frame."""
    for step in steps:
        at = at @ elementary(step.motion, values[step.symbol])
    return at


def to_axis(at: ca.SX, robot: Robot, dims: Dimensions, joint: int) -> ca.SX:
    """Return the frame on a joint's axis, before it turns, from that at the end of the link before (the base's for joint 0)."""
    frame = robot.frames[joint]
    return along(at, frame.mount if joint else (*frame.reach, *frame.mount), figures(robot, dims, joint))


def to_end(at: ca.SX, robot: Robot, dims: Dimensions, joint: int) -> ca.SX:
    """Return the frame at the end of a joint's link, from the link's own."""
    following = joint + 1
    if following == robot.n_joints:
        return at
    return along(at, robot.frames[following].reach, figures(robot, dims, following))


def span(robot: Robot, dims: Dimensions, joint: int) -> ca.SX:
    """Return the transform (4, 4) from a joint's axis to the end of its link; that of a slide at zero."""
    link = along(ca.SX.eye(4), robot.frames[joint].body, figures(robot, dims, joint))
    return to_end(link, robot, dims, joint)
