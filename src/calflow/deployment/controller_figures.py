"""Controller figures: what a calibration is to be typed into a robot's controller as, in mm and degrees."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from calflow.deployment.programs.orientation import nearest_vector
from calflow.files.tables import column
from calflow.robot.angles import angles
from calflow.robot.frames import Step
from calflow.robot.robot import Robot


@dataclass(frozen=True, kw_only=True)
class ControllerFigure:
    """A figure of a controller: as the maker has it, as calibrated, and their difference."""

    part: str = column("joint 1 …, loop, base (in the measuring frame), tool, or a marker (in the flange's frame)")
    figure: str = column(
        "symbol; of a base and tool besides A B C (KUKA: about z, y, x in turn), W P R (FANUC: about fixed x, y, z), q1 … q4 "
        "(ABB: w, x, y, z) and vx vy vz (Universal Robots: axis times angle)"
    )
    unit: str = column("mm, deg, rad, or 1")
    nominal: float = column("as the robot file has it")
    calibrated: float = column("as calibrated")
    difference: float = column("calibrated minus nominal; of angles the shorter way round")


def controller_figures(nominal: Robot, calibrated: Robot) -> list[ControllerFigure]:
    """Return the figures of a calibrated robot beside those of the maker's.

    Of the ways in which a quaternion or a rotation vector states the same turn, the calibrated robot has the one near the maker's.
    """
    return [
        ControllerFigure(
            part=part, figure=name, unit=unit, nominal=before, calibrated=after, difference=_apart(unit, before, after)
        )
        for (part, name, unit, before), (_, _, _, after) in zip(
            _every(nominal, nominal), _every(calibrated, nominal), strict=True
        )
    ]


def _apart(unit: str, before: float, after: float) -> float:
    """A figure's difference, of an angle between -180 and 180 degrees."""
    return (after - before + 180.0) % 360.0 - 180.0 if unit == "deg" and abs(after - before) > 180.0 else after - before


def _every(robot: Robot, beside: Robot) -> Iterator[tuple[str, str, str, float]]:
    for i, joint in enumerate(robot.joints):
        for step in joint.frame.every:
            yield (f"joint {i + 1}", step.symbol, *_shown(step))
    if robot.loop:
        bars = {"crank": robot.loop.crank.length, "rod": robot.loop.rod.length, "rocker": robot.loop.rocker}
        yield from (("loop", name, "mm", 1e3 * length) for name, length in bars.items())
    yield from (("base", axis, "mm", 1e3 * value) for axis, value in zip("xyz", robot.base.origin, strict=True))
    yield from _turn("base", robot.base.rotation, beside.base.rotation)
    if robot.tool_rotation is not None:
        yield from _turn("tool", robot.tool_rotation, beside.tool_rotation or (0.0, 0.0, 0.0))
    for name, marker in robot.markers.items():
        yield from (
            (f"marker {name}", axis, "mm", 1e3 * value) for axis, value in zip("xyz", marker.point, strict=True)
        )


def _turn(part: str, rotation: Sequence[float], beside: Sequence[float]) -> Iterator[tuple[str, str, str, float]]:
    """A rotation (about x, y and z in turn) as makers count it, in figures near another's where there are several ways."""
    turn, other = (Rotation.from_euler("XYZ", one) for one in (rotation, beside))
    ways = {("rx", "ry", "rz"): "XYZ", ("A", "B", "C"): "ZYX", ("W", "P", "R"): "xyz"}
    for names, order in ways.items():
        yield from (
            (part, name, "deg", float(np.rad2deg(angle)))
            for name, angle in zip(names, angles(turn, order), strict=True)
        )
    near = other.as_quat(canonical=True, scalar_first=True)
    quaternion = turn.as_quat(scalar_first=True)
    quaternion = quaternion if quaternion @ near >= 0 else -quaternion
    yield from ((part, f"q{k + 1}", "1", float(value)) for k, value in enumerate(quaternion))
    yield from (
        (part, f"v{axis}", "rad", float(v))
        for axis, v in zip("xyz", nearest_vector(turn.as_rotvec(), other.as_rotvec()), strict=True)
    )


def _shown(step: Step) -> tuple[str, float]:
    return ("mm", 1e3 * step.value) if step.is_length else ("deg", float(np.rad2deg(step.value)))
