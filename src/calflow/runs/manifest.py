"""The manifest: what a run was made of, how far each stage came, and what it wrote."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from calflow.files.problems import InputError, Problem, refuse
from calflow.files.results import SUM, is_whole, sealed
from calflow.files.writing import contained, write_text

NAME = "manifest.json"
REMEDY = "delete it to run everything anew"
DESCRIBING = (".toml", ".urdf")  # endings of inputs that hold no measurements


class _Kept(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class StageEntry(_Kept):
    """A stage in the manifest: its state, why it last ran, and why that was reused since.

    outputs has the SHA-256 of each file it wrote, by its path in the run folder, and key what these depend on; finished is
    when it did, in UTC.
    """

    status: Literal["running", "interrupted", "failed", "done"]
    reason: str
    key: dict[str, str]
    reused: str | None = None
    seconds: float | None = Field(default=None, ge=0)
    finished: str = ""
    outputs: dict[str, str] | None = None

    @model_validator(mode="after")
    def _tells_what_was_done(self) -> StageEntry:
        if self.status == "done" and (self.outputs is None or self.seconds is None):
            raise ValueError("a stage that is done has outputs and seconds")
        return self


class KeptFile(_Kept):
    """A file that results depend on: its SHA-256, where it was (absolute), and whether it is of what was measured."""

    sha256: str
    path: str
    measured: bool = False


class Manifest(_Kept):
    """What a run folder tells of itself; study_file and folder are where the study and the run were, absolute.

    files has every input but the workflow by its name as it is seen from the study's folder (absolute where the study says so),
    environment the version of every package that was installed for calflow, code a hash of calflow's own.
    """

    calflow: str
    versions: dict[str, str]
    packages: dict[str, str] = {}
    code: str = ""
    machine: str = ""
    environment: dict[str, str] = {}
    study: str
    study_file: str
    folder: str = ""
    workflow: str
    seed: int
    inputs: dict[str, str]
    files: dict[str, KeptFile] = {}
    stages: dict[str, StageEntry]

    def outputs(self, stage: str) -> dict[str, str]:
        """Return the SHA-256 of what a stage wrote, by path in the run folder; empty where it never finished."""
        return (self.stages[stage].outputs or {}) if stage in self.stages else {}


def is_measured(path: str) -> bool:
    """Return whether an input of a manifest holds measurements, and does not say what was asked."""
    return not path.lower().endswith(DESCRIBING)


def read_manifest(folder: Path) -> Manifest | None:
    """Return a run folder's manifest; None where there is none.

    Raises:
        InputError: it is not what a run writes, or names files outside the folder.
    """
    path = folder / NAME
    if path.exists() and not path.is_file():
        raise refuse(f"is no file; {REMEDY}", path)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        whole = not isinstance(content, dict) or is_whole(content)
        if isinstance(content, dict):
            content.pop(SUM, None)
        manifest = Manifest.model_validate(content)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the whole"
        raise refuse(f"is not what a run writes ({where}: {first['msg']}); {REMEDY}", path) from None
    except (OSError, ValueError, RecursionError) as error:
        raise refuse(f"cannot be read ({error}); {REMEDY}", path) from None
    outside = [
        Problem(f"names {name!r}, which is no file inside the run folder; {REMEDY}", path)
        for stage in manifest.stages
        for name in manifest.outputs(stage)
        if contained(folder, name) is None
    ]
    if outside:
        raise InputError(outside)
    if not whole:
        raise refuse(f"was changed since a run wrote it; {REMEDY}", path)
    return manifest


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write a run folder's manifest whole, with a sum by which a turned bit is noticed."""
    write_text(folder / NAME, json.dumps(sealed(manifest.model_dump(exclude_none=True)), indent=2) + "\n")
