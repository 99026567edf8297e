"""The stage: a function from a study and earlier results to results, with the metadata to plan and cache it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from calflow.estimation.progress import draws
from calflow.files.problems import Problem
from calflow.files.tables import Results, Tables
from calflow.files.toml import FileModel
from calflow.measurements.measurements import Measurements
from calflow.stages.demand import Demand
from calflow.study import Study


@dataclass(frozen=True)
class Context:
    """The arguments of a stage.

    results: tables and documents of the stages it needs; folder: work folder for the stage's files, laid out like the
    run folder, into which they are moved when the stage is done, and kept after an interruption; run_folder: folder
    with the files of earlier stages; say, advance: callbacks for messages and the completed share of the work.
    """

    study: Study
    settings: Any
    results: Results
    folder: Path
    run_folder: Path
    say: Callable[[str], None]
    advance: Callable[[float], None]

    @property
    def tables(self) -> Tables:
        """The tables of the stages that it needs."""
        return self.results.tables

    def rng(self, purpose: str) -> np.random.Generator:
        """Return a random generator for this purpose alone, seeded by the study."""
        return draws(self.study.file.seed)(purpose)


@dataclass(frozen=True)
class Stage:
    """A stage: the model of its settings, the stages whose results it needs, and whether it reads the measurements.

    tables, documents: row types and dataclasses of its possible results, by path in the run folder; problems: returns
    the errors for which it would refuse a study, settings and any measurements; resumes: files of an earlier run from
    which it resumes if only settings changed; reads: returns further files named by the settings; demand: estimates
    memory and time; titled: whether its results contain the study's title and acceptance; bases: stages of which one
    suffices as its base, the most informative first (see `on`).
    """

    name: str
    title: str
    settings: type[FileModel]
    run: Callable[[Context], Results]
    needs: tuple[str, ...] = ()
    uses: tuple[str, ...] = ()  # optional upstream stages, used if the workflow, or a stage by itself, has them
    measured: bool = True
    resumes: tuple[str, ...] = ()
    tables: Mapping[str, type] = field(default_factory=dict, hash=False)
    documents: Mapping[str, type] = field(default_factory=dict, hash=False)
    problems: Callable[[Study, Any, Measurements | None], list[Problem]] = lambda study, settings, data: []
    reads: Callable[[Study, Any], tuple[Path, ...]] = lambda study, settings: ()
    demand: Callable[[Study, Any, Measurements], Demand] = lambda study, settings, data: Demand()
    titled: bool = False
    bases: tuple[str, ...] = ()

    def on(self, base: Stage) -> Stage:
        """Return the stage on one of its bases, which it then needs, and reads the measurements if this does."""
        return replace(self, bases=(), needs=(*self.needs, base.name), measured=base.measured)
