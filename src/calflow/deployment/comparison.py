"""A comparison of calibrations: runs side by side, with the significance of what differs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from calflow.estimation.accuracy import Accuracy
from calflow.files.deferred import pd
from calflow.files.tables import StoredResults, column


@dataclass(frozen=True, kw_only=True)
class Setting:
    """What one of the runs was asked, or was made of, that another was not."""

    setting: str = column("key of the study, stage setting or version")
    of: Mapping[str, str] = column("what a run has; empty: nothing", name="{run}")


@dataclass(frozen=True, kw_only=True)
class RunData:
    """The measurements of a run, and the noise that was taken for theirs."""

    run: str = column("the run")
    files: tuple[str, ...] = column("measurement files")
    poses: int = column("poses that were fitted")
    held_out: int = column("poses that were held out")
    noise_mm: float = column("noise of a row, per axis; empty: no lengths were measured", "mm")
    noise_from: tuple[str, ...] = column("where the noise is known from")
    discrepancy_mm: float = column("what the model leaves beyond the noise, per axis", "mm")
    same_data_as: tuple[str, ...] = column("runs of the very same measurements")


@dataclass(frozen=True, kw_only=True)
class RunAccuracy(Accuracy):
    """The accuracy of a model of a run, on one split."""

    run: str = column("the run")


@dataclass(frozen=True, kw_only=True)
class ParameterDifference:
    """A parameter that two runs share, and by how much it differs."""

    first: str = column("a run")
    second: str = column("another one")
    parameter: str = column("its name")
    unit: str = column("of the figures in this row (SI)")
    first_value: float = column("as the first run calibrated it", "as `unit` says")
    second_value: float = column("as the second did", "as `unit` says")
    difference: float = column("second minus first", "as `unit` says")
    sd: float | None = column("its standard deviation; empty: both runs are of the same measurements", "as `unit` says")
    p: float | None = column("chance of so large a difference of this parameter alone; empty: as before")
    significant: bool | None = column(
        "whether it is beyond chance, all parameters of the pair counted (Holm 1979, 1 %); empty: as before"
    )
    meaning: str = column("what it is, in words")


@dataclass(frozen=True, kw_only=True)
class RunPair:
    """Two runs: whether all parameters that they share differ by more than both leave open."""

    first: str = column("a run")
    second: str = column("another one")
    robots: tuple[str, ...] = column("names of their robots")
    robot: Literal["the same", "another file", "another one"] = column(
        "another file: the robots have one name and joints of the same kind, and their files differ"
    )
    shared: int = column("parameters that both have, refer to the same figure and sit on no bound")
    chi2: float | None = column(
        "of their differences, covariances counted; empty: both runs are of the same measurements"
    )
    freedom: int | None = column("directions in which measurements tell of them; empty: as before")
    p: float | None = column("chance of so much where the robot is the same; empty: as before")


@dataclass(frozen=True, kw_only=True)
class RunCause:
    """A cause that one of the runs found, or something unexplained."""

    run: str = column("the run")
    status: str = column("named, one_of, unexplained, data_fault")
    cause: str = column("id of the effect or fault")
    joint: int | None = column("number of its joint or link; empty: none")
    estimate: float = column("its size", "as `unit` says")
    sd: float = column("its standard deviation", "as `unit` says")
    unit: str = column("of the size (SI)")
    probability: float = column("that it is this cause rather than a rival")
    also_in: tuple[str, ...] = column("other runs that found it at the same place")


@dataclass(frozen=True)
class Comparison(StoredResults):
    """Runs side by side."""

    settings: tuple[Setting, ...]
    data: tuple[RunData, ...]
    accuracy: tuple[RunAccuracy, ...]
    parameters: tuple[ParameterDifference, ...]
    pairs: tuple[RunPair, ...]
    causes: tuple[RunCause, ...]

    @property
    def table(self) -> pd.DataFrame:
        """The parameters' differences as a DataFrame."""
        return self.results.tables["parameters.csv"]
