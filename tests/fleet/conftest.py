"""Plants for tests."""

from __future__ import annotations

import pytest

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

    The first process that calibrates C-3 is killed.
    """
    with without_data() as patch:
        plant = built(tmp_path_factory.mktemp("ran") / "plant", _measured / "measurements.csv")
        broken(plant, "B-2")
        once = f"""if open(os.environ["BEFALLEN"]).read().count(" ") == 1: {KILLED}"""
        befalls(once, "C-3", patch, plant / "befalls")
        return plant, plant.fleet("run", "--cores", 2)
