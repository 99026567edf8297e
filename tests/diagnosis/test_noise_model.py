"""Noise grows with range, or differs between sessions or markers, where the scatter does, not where the model errs more."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calflow.diagnosis.background import BackgroundBasis
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.noise_model import NoiseLevels, levels_of_residuals, noise_of_repeats, noise_of_residuals
from calflow.diagnosis.standstills import Standstills
from calflow.diagnosis.unexplained import POSE, unexplained
from calflow.estimation.accuracy import errors
from calflow.estimation.calibrated_model import CalibratedModel, series_noise
from calflow.estimation.fit import fit_reweighted
from calflow.estimation.noise import averaged, measured_noise, repeats_scatter
from calflow.files.units import METRE
from calflow.model import build
from estimation.data import SIGMA, measured
from robots import industrial


def fitted(repeats, shift, sigma=lambda r: 0 * r + SIGMA, session=None, stated=False):
    """A robot whose points are shifted by a function of joint readings and range, geometry fitted."""
    model = build(industrial(), ("geometry",))
    rng = np.random.default_rng(51)
    data = measured(model, model.nominal, 150, rng, repeats=repeats, sigma=0.0)
    data.table["range"] = np.linalg.norm(data.position - np.array([4.0, 0.0, 0.0]), axis=1)
    if session:
        data.table["session"] = session(data.table)
    noise = sigma(data.table if session else data.table["range"].to_numpy())
    data.table[["x", "y", "z"]] += noise[:, None] * rng.standard_normal((len(data), 3)) + shift(data.table)
    if stated:
        data.table["sigma"] = SIGMA
    return fitted_to(data)


def fitted_to(data):
    """The geometry fitted to the means of rows."""
    model = build(data.robot, ("geometry",), data.given)
    device = measured_noise(data)
    means, device = averaged(data, replace(device, scatter=repeats_scatter(data, errors(model, model.nominal, data))))
    fit, noise, lack, _ = fit_reweighted(model, means, device, model.nominal[None], "linear")
    return Fitted(fit, means, noise, lack, device)


def seen_by_markers(loose, repeats=1, stated=False, session=None, seed=53):
    """A robot whose poses are seen by three markers, of which B scatters `loose` times as much; geometry fitted."""
    places = {"A": [0.1, 0.02, 0.3], "B": [-0.1, 0.2, 0.25], "C": [0.15, -0.2, 0.2]}
    robot = industrial(markers={name: {"point_m": place} for name, place in places.items()})
    model, rng = build(robot, ("geometry",)), np.random.default_rng(seed)
    data = measured(model, model.nominal, 60, rng, repeats=repeats)
    table = pd.concat([data.table.assign(marker=name) for name in places], ignore_index=True)
    data = replace(data, table=table.assign(line=np.arange(2, len(table) + 2)))
    noise = SIGMA * np.where(data.table["marker"] == "B", loose, 1.0)
    place = model.position(model.nominal, data.conditions) + noise[:, None] * rng.standard_normal((len(data), 3))
    table = data.table.assign(**dict(zip("xyz", place.T, strict=True)))
    table = table.assign(session=session(table)) if session else table
    return fitted_to(replace(data, table=table.assign(sigma=SIGMA) if stated else table))


def days(table):
    """Three days, each of which measures poses from everywhere."""
    return np.array(["mon", "tue", "wed"])[table["pose"].to_numpy() % 3]


def noisy_on_wednesday(table):
    """Noise that is four times as large on the third day."""
    return SIGMA * np.where(table["session"] == "wed", 4.0, 1.0)


def of_residuals(seen, significance):
    """The growth that residuals tell, unless joints do not repeat beside it."""
    grown = noise_of_residuals(seen)
    if grown is None or grown.p >= significance:
        return None
    beside = seen.weighed(grown.sigma(seen.data, seen.device))
    return None if len(Standstills.of(beside, BackgroundBasis.of(seen)).joints) else grown


def none(table):
    """No error of the model."""
    return 0.0


def further(table):
    """An error that is smooth, and grows with range."""
    return 1e-4 * np.outer((table["range"] - 2) * np.sin(2 * table["q4"]), [0.0, 0.6, 0.8])


def unrepeatable(table):
    """A second joint that comes to rest on either side of its reading: an error along its way, the larger the further out."""
    q1, place = table["q1"].to_numpy(), table[["x", "y", "z"]].to_numpy()
    axis = np.stack([-np.sin(q1), np.cos(q1), 0 * q1], axis=1)
    origin = np.stack([0.312 * np.cos(q1), 0.312 * np.sin(q1), 0.67 + 0 * q1], axis=1)
    sides = np.random.default_rng(4).choice([-1.5e-4, 1.5e-4], len(table))
    return sides[:, None] * np.cross(axis, place - origin)


def test_a_joint_that_does_not_repeat_is_not_noise_of_the_device():
    """Fails if play whose sides nobody recorded is named as the device's noise, since who reaches far is far from it, or as smooth.

    The joint is told, and half of its play.
    """
    seen = fitted(1, unrepeatable)
    assert of_residuals(seen, 1e-2) is None
    grown = noise_of_residuals(seen)
    noisier = seen.weighed(grown.sigma(seen.data, seen.device)) if grown else seen
    standstills = Standstills.of(noisier, BackgroundBasis.of(seen))
    rng, at_rest = np.random.default_rng(1), standstills.at_rest(2e-3)
    (left,) = unexplained(seen, 2e-3, rng, lambda _: None, at_rest, standstills.background)
    assert left.inputs == (POSE, "q2")
    size, low, high = (float(figure) for figure in re.findall(r"[\d.]+", left.detail)[:3])
    assert low < 150 < high < 1.4 * low
    assert abs(size - 150) < 15


def test_noise_is_no_joint_that_does_not_repeat():
    """Fails if noise of the device, which moves a point to all sides, is told as a joint's."""
    for noise in (lambda r: 1e-5 + 2e-5 * r, lambda r: 0 * r + SIGMA):
        seen = fitted(1, none, noise)
        assert not len(Standstills.of(seen, BackgroundBasis.of(seen)).joints)


