"""The verdict on each finding: its status, the probability of its cause, and the rivals that the data do not exclude.

The models in reach are the causes found with some left out or exchanged, or one added, with probabilities by the verdicts.
A certain cause goes into the model to be used. Any other of the robot remains suspected unless it lowers the leave-one-pose-out
error, since what is right at the fitted poses can be wrong at all others. A cause of the measuring device is not applied to the
robot: it stays in the model, to keep its error out of the other parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from itertools import chain, combinations, islice
from types import MappingProxyType
from typing import Generic, Literal

import casadi as ca
import numpy as np
import scipy

from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.regressors import H, Hypothesis, Place
from calflow.diagnosis.screening import Catalogue, Score
from calflow.diagnosis.stepwise import REACH, WITHIN
from calflow.diagnosis.trial import Detection
from calflow.effects.cause import Cause
from calflow.effects.wording import UNEXPLAINED, NamedCause
from calflow.estimation.calibrated_model import MANY, Alternative
from calflow.estimation.leverage import UNSURE
from calflow.estimation.needed_conditions import depended_on
from calflow.estimation.variance_components import TEMPERED
from calflow.model import Model

CERTAIN = 1.96  # standard deviations of a 95 % interval
INTERVAL = np.array([0.025, 0.975])  # quantiles at the ends of a 95 % interval
DRAWS = 4000  # sizes drawn for an interval

Status = Literal["named", "one_of"]
NEGLIGIBLE = 0.02  # probability below which a rival does not affect intervals
MOST_FITTED = 4  # rivals that are fitted, the likeliest
MOST_IN_REACH = 24  # models, the likeliest
SIZE = "its size; of an angle error curve its root mean square over the measured travel, between readings included"


@dataclass(frozen=True)
class Rival(Generic[H]):
    """Another explanation of a finding: an effect's id and its joint (0 for none); cost is relative to the finding's.

    score is that of its best variant in the finding's place, None where it could not be tested; needs says what a test would take.
    """

    id: str
    joint: int
    cost: float
    score: Score[H] | None
    needs: str = ""

    @property
    def cause(self) -> H | None:
        """The best variant, if it could be tested."""
        return self.score.cause if self.score else None


@dataclass(frozen=True, kw_only=True)
class Verdict(Detection[H]):
    """A finding with its status, the probability of its cause at its part, and its rivals, the likeliest first."""

    status: Status
    probability: float
    rivals: tuple[Rival[H], ...]

    @property
    def others(self) -> tuple[Rival[H], ...]:
        """The rivals except its own effect at other parts of the same joint: a tool and a marker on it may both sag."""
        own = named(self.cause)
        return tuple(rival for rival in self.rivals if named(rival) != own)

    @property
    def of_effect(self) -> float:
        """The probability of its effect at its joint, at whichever part."""
        return self._of_all(lambda own, other: other == own)

    @property
    def of_family(self) -> float:
        """The probability of its family at its joint, whichever member it is."""
        return self._of_all(NamedCause.covers)

    @property
    def of_unnamed(self) -> float:
        """The probability, by the evidence, of an unnamed error in its place."""
        return sum(_probability(self, rival) for rival in self.rivals if rival.id == UNEXPLAINED)

    def _of_all(self, alike: Callable[[NamedCause, NamedCause], bool]) -> float:
        own = named(self.cause)
        costs = [(named(best.cause), cost - self.cost) for cost, best in self.places.values()]
        costs += [(named(rival), rival.cost) for rival in self.rivals if rival.score is None]
        summed = [cost for other, cost in costs if alike(own, other)]
        return self.probability * float(np.exp(-np.array(summed) / 2).sum())

    @property
    def among_kin(self) -> bool:
        """Whether it has a family and rivals, all of which are of that at its joint."""
        own = self.cause.family, self.cause.joint
        kin = [rival for rival in self.rivals if rival.cause and (rival.cause.family, rival.joint) == own]
        return bool(own[0] and kin) and len(kin) == len(self.rivals)


def verdict(finding: Detection[H], untestable: Mapping[str, str] = MappingProxyType({})) -> Verdict[H]:
    """Return the verdict on a finding, from the evidence of all rivals in its place, variants of each taken together.

    untestable holds ids of possible causes that could not be tested, with what a test would take.
    """
    own, against, others = finding.cause.place, TEMPERED * finding.unnamed, _in_its_place(finding, untestable)
    near = [(cost - finding.cost, best) for place, (cost, best) in finding.places.items() if place != own]
    rivals = [Rival(best.cause.id, best.cause.joint, cost, best) for cost, best in near if cost < WITHIN]
    untested = (other for other, _ in others if isinstance(other, Untested))
    rivals += [Rival(other.id, other.joint, 0.0, None, untestable.get(other.id, "")) for other in untested]
    if against < WITHIN:
        rivals.append(Rival(UNEXPLAINED, 0, against, None))
    odds = [log_odds for other, log_odds in others if other is None or other.place != own]
    probability = 1 / (1 + float(np.exp(odds).sum()))
    ordered = tuple(sorted(rivals, key=lambda rival: rival.cost))
    found = {field.name: getattr(finding, field.name) for field in fields(Detection)}
    return Verdict(**found, status="one_of" if ordered else "named", probability=probability, rivals=ordered)


def no_surer_than_its_size(finding: Detection[Cause], fitted: Fitted) -> Detection[Cause]:
    """Return a finding in whose place an unnamed error costs no more than its amplitudes' distance from zero, squared (Wald).

    Their deviations include all smooth errors, of which the search knows a part: what may be zero beside these is not certain.
    """
    columns = fitted.model.columns(finding.cause)
    if fitted.fit.at_bound[columns].all():
        return finding
    distance = fitted.fit.from_zero(columns, fitted.covariance)
    return replace(finding, unnamed=min(finding.unnamed, distance / TEMPERED))


def _in_its_place(finding: Detection[H], untestable: Collection[str]) -> list[tuple[H | Untested | None, float]]:
    """Return what may be in a finding's place with its log odds: other candidates, what was not tested (ids), and None, the last.

    None is nothing, a priori as probable as all places together, or an unnamed error, which never counts more than the finding.
    """
    cause, tested = finding.cause, {(score.cause.id, score.cause.joint) for score in finding.scores}
    others = [other for other in dict.fromkeys([*cause.alike, *untestable]) if (other, cause.joint) not in tested]
    unnamed = -max(TEMPERED * finding.unnamed, 0.0) / 2
    return [
        *((score.cause, (finding.cost - score.cost) / 2) for score in finding.scores if score.cause != cause),
        *((Untested(other, cause.joint, cause.part), 0.0) for other in others),
        (None, float(np.logaddexp(finding.cost / 2 + np.log(len(finding.places)), unnamed))),
    ]


def named(cause: Hypothesis | Rival) -> NamedCause:
    """Return the id of a cause, or of a rival, with its joint."""
    return NamedCause(cause.id, cause.joint)


def fitted_alternatives(
    verdicts: Sequence[Verdict], final: Fitted, suspected: Sequence[Verdict] = (), in_reach: Sequence[ModelInReach] = ()
) -> tuple[Alternative, ...]:
    """Return models with the likeliest rivals fitted in the causes' places, one at a time, except untestable rivals.

    Forms of a cause by other conditions of a row are rivals too. Suspected causes and their rivals are further alternatives, as are
    probable causes beside those found: too small to be named for certain, they shift predictions all the same.
    """
    every = [*((verdict, verdict.cause) for verdict in verdicts), *((suspect, None) for suspect in suspected)]
    asked: list[tuple[float, Cause | None, Cause | None]] = [
        (_probability(verdict, rival), gone, rival.cause)
        for verdict, gone in every
        for rival in verdict.rivals
        if rival.cause is not None
    ]
    asked += [
        (probability, verdict.cause, form)
        for verdict in verdicts
        for probability, form in _forms_by_other_conditions(verdict, final.model)
    ]
    # How well an unnamed error explains the data, its form being a guess, says which is likelier, but not by how much. One that is
    # left beside a cause is another one, of which smooth errors say how large it may be elsewhere.
    asked += [
        ((verdict.probability + verdict.of_unnamed) / 2, verdict.cause, None)
        for verdict in verdicts
        if UNEXPLAINED in {rival.id for rival in verdict.rivals}
    ]
    asked += [(suspect.probability, None, suspect.cause) for suspect in suspected]
    asked += [
        (probability, None, came)
        for model, probability in zip(in_reach, probabilities(in_reach).tolist(), strict=True)
        if model.change == "besides" and probability > UNSURE and isinstance(came := model.causes[-1], Cause)
    ]
    likeliest = sorted((other for other in asked if other[0] >= NEGLIGIBLE), key=lambda other: -other[0])[:MOST_FITTED]
    alternatives = []
    for probability, gone, rival in likeliest:
        stay = [verdict.cause for verdict in verdicts if verdict.cause != gone]
        come = [rival] if rival is not None and rival not in stay else []
        fit = final.fit_with([*stay, *come])
        alternatives.append(Alternative(fit.model, fit.estimate, probability, gone, next(iter(come), None)))
    return tuple(alternatives)


def _forms_by_other_conditions(verdict: Verdict, model: Model) -> list[tuple[float, Cause]]:
    """Return the best form of a cause by each other set of a row's conditions, with the probability of all forms by these.

    Forms by the same conditions agree wherever these were measured; others agree with them only for as long as their conditions
    change together, as the temperature and the time do while an arm warms up.
    """
    forms = [(verdict.probability * np.exp((verdict.cost - score.cost) / 2), score.cause) for score in verdict.scores
             if score.cause.place == verdict.cause.place]  # fmt: skip
    by_conditions: dict[tuple[str, ...], list[tuple[float, Cause]]] = {}
    for probability, form in forms:
        if probability >= NEGLIGIBLE:
            conditions = tuple(depended_on(replace(model, effects=(form,))))
            by_conditions.setdefault(conditions, []).append((float(probability), form))
    others = [group for group in by_conditions.values() if all(form != verdict.cause for _, form in group)]
    return [(sum(probability for probability, _ in group), max(group, key=lambda form: form[0])[1]) for group in others]


def _probability(verdict: Verdict, rival: Rival) -> float:
    """Return the rival's probability by the verdict; one that could not be tested never counts more than the cause."""
    cost = rival.cost if rival.cause else max(rival.cost, 0.0)
    return float(verdict.probability * np.exp(-cost / 2))


