"""Figures alone: a robot's own figures fitted anew to the measurements, for what can hold no other effect.

Calibrated figures beside springs and causes are not the best figures without these: cut down to what a controller or a format
holds, a calibration may miss by more than the maker's figures do. Fitted alone they take over what they can of the rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from calflow.effects import Effect
from calflow.estimation.accuracy import distances, errors, judged_unit
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.fit import Fit, fit_reweighted
from calflow.files.words import mm
from calflow.measurements.measurements import Measurements
from calflow.model import Model
from calflow.observations import leading_units
from calflow.robot.mechanism import (
    OPTIONAL,
    Deflection,
    Dimensions,
    Loads,
    Row,
    State,
    nominal_dimensions,
    nominal_loads,
)
from calflow.robot.parts import Expected


@dataclass(frozen=True)
class Missed:
    """By how much the robot misses with a level of effort: at held-out poses, at fitted ones where none are held out [unit]."""

    mean: float
    largest: float
    unit: str

    @staticmethod
    def of(model: Model, estimate: np.ndarray, data: Measurements) -> Missed:
        """Return it of a model with these parameters."""
        judged = data.only(data.held_out if data.held_out.any() else data.train)
        unit = judged_unit(leading_units(data))
        distance = unit.shown(distances(errors(model, estimate, judged)))
        return Missed(float(np.nanmean(distance)), float(np.nanmax(distance)), unit.label)

    def __str__(self) -> str:
        return f"{mm(self.mean)} {self.unit} on average ({mm(self.largest)} {self.unit} at most)"


@dataclass(frozen=True)
class Levels:
    """What may be given to a robot, and what it then misses by: nothing, joint zeros, all figures, corrected commands.

    figures and zeros are the fits of these alone; base, tool, markers and what the measuring device does are fitted beside
    both, and what the device does is no part of what the robot misses by. left_out is what of the robot no figure holds.
    """

    figures: Fit
    zeros: Fit
    left_out: tuple[Effect, ...]
    by_nothing: Missed
    by_zeros: Missed
    by_figures: Missed
    by_commands: Missed
    held_out: bool

    @staticmethod
    def of(calibrated: CalibratedModel, data: Measurements) -> Levels:
        """Fit figures and zeros alone to the training rows, and judge all levels by the same rows."""
        whole = calibrated.model
        beyond = beyond_figures(whole)
        alone = replace(whole, effects=tuple(effect for effect in whole.effects if effect not in beyond))
        figures = _fitted(alone, calibrated, data)
        zeros = _fitted(_with_zeros_alone(alone), calibrated, data)
        return Levels(
            figures,
            zeros,
            beyond,
            by_nothing=Missed.of(alone, _with_device(alone, figures.estimate), data),
            by_zeros=Missed.of(zeros.model, zeros.estimate, data),
            by_figures=Missed.of(figures.model, figures.estimate, data),
            by_commands=Missed.of(whole, calibrated.estimate, data),
            held_out=bool(data.held_out.any()),
        )

    @property
    def table(self) -> dict[str, Missed]:
        """What is given to the robot, and what it then misses by."""
        return {
            "nothing: the maker's figures": self.by_nothing,
            "joint zeros, base and tool alone": self.by_zeros,
            "all figures": self.by_figures,
            "corrected commands": self.by_commands,
        }

    @property
    def words(self) -> str:
        """Say what each level is worth."""
        where = "at held-out poses" if self.held_out else "at the poses that were fitted"
        return f"the robot misses {where}, by what is given to it: " + "; ".join(
            f"{what}, {missed}" for what, missed in self.table.items()
        )

    @property
    def harm(self) -> str:
        """Say that figures are worse than the maker's; empty where they are not."""
        if self.by_figures.mean <= self.by_nothing.mean:
            return ""
        return (
            f"the robot's figures alone, fitted as well as they can be, miss by {self.by_figures}, the maker's by "
            f"{self.by_nothing}: leave the maker's where they are, and correct commands (calflow compensate, calflow filter)"
        )


def beyond_figures(model: Model) -> tuple[Effect, ...]:
    """Return the effects of the robot, not of the measuring device, that are more than its lengths and angles."""
    return tuple(effect for effect in model.effects if not effect.of_device() and not is_of_figures(effect))


def is_of_figures(effect: Effect) -> bool:
    """Whether an effect only changes lengths and angles of the robot, alike in every row."""
    robot, p = effect.robot, ca.SX.sym("p", len(effect.declared))
    conditions = ca.SX.sym("c", sum(Row.sizes(robot, OPTIONAL).values()))
    row, state = Row.unpack(robot, conditions, OPTIONAL), State.symbols(robot)
    dims = _packed(effect.dimensions(p, nominal_dimensions(robot), row))
    moves = effect.deflection(p, state, row, Deflection.zero(robot.n_joints))
    torque = ca.sparsify(ca.SX(effect.torque(p, state, row)))
    loads = _packed(effect.loads(p, nominal_loads(robot), row))
    elsewhere = not moves.is_zero or torque.nnz() > 0 or ca.depends_on(loads, p)
    return bool(ca.depends_on(dims, p) and not ca.depends_on(dims, conditions) and not elsewhere)


def _packed(parts: Dimensions | Loads) -> ca.SX:
    return ca.vertcat(*(ca.vec(ca.SX(part)) for part in vars(parts).values()))


def _with_device(model: Model, estimate: np.ndarray) -> np.ndarray:
    """The nominal parameters, with what the measuring device does as it was estimated."""
    values = model.nominal.copy()
    for effect in model.effects:
        if effect.of_device():
            values[model.columns(effect)] = estimate[model.columns(effect)]
    return values


def _with_zeros_alone(model: Model) -> Model:
    """The model with the maker's lengths and twists: what moves a bar of a loop, or a step that is no joint's zero, is held."""
    robot = model.robot
    zeros = [robot.step_index(i, joint.moving.symbol) for i, joint in enumerate(robot.joints)]
    others = np.setdiff1d(np.arange(len(robot.steps)), zeros).tolist()
    held: list[Expected] = []
    for effect in model.effects:
        p = ca.SX.sym("p", len(effect.declared))
        dims = effect.dimensions(p, nominal_dimensions(robot), Row.symbols(robot))
        slopes = ca.jacobian(ca.vertcat(dims.steps[others], dims.bars), p)
        moves = np.array(ca.DM(slopes.sparsity(), 1)).any(axis=0)
        held += [Expected(name=effect.declared[k].name, fixed=True) for k in np.flatnonzero(moves)]
    names = {one.name for one in held}
    kept = (one for one in robot.expected if one.name not in names)
    return replace(model, robot=replace(robot, expected=(*kept, *held)))


def _fitted(model: Model, calibrated: CalibratedModel, data: Measurements) -> Fit:
    """The fit of a model's parameters to the training rows, from where the whole model has them."""
    whole, train = calibrated.model, data.only(data.train)
    known = dict(zip((one.name for one in whole.parameters), calibrated.estimate, strict=True))
    start = np.array([known.get(one.name, one.nominal) for one in model.parameters])
    found, *_ = fit_reweighted(model, train, calibrated.noise(train), start[None], calibrated.loss)
    return found
