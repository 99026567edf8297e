"""The table `[stages.select.cell]`: what the poses that select chooses must keep to."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from calflow.design.cell.cell import Box, Cell, Cylinder, Station
from calflow.files.toml import Angle, FileModel, Length, Lengths3, Unit
from calflow.robot.robot import Robot

Radii = Annotated[tuple[Annotated[float, Field(gt=0)], ...], Unit("length")]
Angles = Annotated[tuple[float, ...], Unit("angle")]


class StationSettings(FileModel):
    """A table `[[stages.select.cell.stations]]`: a device that must see the reflector."""

    origin: Lengths3 = Field(description="where it stands in the measuring frame, e.g. `origin_mm`")
    range_min: Length = Field(default=0.0, ge=0, description="how near it measures, e.g. `range_min_m`")
    range_max: Length | None = Field(default=None, gt=0, description="how far it measures")
    elevation_min: Angle = Field(
        default=-np.pi / 2, description="how low it looks, from the horizontal (x and y of the measuring frame), e.g. "
        "`elevation_min_deg`"
    )  # fmt: skip
    elevation_max: Angle = Field(default=np.pi / 2, description="how high it looks")

    @model_validator(mode="after")
    def _in_order(self) -> StationSettings:
        if self.range_max is not None and self.range_min >= self.range_max:
            raise ValueError("range_min must lie below range_max")
        if self.elevation_min >= self.elevation_max:
            raise ValueError("elevation_min must lie below elevation_max")
        return self

    @property
    def station(self) -> Station:
        """The same as an object."""
        far = np.inf if self.range_max is None else self.range_max
        return Station(self.origin, self.range_min, far, self.elevation_min, self.elevation_max)


class BoxSettings(FileModel):
    """A table `[[stages.select.cell.boxes]]`: a box along the axes of the drawing's frame."""

    min: Lengths3 = Field(description="its least x, y and z, e.g. `min_mm`")
    max: Lengths3 = Field(description="its largest x, y and z, e.g. `max_mm`")

    @model_validator(mode="after")
    def _in_order(self) -> BoxSettings:
        if not all(a < b for a, b in zip(self.min, self.max, strict=True)):
            raise ValueError("min must lie below max on every axis")
        return self


class CylinderSettings(FileModel):
    """A table `[[stages.select.cell.cylinders]]`: its ends count as rounded, so that it is longer by its radius at either end."""

    start: Lengths3 = Field(description="where its axis begins, e.g. `start_mm`")
    end: Lengths3 = Field(description="where its axis ends, e.g. `end_mm`")
    radius: Length = Field(gt=0, description="its radius, e.g. `radius_mm`")


class CellSettings(FileModel):
    """What poses must keep to; what is not stated is not asked for.

    Links are capsules from joint to joint and to the flange.
    """

    stations: tuple[StationSettings, ...] = Field(
        default=(), description="tables: the devices that must see the reflector"
    )
    reflector_axis: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 1.0), description="where the reflector looks, in the flange's frame; its z"
    )
    acceptance: Angle | None = Field(
        default=None,
        gt=0,
        le=np.pi,
        description="how far off that axis a station may be: half the cone's opening, e.g. `acceptance_deg`",
    )
    line_of_sight: bool = Field(
        default=True, description="whether links, boxes and cylinders may not stand between a station and the reflector"
    )
    sight_from: Length = Field(
        default=0.0, ge=0, description="how far off the reflector a line of sight begins to count, e.g. `sight_from_mm`"
    )
    link_radii: Radii | None = Field(
        default=None,
        description="the links' radii, one a joint, e.g. `link_radii_mm`; 4 % of the stretched arm's length. The base has the "
        "first one's, the bars of a loop the least",
    )
    tool_radius: Length | None = Field(
        default=None,
        gt=0,
        description="radius of a capsule from the flange to the reflector, e.g. `tool_radius_mm`; no tool",
    )
    self_collision: bool = Field(
        default=True, description="whether links may not touch each other: those that have a link between them longer than both "
        "radii"
    )  # fmt: skip
    clearance: Length = Field(
        default=0.0, ge=0, description="what links keep from each other and from what is drawn, e.g. `clearance_mm`"
    )
    frame: Literal["base", "measuring"] = Field(
        default="base",
        description="the frame in which floor, boxes and cylinders are drawn: the `base`'s or the `measuring` one",
    )
    floor: Length | None = Field(
        default=None,
        description="height of the floor, e.g. `floor_mm`; it and the boxes do not count for base and first link",
    )
    boxes: tuple[BoxSettings, ...] = Field(default=(), description="tables: boxes that stand around")
    cylinders: tuple[CylinderSettings, ...] = Field(default=(), description="tables: cylinders that stand around")
    configuration: Angles | None = Field(
        default=None,
        description="readings of the six joints at a pose whose elbow and wrist are kept, e.g. `configuration_deg`",
    )
    torque_share: float | None = Field(
        default=None,
        gt=0,
        description="how much of each joint's `rated_torque` the robot and its payload may take to hold",
    )

    def of(self, robot: Robot) -> Cell:
        """Return the cell of a robot for which nothing is wrong with it."""
        like = None
        if self.configuration is not None:
            readings = np.zeros(robot.n_joints)
            readings[robot.arm] = self.configuration
            like = tuple(map(float, readings))
        return Cell(
            stations=tuple(one.station for one in self.stations),
            reflector_axis=self.reflector_axis, acceptance=self.acceptance,
            line_of_sight=self.line_of_sight, sight_from=self.sight_from,
            radii=self.link_radii, tool_radius=self.tool_radius, self_collision=self.self_collision, clearance=self.clearance,
            drawn_in_base=self.frame == "base", floor=self.floor,
            boxes=tuple(Box(one.min, one.max) for one in self.boxes),
            cylinders=tuple(Cylinder(one.start, one.end, one.radius) for one in self.cylinders),
            like=like, torque_share=self.torque_share,
        )  # fmt: skip

    @model_validator(mode="after")
    def _points_somewhere(self) -> CellSettings:
        if not any(self.reflector_axis):
            raise ValueError("reflector_axis must not be zero")
        if self.acceptance is not None and not self.stations:
            raise ValueError("acceptance needs a station to look at: a table [[stages.select.cell.stations]]")
        return self

    def wrong(self, robot: Robot) -> Iterator[tuple[str, str]]:
        """Say what does not fit the robot, with the key that says it."""
        if self.link_radii is not None and len(self.link_radii) != robot.n_joints:
            yield f"expected {robot.n_joints} radii, one a joint, found {len(self.link_radii)}", "link_radii"
        arm = [robot.joints[i] for i in robot.arm]
        if self.configuration is not None:
            if len(arm) != 6 or any(joint.kind != "revolute" for joint in arm):
                yield "elbow and wrist are known of arms of six joints that turn", "configuration"
            elif len(self.configuration) != 6:
                yield f"expected 6 joint readings, found {len(self.configuration)}", "configuration"
        if self.torque_share is not None and not (robot.has_masses and any(joint.rated_torque for joint in arm)):
            yield "needs masses and rated_torque of joints in the robot file", "torque_share"
