"""What no fitted row was of is placed by its own rows, and changes nothing else."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from calflow.estimation.accuracy import completed, distances, errors
from calflow.estimation.fit import fit_reweighted
from calflow.estimation.noise import Noise
from calflow.estimation.registration import registered
from calflow.measurements.series import Series, Station
from calflow.model import stated
from calflow.observations import observations
from hidden.devices import Arm, Tracker, measured, seen, sockets
from robots import ur10

SIGMA = 2e-5


@pytest.fixture(scope="module")
def arm():
    """A UR10 that errs."""
    return Arm.drawn(ur10(), np.random.default_rng(1))


def fitted(data, *more):
    """The geometry of training rows, and more effects."""
    train = data.only(data.train)
    robot, observed = registered(data.robot, observations(train), train)
    model = stated(robot, ("geometry", *more), train, observed)
    noise = Noise(np.full(len(train), SIGMA), ("file",))
    return fit_reweighted(model, train.on(robot), noise, model.nominal[None], "linear")[0]


def test_a_placement_held_out_is_placed_by_its_own_rows(arm):
    """Fails if sockets that no fit saw are judged by where the nominal robot had them, or move what was fitted."""
    rng = np.random.default_rng(2)
    at = {"near": np.array([0.6, 0.3, 0.2]), "far": np.array([-0.5, 0.6, 0.4])}
    parts = [
        sockets(arm, {"0": point, "1": point + np.array([0.03, 0.0, 0.04])}, 12, SIGMA, rng).assign(placement=name)
        for name, point in at.items()
    ]
    table = pd.concat(parts, ignore_index=True)
    data = measured(arm.robot, table, Series.of("", "same-point", {"distance": 0.05}, labels=("socket", "placement")))
    data.table["split"] = np.where(table["placement"] == "far", "holdout", "train")
    fit = fitted(data)
    model, estimate = completed(fit.model, fit.estimate, data)
    old = {p.name: value for p, value in zip(fit.model.parameters, fit.estimate, strict=True)}
    new = {p.name: value for p, value in zip(model.parameters, estimate, strict=True)}
    assert {name: new[name] for name in old} == old
    assert len(new) == len(old) + 5
    held = distances(errors(fit.model, fit.estimate, data))[data.held_out]
    points = model.point(estimate, data.conditions)
    for socket in ("0", "1"):
        own = points[(table["placement"] == "far") & (table["socket"] == socket)]
        apart = np.linalg.norm(own - own.mean(axis=0), axis=1)
        mine = held[(table.loc[table["placement"] == "far", "socket"] == socket).to_numpy()]
        np.testing.assert_allclose(mine.mean(), apart.mean(), rtol=0.5)
    assert held.mean() < 8 * SIGMA


def test_a_session_held_out_is_placed_by_its_own_rows(arm):
    """Fails if a station that was set up anew is judged in the frame it had before."""
    rng = np.random.default_rng(3)
    series = Series(station=Station("A", by_session=True))
    q = arm.random(60, rng, 2.0)
    moved = Tracker(np.array([2.0, 1.0, 0.5, 0.1, -0.2, 0.7]), SIGMA, 0.0, 1e-5)
    first, second = (
        seen(arm, part, one, rng) for part, one in ((q[:45], Tracker(np.zeros(6), SIGMA, 0, 1e-5)), (q[45:], moved))
    )
    table = pd.concat([first.assign(session="mon"), second.assign(session="tue")], ignore_index=True)
    data = measured(arm.robot, table, series)
    data.table["split"] = np.where(table["session"] == "tue", "holdout", "train")
    fit = fitted(data)
    held = distances(errors(fit.model, fit.estimate, data))[data.held_out]
    assert held.mean() < 5 * SIGMA
    alone = data.only(data.train)
    np.testing.assert_array_equal(fitted(alone).estimate, fit.estimate)


def test_frames_of_sessions_held_out_are_placed_by_their_own_rows(arm):
    """Fails if a session that no fit saw stands where the first did, or moves what was fitted."""
    rng = np.random.default_rng(4)
    q = arm.random(75, rng, 2.0)
    at = {
        "mon": np.zeros(6),
        "tue": np.array([1e-3, -2e-3, 1e-3, 5e-4, 0, 1e-3]),
        "wed": np.array([-1e-3, 2e-3, 0, 1e-3, 0, 0]),
    }
    seen_in = [
        seen(arm, q[25 * k : 25 * k + 25], Tracker(place, SIGMA, 0.0, 1e-5), rng).assign(session=name)
        for k, (name, place) in enumerate(at.items())
    ]
    table = pd.concat(seen_in, ignore_index=True)
    data = measured(arm.robot, table, Series())
    data.table["split"] = np.where(table["session"] == "wed", "holdout", "train")
    fit = fitted(data, "session-frame")
    found = {
        p.symbol: value for p, value in zip(fit.model.parameters, fit.estimate, strict=True) if p.part == "sessions"
    }
    assert abs(found["rz-tue"] + 1e-3) < 1e-4  # what the device reports turns against it
    held = distances(errors(fit.model, fit.estimate, data))[data.held_out]
    assert held.mean() < 5 * SIGMA
    model, estimate = completed(fit.model, fit.estimate, data)
    assert model.effects[:-1] == fit.model.effects
    np.testing.assert_array_equal(estimate[: len(fit.estimate)], fit.estimate)
    assert {p.symbol for p in model.parameters[len(fit.estimate) :]} == {
        f"{s}{a}-wed" for s in ("", "r") for a in "xyz"
    }
