"""What no cause explains is told with its inputs, and noise is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.noise_model import noise_of_residuals
from calflow.diagnosis.screening import by_place
from calflow.diagnosis.trial import Linearisation
from calflow.diagnosis.unexplained import SUSPECTED, Oscillation, UnexplainedStructure, decoys, suspected, unexplained
from calflow.effects import catalogue
from calflow.estimation.fit import fit_reweighted
from calflow.model import build
from estimation.data import SIGMA, measured, stated
from robots import industrial


def fitted(shift=None, seed=8, poses=100, sigma=None, uneven=10.0):
    """A robot whose points are shifted by a function of its table, geometry fitted."""
    robot = industrial()
    model = build(robot, ("geometry",))
    rng = np.random.default_rng(seed)
    data = measured(model, model.nominal, poses, rng, sigma=SIGMA if sigma is None else 0.0)
    data.table["time"] = np.cumsum(rng.uniform(30 - uneven, 30 + uneven, poses))
    data.table["range"] = np.linalg.norm(data.position - np.array([4.0, 0.0, 0.0]), axis=1)
    if sigma is not None:
        data.table[["x", "y", "z"]] += sigma(data.table["range"].to_numpy())[:, None] * rng.standard_normal((poses, 3))
    if shift is not None:
        data.table[["x", "y", "z"]] += shift(data.table)
    model = build(robot, ("geometry",), data.given)
    fit, noise, lack, _ = fit_reweighted(model, data, stated(data), model.nominal[None], "linear")
    return Fitted(fit, data, noise, lack, noise)


def test_noise_depends_on_nothing():
    """Breaks if noise is reported as structure."""
    assert unexplained(fitted(), 0.01, np.random.default_rng(1), lambda _: None) == []


@pytest.mark.parametrize(
    ("shift", "inputs"),
    [
        (lambda t: 3e-4 * np.outer(np.sin(t["q4"]) * np.cos(t["q6"]), [0, 0, 1]), {"q4", "q6"}),
        (lambda t: 2e-4 * np.outer(np.sin(2 * np.pi * t["time"] / 113.0), [0, 0, 1]), {"time"}),
        (lambda t: 2e-4 * np.outer(np.sin(2 * np.pi * t["time"] / 23.0), [0, 0, 1]), {"time"}),  # between two poses
        (lambda t: 2e-4 * np.outer(np.sin(3 * t["q1"]), [0, 0, 1]), {"q1"}),
    ],
)
def test_structure_is_told_with_its_inputs(shift, inputs):
    """Breaks if a dependence is missed, or put down to other inputs."""
    left = unexplained(fitted(shift), 0.01, np.random.default_rng(1), lambda _: None)
    assert left
    assert inputs <= set(left[0].inputs)


def test_a_slow_drift_is_no_wave_between_two_poses():
    """Breaks if, of waves that nearly even times do not distinguish, another than the slowest is told."""
    drift = fitted(lambda t: 3e-4 * np.outer(t["time"] / t["time"].max(), [0, 0, 1]), uneven=0.1)
    left = unexplained(drift, 0.01, np.random.default_rng(1), lambda _: None)
    waves = [part for part in left[0].functions if isinstance(part, Oscillation)]
    assert waves
    assert all(
        2 * np.pi / wave.rate > 59 for wave in [*waves, *(d for d in decoys(drift) if isinstance(d, Oscillation))]
    )


def test_a_period_is_told_in_the_unit_that_fits_it():
    """Fails if the hours of a working cycle are told as thousands of seconds, or a wave of half a minute in hours."""
    robot = fitted().model.robot
    told = [Oscillation(robot, 2 * np.pi / period).detail for period in (36.0, 3290.0)]
    assert told == ["period 36 s", "period 0.91 h"]


def test_a_step_of_several_joints_is_told_from_its_row_on():
    """Fails if what sets in at a row, and no single joint or tool does, is told without the row."""
    model = build(industrial(), ("geometry",))
    data = measured(model, model.nominal, 100, np.random.default_rng(6))
    turned = data.conditions.copy()
    turned[[1, 2, 4], 60:] += np.array([[2e-4], [-3e-4], [4e-4]])
    moved = model.position(model.nominal, turned) - model.position(model.nominal, data.conditions)
    data.table[["x", "y", "z"]] += moved
    data = replace(data, table=data.table.assign(order=np.arange(1.0, 101.0)))
    model = build(data.robot, ("geometry",), data.given)
    fit, noise, lack, _ = fit_reweighted(model, data, stated(data), model.nominal[None], "linear")
    left, *_ = unexplained(Fitted(fit, data, noise, lack, noise), 0.01, np.random.default_rng(1), lambda _: None)
    assert left.inputs == ("order",)
    assert left.detail == "since row 61 in measuring order"


def test_what_is_certain_and_of_no_use_is_not_told(monkeypatch):
    """Fails if a dependence's share is not what it adds to the errors, or one that explains too little is told for its p-value."""
    known = fitted(lambda t: 2e-4 * np.outer(np.sin(3 * t["q1"]), [0, 0, 1]))
    one, *_ = unexplained(known, 0.01, np.random.default_rng(1), lambda _: None)
    noise = SIGMA**2 * len(known.data) * 3
    added = float((2e-4 * np.sin(3 * known.data.table["q1"])).pow(2).sum())
    assert one.share == pytest.approx(added / (added + noise), abs=0.15)
    monkeypatch.setattr("calflow.diagnosis.unexplained.MATERIAL", one.share * 1.01)
    assert one not in unexplained(known, 0.01, np.random.default_rng(1), lambda _: None)


