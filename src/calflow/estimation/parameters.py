"""The table of parameters: what a fit found, and how far the data say so."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
import pandas as pd

from calflow.estimation.fit import Fit
from calflow.files.tables import column, typed
from calflow.robot.parameter import Parameter

UNIT = "as `unit` says"


@dataclass(frozen=True, kw_only=True)
class FittedParameter:
    """A parameter of a fitted model: what was found, and how far the data say so."""

    parameter: str = column("its name, unique in the model")
    effect: str = column("id of its effect")
    variant: str = column("the effect's variant")
    part: str = column("the part of the robot that it belongs to")
    symbol: str = column("what it is of that part")
    joint: int | None = column("number of its joint or link")
    unit: str = column("of the figures in this row (SI)")
    nominal: float = column("its value where the effect is absent", UNIT)
    estimate: float = column("what the fit found", UNIT, sd="sd")
    sd: float = column(
        "standard deviation of the estimate, after diagnose with what may be left in the errors of rows near each other; "
        "empty at a bound",
        UNIT,
    )
    lower: float = column("the least that is allowed", UNIT)
    upper: float = column("the most that is allowed", UNIT)
    prior_mean: float = column("what is expected of it before anything is measured", UNIT)
    prior_sd: float = column("standard deviation of that", UNIT)
    at_bound: bool = column("whether the estimate sits on a bound")
    prior_share: float = column("share of the estimate's variance that is the prior's; 1: the data say nothing")
    figure: float = column("the maker's figure that the parameter's value is added to", UNIT)
    calibrated: float = column("figure + estimate", UNIT, sd="sd")
    meaning: str = column("what it is, in words")

    def as_parameter(self) -> Parameter:
        """Return the parameter that it is a row of."""
        tag = self.parameter.removeprefix(f"{self.part}.").removesuffix(self.symbol).rstrip(".")
        return Parameter(
            self.effect, self.part, self.symbol, self.unit, self.prior_sd, self.lower, self.upper, self.nominal, self.figure,
            self.meaning, self.joint or 0, self.variant, tag, self.prior_mean,
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Covariances:
    """A row of the covariance by which poses are predicted: errors that rows share are in the discrepancy, and not here again."""

    parameter: str = column("the row's parameter")
    of: Mapping[str, float] = column(
        "covariance with the column's parameter", "the units' product (SI)", name="{parameter}"
    )


def parameter_table(result: Fit, covariance: np.ndarray) -> pd.DataFrame:
    """Return a row a parameter, with its estimate, the sd of a covariance, and how much of the estimate is the prior's."""
    variance = np.diag(result.covariance)
    free = ~result.at_bound
    alone = np.diag(np.linalg.inv(_scaled_information(result)))  # a parameter at a bound: what it would have off it
    share = np.where(free, variance / result.model.prior_sd**2, alone)
    table = pd.DataFrame(asdict(parameter) for parameter in result.model.parameters)
    made = pd.DataFrame(
        {
            "parameter": [parameter.name for parameter in result.model.parameters],
            "effect": table["effect"],
            "variant": table["variant"],
            "part": table["part"],
            "symbol": table["symbol"],
            "joint": table["joint"].where(table["joint"] > 0).astype("Int64"),
            "unit": table["unit"],
            "nominal": table["nominal"],
            "estimate": result.estimate,
            "sd": np.where(free, np.sqrt(np.diag(covariance)), np.nan),
            "lower": table["lower"],
            "upper": table["upper"],
            "prior_mean": table["prior_mean"],
            "prior_sd": table["prior_sd"],
            "at_bound": result.at_bound,
            "prior_share": np.minimum(1.0, share),
            "figure": table["figure"],
            "calibrated": table["figure"] + result.estimate,
            "meaning": table["meaning"],
        }
    )
    return typed(made, FittedParameter)


def _scaled_information(result: Fit) -> np.ndarray:
    return result.information * np.outer(result.model.prior_sd, result.model.prior_sd)


def covariance_table(parameters: Sequence[Parameter], covariance: np.ndarray) -> pd.DataFrame:
    """Return the estimates' covariance (SI units), named by rows and columns."""
    names = [parameter.name for parameter in parameters]
    table = pd.DataFrame(covariance, columns=names)
    table.insert(0, "parameter", names)
    return typed(table, Covariances)
