"""Curves: each finding's effect against the variable that explains it, before and after it was put into the model."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
import pandas as pd

from calflow.conditions import Row
from calflow.effects.base import Effect, Variable
from calflow.measurements import Measurements
from calflow.model import Model, over_rows
from calflow.robot.chain import Deflection
from calflow.robot.dimensions import nominal_dimensions, nominal_loads
from calflow.robot.statics import state
from calflow.stages.causes import Cause
from calflow.stages.extension import Fitted

COLUMNS = [
    "finding",
    "cause",
    "joint",
    "variable",
    "variable_unit",
    "x",
    "before_mm",
    "after_mm",
    "fitted_mm",
    "pose",
    "split",
]


def curves(final: Fitted, causes: Sequence[Cause], data: Measurements) -> pd.DataFrame:
    """Return a row a measured row and finding: the error along the direction in which the cause moves the tool.

    after is what the extended model leaves there, measured minus predicted; before is that with the cause's own part
    added back, fitted that part.
    """
    model, estimate = final.model, final.fit.estimate
    left = data.position - model.position(estimate, data.rows)
    jacobian = model.position_jacobian(estimate, data.rows)
    blocks, start = [], 0
    for effect in model.effects:
        own = slice(start, start + len(effect.declared))
        start = own.stop
        if effect not in causes:
            continue
        assert isinstance(effect, Cause)
        moved = jacobian[:, :, own] @ estimate[own]
        along = _direction(jacobian[:, :, own], estimate[own])
        variable = effect.effect.variable(effect.joint)
        after, fitted = (np.einsum("ra,ra->r", part, along) for part in (left, moved))
        block = {
            "finding": causes.index(effect) + 1, "cause": effect.id, "joint": effect.joint or None,
            "variable": variable.label, "variable_unit": variable.unit, "x": _values(model, effect, variable, data),
            "before_mm": 1e3 * (after + fitted), "after_mm": 1e3 * after, "fitted_mm": 1e3 * fitted,
            "pose": data.table["pose"], "split": data.table["split"],
        }  # fmt: skip
        blocks.append(pd.DataFrame(block)[COLUMNS])
    return pd.concat(blocks, ignore_index=True) if blocks else pd.DataFrame(columns=COLUMNS)


def _direction(jacobian: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Unit vectors (n_rows, 3) along which a cause acts: its strongest axis in each row, turned alike in neighbours.

    Where all of a cause's parameters act along one line, as on a joint's angle, a row's sign is that of its lever; it must
    not turn with the effect itself, or every error would look positive.
    """
    weighted = jacobian * np.abs(value)
    _, _, axes = np.linalg.svd(weighted.transpose(0, 2, 1), full_matrices=False)
    along = axes[:, 0, :]
    parallel = np.einsum("rap,rbp->rab", weighted, weighted)
    largest = np.argmax(np.abs(value) * np.abs(jacobian).sum(axis=(0, 1)))
    lever = np.einsum("ra,ra->r", along, jacobian[:, :, largest])
    mean = np.einsum("rab,rb->ra", parallel, along).mean(axis=0)
    if jacobian.shape[2] == 1:
        return along * np.where(lever < 0, -1.0, 1.0)[:, None]
    return along * np.where(along @ mean < 0, -1.0, 1.0)[:, None]


def _values(model: Model, cause: Effect, variable: Variable, data: Measurements) -> np.ndarray:
    c = ca.SX.sym("c", model.n_conditions)
    row = Row.unpack(model.robot, c, model.given)
    robot = model.robot
    now = state(robot, nominal_dimensions(robot), nominal_loads(robot), row, Deflection.zero(robot.n_joints))
    p = ca.SX.sym("p")
    function = ca.Function("variable", [p, c], [ca.densify(ca.SX(variable.value(now, row)))])
    return over_rows(function, np.zeros(1), data.rows)[0].ravel() * variable.factor
