"""The verdict: what each finding may be called, how surely, and what it cannot be told from.

The likeliest rivals are fitted in the place of the causes that were found. The models in reach of what was found are its causes
with some of them left out or exchanged, and one added, each as probable as the verdicts on them say.

A cause's amplitude is one figure for its parameters, and how sure that is whatever its form. A cause that is certain goes into the
model that goes back to the robot: it is named, and its amplitude is not none beside what else the model errs by. Of the others
those stay suspicions with which training poses left out in turn are missed no less than without: what is right where poses were
fitted can be wrong at all others. A cause of the measuring device goes back to no robot: it stays, to keep its error off the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations
from types import MappingProxyType
from typing import Generic, Literal

import casadi as ca
import numpy as np
import scipy

from calflow.diagnosis.extension import Extended
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.regressors import H
from calflow.diagnosis.screening import Catalogue, Score, by_place
from calflow.diagnosis.stepwise import REACH, WITHIN, Detection
from calflow.effects.base import UNEXPLAINED, Cause, NamedCause
from calflow.estimation.calibrated_model import MANY, Alternative
from calflow.files.deferred import pd
from calflow.files.tables import column, to_frame

# Of the evidence against it: the form of what nobody can name is itself a guess (Grünwald and van Ommen 2017).
TEMPERED = 0.5
CERTAIN = 1.96  # standard deviations of a 95 % interval

Status = Literal["named", "one_of"]


@dataclass(frozen=True)
class Rival(Generic[H]):
    """What else could explain the data: an effect's id and its joint (0 for none); cost is relative to the finding's.

    score is of its best variant in the finding's place, None where the data could not test it; needs is what that would take.
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


@dataclass(frozen=True)
class Verdict(Generic[H]):
    """A finding with its status, the probability of its cause at its part, and its rivals, the nearest first."""

    finding: Detection[H]
    status: Status
    probability: float
    rivals: tuple[Rival[H], ...]

    @property
    def others(self) -> tuple[Rival[H], ...]:
        """The rivals without its own effect at other parts of one place: a tool and a marker on it may sag side by side."""
        own = (self.finding.cause.id, self.finding.cause.joint)
        return tuple(rival for rival in self.rivals if (rival.id, rival.joint) != own)

    @property
    def of_effect(self) -> float:
        """The probability of its effect at its joint, at whichever part."""
        return self._of_all(lambda own, other: other == own)

    @property
    def of_family(self) -> float:
        """The probability of its family at its joint, whichever member it is."""
        return self._of_all(NamedCause.covers)

    def _of_all(self, alike: Callable[[NamedCause, NamedCause], bool]) -> float:
        cause, evidence = self.finding.cause, by_place(self.finding.scores)
        costs = [(best.cause.id, best.cause.joint, cost - evidence[cause.place][0]) for cost, best in evidence.values()]
        costs += [(rival.id, rival.joint, rival.cost) for rival in self.rivals if rival.score is None]
        own = NamedCause(cause.id, cause.joint)
        summed = [cost for other, joint, cost in costs if alike(own, NamedCause(other, joint))]
        return self.probability * float(np.exp(-np.array(summed) / 2).sum())

    @property
    def family(self) -> str:
        """The family to name it by where all that it could be are of one family, at one joint; empty otherwise."""
        cause = self.finding.cause
        family = cause.family
        same = all(
            rival.cause is not None and rival.cause.family == family and rival.joint == cause.joint
            for rival in self.rivals
        )
        return family if family and self.rivals and same else ""


def verdict(finding: Detection[H], untestable: Mapping[str, str] = MappingProxyType({})) -> Verdict[H]:
    """Weigh a finding against all rivals in its place by their evidence, the variants of each taken together.

    untestable are ids of what may be behind it and could not be tested, with what that would take: as likely as the finding.
    """
    evidence = by_place(finding.scores)
    cause = finding.cause
    named_cost = evidence[cause.place][0]
    rivals = [
        Rival(best.cause.id, best.cause.joint, cost - named_cost, best)
        for place, (cost, best) in evidence.items()
        if place != cause.place and cost - named_cost < WITHIN
    ]
    tested = {(score.cause.id, score.cause.joint) for score in finding.scores}
    untested = [other for other in dict.fromkeys([*cause.alike, *untestable]) if (other, cause.joint) not in tested]
    rivals += [Rival(other, cause.joint, 0.0, None, untestable.get(other, "")) for other in untested]
    against = TEMPERED * finding.unnamed
    if against < WITHIN:
        rivals.append(Rival(UNEXPLAINED, 0, against, None))
    others = [-(cost - named_cost) / 2 for place, (cost, _) in evidence.items() if place != cause.place]
    others += [0.0] * len(untested) + [_log_odds_of_nothing(finding)]
    probability = 1 / (1 + float(np.exp(others).sum()))
    ordered = tuple(sorted(rivals, key=lambda rival: rival.cost))
    return Verdict(finding, "one_of" if ordered else "named", probability, ordered)


