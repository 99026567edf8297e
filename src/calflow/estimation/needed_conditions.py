"""The optional conditions of a row that a calibrated model's positions depend on, by the sparsity of its graph."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from calflow.files.problems import InputError, Problem, refuse
from calflow.files.tables import column
from calflow.files.units import SUFFIXES
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import column_names, condition_columns
from calflow.model import Model
from calflow.robot.mechanism import Row
from calflow.robot.robot import Robot

HOW_TO_GO_ON = '--without-conditions (missing = "widen") goes on with a wider standard deviation'
AT_REST = ("speed", "acceleration", "image_row")  # zero unless stated


@dataclass(frozen=True, kw_only=True)
class NeededCondition:
    """A condition of a row on which the robot's position depends."""

    condition: str = column("its name: approach, travel, wrench, torque, time, temperature, order")
    effects: tuple[str, ...] = column("ids of the effects that depend on it")
    columns: str = column("the columns that state it, in words")
    spread_mm: float = column(
        "error of the model's positions without it, per axis: root mean square over the fitted rows", "mm"
    )


def needed_conditions(model: Model, estimate: np.ndarray, data: Measurements) -> tuple[NeededCondition, ...]:
    """Return the optional conditions on which the markers' positions depend, by the graph's sparsity, and the size of each effect.

    Those on which only the device depends are left out, and the time of a step, after which rows without a time are taken to be.
    """
    rows = data.only(data.train)
    model = model.later(rows)
    needed = []
    for condition in to_state(model):
        dependent = [effect.id for effect in model.effects if condition in to_state(replace(model, effects=(effect,)))]
        left = tuple(name for name in model.given if name != condition)
        lost = _points(model, estimate, rows) - _points(replace(model, given=left), estimate, rows)
        needed.append(
            NeededCondition(
                condition=condition, effects=tuple(dict.fromkeys(dependent or (effect.id for effect in model.effects))),
                columns=_columns(condition, model.robot), spread_mm=1e3 * float(np.sqrt((lost**2).mean(axis=0)).max()),
            )
        )  # fmt: skip
    return tuple(needed)


def check_stated(needed: Iterable[NeededCondition], given: Sequence[str], instead: str = "") -> None:
    """Check that rows state the needed conditions; instead tells the user how to go on without them.

    Raises:
        InputError: conditions are missing; one problem per effect and condition.
    """
    remedy = f"; {instead}" if instead else ""
    problems = [
        Problem(f"effect '{effect}' needs {need.columns}, which the rows lack{remedy}")
        for need in needed if need.condition not in given for effect in need.effects
    ]  # fmt: skip
    if problems:
        raise InputError(problems)


def check_payload_stated(model: Model, carried: Sequence[str], stated: bool) -> None:
    """Check that a payload is stated if the model's positions depend on it and payloads were carried; else raise InputError."""
    if carried and not stated and "payload" in depended_on(model):
        raise refuse(
            f'expected {", ".join(model.robot.payloads)} or "" for nothing (in a table: a column payload, with an empty cell for '
            f"nothing), since the robot was calibrated with {' and '.join(carried)} and gives way under what it carries",
            key="payload",
        )


def _points(model: Model, estimate: np.ndarray, rows: Measurements) -> np.ndarray:
    """Return the markers' positions by the model's given conditions alone, shape (n_rows, 3) [m]."""
    return model.point(estimate, rows.stating(model.given).conditions)


def depended_on(model: Model) -> list[str]:
    """Return the conditions that a marker's position depends on, its readings among them."""
    _, c, predicted = model.symbols
    depends = np.array(ca.which_depends(predicted.point, c, 1, False), dtype=bool)
    return [name for name, span in Row.spans(model.robot, model.given).items() if depends[span].any()]


def to_state(model: Model) -> list[str]:
    """Return the given conditions that a marker's position depends on and that are not zero unless stated."""
    return [name for name in depended_on(model) if name in model.given and name not in AT_REST]


def _columns(condition: str, robot: Robot) -> str:
    dimensions = column_names(robot)
    names = condition_columns(condition, robot)
    if not set(names) <= set(dimensions):
        return "rows in measuring order"
    units = [SUFFIXES[dimensions[name]][0] if dimensions[name] else "" for name in names]
    spelled = [f"{name}_{unit}" if unit else name for name, unit in zip(names, units, strict=True)]
    return f"columns {spelled[0]} … {spelled[-1]}" if len(spelled) > 1 else f"a column {spelled[0]}"
