"""The set-up: robot file and table as a model reads them, and how well they explain what was measured.

A mistake of the user is a change of the set-up: of the robot's figures, of which of these are free, or of the table. Each is
weighed by the same number, the log-likelihood of the positions with the robot's parameters integrated (Laplace), within what
robots really are off by, whatever a study allows. Errors count as Student's t, whose degrees of freedom are those of the fit's
weights; a robust fit's scale is their size, and what robots do that this model lacks is part of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calflow.effects import catalogue
from calflow.effects.base import Effect
from calflow.effects.geometry import PLACED_SD as STATED_SD
from calflow.effects.geometry import DimensionError, Geometry
from calflow.effects.misstated_payload import PayloadMass
from calflow.estimation.registration import marker_places, marker_shifts, with_markers
from calflow.faults.rough import PLACED_SD, WIDTH, Expectation, Rough, lengths, level, motion, rough
from calflow.files.deferred import Rotation
from calflow.measurements.measurements import Measurements
from calflow.model import Model
from calflow.robot.frames import FrameOrigin, rpy_of, vector
from calflow.robot.mechanism import Row
from calflow.robot.parts import Base, Parameter
from calflow.robot.robot import Robot

CLEARLY = 0.7  # times the size of errors below which they are less for a reason
SUSPECT, SUSPECT_SCALE = 4.0, 1e-3  # standard deviations, and a scale [m], that no robot of its maker's figures has
SINGLE = 0.05  # share of the rows that may be grossly off by themselves; of few poses a robust fit leaves out those that tell
PHYSICS = 4e-5  # m: what causes that this model lacks leave of a good robot at least; a mistake is more
ROWS = 400  # that set-ups are weighed by: more would hardly tell more


@dataclass(frozen=True)
class EveryFigure(Geometry):
    """Every figure of a robot, those too whose errors others make up for: only what is expected of it says what may move."""

    @cached_property
    def errors(self) -> tuple[DimensionError, ...]:
        """The errors of all figures; of those that are no parameters of the geometry nothing is expected."""
        free = {error.parameter.identity: error for error in super().errors}
        return tuple(free.values()) + tuple(
            error for error in _every_step(self.robot) if error.parameter.identity not in free
        )


def _every_step(robot: Robot) -> list[DimensionError]:
    return [
        DimensionError(
            Parameter(Geometry.id, f"joint{i + 1}", step.symbol, step.unit, 0.0, -np.inf, np.inf, figure=step.value,
                      joint=i + 1),
            "steps", robot.step_index(i, step.symbol),
        )
        for i, frame in enumerate(robot.frames)
        for step in frame.steps
    ]  # fmt: skip


@dataclass(frozen=True)
class Setup:
    """Some rows as a model reads them: packed conditions (n_conditions, n_rows) and positions (n_rows, 3) [m].

    numbers (n_rows,) are the rows' among all, from 0, poses how many poses they are of, and independent how many rows have errors
    of their own: a robot's error in a pose has six degrees of freedom, as much as two markers show. turn (3, 3) and origin (3,)
    are where the base is stated, None where nobody says; stated are the parameters (indices) of base and markers whose place is.
    The positions are magnification times those of the table, every row's or each one's.
    """

    model: Model
    expected: Expectation
    stated: tuple[int, ...]
    conditions: np.ndarray
    position: np.ndarray
    numbers: np.ndarray
    poses: int
    independent: int
    turn: np.ndarray | None
    origin: np.ndarray | None
    magnification: float | np.ndarray = 1.0

    @staticmethod
    def of(data: Measurements, *beside: Effect) -> Setup:
        """Return the set-up as robot file and table state it, with some training rows; effects beside are of their usual size."""
        base = data.robot.base
        turn = FrameOrigin(rpy=vector(-np.array(base.rotation))).rotation.T if base.known else None
        origin = np.array(base.origin) if base.known else None
        model = _model(with_markers(data.robot, data.only(data.train)), data.given, beside)
        expected, stated = _expected(model, base.known)
        return Setup(model, expected, stated, *_training_rows(data), turn, origin)

    def on(self, data: Measurements) -> Setup:
        """Return the same with some training rows of other data of the robot."""
        conditions, position, numbers, poses, independent = _training_rows(data)
        return replace(
            self, conditions=conditions, position=position, numbers=numbers, poses=poses, independent=independent
        )

    def at(self, data: Measurements, rows: np.ndarray) -> Setup:
        """Return the same with some rows of data (n_rows,), from 0, to see what it says of them."""
        independent = round(self.independent * len(rows) / len(self.numbers))
        return replace(
            self,
            conditions=data.conditions[:, rows],
            position=data.position[rows],
            numbers=rows,
            independent=independent,
        )

    def differs_from(self, other: Setup) -> np.ndarray:
        """Return which rows (n_rows,) have other readings or loads than in another set-up with the same rows."""
        first_marker = Row.spans(self.model.robot)["marker"].start
        return np.asarray((self.conditions[:first_marker] != other.conditions[:first_marker]).any(axis=0))

    def with_reading(self, joint: int, reading: np.ndarray) -> Setup:
        """Return it with other readings (n_rows,) of a joint (from 0)."""
        conditions = self.conditions.copy()
        conditions[joint] = reading
        return replace(self, conditions=conditions)

    def with_figures(self, changes: dict[int, float]) -> Setup:
        """Return it with other figures, by their parameter, added to what is stated."""
        mean = self.expected.mean.copy()
        for k, change in changes.items():
            mean[k] += change
        return replace(self, expected=Expectation(mean, self.expected.sd))

    def freed(self, *figures: int) -> Setup:
        """Return it with figures, by their parameter, that may be anything."""
        sd = self.expected.sd.copy()
        sd[list(figures)] = PLACED_SD
        return replace(
            self, expected=Expectation(self.expected.mean, sd), stated=tuple(set(self.stated) - set(figures))
        )

    def by(self, robot: Robot) -> Setup:
        """Return it with another robot of the same joints, loads and markers."""
        model = _model(robot, self.model.given)
        expected, stated = _expected(model, self.turn is not None)
        return replace(self, model=model, expected=expected, stated=stated)

    @property
    def restated(self) -> Setup:
        """The same with its figures of the links stated by the robot file: springs act, and figures are free, by what it states.

        Links that may be anything are stated where the rigid robot has them.
        """
        links = {k: p for k, p in enumerate(self.model.parameters) if p.effect == Geometry.id and p.joint}
        anything = {k for k in links if self.expected.sd[k] == PLACED_SD}
        errors = self.rigid.explained.fit.estimate if anything else self.expected.mean
        figures = {(p.joint, p.symbol): p.figure + errors[k] for k, p in links.items() if errors[k]}
        if not figures:
            return self
        again = self.by(_with_figures(self.model.robot, figures))
        same = {p.identity: k for k, p in enumerate(again.model.parameters)}
        return again.freed(*(same[links[k].identity] for k in anything))

    @property
    def registered(self) -> Setup:
        """The same with markers whose place nobody knows where the links, as stated, put them."""
        robot, numbers = self.model.robot, {p.identity: k for k, p in enumerate(self.model.parameters)}
        places = marker_places(robot)
        leading = {
            place: [numbers[Geometry.id, "", name, axis] for axis in "xyz"]
            for place, (name, marker) in zip(places, robot.markers.items(), strict=True)
            if place >= 0 and not marker.relative_sd
        }
        if not leading:
            return self
        nominal, first = self.points(), robot.n_joints + len(robot.payloads)
        shifted = (self.with_figures({columns[k]: 1.0 for columns in leading.values()}) for k in range(3))
        turned = np.stack([setup.points() - nominal for setup in shifted], axis=-1)
        which = self.conditions[first : first + len(robot.markers)].argmax(axis=0)
        stands = None if self.turn is None else Rotation.from_matrix(self.turn)
        shifts = marker_shifts(places, which, self.position, nominal, turned, stands, self.origin)
        return self.with_figures(
            {k: shifts[place, axis] for place, columns in leading.items() for axis, k in enumerate(columns)}
        )

    @cached_property
    def rigid(self) -> Setup:
        """The same robot with nothing to be fitted but where base and tool are, and what was freed."""
        placed = self.expected.sd >= STATED_SD
        return replace(self, expected=Expectation(self.expected.mean, np.where(placed, self.expected.sd, 0.0)))

    @property
    def without_springs(self) -> Setup:
        """The same robot with joints that do not give way."""
        geometric = np.array([p.effect == Geometry.id for p in self.model.parameters])
        return replace(self, expected=Expectation(self.expected.mean, np.where(geometric, self.expected.sd, 0.0)))

    def points(self) -> np.ndarray:
        """Return where the markers are [m] in the base's frame, shape (n_rows, 3); nan where a loop cannot be closed."""
        return self.model.position(self.expected.mean, self.conditions)

    @cached_property
    def explained(self) -> ExplainedSetup:
        """The robot fitted, its base first."""
        turn, shift, _ = motion(self.points(), self.position)
        expected, start = self._expected(turn, shift), self.expected.mean
        return ExplainedSetup(self, rough(self.model, self.conditions, self.position, turn, shift, expected, start))

    @property
    def base(self) -> list[int]:
        """The parameters of the base: x, y, z and angles."""
        return [k for k, p in enumerate(self.model.parameters) if p.effect == Geometry.id and p.part == "base"]

    def _expected(self, turn: np.ndarray, shift: np.ndarray) -> Expectation:
        """Return what is expected of a robot that is near where turn (3, 3) and shift (3,) say."""
        mean = self.expected.mean.copy()
        if self.turn is not None and self.origin is not None:
            away = rpy_of(self.turn.T @ turn)  # of the inverse: a base's angles turn about x, y and z that turn along
            mean[self.base] = np.r_[turn.T @ (self.origin - shift), -np.array(away)]
        return Expectation(mean, self.expected.sd)


