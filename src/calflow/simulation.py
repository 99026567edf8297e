"""Simulation: measurements of a robot with known errors (a truth file), for comparison with a study's estimates."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from calflow.design.candidates import candidates, packed_conditions
from calflow.design.cell import Box
from calflow.design.planned import stated_poses
from calflow.effects.base import unmet
from calflow.files.deferred import pd
from calflow.files.problems import InputError, Problem, nearest, refuse_any, run_checks, truncated
from calflow.files.toml import FileModel, Length, Lengths3, Origin, Seed, Unit, read_toml
from calflow.files.units import LARGEST, spellings
from calflow.model import Model, build
from calflow.robot.mechanism import reading_columns, shown_readings
from calflow.robot.robot import Robot
from calflow.study import Effects, check_effects

MOST_ROWS = 10_000_000  # per marker: guards memory against a mistyped number


class Device(FileModel):
    """A tracker: noise per axis is floor + noise · range."""

    origin: Lengths3 = (0.0, 0.0, 0.0)
    floor: Length = Field(default=0.0, ge=0)
    noise: Annotated[float, Unit("ratio")] = Field(default=0.0, ge=0)

    def sigma(self, position: np.ndarray) -> np.ndarray:
        """Return the standard deviation per axis [m] at positions (n, 3)."""
        return np.asarray(self.floor + self.noise * np.linalg.norm(position - np.array(self.origin), axis=1))


class PoseSet(FileModel):
    """Poses to measure: a number of random ones, or those of a file as written by the stage select."""

    split: Literal["train", "holdout"] | None = None
    poses: str | None = None
    random: int | None = Field(default=None, ge=1)

    @model_validator(mode="after")
    def _one_source(self) -> PoseSet:
        if (self.poses is None) == (self.random is None):
            raise ValueError('expected either poses = "file.csv" or random = number')
        return self


class Truth(FileModel):
    """A truth file: the robot, its true errors, the device and the measured poses."""

    robot: str
    effects: Effects
    seed: Seed
    repeats: int = Field(default=1, ge=1)
    approach: bool = False
    payloads: tuple[str, ...] = ()
    region: Box | None = None
    device: Device = Device()
    sets: tuple[PoseSet, ...] = Field(min_length=1)
    values: dict[str, dict[str, Any]] = {}

    @model_validator(mode="after")
    def _of_some_size(self) -> Truth:
        rows = self.repeats * sum(set.random or 0 for set in self.sets)
        if max(rows, self.repeats) > MOST_ROWS:
            raise ValueError(
                f"expected at most {MOST_ROWS:,} rows a marker, found {rows:,} (random poses times repeats)"
            )
        return self

    @model_validator(mode="after")
    def _split_in_all(self) -> Truth:
        if 0 < sum(set.split is None for set in self.sets) < len(self.sets):
            raise ValueError(
                "expected split in all [[sets]] or in none: a file's rows are divided throughout or not at all"
            )
        return self


def simulate(path: str | Path) -> pd.DataFrame:
    """Return the measurement table that a truth file describes, in a measurement file's columns.

    Raises:
        InputError: with all problems of the truth file and its robot.
    """
    path = Path(path)
    truth = read_toml(path, Truth)
    robot_path = path.parent / truth.robot
    robot = Robot.from_toml(robot_path)
    check_effects(truth.effects, robot, robot_path)
    model = build(robot, truth.effects, ("approach",) if truth.approach else ())
    values, _, _ = run_checks(
        lambda: _values(truth, model, path),
        lambda: _check_payloads(truth, robot, path),
        lambda: _check_conditions(model, path),
    )
    rng = np.random.default_rng(truth.seed)
    payloads = truth.payloads or ("",)
    tables, first = [], 1
    for pose_set in truth.sets:
        readings = _readings(pose_set, truth, model, path, rng)
        tables.append(_measure(readings, first, pose_set, truth, model, values, payloads, rng))
        first += len(readings)
    return pd.concat(tables, ignore_index=True)


def _check_payloads(truth: Truth, robot: Robot, path: Path) -> None:
    origin = Origin.of(path)
    refuse_any(
        origin.problem(f"unknown payload '{name}'{nearest(name, robot.payloads)}", "payloads")
        for name in truth.payloads
        if name and name not in robot.payloads
    )


def _check_conditions(model: Model, path: Path) -> None:
    """Reject effects without influence because no simulated row has the conditions that they need."""
    origin = Origin.of(path)
    refuse_any(
        origin.problem(f"effect '{effect.id}' needs {'approach = true' if need == 'approach' else lacking}", "effects")
        for effect in model.effects
        for need in effect.needs
        for lacking in unmet((need,), model.robot, model.given)
    )


# By the path of a key, [values.PART] or [values.PART.EFFECT]: the parameters that it may mean, and its unit's factor to SI.
_Meanings = Mapping[tuple[str, ...], Sequence[tuple[int, float]]]


def _values(truth: Truth, model: Model, path: Path) -> np.ndarray:
    """Return the true parameters, from `[values.PART] key` or, if ambiguous, `[values.PART.EFFECT] key`."""
    meanings = defaultdict[tuple[str, ...], list[tuple[int, float]]](list)
    for i, p in enumerate(model.parameters):
        for suffix, factor in spellings(p.unit).items():
            for way in ((p.part,), (p.part, p.effect)):
                meanings[*way, p.symbol + suffix].append((i, factor))
    values, set_before = model.nominal.copy(), set[int]()
    problems, origin = list[Problem](), Origin.of(path)
    for location, value in _stated(truth):
        if wrong := _wrong_value(location, value, meanings, model, set_before):
            problems.append(origin.problem(wrong, "values", *location))
            continue
        ((index, factor),) = meanings[location]
        set_before.add(index)
        values[index] = factor * value
    refuse_any(problems)
    return values


def _stated(truth: Truth) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield every true value with its path: part, effect if stated, and key."""
    for part, table in truth.values.items():
        for key, value in table.items():
            if isinstance(value, dict):
                yield from (((part, key, inner), figure) for inner, figure in value.items())
            else:
                yield (part, key), value


