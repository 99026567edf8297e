"""A robot by its URDF and by its DH table: the same held-out error, and the same number of directions determined.

python benchmarks/urdf.py ur10.urdf --tip tool0 [--base base_link] (the URDF of the robot of studies/ur10-tmac; CALFLOW_DATA set)
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import calflow as cf

STUDY = Path(__file__).parents[1] / "studies" / "ur10-tmac" / "study.toml"


def main() -> None:
    """Fit series C with both robots and print what differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("urdf")
    parser.add_argument("--tip")
    parser.add_argument("--base")
    asked = parser.parse_args()
    study = cf.load_study(STUDY)
    data, table = study.measurements(), study.robot
    described = cf.Robot.from_urdf(asked.urdf, asked.tip, asked.base, markers=table.markers, base=table.base)
    held = []
    for name, robot in (("DH", table), ("URDF", described)):
        begun = time.process_time()
        fit = cf.identify(robot, replace(data, robot=robot), effects=["geometry"], seed=study.file.seed)
        row = fit.accuracy.table.iloc[-1]
        held.append(row["mean_mm"])
        found = fit.summary
        print(f"{name:5} held out {row['mean_mm']:.6f} mm mean, {row['max_mm']:.6f} max; "
              f"{found.rank} of {found.parameters} determined; {time.process_time() - begun:.1f} s")  # fmt: skip
    print(f"difference of the means: {1e3 * abs(held[1] - held[0]):.4f} um")


if __name__ == "__main__":
    main()
