"""How large the robot is: said to be unknown where nothing but places that nobody knows was touched."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.estimation.fit import fit
from calflow.estimation.identifiability import Statement, left_open
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.noise import Noise
from calflow.estimation.registration import registered
from calflow.files.tables import from_frame
from calflow.measurements.measurements import combined
from calflow.measurements.series import Series
from calflow.model import build
from calflow.observations import observations
from hidden.devices import Arm, Tracker, measured, seen, sockets, wire
from robots import ur10

SIGMA = 5e-5


@pytest.fixture(scope="module")
def rows():
    """A UR10 that errs: touches of two sockets, a wire's lengths and a tracker's positions."""
    rng = np.random.default_rng(1)
    arm = Arm.drawn(ur10(), rng)
    point = np.array([0.6, 0.2, 0.3])
    return arm.robot, {
        "cups": sockets(arm, {"a": point, "b": point + np.array([0.03, 0.04, 0.0])}, 40, SIGMA, rng),
        "wire": wire(arm, arm.random(60, rng), np.array([1.2, 0.5, 0.1]), SIGMA, rng),
        "tracker": seen(arm, arm.random(40, rng), Tracker(np.zeros(6)), rng),
    }


def statements(robot, *series):
    """What a fit of these series leaves open."""
    data = combined([measured(robot, table, one, SIGMA) for table, one in series])
    robot, observed = registered(robot, observations(data), data)
    model = build(robot, ("geometry",), data.given, observed)
    noise = Noise(np.full(len(data), SIGMA), ("file",) * len(series), series=data.series_number)
    found = left_open(fit(LeastSquares.of(model, data.on(robot), noise))[0])
    return [one for one in from_frame(found, Statement) if one.kind == "scale"]


def test_sockets_alone_do_not_say_how_large_the_robot_is(rows):
    """Fails if nobody is told that the size is the robot file's, or the lengths are not named with their proportions."""
    robot, tables = rows
    (said,) = statements(robot, (tables["cups"], Series("cups", "same-point")))
    assert "how large the robot is" in said.statement
    assert set(said.parameters[:2]) == {"joint2.a", "joint3.a"}
    assert said.weights[0] == 1
    assert said.weights[1] == pytest.approx(0.5723 / 0.612, rel=0.01)
    assert not any("same-point" in name or "cups" in name for name in said.parameters)


@pytest.mark.parametrize(
    ("name", "series"),
    [
        ("cups", Series.of("cups", "same-point", {"distance": 0.05})),
        ("wire", Series("wire", "distance")),
        ("tracker", Series("tracker", "position")),
    ],
)
def test_a_known_length_says_how_large_the_robot_is(rows, name, series):
    """Fails if size is called unknown where sockets stand a known distance apart, a wire has a length, or a tracker looks on."""
    robot, tables = rows
    assert not statements(robot, (tables[name], series))


def test_a_wire_beside_the_sockets_says_it(rows):
    """Fails if one series that does not know the size hides that another does."""
    robot, tables = rows
    assert not statements(
        robot, (tables["cups"], Series("cups", "same-point")), (tables["wire"], Series("wire", "distance"))
    )
