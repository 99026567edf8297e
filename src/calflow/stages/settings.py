"""The settings of the stages: what a study file says of each, in its table `[stages.NAME]`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator
from pydantic.json_schema import SkipJsonSchema

from calflow.design.cell import Box, Cell, CellStation, Cylinder
from calflow.design.planned import USUAL_DRIFT, Aim, Order, Record
from calflow.diagnosis import FALSE_ALARM
from calflow.estimation.least_squares import Loss
from calflow.estimation.noise import NoiseSource
from calflow.files.problems import nearest
from calflow.files.toml import Angle, FileModel, Length, Lengths3, Sigma, Unit
from calflow.robot.robot import Robot
from calflow.sampling.chain import ChainLength
from calflow.study import AlignedBox, AnyEffects

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
    def station(self) -> CellStation:
        """The same as an object."""
        far = np.inf if self.range_max is None else self.range_max
        return CellStation(self.origin, self.range_min, far, self.elevation_min, self.elevation_max)


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
    boxes: tuple[AlignedBox, ...] = Field(default=(), description="tables: boxes that stand around")
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
            stations=tuple(station.station for station in self.stations),
            reflector_axis=self.reflector_axis, acceptance=self.acceptance,
            line_of_sight=self.line_of_sight, sight_from=self.sight_from,
            radii=self.link_radii, tool_radius=self.tool_radius, self_collision=self.self_collision, clearance=self.clearance,
            drawn_in_base=self.frame == "base", floor=self.floor,
            boxes=tuple(Box(box.min, box.max) for box in self.boxes),
            cylinders=tuple(Cylinder(cylinder.start, cylinder.end, cylinder.radius) for cylinder in self.cylinders),
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
            if not robot.is_one_arm or len(arm) != 6 or any(joint.kind != "revolute" for joint in arm):
                yield "elbow and wrist are known of arms of six joints that turn", "configuration"
            elif len(self.configuration) != 6:
                yield f"expected 6 joint readings, found {len(self.configuration)}", "configuration"
        if self.torque_share is not None and not (robot.has_masses and any(joint.rated_torque for joint in arm)):
            yield "needs masses and rated_torque of joints in the robot file", "torque_share"


class RegionSettings(FileModel):
    """A box in the measuring frame."""

    region_min: Lengths3 | None = Field(
        default=None,
        description="least x, y and z of a box in the measuring frame that the marker must be in, e.g. `region_min_mm`",
    )
    region_max: Lengths3 | None = Field(
        default=None, description="largest x, y and z of that box, e.g. `region_max_mm`"
    )

    @model_validator(mode="after")
    def _whole_region(self) -> RegionSettings:
        low, high = self.region_min, self.region_max
        if (low is None) != (high is None):
            raise ValueError("region_min and region_max go together")
        if low and high and not all(a < b for a, b in zip(low, high, strict=True)):
            raise ValueError("region_min must lie below region_max on every axis")
        return self

    @property
    def region(self) -> np.ndarray | None:
        """The box (2, 3) [m]; None where there is none."""
        return None if self.region_min is None else np.array([self.region_min, self.region_max])


class TaskSettings(RegionSettings):
    """The table `[stages.select.task]`: where the robot will work, and what it will carry there.

    Without a region of its own the task is where the poses are measured.
    """

    payloads: tuple[str, ...] = Field(
        default=(), description='what the robot will carry, "" for nothing; that of the poses'
    )
    poses: str = Field(
        default="",
        description="a CSV of joint readings (`q1_deg` …) of the task, in the place of poses drawn in the region",
    )
    number: int = Field(default=400, ge=10, description="poses that are drawn in the region")


class SelectSettings(RegionSettings):
    """Settings of select: how many poses of how many candidates, what for, and where the device can see the tool.

    Poses are chosen for the study's effects and for also_effects, which may be causes to be told apart, and to be measured as
    the series `measure` will be; the study's first one where nothing is said.
    """

    poses: int = Field(default=100, ge=4, description="how many poses to choose")
    candidates: int = Field(default=2000, ge=100, le=10_000_000, description="how many to choose them of")
    candidates_file: str = Field(
        default="",
        description="a CSV of joint readings (`q1_deg` …) to choose of, such as taught poses, in the place of drawn ones; "
        "those beyond joint limits or outside the region, or that the cell refuses, are left out",
    )
    tolerance: Length | None = Field(
        default=None,
        gt=0,
        description="the tool's standard deviation over the task (root mean square) for which the number of poses is looked "
        "for, e.g. `tolerance_um`",
    )
    refine: bool = Field(
        default=False,
        description="`true`: the poses chosen are moved between the candidates, within joint limits, region and cell; not taught "
        "poses, and not for the `worst`",
    )
    add_to_measured: bool = Field(
        default=False,
        description="`true`: the poses of the study's measurements count as already there (those to be fitted, repeats once), and "
        "`poses` are chosen that add the most to them",
    )
    criterion: Aim | None = Field(
        default=None,
        description="what the poses are to make sure: all `parameters` alike (D-optimal, O1), the `tool` over the task (root mean "
        "square of its error), or where in the task it is `worst`; the tool where there is a task, else the parameters",
    )
    task: TaskSettings | None = Field(default=None, description="a table: where the tool must be right, see below")
    cell: CellSettings | None = Field(default=None, description="a table: what the poses must keep to, see below")
    payload: str = Field(default="", description="what the robot carries while it is measured")
    marker: str = Field(default="", description="what is measured; the first")
    sigma: Sigma | None = Field(
        default=None,
        gt=0,
        description="standard deviation of the device, per axis, e.g. `sigma_um` (50 µm; of another unit half a usual device's)",
    )
    sigma_unit: SkipJsonSchema[str] = ""
    sigma_rotation: Angle = Field(
        default=1e-4, gt=0, description="the same of orientations, e.g. `sigma_rotation_mrad` (0.1 mrad)"
    )
    measure: str = Field(default="", description="name of the series as which poses will be measured; the first")
    also_effects: AnyEffects = Field(
        default=(),
        description="causes that are only suspected: the poses are to tell of them as of the study's effects",
    )

    order: Order = Field(
        default="short",
        description="in which the poses are measured: on `short` ways, or `random`, in blocks of ten drawn from all poses, each on "
        "short ways, so that what wanders looks like no joint",
    )
    drift: Length = Field(
        default=USUAL_DRIFT,
        gt=0,
        description="steady drift of device or robot from the first pose to the last, e.g. `drift_um` (50 µm): what it would "
        "pull in each order is said in `select/order.csv`",
    )
    isolability: bool = Field(
        default=False,
        description="`true`: which causes of the catalogue the planned poses would show, and tell from which others, is said in "
        "`select/isolability.csv`, with what could be added to the plan; it takes some seconds to minutes",
    )
    isolability_size: float = Field(
        default=1.0, gt=0, description="of these causes, in usual sizes (their priors' standard deviations)"
    )
    records: tuple[Record, ...] = Field(
        default=("approach",),
        description="what will be recorded of each row besides joint readings: `approach`, `travel`, `time`, `temperature`; for "
        "`isolability`",
    )

    @model_validator(mode="after")
    def _enough_candidates(self) -> SelectSettings:
        if self.poses > self.candidates and not self.candidates_file:
            raise ValueError("poses: there must be at least as many candidates")
        if self.refine and (self.candidates_file or self.aim == "worst"):
            raise ValueError("refine: taught poses are left as they are, and the criterion must be parameters or tool")
        return self

    @property
    def aim(self) -> Aim:
        """What the poses are to make sure."""
        return self.criterion or ("tool" if self.task else "parameters")


class IdentifySettings(FileModel):
    """Settings of identify."""

    starts: int = Field(default=3, ge=1)
    loss: Loss = "linear"
    noise: NoiseSource = "auto"
    count: dict[str, int] = {}


class DiagnoseSettings(FileModel):
    """Settings of diagnose: the chance of a false alarm, the most causes to add, and which effects to look for (all)."""

    false_alarm: float = Field(default=FALSE_ALARM, gt=0, lt=0.5)
    causes: int = Field(default=10, ge=1)
    catalogue: AnyEffects = ()
    leave_out: AnyEffects = ()


class WorkSettings(RegionSettings):
    """Poses of a file, or drawn in a region; what is asked of them."""

    poses: str = Field(
        default="",
        description="a CSV of rows as `calflow predict` takes them: joint readings (`q1_deg` …), `payload`, `marker`, `pose` and "
        "what else the model must be told, in the place of poses drawn in the region",
    )
    path: bool = Field(default=False, description="`true`: the rows of the file are a path, in their order")
    payloads: tuple[str, ...] = Field(
        default=(),
        description='each pose under each of these, "" for nothing; as the file says, else the heaviest measured',
    )
    marker: str = Field(default="", description="whose position it is, of poses that are drawn; the first")
    number: int = Field(default=400, ge=10, description="poses that are drawn in the region")
    tolerance: Length | None = Field(
        default=None,
        gt=0,
        description="how far off the tool may be, e.g. `tolerance_mm`; that of `[acceptance]`",
    )
    turn_tolerance: Angle | None = Field(
        default=None, gt=0, description="by what angle it may be turned, e.g. `turn_tolerance_mrad`; not asked"
    )

    @model_validator(mode="after")
    def _somewhere(self) -> WorkSettings:
        if bool(self.poses) == (self.region is not None):
            raise ValueError("expected either poses, a CSV, or region_min and region_max")
        if self.path and not self.poses:
            raise ValueError("a path needs its poses, a CSV")
        return self

    def wrong(self, robot: Robot) -> Iterator[tuple[str, str]]:
        """Say which names the robot file lacks, with the key that says them."""
        for what, name, names, key in (
            ("marker", self.marker, list(robot.markers), "marker"),
            *(("payload", payload, list(robot.payloads), "payloads") for payload in self.payloads),
        ):
            if name and name not in names:
                yield f"unknown {what} '{name}'; there are {', '.join(names) or 'none'}{nearest(name, names)}", key


class SampleSettings(FileModel):
    """Settings of sample: length and mixture of the chain. independent is the share of the independence proposal."""

    ensembles: int = Field(default=ChainLength.ensembles, ge=4)
    walkers: int | None = Field(default=ChainLength.walkers, ge=4)
    block: int = Field(default=ChainLength.block, ge=10)
    max_steps: int = Field(default=ChainLength.max_steps, ge=50)
    ess: int = Field(default=ChainLength.ess, ge=100)
    independent: float = Field(default=ChainLength.independent, ge=0, le=1)
    task: WorkSettings | None = Field(default=None, description="a table: where the robot works")


class NoStageSettings(FileModel):
    """Settings of report and residual_field: there are none."""


SETTINGS: Mapping[str, type[FileModel]] = {
    "select": SelectSettings,
    "identify": IdentifySettings,
    "diagnose": DiagnoseSettings,
    "residual_field": NoStageSettings,
    "sample": SampleSettings,
    "report": NoStageSettings,
}
