"""What every stage is: a function from a study and earlier results to results."""

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
    """What a stage is given.

    results holds the tables and documents of the stages it needs. folder is where the stage may write files of its own, laid
    out as the run folder, into which they move when the stage is done; what lies there survives an interruption. run_folder
    holds the finished files of earlier stages. say tells a line, advance the share of work done.
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
        """The tables of the stages it needs."""
        return self.results.tables

    def rng(self, purpose: str) -> np.random.Generator:
        """Return a random generator of this purpose's own, from the study's seed."""
        return draws(self.study.file.seed)(purpose)


@dataclass(frozen=True)
class Stage:
    """A stage: its settings' model, the stages whose results it needs, and whether it reads the measurements.

    tables and documents say by path in the run folder what it may make: of which rows, or of which dataclass. problems finds
    what it would refuse of a study, its settings and (where there are any) the measurements; resumes names files of an
    earlier run that it goes on from where only its settings changed; reads names further files that its settings ask for;
    demand foresees what it will take; titled says whether the study's title and acceptance stand in what it writes. bases names
    stages of which one is enough to go on from, the one that tells most first: see `on`.
    """

    name: str
    title: str
    settings: type[FileModel]
    run: Callable[[Context], Results]
    needs: tuple[str, ...] = ()
    uses: tuple[str, ...] = ()  # earlier stages it takes into account where the workflow has them
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
        """Return the stage as it goes on from one of its bases: it needs that one, and is measured where that is."""
        return replace(self, bases=(), needs=(*self.needs, base.name), measured=base.measured)
