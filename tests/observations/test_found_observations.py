"""Observations of other packages: found by their entry points, and then like any other."""

from __future__ import annotations

import os

import pandas as pd

from plugin import install

LASER = '''\
"""A laser on the floor that reads the marker's height over it."""

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np

from calflow.files.units import METRE, MeasurementUnit
from calflow.measurements.rows import Reported
from calflow.observations.base import Observation
from calflow.robot.parts import Parameter


@dataclass(frozen=True)
class FloorHeight(Observation):
    """height = z + zero."""

    id: ClassVar[str] = "floor-height"
    title: ClassVar[str] = "height over the floor"
    columns: ClassVar[Reported] = Reported({"height": "length"})
    units: ClassVar[tuple[MeasurementUnit, ...]] = (METRE,)

    @classmethod
    def of(cls, series, table):
        return cls(series)

    def parameters(self):
        return (Parameter(self.id, self.part, "zero", "m", 0.5, -3.0, 3.0, meaning="zero of the laser"),)

    @property
    def reports(self):
        return 1

    def reported(self, table):
        return table["height"].to_numpy(float)[None]

    def error(self, p, seen, y):
        return seen.point[2] + p[0] - y[0]

    def expected(self, points, rotations):
        return points[:, 2][None]
'''


def test_a_found_observation_is_read_fitted_and_planned(small, tmp_path):
    """Fails if another package's kind cannot stand in a study, or its own parameter gets lost on the way."""
    site = install(tmp_path / "site", "lasers", LASER, "floor-height = lasers:FloorHeight", "calflow.observations")
    rows = small.rows
    height = rows["z_mm"].astype(float) + 120.0
    small.measure(rows.drop(columns=["x_mm", "y_mm", "z_mm"]).assign(height_mm=height), "heights.csv")
    small.edit("study.toml", ('file = "measurements.csv"', 'kind = "floor-height"\nfile = "heights.csv"'))
    path = os.pathsep.join(filter(None, (str(site), os.environ.get("PYTHONPATH"))))
    small.edit("quick.toml", (', "sample"]', "]"), ("[settings.sample]\nmax_steps = 60\nblock = 20\ness = 100\n", ""))
    environment = {**os.environ, "PYTHONPATH": path, "PYTHONIOENCODING": "utf-8"}
    done = small.forked("-m", "calflow", "run", ".", "--out", "runs", env=environment)
    assert done.returncode == 0, done.stderr
    found = pd.read_csv(small / "runs" / "identify" / "parameters.csv").set_index("parameter")
    own = found.loc["floor-height.zero"]
    assert own["effect"] == "floor-height"
    assert abs(own["estimate"] - 0.12) < 5 * own["sd"] + 0.02
    assert len(pd.read_csv(small / "runs" / "select" / "poses.csv")) == 8


def test_a_kind_of_a_package_that_is_not_there_is_refused(small):
    """Fails if a study with an unknown kind is read, or the kinds that there are are not named."""
    small.edit("study.toml", ('file = "measurements.csv"', 'kind = "floor-height"\nfile = "measurements.csv"'))
    (said,) = small.refused()
    assert "floor-height" in said
    assert "distance" in said