def _log_odds_of_nothing(finding: Detection) -> float:
    """How much likelier than the finding's place it is that no cause acts there, in the logarithm.

    Either nothing does, before the data as likely as all places together, or what nobody can name; that never counts for more
    than the finding.
    """
    places = by_place(finding.scores)
    return float(
        np.logaddexp(
            places[finding.cause.place][0] / 2 + np.log(len(places)), -max(TEMPERED * finding.unnamed, 0.0) / 2
        )
    )


def label(cause: str, joint: int) -> str:
    """Name a cause with its joint, if it has one."""
    return NamedCause(cause, joint).label


LEAST = 0.02  # probability below which a rival moves no interval
MOST_FITTED = 4  # that are fitted: the likeliest


def fitted_alternatives(
    verdicts: Sequence[Verdict], final: Fitted, suspected: Sequence[Verdict] = ()
) -> tuple[Alternative, ...]:
    """Fit the likeliest rivals in the causes' places, one at a time; a rival that could not be tested has no model.

    What is suspected, and not in the model to be used, and its rivals are alternatives besides.
    """
    asked: list[tuple[float, Cause | None, Cause | None]] = [
        (_probability(verdict, rival), verdict.finding.cause, rival.cause)
        for verdict in verdicts
        for rival in verdict.rivals
        if rival.cause is not None or rival.id == UNEXPLAINED
    ]
    for verdict in suspected:
        asked.append((verdict.probability, None, verdict.finding.cause))
        asked += [
            (_probability(verdict, rival), None, rival.cause) for rival in verdict.rivals if rival.cause is not None
        ]
    likeliest = sorted((other for other in asked if other[0] >= LEAST), key=lambda other: -other[0])[:MOST_FITTED]
    alternatives = []
    for probability, gone, rival in likeliest:
        stay = [verdict.finding.cause for verdict in verdicts if verdict.finding.cause != gone]
        come = [rival] if rival is not None and rival not in stay else []
        fit = final.fit_with([*stay, *come])
        alternatives.append(Alternative(fit.model, fit.estimate, probability, gone, next(iter(come), None)))
    return tuple(alternatives)


def _probability(verdict: Verdict, rival: Rival) -> float:
    """The rival's share, as the verdict weighs it: what could not be tested never counts for more than the cause."""
    cost = rival.cost if rival.cause else max(rival.cost, 0.0)
    return float(verdict.probability * np.exp(-cost / 2))


MOST_IN_REACH = 24  # models: the likeliest
Change = Literal["found", "without", "instead", "besides", "several"]


@dataclass(frozen=True)
class ModelInReach:
    """A model in reach by its causes: what was found, less some causes, with others in their places, or with one more.

    log_prior is the logarithm of its prior probability, over that of a model without causes, log_weight that of how probable it
    is, prior and evidence, over what was found.
    """

    causes: tuple[Cause, ...]
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
    """Return the models in reach, that to be used first, then the likeliest; none of nothing found.

    suspected are the findings that are not in the model to be used; beside are the scores of all candidates of the catalogue that
    the final model does not have.

    Before the data each place of the catalogue that they can show is a cause with odds of one to the number of these places,
    and its forms share them evenly: one cause is to be expected of the whole catalogue, however large it is. What is in the place
    of one cause says nothing of what is in another's. Causes of very many parameters stay as they are in all models.
    """
    small = [finding for finding in findings if _is_small(finding.cause)]
    if not small:
        return ()
    places = float(np.log(len(rivals_shown(findings, beside))))

    def log_prior(causes: Sequence[Cause]) -> float:
        return -sum(places + float(np.log(catalogue.variants.get(cause.place, 1))) for cause in causes)

    models = [ModelInReach(final.causes, "found", log_prior(final.causes), 0.0)]
    for choices in (*map(_in_its_place, small), _besides(beside, places)):
        chosen = [_changed(model, choice) for model in models for choice in choices]
        models += [model for model in chosen if model.log_weight > -REACH and _differ(model.causes)]
        models = [models[0], *sorted(models[1:], key=lambda model: -model.log_weight)[: MOST_IN_REACH - 1]]
    if suspected:
        used = models[0]
        for finding in suspected:
            used = replace(_changed(used, _in_its_place(finding)[-1]), change="without")
        models = [used, *(model for model in models if set(model.causes) != set(used.causes))]
    return tuple(replace(model, log_prior=log_prior(model.causes)) for model in models)


