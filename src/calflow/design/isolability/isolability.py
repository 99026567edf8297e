"""Isolability: which causes a plan of poses would show, and from which others it would tell each, before anything is measured.

Of every cause at a stated size many measurements are drawn, as the linearised model and the noise say, and all causes are
tested and weighed as diagnose does it: the best that passes is the finding, and whatever is near it is in the finding's set. The
share of them in which the cause is in that set is the chance that it is seen, the share in which besides a rival is not is the
chance that it is told from that.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from calflow.design.isolability.visits import Visits
from calflow.design.planned import Planned
from calflow.diagnosis.findings.verdict import WITHIN
from calflow.diagnosis.screening.catalogue import Catalogue
from calflow.diagnosis.screening.family import Family
from calflow.diagnosis.screening.hypothesis import H
from calflow.diagnosis.screening.regressors import Candidate, Products, Regressors, candidates_of
from calflow.diagnosis.screening.screening import Screening
from calflow.diagnosis.screening.tall_matrix import Held
from calflow.diagnosis.search.acceptance import FALSE_ALARM, SHARES
from calflow.effects import Effect
from calflow.effects.cause import Cause
from calflow.estimation.probing import probed
from calflow.measurements.measurements import Measurements
from calflow.model import Model, stated

DRAWS = 400  # measurements drawn of each cause: a chance of 0.9 is known to 0.015
FORMS = 20  # of a cause, drawn among its variants
BUILT = 0.4  # of priors' standard deviations: how far the fitted parameters of real robots are off (UR10 0.2, FANUC 0.4, UR5 1.1)
Place = tuple[str, str]  # effect and part


@dataclass(frozen=True, eq=False)
class Isolability:
    """Of each place of a cause the chance that it is seen, and of each pair (true, rival) that the one is seen and told.

    causes has a form of each place, lacking what a test of an effect needs, untold the ids of what no data of this kind tell from
    a place, and what that would take (empty: another sensor or load).
    """

    causes: Mapping[Place, Cause]
    seen: Mapping[Place, float]
    told: Mapping[tuple[Place, Place], float]
    lacking: Mapping[str, str]
    untold: Mapping[Place, Mapping[str, str]]


def isolability(
    effects: Sequence[str],
    planned: Planned,
    visits: Visits,
    rng: np.random.Generator,
    *,
    size: float = 1.0,
    false_alarm: float = FALSE_ALARM,
    holdout: float = 0.0,
    seed: int = 1,
    draws: int = DRAWS,
) -> Isolability:
    """Return what a plan can tell of causes besides effects that are fitted.

    Args:
        effects: ids of what is fitted anyway.
        planned: how each pose will be measured.
        visits: which poses, with what on and beside the robot.
        rng: draws causes and noise.
        size: of each cause, in its usual size: the root mean square of its parameters, in their priors' standard deviations.
        false_alarm: chance that diagnose finds anything where nothing is hidden.
        holdout: share of the poses that the study holds out, by its seed: diagnose sees the others.
        seed: of the study.
        draws: measurements of each cause.
    """
    screening, catalogue = screened(effects, planned, visits.measurements().split(holdout, seed), rng)
    seen, told = chances(screening, screening.family(rng), SHARES["causes"] * false_alarm, rng, size=size, draws=draws)
    causes = {candidate.cause.place: candidate.cause for candidate in screening.regressors.candidates}
    untold = {place: _untold(cause, catalogue, causes) for place, cause in causes.items()}
    return Isolability(causes, seen, told, catalogue.lacking, untold)


def screened(
    effects: Sequence[str], planned: Planned, data: Measurements, rng: np.random.Generator
) -> tuple[Screening[Cause], Catalogue]:
    """Return the tests of all causes that a plan's measurements will allow, and the catalogue that they are of."""
    train = data.only(data.train)
    catalogue = Catalogue.of(train, effects)
    model = stated(data.robot, effects, train, (planned.observation,))
    return Screening(_regressors(model, planned, train.rows, catalogue.effects, rng)), catalogue


