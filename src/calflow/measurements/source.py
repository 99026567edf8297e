"""What a study says of its data: where the file is, and how to read it."""

from __future__ import annotations

import re
from dataclasses import fields
from typing import Literal

from pydantic import Field, field_validator, model_validator

from calflow.files.toml import Angle, FileModel, Length, Lengths3
from calflow.measurements.layout import Layout, Missing


class MeasurementSource(FileModel):
    """Where the measurements are and how to read them: the `[measurements]` table of a study.

    A url is fetched once and kept; its sha256 is then required. The folder that CALFLOW_DATA names is looked in first.
    The other keys are a `Layout`'s.
    """

    file: str
    url: str | None = None
    sha256: str | None = None
    separator: str = ","
    decimal: Literal[".", ","] = "."
    columns: dict[str, str] = {}
    markers: dict[str, dict[str, str]] = {}
    sigma: Length | None = Field(default=None, gt=0)
    sigma_rotation: Angle | None = Field(default=None, gt=0)
    in_order: bool = False
    tracker: Lengths3 | None = None
    missing: Missing = "refuse"

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

    @field_validator("sha256")
    @classmethod
    def _is_a_hash(cls, sha256: str | None) -> str | None:
        if sha256 is not None and not re.fullmatch("[0-9a-f]{64}", sha256):
            raise ValueError(f"expected 64 digits 0-9 and a-f, found {len(sha256)} characters: {sha256!r}")
        return sha256

    @property
    def layout(self) -> Layout:
        """How to read the file."""
        return Layout(**{field.name: getattr(self, field.name) for field in fields(Layout)})
