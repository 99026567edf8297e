"""The task: poses and payloads at which the tool's error is what counts, whatever the parameters are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calflow.design.candidates import candidates, pack
from calflow.design.optimality import ToolError
from calflow.model import Model


@dataclass(frozen=True, eq=False)
class Task:
    """Where the tool must be right: packed conditions (n_conditions, n_points), all points alike."""

    rows: np.ndarray

    @staticmethod
    def within(
        model: Model, payloads: Sequence[str], marker: str, region: np.ndarray | None, number: int,
        rng: np.random.Generator,
    ) -> Task:  # fmt: skip
        """Return so many poses, drawn over a region (2, 3) [m] of the measuring frame, under each of these payloads.

        Raises:
            InputError: hardly any pose reaches the region.
        """
        readings, _ = candidates(model, number, payloads[0], marker, region, rng)
        return Task.of(model, readings, payloads, marker)

    @staticmethod
    def of(model: Model, readings: np.ndarray, payloads: Sequence[str], marker: str) -> Task:
        """Return these joint readings (n, n_joints), each under each of these payloads."""
        return Task(np.hstack([pack(model, readings, payload, marker) for payload in payloads]))

    def criterion(self, model: Model) -> ToolError:
        """Return the tool's error over the task, of a model whose parameters are scaled by their priors."""
        slopes = model.point_jacobian(model.nominal, self.rows) * model.prior_sd
        return ToolError(slopes, np.full(len(slopes), 1 / len(slopes)))
