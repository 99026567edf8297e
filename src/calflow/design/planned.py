"""A planned measurement with its standard deviations, the task at which the tool's error counts, and the request for poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import PlainValidator

from calflow.design.candidates import admissible, candidates, packed_conditions
from calflow.design.cell import Cell, refused_words
from calflow.design.optimality import ToolError
from calflow.estimation.least_squares import LeastSquares, SeriesBlock
from calflow.estimation.noise import Noise, PerUnit
from calflow.estimation.progress import Say, nobody
from calflow.faults.implausible import plausible
from calflow.files.problems import refuse
from calflow.files.toml import Count, Positive, as_annotated
from calflow.measurements.cells import read_cells
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import Layout, numbered, split_column
from calflow.measurements.series import Series
from calflow.model import Model
from calflow.observations import Observation
from calflow.observations.position import Position
from calflow.robot.robot import Robot

Aim = Literal["parameters", "tool", "worst"]  # whose variance is minimised
Measure = Literal["rms", "worst"]  # of the tool's error over the task
Order = Literal["short", "random"]  # in which poses are measured
RecordedCondition = Literal["approach", "travel", "time", "temperature"]  # besides joint readings
USUAL_DRIFT = 5e-5  # m: of a laser tracker in an afternoon
USUAL_SIGMA = 5e-5  # m, of a laser tracker on a large robot
USUAL_TURNING_SIGMA = 1e-4  # rad, of its orientations


@dataclass(frozen=True)
class Planned:
    """A kind of observation with its standard deviations: sigma in its leading unit, further in each other unit."""

    observation: Observation
    sigma: float
    further: PerUnit = field(default_factory=PerUnit)

    @staticmethod
    def like(observation: Observation, noise: Noise, k: int, share: float = 1.0) -> Planned:
        """Return the plan of observations like series k, with only a share of the further rows fitted."""
        about = noise.only(noise.of_series(k)).about_model(observation.units)
        sizes = {
            unit: float(np.sqrt(np.mean(sd**2) / share)) for unit, sd in zip(observation.units, about, strict=True)
        }
        return Planned(observation, sizes[observation.units[0]], PerUnit(tuple(sizes.items())))

    def whitened(self, model: Model, p: np.ndarray, conditions: np.ndarray) -> np.ndarray:
        """Return the whitened Jacobian (n_poses, n_values, n_parameters) of packed conditions (n_conditions, n_poses) at p."""
        (block,) = self.problem(model, p, conditions).blocks
        return block.linearised(p)[1].reshape(conditions.shape[1], -1, len(p))

    def problem(self, model: Model, p: np.ndarray, conditions: np.ndarray) -> LeastSquares:
        """Return the problem of packed conditions (n_conditions, n_poses), a row for each point seen, as predicted at p."""
        conditions = np.repeat(conditions, self.observation.n_seen, axis=1)
        reported = self.observation.expected(model.point(p, conditions), model.rotation(p, conditions))
        sigma = np.tile(self.sd[:, None], conditions.shape[1])
        every = np.arange(conditions.shape[1])
        block = SeriesBlock(model, self.observation, every, conditions, reported, 1 / sigma, sigma, sigma, every)
        return LeastSquares(model, (block,))

    @property
    def sd(self) -> np.ndarray:
        """Standard deviation of each residual, shape (n_units,)."""
        units = self.observation.units
        return np.array([self.sigma if unit == units[0] else self.further[unit] or unit.usual for unit in units])


def stated_poses(file: Path, robot: Robot) -> np.ndarray:
    """Return the joint readings of a pose file [rad, or m], shape (n_poses, n_joints), whatever its other columns.

    Raises:
        InputError: it cannot be read, lacks a joint's column, has no poses, or poses that the robot cannot reach.
    """
    joint_of = {name: split_column(name, robot)[0] for name in map(str, read_cells(file, Layout()))}
    readings = {name: name for name, joint in joint_of.items() if joint in numbered("q", robot.n_joints)}
    # A file that lacks readings is read as it is, for the message on its columns.
    whole = {f"q{i + 1}" for i in robot.driven} <= set(joint_of.values())
    rows = Measurements.to_predict(file, robot, columns=readings if whole else {})
    return plausible(rows, file).joints


@dataclass(frozen=True, eq=False)
class Task:
    """The poses at which the tool must be accurate, equally weighted: readings (n, n_joints), and the payload of each (n,)."""

    readings: np.ndarray
    payloads: np.ndarray
    marker: str

    @staticmethod
    def within(
        model: Model, payloads: Sequence[str], marker: str, region: np.ndarray | None, number: int,
        rng: np.random.Generator,
    ) -> Task:  # fmt: skip
        """Return a number of poses drawn over a region (2, 3) [m] under each payload; InputError if hardly any reaches it."""
        readings, _ = candidates(model, number, payloads[0], marker, region, rng)
        return Task.of(readings, payloads, marker)

    @staticmethod
    def of(readings: np.ndarray, payloads: Sequence[str], marker: str) -> Task:
        """Return the task of joint readings (n, n_joints), each under each payload."""
        return Task(np.tile(readings, (len(payloads), 1)), np.repeat(payloads, len(readings)), marker)

    def criterion(self, model: Model) -> ToolError:
        """Return the tool's error over the task, parameters scaled by priors, for images without what teaching the tool removes."""
        conditions = packed_conditions(model, self.readings, self.payloads, self.marker)
        slopes = model.point_jacobian(model.nominal, conditions) * model.prior_sd
        if model.tool_unseen:
            taught, flat = by_tool(model, model.nominal, conditions), slopes.reshape(-1, slopes.shape[2])
            slopes = (flat - taught @ (taught.T @ flat)).reshape(slopes.shape)
        return ToolError(slopes, np.full(len(slopes), 1 / len(slopes)))


