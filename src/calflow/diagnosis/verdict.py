"""The verdict: what each finding may be called, how surely, and what it cannot be told from.

The likeliest rivals are fitted in the place of the causes that were found.

A cause's amplitude is one figure for its parameters, and how sure that is whatever its form. A cause that is certain goes into the
model that goes back to the robot: it is named, and its amplitude is not none beside what else the model errs by. Of the others
those stay suspicions with which training poses left out in turn are missed no less than without: what is right where poses were
fitted can be wrong at all others. A cause of the measuring device goes back to no robot: it stays, to keep its error off the rest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Generic, Literal

import casadi as ca
import numpy as np

from calflow.diagnosis.extension import Extended
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.regressors import H
from calflow.diagnosis.screening import Score, by_place
from calflow.diagnosis.stepwise import WITHIN, Detection
from calflow.effects.base import UNEXPLAINED, Cause, NamedCause
from calflow.estimation.calibrated_model import Alternative

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
    """A finding with its status, probability and rivals, the nearest first."""

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
    others += [0.0] * len(untested) + [log_odds_of_nothing(finding)]
    probability = 1 / (1 + float(np.exp(others).sum()))
    ordered = tuple(sorted(rivals, key=lambda rival: rival.cost))
    return Verdict(finding, "one_of" if ordered else "named", probability, ordered)


def log_odds_of_nothing(finding: Detection) -> float:
    """Return how much likelier than the finding's place it is that no cause acts there, in the logarithm.

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
