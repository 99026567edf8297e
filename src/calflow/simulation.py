"""Simulation: a truth file becomes a measurement CSV, so that what a study finds can be compared with what is true."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pandas as pd
from pydantic import Field, model_validator

from calflow.model import Model, build
from calflow.problems import InputError, Problem, nearest, refuse
from calflow.robot.description import Robot, read_robot
from calflow.stages.candidates import candidates, pack
from calflow.toml_file import FileModel, Length, Lengths3, Unit, line_numbers, read_toml
from calflow.units import split_unit, to_si


class Region(FileModel):
    """A box in the measuring frame."""

    min: Lengths3
    max: Lengths3


class Device(FileModel):
    """A tracker: noise per axis is the root of floor² + (noise · range)²."""

    origin: Lengths3 = (0.0, 0.0, 0.0)
    floor: Length = Field(default=0.0, ge=0)
    noise: Annotated[float, Unit("ratio")] = Field(default=0.0, ge=0)

    def sigma(self, position: np.ndarray) -> np.ndarray:
        """Return the standard deviation per axis [m] at positions (n, 3)."""
        return np.hypot(self.floor, self.noise * np.linalg.norm(position - np.array(self.origin), axis=1))


class PoseSet(FileModel):
    """Poses to measure: so many random ones, or a file's (as the stage select writes it)."""

    split: Literal["train", "holdout"] | None = None
    poses: str | None = None
    random: int | None = Field(default=None, ge=1)

    @model_validator(mode="after")
    def _one_source(self) -> PoseSet:
        if (self.poses is None) == (self.random is None):
            raise ValueError('expected either poses = "file.csv" or random = number')
        return self


class Truth(FileModel):
    """A truth file: the robot, its real errors, the device and what is measured with it."""

    robot: str
    effects: tuple[str, ...]
    seed: int = Field(ge=0)
    repeats: int = Field(default=1, ge=1)
    approach: bool = False
    payloads: tuple[str, ...] = ()
    region: Region | None = None
    device: Device = Device()
    sets: tuple[PoseSet, ...] = Field(min_length=1)
    values: dict[str, dict[str, float]] = {}


def simulate(path: Path) -> pd.DataFrame:
    """Return the measurement table that a truth file describes, in a measurement file's columns.

    Raises:
        InputError: with all problems of the truth file and its robot.
    """
    truth = read_toml(path, Truth)
    robot = read_robot(path.parent / truth.robot)
    model = build(robot, truth.effects)
    values = _values(truth, model, path)
    for payload in truth.payloads:
        if payload not in robot.payloads:
            raise refuse(f"unknown payload '{payload}'{nearest(payload, robot.payloads)}", path, key="payloads")
    rng = np.random.default_rng(truth.seed)
    payloads = truth.payloads or ("",)
    tables, first = [], 1
    for pose_set in truth.sets:
        readings = _readings(pose_set, truth, model, path, rng)
        tables.append(_measure(readings, first, pose_set, truth, model, values, payloads, rng))
        first += len(readings)
    return pd.concat(tables, ignore_index=True)


def _values(truth: Truth, model: Model, path: Path) -> np.ndarray:
    """The true parameter values; a key is the parameter's symbol with a unit, in the table of its part."""
    index = {(p.part, p.symbol): i for i, p in enumerate(model.parameters)}
    values = model.nominal.copy()
    problems: list[Problem] = []
    lines = line_numbers(path.read_text(encoding="utf-8"))
    for part, table in truth.values.items():
        for key, value in table.items():
            symbol, unit = split_unit(key) or (key, "")
            line = lines.get(("values", part, key))
            at = index.get((part, symbol))
            if at is None or not unit:
                known = [f"{p.part}.{p.symbol}" for p in model.parameters]
                problems.append(Problem(f"unknown parameter{nearest(f'{part}.{symbol}', known)} (with its unit, as in alpha_mrad)",
                                        path, line, f"values.{part}.{key}"))  # fmt: skip
            else:
                values[at] = to_si(unit)[0] * value
    if problems:
        raise InputError(problems)
    return values


def _readings(pose_set: PoseSet, truth: Truth, model: Model, path: Path, rng: np.random.Generator) -> np.ndarray:
    """Joint readings of a set, rounded to what a file states, so that the file holds the very pose simulated."""
    robot = model.robot
    if pose_set.poses is not None:
        file = path.parent / pose_set.poses
        try:
            table = pd.read_csv(file)
            degrees = table[_reading_columns(robot)].to_numpy()
        except (OSError, ValueError, KeyError) as error:
            raise refuse(f"cannot be read as poses with {', '.join(_reading_columns(robot))}: {error}", file) from None
    else:
        region = np.array([truth.region.min, truth.region.max]) if truth.region else None
        payload = truth.payloads[0] if truth.payloads else ""
        marker = next(iter(robot.markers))
        readings, _ = candidates(model, pose_set.random or 0, payload, marker, region, rng)
        degrees = readings / _reading_units(robot)
    return np.round(degrees, 4) * _reading_units(robot)


def _measure(
    readings: np.ndarray, first: int, pose_set: PoseSet, truth: Truth, model: Model, values: np.ndarray,
    payloads: tuple[str, ...], rng: np.random.Generator,
) -> pd.DataFrame:  # fmt: skip
    robot = model.robot
    poses = np.arange(first, first + len(readings))
    carried = np.array(payloads, dtype=object)[np.arange(len(readings)) % len(payloads)]
    approach = np.sign(np.diff(readings, axis=0, prepend=readings[-1:])).astype(int)
    blocks = []
    for marker in robot.markers:
        position = np.empty((len(readings), 3))
        for payload in payloads:
            own = carried == payload
            position[own] = model.position(values, pack(model, readings[own], payload, marker))
        sigma = truth.device.sigma(position)
        for repeat in range(1, truth.repeats + 1):
            seen = position + sigma[:, None] * rng.standard_normal(position.shape)
            block = pd.DataFrame({"pose": poses, "repeat": repeat, "marker": marker, "payload": carried})
            if pose_set.split:
                block["split"] = pose_set.split
            for name, column in zip(_reading_columns(robot), (readings / _reading_units(robot)).T, strict=True):
                block[name] = np.round(column, 4)
            if truth.approach:
                for i in range(robot.n_joints):
                    block[f"approach{i + 1}"] = approach[:, i]
            for i, axis in enumerate("xyz"):
                block[f"{axis}_mm"] = np.round(1e3 * seen[:, i], 4)
            blocks.append(block.assign(sigma_mm=np.round(1e3 * sigma, 5)))
    return pd.concat(blocks).sort_values(["pose", "repeat"], kind="stable")


def _reading_columns(robot: Robot) -> list[str]:
    return [f"q{i + 1}_{'deg' if joint.kind == 'revolute' else 'mm'}" for i, joint in enumerate(robot.joints)]


def _reading_units(robot: Robot) -> np.ndarray:
    return np.array([np.deg2rad(1.0) if joint.kind == "revolute" else 1e-3 for joint in robot.joints])
