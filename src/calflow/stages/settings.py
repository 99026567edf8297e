"""The settings of the stages, from the tables `[stages.NAME]` of a study file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from pydantic import Field, model_validator
from pydantic.json_schema import SkipJsonSchema

from calflow.design.cell import Cell
from calflow.design.planned import USUAL_DRIFT, Aim, Order, Record
from calflow.diagnosis import FALSE_ALARM
from calflow.estimation.least_squares import Loss
from calflow.estimation.noise import NoiseSource
from calflow.files.problems import unknown_name
from calflow.files.toml import Angle, Count, FalseAlarm, FileModel, Length, Lengths3, Sigma
from calflow.robot.robot import Robot
from calflow.sampling.chain import ChainLength
from calflow.study import AnyEffects


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
        """The box (2, 3) [m]; None if not stated."""
        return None if self.region_min is None else np.array([self.region_min, self.region_max])


class TaskSettings(RegionSettings):
    """The table `[stages.select.task]`: the robot's working region or poses, and its payloads there.

    Without a region of its own the task is in the region of the measured poses.
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
    """Settings of select: the numbers of poses and candidates, the criterion, and the region visible to the device.

    Poses are chosen for the study's effects and for also_effects, which may be suspected causes, and for measurements
    like those of the series `measure`, by default the study's first one.
    """

    poses: int = Field(default=100, ge=4, description="how many poses to choose")
    candidates: int = Field(default=2000, ge=100, le=10_000_000, description="how many candidates to choose them from")
    candidates_file: str = Field(
        default="",
        description="a CSV of joint readings (`q1_deg` …) to choose of, such as taught poses, in the place of drawn ones; "
        "those beyond joint limits or outside the region, or that the cell refuses, are left out",
    )
    tolerance: Length | None = Field(
        default=None,
        gt=0,
        description="the tool's standard deviation over the task (root mean square) for which the number of poses is sought, "
        "e.g. `tolerance_um`",
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
        description="what the poses are to make certain: all `parameters` alike (D-optimal, O1), the `tool` over the task (root "
        "mean "
        "square of its error), or where in the task it is `worst`; the tool where there is a task, else the parameters",
    )
    task: TaskSettings | None = Field(default=None, description="a table: where the tool must be right, see below")
    cell: Cell | None = Field(default=None, description="a table: what the poses must keep to, see below")
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
        "short ways, so that drift does not look like a joint's error",
    )
    drift: Length = Field(
        default=USUAL_DRIFT,
        gt=0,
        description="steady drift of device or robot from the first pose to the last, e.g. `drift_um` (50 µm): its effect in "
        "each order is stated in `select/order.csv`",
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
        """The criterion of the selection."""
        return self.criterion or ("tool" if self.task else "parameters")


class IdentifySettings(FileModel):
    """Settings of identify."""

    starts: Count = 3
    loss: Loss = "linear"
    noise: NoiseSource = "auto"
    count: dict[str, int] = {}


class DiagnoseSettings(FileModel):
    """Settings of diagnose: the false-alarm rate, the largest number of causes, and the effects to search (all)."""

    false_alarm: FalseAlarm = FALSE_ALARM
    causes: Count = 10
    catalogue: AnyEffects = ()
    leave_out: AnyEffects = ()


class WorkSettings(RegionSettings):
    """Task poses from a file or drawn in a region, with tolerances."""

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
        default=None, gt=0, description="how far off the tool may be, e.g. `tolerance_mm`; that of `[acceptance]`"
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
        """Yield messages on names that the robot file lacks, each with its key."""
        if message := unknown_name("marker", self.marker, robot.markers):
            yield message, "marker"
        yield from (
            (message, "payloads")
            for name in self.payloads
            if (message := unknown_name("payload", name, robot.payloads))
        )


class SampleSettings(ChainLength):
    """Settings of sample: length of the chain and mixture of moves; independent: share of the independence proposal."""

    task: WorkSettings | None = Field(default=None, description="a table: where the robot works")


class NoStageSettings(FileModel):
    """Settings of report and residual_field, which have none."""


SETTINGS: Mapping[str, type[FileModel]] = {
    "select": SelectSettings,
    "identify": IdentifySettings,
    "diagnose": DiagnoseSettings,
    "residual_field": NoStageSettings,
    "sample": SampleSettings,
    "report": NoStageSettings,
}