@pytest.mark.parametrize("repeats", [1, 2])
def test_a_misfit_is_not_noise(repeats):
    """Fails if an error that grows with range is swallowed by the noise."""
    seen = fitted(repeats, further)
    assert repeats == 1 or noise_of_repeats(seen).p > 1e-3
    assert of_residuals(seen, 1e-3) is None


def test_repeats_tell_the_growth_whatever_the_model_leaves():
    """Fails if a model's error makes the growth look larger, or smaller, than the repeats show it."""
    seen = noise_of_repeats(fitted(2, further, lambda r: 1e-5 + 2e-5 * r))
    assert seen.p < 1e-3
    assert abs(seen.slope - 2e-5) < 4 * seen.sd < 2.4e-5


def test_residuals_tell_the_growth_where_nothing_was_repeated():
    """Fails if the noise's growth is missed without repeats, or told by residuals where repeats speak."""
    seen = of_residuals(fitted(1, none, lambda r: 1e-5 + 2e-5 * r), 1e-3)
    assert seen is not None
    assert abs(seen.slope - 2e-5) < 4 * seen.sd
    assert noise_of_repeats(fitted(1, none)) is None
    assert of_residuals(fitted(2, none, lambda r: 1e-5 + 2e-5 * r), 1e-3) is None


def test_of_two_set_ups_the_further_one_may_be_the_noisier():
    """Fails if a day of other noise, on which the device stood further off, is named as noise that grows with range."""

    def noisier(table):
        return np.where(np.arange(len(table)) % 2, 4e-5, 2e-6)[:, None] * np.random.default_rng(3).standard_normal(
            (len(table), 3)
        )

    seen = fitted(1, noisier)
    far = np.arange(len(seen.data)) % 2 == 1
    table = seen.data.table.assign(range=seen.data.table["range"] + 2.0 * far)
    assert noise_of_residuals(replace(seen, data=replace(seen.data, table=table))) is not None
    days = table.assign(session=np.where(far, "tue", "mon"))
    grown = noise_of_residuals(replace(seen, data=replace(seen.data, table=days)))
    assert grown is None or grown.p > 0.01


