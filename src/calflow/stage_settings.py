"""The settings of the stages, from the tables `[stages.NAME]` of a study file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from pydantic import Field, model_validator
from pydantic.json_schema import SkipJsonSchema

from calflow.design.cell import Cell
from calflow.design.planned import USUAL_DRIFT, Aim, Order, RecordedCondition
from calflow.diagnosis import FALSE_ALARM
from calflow.effects.stated import AnyEffects
from calflow.estimation.least_squares import Loss
from calflow.estimation.noise import NoiseSource
from calflow.files.problems import unknown_name
from calflow.files.toml import Angle, Count, FalseAlarm, FileModel, Length, Lengths3, Sigma
from calflow.robot.robot import Robot
from calflow.sampling.chain import ChainLength


class RegionSettings(FileModel):
    """A box in the measuring frame."""

    region_min: Lengths3 | None = Field(
        default=None,
        description="smallest x, y and z of a box in the measuring frame that must contain the marker, e.g. `region_min_mm`",
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
        default=(), description='payloads of the task, "" for none; default: that of the poses'
    )
    poses: str = Field(
        default="", description="a CSV of joint readings (`q1_deg` …) of the task, instead of poses drawn in the region"
    )
    number: int = Field(default=400, ge=10, description="number of poses drawn in the region")


class SelectSettings(RegionSettings):
    """Settings of select: the numbers of poses and candidates, the criterion, and the region visible to the device.

    Poses are chosen for the study's effects and for also_effects, which may be suspected causes, and for measurements
    like those of the series `measure`, by default the study's first one.
    """

    poses: int = Field(default=100, ge=4, description="number of poses to choose")
    candidates: int = Field(default=2000, ge=100, le=10_000_000, description="number of candidates to choose from")
    candidates_file: str = Field(
        default="",
        description="a CSV of joint readings (`q1_deg` …) to choose from, such as taught poses, instead of drawn ones; "
        "those beyond joint limits, outside the region, or refused by the cell are left out",
    )
    tolerance: Length | None = Field(
        default=None,
        gt=0,
        description="the tool's standard deviation over the task (root mean square) for which the number of poses is sought, "
        "e.g. `tolerance_um`",
    )
    refine: bool = Field(
        default=False,
        description="`true`: the chosen poses are refined between the candidates, within joint limits, region and cell; not for "
        "taught poses or the criterion `worst`",
    )
    add_to_measured: bool = Field(
        default=False,
        description="`true`: the training poses of the study's measurements count as already measured (repeats once), and "
        "`poses` are chosen that add the most information",
    )
    criterion: Aim | None = Field(
        default=None,
        description="whose uncertainty is minimised: all `parameters` (D-optimal, O1), the `tool` over the task (root "
        "mean square of its error), or the tool at the task's `worst` pose; default: the tool if there is a task, else parameters",
    )
    task: TaskSettings | None = Field(default=None, description="a table: where the tool must be accurate, see below")
    cell: Cell | None = Field(default=None, description="a table: constraints on the poses, see below")
    payload: str = Field(default="", description="payload during the measurement")
    marker: str = Field(default="", description="marker to measure; default: the first")
    sigma: Sigma | None = Field(
        default=None,
        gt=0,
        description="standard deviation of the device, per axis, e.g. `sigma_um`; default: that of `[measurements]`, or else 50 µm "
        "(in other units half a usual device's)",
    )
    sigma_unit: SkipJsonSchema[str] = ""
    sigma_rotation: Angle | None = Field(
        default=None,
        gt=0,
        description="the same for orientations, e.g. `sigma_rotation_mrad`; default: that of `[measurements]`, or else 0.1 mrad",
    )
    measure: str = Field(
        default="", description="name of the series as which poses will be measured; default: the first"
    )
    also_effects: AnyEffects = Field(
        default=(),
        description="suspected causes, whose parameters the poses are to determine like those of the study's effects",
    )

    order: Order = Field(
        default="short",
        description="measuring order of the poses: `short` moves, or `random`, in blocks of ten drawn from all poses, each with "
        "short moves, so that drift does not look like a joint's error",
    )
    drift: Length = Field(
        default=USUAL_DRIFT,
        gt=0,
        description="steady drift of device or robot from the first pose to the last, e.g. `drift_um` (50 µm): its effect in "
        "each order is stated in `select/order.csv`",
    )
    isolability: bool = Field(
        default=False,
        description="`true`: `select/isolability.csv` states which causes of the catalogue the planned poses could detect and "
        "distinguish, and what could be added to the plan; it takes some seconds to minutes",
    )
    isolability_size: float = Field(
        default=1.0, gt=0, description="size of these causes, in standard deviations of their priors"
    )
    records: tuple[RecordedCondition, ...] = Field(
        default=("approach",),
        description="what will be recorded in each row besides joint readings: `approach`, `travel`, `time`, `temperature`; for "
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
        description="a CSV of rows as for `calflow predict`: joint readings (`q1_deg` …), `payload`, `marker`, `pose` and other "
        "conditions that the model needs, instead of poses drawn in the region",
    )
    path: bool = Field(default=False, description="`true`: the rows of the file are a path, in their order")
    payloads: tuple[str, ...] = Field(
        default=(),
        description='payloads for every pose, "" for none; default: those of the file, else the heaviest measured',
    )
    marker: str = Field(default="", description="marker, for drawn poses; default: the first")
    number: int = Field(default=400, ge=10, description="number of poses drawn in the region")
    tolerance: Length | None = Field(
        default=None, gt=0, description="permitted position error, e.g. `tolerance_mm`; default: that of `[acceptance]`"
    )
    turn_tolerance: Angle | None = Field(
        default=None, gt=0, description="permitted orientation error, e.g. `turn_tolerance_mrad`; default: none"
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
