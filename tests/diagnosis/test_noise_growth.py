"""Noise is taken to grow with range where the device's own scatter does, not where the model errs more the further it looks."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from calflow.diagnosis.background import BackgroundBasis
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.noise_growth import growth_of_repeats, growth_of_residuals
from calflow.diagnosis.unexplained import POSE, Standstills, unexplained
from calflow.estimation.accuracy import errors
from calflow.estimation.fit import fit_reweighted
from calflow.estimation.noise import averaged, measured_noise, repeats_scatter
from calflow.model import build
from estimation.data import SIGMA, measured
from robots import industrial


def fitted(repeats, shift, sigma=lambda r: 0 * r + SIGMA):
    """A robot whose points are shifted by a function of joint readings and range, geometry fitted."""
    model = build(industrial(), ("geometry",))
    rng = np.random.default_rng(51)
    data = measured(model, model.nominal, 150, rng, repeats=repeats, sigma=0.0)
    data.table["range"] = np.linalg.norm(data.position - np.array([4.0, 0.0, 0.0]), axis=1)
    noise = sigma(data.table["range"].to_numpy())[:, None] * rng.standard_normal((len(data), 3))
    data.table[["x", "y", "z"]] += noise + shift(data.table)
    model = build(industrial(), ("geometry",), data.given)
    device = measured_noise(data)
    means, device = averaged(data, replace(device, scatter=repeats_scatter(data, errors(model, model.nominal, data))))
    fit, noise, lack, _ = fit_reweighted(model, means, device, model.nominal[None], "linear")
    return Fitted(fit, means, noise, lack, device)


def of_residuals(seen, significance):
    """The growth that residuals tell, unless joints do not repeat beside it."""
    grown = growth_of_residuals(seen)
    beside = seen.weighed(grown.sigma(seen.data, seen.device)) if grown else seen
    joints = Standstills.of(beside, BackgroundBasis.of(seen)).joints
    return grown if grown and grown.p < significance and not len(joints) else None


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
    grown = growth_of_residuals(seen)
    noisier = seen.weighed(grown.sigma(seen.data, seen.device)) if grown else seen
    standstills = Standstills.of(noisier, BackgroundBasis.of(seen))
    at_rest = [standstills.unexplained(k) for k in standstills.joints]
    (left,) = unexplained(seen, 2e-3, np.random.default_rng(1), lambda _: None, at_rest, standstills.background)
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
    assert growth_of_repeats(seen, 1e-3) is None
    assert of_residuals(seen, 1e-3) is None


def test_repeats_tell_the_growth_whatever_the_model_leaves():
    """Fails if a model's error makes the growth look larger, or smaller, than the repeats show it."""
    seen = growth_of_repeats(fitted(2, further, lambda r: 1e-5 + 2e-5 * r), 1e-3)
    assert seen is not None
    assert abs(seen.slope - 2e-5) < 4 * seen.sd < 2.4e-5


def test_residuals_tell_the_growth_where_nothing_was_repeated():
    """Fails if the noise's growth is missed without repeats, or told by residuals where repeats speak."""
    seen = of_residuals(fitted(1, none, lambda r: 1e-5 + 2e-5 * r), 1e-3)
    assert seen is not None
    assert abs(seen.slope - 2e-5) < 4 * seen.sd
    assert growth_of_repeats(fitted(1, none), 1e-3) is None
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
    assert growth_of_residuals(replace(seen, data=replace(seen.data, table=table))) is not None
    days = table.assign(session=np.where(far, "tue", "mon"))
    grown = growth_of_residuals(replace(seen, data=replace(seen.data, table=days)))
    assert grown is None or grown.p > 0.01
