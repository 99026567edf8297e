"""A small study on disk, identified, with made-up tables of select and sample, for the report's tests."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np
import pandas as pd

from calflow.model import build
from calflow.robot.description import read_robot
from calflow.stages.candidates import candidates
from calflow.stages.identify import STAGE as IDENTIFY
from calflow.stages.stage import Context
from calflow.study import load_study

ROBOT = """
name = "Arm *3* #1"
convention = "modified-dh"
[[joints]]
d_m = 0.8
limits_deg = [-120, 120]
mass_kg = 200
[[joints]]
alpha_deg = -90
limits_deg = [-100, 40]
mass_kg = 120
com_m = [0.5, 0.0, 0.0]
[[joints]]
a_m = 1.0
limits_deg = [-90, 90]
mass_kg = 80
com_m = [0.4, 0.0, 0.1]
{payload}
"""
PAYLOAD = """
[payloads."grip_$ {5 kg}"]
mass_kg = 100
com_m = [0.9, 0.0, 0.1]
"""
STUDY = """
name = "small"
title = 'Arm_1 *bold* #let $x^2$ @ref <label> "quoted" \\\\ [x] // end'
robot = "robot.toml"
workflow = "{workflow}"
seed = 3
effects = ["geometry"{compliance}]
[measurements]
file = "measured.csv"
{sigma}
[split]
holdout = {holdout}
"""
SIGMA = 5e-5  # m


@dataclass(frozen=True)
class Case:
    """What may differ between small studies."""

    poses: int = 40
    repeats: int = 1
    markers: tuple[str, ...] = ("T_*a*$#@<b>",)
    payload: bool = True
    stated: bool = True
    holdout: float = 0.3
    oriented: bool = False


def context(folder: Path, case: Case = Case()) -> Context:
    """Write the study, run identify on it, and return the context that the report is given."""
    study = load_study(_write(folder, case))
    given = Context(
        study, IDENTIFY.settings(starts=1), {}, folder, folder / "run", lambda line: None, lambda share: None
    )
    return replace(given, tables=IDENTIFY.run(given), settings=None)


def with_select(given: Context) -> Context:
    """The context with tables as the stage select makes them."""
    n = np.arange(8, 31, 2)
    worth = pd.DataFrame({"n_poses": n, **{f"O{i}": i * np.sqrt(n) for i in range(1, 6)}, "expected_sd_mm": 0.5 / n})
    poses = pd.DataFrame(np.random.default_rng(1).uniform(-90, 90, (30, 3)), columns=["q1_deg", "q2_deg", "q3_deg"])
    poses.insert(0, "pose", np.arange(1, 31))
    for i, axis in enumerate("xyz"):
        poses[f"nominal_{axis}_mm"] = 1000 * np.cos(np.deg2rad(poses[f"q{i + 1}_deg"]))
    poses["marker"], poses["payload"] = given.study.robot.n_joints, np.nan  # what a CSV without payloads reads as
    return replace(given, tables={**given.tables, "select/poses.csv": poses, "select/observability.csv": worth})


def with_sample(given: Context, steps: int = 40) -> Context:
    """The context with tables as the stage sample makes them, and a chain of independent draws."""
    parameters = given.tables["identify/parameters.csv"]
    n = len(parameters) + 1
    path = given.run_folder / "sample" / "chain.h5"
    path.parent.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(2)
    with h5py.File(path, "w") as file:
        for e in range(4):
            group = file.create_group(f"ensemble{e + 1}")
            group["chain"] = rng.standard_normal((steps, 2 * n, n))
            group.attrs["iteration"] = steps
    names = [*parameters["parameter"], "noise.factor"]
    centre, sd = [*parameters["estimate"], 1.0], [*parameters["sd"].fillna(1e-6), 0.05]
    posterior = pd.DataFrame({"parameter": names, "unit": [*parameters["unit"], "1"], "mean": centre, "sd": sd})
    for name, shift in (("q025", -2.0), ("q500", 0.0), ("q975", 2.0)):
        posterior[name] = np.array(centre) + shift * np.array(sd)
    posterior = posterior.assign(rhat=1.001, ess=5000.0 + np.arange(n))
    residuals = given.tables["identify/residuals.csv"]
    error = np.linalg.norm(residuals[["dx_mm", "dy_mm", "dz_mm"]], axis=1)
    predictive = residuals[["pose", "repeat", "marker", "split"]].assign(
        error_mm=error, expected_mm=0.08, low_mm=0.0, high_mm=1.1 * error.max(), covered=True, heldout_coverage=1.0
    )
    summary = pd.DataFrame(
        [
            ("steps", steps),
            ("burn_in_steps", int(steps) // 4),
            ("autocorrelation_steps", "2"),
            ("ensembles", f"4 of {2 * n} walkers"),
            ("length", "long enough"),
        ],
        columns=["item", "value"],
    )
    names = ("posterior", "predictive", "summary")
    made = {f"sample/{name}.csv": table for name, table in zip(names, (posterior, predictive, summary), strict=True)}
    return replace(given, tables={**given.tables, **made})


def changed(given: Context, path: str, **columns: object) -> Context:
    """The context with columns of one table replaced."""
    return replace(given, tables={**given.tables, path: given.tables[path].assign(**columns)})


def _write(folder: Path, case: Case) -> Path:
    markers = "".join(
        f"[markers.{name!r}]\npoint_m = [{0.9 + 0.1 * k}, 0.1, {0.05 * k}]\n" for k, name in enumerate(case.markers)
    )
    turned = "tool_rotation_deg = [0, 0, 0]\n" if case.oriented else ""
    (folder / "robot.toml").write_text(turned + ROBOT.format(payload=PAYLOAD * case.payload) + markers)
    (folder / "study.toml").write_text(
        STUDY.format(
            workflow="paper-table",
            compliance=', "joint-compliance"' * case.payload,
            sigma=f"sigma_m = {SIGMA}" * case.stated + f"\nsigma_rotation_rad = {SIGMA}" * case.oriented,
            holdout=case.holdout,
        )
    )
    _measure(folder, case).to_csv(folder / "measured.csv", index=False)
    return folder / "study.toml"


def _measure(folder: Path, case: Case) -> pd.DataFrame:
    robot = read_robot(folder / "robot.toml")
    model = build(robot, ("geometry", "joint-compliance") if case.payload else ("geometry",))
    rng = np.random.default_rng(0)
    truth = np.clip(0.3 * model.prior_sd * rng.standard_normal(len(model.nominal)), *model.bounds.T)
    payload = next(iter(robot.payloads), "")
    blocks = []
    for marker in case.markers:
        readings, rows = candidates(model, case.poses, payload, marker, None, np.random.default_rng(7))
        exact, rotation = model.position(truth, rows), model.rotation(truth, rows)
        for repeat in range(1, case.repeats + 1):
            block = pd.DataFrame(readings, columns=["q1_rad", "q2_rad", "q3_rad"])
            block[["x_m", "y_m", "z_m"]] = exact + SIGMA * rng.standard_normal(exact.shape)
            if case.oriented:
                block[["rx_rad", "ry_rad", "rz_rad"]] = _angles(rotation)
            blocks.append(block.assign(pose=np.arange(case.poses), repeat=repeat, marker=marker))
    table = pd.concat(blocks, ignore_index=True)
    return table.assign(payload=payload) if payload else table


def _angles(rotation: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(rotation).as_euler("XYZ")
