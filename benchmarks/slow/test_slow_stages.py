"""Stages at length: what a plan tells apart of the whole catalogue, a wire through all of them, and a session's noise saved."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

import calflow as cf
import robots
from calflow.deployment.run_outcome import RunOutcome
from calflow.model import build
from conftest import _measured, small  # noqa: F401, fixtures
from effects.test_axis_straightness import ON_A_RAIL
from hidden.devices import rows, written
from stages.test_mixtures import CUPS, WIRE, eccentricity_found, finished, lines_at_fault, study, tables  # noqa: F401, fixtures
from stages.test_select import selected
from test_saved import Case, assert_identified_and_loaded, assert_loaded


def test_what_the_plan_tells_apart_is_said_where_it_is_asked_for(small):  # noqa: F811
    """Fails if the table comes unasked, counts a study's own effect as a cause, or the stage does not say the gaps in words."""
    said = selected(small, "")[2]
    assert "causes" not in said
    assert not (small / "runs" / "select" / "isolability.csv").exists()
    said = selected(small, 'isolability = true\nrecords = ["travel", "time", "temperature"]', out="told")[2]
    table = pd.read_csv(small / "told" / "select" / "isolability.csv")
    package = json.loads((small / "told" / "datapackage.json").read_text(encoding="utf-8"))
    assert "select/isolability.csv" in {resource["path"] for resource in package["resources"] if "schema" in resource}
    assert not set(table["cause"]) & {"geometry", "joint-compliance"}
    worst = table[table["worst"]]
    assert worst["cause"].isin(["joint-backlash"]).any()
    assert table["chance"].between(0, 1).all()
    assert (table["enough"] == (table["chance"] >= 0.9)).all()
    assert "would be detected" in said
    assert any(words in said for words in worst["words"])


def test_a_wire_alone(study):  # noqa: F811
    """Fails if any stage cannot do with lengths, misses an outlier or a cause in them, or predicts nothing from them."""
    folder = study(WIRE)
    found = finished(folder)
    assert lines_at_fault(found) == {19}
    assert eccentricity_found(found)
    left = found["diagnose/accuracy"].query("split == 'holdout'")["mean_mm"]
    assert left.iloc[-1] < 0.12 < 0.3 < left.iloc[0]
    assert found["identify/residuals"]["dx_mm"].isna().all()
    asked = written(rows(np.full((2, 6), 0.3)))
    folder.measure(asked, "asked.csv")
    answer = folder.calflow("predict", folder / "runs", folder / "asked.csv", "--out", folder / "answer.csv")
    assert answer.code == 0, answer
    assert pd.read_csv(folder / "answer.csv")["sd_x_mm"].between(0, 3).all()


def test_sockets_alone(study):  # noqa: F811
    """Fails if any stage cannot do with touches, or misses an outlier or a cause in them."""
    folder = study(CUPS)
    found = finished(folder)
    assert lines_at_fault(found) == {35}
    assert eccentricity_found(found)
    poses = pd.read_csv(folder / "runs" / "select" / "poses.csv")
    apart = np.linalg.norm(
        poses[["nominal_x_mm", "nominal_y_mm", "nominal_z_mm"]].to_numpy()[:, None]
        - np.array([[600, 200, 300], [650, 200, 300]]),
        axis=2,
    )
    assert (apart.min(axis=1) < 0.2).all()
    assert len(set(apart.argmin(axis=1))) == 2


