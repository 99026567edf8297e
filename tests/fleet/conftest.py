"""Plants for tests."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from calflow.fleet.engine import FleetFolder
from conftest import Folder, without_data
from fleet.plant import KILLED, Plant, befalls, broken, built


@pytest.fixture
def plant(_measured: Folder, tmp_path, monkeypatch) -> Plant:
    """A plant of which nothing was run."""
    monkeypatch.delenv("CALFLOW_DATA", raising=False)
    return built(tmp_path / "plant", _measured / "measurements.csv")


@pytest.fixture(scope="module")
def ran(_measured: Folder, tmp_path_factory) -> tuple[Plant, object]:
    """A plant whose robot B-2 has a misspelt column, run once; and what the command said. Tests leave it as it is.

    A first command was killed as soon as A-1 was calibrated. The first process of the second that calibrates C-3 is killed.
    """
    with without_data() as patch:
        plant = built(tmp_path_factory.mktemp("ran") / "plant", _measured / "measurements.csv")
        broken(plant, "B-2")
        killed_after(plant, "A-1")
        once = f"""if open(os.environ["BEFALLEN"]).read().count(" ") == 1: {KILLED}"""
        befalls(once, "C-3", patch, plant / "befalls")
        return plant, plant.fleet("run", "--cores", 2)


def killed_after(plant: Plant, robot: str) -> None:
    """Run a robot alone, kill the command and all that it began when its outcome is there, and report what there is."""
    outcome = FleetFolder(plant.out).outcome(robot)
    called = [sys.executable, "-m", "calflow", "fleet", "run", plant.file, "--out", plant.out, "--cores", "1"]
    only = ("--", outcome.relative_to(plant.out))
    apart = subprocess.Popen(
        [*called, *only], start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    while not outcome.exists():
        assert apart.poll() is None
        time.sleep(0.02)
    os.killpg(apart.pid, signal.SIGKILL)
    apart.wait()
    assert not (plant.out / "fleet.csv").exists()
    assert plant.fleet("report").code == 0  # of what there is, which is no reason not to go on
