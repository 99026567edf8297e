"""A study of a kind of observation that another package brings, with data that other code than calflow's made."""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from conftest import SMALL, Folder
from hidden.causes import Hidden, response
from hidden.simulator import Array, Frames, Robot, Rows, equilibrium, read, tool_point, worn
from plugin import install

COMPLIANCE = (2e-6, 2e-6, 3e-6)  # rad/Nm
ALIKE = ("joint-eccentricity", "periodic-joint-error", "joint-error-map")  # an eccentricity, and what may pass for one
EVERY_STAGE = ("select", "identify", "diagnose", "sample", "report")
LIMITS = np.deg2rad([[-170, 170], [-100, 40], [-20, 140]])


@dataclass(frozen=True)
class Simulated:
    """A worn robot's rows: joint readings (n, 3) [rad], payloads, frames, and where the marker is (n, 3) [m]."""

    robot: Robot
    nominal: Robot
    rows: Rows
    found: Frames
    point: Array


def simulated(poses: int, seed: int, *hidden: Hidden) -> Simulated:
    """Move a worn robot that stands level at the origin through random poses, with causes that nobody told of."""
    rng = np.random.default_rng(seed)
    nominal = read(tomllib.loads(SMALL["robot.toml"]), np.array(COMPLIANCE))
    robot = replace(worn(nominal, rng), base=np.eye(4))
    q = rng.uniform(*LIMITS.T, (poses, 3))
    still, order = np.zeros((poses, 3)), np.arange(poses, dtype=float)
    rows = Rows(
        q, rng.integers(0, 2, poses), np.zeros(poses, dtype=int), still, still, still, order, 293.15 + 0 * order
    )
    motion, state = equilibrium(robot, rows, lambda state: response(robot, rows, state, hidden))
    return Simulated(robot, nominal, rows, state.frames, tool_point(robot, rows, motion, state.frames.tips[-1]))


def study(
    folder: Folder,
    site: Path,
    kind: type[Any],
    made: Simulated,
    values: pd.DataFrame,
    settings: str,
    stages: Sequence[str] = EVERY_STAGE,
) -> dict[str, str]:
    """Write a study of these values (in the order of the rows), its kind installed as a package; return the environment."""
    source = Path(__file__).parent / f"{kind.__module__.rpartition('.')[2]}.py"
    module = f"another_{source.stem}"
    install(
        site,
        module,
        source.read_text(encoding="utf-8"),
        f"{kind.id} = {module}:{kind.__name__}",
        "calflow.observations",
    )
    readings = pd.DataFrame(np.rad2deg(made.rows.q), columns=["q1_deg", "q2_deg", "q3_deg"])
    payload = np.array(["light", "heavy"])[made.rows.payload]
    folder.measure(pd.concat([readings, values], axis=1).assign(pose=np.arange(1, len(values) + 1), payload=payload))
    folder.edit(
        "study.toml",
        ('file = "measurements.csv"\n', f'file = "measurements.csv"\nkind = "{kind.id}"\n{settings}'),
        ("poses = 8\n", f"poses = 12\n\n[stages.diagnose]\ncatalogue = {json.dumps(ALIKE)}\n"),
    )
    folder.edit("quick.toml", ('["select", "identify", "sample"]', json.dumps(stages)))
    path = os.pathsep.join(filter(None, (str(site), os.environ.get("PYTHONPATH"))))
    return {**os.environ, "PYTHONPATH": path, "PYTHONIOENCODING": "utf-8"}


