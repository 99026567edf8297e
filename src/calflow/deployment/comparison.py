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
    """A setting or version in which the runs differ."""

    setting: str = column("key of the study, stage setting or version")
    of: Mapping[str, str] = column("the value in a run; empty: none", name="{run}")


@dataclass(frozen=True, kw_only=True)
class RunData:
    """The measurements of a run, and the noise that was assumed for them."""

    run: str = column("the run")
    files: tuple[str, ...] = column("measurement files")
    poses: int = column("poses that were fitted")
    held_out: int = column("poses that were held out")
    noise_mm: float = column("noise of a row, per axis; empty: no lengths were measured", "mm")
    noise_from: tuple[str, ...] = column("source of the noise")
    discrepancy_mm: float = column("the model's discrepancy beyond the noise, per axis", "mm")
    same_data_as: tuple[str, ...] = column("runs of the same measurements")


@dataclass(frozen=True, kw_only=True)
class RunAccuracy(Accuracy):
    """The accuracy of a model of a run on one split."""

    run: str = column("the run")


@dataclass(frozen=True, kw_only=True)
class ParameterDifference:
    """The difference of a parameter that two runs share."""

    first: str = column("a run")
    second: str = column("another one")
    parameter: str = column("its name")
    unit: str = column("of the figures in this row (SI)")
    first_value: float = column("the first run's estimate", "as `unit` says")
    second_value: float = column("the second run's estimate", "as `unit` says")
    difference: float = column("second minus first", "as `unit` says")
    sd: float | None = column("its standard deviation; empty: both runs are of the same measurements", "as `unit` says")
    p: float | None = column(
        "p-value of the difference of this parameter alone, or of its curve as a whole; empty: as before"
    )
    significant: bool | None = column(
        "whether it is significant among all parameters of the pair (Holm 1979, 1 %), a curve as one; empty: as before"
    )
    curve: str = column("the curve of which it is a figure; empty: none")
    meaning: str = column("what it is, in words")


@dataclass(frozen=True, kw_only=True)
class RunPair:
    """Two runs, with the test whether their shared parameters differ by more than their covariances explain."""

    first: str = column("a run")
    second: str = column("another one")
    robots: tuple[str, ...] = column("names of their robots")
    robot: Literal["the same", "another file", "another one"] = column(
        "another file: the robots have one name and joints of the same kind, and their files differ"
    )
    shared: int = column("parameters that both have, with the same nominal figure and not at a bound")
    chi2: float | None = column(
        "chi-squared of the differences, with both covariances; empty: both runs are of the same measurements"
    )
    freedom: int | None = column("its degrees of freedom: directions that the measurements determine; empty: as before")
    p: float | None = column("its p-value, if the robot is the same; empty: as before")


@dataclass(frozen=True, kw_only=True)
class RunCause:
    """A cause found by one of the runs, or an unexplained error."""

    run: str = column("the run")
    status: str = column("named, one_of, unexplained, data_fault")
    cause: str = column("id of the effect or fault")
    joint: int | None = column("number of its joint or link; empty: none")
    estimate: float = column("its size", "as `unit` says")
    sd: float = column("its standard deviation", "as `unit` says")
    unit: str = column("of the size (SI)")
    probability: float = column("posterior probability of this cause against its rivals")
    also_in: tuple[str, ...] = column("other runs that found it at the same place")


@dataclass(frozen=True)
class Comparison(StoredResults):
    """Runs side by side; notes: which were fitted again with the causes of all, or could not be."""

    settings: tuple[Setting, ...]
    data: tuple[RunData, ...]
    accuracy: tuple[RunAccuracy, ...]
    parameters: tuple[ParameterDifference, ...]
    pairs: tuple[RunPair, ...]
    causes: tuple[RunCause, ...]
    notes: tuple[str, ...]

    @property
    def table(self) -> pd.DataFrame:
        """The parameters' differences as a DataFrame."""
        return self.results.tables["parameters.csv"]
