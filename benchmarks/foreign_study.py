"""Studies of the arms of foreign_physics: their files as a user writes them, and what calflow makes of them in one process."""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from foreign_physics import PAYLOADS, Arm, Array, Rows
from real_data import CELSIUS

import calflow as cf
from calflow.deployment.prediction import Prediction, predict_rows

MARKERS = "ABC"


def write_study(
    folder: Path, arm: Arm, rows: Rows, seen: Array, *, sigma: float | None = None, columns: Collection[str] = ("approach",),
    masses: bool = True, effects: Sequence[str] = ("geometry", "joint-compliance"), holdout: float = 0.2,
) -> None:  # fmt: skip
    """Write robot file, study and measurements of points seen (rows, 3) [m]; sigma [m] where the noise is stated.

    columns may hold approach, travel, time, temperature and session.
    """
    folder.mkdir(parents=True, exist_ok=True)
    markers = int(rows.marker.max()) + 1
    (folder / "robot.toml").write_text(robot_toml(arm, masses, markers), encoding="utf-8")
    lines = [f'name = "{folder.name.lower()}"', 'robot = "robot.toml"', 'workflow = "diagnose"', "seed = 1"]
    lines += [f"effects = {json.dumps(effects)}", "", "[measurements]", 'file = "measurements.csv"']
    lines += [f"sigma_mm = {1e3 * sigma:.6f}"] if sigma else []
    lines += ["", "[split]", f"holdout = {holdout}", ""]
    (folder / "study.toml").write_text("\n".join(lines), encoding="utf-8")
    table = table_of(arm, rows, columns)
    table[["x_mm", "y_mm", "z_mm"]] = np.round(1e3 * seen, 6)
    table.to_csv(folder / "measurements.csv", index=False)


def table_of(arm: Arm, rows: Rows, columns: Collection[str]) -> pd.DataFrame:
    """What is stated of rows beside where they were seen."""

    def of_joints(name: str, values: Array) -> pd.DataFrame:
        units = ["mm" if slide else "deg" for slide in arm.slide]
        scaled = np.where(arm.slide, 1e3 * values, np.rad2deg(values))
        return pd.DataFrame({f"{name}{i + 1}_{unit}": np.round(scaled[:, i], 7) for i, unit in enumerate(units)})

    parts = [pd.DataFrame({"pose": rows.pose + 1}), of_joints("q", rows.q)]
    parts.append(
        pd.DataFrame({"payload": np.array(PAYLOADS)[rows.payload], "marker": np.array(list(MARKERS))[rows.marker]})
    )
    repeat = pd.Series(range(len(rows))).groupby([rows.pose, rows.marker]).cumcount()
    if repeat.any():
        parts.append(pd.DataFrame({"repeat": repeat + 1}))
    if "approach" in columns:
        parts.append(pd.DataFrame({f"approach{i + 1}": rows.side[:, i].astype(int) for i in range(arm.n)}))
    if "travel" in columns:
        parts.append(of_joints("travel", rows.travel))
    given = {"time": ("time_s", np.round(rows.time, 1)), "temperature": ("temperature_degC", rows.temperature),
             "session": ("session", np.array(["first", "second", "third"])[rows.session])}  # fmt: skip
    parts += [pd.DataFrame({name: values}) for column, (name, values) in given.items() if column in columns]
    return pd.concat(parts, axis=1)


def robot_toml(arm: Arm, masses: bool, markers: int) -> str:
    """The robot file, as its maker says."""
    turn = np.rad2deg(arm.base.as_euler("XYZ"))  # about x, y and z in turn
    lines = [f'name = "{arm.name}"', 'convention = "modified-dh"', ""]
    lines += ["[base]", f"origin_m = {_list(arm.origin)}", f"rotation_deg = {_list(turn)}"]
    for i in range(arm.n):
        lines += ["", "[[joints]]", f"alpha_rad = {arm.alpha[i]:.12g}", f"a_m = {arm.a[i]:.12g}", f"d_m = {arm.d[i]:.12g}",
                  f"theta_rad = {arm.theta[i]:.12g}"]  # fmt: skip
        limits = _list(arm.limits[i])
        slide, turning = (
            ['kind = "prismatic"', f"limits_m = {limits}"],
            [f"limits_rad = {limits}", f"gear_ratio = {arm.gear[i]}"],
        )
        lines += slide if arm.slide[i] else turning
        lines += [f"mass_kg = {arm.mass[i]}", f"com_m = {_list(arm.com[i])}"] if masses else []
    for name, mass, com in zip(PAYLOADS, arm.payload_mass, arm.payload_com, strict=True):
        known = mass if masses or mass == 0 else '"unknown"'
        lines += ["", f"[payloads.{name}]", f"mass_kg = {known}", f"com_m = {_list(com)}"]
    for name, point in zip(MARKERS[:markers], arm.markers, strict=False):
        lines += ["", f"[markers.{name}]", f"point_m = {_list(point)}"]
    return "\n".join(lines) + "\n"


def _list(values: Array) -> str:
    return "[" + ", ".join(f"{value:.12g}" for value in values) + "]"


def identified(folder: Path) -> cf.Calibration:
    """What calflow identifies by a study, in this process."""
    study = cf.load_study(folder / "study.toml")
    return cf.identify(study.robot, study.measurements(), study.file.effects, starts=1, seed=study.file.seed)


def names_of(calibration: cf.Calibration) -> pd.DataFrame:
    """The findings that name a cause, or one of several: noise that grows with range is none."""
    found = calibration.findings.table
    return found[found["status"].isin(["named", "one_of"]) & (found["cause"] != "range-noise")].reset_index(drop=True)


def rivals_of(finding: pd.Series) -> list[tuple[str, int]]:
    """What else a finding may be: causes and their joints (0: none)."""
    causes, joints = (str(finding[name]).split(";") if pd.notna(finding[name]) and finding[name] != "" else []
                      for name in ("rival_causes", "rival_joints"))  # fmt: skip
    return [(cause, int(float(joint))) for cause, joint in zip(causes, joints, strict=True)]


def joint_of(finding: pd.Series) -> int:
    """A finding's joint or link; 0: none."""
    return 0 if pd.isna(finding["joint"]) else int(finding["joint"])


def rows_there(calibration: cf.Calibration, rows: Rows, *, timed: bool = False) -> cf.Measurements:
    """Rows to be predicted, with all that is known of them."""
    more = (
        {"time": rows.time, "temperature": rows.temperature + CELSIUS, "time_origin": calibration.time_origin}
        if timed
        else {}
    )
    return cf.Measurements.from_arrays(
        calibration.model.robot, rows.q, None, pose=rows.pose, payload=[PAYLOADS[k] for k in rows.payload],
        marker=[MARKERS[k] for k in rows.marker], approach=rows.side, travel=rows.travel, **more,
    )  # fmt: skip


def predicted(calibration: cf.Calibration, rows: Rows, *, timed: bool = False) -> Prediction:
    """Where a calibration says that rows are; what it would need besides widens its intervals."""
    return predict_rows(calibration, rows_there(calibration, rows, timed=timed), "widen")
