"""The residual field as a run folder keeps it: what it was learnt from as a table, its figures and its gain as a document."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd

from calflow.estimation.residual_field import ResidualField
from calflow.files.results import Results
from calflow.files.tables import column, typed
from calflow.robot.robot import Robot

POSES, SUMMARY = "residual_field/poses.csv", "residual_field/summary.json"


@dataclass(frozen=True, kw_only=True)
class FieldPose:
    """A pose that the residual field, which is not physical, was learnt from; a header alone where it is not applied."""

    q: Mapping[str, float] = column("joint readings", name="q{joint}_{deg|mm}")
    left_x_mm: float = column("measured minus predicted position there, along the measuring frame's x", "mm")
    left_y_mm: float = column("the same along y", "mm")
    left_z_mm: float = column("the same along z", "mm")


@dataclass(frozen=True, kw_only=True)
class FieldSummary:
    """The residual field's figures, and what it gains."""

    kind: Literal["not physical"] = column("what it is: no cause explains it")
    applied: bool = column("whether predictions and commands have it: only where it gains something at left-out poses")
    statement: str = column("the same in a sentence")
    poses: int = column("number of fitted poses that it was learnt from, or would have been")
    blocks: int = column("number of blocks of these that were left out in turn")
    rms_without_mm: float | None = column("rms distance at left-out poses without it; null: too few poses", "mm")
    rms_corrected_mm: float | None = column("the same with it, learnt from the others", "mm")
    p: float = column("chance of so much where nothing is gained")
    covered: float | None = column("share of left-out coordinates within their 95 % intervals")
    size_mm: float | None = column(
        "its standard deviation per axis where nothing was measured; null: not applied", "mm"
    )
    rest_mm: float | None = column("standard deviation per axis of what is left and not smooth", "mm")
    own_mm: float | None = column("the part of it that is not the device's noise", "mm")
    lengths: tuple[float, ...] = column("over which it changes, a joint, as parts of the measured range")


@dataclass(frozen=True, kw_only=True)
class FieldAccuracy:
    """How far predictions are from positions, without the residual field and with it, at poses that it has not seen."""

    correction: Literal["none", "residual field (not physical)"] = column("what was added to the model's predictions")
    where: Literal["left-out blocks", "holdout"] = column(
        "left-out blocks: of the training rows, seen by the model; holdout: rows that nothing has seen"
    )
    n: int = column("number of poses of the blocks, or rows held out")
    mean_mm: float = column("mean distance", "mm")
    rms_mm: float = column("its root mean square", "mm")
    max_mm: float = column("the largest", "mm")
    covered: float | None = column(
        "share of the coordinates within their 95 % intervals, the device's noise included; of blocks with it alone"
    )


def pose_table(field: ResidualField | None, robot: Robot) -> pd.DataFrame:
    """Return the table of `FieldPose`s."""
    n = robot.n_joints
    nodes, left = (field.nodes, field.left) if field else (np.zeros((0, n)), np.zeros((0, 3)))
    columns = dict(zip(_names(robot), (nodes * _factors(robot)).T, strict=True))
    return typed(pd.DataFrame(columns | {f"left_{a}_mm": 1e3 * left[:, k] for k, a in enumerate("xyz")}), FieldPose)


def read_field(results: Results, robot: Robot) -> ResidualField | None:
    """Rebuild the field; None where the results have none, or it is not applied."""
    if SUMMARY not in results:
        return None
    told = results.document(SUMMARY, FieldSummary)
    if not told.applied or told.size_mm is None or told.rest_mm is None or told.own_mm is None:
        return None
    table = results.tables[POSES]
    nodes = table[_names(robot)].to_numpy(dtype=float) / _factors(robot)
    left = table[["left_x_mm", "left_y_mm", "left_z_mm"]].to_numpy(dtype=float) / 1e3
    return ResidualField(nodes, left, np.array(told.lengths), told.size_mm / 1e3, told.rest_mm / 1e3, told.own_mm / 1e3)


def _names(robot: Robot) -> Sequence[str]:
    return [f"q{i + 1}_{joint.shown[0]}" for i, joint in enumerate(robot.joints)]


def _factors(robot: Robot) -> np.ndarray:
    return np.array([joint.shown[1] for joint in robot.joints])