def rivals_shown(findings: Sequence[Detection[Cause]], beside: Sequence[Score[Cause]]) -> dict[tuple[str, str], Cause]:
    """Return the places that the data show, in place of what was found or beside it, each with a cause there."""
    scores = [*beside, *(score for finding in findings for score in finding.scores)]
    return {score.cause.place: score.cause for score in scores}


@dataclass(frozen=True)
class _Choice:
    """A step from what was found: a cause goes, another comes (None for none); log_weight is that of the step."""

    change: Change
    goes: Cause | None
    comes: Cause | None
    log_weight: float


def _in_its_place(finding: Detection[Cause]) -> list[_Choice]:
    """Return what else may be in a finding's place: a rival, another form, or nothing; relative to the form that was found."""
    cause, cost = finding.cause, finding.own.cost
    forms = (cost - by_place(finding.scores)[cause.place][0]) / 2
    others = [
        _Choice("instead", cause, score.cause, (cost - score.cost) / 2)
        for score in finding.scores
        if score.cause != cause and _is_small(score.cause)
    ]
    return [*others, _Choice("without", cause, None, forms + _log_odds_of_nothing(finding))]


def _besides(beside: Sequence[Score[Cause]], places: float) -> list[_Choice]:
    """Return what may act besides: what a form costs is in the evidence already, what a place costs is not."""
    return [
        _Choice("besides", None, score.cause, -score.cost / 2 - places) for score in beside if _is_small(score.cause)
    ]


def _changed(model: ModelInReach, choice: _Choice) -> ModelInReach:
    come = [choice.comes] if choice.comes else []
    places = [come if cause == choice.goes else [cause] for cause in model.causes]
    causes = (*chain.from_iterable(places), *(come if choice.goes is None else []))
    change: Change = choice.change if model.change == "found" else "several"
    return ModelInReach(causes, change, 0.0, model.log_weight + choice.log_weight)


def _differ(causes: Sequence[Cause]) -> bool:
    """Whether no two causes are forms of the same thing."""
    return not any(cause.place == other.place and cause.same_form(other) for cause, other in combinations(causes, 2))


def _is_small(cause: Cause) -> bool:
    return cause.n_parameters <= MANY


def probabilities(models: Sequence[ModelInReach]) -> np.ndarray:
    """Return how probable each model is if one of them is right, (n_models,)."""
    return np.asarray(scipy.special.softmax([model.log_weight for model in models])) if models else np.zeros(0)


ONLY = "-"  # instead of the form of a cause that has no other


@dataclass(frozen=True, kw_only=True)
class ModelRow:
    """A model that may be right, by its causes, the likeliest first. No row: diagnose found nothing that may be something else."""

    model: int = column("its number; 1 is what was found")
    change: Change = column(
        "what makes it: as found, without a cause, with one instead of another, with one besides, or several of these"
    )
    causes: tuple[str, ...] = column("ids of its causes; empty: none")
    joints: tuple[int, ...] = column("the joint or link of each; 0: none")
    parts: tuple[str, ...] = column("the part of the robot that each is a cause of")
    details: tuple[str, ...] = column("the form of each, in words; -: it has only one", separator="; ")
    log_evidence: float = column("logarithm of the data's probability under it, over that of what diagnose found")
    log_prior: float = column("logarithm of its prior probability, over that of a model without causes")
    probability: float = column("that it is right, if one of these models is")


@dataclass(frozen=True, kw_only=True)
class CauseProbability:
    """A cause of any of these models, the likeliest first."""

    cause: str = column("id of the effect")
    joint: int | None = column("number of its joint or link; empty: none")
    part: str = column("the part of the robot")
    probability: float = column(
        "that it acts, in whatever form and beside whatever else, if one of these models is right"
    )
    found: bool = column("whether diagnose put it into the model")


def models_table(models: Sequence[ModelInReach]) -> pd.DataFrame:
    """Return the table of `ModelRow`s of the models in reach, what was found first."""
    rows = [
        ModelRow(
            model=number, change=model.change, causes=tuple(cause.id for cause in model.causes),
            joints=tuple(cause.joint for cause in model.causes), parts=tuple(cause.part for cause in model.causes),
            details=tuple(cause.detail or ONLY for cause in model.causes),
            log_evidence=model.log_weight - model.log_prior + models[0].log_prior, log_prior=model.log_prior,
            probability=float(probability),
        )
        for number, (model, probability) in enumerate(zip(models, probabilities(models), strict=True), start=1)
    ]  # fmt: skip
    return to_frame(sorted(rows, key=lambda row: -row.probability), ModelRow)


