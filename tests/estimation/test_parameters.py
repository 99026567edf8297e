"""Parameters by name: held, bounded and expected otherwise, from Python and from a study file, wherever they count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import calflow as cf
from calflow.calibration import Calibration
from calflow.estimation.parameters import Parameters
from calflow.model import build
from calflow.study import load_study
from robots import hh800

EFFECTS = ("geometry", "joint-compliance")


@pytest.fixture
def before():
    """The parameters of a robot before a fit."""
    return Parameters.of_model(build(hh800(), EFFECTS))


def test_a_parameter_says_what_is_allowed_and_expected_of_it(before):
    """Fails if a name leads to another parameter, or a figure is not what the effect declares."""
    declared = build(hh800(), EFFECTS).parameters
    assert list(before) == [one.name for one in declared]
    for one in declared:
        row = before[one.name]
        assert (row.bounds, row.prior) == ((one.lower, one.upper), (one.prior_mean, one.prior_sd))
        assert (row.unit, row.meaning, row.value) == (one.unit, one.meaning, one.prior_mean)
        assert (row.at_bound, row.fixed) == (False, False)
        assert np.isnan(row.sd)
    assert "joint3.theta" in repr(before)
    assert "<td>joint3.theta</td>" in before._repr_html_()


def test_what_is_changed_is_changed_alone(before):
    """Fails if a change touches another parameter, the object it was asked of, or an earlier change of the same parameter."""
    name = "joint3.theta"
    after = before.fix(name, 1e-3).bound(name, upper=5e-3).prior(name, 1e-4, 2e-4)
    row = after[name]
    assert (row.fixed, row.value, row.sd) == (True, 1e-3, 0.0)
    assert (row.bounds, row.prior) == ((before[name].lower, 5e-3), (1e-4, 2e-4))
    assert not before[name].fixed
    assert [one for one in before if before[one].prior != after[one].prior] == [name]
    freed = after.free(name)
    assert (freed[name].fixed, freed[name].bounds, freed[name].value) == (False, row.bounds, 1e-4)
    assert before.fix(name).free(name).stated == ()
    assert before.fix(name)[name].value == before[name].nominal


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p: p.fix("joint3.thetta"), "unknown parameter 'joint3.thetta', did you mean 'joint3.theta'?"),
        (lambda p: p.fix("joint3.theta", 1.0), "parameter 'joint3.theta' is between -0.02 and 0.02 rad, expected 1"),
        (lambda p: p.bound("joint3.theta", lower=0.1), "expected lower < upper, found 0.1 and 0.02 rad"),
        (lambda p: p.bound("joint3.theta", lower=1e-3), "is expected about 0 rad, which is not between 0.001 and 0.02"),
        (lambda p: p.prior("joint3.theta", 0.5, 1e-4), "is between -0.02 and 0.02 rad, expected 0.5"),
        (lambda p: p.prior("joint3.theta", 0.0, 0.0), "sd: expected a number greater than 0, found 0.0"),
    ],
)
def test_what_cannot_be_is_refused(before, change, message):
    """Fails if a name or a figure that makes no sense is taken, or the message does not say what would."""
    with pytest.raises(cf.InputError) as refused:
        change(before)
    assert message in str(refused.value)


def test_a_model_of_held_parameters_predicts_as_the_whole_one():
    """Fails if a held value gets lost in the graph, or stands in another parameter's place, of any effect."""
    robot, rng = hh800(), np.random.default_rng(5)
    whole = build(robot, EFFECTS)
    p = 0.3 * whole.prior_sd * rng.standard_normal(len(whole.parameters))
    p = np.clip(p, *whole.bounds.T)
    held = rng.random(len(p)) < 0.3
    named = Parameters.of_model(whole)
    for k in np.flatnonzero(held):
        named = named.fix(whole.parameters[k].name, p[k])
    lean = build(replace(robot, expected=named.stated), EFFECTS)
    assert [one.name for one in lean.parameters] == [
        one.name for one, fixed in zip(whole.parameters, held, strict=True) if not fixed
    ]
    rows = rng.uniform(-0.5, 0.5, (whole.n_conditions, 7))
    np.testing.assert_allclose(lean.position(p[~held], rows), whole.position(p, rows), atol=1e-13)
    np.testing.assert_allclose(
        lean.position_jacobian(p[~held], rows), whole.position_jacobian(p, rows)[:, :, ~held], atol=1e-12
    )
    for effect, own in zip(lean.effects, whole.effects, strict=True):
        assert np.array_equal(lean.values(effect, p[~held]), p[whole.columns(own)])
        assert np.array_equal(p[~held][lean.columns(effect)], p[whole.columns(own)][~held[whole.columns(own)]])


STATED = """
[parameters.joint2.theta]
fixed = true
value_deg = 0.01

[parameters.joint3.a]
prior_mean_um = 100
prior_sd_um = 1

[parameters.joint3.s]
upper_rad_per_Nm = 1e-6
"""


