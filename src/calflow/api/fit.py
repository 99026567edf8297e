"""A fit: the identified robot as a notebook holds it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING

import pandas as pd

from calflow.api.inputs import effects_of, split_rows
from calflow.api.model import Model
from calflow.estimation.fit_summary import IdentifySummary
from calflow.estimation.identifiability import Statement
from calflow.estimation.identification import Identification, NoiseSource
from calflow.estimation.identification import identify as identified
from calflow.estimation.least_squares import Loss
from calflow.estimation.needed_conditions import NeededCondition
from calflow.estimation.parameters import Parameters
from calflow.estimation.progress import Say, draws, nobody
from calflow.faults import Fault, examined
from calflow.files.results import Results
from calflow.measurements.measurements import Measurements
from calflow.robot.robot import Robot
from calflow.stages.identify import results

if TYPE_CHECKING:
    from calflow.api.plots import Plots
    from calflow.reporting.material import Material

OPEN_SHOWN = 6  # statements of what the data leave open, beyond which the rest is counted


@dataclass(frozen=True, eq=False, repr=False)
class Fit:
    """An identified robot; its tables are those of a run's folder `identify`.

    measured are the measurements as they were given, faults the gross mistakes in them that were put right or left out.
    """

    identification: Identification
    measured: Measurements
    faults: tuple[Fault, ...]
    effects: tuple[str, ...]
    seed: int

    @cached_property
    def results(self) -> Results:
        """All tables and the summary, by their path in a run folder."""
        return results(self.identification, self.faults)

    @property
    def parameters(self) -> pd.DataFrame:
        """What was found, a row a parameter (see `identify/parameters.csv`)."""
        return self.results.tables["identify/parameters.csv"]

    @property
    def accuracy(self) -> pd.DataFrame:
        """The position error of each model on the way, on fitted and held-out rows (see `identify/accuracy.csv`)."""
        return self.results.tables["identify/accuracy.csv"]

    @property
    def covariance(self) -> pd.DataFrame:
        """The estimate's covariance in SI units, named by rows and columns."""
        return self.results.tables["identify/covariance.csv"].set_index("parameter")

    @property
    def residuals(self) -> pd.DataFrame:
        """What the model leaves of each row (see `identify/residuals.csv`)."""
        return self.results.tables["identify/residuals.csv"]

    @property
    def summary(self) -> IdentifySummary:
        """Noise, lack of fit and solver."""
        return self.identification.summary

    @property
    def left_open(self) -> tuple[Statement, ...]:
        """What the data do not tell."""
        return self.identification.identifiability.left_open

    @cached_property
    def model(self) -> Model:
        """The calibrated robot, to predict and compensate with."""
        needed = self.results.rows("identify/needed_conditions.csv", NeededCondition)
        return Model(self.identification.known, needed, self.measured, self.identification.data)

    @property
    def plot(self) -> Plots:
        """Its figures."""
        from calflow.api.plots import Plots

        return Plots(self.material)

    def material(self, title: str = "") -> Material:
        """Return what its figures and its report are made from."""
        from calflow.api.material import material_of

        return material_of(self.model, self.results, self.effects, self.seed, self.settings, title)

    @property
    def settings(self) -> dict[str, dict[str, object]]:
        """What a study would say to get it."""
        return {"identify": {"starts": self.identification.starts, "loss": self.identification.loss}}

    def __repr__(self) -> str:
        return "\n".join((f"Fit: {' + '.join(self.effects)}", self._accuracy.to_string(index=False), *self._said))

    def _repr_html_(self) -> str:
        said = "".join(f"<li>{escape(line)}</li>" for line in self._said)
        title = f"Fit: {escape(' + '.join(self.effects))}"
        return f"<b>{title}</b>{self._accuracy.to_html(index=False, float_format='{:.3f}'.format)}<ul>{said}</ul>"

    @property
    def _accuracy(self) -> pd.DataFrame:
        return self.accuracy[["model", "split", "n", "mean_mm", "max_mm"]].round(4)

    @property
    def _said(self) -> list[str]:
        """Faults of the data, what sits at a bound, and what the data do not tell."""
        bound = list(self.parameters.loc[self.parameters["at_bound"], "parameter"])
        left = [one.statement for one in self.left_open if one.kind != "bound"]
        return [
            *(fault.said for fault in self.faults),
            *([] if self.summary.converged else [f"the fit did not converge ({self.summary.solver.words})"]),
            f"at bounds: {', '.join(bound) or 'none'}",
            *(left[:OPEN_SHOWN] or ["the data tell every parameter"]),
            *([f"and {len(left) - OPEN_SHOWN} more in left_open"] if len(left) > OPEN_SHOWN else []),
        ]


def identify(
    robot: Robot,
    data: Measurements,
    effects: Sequence[str] = ("geometry", "joint-compliance"),
    *,
    parameters: Parameters | None = None,
    starts: int = 3,
    loss: Loss = "linear",
    noise: NoiseSource = "auto",
    seed: int = 1,
    say: Say = nobody,
) -> Fit:
    """Identify a robot from measurements, after gross mistakes in these were looked for.

    Args:
        robot: as its maker says.
        data: measurements with a split (see `Measurements.split`).
        effects: ids of what a real robot also does, in the order in which they are added.
        parameters: what is held, bounded or expected otherwise (see `Parameters.of`).
        starts: number of starting points of each fit.
        loss: how the square of a row's residual counts: linear, soft_l1, cauchy.
        noise: where the noise is to be taken from.
        seed: of all draws.
        say: is told how it goes on, `print` for example.

    Raises:
        InputError: robot or measurements lack what an effect needs, or the measurements are too few.
    """
    named = effects_of(effects, robot, data)
    robot = robot if parameters is None else parameters.on(robot, data, named)
    rows, faults = examined(split_rows(data).on(robot))
    found = identified(rows, named, starts=starts, loss=loss, noise=noise, rng=draws(seed), say=say)
    return Fit(found, data.on(robot), faults, named, seed)
