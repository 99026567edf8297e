"""The set-up: robot file and table as input of a model, and its evidence given the measured positions.

A mistake of the user is a change of the set-up: of the robot's dimensions, of the free ones, or of the table. The
evidence is the log marginal likelihood of the positions by Laplace's approximation, with priors of real robots' errors
whatever a study allows. Errors have Student's t distribution of the robust fit's scale, including unmodelled physics,
with the degrees of freedom of the fit's weights.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calflow.effects import catalogue
from calflow.effects.base import Effect
from calflow.effects.geometry import DimensionError, Geometry
from calflow.effects.misstated_payload import PayloadMass
from calflow.estimation.registration import marker_places, marker_shifts, with_markers
from calflow.faults.rough import FAR_BETTER, GROSS, PLACED_SD, WIDTH, lengths, level, motion, robust_fit
from calflow.files.deferred import Rotation
from calflow.measurements.measurements import Measurements
from calflow.model import Model
from calflow.robot.frames import FrameOrigin, rpy_of, vector
from calflow.robot.mechanism import Row
from calflow.robot.parts import PLACED_SD as STATED_SD
from calflow.robot.parts import Base, Parameter
from calflow.robot.robot import Robot

CLEARLY = 0.7  # ratio of errors below which they are clearly smaller
SUSPECT, SUSPECT_SCALE = 4.0, 1e-3  # deviation [sd] and scale [m] beyond those of any robot as stated by its maker
SINGLE = 0.05  # share of rows that may be single outliers; with few poses a robust fit rejects informative ones
PHYSICS = 4e-5  # m: least error of a good robot by unmodelled causes; a mistake exceeds it
ROWS = 400  # largest number of rows for comparing set-ups


@dataclass(frozen=True)
class AllDimensions(Geometry):
    """All dimensions of a robot, also those that are not identifiable; the prior decides which are free."""

    @cached_property
    def errors(self) -> tuple[DimensionError, ...]:
        """The errors of all dimensions; those that are no parameters of the geometry have no prior uncertainty."""
        free = {error.parameter.identity for error in super().errors}
        steps = [(i, step) for i, frame in enumerate(self.robot.frames) for step in frame.steps]
        every = (
            DimensionError(
                Parameter(self.id, f"joint{i + 1}", step.symbol, step.unit, 0.0, -np.inf, np.inf, figure=step.value,
                          joint=i + 1),
                "steps", self.robot.step_index(i, step.symbol),
            )
            for i, step in steps
        )  # fmt: skip
        return (*super().errors, *(error for error in every if error.parameter.identity not in free))


@dataclass(frozen=True)
class Setup:
    """A model with a prior, and some rows: packed conditions (n_conditions, n_rows) and positions (n_rows, 3) [m].

    links: the model without what gives way, which needs no loads, most of the work; kept (n,): its parameters among the model's;
    mean, sd (n_parameters,): the prior, in SI, with sd 0 for fixed parameters;
    turn (3, 3), origin (3,): the stated base pose, None if unknown; stated: indices of the parameters of stated base and
    marker positions. numbers (n_rows,): indices of the rows; seen (n_poses,): number of markers at each of their poses;
    magnification: of the positions against the table's, of all rows or each.
    """

    model: Model
    links: Model
    kept: np.ndarray
    mean: np.ndarray
    sd: np.ndarray
    stated: tuple[int, ...]
    turn: np.ndarray | None
    origin: np.ndarray | None
    conditions: np.ndarray
    position: np.ndarray
    numbers: np.ndarray
    seen: np.ndarray
    magnification: float | np.ndarray = 1.0

    @staticmethod
    def of(data: Measurements) -> Setup:
        """Return the set-up as stated by robot file and table, with some training rows."""
        base = data.robot.base
        turn = FrameOrigin(rpy=vector(-np.array(base.rotation))).rotation.T if base.known else None
        origin = np.array(base.origin) if base.known else None
        robot = replace(with_markers(data.robot, data.only(data.train)), base=Base(known=False), expected=())
        model = _model(robot, data.given)
        links, kept = _links(model)
        stated = {"base", *(name for name, marker in robot.markers.items() if marker.known)} if base.known else set()
        return Setup(model, links, kept, *_prior(model, stated), turn, origin, *_at(data, _training_rows(data)))

    def beside(self, effect: Effect) -> Setup:
        """Return the set-up with a further effect."""
        effects = (*self.model.effects, replace(effect, robot=self.model.robot))
        return self._with_model(replace(self.model, effects=effects))

    def on(self, data: Measurements) -> Setup:
        """Return the set-up with some training rows of other data of the robot."""
        return self.at(data, _training_rows(data))

    def at(self, data: Measurements, rows: np.ndarray) -> Setup:
        """Return the set-up with given rows (n_rows,) of data."""
        conditions, position, numbers, seen = _at(data, rows)
        return replace(self, conditions=conditions, position=position, numbers=numbers, seen=seen)

    def differs_from(self, other: Setup) -> np.ndarray:
        """Return which rows (n_rows,) differ in readings or payload from another set-up with the same rows."""
        first_marker = Row.spans(self.model.robot)["marker"].start
        return np.asarray((self.conditions[:first_marker] != other.conditions[:first_marker]).any(axis=0))

    def with_reading(self, joint: int, reading: np.ndarray) -> Setup:
        """Return the set-up with other readings (n_rows,) of a joint (from 0)."""
        conditions = self.conditions.copy()
        conditions[joint] = reading
        return replace(self, conditions=conditions)

    def with_dimensions(self, changes: dict[int, float]) -> Setup:
        """Return the set-up with changes added to dimensions, by parameter index."""
        mean = self.mean.copy()
        mean[list(changes)] += list(changes.values())
        return replace(self, mean=mean)

    def freed(self, *figures: int) -> Setup:
        """Return the set-up with practically no prior on some dimensions (parameter indices)."""
        sd = self.sd.copy()
        sd[list(figures)] = PLACED_SD
        return replace(self, sd=sd, stated=tuple(set(self.stated) - set(figures)))

    def with_robot(self, robot: Robot) -> Setup:
        """Return the set-up with another robot of the same joints, payloads and markers, and an unknown base."""
        return self._with_model(_model(robot, self.model.given))

    def _with_model(self, model: Model) -> Setup:
        parts = {self.model.parameters[k].part for k in self.stated}
        (links, kept), (mean, sd, stated) = _links(model), _prior(model, parts)
        links = self.links if links == self.links else links  # whose graph is made already
        return replace(self, model=model, links=links, kept=kept, mean=mean, sd=sd, stated=stated)

    @property
    def with_stated_markers(self) -> Setup:
        """The set-up with the prior of a stated place on known markers, also beside an unknown base."""
        places = zip(self.model.robot.markers, marker_places(self.model.robot), strict=True)
        base = {self.model.parameters[k].part for k in self.stated}
        _, sd, stated = _prior(self.model, {*base, *(name for name, place in places if place < 0)})
        return replace(self, sd=sd, stated=stated)

    @property
    def restated(self) -> Setup:
        """The set-up with its link dimensions written into the robot file, on which springs and priors depend.

        Link dimensions without prior get the values of the rigid fit.
        """
        links = {k: p for k, p in enumerate(self.model.parameters) if p.effect == Geometry.id and p.joint}
        anything = {k for k in links if self.sd[k] == PLACED_SD}
        errors = self.rigid.fitted.estimate if anything else self.mean
        figures = {(p.joint, p.symbol): p.figure + errors[k] for k, p in links.items() if errors[k]}
        if not figures:
            return self
        again = self.with_robot(_with_dimensions(self.model.robot, figures))
        same = {p.identity: k for k, p in enumerate(again.model.parameters)}
        return again.freed(*(same[links[k].identity] for k in anything))

    @property
    def registered(self) -> Setup:
        """The set-up with markers of unknown position placed by the nominal links."""
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
        shifted = (self.with_dimensions({columns[k]: 1.0 for columns in leading.values()}) for k in range(3))
        turned = np.stack([setup.points() - nominal for setup in shifted], axis=-1)
        which = self.conditions[first : first + len(robot.markers)].argmax(axis=0)
        stands = None if self.turn is None else Rotation.from_matrix(self.turn)
        shifts = marker_shifts(places, which, self.position, nominal, turned, stands, self.origin)
        return self.with_dimensions(
            {k: shifts[place, axis] for place, columns in leading.items() for axis, k in enumerate(columns)}
        )

    @cached_property
    def rigid(self) -> Setup:
        """The set-up of the links alone in which only base, tool and freed dimensions are fitted."""
        sd, every = self.sd[self.kept], np.arange(len(self.kept))
        return replace(
            self, model=self.links, kept=every, mean=self.mean[self.kept], sd=np.where(sd >= STATED_SD, sd, 0.0)
        )

    @property
    def without_springs(self) -> Setup:
        """The set-up with rigid joints."""
        geometric = np.array([p.effect == Geometry.id for p in self.model.parameters])
        return replace(self, sd=np.where(geometric, self.sd, 0.0))

    def points(self) -> np.ndarray:
        """Return the markers' nominal positions (n_rows, 3) [m] in the base frame; nan if a loop cannot be closed."""
        return self.links.position(self.mean[self.kept], self.conditions)

    @cached_property
    def fitted(self) -> FittedSetup:
        """The robust fit, which starts from that of the base."""
        turn, shift, _ = motion(self.points(), self.position)
        mean = self._mean_near(turn, shift)
        fit = robust_fit(self.model, self.conditions, self.position, turn, shift, mean, self.sd, self.mean)
        return FittedSetup(self, turn, shift, mean, *fit)

    @property
    def base(self) -> list[int]:
        """The parameter indices of the base: x, y, z and angles."""
        return [k for k, p in enumerate(self.model.parameters) if p.effect == Geometry.id and p.part == "base"]

    def _mean_near(self, turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
        """Return the prior's mean relative to an approximate base pose, turn (3, 3) and shift (3,)."""
        mean = self.mean.copy()
        if self.turn is not None and self.origin is not None:
            away = rpy_of(self.turn.T @ turn)  # of the inverse: the base's angles are about moving axes
            mean[self.base] = np.r_[turn.T @ (self.origin - shift), -np.array(away)]
        return mean


def _model(robot: Robot, given: tuple[str, ...]) -> Model:
    """Return the model of a robot with springs and payloads."""
    springs = [kind(robot) for kind in catalogue().values() if kind.springs(robot)]
    loads = [PayloadMass(robot)] if robot.has_masses and any(load.mass for load in robot.payloads.values()) else []
    return Model(robot, (AllDimensions(robot), *loads, *springs), given)


def _links(model: Model) -> tuple[Model, np.ndarray]:
    """Return a model without the effects that give way, which move nothing at their means, and its parameters in the model."""
    links = replace(model, effects=tuple(effect for effect in model.effects if not effect.gives_way))
    return links, np.concatenate([model.columns(effect) for effect in links.effects])


def _prior(model: Model, parts: Collection[str]) -> tuple[np.ndarray, np.ndarray, tuple[int, ...]]:
    """Return the prior mean and sd of a model, and the parameters of the parts (base and markers) that are where it is stated."""
    figures = [k for k, p in enumerate(model.parameters) if p.effect == Geometry.id]
    placed = [k for k in figures if model.parameters[k].part in ("base", *model.robot.markers)]
    stated = [k for k in placed if model.parameters[k].part in parts]
    sd = np.where([p.effect == PayloadMass.id for p in model.parameters], 0.0, model.prior_sd)
    sd[placed], sd[stated] = PLACED_SD, STATED_SD
    return model.prior_mean, sd, tuple(stated)


def _with_dimensions(robot: Robot, figures: Mapping[tuple[int, str], float]) -> Robot:
    """Return a robot with other link dimensions, by joint (from 1) and symbol."""
    joints = list(robot.joints)
    for (joint, symbol), value in figures.items():
        joints[joint - 1] = replace(joints[joint - 1], frame=joints[joint - 1].frame.restated({symbol: float(value)}))
    return replace(robot, joints=tuple(joints))


def _training_rows(data: Measurements) -> np.ndarray:
    """Return some training rows (n_rows,), chosen at random, since markers or payloads may alternate."""
    return np.sort(np.random.default_rng(0).permutation(np.flatnonzero(data.train))[:ROWS])


def _at(data: Measurements, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the conditions, positions and numbers of given rows, and how many markers are seen at each of their poses."""
    seen = data.table.iloc[rows].groupby("pose")["marker"].nunique().to_numpy()
    return data.conditions[:, rows], data.position[rows], rows, seen


@dataclass(frozen=True)
class FittedSetup:
    """A set-up with its robust fit (see `robust_fit`).

    turn (3, 3), shift (3,): from the robot's base to the measuring frame; mean (n_parameters,): the prior's, relative to these.
    """

    setup: Setup
    turn: np.ndarray
    shift: np.ndarray
    mean: np.ndarray
    estimate: np.ndarray
    covariance: np.ndarray
    volume: float
    scale: float

    @property
    def model(self) -> Model:
        """The fitted model."""
        return self.setup.model

    @property
    def gross(self) -> float:
        """The threshold of gross errors [m]."""
        return GROSS * self.scale

    @property
    def deviations(self) -> np.ndarray:
        """The deviation of each parameter from its prior mean, in standard deviations, shape (n_parameters,)."""
        sd = self.setup.sd
        return np.divide(self.estimate - self.mean, sd, out=np.zeros(len(sd)), where=sd > 0)

    def predicted(self, conditions: np.ndarray) -> np.ndarray:
        """Return positions (n_rows, 3) [m] for packed conditions; nan if a loop cannot be closed."""
        return self.model.position(self.estimate, conditions) @ self.turn.T + self.shift

    def moved(self, conditions: np.ndarray, joint: int, by: float) -> np.ndarray:
        """Return the displacement (n_rows, 3) [m] of positions by a step of a joint (from 0) [rad or m]."""
        stepped = conditions.copy()
        stepped[joint] += by
        return self.predicted(stepped) - self.predicted(conditions)

    def miss(self, data: Measurements) -> np.ndarray:
        """Return each row's position error [m], shape (n_rows,); gross ones scaled by the uncertainty of prediction."""
        miss = lengths(data.position - self.predicted(data.conditions))
        far = np.isfinite(miss) & (miss > self.gross)
        if far.any():
            jacobian = self.model.position_jacobian(self.estimate, data.conditions[:, far])
            variance = ((jacobian @ self.covariance) * jacobian).sum(axis=2).max(axis=1)
            miss[far] /= np.sqrt(1 + variance / self.scale**2)
        return miss

    def better(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Return whether gross errors (…) [m] fall to the level of other rows."""
        return (before > self.gross) & (after < np.minimum(self.gross, before / FAR_BETTER))

    def errors_at(self, setup: Setup) -> np.ndarray:
        """Return the position errors of another set-up's rows, shape (n_rows,) [m]."""
        return lengths(setup.position - self.predicted(setup.conditions))

    @cached_property
    def error(self) -> np.ndarray:
        """The position errors in units of the table, shape (n_rows,) [m]."""
        return self.errors_at(self.setup) / self.setup.magnification

    @cached_property
    def likelihood(self) -> float:
        """The log likelihood of the table's positions at the fit, scaled to the number of independent rows."""
        if not np.isfinite(self.estimate).all():
            return -np.inf
        surprise = self.surprise(self.error, self.setup.magnification)
        # A pose error has six degrees of freedom, those of two markers.
        share = self.setup.seen.clip(max=2).sum() / len(self.error)
        return float(-share * surprise.sum())

    def surprise(self, error: np.ndarray, magnification: float | np.ndarray = 1.0) -> np.ndarray:
        """Return minus the log density, but for a constant, of position errors (…) [m] in units of the table."""
        scale, tail = np.hypot(self.scale, PHYSICS) / magnification, WIDTH**2
        return np.asarray(3 * np.log(scale) + (tail + 3) / 2 * np.log1p((np.minimum(error, 1e3) / scale) ** 2 / tail))

    @property
    def suspicious(self) -> bool:
        """Whether parameters, scale or share of outliers exceed those of any robot as stated."""
        deviation = np.abs(self.deviations[self.setup.sd < PLACED_SD]).max(initial=0.0)
        return bool(deviation > SUSPECT or self.scale > SUSPECT_SCALE or self.gross_share > SINGLE)

    @property
    def gross_share(self) -> float:
        """The share of rows with gross errors."""
        return float((self.error > self.gross).mean())

    @property
    def evidence(self) -> float:
        """The log marginal likelihood of the positions."""
        return self.likelihood + self.log_prior

    def log_odds(self, other: FittedSetup) -> float:
        """Return the log odds against another set-up.

        A higher likelihood does not count unless the errors, of the rows that differ if any, are clearly smaller.
        """
        gained, there = self.likelihood - other.likelihood, self.setup.differs_from(other.setup)
        rows = there if there.any() else ~there
        if gained > 0 and level(self.error[rows]) > CLEARLY * level(other.error[rows]):
            gained = 0.0
        return gained + self.log_prior - other.log_prior

    @cached_property
    def log_prior(self) -> float:
        """The log of the prior density at the estimate times the posterior volume (Occam factor)."""
        uncertain = (self.setup.sd > 0) & (self.setup.sd < PLACED_SD)
        return float(self.volume - (self.deviations[uncertain] ** 2).sum() / 2)

    @property
    def displacements(self) -> np.ndarray:
        """The displacements of stated base and markers [m and rad]."""
        return self.shifts(self.setup)

    def shifts(self, stated: Setup) -> np.ndarray:
        """Return the displacements of what another set-up has as stated base and markers [m and rad]."""
        return np.abs(self.estimate - self.mean)[list(stated.stated)]

    @property
    def base(self) -> tuple[np.ndarray, np.ndarray]:
        """The base pose in the measuring frame: turn (3, 3) and origin (3,) [m]."""
        small = {self.model.parameters[k].symbol: self.estimate[k] for k in self.setup.base}
        turn = self.turn @ Rotation.from_euler("XYZ", [small["rx"], small["ry"], small["rz"]]).as_matrix()
        return turn, self.turn @ np.array([small["x"], small["y"], small["z"]]) + self.shift

    def figure(self, parameter: Parameter) -> float:
        """Return the estimated value of a dimension, in SI."""
        there = [p.identity for p in self.model.parameters].index(parameter.identity)
        return float(self.model.parameters[there].figure + self.estimate[there])
