"""What the robot touches, or a wire's anchor, that is knocked once."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import calflow as cf
from first_steps import ARM, FIRST_STEPS, touching

KNOCK = np.array([4e-4, -4e-4, 0.0])  # m
READINGS = [f"q{k}_deg" for k in range(1, 7)]


def lengths(rng: np.random.Generator) -> pd.DataFrame:
    """Lengths of a wire whose anchor is knocked after 70 of 140 rows."""
    q = rng.uniform(ARM["LOW"], ARM["HIGH"], (140, 6))
    anchor = np.array([1.9, 0.3, -0.2]) + (np.arange(140) >= 70)[:, None] * 2 * KNOCK
    length = np.linalg.norm(ARM["ball"](q) - anchor, axis=1) + rng.normal(0, 5e-5, 140)
    return pd.DataFrame(np.degrees(q), columns=READINGS).assign(length_mm=1e3 * length)


def touches(rng: np.random.Generator) -> pd.DataFrame:
    """Touches of two sockets in four places; the second pair slides after half of its touches, 36 of all."""
    places = np.array([(0.75, -0.2, 0.3), (0.65, 0.35, 0.55), (-0.1, 0.8, 0.45), (0.35, -0.7, 0.85)])
    placement, touch = np.repeat([1, 2, 3, 4], 24), np.tile(np.arange(24), 4)
    right, slid = touch % 2 == 1, (placement == 2) & (touch >= 12)
    at = places[placement - 1] + np.outer(right, ARM["BESIDE"]) + np.outer(slid, KNOCK) + rng.normal(0, 3e-5, (96, 3))
    named = {"placement": placement.astype(str), "socket": np.where(right, "right", "left")}
    return pd.DataFrame(named | dict(zip(READINGS, np.degrees(touching(at, rng)).T, strict=True)))


def test_what_is_touched_may_be_knocked(tmp_path):
    """Fails if a pair of sockets that moved once is missed, or taken for joints whose zeros jumped."""
    assert_knocked(tmp_path, "sockets", touches, 36)


def first_steps(tmp_path) -> Path:
    """A copy of the first steps' studies that are fitted from one start."""
    folder = Path(shutil.copytree(FIRST_STEPS, tmp_path / "study"))
    for study in ("wire.toml", "sockets.toml"):
        with (folder / study).open("a", encoding="utf-8") as file:
            file.write("\n[stages.identify]\nstarts = 1\n")
    return folder


def assert_knocked(tmp_path, study: str, rows: Callable[[np.random.Generator], pd.DataFrame], moment: int) -> None:
    """What was knocked is told alone, at its moment and as far as it moved; benchmarks/slow has a wire's anchor."""
    folder = first_steps(tmp_path)
    rows(np.random.default_rng(1)).to_csv(folder / f"{study}.csv", index=False)
    found = cf.run(cf.load_study(folder / f"{study}.toml"), tmp_path / "run").tables["diagnose/findings.csv"]
    step = found[found["cause"] == "frame-step"].iloc[0]
    assert step["status"] == "named", found["statement"].tolist()
    assert not (found["cause"] == "joint-step").any(), found["statement"].tolist()
    assert abs(int(step["detail"].split()[2]) - moment) <= 3, step["detail"]
    assert step["estimate"] == pytest.approx(np.linalg.norm(KNOCK) * (2 if study == "wire" else 1), abs=4 * step["sd"])
