"""Programs of others, each in an environment of its own: pybotics and figaroh."""

from __future__ import annotations

import resource
import signal
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from calflow.estimation.registration import registered
from calflow.measurements.measurements import Measurements
from calflow.observations import observations
from calflow.robot.formats.rigid_chain import rigid_chain, urdf_text
from calflow.robot.frames import convention_of
from calflow.robot.robot import Robot
from prior_methods.method import Predictor, timed

MOST_SECONDS = 120  # of the processor, for one marker of one split
MOST_TURNS = 15  # of a fit: directions that base and tool share keep both going for minutes
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
                           max_nfev=int(sys.argv[3]), args=(handler, given["q"], given["xyz"])).x
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
            _run(self.python, PYBOTICS, given, found, MOST_TURNS)
            return dict(np.load(found))


FIGAROH = """
import logging, sys
import numpy as np
import pinocchio as pin
from scipy.optimize import least_squares
import figaroh.calibration.base_calibration as own
from figaroh.calibration.base_calibration import BaseCalibration
from figaroh.calibration.calibration_tools import calc_updated_fkm
from figaroh.tools.robot import Robot
logging.disable(logging.CRITICAL)

class Calibration(BaseCalibration):
    def cost_function(self, var):
        found = calc_updated_fkm(self.model, self.data, var, self.q_measured, self.calib_config)
        return self.apply_measurement_weighting(
            self._compute_logmap_residuals(self.PEE_measured, found, position_frame="world"), pos_weight=1000.0)

own.least_squares = lambda *given, **how: least_squares(*given, **how | {"max_nfev": int(sys.argv[2])})
folder = sys.argv[1]
given = np.load(folder + "/given.npz")
calibration = Calibration(Robot(folder + "/robot.urdf", folder), folder + "/config.yaml")
if len(given["names"]):
    calibration.load_data_set()
    names, var = list(given["names"]), given["var"]
    calibration.calib_config["param_name"] = names
else:
    calibration.calib_config |= {"known_baseframe": False, "known_tipframe": False}
    calibration.initialize()
    var = calibration.solve(enable_logging=False, outlier_threshold=1.0).x
    names = list(calibration.calib_config["param_name"])
found = calc_updated_fkm(calibration.model, calibration.data, var, calibration.q_measured, calibration.calib_config)
np.savez(folder + "/found.npz", names=names, var=var, xyz=np.reshape(found, (3, -1)).T)
"""
FIGAROH_CONFIG = """\
extends: ""
robot:
  name: robot
tasks:
  calibration:
    enabled: true
    type: kinematic_calibration
    kinematics:
      base_frame: measuring_frame
      tool_frame: marker_{marker}
    parameters:
      calibration_level: full_params
    measurements:
      markers:
        - measurable_dof: [true, true, true, false, false, false]
      poses:
        base_pose: null
        tool_pose: null
    data:
      number_of_samples: {rows}
      source_file: {folder}/rows.csv
"""


@dataclass(frozen=True)
class Figaroh:
    """All parameters that its own analysis keeps, base and tool, from a URDF that calflow wrote; a marker at a time."""

    python: Path | None
    name: str = "figaroh"

    def lacking(self, train: Measurements) -> str:
        """An interpreter."""
        return "" if self.python else "no interpreter given (--figaroh)"

    @timed
    def fit(self, train: Measurements) -> Predictor:
        """Fit each marker's rows."""
        robot, _ = registered(train.robot, observations(train), train)
        none = {"names": np.zeros(0), "var": np.zeros(0)}
        fits = {
            marker: self._ran(robot, marker, train.only((train.table["marker"] == marker).to_numpy()), none)
            for marker in train.table["marker"].unique()
        }

        def positions(rows: Measurements) -> np.ndarray:
            found = np.full((len(rows), 3), np.nan)
            for marker, known in fits.items():
                own = (rows.table["marker"] == marker).to_numpy()
                found[own] = self._ran(robot, marker, rows.only(own), known)["xyz"]
            return found

        return positions

    def _ran(
        self, robot: Robot, marker: str, rows: Measurements, known: dict[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Run it on rows: a fit where no parameters are known yet, and where each row then is [m]."""
        chain = rigid_chain(robot)
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            (folder / "robot.urdf").write_text(urdf_text(chain, "for figaroh"), encoding="utf-8")
            config = FIGAROH_CONFIG.format(marker=marker, rows=len(rows), folder=folder)
            (folder / "config.yaml").write_text(config, encoding="utf-8")
            table = pd.DataFrame(rows.joints, columns=[joint.name for joint in chain.joints])
            table[["x1", "y1", "z1"]] = rows.position
            table.to_csv(folder / "rows.csv", index=False)
            np.savez(folder / "given.npz", names=known["names"], var=known["var"])
            _run(self.python, FIGAROH, folder, MOST_TURNS)
            return dict(np.load(folder / "found.npz"))


def _run(python: Path | None, script: str, *arguments: Path | int) -> None:
    """Run a script by another interpreter.

    Raises:
        RuntimeError: with the last line that it said, or that it took too long.
    """
    command = [str(python), "-c", script, *map(str, arguments)]
    told = subprocess.run(command, capture_output=True, text=True, preexec_fn=_limited)
    if told.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        raise RuntimeError(f"not done after {MOST_SECONDS} s of the processor")
    if told.returncode:
        raise RuntimeError((told.stderr.strip().splitlines() or ["said nothing"])[-1])


def _limited() -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (MOST_SECONDS, MOST_SECONDS + 1))
