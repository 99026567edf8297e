"""Every stage with what is no position: sockets alone, and several devices together; benchmarks/slow has a wire alone."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calflow.robot.robot import Robot
from conftest import Folder
from hidden.devices import Arm, Tracker, seen, sockets, wire, written

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")  # what a device does not ask for is no 0/0
ROBOT = Path(__file__).parents[2] / "studies" / "ur10-tmac" / "robot.toml"
ECCENTRIC = 1e-3  # rad, hidden in joint 3
STUDY = """\
name = "mixture"
robot = "robot.toml"
workflow = "quick.toml"
seed = 3
effects = ["geometry"]
"""
QUICK = """\
name = "quick"
stages = STAGES

[settings.select]
poses = 40
candidates = 100

[settings.identify]
starts = 1

[settings.diagnose]
catalogue = ["joint-eccentricity", "joint-backlash", "gear-ratio-error", "joint-step", "link-bending"]

[settings.sample]
max_steps = 50
block = 25
ess = 100
"""
WIRE = """
[[measurements]]
name = "wire"
kind = "distance"
file = "wire.csv"
sigma_mm = 0.05

[measurements.settings]
anchor_mm = [1200, 500, 100]
anchor_known = false
"""
CUPS = """
[[measurements]]
name = "cups"
kind = "same-point"
file = "cups.csv"
sigma_mm = 0.05

[measurements.settings]
distance_mm = 50
place_mm = [600, 200, 300]
"""
STATION = """
[[measurements]]
name = "{0}"
file = "{0}.csv"

[measurements.station]
name = "{0}"

[measurements.noise]
floor_mm = 0.01
growth_um_per_m = 5
angle_arcsec = 1
"""


STAGES = {(WIRE,): ["select", "identify", "diagnose"], (CUPS,): ["select", "identify", "diagnose", "sample"]}
OF_MANY = ["identify", "diagnose"]


@dataclass(frozen=True)
class Eccentric(Arm):
    """A robot whose third joint does not run true."""

    def tool(self, q, marker=0):
        q = np.array(q)
        q[:, 2] += ECCENTRIC * np.cos(q[:, 2])
        return super().tool(q, marker)


@pytest.fixture(scope="module")
def tables():
    """What the devices report, an outlier in each."""
    rng = np.random.default_rng(1)
    drawn = Arm.drawn(Robot.from_toml(ROBOT), rng)
    arm = Eccentric(drawn.robot, drawn.figures)
    point = np.array([0.6, 0.2, 0.3])
    q = arm.random(60, rng)
    stations = {"A": np.array([3, 0.2, 0.4, 0, 0, 1.0]), "B": np.array([-2, 2.5, 0.4, 0.02, -0.01, -2.0])}
    found = {name: seen(arm, q[k * 20 :][:40], Tracker(at), rng) for k, (name, at) in enumerate(stations.items())}
    found["wire"] = wire(arm, arm.random(120, rng), np.array([1.2, 0.5, 0.1]), 5e-5, rng)
    found["cups"] = sockets(arm, {"a": point, "b": point + np.array([0.03, 0.04, 0.0])}, 45, 5e-5, rng)
    found["wire"].loc[17, "length"] += 0.02
    found["cups"].loc[33, "q2"] += 0.02
    found["B"].loc[7, "y"] += 0.02
    return found


@pytest.fixture
def study(tables, tmp_path):
    """Write a study with some of the series."""

    def write(*series: str) -> Folder:
        shutil.copy(ROBOT, tmp_path / "robot.toml")
        (tmp_path / "quick.toml").write_text(QUICK.replace("STAGES", json.dumps(STAGES.get(series, OF_MANY))))
        (tmp_path / "study.toml").write_text(STUDY + "".join(series))
        for name, table in tables.items():
            written(table).to_csv(tmp_path / f"{name}.csv", index=False)
        return Folder(tmp_path)

    return write


def finished(folder: Folder) -> dict[str, pd.DataFrame]:
    """Run all stages; the tables."""
    checked = folder.calflow("check")
    assert checked.code == 0, checked
    answer = folder.calflow("run")
    assert answer.code == 0, answer
    names = ("identify/faults", "identify/residuals", "identify/accuracy", "diagnose/findings", "diagnose/accuracy")
    found = {name: pd.read_csv(folder / "runs" / f"{name}.csv") for name in names}
    assert (found["identify/residuals"]["error_mm"] >= 0).all()
    return found


def eccentricity_found(found: dict[str, pd.DataFrame]) -> bool:
    """Whether the eccentricity of joint 3 is named, with its size."""
    causes = found["diagnose/findings"].query("status in ('named', 'one_of')")
    own = causes[(causes["cause"] == "joint-eccentricity") & (causes["joint"] == 3)]
    told = (own["probability"] > 0.95) & (own["rival_causes"].astype(object).fillna("") == "")
    return len(causes) == told.sum() == 1 and abs(own["estimate"].iloc[0] - ECCENTRIC) < 4 * own["sd"].iloc[0]


def lines_at_fault(found: dict[str, pd.DataFrame]) -> set[int]:
    """Lines that were left out."""
    return set(found["identify/faults"]["line"].dropna().astype(int))


def test_two_stations_sockets_and_a_wire(study):
    """Fails if several devices cannot be mixed, a fault is told without its file, or their causes are not added up."""
    folder = study(STATION.format("A"), STATION.format("B"), CUPS, WIRE)
    found = finished(folder)
    assert lines_at_fault(found) == {9, 19, 35}
    assert {"B", "wire", "cups"} == {
        said.partition(" of measurements ")[2].split()[0] for said in found["identify/faults"]["statement"]
    }
    assert eccentricity_found(found)
    summary = json.loads((folder / "runs" / "identify" / "summary.json").read_text())
    assert summary["noise_sources"] == ["file"] * 4


def test_poses_for_what_stands_nobody_knows_where_are_refused(study):
    """Fails if poses are planned for a socket, or a wire, of which nothing says where it is, or nobody is told what to state."""
    folder = study(CUPS.replace("place_mm = [600, 200, 300]\n", ""), WIRE)
    (said,) = folder.refused()
    assert "place_mm" in said
    assert said.startswith("study.toml:")
    folder.edit("quick.toml", ("candidates = 100", 'candidates = 100\nmeasure = "wires"'))
    (said,) = folder.refused()
    assert "did you mean 'wire'" in said
    folder.edit("quick.toml", ('"wires"', '"wire"'))
    assert folder.calflow("check").code == 0
