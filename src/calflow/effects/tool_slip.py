"""Tool slip: a tool, or a marker on it, that shifted once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import casadi as ca

from calflow.effects.base import Words
from calflow.effects.displacement import Rigid
from calflow.effects.step_change import PointStep
from calflow.effects.tool_deflection import TOOL, markers_alone, tools
from calflow.robot.frames import placement
from calflow.robot.mechanism import Dimensions, Row
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot


@dataclass(frozen=True)
class ToolSlip(Rigid, PointStep):
    """Marker's point - (x, y, z), and with turning - r x point, in the flange's frame, up to a row.

    Of a tool with all its markers, or, without rotation, of one of several markers.
    """

    id = "tool-slip"
    title = "slip of the tool"
    words = Words("slip of the tool", "the tool, or a marker on it, shifted once", "shift")
    whole = TOOL
    imaged = False
    told_by = "measure the tool against its flange, or some of the first poses again"
    sds = {"m": 3e-4, "rad": 1e-3}

    @classmethod
    def kinds(cls, robot: Robot) -> tuple[Self, ...]:
        """Return the slip without rotation, and with it where the tool's orientation shows."""
        shows = len(robot.markers) > 1 or robot.tool_rotation is not None
        return (cls(robot), cls(robot, turning=True)) if shows else (cls(robot),)

    @cached_property
    def _markers(self) -> dict[str, tuple[int, ...]]:
        """The indices of the markers that slip, by part."""
        on = self.robot.marker_links
        whole = {part: tuple(k for k, of in enumerate(on) if of == link) for part, link in tools(self.robot).items()}
        alone = {} if self.turning else {name: (k,) for name, k in markers_alone(self.robot).items()}
        return whole | alone

    def parameters(self) -> tuple[Parameter, ...]:
        """Return each part's shift, and rotation."""
        return tuple(parameter for part in self._markers for parameter in self.of_part(part))

    def dimensions(self, p: ca.SX, dims: Dimensions, row: Row) -> Dimensions:
        """Return the dimensions with the markers, and the tool's rotation, as they were before the moment."""
        before = self.before(row)
        if not before.nnz():
            return dims
        markers, turn = ca.SX(dims.markers), dims.tool_rotation
        for part, columns in self.parts.items():
            own = p[columns]
            for k in self._markers[part]:
                markers[:, k] = self.undone(own, dims.markers[:, k], row)
            if self.turning and self.robot.tool_rotation is not None:
                stands = placement(ca.DM([0, 0, 0, *self.robot.tool_rotation]))[:3, :3]
                turn = turn - stands.T @ own[3:] * before
        return replace(dims, markers=markers, tool_rotation=turn)
