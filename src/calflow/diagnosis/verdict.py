"""The verdict on each finding: its status, the probability of its cause, and the rivals that the data do not exclude.

A certain cause goes into the model to be used. Any other of the robot remains suspected unless it lowers the leave-one-pose-out
error, since what is right at the fitted poses can be wrong at all others. A cause of the measuring device is not applied to the
robot: it stays in the model, to keep its error out of the other parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Generic, Literal

import numpy as np

from calflow.diagnosis.amplitude import found_amplitude
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.regressors import H, Hypothesis, Place
from calflow.diagnosis.screening import Score
from calflow.diagnosis.stepwise import WITHIN
from calflow.diagnosis.trial import Detection
from calflow.effects.cause import Cause
from calflow.effects.wording import UNEXPLAINED, NamedCause
from calflow.estimation.variance_components import TEMPERED

Status = Literal["named", "one_of"]


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
        return sum(self.of_rival(rival) for rival in self.rivals if rival.id == UNEXPLAINED)

    def of_rival(self, rival: Rival[H]) -> float:
        """Return the probability of one of its rivals; of one that could not be tested never more than the cause's."""
        cost = rival.cost if rival.cause else max(rival.cost, 0.0)
        return float(self.probability * np.exp(-cost / 2))

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
    own, against, others = finding.cause.place, TEMPERED * finding.unnamed, in_its_place(finding, untestable)
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


def in_its_place(finding: Detection[H], untestable: Collection[str]) -> list[tuple[H | Untested | None, float]]:
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