@pytest.mark.parametrize(("repeats", "stated"), [(1, True), (1, False), (2, True)])
def test_a_noisier_session_is_told_from_the_others(repeats, stated):
    """Fails if the noise of one day is shared by all, is not sized, or the repeats or residuals that tell it are not used."""
    seen = fitted(repeats, none, noisy_on_wednesday, days, stated)
    levels = (noise_of_repeats if repeats > 1 else noise_of_residuals)(seen)
    assert isinstance(levels, NoiseLevels)
    assert levels.p < 1e-3
    (factors,) = levels.factors
    of_day = np.array([factors.get(day, 1.0) for day in ("mon", "tue", "wed")])
    np.testing.assert_allclose(of_day[2] / of_day[:2], 4.0, rtol=0.35)
    if stated and repeats == 1:
        (doubt,) = levels.doubts(seen.data, seen.device)
        assert (doubt.session, doubt.believed) == ("wed", False)
        assert "session wed, 0.03 mm per axis, is 4" in doubt.statement
        assert doubt.statement.endswith("Correct sigma, unless the robot repeated worse then.")
        settled = seen.weighed(levels.sigma(seen.data, seen.device))
        assert settled.noise.discrepancy[METRE] == 0
        assert seen.noise.discrepancy[METRE] > SIGMA


@pytest.mark.parametrize(("repeats", "stated"), [(1, True), (1, False), (2, True)])
def test_a_loose_marker_is_told_from_the_others(repeats, stated):
    """Fails if the noise of one marker is shared by all, is not sized, is a session's, or nobody is told to look at it."""
    seen = seen_by_markers(4.0, repeats, stated, days)
    levels = (noise_of_repeats if repeats > 1 else noise_of_residuals)(seen)
    assert (levels.label, levels.p < 1e-3) == ("marker", True)
    (factors,) = levels.factors
    of_marker = np.array([factors.get(name, 1.0) for name in "ABC"])
    np.testing.assert_allclose(of_marker[1] / of_marker[::2], 4.0, rtol=0.35)
    if stated and repeats == 1:
        (doubt,) = levels.doubts(seen.data, seen.device)
        assert (doubt.session, doubt.marker, doubt.believed) == ("", "B", False)
        assert doubt.statement.startswith("The stated noise for marker B, 0.03 mm per axis, is ")
        assert doubt.statement.endswith("Correct sigma, unless that marker does not sit firmly.")


@pytest.mark.parametrize("stated", [True, False])
def test_a_loose_marker_does_not_widen_what_is_promised_of_the_others(stated):
    """Fails if rows of one marker are promised the noise of another, or its own is forgotten as the noise is not known."""
    seen = seen_by_markers(4.0, stated=stated)
    levels = levels_of_residuals(seen)
    settled = seen.weighed(levels.sigma(seen.data, seen.device))
    sigma = replace(settled.device, sigma=settled.noise.sigma / levels.factor(seen.data))
    devices = levels.devices(series_noise(sigma, seen.data), seen.data)
    calibrated = CalibratedModel(
        settled.model, settled.fit.estimate, settled.covariance, settled.fit.at_bound, devices,
        settled.noise.discrepancy, settled.fit.loss, settled.errors,
    )  # fmt: skip
    promised = np.sqrt(calibrated.promised_variance(seen.data, METRE).mean(axis=1))
    of_marker = [float(np.mean(promised[seen.data.labels("marker") == name])) / SIGMA for name in "ABC"]
    # What the fit alone tells is the harmonic mean of the variances.
    quiet = 1.1 * (1 if stated else (3 / (2 + 1 / 4**2)) ** 0.5)
    np.testing.assert_allclose(of_marker, [quiet, 4.1, quiet], rtol=0.2)


