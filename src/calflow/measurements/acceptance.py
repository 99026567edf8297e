"""What a calibration is signed with: the robot's serial number, what measured it, who and when, and how accurate it must be."""

from __future__ import annotations

import datetime
from typing import Annotated

from pydantic import Field, model_validator

from calflow.files.toml import FileModel, Length, Unit


class Acceptance(FileModel):
    """The table `[acceptance]` of a study; every key may be left out, and concerns the report alone."""

    serial_number: str = Field(default="", description="of the robot")
    instrument: str = Field(default="", description="what measured, with its own serial number")
    certificate: str = Field(
        default="", description="of the instrument's calibration: number, who issued it, until when"
    )
    date: datetime.date | None = Field(
        default=None, description="when it was measured, e.g. `2025-11-22` (without quotes)"
    )
    operator: str = Field(default="", description="who measured")
    temperature: Annotated[float, Unit("temperature")] | None = Field(
        default=None, description="where it was measured, e.g. `temperature_degC`"
    )
    tolerance: Length | None = Field(
        default=None,
        gt=0,
        description="the most by which any held-out position may be off, e.g. `tolerance_mm`: passed or failed",
    )

    @model_validator(mode="after")
    def _says_something(self) -> Acceptance:
        if self == type(self).model_construct():
            raise ValueError(f"expected one or more of {', '.join(type(self).model_fields)}")
        return self
