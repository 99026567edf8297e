"""Two causes at once replace what resembles both."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.diagnosis.regressors import Candidate, Regressors, TallMatrix
from calflow.diagnosis.screening import Family, Screening
from calflow.diagnosis.stepwise import CauseAcceptance, Exchange, Stepwise
from calflow.diagnosis.trial import Screened
from calflow.effects import catalogue
from calflow.effects.cause import Cause
from calflow.estimation.progress import nobody
from calflow.estimation.variance_components import LOG_PRIOR, SIZES
from calflow.linear import Block, LinearProblem, LinearTrial
from diagnosis.test_screening import with_residual
from robots import industrial

ROBOT = industrial()
ROWS, OWN = 300, 5


def causes():
    """Six causes of one parameter, and two of two parameters."""
    ratio, eccentric = catalogue()["gear-ratio-error"](ROBOT), catalogue()["joint-eccentricity"](ROBOT)
    return [
        *(Cause(ROBOT, ratio, f"joint{k + 1}") for k in range(6)),
        *(Cause(ROBOT, eccentric, f"joint{k + 1}") for k in range(2)),
    ]


@pytest.fixture
def regressors():
    """Random ones with noise of one, in which the third cause looks like the first and the second together."""
    rng = np.random.default_rng(1)
    every = causes()
    ends = np.cumsum([0, *(len(cause.declared) for cause in every)])
    matrix = rng.standard_normal((ROWS, ends[-1])) / [*[1e-4] * 6, *[3e-5] * 4]
    matrix[:, 2] = matrix[:, 0] + matrix[:, 1] + 0.8 * matrix[:, 2]
    jacobian = rng.standard_normal((ROWS, OWN))
    residual = rng.standard_normal(ROWS) + matrix[:, 0] * 6e-5 + matrix[:, 1] * 6e-5
    prior_sd = np.array([p.prior_sd for cause in every for p in cause.declared])
    candidates = tuple(
        Candidate(cause, np.arange(i, j)) for cause, i, j in zip(every, ends[:-1], ends[1:], strict=True)
    )
    return Regressors(
        residual, jacobian, np.full(OWN, 0.1), np.zeros(OWN), 0.0, TallMatrix.held(matrix), prior_sd, candidates
    )


FAMILY = Family({}, 30.0)


def chi2(regressors, columns, sizes=()):
    """What a fit with some candidates' columns leaves, by ordinary least squares with the priors of these sizes as rows."""
    whole = np.hstack([regressors.jacobian, regressors.matrix.times(np.eye(regressors.matrix.shape[1]))[:, columns]])
    prior = np.diag(np.sqrt([*regressors.precision, *(regressors.prior_sd[columns] * sizes) ** -2.0]))
    left = np.append(regressors.residual, np.zeros(len(prior)))
    return float(np.linalg.lstsq(np.vstack([whole, prior]), left, rcond=None)[1][0])


def test_a_pair_costs_what_a_fit_of_both_would(regressors):
    """Breaks if what one candidate takes from the other is forgotten, or its columns and priors are mixed up."""
    screening = Screening(regressors)
    exchange = Exchange.of(screening, FAMILY, [causes()[2]])
    found = {frozenset((first.place, second.place)): cost for cost, first, second in exchange.better()}
    before = chi2(regressors, [])
    own = screening.information(np.arange(3)) * np.outer(regressors.prior_sd[:3], regressors.prior_sd[:3])
    sizes, costs = np.empty((2, 3))
    for k in range(3):
        fallen = [(ROWS - OWN) * np.log(chi2(regressors, [k], np.array([size])) / before) for size in SIZES]
        logs = -(np.array(fallen) + np.log1p(own[k, k] * SIZES**2)) / 2
        best = np.argmax(logs + LOG_PRIOR)
        sizes[k], costs[k] = SIZES[best], 2 * (logs[best] - np.log(np.exp(logs + LOG_PRIOR).sum()))
    for first, second in ((0, 1), (0, 2), (1, 2)):
        columns = [first, second]
        places = frozenset(causes()[k].place for k in columns)
        narrowed = np.eye(2) + own[np.ix_(columns, columns)] * np.outer(sizes[columns], sizes[columns])
        fallen = (ROWS - OWN) * np.log(chi2(regressors, columns, sizes[columns]) / before)
        expected = fallen + np.linalg.slogdet(narrowed)[1] + costs[columns].sum()
        if places in found:
            assert found[places] == pytest.approx(expected, abs=0.02)
    assert frozenset(causes()[k].place for k in (0, 1)) in found


