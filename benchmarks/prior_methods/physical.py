"""Models of the robot's physics: the maker's figures, geometry, geometry with springs in the joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calflow.estimation.identification import fit_effects
from calflow.estimation.registration import registered
from calflow.measurements.measurements import Measurements
from calflow.model import Model, build
from calflow.observations import observations
from prior_methods.method import Predictor, timed


@dataclass(frozen=True)
class Calibrated:
    """A model and its parameters (n_parameters,)."""

    model: Model
    estimate: np.ndarray

    def positions(self, rows: Measurements) -> np.ndarray:
        """Return where it says that the robot will be, shape (n_rows, 3) [m]."""
        return self.model.position(self.estimate, rows.on(self.model.robot).conditions)


def calibrated(train: Measurements, *effects: str) -> Calibrated:
    """Fit effects, one after the other."""
    known = fit_effects(train, effects, starts=1).known
    return Calibrated(known.model, known.estimate)


@dataclass(frozen=True)
class Nominal:
    """The maker's figures; base and tool stand where the training rows say."""

    name: str = "nominal, base and tool placed"

    def lacking(self, train: Measurements) -> str:
        """Nothing."""
        return ""

    @timed
    def fit(self, train: Measurements) -> Predictor:
        """Place base and tool."""
        robot, _ = registered(train.robot, observations(train), train)
        model = build(robot, (), train.given)
        return Calibrated(model, model.nominal).positions


@dataclass(frozen=True)
class Geometry:
    """All identifiable errors of the kinematic table."""

    name: str = "geometry"

    def lacking(self, train: Measurements) -> str:
        """Nothing."""
        return ""

    @timed
    def fit(self, train: Measurements) -> Predictor:
        """Fit them."""
        return calibrated(train, "geometry").positions


@dataclass(frozen=True)
class Compliance:
    """Geometry, and a spring in each joint that gravity winds up."""

    name: str = "geometry + joint compliance"

    def lacking(self, train: Measurements) -> str:
        """Masses."""
        return "" if train.robot.has_masses else "no masses known"

    @timed
    def fit(self, train: Measurements) -> Predictor:
        """Fit both."""
        return calibrated(train, "geometry", "joint-compliance").positions
