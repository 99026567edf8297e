"""What identify kept is read back: places where they were, and a noise for every row."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.estimation.calibrated_model import CalibratedModel, SeriesNoise
from calflow.estimation.error_model import ErrorModel
from calflow.estimation.model_tables import observation_table, placed, placement_table
from calflow.estimation.noise import PerUnit
from calflow.files.tables import Results
from calflow.measurements.measurements import Measurements
from calflow.model import Model, build
from calflow.observations import observations
from calflow.robot.parts import Marker
from robots import ASKEW, ur10


def test_a_marker_called_tool_is_not_taken_for_the_tool_s_turn():
    """Fails if a robot whose marker is called as in the template, and whose tool is turned, has its marker at the flange."""
    robot = replace(
        ur10(), base=replace(ASKEW, known=False), tool_rotation=(0.2, 0.7, -0.9),
        markers={"tool": Marker((0.06, -0.02, 0.1), known=False), "B": Marker((0.0, 0.1, 0.2), known=False)},
    )  # fmt: skip
    observed = observations(
        Measurements.from_arrays(robot, np.zeros((2, 6)), np.ones((2, 3)), marker="B", payload="load")
    )
    kept = Results(
        {
            "identify/placement.csv": placement_table(robot, observed),
            "identify/observations.csv": observation_table(observed),
        }
    )
    file = replace(
        robot,
        base=replace(robot.base, origin=(0.0, 0.0, 0.0)),
        markers={name: Marker((0.0, 0.0, 0.1), known=False) for name in robot.markers},
    )
    found = placed(file, kept)
    for name, marker in robot.markers.items():
        np.testing.assert_allclose(found.markers[name].point, marker.point, atol=1e-12)
    np.testing.assert_allclose(found.tool_rotation, robot.tool_rotation, atol=1e-12)
    np.testing.assert_allclose(found.base.rotation, robot.base.rotation, atol=1e-12)


@pytest.mark.parametrize(("source", "expected"), [("file", [2e-5, 7e-5]), ("repeats", [4e-5, 4e-5])])
def test_rows_that_state_no_noise_have_that_of_the_fit(source, expected):
    """Fails if new rows without a column sigma have a noise that is no number, or one that is stated does not count."""
    model = build(ur10(), ())
    known = CalibratedModel(
        model,
        np.zeros(0),
        np.zeros((0, 0)),
        np.zeros(0, bool),
        (SeriesNoise(4e-5, source, 7e-5),),
        PerUnit(),
        "linear",
        ErrorModel.white(PerUnit(), 0),
    )
    rows = Measurements.from_arrays(ur10(), np.zeros((2, 6)), np.ones((2, 3)), payload="load", sigma=[2e-5, 3e-5])
    assert known.noise(rows).sigma[0] == expected[0]
    assert known.noise(replace(rows, table=rows.table.drop(columns="sigma"))).sigma[1] == expected[1]


def test_an_axis_that_only_the_prior_tells_is_untold():
    """Fails if a direction of the tool that no measurement told goes unsaid, or one that was told is doubted."""
    model = build(ur10(), ("geometry",))
    told = np.where([name.startswith("E.") for name in (p.name for p in model.parameters)], 1.0, 1e-3)
    known = CalibratedModel(
        model,
        model.nominal,
        np.diag((told * model.prior_sd) ** 2),
        np.zeros(len(told), bool),
        (SeriesNoise(4e-5, "file", 4e-5),),
        PerUnit(),
        "linear",
        ErrorModel.white(PerUnit(), len(told)),
    )
    upright = Measurements.from_arrays(ur10(), np.zeros((3, 6)), np.ones((3, 3)), payload="load").conditions
    assert (known.untold(Model.point_jacobian, upright) > 0.5).all()
    sure = replace(known, covariance=np.diag((1e-3 * model.prior_sd) ** 2))
    assert (sure.untold(Model.point_jacobian, upright) == 0).all()