def _model(robot: Robot, given: tuple[str, ...], beside: tuple[Effect, ...] = ()) -> Model:
    """Return the model of a robot whose base may be anywhere, with springs, loads and the effects beside."""
    robot = replace(robot, base=Base(known=False), expected=())
    springs = [kind(robot) for kind in catalogue().values() if kind.springs(robot)]
    loads = [PayloadMass(robot)] if robot.has_masses and any(load.mass for load in robot.payloads.values()) else []
    effects = (EveryFigure(robot), *loads, *springs, *(replace(effect, robot=robot) for effect in beside))
    return Model(robot, effects, given)


def _expected(model: Model, known: bool) -> tuple[Expectation, tuple[int, ...]]:
    """Return what is expected of a model, and which parameters are of places that somebody states, as its base is known."""
    figures, markers = [k for k, p in enumerate(model.parameters) if p.effect == Geometry.id], model.robot.markers
    placed = [k for k in figures if model.parameters[k].part in ("base", *markers)]
    parts = {"base", *(name for name, marker in markers.items() if marker.known)} if known else {}
    stated = [k for k in placed if model.parameters[k].part in parts]
    sd = np.where([p.effect == PayloadMass.id for p in model.parameters], 0.0, model.prior_sd)
    sd[placed], sd[stated] = PLACED_SD, STATED_SD
    return Expectation(model.prior_mean, sd), tuple(stated)


