"""The summaries of identify and of diagnose: noise, lack of fit and the solver, as values that later stages read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calflow.estimation.lack_of_fit import SIGNIFICANT, NoiseDoubt
from calflow.estimation.least_squares import Loss
from calflow.estimation.noise import Noise, PerUnit, Source
from calflow.files.tables import column
from calflow.files.units import METRE, RADIAN
from calflow.observations import Observation


@dataclass(frozen=True, kw_only=True)
class Solver:
    """How the solver ended."""

    name: str = column("which it was", default="IPOPT")
    status: str = column("what it says of its end")
    iterations: int = column("how many it made")

    @property
    def words(self) -> str:
        """The same in words."""
        return f"{self.name}: {self.status}, {self.iterations} iterations"


@dataclass(frozen=True, kw_only=True)
class FitSummary:
    """What is known of a fit's noise, and what the model leaves beyond it."""

    noise_sources: tuple[Source, ...] = column("where the noise of each series is known from: repeats, file, estimated")
    sigma_mm: float | None = column(
        "the noise of a row, per axis; of noise that grows with range, that at no distance; null: no lengths were measured",
        "mm",
    )
    noise_growth_mm_per_m: float = column("by how much the noise grows with range", "mm/m", default=0.0)
    discrepancy_mm: float = column(
        "what the model leaves of lengths beyond the noise, per axis; 0 without lengths", "mm"
    )
    rotation_discrepancy_mrad: float | None = column(
        "the same of orientations; null: not measured", "mrad", default=None
    )
    discrepancies: dict[str, float] = column(
        "what the model leaves beyond the noise, by the unit it is in: mm, mrad, px, …"
    )
    elsewhere_mm: float = column(
        "what it errs by beyond that, and beyond what is told of its parameters, at poses that it was not fitted to, per axis: "
        "by leaving out one training pose at a time",
        "mm",
        default=0.0,
    )
    intraclass: float = column(
        "correlation of what the markers of a standstill err, axis by axis; 0: each for itself", default=0.0
    )
    loss: Loss = column("of the fit")
    reduced_chi2: float | None = column("chi² per degree of freedom; null: cannot be told, the noise came from the fit")
    lack_of_fit_p: float | None = column("chance of so much where the model is right; null: cannot be told")
    solver: Solver = column("name, status, iterations")
    converged: bool = column("whether the solver reached its optimum")

    @property
    def noise_known(self) -> bool:
        """Whether any of it is known apart from the fit."""
        return any(source != "estimated" for source in self.noise_sources)

    def discrepancy_of(self, observed: Sequence[Observation]) -> PerUnit:
        """Return the discrepancies in the units of what was observed."""
        units = {unit.label: unit for observation in observed for unit in observation.units}
        return PerUnit(tuple((units[label], size / units[label].scale) for label, size in self.discrepancies.items()))

    @property
    def lack_of_fit(self) -> float:
        """How many times the noise the model leaves; nan where the noise was estimated from the fit itself."""
        if not self.noise_known or self.reduced_chi2 is None:
            return float("nan")
        return float(np.sqrt(self.reduced_chi2))

    @property
    def lacks_fit(self) -> bool:
        """Whether the model leaves more than its noise, beyond chance."""
        return self.lack_of_fit_p is not None and self.lack_of_fit_p < SIGNIFICANT and self.lack_of_fit > 1


def discrepancies(noise: Noise) -> dict[str, Any]:
    """Return the fields of a `FitSummary` that say what the model leaves beyond the noise."""
    turned = RADIAN in dict(noise.further)
    return {
        "discrepancy_mm": 1e3 * noise.discrepancy[METRE],
        "rotation_discrepancy_mrad": 1e3 * noise.discrepancy[RADIAN] if turned else None,
        "discrepancies": {unit.label: unit.shown(size) for unit, size in noise.discrepancy.sizes},
    }


@dataclass(frozen=True, kw_only=True)
class Extrapolation:
    """A joint whose held-out readings lie beyond what was fitted: accuracy there is a guess, good or bad."""

    joint: int = column("its number")
    rows: int = column("held-out rows beyond the fitted readings")

    @property
    def words(self) -> str:
        """The same in words."""
        return f"joint {self.joint}: {self.rows} held-out rows lie beyond the readings that were fitted"


@dataclass(frozen=True, kw_only=True)
class IdentifySummary(FitSummary):
    """How identify ended: noise, lack of fit, what the data determine, and the solver."""

    spread_mm: float = column("mean distance of the measured points from their middle", "mm")
    rank: int = column("number of directions that the data determine")
    parameters: int = column("number of parameters")
    rank_by_effect: dict[str, int] = column("directions that each effect adds, by its id")
    effective_parameters: float = column("parameters that the data determine rather than the prior")
    training_poses: int = column("poses that were fitted")
    heldout_poses: int = column("poses that were held out")
    equilibrium_error_um: float = column("how far a fourth turn of the equilibrium would move any pose", "um")
    starts: int = column("fits from different starting points")
    starts_agreeing: int = column("of which came to the same result")
    extrapolation: tuple[Extrapolation, ...] = column("joints held out beyond what was fitted: joint, rows", default=())
    noise_doubts: tuple[NoiseDoubt, ...] = column(
        "stated noises that repeats or the fit contradict: series, sizes, p", default=()
    )
    time_origin_s: float | None = column(
        "reading of the clock that times count from; null: no times", "s", default=None
    )
    conditions: tuple[str, ...] = column(
        "the optional conditions that the measurements state: approach, travel, wrench, …", default=()
    )
    notes: tuple[str, ...] = column(
        "what was assumed of the measurements, and which rows have no measured value", default=()
    )