def test_the_noise_of_a_session_is_loaded_as_it_was_saved(tmp_path):
    """Fails if a session's noise is lost with the files, nobody is told that what was stated is wrong, or the accuracy is that of
    the fit before.
    """
    case = Case(robots.industrial(), ("geometry",))
    data = case.measured(1)
    noisy = np.arange(len(data)) % 3 == 0
    rng = np.random.default_rng(5)
    more = {name: data.table[name] + noisy * 3e-4 * rng.standard_normal(len(data)) for name in "xyz"}
    days = {"session": np.where(noisy, "wed", "mon"), "sigma": 3e-5}
    data = replace(data, table=data.table.assign(**more, **days))
    calibration = cf.identify(case.robot, data, case.effects, starts=1)
    found = calibration.diagnose(catalogue=["joint-backlash", "joint-eccentricity"])
    loaded = assert_loaded(found, tmp_path / "diagnosed")
    (device,) = loaded.device
    assert 6 < device.factors["wed"] < 16
    assert "mon" not in device.factors
    np.testing.assert_array_equal(loaded.noise(data).sigma, np.where(noisy, device.factors["wed"], 1.0) * 3e-5)
    assert loaded.noise(data).words.endswith("corrected where it is larger")
    (doubt,) = RunOutcome(loaded.results).noise_doubts
    assert doubt.session == "wed"
    off = found.model.position(found.estimate, data.conditions) - data.position
    assert not np.array_equal(found.estimate, calibration.estimate), "fitted again with that noise"
    *_, fitted = (row for row in found.accuracy if row.split == "train")
    assert fitted.mean == pytest.approx(1e3 * np.linalg.norm(off[data.train], axis=1).mean())


def test_the_noise_of_a_marker_is_loaded_as_it_was_saved(tmp_path):
    """Fails if a marker's noise is lost with the files, or a run that was saved without it is not loaded."""
    places = {"E": [0.1, 0.02, 0.3], "F": [-0.1, 0.2, 0.25], "G": [0.15, -0.2, 0.2]}
    case = Case(robots.industrial(markers={name: {"point_m": at} for name, at in places.items()}), ("geometry",))
    data, rng = case.measured(1).only(np.arange(70) < 40), np.random.default_rng(5)
    table = pd.concat([data.table.assign(marker=name) for name in places], ignore_index=True)
    data = replace(data, table=table.assign(line=np.arange(2, len(table) + 2), sigma=3e-5))
    model, loose = build(case.robot, ("geometry",), data.given), data.table["marker"] == "F"
    noise = np.where(loose, 3e-4, 3e-5)[:, None] * rng.standard_normal((len(data), 3))
    seen = model.position(model.nominal, data.conditions) + noise
    data = replace(data, table=data.table.assign(**dict(zip("xyz", seen.T, strict=True))))
    found = cf.identify(case.robot, data, case.effects, starts=1).diagnose(catalogue=["joint-backlash"])
    loaded = assert_loaded(found, tmp_path / "diagnosed")
    (device,) = loaded.device
    assert 6 < device.factors["F"] < 16
    np.testing.assert_array_equal(loaded.noise(data).sigma, np.where(loose, device.factors["F"], 1.0) * 3e-5)
    (doubt,) = RunOutcome(loaded.results).noise_doubts
    assert (doubt.session, doubt.marker) == ("", "F")


ROBOTS = {
    "arm": robots.industrial(),
    "arm with a marker off its axes": robots.industrial(markers={"E": {"point_m": [0.1, 0.02, 0.3]}}),
    "loop": robots.palletiser(),
    "rail": ON_A_RAIL,
}
cases = st.builds(
    Case,
    robot=st.sampled_from(list(ROBOTS.values())),
    effects=st.sampled_from([("geometry",), ("geometry", "joint-compliance"), ("geometry", "gravity-deflection")]),
    kind=st.sampled_from(["position", "pose", "distance"]),
    stated=st.booleans(),
    bend=st.sampled_from([0.0, 2e-3]),
).filter(
    lambda case: (
        case.effects == ("geometry",) or (case.robot.has_masses and case.kind != "distance")
    )  # too few equations
)


@settings(
    max_examples=10,
    phases=[Phase.explicit, Phase.generate],
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=list(HealthCheck),
)
@given(case=cases, seed=st.integers(1, 1000))
def test_whatever_is_identified_is_loaded_as_it_was_saved(tmp_path_factory, case, seed):
    """Fails if any robot, effects, device, noise or residual field costs a bit, of which tests/test_saved.py has a few."""
    assert_identified_and_loaded(case, seed, tmp_path_factory.mktemp("saved"))