def test_what_goes_with_the_payload_is_told():
    """Breaks if a dependence on the payload is missed or put down to joints alone, or told where all rows carry the same."""
    robot = industrial()
    rng = np.random.default_rng(5)
    model = build(robot, ("geometry",))
    data = measured(model, model.nominal, 100, rng)
    bare = rng.permutation(100) < 50
    data.table.loc[bare, "payload"] = ""
    turned = data.conditions.copy()
    turned[1, ~bare] += 2e-4 * np.cos(turned[1, ~bare])
    data.table[["x", "y", "z"]] += model.position(model.nominal, turned) - model.position(
        model.nominal, data.conditions
    )
    fit, noise, lack, _ = fit_reweighted(model, data, stated(data), model.nominal[None], "linear")
    left = unexplained(Fitted(fit, data, noise, lack, noise), 0.01, np.random.default_rng(1), lambda _: None)
    assert "payload" in left[0].inputs
    assert left[0].detail == "under load"


def test_noise_that_grows_with_range_is_measured():
    """Breaks if the growth is missed, misjudged, or seen where the noise is even."""
    seen = noise_of_residuals(fitted(sigma=lambda r: 1.5e-5 + 2e-5 * r, poses=300))
    assert seen is not None
    assert seen.p < 0.001
    assert abs(seen.slope - 2e-5) < 4 * seen.sd
    assert seen.floor < 4e-5
    even = noise_of_residuals(fitted())
    assert even is None or even.p > 0.001


FAMILY = ("gear-ratio-error", "gear-transmission-error", "joint-eccentricity")


def test_what_stays_unexplained_has_suspects():
    """Fails if errors of another joint are suspected, an improbable cause is, or a probable one with a dependence but the first."""
    known = fitted()
    effects = tuple(catalogue()[name](known.data.robot) for name in (*FAMILY, "nonlinear-joint-stiffness"))
    scores = Linearisation.at(known, effects).beside.scores
    first, second, third = (
        UnexplainedStructure(inputs, 1e-6, 0.5, (), along=along)
        for inputs, along in ((("q2",), ("q2",)), (("q4", "q3"), ("q4",)), (("q1", "q5"), ()))
    )
    unlikely = [replace(score, cost=40.0) for score in scores]
    found = suspected((first, second, third), unlikely)
    family = [score.cause for score in scores if score.cause.id in FAMILY]
    of_joint = [{cause.place for cause in family if cause.joint == joint} for joint in (2, 4)]
    assert all(of_joint)
    assert [{cause.place for cause in left.suspects} for left in found] == [*of_joint, set()]
    likely = next(
        score for score in unlikely if (score.cause.id, score.cause.joint) == ("nonlinear-joint-stiffness", 3)
    )
    for odds, told in ((SUSPECTED * 1.1, True), (SUSPECTED * 0.9, False)):
        cost = -2 * np.log(odds / (1 - odds) * len(by_place(scores)))
        others = [replace(likely, cost=cost) if score is likely else score for score in unlikely]
        found = suspected((first, second, third), others)
        assert [likely.cause in left.suspects for left in found] == [told, False, False]
