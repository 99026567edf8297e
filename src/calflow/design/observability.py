"""Observability: what every number of poses is worth, the most telling first."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calflow.design.search.exchange import information
from calflow.design.search.optimality import ToolError, indices
from calflow.estimation.identifiability import NULL
from calflow.files.tables import column, to_frame

CURVE = 30  # numbers of poses of which the worth is told


@dataclass(frozen=True, kw_only=True)
class Observability:
    """What a number of poses, the most telling first, is worth."""

    n_poses: int = column("number of poses, besides those that were measured already and count")
    indices: Mapping[str, float] = column(
        "observability indices O1 to O5 of these poses, parameters scaled by their priors", name="O{1|2|3|4|5}"
    )
    expected_sd_mm: float = column(
        "root mean square over the task (the workspace, where the study names none) of the predicted position's standard "
        "deviation",
        "mm",
    )
    worst_sd_mm: float = column("the largest of these standard deviations", "mm")


def observability(whitened: np.ndarray, prior: np.ndarray, tool: ToolError, added: bool) -> pd.DataFrame:
    """Return indices and the tool's expected standard deviation against the number of poses.

    whitened (n_poses, n_axes, n_parameters) are in order, prior is the information before them. Parameters are scaled by their
    priors, so an index compares what the data say with what was known before. The standard deviation is the root mean square
    over the task's poses of the predicted position's, all three axes. Poses that are added to others are told from the first.
    """
    n_parameters = whitened.shape[2]
    singular = np.linalg.svd(whitened.reshape(-1, n_parameters), compute_uv=False)
    rank = int((singular > NULL * singular[0]).sum())
    first = 0 if added else min(len(whitened), -(-rank // whitened.shape[1]))
    rows = []
    for n in sorted({*range(first, len(whitened) + 1, max(1, (len(whitened) - first) // CURVE)), len(whitened)}):
        part = whitened[:n]
        variances = tool.variances(np.linalg.inv(information(part, prior)))
        own = indices(part.reshape(-1, n_parameters), rank)
        rows.append(
            Observability(
                n_poses=n,
                indices={f"O{k}": value for k, value in enumerate(own, start=1)},
                expected_sd_mm=1e3 * float(np.sqrt(tool.shares @ variances)),
                worst_sd_mm=1e3 * float(np.sqrt(variances.max())),
            )
        )
    return to_frame(rows, Observability)
