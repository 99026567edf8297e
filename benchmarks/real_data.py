"""The measured robots that benchmarks share, and their rows as a measurement file has them."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from calflow.measurements.measurements import Measurements

STUDIES = Path(__file__).parents[1] / "studies"
DATA = {
    "ur10-c": STUDIES / "ur10-tmac" / "study.toml",
    "ur10-b": STUDIES / "ur10-tmac" / "series_b.toml",
    "ur5": STUDIES / "ur5" / "study.toml",
    "fanuc": STUDIES / "fanuc-r2000" / "study.toml",
}
CELSIUS = 273.15


def columns(data: Measurements) -> pd.DataFrame:
    """Return the rows as a measurement file has them."""
    table = data.table
    kept = {name: table[name] for name in ("pose", "repeat", "marker", "payload", "split")}
    kept |= {f"q{i}_rad": table[f"q{i}"] for i in range(1, data.robot.n_joints + 1)}
    kept |= {f"{axis}_mm": 1e3 * table[axis] for axis in "xyz"}
    if "temperature" in table:
        kept["temperature_degC"] = table["temperature"] - CELSIUS
    return pd.DataFrame(kept)