@dataclass(frozen=True)
class Untested:
    """A cause that the data could not test, where one was found that it cannot be told from: id, joint (0 for none) and part."""

    id: str
    joint: int
    part: str

    detail = "not tested"

    @property
    def place(self) -> Place:
        return self.id, self.part


Change = Literal["found", "without", "instead", "besides", "several"]
Others = list[tuple[Cause | Untested | None, float]]  # what may come, None: nothing, with its log odds


@dataclass(frozen=True)
class ModelInReach:
    """A model in reach, by its causes: those found, less some, with others in their places, or with one more.

    log_prior is its log prior probability relative to a model without causes, log_weight its log posterior probability relative to
    the model found.
    """

    causes: tuple[Cause | Untested, ...]
    change: Change
    log_prior: float
    log_weight: float


def models_in_reach(
    final: Fitted,
    findings: Sequence[Detection[Cause]],
    beside: Sequence[Score[Cause]],
    catalogue: Catalogue,
    suspected: Sequence[Detection[Cause]] = (),
) -> tuple[ModelInReach, ...]:
    """Return the models in reach, the one to be used first, then by probability; empty without findings.

    suspected are findings that are not in use; beside are the scores of all candidates that the final model lacks. A priori each
    place that the data can show holds a cause with odds of one to the number of such places, shared evenly by its forms: one is
    expected of the whole catalogue, however large. Causes of very many parameters do not come besides.
    """
    if not findings:
        return ()
    places = float(np.log(len(rivals_shown(findings, beside))))

    def log_prior(causes: Sequence[Cause | Untested]) -> float:
        return -sum(places + float(np.log(catalogue.variants.get(cause.place, 1))) for cause in causes)

    models = [ModelInReach(final.causes, "found", log_prior(final.causes), 0.0)]
    # The prior of a form is in the evidence already, that of a place is not.
    besides: Others = [(score.cause, -score.cost / 2 - places) for score in beside if score.cause.n_parameters <= MANY]
    instead: list[tuple[Cause, Others]] = []
    for finding in findings:
        forms = (finding.own.cost - finding.cost) / 2  # log odds of its place against its form
        others = _in_its_place(finding, catalogue.untestable(finding.cause.id))
        instead.append((finding.cause, [(comes, log_odds + forms) for comes, log_odds in others]))
    for goes, others in (*instead, (None, besides)):
        near = [(model, *other) for model in models for other in others if model.log_weight + other[1] > -REACH]
        near.sort(key=lambda change: -(change[0].log_weight + change[2]))
        every = (_changed(model, goes, comes, log_odds) for model, comes, log_odds in near)
        likeliest = islice((model for model in every if _differ(model.causes)), MOST_IN_REACH)
        models[1:] = sorted([*models[1:], *likeliest], key=lambda model: -model.log_weight)[: MOST_IN_REACH - 1]
    if suspected:
        used = models[0]
        for cause, others in instead:
            if cause in {finding.cause for finding in suspected}:
                used = replace(_changed(used, cause, *others[-1]), change="without")
        models = [used, *(model for model in models if set(model.causes) != set(used.causes))]
    return tuple(replace(model, log_prior=log_prior(model.causes)) for model in models)


