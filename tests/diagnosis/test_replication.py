"""What one series shows is looked for on another, and the words follow from what is seen."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.replication import confirm, curve
from calflow.effects import catalogue
from calflow.effects.cause import Cause
from calflow.estimation.fit import fit_reweighted
from calflow.model import Model, build
from estimation.data import measured, stated
from robots import industrial

ORDER = 5.0


def series(size, seed):
    """Poses of a robot with a periodic error of joint 1, a third of them held out."""
    robot = industrial()
    cause = Cause(robot, catalogue()["periodic-joint-error"](robot, ORDER), "joint1")
    model = Model(robot, (*build(robot, ("geometry",)).effects, cause))
    truth = model.nominal.copy()
    truth[-2:] = size
    data = measured(model, truth, 90, np.random.default_rng(seed))
    data.table.loc[data.table["pose"] % 3 == 0, "split"] = "holdout"
    return model, cause, data


@pytest.fixture(scope="module")
def here():
    """The first series, fitted."""
    model, cause, data = series((2e-4, 1e-4), 1)
    train = data.only(data.train)
    fit, noise, lack, _ = fit_reweighted(model, train, stated(train), model.nominal[None], "linear")
    return Fitted(fit, train, noise, lack, noise), cause


def test_the_same_error_confirms(here):
    """Breaks if curves are compared at other angles, or the carried model is not better than none on the other series."""
    found, _ = here
    causes, _, accuracies = confirm(found, series((2e-4, 1e-4), 2)[2])
    (row,) = causes.to_dict("records")
    assert row["joint"] == 1
    assert row["correlation"] > 0.95
    assert "the same curve" in row["words"]
    accuracy = accuracies.set_index("model")["heldout_mean_mm"]
    assert accuracy["the causes carried over"] < 0.7 * accuracy["without the causes"]


def test_another_error_contradicts(here):
    """Breaks if series that disagree count as confirmed."""
    found, _ = here
    causes, *_ = confirm(found, series((-2e-4, 1e-4), 3)[2])
    assert "do not agree" in causes["words"].iloc[0]


def test_a_curve_is_its_terms(here):
    """Breaks if a cause's parameters are put to the wrong waves or the wrong joint."""
    _, cause = here
    angle = np.linspace(-1, 1, 7)
    np.testing.assert_allclose(
        curve(cause, np.array([2.0, 3.0]), angle), 2 * np.cos(ORDER * angle) + 3 * np.sin(ORDER * angle)
    )
