"""A robot of the 210 kg class as built, where a tracker sees it: the hidden simulator's mechanics, apart from calflow's graph."""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import calflow as cf
from calflow.estimation.calibrated_model import CalibratedModel
from hidden.case import COMPLIANCE, Case, draw_poses, robot_file, stated_tables, toml
from hidden.causes import PAYLOADS, Hidden, measured_points
from hidden.simulator import Robot, Rows, read, worn

EFFECTS = ("geometry", "joint-compliance")
LOAD_KG = 210.0
NOISE = 5e-5  # m, per axis, of the tracker
COLD = 20.0  # degC at which it was calibrated


@dataclass(frozen=True)
class HeavyRobot:
    """A robot as its maker states it, for calflow and for the simulator, and as it was built."""

    stated: cf.Robot
    nominal: Robot
    real: Robot
    markers: tuple[str, ...]

    @staticmethod
    def drawn(rng: np.random.Generator, markers: int = 1) -> HeavyRobot:
        """One of many: tenths of a millimetre and of a millirad off, springs by a tenth, base and tool by more."""
        case = Case(robot="serial", markers=markers)
        tables = stated_tables(case)
        for share, name in enumerate(PAYLOADS):
            tables["payloads"][name]["mass_kg"] = share / 2 * LOAD_KG
        nominal = read(tables, np.array(COMPLIANCE["serial"]))
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "robot.toml")
            file.write_text(toml(robot_file(tables, True)), encoding="utf-8")
            stated = cf.Robot.from_toml(file)
        return HeavyRobot(stated, nominal, worn(nominal, rng), tuple(tables["markers"]))

    def poses(self, number: int, rng: np.random.Generator) -> np.ndarray:
        """Readings (number, 6) [rad] anywhere with the tool before the robot."""
        return draw_poses(self.nominal, Case(robot="serial", poses=number), rng)

    def points(self, q: np.ndarray, payload: str = "full", temperature: float = COLD) -> np.ndarray:
        """Where all markers are at readings, without noise (n_poses, n_markers, 3) [m]."""
        poses, each = len(q), len(self.markers)
        rows = _rows(np.repeat(q, each, axis=0), PAYLOADS.index(payload), np.tile(np.arange(each), poses), temperature)
        warm = (Hidden("thermal-growth", 0, 12e-6),)
        return measured_points(self.real, rows, warm).reshape(poses, each, 3)

    def measured(self, q: np.ndarray, points: np.ndarray, payload: str = "full", **more: object) -> cf.Measurements:
        """Rows that say that markers were seen at points (n_poses, n_markers, 3) [m] when the robot was at readings q."""
        each = len(self.markers)
        return cf.Measurements.from_arrays(
            self.stated, np.repeat(q, each, axis=0), points.reshape(-1, 3), payload=payload,
            marker=np.tile(self.markers, len(q)), pose=np.repeat(np.arange(1, len(q) + 1), each),
            sigma=np.full(each * len(q), NOISE), **more,
        )  # fmt: skip

    def calibrated(
        self, poses: int, rng: np.random.Generator, effects: tuple[str, ...] = EFFECTS
    ) -> tuple[CalibratedModel, cf.Measurements]:
        """What calflow identifies by poses of its own, every load carried by a third of them; and their rows."""
        q = self.poses(poses, rng)
        blocks = [
            self.measured(own, seen(self.points(own, payload), rng), payload, split="train")
            for own, payload in zip(np.array_split(q, len(PAYLOADS)), PAYLOADS, strict=True)
        ]
        data = _stacked(blocks)
        known = cf.identify(self.stated, data, effects, starts=1)
        return replace(known, model=replace(known.model, given=())), data


def seen(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Points as the tracker reports them."""
    return np.asarray(points + NOISE * rng.standard_normal(points.shape))


def _stacked(blocks: list[cf.Measurements]) -> cf.Measurements:
    """All rows under one another, each pose with a number of its own."""
    tables = [one.table.assign(pose=[f"{k}-{name}" for name in one.table["pose"]]) for k, one in enumerate(blocks)]
    table = pd.concat(tables, ignore_index=True)
    return replace(blocks[0], table=table.assign(line=np.arange(1, len(table) + 1)))


def _rows(q: np.ndarray, payload: int, marker: np.ndarray, temperature: float) -> Rows:
    n, none = len(q), np.zeros_like(q)
    return Rows(q, np.full(n, payload), marker, none, none, none, np.zeros(n), np.full(n, temperature))
