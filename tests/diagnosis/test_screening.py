"""The screening's statistics are what refits and repeated experiments would give."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, kstest

from calflow.diagnosis.linear_model import LinearModel
from calflow.diagnosis.regressors import Background, Regressors
from calflow.diagnosis.screening import Catalogue, Screening
from calflow.diagnosis.stepwise import CauseAcceptance
from calflow.effects import catalogue
from calflow.effects.cause import Cause
from calflow.estimation.fit import fit
from calflow.model import Model, build
from estimation.data import measured, problem
from robots import industrial

TESTED = ("joint-eccentricity", "gear-ratio-error", "bearing-compliance", "joint-compliance")


@pytest.fixture(scope="module")
def data():
    """Sixty poses of a robot whose second joint runs out of true."""
    robot = industrial()
    eccentric = Cause(robot, catalogue()["joint-eccentricity"](robot), "joint2")
    model = Model(robot, (*build(robot, ("geometry",)).effects, eccentric))
    truth = model.nominal.copy()
    truth[-2:] = 1.5e-4, -1e-4
    return measured(model, truth, 60, np.random.default_rng(3))


@pytest.fixture(scope="module")
def fitted(data):
    """The geometry fitted to them, and its problem."""
    asked = problem(build(data.robot, ("geometry",)), data)
    return fit(asked)[0], asked


@pytest.fixture(scope="module")
def regressors(data, fitted):
    """A small catalogue's regressors there."""
    scale = catalogue()["tracker-scale"](data.robot)  # not in the catalogue where no distance between markers is known
    return Regressors.of(*fitted, (*Catalogue.of(data, ("geometry",), TESTED).effects, scale))


def test_a_score_is_what_a_refit_gains(data, fitted, regressors):
    """Breaks if the projection forgets the fit's parameters or the priors: then chi² falls by something else."""
    before, asked = fitted
    scores = {(s.cause.place, s.cause.detail): s for s in Screening.of(regressors).scores}
    for (_, part), detail in ((("joint-eccentricity", "joint2"), "order 1"), (("gear-ratio-error", "joint4"), "")):
        score = next(
            s for (place, d), s in scores.items() if place[1] == part and d == detail and place[0] in TESTED[:2]
        )
        wider = Model(data.robot, (*before.model.effects, score.cause))
        after = fit(asked.on(wider), np.concatenate([before.estimate, score.estimate])[None])[0]
        assert 2 * (before.objective - after.objective) == pytest.approx(score.drop, rel=0.02, abs=0.02)
        own = after.estimate[-len(score.estimate) :]
        np.testing.assert_allclose(own, score.estimate, atol=0.05 * np.sqrt(np.diag(score.covariance)).max())


def test_the_right_cause_scores_best(regressors):
    """Breaks if the evidence does not rank the cause that is there first, or its amplitude is wrong."""
    best = Screening.of(regressors).scores[0]
    assert best.cause.place == ("joint-eccentricity", "joint2")
    np.testing.assert_allclose(best.estimate, [1.5e-4, -1e-4], atol=4 * np.sqrt(np.diag(best.covariance)).max())


def test_many_points_of_a_pose_do_not_hide_what_moves_it(fitted, regressors):
    """Fails if a cause must matter beside the noise of all points that are seen of a pose, or less of one that is seen by one."""
    best, accepted = Screening.of(regressors).scores[0], CauseAcceptance(0.01, 5)
    small = replace(best, share=0.004)
    effects, rng = (best.cause.effect,), np.random.default_rng(2)
    for points, is_material in ((1, False), (2, False), (10, True)):
        poses = np.arange(60) // points
        family = Screening.of(Regressors.of(*fitted, effects, poses)).family(rng)
        assert accepted.accepts(best, family)
        assert accepted.accepts(small, family) == is_material


def test_what_geometry_imitates_is_not_tested(regressors):
    """Breaks if a candidate that the model's own parameters imitate counts as testable."""
    screening = Screening.of(regressors)
    shown = {score.cause.id for score in screening.scores}
    assert "tracker-scale" not in shown
    assert {"joint-eccentricity", "gear-ratio-error", "bearing-compliance"} <= shown


