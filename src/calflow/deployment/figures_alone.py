"""Figures alone: a robot's geometric parameters refitted to the measurements without any other effect.

Calibrated figures estimated beside springs and causes are not the best without these: reduced to what a controller or a
format holds, a calibration may be worse than the maker's figures. Refitted alone, they absorb part of the rest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import casadi as ca
import numpy as np

from calflow.effects import Effect
from calflow.estimation.accuracy import distances, errors, judged_unit, mean_rms_max
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.fit import fit_sharing
from calflow.estimation.noise import PerUnit, representative
from calflow.estimation.parameters import FittedParameter, Parameters
from calflow.estimation.probing import stacked
from calflow.files.tables import Results, column, to_frame
from calflow.files.words import mm
from calflow.measurements.measurements import Measurements
from calflow.model import Model
from calflow.observations import leading_units
from calflow.robot.mechanism import OPTIONAL, Deflection, Row, State, nominal_dimensions, nominal_loads
from calflow.robot.parts import Expected

LEVELS, FIGURES = "levels_of_effort.csv", "figures.csv"  # of a stage
Effort = Literal["nothing", "zeros", "zeros and tool", "figures", "commands"]
GIVEN: dict[Effort, str] = {
    "nothing": "the maker's figures",
    "zeros": "joint zeros, base placed",
    "zeros and tool": "joint zeros and tool, base placed",
    "figures": "controller figures",
    "commands": "corrected commands",
}
MEANT: dict[Effort, str] = GIVEN | {
    "figures": f"{GIVEN['figures']}: all lengths and angles",
    "commands": f"{GIVEN['commands']} (every target changed)",
}


@dataclass(frozen=True, kw_only=True)
class EffortLevel:
    """A level of effort, what is given to the robot, with its errors at held-out poses, or else at fitted ones."""

    level: Effort = column(
        "nothing; joint zeros (of the maker's lengths and twists), base placed; these with the tool; all figures, as `export` "
        "writes them; corrected commands, of `compensate` or `filter`"
    )
    split: Literal["train", "holdout"] = column("the rows by which it is judged, which have values in `unit`")
    unit: str = column("the unit that the following figures are in: mm, mrad, px, …")
    mean: float = column("mean error, in `unit`")
    rms: float = column("root mean square error, in `unit`")
    max: float = column("largest error, in `unit`")
    promised: float = column(
        "root mean square error that the calibrated model predicts for these rows, device noise included, in `unit`"
    )

    def __str__(self) -> str:
        return (
            f"{mm(self.mean)} {self.unit} on average (largest {mm(self.max)} {self.unit}; RMS {mm(self.rms)}, "
            f"expected {mm(self.promised)})"
        )


@dataclass(frozen=True, kw_only=True)
class AloneParameter(FittedParameter):
    """A parameter of figures that were fitted alone."""

    level: Effort = column("what is given to the robot: zeros, zeros and tool, or figures")


@dataclass(frozen=True)
class FiguresAlone:
    """A robot's figures fitted alone: the model without other effects, and its parameters."""

    model: Model
    parameters: tuple[FittedParameter, ...]

    @cached_property
    def estimate(self) -> np.ndarray:
        """The estimates, shape (n_parameters,)."""
        return np.array([parameter.estimate for parameter in self.parameters if not parameter.fixed])


