"""Controller figures: what a calibration is to be typed into a robot's controller as, in mm and degrees."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from calflow.files.tables import column
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
    difference: float = column("calibrated minus nominal")


def controller_figures(nominal: Robot, calibrated: Robot) -> list[ControllerFigure]:
    """Return the figures of a calibrated robot beside those of the maker's."""
    return [
        ControllerFigure(part=part, figure=name, unit=unit, nominal=before, calibrated=after, difference=after - before)
        for (part, name, unit, before), (_, _, _, after) in zip(_every(nominal), _every(calibrated), strict=True)
    ]


def _every(robot: Robot) -> Iterator[tuple[str, str, str, float]]:
    for i, joint in enumerate(robot.joints):
        for step in joint.frame.every:
            yield (f"joint {i + 1}", step.symbol, *_shown(step))
    if robot.loop:
        bars = {"crank": robot.loop.crank.length, "rod": robot.loop.rod.length, "rocker": robot.loop.rocker}
        yield from (("loop", name, "mm", 1e3 * length) for name, length in bars.items())
    yield from _place("base", robot.base.origin, robot.base.rotation)
    if robot.tool_rotation is not None:
        yield from _turn("tool", robot.tool_rotation)
    for name, marker in robot.markers.items():
        yield from (
            (f"marker {name}", axis, "mm", 1e3 * value) for axis, value in zip("xyz", marker.point, strict=True)
        )


def _place(part: str, origin: Sequence[float], rotation: Sequence[float]) -> Iterator[tuple[str, str, str, float]]:
    yield from ((part, axis, "mm", 1e3 * value) for axis, value in zip("xyz", origin, strict=True))
    yield from _turn(part, rotation)


def _turn(part: str, rotation: Sequence[float]) -> Iterator[tuple[str, str, str, float]]:
    """A rotation (about x, y and z in turn) as makers count it."""
    turn = Rotation.from_euler("XYZ", rotation)
    ways = {
        ("rx", "ry", "rz"): turn.as_euler("XYZ", degrees=True),
        ("A", "B", "C"): turn.as_euler("ZYX", degrees=True),
        ("W", "P", "R"): turn.as_euler("xyz", degrees=True),
    }
    for names, angles in ways.items():
        yield from ((part, name, "deg", float(angle)) for name, angle in zip(names, angles, strict=True))
    x, y, z, w = turn.as_quat(canonical=True)
    yield from ((part, f"q{k + 1}", "1", float(value)) for k, value in enumerate((w, x, y, z)))
    yield from ((part, f"v{axis}", "rad", float(v)) for axis, v in zip("xyz", turn.as_rotvec(), strict=True))


def _shown(step: Step) -> tuple[str, float]:
    return ("mm", 1e3 * step.value) if step.is_length else ("deg", float(np.rad2deg(step.value)))