def _wrong_value(location: tuple[str, ...], value: Any, meanings: _Meanings, model: Model, set_before: set[int]) -> str:
    """Return what is wrong with a true value; empty if nothing."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return f"expected a number, found {truncated(repr(value))}"
    if location not in meanings:
        known = [".".join(way) for way in meanings if len(way) == len(location)]
        return f"unknown parameter or unit{nearest('.'.join(location), known)}"
    meant = [model.parameters[index] for index, _ in meanings[location]]
    if len(meant) > 1:
        ways = " or ".join(f"[values.{parameter.part}.{parameter.effect}] {location[-1]}" for parameter in meant)
        return f"belongs to {len(meant)} parameters: expected {ways}"
    ((index, factor),) = meanings[location]
    if index in set_before:
        return "is given twice, in different units"
    if not abs(factor * value) <= LARGEST[""]:
        return f"expected at most {LARGEST['']:g}, found {value!r}"
    return ""


def _readings(pose_set: PoseSet, truth: Truth, model: Model, path: Path, rng: np.random.Generator) -> np.ndarray:
    """Return the joint readings of a set, rounded as in a file, so that the file holds exactly the simulated pose."""
    units = np.array([np.deg2rad(1.0) if joint.kind == "revolute" else 1e-3 for joint in model.robot.joints])
    if pose_set.poses is not None:
        stated = stated_poses(path.parent / pose_set.poses, model.robot) / units
    else:
        region = np.array([truth.region.min, truth.region.max]) if truth.region else None
        payload = truth.payloads[0] if truth.payloads else ""
        marker = next(iter(model.robot.markers))
        try:
            readings, _ = candidates(model, pose_set.random or 0, payload, marker, region, rng)
        except InputError as error:
            raise Origin.of(path).refuse(error.problems[0].message, "region") from None
        stated = readings / units
    return np.round(stated, 4) * units


def _measure(
    readings: np.ndarray, first: int, pose_set: PoseSet, truth: Truth, model: Model, values: np.ndarray,
    payloads: tuple[str, ...], rng: np.random.Generator,
) -> pd.DataFrame:  # fmt: skip
    robot = model.robot
    poses = np.arange(first, first + len(readings))
    carried = np.array(payloads, dtype=object)[np.arange(len(readings)) % len(payloads)]
    approach = np.sign(np.diff(readings, axis=0, prepend=readings[:1])).astype(int)
    blocks = []
    for marker in robot.markers:
        position = np.empty((len(readings), 3))
        for payload in payloads:
            rows = carried == payload
            conditions = packed_conditions(model, readings[rows], payload, marker)
            if truth.approach:
                conditions[-robot.n_joints :] = approach[rows].T
            position[rows] = model.position(values, conditions)
        sigma = truth.device.sigma(position)
        for repeat in range(1, truth.repeats + 1):
            seen = position + sigma[:, None] * rng.standard_normal(position.shape)
            block = pd.DataFrame({"pose": poses, "repeat": repeat, "marker": marker, "payload": carried})
            if pose_set.split:
                block["split"] = pose_set.split
            for name, column in zip(reading_columns(robot), shown_readings(robot, readings).T, strict=True):
                block[name] = np.round(column, 4)
            if truth.approach:
                for i in robot.driven:
                    block[f"approach{i + 1}"] = approach[:, i]
            for i, axis in enumerate("xyz"):
                block[f"{axis}_mm"] = np.round(1e3 * seen[:, i], 4)
            if (sigma > 0).all():  # a device without noise leaves the column out
                stated = np.round(1e3 * sigma, 5)
                block["sigma_mm"] = np.where(stated > 0, stated, 1e3 * sigma)
            blocks.append(block)
    return pd.concat(blocks).sort_values(["pose", "repeat"], kind="stable")
