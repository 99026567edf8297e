"""What a study says of its data: where the file is, and how to read it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import fields
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator
from pydantic.json_schema import SkipJsonSchema

from calflow.files.toml import Angle, Angles3, FileModel, Length, Lengths3, Sigma, Unit
from calflow.measurements.columns import Layout, Missing
from calflow.measurements.series import BeamNoise, Series, Setting, Station


class StationFile(FileModel):
    """Where a series' device stands: the table `[measurements.station]`."""

    name: str = ""
    known: bool = False
    origin: Lengths3 = (0.0, 0.0, 0.0)
    rotation: Angles3 = (0.0, 0.0, 0.0)
    by_session: bool = False


class BeamFile(FileModel):
    """A tracker's noise as its maker states it: along the beam floor + growth · range, across it an angle."""

    floor: Length = Field(gt=0)
    growth: Annotated[float, Unit("ratio")] = Field(default=0.0, ge=0)
    angle: Angle = Field(gt=0)


class MeasurementSource(FileModel):
    """Where the measurements are and how to read them: a `[measurements]` table of a study.

    kind is an observation's id, settings what that kind lets one say.

    A url, by https, is fetched once by a run and kept; its sha256 is then required. The folder that CALFLOW_DATA names is looked
    in first.
    The other keys are a `Layout`'s.
    """

    file: str
    name: str = ""
    kind: str = ""
    station: StationFile = StationFile()
    noise: BeamFile | None = None
    settings: dict[str, Any] = {}
    url: str | None = None
    sha256: str | None = None
    separator: str = ","
    decimal: Literal[".", ","] = "."
    columns: dict[str, str] = {}
    markers: dict[str, dict[str, str]] = {}
    sigma: Sigma | None = Field(default=None, gt=0)
    sigma_unit: SkipJsonSchema[str] = ""
    sigma_rotation: Angle | None = Field(default=None, gt=0)
    in_order: bool = False
    tracker: Lengths3 | None = None
    missing: Missing = "whole"

    @model_validator(mode="after")
    def _fetched_is_checked(self) -> MeasurementSource:
        if self.url and not self.sha256:
            raise ValueError("a url needs the file's sha256")
        _ = self.layout  # says what cannot be
        return self

    @field_validator("separator")
    @classmethod
    def _is_one_character(cls, separator: str) -> str:
        if len(separator) != 1:
            raise ValueError(f"expected one character, found {separator!r}")
        return separator

    @field_validator("url")
    @classmethod
    def _is_fetched_safely(cls, url: str | None) -> str | None:
        if url is not None and not re.fullmatch(r"https://[!-~]+", url):
            raise ValueError(f"expected a url that begins with https:// and has no blanks, found {url!r}; fetch anything else "
                             "yourself, into the folder that CALFLOW_DATA names")  # fmt: skip
        return url

    @field_validator("sha256")
    @classmethod
    def _is_a_hash(cls, sha256: str | None) -> str | None:
        if sha256 is not None and not re.fullmatch("[0-9a-f]{64}", sha256):
            raise ValueError(f"expected 64 digits 0-9 and a-f, found {len(sha256)} characters: {sha256!r}")
        return sha256

    @property
    def layout(self) -> Layout:
        """How to read the file, positions and orientations if it has them."""
        names = [field.name for field in fields(Layout) if field.name != "reports"]
        return Layout(**{name: getattr(self, name) for name in names})

    def series(self, labels: tuple[str, ...], settings: Mapping[str, Setting]) -> Series:
        """Return what is said of the rows; labels and settings are what its kind makes of them."""
        device = self.tracker or (0.0, 0.0, 0.0)
        beam = None if self.noise is None else BeamNoise(self.noise.floor, self.noise.growth, self.noise.angle, device)
        station = Station(**self.station.model_dump())
        return Series(self.name, self.kind, station, beam, tuple(settings.items()), labels)
