"""The curves of causes: the error of every measured row along the direction in which a cause acts, against its variable."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calflow.diagnosis.fitted import Fitted
from calflow.effects import Effect
from calflow.effects.base import Variable
from calflow.effects.cause import Cause
from calflow.estimation.accuracy import completed, error_jacobian, errors, judged_unit
from calflow.estimation.smooth_functions import JointField
from calflow.files.deferred import pd
from calflow.files.tables import column, to_frame, typed
from calflow.files.units import METRE
from calflow.measurements.measurements import Measurements
from calflow.model import Model
from calflow.observations import leading_units

PARALLEL = 0.02  # share of an effect across its joint's direction, below which it counts as an error of that joint


@dataclass(frozen=True, kw_only=True)
class CurvePoint:
    """A measured row's error along the direction in which a cause acts, with the variable that explains it."""

    finding: int = column("number of the cause among those in the extended model, from 1")
    cause: str = column("its id")
    joint: int | None = column("number of its joint or link; empty: none")
    variable: str = column("the variable that explains it, in words")
    variable_unit: str = column("of the variable; empty: none")
    x: float = column("the variable", "as `variable_unit` says")
    before_mm: float = column("measured minus predicted, without this cause's contribution; empty: no lengths", "mm")
    after_mm: float = column("the same with the whole extended model", "mm")
    fitted_mm: float = column("the cause's contribution", "mm")
    pose: str = column("as in the measurements")
    split: str = column("train, holdout; empty: left out as faulty")
    before: float = column("as before_mm, in `error_unit`")
    after: float = column("as after_mm, in `error_unit`")
    fitted: float = column("as fitted_mm, in `error_unit`")
    error_unit: str = column("the unit by which the model is judged: mm, or where no lengths were measured mrad, px, …")


def curves(final: Fitted, causes: Sequence[Cause], data: Measurements) -> pd.DataFrame:
    """Return one row per measured row and finding: the error along the direction in which the cause moves the tool.

    after is the extended model's residual there, measured minus predicted; fitted is the cause's contribution, before their sum.
    """
    model, estimate = final.model, final.fit.estimate
    left = -np.nan_to_num(errors(model, estimate, data))
    model, estimate = completed(model, estimate, data)
    turned = replace(model, effects=(*model.effects, JointField(model.robot, orders=0)))
    whole = error_jacobian(turned, np.append(estimate, np.zeros(model.robot.n_joints)), data)
    jacobian, levers = np.split(whole, [len(estimate)], axis=2)
    unit = judged_unit(leading_units(data))
    lengths = unit.scale if unit == METRE else np.nan
    blocks = []
    for cause in final.causes:
        columns = model.columns(cause)
        moved = jacobian[:, :, columns] @ estimate[columns]
        lever = levers[:, :, cause.joint - 1] if cause.joint else None
        along = _acting_along(jacobian[:, :, columns], estimate[columns], lever)
        variable = cause.effect.variable(cause.joint)
        after, fitted = (np.einsum("ra,ra->r", part, along) for part in (left, moved))
        block = {
            "finding": causes.index(cause) + 1, "cause": cause.id, "joint": cause.joint or None,
            "variable": variable.label, "variable_unit": variable.unit, "x": _variable_values(model, cause, variable, data),
            "before_mm": lengths * (after + fitted), "after_mm": lengths * after, "fitted_mm": lengths * fitted,
            "before": unit.shown(after + fitted), "after": unit.shown(after), "fitted": unit.shown(fitted),
            "error_unit": unit.label,
            "pose": data.table["pose"], "split": data.table["split"],
        }  # fmt: skip
        blocks.append(typed(pd.DataFrame(block), CurvePoint))
    return pd.concat(blocks, ignore_index=True) if blocks else to_frame((), CurvePoint)


def _acting_along(jacobian: np.ndarray, value: np.ndarray, lever: np.ndarray | None) -> np.ndarray:
    """Return the unit vectors (n_rows, 3) along which a cause acts.

    If all its parameters move the tool as its joint does, they are along the joint's lever (n_rows, 3), whose sign does not follow
    the effect, as else every error would look positive. Otherwise they are the principal axis of each row, with one common side.
    """
    moved = jacobian * np.abs(value)
    if lever is not None:
        along = lever / np.maximum(np.linalg.norm(lever, axis=1), 1e-12)[:, None]
        apart = moved - along[:, :, None] * np.einsum("ra,rap->rp", along, moved)[:, None, :]
        if np.linalg.norm(apart) < PARALLEL * np.linalg.norm(moved):
            return along
    _, _, axes = np.linalg.svd(moved.transpose(0, 2, 1), full_matrices=False)
    along = axes[:, 0, :]
    mean = np.einsum("rap,rbp,rb->a", moved, moved, along)
    return along * np.where(along @ mean < 0, -1.0, 1.0)[:, None]


def _variable_values(model: Model, cause: Effect, variable: Variable, data: Measurements) -> np.ndarray:
    rigid = Model(model.robot, (), model.given)
    (values,) = rigid.figures(
        "variable", lambda p, c, at: [variable.value(at.state, at.row)], rigid.nominal, data.conditions
    )
    return values.ravel() * variable.factor
