"""Write measurements.csv: where the UR5 went is its target minus the difference that its files state."""

from __future__ import annotations

import os
from pathlib import Path

import pandas as pd

SPLITS = {"grid": "train", "random": "holdout"}


def main() -> None:
    """Write the file beside this one."""
    parts = [converted(Path(os.environ["CALFLOW_DATA"]) / "ur5" / f"{name}.csv", name) for name in SPLITS]
    pd.concat(parts).to_csv(Path(__file__).with_name("measurements.csv"), index=False)


def converted(path: Path, name: str) -> pd.DataFrame:
    """The rows of one of the two files, in their order."""
    given = pd.read_csv(path).sort_values("step_order")
    rows = {"pose": [f"{name}{step}" for step in given["step_order"]]}
    rows |= {f"q{i}_deg": given[f"joint_{i}"] for i in range(1, 7)}
    rows |= {f"{axis}_mm": given[f"{axis}_t"] - given[f"{axis}_dif"] for axis in "xyz"}
    return pd.DataFrame(rows).assign(session=name, split=SPLITS[name])


if __name__ == "__main__":
    main()
