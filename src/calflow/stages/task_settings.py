"""The table `[stages.sample.task]`: where the robot works, and how accurate it must be there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from pydantic import Field, model_validator

from calflow.design.candidates import candidates
from calflow.estimation.registration import plausible
from calflow.files.problems import nearest
from calflow.files.toml import Angle, Length
from calflow.measurements.measurements import Measurements
from calflow.model import Model
from calflow.robot.robot import Robot
from calflow.sampling.task_points import TaskTolerances
from calflow.stages.select_settings import RegionSettings
from calflow.study import Study


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

    def asked(self, study: Study) -> TaskTolerances:
        """Return what is asked of the task."""
        accepted = study.file.acceptance.tolerance if study.file.acceptance else None
        return TaskTolerances(
            tolerance=self.tolerance or accepted, turn_tolerance=self.turn_tolerance, in_order=self.path
        )

    def wrong(self, robot: Robot) -> Iterator[tuple[str, str]]:
        """Say which names the robot file lacks, with the key that says them."""
        for what, name, names, key in (
            ("marker", self.marker, list(robot.markers), "marker"),
            *(("payload", payload, list(robot.payloads), "payloads") for payload in self.payloads),
        ):
            if name and name not in names:
                yield f"unknown {what} '{name}'; there are {', '.join(names) or 'none'}{nearest(name, names)}", key

    def points(
        self, study: Study, model: Model, measured: Measurements, time_origin: float | None, rng: np.random.Generator
    ) -> Measurements:
        """Return the task's rows, each pose under each payload.

        Raises:
            InputError: the file is at fault, or hardly any pose reaches the region.
        """
        if self.poses:
            path, source = study.path.parent / self.poses, study.file.sources[0]
            how = {"separator": source.separator, "decimal": source.decimal}
            rows = plausible(Measurements.to_predict(path, model.robot, time_origin=time_origin, **how), path)
            return under(rows, self.payloads) if self.payloads else rows
        mass = {"": 0.0} | {name: load.mass or 0.0 for name, load in model.robot.payloads.items()}
        payloads = self.payloads or (max(dict.fromkeys(measured.table["payload"]), key=lambda name: mass[name]),)
        marker = self.marker or next(iter(model.robot.markers))
        readings, _ = candidates(model, self.number, payloads[0], marker, self.region, rng)
        drawn = Measurements.from_arrays(model.robot, readings, None, payload=payloads[0], marker=marker)
        return under(drawn, payloads)


def under(rows: Measurements, payloads: Sequence[str]) -> Measurements:
    """Return rows under each of these payloads, one payload after the other."""
    tables = [rows.table.assign(payload=payload) for payload in payloads]
    return replace(rows, table=pd.concat(tables, ignore_index=True))