def rivals_shown(findings: Sequence[Detection[Cause]], beside: Sequence[Score[Cause]]) -> dict[Place, Cause]:
    """Return the places that the data can show, in place of a finding or beside it, each with a cause there."""
    scores = [*beside, *(score for finding in findings for score in finding.scores)]
    return {score.cause.place: score.cause for score in scores}


def _changed(model: ModelInReach, goes: Cause | None, comes: Cause | Untested | None, log_odds: float) -> ModelInReach:
    """Return a model with one cause in the place of another, with one besides (goes None), or without one (comes None)."""
    come = [comes] if comes else []
    places = [come if cause == goes else [cause] for cause in model.causes]
    causes = (*chain.from_iterable(places), *(come if goes is None else []))
    change: Change = "without" if comes is None else "besides" if goes is None else "instead"
    return ModelInReach(causes, change if model.change == "found" else "several", 0.0, model.log_weight + log_odds)


def _differ(causes: Sequence[Cause | Untested]) -> bool:
    """Whether no two causes are forms of the same cause."""
    untested = [cause for cause in causes if isinstance(cause, Untested)]
    tested = [cause for cause in causes if isinstance(cause, Cause)]
    shared = len({cause.place for cause in tested}) < len(tested)  # hardly ever: forms are compared then alone
    twice = shared and any(cause.same_form(other) for cause, other in combinations(tested, 2))
    return not twice and len(set(untested)) == len(untested)


