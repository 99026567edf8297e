"""The settings of select: what a study file says of the poses to be chosen."""

from __future__ import annotations

from pydantic import Field, field_validator, model_validator

from calflow.design.isolability.visits import Record
from calflow.design.selection import Aim
from calflow.design.tour import Order
from calflow.design.trend import USUAL_DRIFT
from calflow.files.toml import Angle, Length
from calflow.stages.cell_settings import CellSettings
from calflow.stages.region import Region
from calflow.study_file import known_effects


class TaskSettings(Region):
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


class SelectSettings(Region):
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
    sigma: Length = Field(
        default=5e-5, gt=0, description="standard deviation of the device, per axis, e.g. `sigma_um` (50 µm)"
    )
    sigma_rotation: Angle = Field(
        default=1e-4, gt=0, description="the same of orientations, e.g. `sigma_rotation_mrad` (0.1 mrad)"
    )
    measure: str = Field(default="", description="name of the series as which poses will be measured; the first")
    also_effects: tuple[str, ...] = Field(
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

    @field_validator("also_effects")
    @classmethod
    def _known(cls, effects: tuple[str, ...]) -> tuple[str, ...]:
        return known_effects(effects) if effects else effects

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
