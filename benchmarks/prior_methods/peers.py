"""Programs of others: pybotics in an environment of its own; figaroh, which these studies cannot feed."""

from __future__ import annotations

import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from calflow.estimation.registration import registered
from calflow.measurements.measurements import Measurements
from calflow.observations import observations
from calflow.robot.frames import convention_of
from calflow.robot.robot import Robot
from prior_methods.method import Fitted, Predictor, timed

PYBOTICS = """
import sys
import numpy as np
from scipy.optimize import least_squares
from pybotics.optimization import OptimizationHandler, optimize_accuracy
from pybotics.robot import Robot
given = np.load(sys.argv[1])
robot = Robot.from_parameters(given["table"])
robot.world_frame, robot.tool.position = given["world"], given["tool"]
masks = [True] * robot.kinematic_chain.num_parameters, [True] * 3 + [False] * 3, [True] * 6
handler = OptimizationHandler(robot, *masks)
vector = given["vector"]
if not len(vector):
    vector = least_squares(optimize_accuracy, handler.generate_optimization_vector(), x_scale="jac",
                           args=(handler, given["q"], given["xyz"])).x
handler.apply_optimization_vector(vector)
np.savez(sys.argv[2], vector=vector, xyz=[handler.robot.fk(q)[:3, 3] for q in given["q"]])
"""


@dataclass(frozen=True)
class Table:
    """A robot as pybotics states it, in mm: modified DH (alpha, a, theta, d) a joint, the base's frame, the marker's place."""

    table: np.ndarray
    world: np.ndarray
    tool: np.ndarray

    @staticmethod
    def of(robot: Robot, marker: str) -> Table:
        """Restate a robot; DH becomes modified DH by counting a and alpha to the joint after."""
        figures = [joint.frame.figures for joint in robot.joints]
        own = np.array([[f["alpha"], 1e3 * f["a"], f["theta"], 1e3 * f["d"]] for f in figures])
        point = 1e3 * np.array(robot.markers[marker].point)
        if convention_of([joint.frame for joint in robot.joints]) == "dh":
            alpha, a = own[-1, :2]
            point = Rotation.from_euler("x", alpha).apply(point) + np.array([a, 0.0, 0.0])
            own[:, :2] = np.vstack([[0, 0], own[:-1, :2]])
        world = np.eye(4)
        world[:3, :3] = Rotation.from_euler("XYZ", robot.base.rotation).as_matrix()
        world[:3, 3] = 1e3 * np.array(robot.base.origin)
        return Table(own, world, point)


@dataclass(frozen=True)
class Pybotics:
    """All modified DH parameters, base and tool by SciPy's least squares, as its handbook does; a marker at a time."""

    python: Path | None
    name: str = "pybotics"

    def lacking(self, train: Measurements) -> str:
        """An interpreter, or a robot that its tables can state."""
        robot = train.robot
        plain = convention_of([joint.frame for joint in robot.joints]) and not robot.loop and not robot.couplings
        if not plain:
            return "states DH chains only"
        return "" if self.python else "no interpreter given (--pybotics)"

    @timed
    def fit(self, train: Measurements) -> Predictor:
        """Fit each marker's rows."""
        robot, _ = registered(train.robot, observations(train), train)
        tables = {marker: Table.of(robot, marker) for marker in train.table["marker"].unique()}
        vectors = {
            marker: self._ran(table, train.only((train.table["marker"] == marker).to_numpy()), np.zeros(0))["vector"]
            for marker, table in tables.items()
        }

        def positions(rows: Measurements) -> np.ndarray:
            found = np.full((len(rows), 3), np.nan)
            for marker, table in tables.items():
                own = (rows.table["marker"] == marker).to_numpy()
                found[own] = self._ran(table, rows.only(own), vectors[marker])["xyz"] / 1e3
            return found

        return positions

    def _ran(self, table: Table, rows: Measurements, vector: np.ndarray) -> dict[str, np.ndarray]:
        """Run it on rows: a fit where there is no vector of parameters yet, and where each row then is [mm]."""
        signs = [joint.sign for joint in rows.robot.joints]
        with tempfile.TemporaryDirectory() as name:
            given, found = Path(name) / "given.npz", Path(name) / "found.npz"
            q, xyz = rows.joints * signs, 1e3 * rows.position
            np.savez(given, **vars(table), q=q, xyz=xyz, vector=vector)
            subprocess.run([str(self.python), "-c", PYBOTICS, str(given), str(found)], check=True)
            return dict(np.load(found))


@dataclass(frozen=True)
class Figaroh:
    """figaroh reads a URDF; the robots here are stated by DH tables."""

    name: str = "figaroh"

    def lacking(self, train: Measurements) -> str:
        """The robot in its format."""
        return "reads URDF alone, and the study states a DH table"

    def fit(self, train: Measurements) -> Fitted:
        """Never asked for."""
        raise NotImplementedError(self.lacking(train))