def cause_table(models: Sequence[ModelInReach]) -> pd.DataFrame:
    """Return the table of `CauseProbability`s of the models in reach, what was found first."""
    acting = {cause.place: cause for model in reversed(models) for cause in reversed(model.causes)}
    rows = []
    for place, cause in reversed(acting.items()):
        having = np.array([any(other.place == place for other in model.causes) for model in models])
        rows.append(
            CauseProbability(
                cause=cause.id, joint=cause.joint or None, part=cause.part,
                probability=float(probabilities(models)[having].sum()), found=bool(having[0]),
            )
        )  # fmt: skip
    return to_frame(sorted(rows, key=lambda row: -row.probability), CauseProbability)


def amplitude(cause: Cause, values: np.ndarray, covariance: np.ndarray) -> tuple[float, float]:
    """Return one figure for a cause's parameters, and its standard deviation; a single parameter keeps its sign."""
    if len(values) == 1:
        return float(values[0]), float(np.sqrt(covariance[0, 0]))
    p = ca.SX.sym("p", len(values))
    size = cause.effect.size(p)
    figure, slope = (
        np.array(output).ravel() for output in ca.Function("size", [p], [size, ca.gradient(size, p)])(values)
    )
    return float(figure[0]), float(np.sqrt(slope @ covariance @ slope))


def found_amplitude(finding: Detection, fitted: Fitted) -> tuple[float, float]:
    """Return a found cause's amplitude in the final model, and its standard deviation whatever its form may be.

    Another form in its place (another order, say) can explain the data as well with another amplitude. Each form counts by its
    evidence (Bayesian model averaging: Hoeting et al. 1999), about the estimate of the best one.
    """
    cause = finding.cause
    columns = fitted.model.columns(cause)
    estimate, sd = amplitude(cause, fitted.fit.estimate[columns], fitted.covariance[np.ix_(columns, columns)])
    if sd == 0:
        return estimate, sd  # at a bound
    forms = [score for score in finding.scores if score.cause.place == cause.place]
    others = [s for s in forms if s.cause != cause and same_quantities(s.cause, cause)]
    least = min(score.cost for score in forms)
    variances, weights = [sd**2], [np.exp((least - finding.own.cost) / 2)]
    for score in others:
        other, other_sd = amplitude(score.cause, score.estimate, score.covariance)
        variances.append(other_sd**2 + (other - estimate) ** 2)
        weights.append(np.exp((least - score.cost) / 2))
    return estimate, float(np.sqrt(np.average(variances, weights=weights)))


def same_quantities(cause: Cause, other: Cause) -> bool:
    """Whether the parameters of two forms of a cause mean the same."""
    first, second = ([(p.symbol, p.unit) for p in form.declared] for form in (cause, other))
    return first == second


@dataclass(frozen=True)
class DeployedCauses:
    """The model to be used, None where that is the identified one as it is, the verdicts on its causes, and on those left out."""

    fitted: Fitted | None
    deployed: tuple[Verdict, ...]
    suspected: tuple[Verdict, ...] = ()


def deployed_causes(extended: Extended, verdicts: Sequence[Verdict], identified_misses: float) -> DeployedCauses:
    """Leave out the robot's causes that are not worth it, the one that explains least first; each by what is missed without it.

    Args:
        extended: the model with all causes.
        verdicts: on its causes, the one that explains most first.
        identified_misses: root mean square distance [m] by which the identified model misses poses left out; nan: not known.
    """
    now = DeployedCauses(extended.fitted, tuple(verdicts))
    misses = extended.fitted.left_out.at_new_poses
    of_robot = [verdict for verdict in reversed(verdicts) if not verdict.finding.cause.of_device()]
    for doubtful in [verdict for verdict in of_robot if not is_certain(verdict, extended.fitted)]:
        stay = tuple(verdict for verdict in now.deployed if verdict is not doubtful)
        fewer = extended.fitted.with_causes([verdict.finding.cause for verdict in stay]) if stay else None
        misses_then = fewer.left_out.at_new_poses if fewer else identified_misses
        if misses_then <= misses:
            now, misses = DeployedCauses(fewer, stay, (doubtful, *now.suspected)), misses_then
    return now


def is_certain(verdict: Verdict, fitted: Fitted) -> bool:
    """Whether a cause is named, and its size is not none, as sure as that is beside the errors left and whatever its form."""
    estimate, sd = found_amplitude(verdict.finding, fitted)
    return verdict.status == "named" and abs(estimate) > CERTAIN * sd
