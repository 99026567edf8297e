"""What was identified of every robot, read from the run folders."""

from __future__ import annotations

import numpy as np
import pandas as pd

from calflow.fleet.collected import collected
from calflow.fleet.fleet import load_fleet
from calflow.fleet.fleet_folder import FleetFolder
from calflow.fleet.work import work
from fleet.plant import broken


def test_parameters_and_covariances_are_those_of_the_runs(plant):
    """Fails if a figure is another robot's or stands in another order, or a robot that failed is made up."""
    broken(plant, "B-2")
    fleet, folder = load_fleet(plant.file), FleetFolder(plant.out)
    work(fleet, folder, ["C-3", "B-2", "A-1"])
    found = list(collected(fleet, folder))
    assert [(one.robot, one.type) for one in found] == [("A-1", "small"), ("C-3", "small")]
    assert found[0].names == found[1].names
    for one in found:
        table = pd.read_csv(folder.run(one.robot) / "identify" / "parameters.csv")
        assert one.names == tuple(table["parameter"])
        np.testing.assert_array_equal(one.estimate, table["estimate"])
        kept = pd.read_csv(folder.run(one.robot) / "identify" / "covariance.csv").set_index("parameter")
        np.testing.assert_array_equal(one.covariance, kept.loc[list(one.names), list(one.names)])
    assert not np.array_equal(found[0].estimate, found[1].estimate)