def test_a_swept_model_tests_as_a_new_one_does(regressors):
    """Fails if tests without some parameters, and with candidates as others, are not those of the model that is factored anew."""
    rng = np.random.default_rng(6)
    modes = np.linalg.qr(rng.standard_normal((len(regressors.residual), 3)))[0]
    background = Background((), (), modes, np.ones(len(modes)), 18.0, 8)
    whole = regressors.beside(background, background.weight)
    value = np.array([2e-3, -1e-3])
    pull = whole.pull.copy()
    pull[[1, 4]] = whole.precision[[1, 4]] * value
    tested, none = np.arange(0, len(whole.candidates), 2), np.zeros(0, dtype=int)
    added = whole.candidates[1].columns
    for gone, come in (([1, 4], none), (none, added), ([1, 4], added)):
        estimate = value if len(gone) else np.zeros(0)
        swept = Screening(LinearModel(replace(whole, pull=pull)), tested, np.array(gone), estimate, come)
        anew = {score.cause: score for score in Screening.of(swept.model.regressors).scores}
        assert swept.chi2 == pytest.approx(swept.model.chi2)
        assert swept.degrees_of_freedom == pytest.approx(swept.model.degrees_of_freedom)
        assert swept.scores
        for score in swept.scores:
            other = anew[score.cause]
            assert (score.drop, score.visible_share) == pytest.approx(
                (other.drop, other.visible_share), rel=1e-6, abs=1e-9
            )
            assert score.estimate == pytest.approx(other.estimate, rel=1e-6, abs=1e-12)


def with_residual(r, residual, **changes):
    """The same regressors with another residual."""
    return replace(r, residual=residual, **changes)


def null(regressors, rng):
    """The same linear problem with nothing but noise in it."""
    r = regressors
    noise, pseudo = rng.standard_normal(len(r.residual)), rng.standard_normal(len(r.precision)) * np.sqrt(r.precision)
    factor = np.linalg.cholesky(r.jacobian.T @ r.jacobian + np.diag(r.precision))
    step = np.linalg.solve(factor.T, np.linalg.solve(factor, r.jacobian.T @ noise + pseudo))
    pull = pseudo - r.precision * step
    rss = float((pull**2 / r.precision).sum())
    return with_residual(r, noise - r.jacobian @ step, pull=pull, prior_rss=rss)


def test_p_values_keep_their_promise(regressors):
    """Breaks if a single test's p-value is not uniform, or the family's false alarms are not what was asked for."""
    rng = np.random.default_rng(5)
    family = Screening.of(null(regressors, rng)).family(rng)
    singles, alarms, draws = [], 0, 400
    for _ in range(draws):
        scores = Screening.of(null(regressors, rng)).scores
        singles.append(next(s.p for s in scores if s.cause.place == ("gear-ratio-error", "joint4")))
        alarms += min(family.p(s) for s in scores) < 0.05
    assert kstest(singles, "uniform").pvalue > 1e-3
    assert binom.cdf(alarms, draws, 0.065) > 1e-3
    assert binom.sf(alarms - 1, draws, 0.035) > 1e-3


def test_a_scan_is_paid_for_in_its_own_place(data, fitted):
    """Breaks if the many orders of a periodic error are free, or make causes without a scan pay."""
    effects = Catalogue.of(data, ("geometry",), ("periodic-joint-error", "gear-ratio-error")).effects
    regressors = Regressors.of(*fitted, effects)
    family = Screening.of(null(regressors, np.random.default_rng(6))).family(np.random.default_rng(7))
    assert family.scans["periodic-joint-error", "joint2"] > 10
    assert family.scans["gear-ratio-error", "joint4"] == pytest.approx(1.0, abs=0.35)
    assert family.places < 2 * len(family.scans)


def test_a_wrong_sign_is_no_evidence():
    """Breaks if a compliance that would have to be negative passes for a cause, or stands among another one's rivals."""
    robot = industrial()
    cause = Cause(robot, catalogue()["joint-compliance"](robot), "joint2")
    model = Model(robot, (*build(robot, ("geometry",)).effects, cause))
    found = {}
    for sign in (1, -1):
        truth = np.append(np.zeros(len(model.parameters) - 1), sign * 5e-7)
        data = measured(model, truth, 80, np.random.default_rng(6))
        plain = problem(build(robot, ("geometry",)), data)
        scores = Screening.of(Regressors.of(fit(plain)[0], plain, (cause,))).scores
        found[sign] = scores[0]
    assert found[1].cost < -50
    assert found[-1].p < 1e-6  # there is something
    assert found[-1].estimate == pytest.approx([0.0])
    assert found[-1].cost > 0
