"""Reliability of names and sizes: whether stated probabilities of causes come true, and what intervals of their sizes cover.

    python benchmarks/blind.py effects 300 --seed 1 --out effects.csv
    python benchmarks/reliability.py effects.csv [MORE.csv ...] --out reliability.svg

Reads the cases of `blind.py`, whose causes a simulator apart from calflow hid: of every first finding the probability that was
stated, whether it is the cause, and by how many standard deviations its size is off. Cases count where something was found.
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from scipy.stats import beta, norm

BINS = (0.0, 0.5, 0.7, 0.9, 0.99, 1.0)
LEVELS = (0.5, 0.9, 0.95)


def share(right: pd.Series) -> tuple[float, float, float]:
    """Share of cases that are right, with its 95 % interval (Jeffreys; to the end where all are alike)."""
    n, k = len(right), float(right.sum())
    low, high = beta(k + 0.5, n - k + 0.5).ppf([0.025, 0.975])
    return k / n, float(low) if k else 0.0, float(high) if k < n else 1.0


def reliability(cases: pd.DataFrame) -> pd.DataFrame:
    """Stated probabilities by bins, and how often they came true, exactly and up to a class of causes that look alike."""
    rows = []
    for low, high in pairwise(BINS):
        own = cases[(cases["probability"] > low) & (cases["probability"] <= high)]
        if len(own):
            exactly, least, most = share(own["right"])
            rows.append({"above": low, "cases": len(own), "stated": own["probability"].mean(), "right": exactly, "low": least,
                         "high": most, "up_to_class": own["up_to_class"].mean()})  # fmt: skip
    return pd.DataFrame(rows)


def coverage(z: pd.Series) -> pd.DataFrame:
    """Share of sizes within intervals of some levels."""
    rows = [(level, *share(z.abs() < norm.ppf(0.5 + level / 2))) for level in LEVELS]
    return pd.DataFrame(rows, columns=["level", "covered", "low", "high"])


def drawn(table: pd.DataFrame, path: Path) -> None:
    """The reliability diagram: a point a bin, on the diagonal where probabilities are right."""
    figure, axes = plt.subplots(figsize=(4, 4), layout="constrained")
    axes.plot([0, 1], [0, 1], color="0.6", linewidth=1)
    axes.errorbar(
        table["stated"],
        table["right"],
        [table["right"] - table["low"], table["high"] - table["right"]],
        fmt="ko",
        capsize=3,
    )
    axes.set(
        xlabel="stated probability of the first name",
        ylabel="share that is right, 95 % interval",
        xlim=(0, 1.02),
        ylim=(0, 1.02),
    )
    figure.savefig(path)


def main() -> None:
    """Read the cases and print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, help="the reliability diagram")
    asked = parser.parse_args()
    cases = pd.concat([pd.read_csv(file) for file in asked.files], ignore_index=True)
    found = cases[cases["detected"].eq(True)].astype({"right": float, "up_to_class": float})
    table = reliability(found.dropna(subset=["probability"]))
    brier = float(np.mean((found["probability"] - found["right"]) ** 2))
    print(f"{len(found)} of {len(cases)} found; stated {found['probability'].mean():.3f}, right {found['right'].mean():.3f}, "
          f"up to class {found['up_to_class'].mean():.3f}, Brier score {brier:.3f}")  # fmt: skip
    print(table.round(3).to_string(index=False))
    print(coverage(found["z"].dropna()).round(3).to_string(index=False))
    if asked.out:
        drawn(table, asked.out)


if __name__ == "__main__":
    main()