def said(folder: Folder, environment: dict[str, str], *command: object) -> str:
    """Return what a command prints; it must end well."""
    done = folder.forked("-m", "calflow", *command, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    return done.stdout + done.stderr


@dataclass(frozen=True)
class Found:
    """What a calibration ended in: mean error of the nominal robot and of the final model, and the parameters by name."""

    nominal: float
    left: float
    parameters: pd.DataFrame


def all_the_way(
    folder: Folder, environment: dict[str, str], made: Simulated, odd: int, unit: str, eccentric: float
) -> Found:
    """Check, run every stage and predict; hold all of it against what was hidden, as for `calibrated`."""
    told = said(folder, environment, "check", ".")
    assert f"line {odd + 2} is " in told
    assert f" {unit} off from the fit of all other rows" in told
    assert f" {unit}, max" in told
    assert "nan" not in told
    found = calibrated(folder, environment, made, odd, unit, eccentric)
    posterior = pd.read_csv(folder / "runs" / "sample" / "posterior.csv").set_index("parameter")
    spring = found.parameters.loc["joint2.s"]
    assert posterior.loc["joint2.s", "mean"] == pytest.approx(spring["estimate"], abs=spring["sd"])
    assert len(pd.read_csv(folder / "runs" / "select" / "poses.csv")) == 12
    page = (folder / "runs" / "report.html").read_text(encoding="utf-8")
    assert f"error of what was measured [{unit}]" in page or f" {unit} on average" in page
    assert (folder / "runs" / "report.pdf").stat().st_size > 10_000
    _holds_where_it_predicts(folder, environment, made)
    return found


def calibrated(
    folder: Folder, environment: dict[str, str], made: Simulated, odd: int, unit: str, eccentric: float
) -> Found:
    """Run, and hold what is identified and diagnosed against what was hidden.

    Args:
        folder: of the study.
        environment: in which its kind of observation is installed.
        made: what was simulated.
        odd: the row with a gross error.
        unit: in which errors are told.
        eccentric: the size of the second joint's eccentricity [rad].
    """
    told = said(folder, environment, "run", ".", "--out", "runs")
    assert f"mean {unit}" in told
    assert "calibration reduces the error from" in told
    assert "eccentricity of joint 2" in told

    def table(name: str) -> pd.DataFrame:
        return pd.read_csv(folder / "runs" / f"{name}.csv")

    faults = table("identify/faults")
    assert faults["row"].tolist() == [odd + 1]
    finding = table("diagnose/findings").set_index("cause").loc["joint-eccentricity"]
    assert finding["joint"] == 2
    assert abs(finding["estimate"] - eccentric) < 3 * finding["sd"]
    assert (finding["error_unit"], finding["gain_low"] > 0, pd.isna(finding["gain_mean_mm"])) == (unit, True, True)
    accuracy = table("diagnose/accuracy")
    assert set(accuracy["unit"]) == {unit}
    assert accuracy["mean_mm"].isna().all()
    residuals = table("identify/residuals")
    assert set(residuals["unit"]) == {unit}
    parameters = table("diagnose/parameters").set_index("parameter")
    for joint in (2, 3):
        own = parameters.loc[f"joint{joint}.s"]
        assert abs(own["estimate"] - made.robot.compliance[joint - 1]) < 3 * own["sd"]
    judged = accuracy[accuracy["split"] == "holdout"]
    return Found(float(judged["mean"].iloc[0]), float(judged["mean"].iloc[-1]), parameters)


def _holds_where_it_predicts(folder: Folder, environment: dict[str, str], made: Simulated) -> None:
    """Predicted positions err by what they promise, in millimetres, although no length was measured."""
    rows = folder.rows
    readings = [name for name in rows if name.startswith("q")]
    rows[[*readings, "payload"]].to_csv(folder / "rows.csv", index=False)
    said(folder, environment, "predict", "runs", "rows.csv", "--out", "predicted.csv")
    predicted = pd.read_csv(folder / "predicted.csv")
    off = predicted[["x_mm", "y_mm", "z_mm"]].to_numpy() - 1e3 * made.point
    sd = predicted[["sd_x_mm", "sd_y_mm", "sd_z_mm"]].to_numpy()
    assert np.isfinite(sd).all()
    assert np.sqrt(np.mean((off / sd) ** 2)) < 2.5