def test_what_looks_like_two_gives_way_to_them(regressors):
    """Breaks if the search cannot leave a cause that imitates two others, or leaves two that are right."""
    screening = Screening(regressors)
    assert screening.scores[0].cause == causes()[2]
    _, *best = next(Exchange.of(screening, FAMILY, [causes()[2]]).better())
    assert {cause.place for cause in best} == {causes()[0].place, causes()[1].place}
    assert not list(Exchange.of(screening, FAMILY, [causes()[0], causes()[1]]).better())


@pytest.mark.parametrize(("false_alarm", "proposed"), [(0.01, 1), (1e-300, 0)])
def test_a_pair_is_proposed_where_each_is_significant_beside_the_other(false_alarm, proposed):
    """Breaks if two causes take the place of one although one of them is not significant, or if none ever do."""
    rng = np.random.default_rng(1)
    x = rng.standard_normal((ROWS, 3)) @ [[1, 0, 1], [0, 1, 1], [0, 0, 0.8]]
    blocks = [Block(name, x[:, [k]], 1.0) for k, name in enumerate("abc")]
    residual, design = rng.standard_normal(ROWS) + x @ [0.6, 0.6, 0.0], np.ones((ROWS, 1))
    problem = LinearProblem(residual, design, np.ones(1), tuple(blocks), x, True, None)
    imitating = LinearTrial(Screened((), FAMILY, ROWS - 1), problem, np.random.default_rng(0), (blocks[2],))
    steps = list(Stepwise(CauseAcceptance(false_alarm, 10), rng, nobody, nobody).exchanges(imitating))
    assert [set(step.causes) for step in steps] == [set(blocks[:2])] * proposed


def test_two_causes_of_one_place_stand_as_any_pair_does(regressors):
    """Breaks if two waves of one joint, or two steps of the device, give way to whatever comes first."""
    twice = [Cause(ROBOT, catalogue()["joint-eccentricity"](ROBOT, order=order), "joint1") for order in (1, 2)]
    there = (Candidate(twice[0], np.arange(6, 8)), Candidate(twice[1], np.arange(8, 10)))
    both = regressors.matrix.times(np.eye(regressors.matrix.shape[1]))[:, 6:10] @ np.array([3e-5, 1e-5, -2e-5, 2e-5])
    candidates = (*regressors.candidates[2:6], *there)
    alone = with_residual(regressors, regressors.residual + both, candidates=candidates)
    assert not list(Exchange.of(Screening(alone), FAMILY, twice).better())


def replaced(regressors, residual):
    """The same problem with another residual, which its own parameters have settled on."""
    r = regressors
    step = np.linalg.solve(r.jacobian.T @ r.jacobian + np.diag(r.precision), r.jacobian.T @ residual)
    pull = -r.precision * step
    rss = float((pull**2 / r.precision).sum())
    return with_residual(r, residual - r.jacobian @ step, pull=pull, prior_rss=rss)


def test_one_cause_takes_the_place_of_two_that_imitate_it(regressors):
    """Breaks if two causes that together resemble a third keep it out, or right ones give way to what resembles them."""
    truly = with_residual(
        regressors,
        np.random.default_rng(2).standard_normal(ROWS)
        + regressors.matrix.times(np.eye(regressors.matrix.shape[1]))[:, 2] * 6e-5,
    )
    imitating = Exchange.of(Screening(truly), FAMILY, [causes()[0], causes()[1]])
    assert imitating.alone().cause == causes()[2]
    assert Exchange.of(Screening(regressors), FAMILY, [causes()[0], causes()[1]]).alone() is None
    assert Exchange.of(Screening(truly), FAMILY, [causes()[0]]).alone() is None
