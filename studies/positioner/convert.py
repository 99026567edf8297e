"""Write measurements.csv: the positioner's poses in their order, every third one held out."""

from __future__ import annotations

import os
from pathlib import Path

import pandas as pd


def main() -> None:
    """Write the file beside this one."""
    given = pd.read_csv(Path(os.environ["CALFLOW_DATA"]) / "positioner" / "poses.csv")
    held = given.index % 3 == 2
    given.assign(split=["holdout" if one else "train" for one in held]).to_csv(
        Path(__file__).with_name("measurements.csv"), index=False
    )


if __name__ == "__main__":
    main()