@pytest.mark.parametrize("stated", [True, False])
def test_rows_further_off_are_promised_their_own_noise(stated):
    """Fails if noise that grows with range is promised alike near and far, as where nobody stated one."""
    seen = fitted(1, none, lambda r: 1e-5 + 2e-5 * r, stated=stated)
    settled = seen.weighed(noise_of_residuals(seen).sigma(seen.data, seen.device))
    grown = noise_of_residuals(seen).levelled(settled)
    sigma = replace(settled.device, sigma=np.full(len(seen.data), np.median(settled.noise.sigma)))
    calibrated = CalibratedModel(
        settled.model, settled.fit.estimate, settled.covariance, settled.fit.at_bound,
        grown.devices(series_noise(sigma, seen.data), seen.data), settled.noise.discrepancy, settled.fit.loss, settled.errors,
    )  # fmt: skip
    promised = np.sqrt(calibrated.promised_variance(seen.data, METRE).mean(axis=1))
    distance = seen.data.table["range"].to_numpy()
    far = distance > np.quantile(distance, 0.9)
    assert np.mean(promised[far] / (1e-5 + 2e-5 * distance[far])) == pytest.approx(1.0, abs=0.15)
    elsewhere = replace(seen.data, table=seen.data.table.drop(columns="range"))
    np.testing.assert_allclose(calibrated.noise(elsewhere).sigma, np.median(settled.noise.sigma))


def test_markers_of_the_same_noise_are_not_told_apart():
    """Fails if chance differences between markers, or a session in which one of them was seen alone, change the noise of any."""

    def of_b(table):
        return np.where(table["marker"] == "B", "tue", "mon")

    for seed in range(54, 58):
        levels = levels_of_residuals(seen_by_markers(1.0, stated=bool(seed % 2), seed=seed))
        assert levels is None or levels.p > 0.01
    levels = levels_of_residuals(seen_by_markers(4.0, stated=True, session=of_b))
    assert levels.label == "session"


def test_sessions_of_the_same_noise_are_not_told_apart():
    """Fails if chance differences between days change the noise of any."""
    for stated in (True, False):
        levels = levels_of_residuals(fitted(1, none, lambda table: SIGMA + 0 * table["range"].to_numpy(), days, stated))
        assert levels is None or levels.p > 0.01


def test_a_misfit_where_one_session_measured_is_not_its_noise():
    """Fails if what the model lacks in one region is put down to the device, as only one day measured there."""

    def far_out(table):
        return np.where(table["q1"] > 0.3, "mon", "tue")

    def rough(table):
        beyond = np.maximum(table["q1"] - 0.2, 0.0) * np.sin(3 * table["q2"] + 2 * table["q3"])
        return 4e-4 * np.outer(beyond, [0.0, 0.6, 0.8])

    seen = fitted(1, rough, lambda table: SIGMA + 0 * table["range"].to_numpy(), far_out, True)
    assert seen.noise.discrepancy[METRE] > SIGMA
    assert levels_of_residuals(seen) is None


@pytest.mark.parametrize("axis", range(3))
def test_a_device_noisier_along_one_axis_is_no_joint_that_does_not_repeat(axis):
    """Fails if the depth of a camera, which scatters more than its image, is told as a joint that moves the tool that way."""
    assert_no_joint(axis, seed=axis)


def assert_no_joint(axis: int, seed: int) -> None:
    """A device that is noisier along an axis is told as no joint; benchmarks/slow has the other draws."""
    rng = np.random.default_rng(seed)
    seen = fitted(1, lambda table: 4 * SIGMA * rng.standard_normal((len(table), 1)) * np.eye(3)[axis])
    assert not Standstills.of(seen, BackgroundBasis.of(seen)).at_rest(2e-3)
