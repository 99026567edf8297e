"""The gate: what a cause must show to be added to the model, and to stay there."""

from __future__ import annotations

from dataclasses import dataclass

from calflow.diagnosis.screening.family import Family
from calflow.diagnosis.screening.score import Score
from calflow.diagnosis.screening.screening import MATERIAL
from calflow.diagnosis.search.linearisation import Finding

FALSE_ALARM = 0.01  # the chance that anything is found where nothing is hidden, unless a study says otherwise
SHARES = {"causes": 0.7, "remainder": 0.2, "noise": 0.1}  # of the false alarms that are allowed


@dataclass(frozen=True)
class Acceptance:
    """What a cause must pass: the chance of a false alarm in the whole family, and how many causes there may be."""

    false_alarm: float
    most: int

    def accepts(self, score: Score, family: Family) -> bool:
        """Whether a candidate pays, matters, and is no accident."""
        return score.delta_bic < 0 and score.share > MATERIAL and family.p(score) < self.false_alarm

    def keeps(self, finding: Finding) -> bool:
        """Whether a cause that is in the model would pass again."""
        own = [score for score in finding.scores if score.cause == finding.cause]
        return bool(own) and self.accepts(own[0], finding.family)