def probabilities(models: Sequence[ModelInReach]) -> np.ndarray:
    """Return the probability of each model if one of them is right, (n_models,)."""
    return np.asarray(scipy.special.softmax([model.log_weight for model in models])) if models else np.zeros(0)


@dataclass(frozen=True)
class Amplitude:
    """A cause's size as one figure, with its standard deviation and the ends of its 95 % interval."""

    estimate: float
    sd: float
    low: float
    high: float

    @staticmethod
    def of_squares(estimate: float, sd: float) -> Amplitude:
        """Return a root of a sum of squares, which is approximately a scaled chi² variable (Satterthwaite 1946)."""
        freedom = (estimate / sd) ** 2 / 2
        low, high = estimate * np.sqrt(scipy.stats.chi2.ppf(INTERVAL, freedom) / freedom)
        return Amplitude(estimate, sd, float(low), float(high))

    @property
    def differs_from_zero(self) -> bool:
        """Whether zero is further than CERTAIN standard deviations: the ends of a length's interval exclude it always."""
        return abs(self.estimate) > CERTAIN * self.sd


def amplitude(cause: Cause, values: np.ndarray, covariance: np.ndarray) -> tuple[float, float]:
    """Return one figure for a cause's parameters, and its standard deviation; a single parameter keeps its sign."""
    (figure,), (slope,) = sizes(cause, values[None])
    return float(figure), float(np.sqrt(slope @ covariance @ slope))


