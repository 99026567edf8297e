"""The box that settings may ask for: where a marker must be."""

from __future__ import annotations

import numpy as np
from pydantic import Field, model_validator

from calflow.files.toml import FileModel, Lengths3


class Region(FileModel):
    """A box in the measuring frame."""

    region_min: Lengths3 | None = Field(
        default=None,
        description="least x, y and z of a box in the measuring frame that the marker must be in, e.g. `region_min_mm`",
    )
    region_max: Lengths3 | None = Field(
        default=None, description="largest x, y and z of that box, e.g. `region_max_mm`"
    )

    @model_validator(mode="after")
    def _whole_region(self) -> Region:
        if (self.region_min is None) != (self.region_max is None):
            raise ValueError("region_min and region_max go together")
        if (
            self.region_min
            and self.region_max
            and not all(a < b for a, b in zip(self.region_min, self.region_max, strict=True))
        ):
            raise ValueError("region_min must lie below region_max on every axis")
        return self

    @property
    def region(self) -> np.ndarray | None:
        """The box (2, 3) [m]; None where there is none."""
        return None if self.region_min is None else np.array([self.region_min, self.region_max])
