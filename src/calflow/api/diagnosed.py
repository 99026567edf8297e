"""A diagnosis: what the identified model lacks, as a notebook holds it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING

import pandas as pd

from calflow.api.fit import Fit
from calflow.api.inputs import check_same
from calflow.api.model import Model
from calflow.api.rows import Rows
from calflow.design.discrimination import NextPose, SeparationRow, questions
from calflow.diagnosis.diagnosis import diagnose as diagnosed
from calflow.diagnosis.findings.extended_model import DiagnosisSummary, extended_model
from calflow.diagnosis.findings.finding import Finding
from calflow.diagnosis.findings.tables import CandidateRow
from calflow.diagnosis.search.trial import FALSE_ALARM
from calflow.estimation.needed_conditions import NeededCondition
from calflow.estimation.progress import Say, draws, nobody
from calflow.files.results import Results
from calflow.measurements.measurements import Measurements
from calflow.stages.diagnose import results

if TYPE_CHECKING:
    from calflow.api.plots import Plots
    from calflow.reporting.material import Material


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis:
    """What was found that a fit's model lacks, and the model extended by it; tables are those of a run's `diagnose`."""

    fit: Fit
    model: Model
    results: Results
    false_alarm: float

    @cached_property
    def findings(self) -> Rows[Finding]:
        """Faults of the data, causes, and what no cause explains, best first; none where nothing is lacking."""
        return Rows(self.results.tables["diagnose/findings.csv"], Finding)

    @cached_property
    def candidates(self) -> Rows[CandidateRow]:
        """Every cause that was tested, and why others were not."""
        return Rows(self.results.tables["diagnose/candidates.csv"], CandidateRow)

    @cached_property
    def next_poses(self) -> Rows[NextPose]:
        """The poses to measure next, so that findings are told from their rivals."""
        return Rows(self.results.tables["diagnose/next_poses.csv"], NextPose)

    @cached_property
    def separations(self) -> Rows[SeparationRow]:
        """How far each finding is from each rival, and what to do about it."""
        return Rows(self.results.tables["diagnose/separations.csv"], SeparationRow)

    @property
    def parameters(self) -> pd.DataFrame:
        """The extended model's parameters."""
        return self.results.tables["diagnose/parameters.csv"]

    @property
    def accuracy(self) -> pd.DataFrame:
        """The accuracy of the models before, and of each with one more cause."""
        return self.results.tables["diagnose/accuracy.csv"]

    @property
    def covariance(self) -> pd.DataFrame:
        """The covariance of the extended model's estimate in SI units, named by rows and columns."""
        return self.results.tables["diagnose/covariance.csv"].set_index("parameter")

    @property
    def residuals(self) -> pd.DataFrame:
        """What the extended model leaves of each row."""
        return self.results.tables["diagnose/residuals.csv"]

    @property
    def plot(self) -> Plots:
        """Its figures."""
        from calflow.api.plots import Plots

        return Plots(self.material)

    def material(self, title: str = "") -> Material:
        """Return what its figures and its report are made from."""
        from calflow.api.material import material_of

        settings = self.fit.settings | {"diagnose": {"false_alarm": self.false_alarm}}
        return material_of(
            self.model, self.fit.results | self.results, self.fit.effects, self.fit.seed, settings, title
        )

    def __repr__(self) -> str:
        last = self.accuracy.groupby("split", sort=False).last()["mean_mm"].round(4)
        error = ", ".join(f"{value:g} mm {split}" for split, value in last.items())
        return "\n".join(
            ("Diagnosis:", *(f"  {line}" for line in self._said), f"  mean position error with it: {error}")
        )

    def _repr_html_(self) -> str:
        said = "".join(f"<li>{escape(line)}</li>" for line in self._said)
        shown = self.accuracy[["model", "split", "n", "mean_mm", "max_mm"]]
        return f"<b>Diagnosis</b><ul>{said}</ul>{shown.to_html(index=False, float_format='{:.3f}'.format)}"

    @property
    def _said(self) -> list[str]:
        said = [f"{one.status.replace('_', ' ')}: {one.statement}" for one in self.findings]
        unseen = self.results.document("diagnose/summary.json", DiagnosisSummary).unseen
        return said or [f"nothing was found that the model lacks{f'; {unseen}' if unseen else ''}"]


def diagnose(
    fit: Fit,
    data: Measurements,
    *,
    false_alarm: float = FALSE_ALARM,
    causes: int = 10,
    catalogue: Sequence[str] = (),
    leave_out: Sequence[str] = (),
    seed: int | None = None,
    say: Say = nobody,
) -> Diagnosis:
    """Name what a fit's model lacks, add it to the model, and ask for the poses that tell it from its rivals.

    Args:
        fit: see `identify`.
        data: the measurements that it is from.
        false_alarm: chance that anything is found where nothing is.
        causes: the most to add.
        catalogue: ids of the effects to look for; all where there are none.
        leave_out: ids not to look for.
        seed: of all draws; the fit's where it is None.
        say: is told how it goes on.

    Raises:
        InputError: the measurements are others than the fit's.
    """
    check_same(data, fit.measured)
    rng, known, rows = draws(fit.seed if seed is None else seed), fit.identification.known, fit.identification.data
    found = diagnosed(
        known, rows, false_alarm=false_alarm, causes=causes, catalogue=tuple(catalogue), leave_out=tuple(leave_out),
        rng=rng, say=say,
    )  # fmt: skip
    made = results(found, known, rows, questions(found, rows, rng), fit.results, rng)
    needed = made.rows("diagnose/needed_conditions.csv", NeededCondition)
    return Diagnosis(fit, Model(extended_model(found, known, rows), needed, fit.measured, rows), made, false_alarm)