def chances(
    screening: Screening[H],
    family: Family,
    false_alarm: float,
    rng: np.random.Generator,
    *,
    size: float = 1.0,
    draws: int = DRAWS,
    places: Collection[Place] | None = None,
) -> tuple[dict[Place, float], dict[tuple[Place, Place], float]]:
    """Return the chance of each place that it is seen, and of each pair (true, rival) that the one is seen and told.

    false_alarm is that of the whole family of tests; every cause meets the same noise. places are those that may be true, all
    where nothing is said.
    """
    regressors = screening.regressors
    noise = rng.standard_normal((len(regressors.residual), draws))
    pull = BUILT * np.sqrt(regressors.precision)[:, None] * rng.standard_normal((len(regressors.precision), draws))
    still, left = screening.settled(noise, pull)
    forms: dict[Place, list[Candidate[H]]] = {}
    for candidate in regressors.candidates:
        forms.setdefault(candidate.cause.place, []).append(candidate)
    true = {place: own for place, own in forms.items() if places is None or place in places}
    seen = dict.fromkeys(true, 0)
    told = dict.fromkeys(((place, rival) for place in true for rival in forms if rival != place), 0)
    for place, own in true.items():
        tried = [own[k] for k in rng.permutation(len(own))[:FORMS]]
        for candidate, which in zip(tried, np.array_split(np.arange(draws), len(tried)), strict=True):
            truth, columns = amplitudes(candidate, regressors.prior_sd, size, len(which), rng), candidate.columns
            score = still[:, which] - screening.response(columns) @ truth
            chi2 = left[which] - (truth * (still[columns][:, which] + score[columns])).sum(axis=0)
            found = screening.trials(score, chi2, family, false_alarm).by_place()
            if place not in found:  # it does not show in any form
                break
            left_open = _left_open(found)
            seen[place] += int(left_open[place].sum())
            for rival in forms.keys() - {place}:  # what does not show cannot be behind what does
                told[place, rival] += int((left_open[place] & ~left_open.get(rival, np.False_)).sum())
    return {place: n / draws for place, n in seen.items()}, {pair: n / draws for pair, n in told.items()}


def _left_open(found: Mapping[Place, tuple[np.ndarray, np.ndarray]]) -> dict[Place, np.ndarray]:
    """In which draws (n_draws,) a place is among what the finding may be: the best that passes, and all that are near it."""
    bic, passed = (np.array([own[k] for own in found.values()]) for k in (0, 1))
    best = np.where(passed, bic, np.inf).min(axis=0)
    return dict(zip(found, (bic - best < WITHIN) & np.isfinite(best), strict=True))


def amplitudes(
    candidate: Candidate[H], prior_sd: np.ndarray, size: float, number: int, rng: np.random.Generator
) -> np.ndarray:
    """Draw a cause's parameters (n_parameters, number) of one size in any direction, on the side that their bounds allow."""
    direction = rng.standard_normal((len(candidate.columns), number))
    direction *= np.sqrt(len(direction) / (direction**2).sum(axis=0))
    drawn = size * prior_sd[candidate.columns, None] * direction
    low, high = candidate.cause.bounds[:, :, None]
    return np.asarray(np.clip(np.where((drawn < low) | (drawn > high), -drawn, drawn), low, high))


def _regressors(
    model: Model, planned: Planned, rows: np.ndarray, effects: Sequence[Effect], rng: np.random.Generator
) -> Regressors[Cause]:
    """What every candidate would do to whitened rows (n_conditions, n_rows); the residual is noise, drawn once.

    Joints give way by as much as is usual: some causes show by that alone.
    """
    n = len(model.parameters)
    sd = np.array([parameter.prior_sd for parameter in model.parameters])
    soft = np.array([p.prior_sd if p.effect == "joint-compliance" else 0.0 for p in model.parameters])
    point = model.nominal + soft
    _, matrix = probed(planned.problem(model, point, rows), point, effects)
    jacobian, found, candidates = matrix[:, :n], Held(matrix[:, n:]), candidates_of(effects)
    residual, precision = rng.standard_normal(len(matrix)), sd**-2.0
    products = Products.of(residual, jacobian, found, candidates)
    known = cho_solve(cho_factor(products.fitted + np.diag(precision)), products.fitted)
    prior_sd = np.array([parameter.prior_sd for effect in effects for parameter in effect.declared])
    return Regressors(
        residual, jacobian, precision, np.zeros(n), 0.0, found, prior_sd, candidates, products, float(np.trace(known))
    )  # fmt: skip


def _untold(cause: Cause, catalogue: Catalogue, tested: Mapping[Place, Cause]) -> dict[str, str]:
    """What may be behind a cause and no such data test, or tell from it, with what that would take."""
    there = {(one.id, one.joint) for one in tested.values()}
    alike = {name: "" for name in cause.alike if (name, cause.joint) not in there}
    return alike | catalogue.untestable(cause.id)