def _with_figures(robot: Robot, figures: Mapping[tuple[int, str], float]) -> Robot:
    """Return a robot with other figures of its links, by joint (from 1) and symbol."""
    joints = list(robot.joints)
    for (joint, symbol), value in figures.items():
        joints[joint - 1] = replace(joints[joint - 1], frame=joints[joint - 1].frame.restated({symbol: float(value)}))
    return replace(robot, joints=tuple(joints))


def _training_rows(data: Measurements) -> tuple[np.ndarray, np.ndarray, np.ndarray, int, int]:
    """Return conditions, positions, numbers, poses and independent rows of some training rows, as a set-up holds them.

    They are chosen at random, since markers or payloads may take turns.
    """
    chosen = np.zeros(len(data), dtype=bool)
    chosen[np.random.default_rng(0).permutation(np.flatnonzero(data.train))[:ROWS]] = True
    few = data.only(chosen)
    markers = few.table.groupby("pose")["marker"].nunique()
    return few.conditions, few.position, np.flatnonzero(chosen), len(markers), int(markers.clip(upper=2).sum())


@dataclass(frozen=True)
class ExplainedSetup:
    """A set-up with the robot that explains the positions best."""

    setup: Setup
    fit: Rough

    @cached_property
    def error(self) -> np.ndarray:
        """How far each position of the table is from where the robot is, shape (n_rows,) [m]."""
        miss = lengths(self.setup.position - self.fit.predicted(self.setup.conditions))
        return miss / self.setup.magnification

    @cached_property
    def likelihood(self) -> float:
        """The logarithm of the table's positions' probability density [1/m] about the fit, by so many rows as are independent."""
        if not np.isfinite(self.fit.estimate).all():
            return -np.inf
        scale, tail = np.hypot(self.fit.scale, PHYSICS) / self.setup.magnification, WIDTH**2
        surprise = 3 * np.log(scale) + (tail + 3) / 2 * np.log1p((np.minimum(self.error, 1e3) / scale) ** 2 / tail)
        share = self.setup.independent / len(self.error)
        return float(-share * surprise.sum())

    @property
    def suspicious(self) -> bool:
        """Whether the robot is farther from what its maker says than robots are, or from more than single rows."""
        deviation = np.abs(self.fit.deviations[self.fit.expected.sd < PLACED_SD]).max(initial=0.0)
        return bool(deviation > SUSPECT or self.fit.scale > SUSPECT_SCALE or self.gross > SINGLE)

    @property
    def gross(self) -> float:
        """The share of the rows that are grossly off."""
        return float((self.error > self.fit.gross).mean())

    @property
    def evidence(self) -> float:
        """The logarithm of the positions' probability density, the robot's parameters integrated."""
        return self.likelihood + self.prior

    def log_odds(self, other: ExplainedSetup) -> float:
        """Return the logarithm of its odds against another.

        That errors are hardly less speaks for nothing: those of the rows that it reads otherwise, or of all.
        """
        gained, there = self.likelihood - other.likelihood, self.setup.differs_from(other.setup)
        rows = there if there.any() else ~there
        if gained > 0 and level(self.error[rows]) > CLEARLY * level(other.error[rows]):
            gained = 0.0
        return gained + self.prior - other.prior

    @cached_property
    def prior(self) -> float:
        """The logarithm of the estimate's prior density times the volume that the data leave, about the same units."""
        fit, sd = self.fit, self.fit.expected.sd
        return float(fit.volume - (fit.deviations[(sd > 0) & (sd < PLACED_SD)] ** 2).sum() / 2)

    @property
    def elsewhere(self) -> np.ndarray:
        """How far base and markers are from where they are stated [m and rad]; of those that nobody states nothing."""
        return np.abs(self.fit.deviations[list(self.setup.stated)]) * STATED_SD

    @property
    def base(self) -> tuple[np.ndarray, np.ndarray]:
        """Where the base is: turn (3, 3) and origin (3,) [m] in the measuring frame."""
        fit = self.fit
        small = {fit.model.parameters[k].symbol: fit.estimate[k] for k in self.setup.base}
        turn = fit.turn @ Rotation.from_euler("XYZ", [small["rx"], small["ry"], small["rz"]]).as_matrix()
        return turn, fit.turn @ np.array([small["x"], small["y"], small["z"]]) + fit.shift

    def figure(self, parameter: Parameter) -> float:
        """Return a figure as the positions ask for it, in SI."""
        there = [p.identity for p in self.fit.model.parameters].index(parameter.identity)
        return float(self.fit.model.parameters[there].figure + self.fit.estimate[there])