@dataclass(frozen=True)
class Levels:
    """The levels of effort, from nothing over joint zeros, zeros and tool, and all figures to corrected commands.

    alone: by level figures, zeros and tool, or zeros, fitted alone, together with base and the measuring device's
    effects, which do not count as the robot's error. left_out: effects that figures cannot hold. every: the levels.
    """

    alone: Mapping[Effort, FiguresAlone]
    left_out: tuple[Effect, ...]
    every: tuple[EffortLevel, ...]

    @staticmethod
    def of(calibrated: CalibratedModel, data: Measurements, known: Levels | None = None) -> Levels:
        """Fit figures and zeros alone to the training rows, and judge all levels on the same rows.

        known: an earlier result for the same rows with the same noise, whose fits are reused.
        """
        whole, before = calibrated.model, known.alone if known else {}
        alone = {
            level: before[level] if before and before[level].model == model else _fitted(model, calibrated, data)
            for level, model in _models(whole).items()
        }
        figures = alone["figures"]
        judged: dict[Effort, tuple[Model, np.ndarray]] = {
            "nothing": (figures.model, _with_device(figures.model, figures.estimate)),
            **{level: (fitted.model, fitted.estimate) for level, fitted in alone.items()},
            "commands": (whole, calibrated.estimate),
        }
        return Levels(alone, beyond_figures(whole), _judged(judged, calibrated, data))

    @staticmethod
    def read(model: Model, results: Results) -> Levels:
        """Return the levels stored for the best model, bit by bit."""
        stage = "diagnose" if "diagnose/effects.csv" in results else "identify"
        rows = results.rows(f"{stage}/{FIGURES}", AloneParameter)
        alone = {
            level: FiguresAlone(bare, tuple(row for row in rows if row.level == level))
            for level, bare in _models(model).items()
        }
        return Levels(alone, beyond_figures(model), tuple(results.rows(f"{stage}/{LEVELS}", EffortLevel)))

    @property
    def figures(self) -> FiguresAlone:
        """All lengths and angles, fitted alone."""
        return self.alone["figures"]

    def kept(self, stage: str) -> Results:
        """Return the tables that a run folder stores for a stage."""
        rows = [
            AloneParameter(**{**vars(parameter), "level": level})
            for level, fitted in self.alone.items()
            for parameter in fitted.parameters
        ]
        return Results(
            {
                f"{stage}/{LEVELS}": to_frame(self.every, EffortLevel),
                f"{stage}/{FIGURES}": to_frame(rows, AloneParameter),
            }
        )

    def by(self, level: Effort) -> EffortLevel:
        """Return the errors of a level."""
        return next(row for row in self.every if row.level == level)

    @property
    def held_out(self) -> bool:
        """Whether they are judged on poses held out of the fit."""
        return self.every[0].split == "holdout"

    @property
    def words(self) -> tuple[str, ...]:
        """The errors of each level in words, a line each."""
        where = "at held-out poses" if self.held_out else "at the poses that were fitted"
        return tuple(f"given {MEANT[row.level]}, the robot misses {where} by {row}" for row in self.every)

    @property
    def harm(self) -> str:
        """A statement that fitted figures are worse than the maker's; empty where they are not."""
        figures, nothing = self.by("figures"), self.by("nothing")
        if figures.mean <= nothing.mean:
            return ""
        return (
            f"controller figures, fitted as well as they can be, miss by {figures}, the maker's by {nothing}: leave the "
            "maker's where they are, and correct commands (calflow compensate, calflow filter)"
        )


def _models(whole: Model) -> dict[Effort, Model]:
    """Return the models without other effects, by the figures given to the robot."""
    beyond = beyond_figures(whole)
    alone = replace(whole, effects=tuple(effect for effect in whole.effects if effect not in beyond))
    return {
        "zeros": _with_zeros(alone, and_tool=False),
        "zeros and tool": _with_zeros(alone, and_tool=True),
        "figures": alone,
    }


def _judged(
    models: Mapping[Effort, tuple[Model, np.ndarray]], calibrated: CalibratedModel, data: Measurements
) -> tuple[EffortLevel, ...]:
    """Return the levels judged on held-out rows, or else on fitted ones, from models with their parameters.

    Held-out rows of which the fit cannot tell whether they are before a step are left out, as where the model is judged. A level's
    predicted error combines its distance from the calibrated model with that model's own uncertainty.
    """
    told = data.held_out & ~calibrated.model.undecided(data)
    held = bool(told.any())
    rows = data.only(told if held else data.train)
    unit = judged_unit(leading_units(rows))
    variance = calibrated.promised_variance(rows, unit).sum(axis=1)
    off = {level: errors(model, estimate, rows) for level, (model, estimate) in models.items()}
    levels = []
    for level, error in off.items():
        size = unit.shown(distances(error))
        promise = unit.shown(np.sqrt(distances(error - off["commands"]) ** 2 + variance))
        there = np.isfinite(size)
        (mean, rms, most), (_, promised, _) = mean_rms_max(size[there]), mean_rms_max(promise[there])
        split: Literal["train", "holdout"] = "holdout" if held else "train"
        levels.append(
            EffortLevel(level=level, split=split, unit=unit.label, mean=mean, rms=rms, max=most, promised=promised)
        )
    return tuple(levels)


