"""The table of parameters: what a fit found, and how far the data say so."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pandas as pd

from calflow.estimation.fit import Fit


def parameter_table(result: Fit) -> pd.DataFrame:
    """Return a row a parameter, with its estimate and how much of that is the prior's."""
    variance = np.diag(result.covariance)
    free = ~result.at_bound
    alone = np.diag(np.linalg.inv(_scaled_information(result)))  # a parameter at a bound: what it would have off it
    share = np.where(free, variance / result.model.prior_sd**2, alone)
    table = pd.DataFrame(asdict(parameter) for parameter in result.model.parameters)
    return pd.DataFrame(
        {
            "parameter": [parameter.name for parameter in result.model.parameters],
            "effect": table["effect"],
            "variant": table["variant"],
            "part": table["part"],
            "symbol": table["symbol"],
            "unit": table["unit"],
            "nominal": table["nominal"],
            "estimate": result.estimate,
            "sd": np.where(free, np.sqrt(variance), np.nan),
            "lower": table["lower"],
            "upper": table["upper"],
            "at_bound": result.at_bound,
            "prior_share": np.minimum(1.0, share),
            "figure": table["figure"],
            "calibrated": table["figure"] + result.estimate,
            "meaning": table["meaning"],
        }
    )


def _scaled_information(result: Fit) -> np.ndarray:
    return result.information * np.outer(result.model.prior_sd, result.model.prior_sd)


def covariance_table(result: Fit) -> pd.DataFrame:
    """Return the estimate's covariance (SI units), named by rows and columns."""
    names = [parameter.name for parameter in result.model.parameters]
    table = pd.DataFrame(result.covariance, columns=names)
    table.insert(0, "parameter", names)
    return table
