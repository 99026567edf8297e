"""Newtons beside millimetres: a robot calibrated by a tracker and a spring balance together."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from hidden.causes import Hidden
from observations.newcomer import said, simulated, study
from observations.spring_balance import SpringBalance

NOISE, PULL = 2e-5, 0.2  # m, N
HOOK, STIFFNESS, PRELOAD = (2.5, 0.5, 1.0), 5e3, 7.0  # m, N/m, N
HOOKED_OFF = (0.004, -0.003, 0.002)  # m
TABLES = f"""
[[measurements]]
name = "balance"
kind = "spring-balance"
file = "tensions.csv"
sigma_N = {PULL}

[measurements.settings]
hook_mm = [2500, 500, 1000]
newtons_per_metre = {STIFFNESS:g}
"""


def measured(made) -> tuple[pd.DataFrame, pd.DataFrame]:
    """What the tracker and the balance show of the same poses."""
    rng = np.random.default_rng(8)
    positions = 1e3 * (made.point + NOISE * rng.standard_normal(made.point.shape))
    length = np.linalg.norm(made.point - np.array(HOOK) - HOOKED_OFF, axis=1)
    tension = STIFFNESS * length - PRELOAD + PULL * rng.standard_normal(len(length))
    return pd.DataFrame(positions, columns=["x_mm", "y_mm", "z_mm"]), pd.DataFrame({"tension_N": tension})


@pytest.fixture
def both(small, tmp_path):
    """The study of both, and the environment in which the balance is installed."""
    made = simulated(80, 11, Hidden("joint-eccentricity", 2, 6e-4, 2))
    positions, tensions = measured(made)
    environment = study(
        small, tmp_path / "site", SpringBalance, made, tensions, "", ("select", "identify", "diagnose", "report")
    )
    rows = small.rows
    small.measure(rows, "tensions.csv")
    small.measure(rows.drop(columns="tension_N").join(positions))
    small.edit(
        "study.toml",
        ('[measurements]\nfile = "measurements.csv"\nkind = "spring-balance"\n',
         '[[measurements]]\nfile = "measurements.csv"\nsigma_um = 20\n' + TABLES),
    )  # fmt: skip
    return small, environment, made


def test_newtons_beside_millimetres_go_all_the_way(both):
    """Fails if a unit is taken for the other anywhere between the check and the report, or newtons count as lengths."""
    folder, environment, made = both
    text = said(folder, environment, "check", ".")
    assert " mm, max" in text
    assert "nan" not in text
    said(folder, environment, "run", ".", "--out", "runs")

    def table(name: str) -> pd.DataFrame:
        return pd.read_csv(folder / "runs" / f"{name}.csv")

    residuals = table("identify/residuals")
    assert set(residuals["unit"]) == {"mm", "N"}
    accuracy = table("diagnose/accuracy")
    left = accuracy[accuracy["split"] == "holdout"].groupby("unit").last()["mean"]
    assert left["N"] < 2 * PULL
    assert left["mm"] < 3e3 * NOISE
    assert accuracy.loc[accuracy["unit"] == "N", "mean_mm"].isna().all()
    finding = table("diagnose/findings").set_index("cause").loc["joint-eccentricity"]
    assert finding["joint"] == 2
    parameters = table("diagnose/parameters").set_index("parameter")
    for name, true in zip("xyz", HOOKED_OFF, strict=True):
        own = parameters.loc[f"balance.{name}"]
        assert abs(own["estimate"] - true) < 4 * own["sd"]
    preload = parameters.loc["balance.preload"]
    assert (preload["unit"], abs(preload["estimate"] - PRELOAD) < 4 * preload["sd"]) == ("N", True)
    page = (folder / "runs" / "report.html").read_text(encoding="utf-8")
    assert f"{PULL:g} N per axis" in page
    assert (folder / "runs" / "report.pdf").stat().st_size > 10_000

    rows = folder.rows
    rows[[*(name for name in rows if name.startswith("q")), "payload"]].to_csv(folder / "rows.csv", index=False)
    said(folder, environment, "predict", "runs", "rows.csv", "--out", "predicted.csv")
    predicted = pd.read_csv(folder / "predicted.csv")
    off = predicted[["x_mm", "y_mm", "z_mm"]].to_numpy() - 1e3 * made.point
    sd = predicted[["sd_x_mm", "sd_y_mm", "sd_z_mm"]].to_numpy()
    assert np.sqrt(np.mean((off / sd) ** 2)) < 2.5


def test_a_noise_of_lengths_is_refused_of_forces(both):
    """Fails if a noise in millimetres is taken for one of newtons."""
    folder, environment, _ = both
    folder.edit("study.toml", (f"sigma_N = {PULL}", "sigma_mm = 0.1"))
    done = folder.apart("-m", "calflow", "check", ".", env=environment)
    assert done.returncode == 2
    assert "sigma_N" in done.stdout + done.stderr
    assert "Traceback" not in done.stderr