def beyond_figures(model: Model) -> tuple[Effect, ...]:
    """Return the effects of the robot, not of the measuring device, beyond its lengths and angles."""
    return tuple(effect for effect in model.effects if not effect.of_measuring() and not is_of_figures(effect))


def is_of_figures(effect: Effect) -> bool:
    """Whether an effect changes only lengths and angles of the robot, equally in every row."""
    robot, p = effect.robot, ca.SX.sym("p", len(effect.declared))
    conditions = ca.SX.sym("c", sum(Row.sizes(robot, OPTIONAL).values()))
    row, state = Row.unpack(robot, conditions, OPTIONAL), State.symbols(robot)
    dims = stacked(effect.dimensions(p, nominal_dimensions(robot), row))
    moves = effect.deflection(p, state, row, Deflection.zero(robot.n_joints))
    torque = ca.sparsify(ca.SX(effect.torque(p, state, row)))
    loads = stacked(effect.loads(p, nominal_loads(robot), row))
    elsewhere = not moves.is_zero or torque.nnz() > 0 or ca.depends_on(loads, p)
    return bool(ca.depends_on(dims, p) and not ca.depends_on(dims, conditions) and not elsewhere)


def _with_device(model: Model, estimate: np.ndarray) -> np.ndarray:
    """Return the nominal parameters with the estimated effects of the measuring device."""
    values = model.nominal.copy()
    for effect in model.effects:
        if effect.of_measuring():
            values[model.columns(effect)] = estimate[model.columns(effect)]
    return values


def _with_zeros(model: Model, *, and_tool: bool) -> Model:
    """Return the model with the maker's lengths and twists; joint zeros, base and optionally the tool are free."""
    robot = model.robot
    zeros = [robot.step_index(i, joint.moving.symbol) for i, joint in enumerate(robot.joints)]
    others = np.setdiff1d(np.arange(len(robot.steps)), zeros).tolist()
    held: list[Expected] = []
    for effect in (effect for effect in model.effects if not effect.of_measuring()):
        p = ca.SX.sym("p", len(effect.declared))
        dims = effect.dimensions(p, nominal_dimensions(robot), Row.symbols(robot))
        of_tool = [] if and_tool else [ca.vec(dims.markers), dims.markers_turn, dims.tool_rotation]
        slopes = ca.jacobian(ca.vertcat(dims.steps[others], dims.bars, *of_tool), p)
        moves = np.array(ca.DM(slopes.sparsity(), 1)).any(axis=0)
        held += [Expected(name=effect.declared[k].name, fixed=True) for k in np.flatnonzero(moves)]
    names = {expected.name for expected in held}
    kept = (expected for expected in robot.expected if expected.name not in names)
    return replace(model, robot=replace(robot, expected=(*kept, *held)))


def _fitted(model: Model, calibrated: CalibratedModel, data: Measurements) -> FiguresAlone:
    """Fit a model's parameters to the training rows, starting at the whole model's estimate.

    The noise has a discrepancy of its own, since figures alone leave other errors than the whole model does.
    """
    whole, train = calibrated.model, data.only(data.train)
    train = train.only(representative(train))
    start = whole.handed_on(calibrated.estimate, model)
    device = replace(calibrated.noise(train), discrepancy=PerUnit(), intraclass=0.0)
    result = fit_sharing(model, train, device, start[None], calibrated.loss)[0]
    return FiguresAlone(model, Parameters.fitted(result, result.covariance).rows)