def test_a_study_states_it_and_every_stage_keeps_to_it(small):
    """Fails if a held parameter is fitted, sampled or chosen poses for, or a run's model is opened without what was stated."""
    with (small / "study.toml").open("a") as file:
        file.write(STATED)
    small.edit(
        "quick.toml",
        ('"identify", "sample"]', '"identify", "diagnose", "sample"]'),
        ("[settings.sample]", '[settings.diagnose]\ncatalogue = ["joint-eccentricity"]\n\n[settings.sample]'),
    )
    assert small.calflow("run").code == 0
    table = pd.read_csv(small / "runs" / "identify" / "parameters.csv").set_index("parameter")
    held = table.loc["joint2.theta"]
    assert (held["fixed"], held["estimate"], held["sd"]) == (True, pytest.approx(np.deg2rad(0.01)), 0.0)
    assert table["fixed"].sum() == 1
    assert tuple(table.loc["joint3.a", ["prior_mean", "prior_sd"]]) == pytest.approx((1e-4, 1e-6))
    assert table.loc["joint3.a", "estimate"] == pytest.approx(1e-4, abs=1e-5)
    assert table.loc["joint3.s", "upper"] == pytest.approx(1e-6)
    for name in ("identify/covariance.csv", "sample/posterior.csv"):
        assert "joint2.theta" not in set(pd.read_csv(small / "runs" / name)["parameter"])
    known = Calibration.load(small / "runs")
    known.save(small / "again")
    again = Calibration.load(small / "again")
    assert again.parameters.stated == known.parameters.stated
    assert again.model.robot == known.model.robot
    assert known.parameters["joint2.theta"].fixed
    assert np.array_equal(again.estimate, known.estimate)
    assert known.model.values(known.model.effects[0], known.estimate)[
        [one.name for one in known.model.effects[0].declared].index("joint2.theta")
    ] == pytest.approx(np.deg2rad(0.01))


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("[parameters.joint2.thetta]\nfixed = true", 1, "unknown parameter 'joint2.thetta', did you mean 'joint2.theta'?"),
        ("[parameters.joint2.theta]\nfixed = 1", 2, "parameters.joint2.theta.fixed: expected true or false, found 1"),
        ("[parameters.joint2.theta]\nfixt = true", 2, "unknown key, did you mean 'fixed'?"),
        ("[parameters.joint2.theta]\nvalue_deg = 1", 1, "value is where a parameter is held: expected fixed = true beside it"),
        ("[parameters.joint2.theta]\nfixed = true\nvalue_mm = 1", 1, "parameter 'joint2.theta' is in rad, not m"),
        ("[parameters.joint2.theta]\nfixed = true\nvalue = 1", 1, "parameter 'joint2.theta' is in rad, not 1"),
        ("[parameters.joint2.theta]\nprior_mean_deg = 0", 1, "expected prior_mean and prior_sd together"),
        ("[parameters.joint2.theta]\nlower_deg = 0\nupper_mm = 1", 1, "expected all figures in units of one kind"),
        ("[parameters.joint2.theta]\nlower_deg = 0\nlower_rad = 1", 3, "'lower' is given twice, in different units"),
        ("[parameters.joint2.theta]\nlower_deg = 2\nupper_deg = 1", 1, "expected lower < upper"),
        ("[parameters.joint2.theta]\nlower_deg = 'x'", 2, "expected a number"),
        ("[parameters.joint2]\n", 1, "states nothing: expected fixed = true, or"),
    ],
)  # fmt: skip
def test_what_a_study_misstates_is_refused_where_it_stands(small, text, line, message):
    """Fails if a misspelt parameter, key or unit is passed over, or told without its file and line."""
    before = len((small / "study.toml").read_text().splitlines())
    with (small / "study.toml").open("a") as file:
        file.write(text + "\n")
    (told,) = small.refused("check")
    assert told.startswith(f"study.toml:{before + line}: ")
    assert message in told


def test_a_study_without_measurements_is_told_too(small):
    """Fails if a plan goes on with what is stated of a parameter that its model does not have."""
    text = (small / "study.toml").read_text().replace('[measurements]\nfile = "measurements.csv"\n', "")
    (small / "study.toml").write_text(f"{text}\n[parameters.joint9.theta]\nfixed = true\n")
    with pytest.raises(cf.InputError, match=r"unknown parameter 'joint9\.theta'"):
        load_study(small.path)


def test_from_python_as_from_a_study(small):
    """Fails if what is held from Python is fitted, lost in a robot file that is written, or passed over where it is unknown."""
    robot = cf.Robot.from_toml(small / "robot.toml")
    data = load_study(small.path).measurements()
    parameters = cf.Parameters.of(robot, data, EFFECTS).fix("joint2.theta", 1e-4).bound("joint3.a", -1e-3, 1e-3)
    fit = cf.identify(robot, data, EFFECTS, parameters=parameters, starts=1)
    held = fit.parameters.table.set_index("parameter").loc["joint2.theta"]
    assert (held["fixed"], held["estimate"], held["sd"]) == (True, 1e-4, 0.0)
    fit.model.robot.to_toml(small / "again.toml")
    again = cf.Robot.from_toml(small / "again.toml")
    assert again.expected == fit.model.robot.expected == parameters.stated
    after = fit.parameters
    assert after["joint3.a"].bounds == (-1e-3, 1e-3)
    assert after.fix("joint3.a")["joint3.a"].value == after["joint3.a"].value != 0
    with pytest.raises(cf.InputError, match=r"unknown parameter 'joint3\.s'"):
        cf.identify(robot, data, ["geometry"], parameters=parameters.fix("joint3.s"))
