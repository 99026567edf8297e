"""A calibration that is saved and loaded is the same to the last bit, whatever the robot, its effects and its device."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
import pandas as pd
import pytest

import calflow as cf
import robots
from calflow.deployment.figures_alone import FIGURES, LEVELS
from calflow.deployment.run_outcome import RunOutcome
from calflow.design.candidates import candidates
from calflow.estimation.calibrated_model import Alternative, CalibratedModel
from calflow.files.tables import Results
from calflow.measurements.saved import load_measurements, save_measurements
from calflow.measurements.series import Series
from calflow.model import Model, build
from estimation.data import drawn_truth

SIGMA, ANCHOR = 3e-5, np.array([1.5, -2.0, 0.1])  # m


@dataclass(frozen=True)
class Case:
    """A robot, its effects, and what a device sees of it: position, pose or distance, with stated noise or without."""

    robot: cf.Robot
    effects: tuple[str, ...]
    kind: str = "position"
    stated: bool = False
    bend: float = 0.0  # m, a smooth error that no effect explains

    @property
    def model(self) -> Model:
        """Its graph."""
        return build(self.robot, self.effects)

    def measured(self, seed: int) -> cf.Measurements:
        """What the device reports at random poses of a robot with errors drawn from their priors."""
        rng, model = np.random.default_rng(seed), self.model
        payload, marker = next(iter(self.robot.payloads), ""), next(iter(self.robot.markers))
        q, conditions = candidates(model, 70, payload, marker, None, rng)
        truth = drawn_truth(model, rng)
        at = model.position(truth, conditions) + SIGMA * rng.standard_normal((len(q), 3))
        at[:, 2] += self.bend * np.sin(2 * q[:, 1])
        more: dict = {"sigma": SIGMA} if self.stated else {}
        if self.kind == "pose":
            more |= {"rotation": model.rotation(truth, conditions), "sigma_rotation": 1e-5}
        data = cf.Measurements.from_arrays(self.robot, q, at, payload=payload, marker=marker, **more)
        if self.kind == "distance":
            wire = Series.of("wire", "distance", {"anchor": tuple(ANCHOR), "anchor_known": False})
            length = np.linalg.norm(at - ANCHOR, axis=1)
            data = replace(data, table=data.table.drop(columns=["x", "y", "z"]).assign(length=length), series=(wire,))
        return data.split(0.3, seed)


CASES = {
    "a serial arm": Case(robots.industrial(markers={"E": {"point_m": [0.1, 0.02, 0.3]}}), ("geometry",), stated=True),
    "a loop that gives way": Case(robots.palletiser(), ("geometry", "joint-compliance")),
    "a wire": Case(robots.industrial(), ("geometry",), "distance"),
    "something smooth": Case(robots.industrial(), ("geometry",), bend=2e-3),
}


def assert_same(one: CalibratedModel, other: CalibratedModel) -> None:
    """Every figure of the model, of what is as probable, and of what is predicted is the same number."""
    for field in fields(CalibratedModel):
        mine, others = getattr(one, field.name), getattr(other, field.name)
        if isinstance(mine, np.ndarray):
            np.testing.assert_array_equal(mine, others, field.name)
        elif field.name == "alternatives":
            assert list(map(figures, mine)) == list(map(figures, others))
        elif field.name == "field":
            assert (mine is None) == (others is None)
        elif field.name == "errors" and mine is not None:
            assert mine.functions == others.functions
            assert mine.rest == others.rest
            for name in ("sd", "mean", "slope", "told", "offset"):
                np.testing.assert_array_equal(getattr(mine, name), getattr(others, name), name)
        else:
            assert mine == others, field.name


def figures(one: Alternative) -> tuple[object, ...]:
    """What another model is by its numbers."""
    return one.model, one.estimate.tolist(), one.probability


def assert_loaded(calibration: cf.Calibration, folder) -> cf.Calibration:
    """It is loaded as it was saved: model, tables, summaries, rows, what was asked, and what it predicts."""
    loaded = cf.Calibration.load(calibration.save(folder))
    assert_same(calibration, loaded)
    assert loaded.results.documents == calibration.results.documents
    assert set(loaded.results.tables) == set(calibration.results.tables)
    for name, table in calibration.results.tables.items():
        read = loaded.results.tables[name]
        pd.testing.assert_frame_equal(table.reset_index(drop=True), read, check_exact=True, check_dtype=False, obj=name)
    assert (loaded.robot, loaded.request, loaded.data) == (calibration.robot, calibration.request, calibration.data)
    q = calibration.data.joints[:7]
    given = {"payload": next(iter(calibration.robot.payloads), None), "missing": "widen"}
    one, other = calibration.predict(q, **given), loaded.predict(q, **given)
    np.testing.assert_array_equal(one.position, other.position)
    np.testing.assert_array_equal(one.sd, other.sd)
    assert loaded.levels == calibration.levels
    assert repr(loaded) == repr(calibration)
    return loaded


def assert_identified_and_loaded(case: Case, seed: int, folder) -> cf.Calibration:
    """What was identified is loaded as it was, without a residual field and with the one that it may gain."""
    calibration = cf.identify(case.robot, case.measured(seed), case.effects, starts=1, seed=seed, title="any")
    assert_loaded(calibration, folder / "identified")
    corrected = calibration.with_residual_field()
    assert_loaded(corrected, folder / "corrected")
    return corrected


@pytest.mark.parametrize("name", CASES)
def test_what_is_loaded_is_what_was_saved(name, tmp_path):
    """Fails if a figure loses a bit on its way through mm, degrees or the digits of a table; benchmarks/slow has any robot."""
    case = CASES[name]
    corrected = assert_identified_and_loaded(case, 1, tmp_path)
    assert (corrected.field is not None) == bool(case.bend)


def test_a_diagnosis_is_loaded_with_all_it_found(tmp_path):
    """Fails if findings, alternatives or models in reach are others, or it cannot be diagnosed again as it was before."""
    case = Case(robots.industrial(), ("geometry",))
    data = case.measured(1)
    side = np.random.default_rng(3).choice([-1.0, 1.0], (len(data), 6))
    play = {f"approach{i + 1}": side[:, i] for i in range(6)} | {"q2": data.table["q2"] - 2e-4 * side[:, 1]}
    data = replace(data, table=data.table.assign(**play))
    calibration = cf.identify(case.robot, data, case.effects, starts=1)
    wanted = ["joint-backlash", "joint-eccentricity"]
    found = calibration.diagnose(catalogue=wanted)
    assert (found.findings[0].cause, found.findings[0].joint) == ("joint-backlash", 2)
    loaded = assert_loaded(found, tmp_path / "diagnosed")
    assert len(loaded.models_in_reach) == len(found.models_in_reach) > 1
    assert list(map(repr, loaded.findings)) == list(
        map(repr, found.findings)
    )  # figures that are not known are no numbers
    assert_same(loaded.identified, calibration)
    again = loaded.diagnose(catalogue=wanted)
    assert again.results.tables["diagnose/findings.csv"].equals(found.results.tables["diagnose/findings.csv"])


def test_a_stated_noise_that_repeats_contradict_on_one_day_is_told_as_it_was_stated():
    """Fails if the noise that is told as stated is the corrected one, or that of a mean of repeats."""
    case, rng = Case(robots.industrial(), ("geometry",)), np.random.default_rng(7)
    data = case.measured(1)
    noisy = np.repeat(np.arange(len(data)) % 3 == 0, 2)
    table = data.table.loc[np.repeat(data.table.index, 2)].reset_index(drop=True)
    scatter = {name: table[name] + np.where(noisy, 1.2e-4, 3e-5) * rng.standard_normal(len(table)) for name in "xyz"}
    days = {"session": np.where(noisy, "wed", "mon"), "sigma": 3e-5, "repeat": np.arange(len(table)) % 2 + 1}
    data = replace(data, table=table.assign(**scatter, **days))
    found = cf.identify(case.robot, data, case.effects, starts=1, noise="file").diagnose(catalogue=["joint-backlash"])
    (doubt,) = (doubt for doubt in RunOutcome(found.results).noise_doubts if doubt.session)
    assert (doubt.session, doubt.stated, doubt.shown_by) == ("wed", pytest.approx(0.03), "repeats")
    assert doubt.shown > 1.5 * doubt.stated


def test_a_run_of_a_version_without_levels_of_effort_says_so(finished):
    """Fails if what needs a table that a run folder of earlier lacks is made without it, or nobody says what to do."""
    calibration = cf.Calibration.load(finished / "runs")
    tables = {name: table for name, table in calibration.results.tables.items() if not name.endswith((LEVELS, FIGURES))}
    older = replace(calibration, results=Results(tables, calibration.results.documents))
    assert older.validate(older.data).summary.status == "no tolerance"
    with pytest.raises(cf.InputError, match="run the study again"):
        older.validate(older.data, sent="controller figures")
    for to in ("dh", "kuka-dat"):
        with pytest.raises(cf.InputError, match="run the study again"):
            older.export(to)


def test_a_saved_calibration_is_a_run_for_the_command_line(tmp_path, small):
    """Fails if a command refuses what Python saved, or predicts another place; or a study's run is written over."""
    case = CASES["a serial arm"]
    calibration = cf.identify(case.robot, case.measured(1), case.effects, starts=1)
    folder = calibration.save(small / "saved")
    assert calibration.save(folder) == folder  # its own is written over
    q = calibration.data.joints[:3]
    columns = [f"q{i + 1}_rad" for i in range(6)]
    pd.DataFrame(q, columns=columns).assign(payload="load").to_csv(small / "rows.csv", index=False)
    assert small.calflow("predict", folder, small / "rows.csv", "--out", small / "there.csv").code == 0
    there = pd.read_csv(small / "there.csv")[["x_mm", "y_mm", "z_mm"]].to_numpy()
    np.testing.assert_allclose(there, 1e3 * calibration.predict(q, payload="load").position, rtol=1e-9)
    (small / "other").mkdir()
    (small / "other" / "notes.txt").write_text("mine")
    with pytest.raises(cf.InputError, match="expected a folder of its own"):
        calibration.save(small / "other")
    (folder / "identify" / "covariance.csv").write_text("parameter\n")
    with pytest.raises(cf.InputError, match=r"identify/covariance\.csv was changed by hand"):
        cf.Calibration.load(folder)


def test_what_no_column_says_of_measurements_is_saved(tmp_path):
    """Fails if rows that do not say what is carried come back as rows that say that nothing is."""
    data = cf.Measurements.from_arrays(robots.ur10(), np.zeros((2, 6)), np.ones((2, 3)), payload="load")
    data = replace(data, notes=("a note",), time_origin=3.0, units=("mm",), payload_stated=False)
    save_measurements(data, tmp_path)
    loaded = load_measurements(tmp_path, data.robot)
    for field in fields(data):
        if field.name != "table":
            assert getattr(loaded, field.name) == getattr(data, field.name), field.name