def by_tool(model: Model, p: np.ndarray, conditions: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis (3 n_rows, 3) of displacements of the rows' points by the tool's place on the flange."""
    return np.asarray(np.linalg.qr(model.rotation(p, conditions).reshape(-1, 3))[0])


def _table_of(shape: str, height: int | None = None, width: int | None = None) -> PlainValidator:
    """Return the conversion of lists of numbers to an array (height, width); shape: the same in words; None: any length."""

    def converted(given: object) -> np.ndarray:
        try:
            array = np.asarray(given, dtype=float)
        except (TypeError, ValueError):
            array = np.zeros(())
        if array.ndim != 2 or array.shape != (height or len(array), width or array.shape[1]):
            raise ValueError(f"expected numbers in an array of shape {shape}")
        return array

    return PlainValidator(converted)


Region = Annotated[np.ndarray, _table_of("(2, 3)", 2, 3)]
Readings = Annotated[np.ndarray, _table_of("(n, n_joints)")]
Conditions = Annotated[np.ndarray, _table_of("(n_conditions, n)")]


@dataclass(frozen=True, kw_only=True)
class SelectionRequest:
    """The settings of a selection of poses.

    Attributes:
        number: number of poses.
        aim: criterion: all parameters (D-optimality, O1), the tool over the task (I-optimality), or its worst point.
        task: the poses at which the tool must be accurate; by default the first candidates.
        payload: the load of the measurement; empty: none.
        marker: the measured marker; empty: the first.
        region: a box (2, 3) [m] in the measuring frame that must contain the marker.
        cell: constraints: lines of sight, obstacles, a configuration.
        planned: how poses will be measured; by default as positions, 50 µm per axis.
        candidates: number of candidates drawn.
        stated: joint readings (n, n_joints) to choose from, instead of drawn candidates.
        there: packed conditions (n_conditions, n) of existing measurements, whose information is included.
        tolerance: limit [m] of the tool's error over the task: of its standard deviation, for which the number of poses is
            sought, or of the true error, within which measuring may stop.
        refine: whether chosen poses are moved between the candidates; not for the worst point.
        order: measuring order: a short tour, or blocks drawn at random.
        drift: steady drift [m] from the first pose to the last, whose bias is reported.
        both_sides: whether each joint is to approach from both sides equally often, from vias.
    """

    number: Count = 100
    aim: Aim = "parameters"
    task: Task | None = None
    payload: str = ""
    marker: str = ""
    region: Region | None = None
    cell: Cell | None = None
    planned: Planned = field(default_factory=lambda: Planned(Position.planned(Series()), USUAL_SIGMA))
    candidates: Count = 2000
    stated: Readings | None = None
    there: Conditions | None = None
    tolerance: Positive | None = None
    refine: bool = False
    order: Order = "short"
    drift: Positive = USUAL_DRIFT
    both_sides: bool = False

    def __post_init__(self) -> None:
        as_annotated(SelectionRequest, vars(self))
        if self.stated is None and self.candidates < self.number:
            raise refuse(
                f"expected at least as many as poses, {self.number}, found {self.candidates}", key="candidates"
            )

    @property
    def measure(self) -> Measure:
        return "worst" if self.aim == "worst" else "rms"

    def rows(self, model: Model, readings: np.ndarray) -> np.ndarray:
        """Return packed conditions (n_conditions, n) of poses; the request must name a marker."""
        return packed_conditions(model, readings, self.payload, self.marker)

    def whitened(self, model: Model, readings: np.ndarray) -> np.ndarray:
        """Return the poses' whitened Jacobian (n, n_axes, n_parameters), parameters in prior standard deviations."""
        return self.planned.whitened(model, model.nominal, self.rows(model, readings)) * model.prior_sd

    def allowed(self, model: Model, readings: np.ndarray, say: Say = nobody) -> np.ndarray:
        """Return which joint readings (n, n_joints) are within limits and region, and allowed by the cell, shape (n,)."""
        good, refusals = admissible(model, self.rows(model, readings), self.marker, self.region, self.cell)
        if self.cell is not None:
            say(f"of those stated within joint limits and region {refused_words(refusals)}")
        return good

    def choice(
        self, model: Model, seen: Observation, rng: np.random.Generator, least: int, say: Say = nobody
    ) -> np.ndarray:
        """Return candidate readings (n, n_joints): drawn to suit an observation, or the admissible stated ones.

        Raises:
            InputError: hardly any pose reaches the region, or fewer than `least` of those stated are admissible.
        """
        if self.stated is None:
            asked = self.payload, self.marker, self.region
            return candidates(model, self.candidates, *asked, rng, seen, self.cell, say)[0]
        if self.stated.shape[1] != model.robot.n_joints:
            shape = f"(n, {model.robot.n_joints})"
            raise refuse(f"expected joint readings of shape {shape}, found {self.stated.shape}", key="stated")
        readings = self.stated[self.allowed(model, self.stated, say)]
        if len(readings) < least:
            region, cell = (", region", " and cell") if self.cell else (" and region", "")
            raise refuse(
                f"of {len(self.stated)} stated poses {len(readings)} are within joint limits{region}{cell}, "
                f"{least} are to be chosen"
            )
        return readings
