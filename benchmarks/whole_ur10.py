"""The UR10's two measured series diagnosed whole, as their studies ask: causes, held-out errors, and what one tells of the other.

    python benchmarks/whole_ur10.py                   both series
    python benchmarks/whole_ur10.py study.toml        one of them

Needs CALFLOW_DATA. Ends with 1 where a figure is missed. A short version is in tests/test_studies.py.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

STUDIES = Path(__file__).parents[1] / "studies" / "ur10-tmac"
NOMINAL = 1.2  # mm: what the maker's figures miss by, at most
CORRELATION = 0.95  # of joint 3's curve in one series with the other's


@dataclass(frozen=True)
class Asked:
    """Held-out mean errors [mm] at most, of geometry alone and of the extended model; whether the other series confirms."""

    geometry: float
    diagnosed: float
    confirmed: bool


SERIES = {"study.toml": Asked(0.46, 0.080, True), "series_b.toml": Asked(0.41, 0.082, False)}


@dataclass(frozen=True)
class Row:
    """What was looked at, what was found, what was asked for, and whether it holds."""

    what: str
    found: str
    asked: str
    holds: bool

    @staticmethod
    def at_most(what: str, found: float, asked: float) -> Row:
        """A held-out mean error [mm]."""
        return Row(what, f"{found:.4f} mm", f"at most {asked} mm", found <= asked)


def main() -> None:
    """Print one table; end with 1 if a figure is missed."""
    rows = []
    for name in sys.argv[1:] or SERIES:
        with tempfile.TemporaryDirectory() as folder:
            command = [
                sys.executable,
                "-m",
                "calflow",
                "run",
                str(STUDIES / name),
                "--out",
                folder,
                "--stage",
                "diagnose",
            ]
            subprocess.run(command, check=True, stdout=sys.stderr)
            rows += [*errors(name, Path(folder)), *causes(name, Path(folder))]
    print("| what | found | asked | |\n| --- | --- | --- | --- |")
    for row in rows:
        print(f"| {row.what} | {row.found} | {row.asked} | {'' if row.holds else 'missed'} |")
    sys.exit(not all(row.holds for row in rows))


def errors(name: str, folder: Path) -> Iterator[Row]:
    """Held-out mean errors of the maker's figures, of geometry, and of the extended model."""
    asked, steps = SERIES[name], pd.read_csv(folder / "diagnose" / "accuracy.csv")
    means = steps[steps["split"] == "holdout"].set_index("model")["mean_mm"]
    yield Row.at_most(f"{name}, nominal", means["nominal"], NOMINAL)
    yield Row.at_most(f"{name}, geometry", means["geometry"], asked.geometry)
    yield Row.at_most(f"{name}, with what diagnose found", means.iloc[-1], asked.diagnosed)


def causes(name: str, folder: Path) -> Iterator[Row]:
    """Joints whose error maps were found, and what the other series says of them."""
    found = pd.read_csv(folder / "diagnose" / "findings.csv")
    joints = sorted(map(int, found.loc[found["cause"] == "joint-error-map", "joint"]))
    yield Row(f"{name}, joints with an error map", str(joints), "1, 2 and 3", {1, 2, 3} <= set(joints))
    if not SERIES[name].confirmed:
        return
    told = pd.read_csv(folder / "diagnose" / "confirmation.csv").drop_duplicates("joint").set_index("joint")
    alike, words = told.loc[3, "correlation"], str(told.loc[1, "words"])
    yield Row(f"{name}, joint 3 in the other series", f"{alike:.3f}", f"at least {CORRELATION}", alike >= CORRELATION)
    yield Row(f"{name}, joint 1 in the other series", words, "no reading of joint 1", "no reading of joint 1" in words)


if __name__ == "__main__":
    main()