def sizes(cause: Cause, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the size of a cause for values of its parameters (n, n_parameters), as findings state it, (n,), and its gradient."""
    if values.shape[1] == 1:
        return values[:, 0], np.ones(values.shape)
    figures, slopes = _size(cause)(values.T)
    return np.array(figures).ravel(), np.array(slopes).T


@lru_cache(maxsize=1024)
def _size(cause: Cause) -> ca.Function:
    """Return a cause's parameters -> its size and gradient; cached, as each form of each finding is asked several times."""
    p = ca.SX.sym("p", cause.n_parameters)
    size = cause.size_of(p)
    return ca.Function("size", [p], [size, ca.gradient(size, p)])


def found_amplitude(finding: Detection, fitted: Fitted) -> Amplitude:
    """Return a found cause's amplitude in the final model, with deviation and interval over all its forms.

    Each form is weighted by its evidence (Bayesian model averaging: Hoeting et al. 1999). The interval is that of sizes drawn from
    the posterior: a length is not normal about its estimate, nor are two forms of different amplitudes.
    """
    cause = finding.cause
    columns = fitted.model.columns(cause)
    own = fitted.fit.estimate[columns], fitted.covariance[np.ix_(columns, columns)]
    estimate, sd = amplitude(cause, *own)
    if sd == 0:
        return Amplitude(estimate, sd, estimate, estimate)  # at a bound
    forms = [(finding.own.cost, cause, *own)]
    for score in finding.scores:
        if score.cause.place == cause.place and score.cause != cause and same_quantities(score.cause, cause):
            forms.append((score.cost, score.cause, *score.likeliest))
    shares = scipy.special.softmax([-cost / 2 for cost, *_ in forms])
    rng, drawn, square = np.random.default_rng(0), list[np.ndarray](), 0.0
    for share, (_, form, values, covariance) in zip(shares, forms, strict=True):
        other, other_sd = amplitude(form, values, covariance)
        square += share * (other_sd**2 + (other - estimate) ** 2)
        if number := round(DRAWS * share):
            drawn.append(sizes(form, rng.multivariate_normal(values, covariance, number, method="eigh"))[0])
    low, high = np.quantile(np.concatenate(drawn), INTERVAL)
    return Amplitude(estimate, float(np.sqrt(square)), float(low), float(high))


def same_quantities(cause: Cause, other: Cause) -> bool:
    """Whether the parameters of two forms of a cause have the same symbols and units."""
    first, second = ([(p.symbol, p.unit) for p in form.declared] for form in (cause, other))
    return first == second


def deployed_model(extended: Fitted, verdicts: Sequence[Verdict]) -> Fitted | None:
    """Return the model without uncertain causes of the robot, the last first, that do not lower the leave-one-pose-out error.

    None where no cause is left: the identified model is then used as it is.
    """
    used: Fitted | None = extended
    deployed, misses = verdicts, extended.left_out.of_new_measurements
    of_robot = [verdict for verdict in reversed(verdicts) if not verdict.cause.of_measuring()]
    for doubtful in [verdict for verdict in of_robot if not is_certain(verdict, extended)]:
        stay = [verdict for verdict in deployed if verdict is not doubtful]
        fewer = extended.with_causes([verdict.cause for verdict in stay])
        # Without any cause the model is the identified one, as identify fits it.
        misses_then = (fewer if stay else fewer.sharing()).left_out.of_new_measurements
        if misses_then <= misses:
            used, deployed, misses = fewer if stay else None, stay, misses_then
    return used


def is_certain(verdict: Verdict, fitted: Fitted) -> bool:
    """Whether a cause is named, and its amplitude differs significantly from zero, averaged over its forms."""
    return verdict.status == "named" and found_amplitude(verdict, fitted).differs_from_zero
