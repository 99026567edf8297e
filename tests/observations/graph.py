"""An observation's graph evaluated with numbers, and its round trip through a run's tables."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from calflow.estimation.model_tables import ModelObservation, observation_table, read_observations
from calflow.observations import Observation, Seen


def error(
    observation: Observation,
    p: np.ndarray,
    points: np.ndarray,
    table: pd.DataFrame,
    rotations: np.ndarray | None = None,
    device: float = 1.0,
) -> np.ndarray:
    """Predicted minus reported (n_rows, n_units) at parameters p, of points (n_rows, 3); the device stretches by a factor."""
    rotations = np.tile(np.eye(3), (len(points), 1, 1)) if rotations is None else rotations
    own, point, rotation = ca.SX.sym("p", len(observation.declared)), ca.SX.sym("x", 3), ca.SX.sym("R", 3, 3)
    y = ca.SX.sym("y", observation.reports)
    seen = Seen(
        point, lambda: rotation, lambda there: device * there, lambda link: ca.SX.eye(4), lambda: ca.SX([0, 0, -1])
    )
    function = ca.Function("error", [own, point, rotation, y], [ca.densify(observation.error(own, seen, y))])
    reported = observation.reported(table)
    assert reported.shape == (observation.reports, len(table))
    rows = [np.array(function(p, points[i], rotations[i], reported[:, i])).ravel() for i in range(len(points))]
    found = np.array(rows)
    assert found.shape == (len(points), len(observation.units))
    return found


def no_links(name: str) -> np.ndarray:
    """The frames of a robot's links where an observation is not to ask for them."""
    raise AssertionError(f"asks for link '{name}'")


def through_json(observation: Observation) -> Observation:
    """The observation as a later stage reads it back."""
    row = observation_table([observation]).iloc[0].to_dict()
    return read_observations([ModelObservation(**row)])[0]


def turned(rng: np.random.Generator, n: int) -> np.ndarray:
    """Random rotations (n, 3, 3)."""
    return Rotation.random(n, rng=rng).as_matrix()


def frame(six: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and origin of a place given by origin and angles about x, y, z in turn."""
    return Rotation.from_euler("XYZ", six[3:]).as_matrix(), np.asarray(six[:3])
