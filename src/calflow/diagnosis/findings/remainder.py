"""The remainder: structure that no cause of the catalogue explains, and which inputs it depends on.

Decoys are smooth functions of the inputs without a physical meaning. They are tested as causes are, with a family of
their own; what passes is reported as unexplained, never as a cause.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calflow.diagnosis.screening.screening import Family, Score, Screening
from calflow.diagnosis.search.decoys import Decoy, decoys
from calflow.diagnosis.search.fitted import Fitted

MOST_PARTS = 3  # unexplained dependences that are told


@dataclass(frozen=True)
class Remainder:
    """A dependence that no cause explains: its inputs, its score among the decoys, and their family."""

    inputs: tuple[str, ...]
    score: Score
    family: Family

    @property
    def p(self) -> float:
        """The chance of anything like this among the decoys where nothing is left."""
        return self.family.p(self.score)


def remainder(
    fitted: Fitted, significance: float, rng: np.random.Generator, say: Callable[[str], None]
) -> list[Remainder]:
    """Return what the fitted model leaves that depends on inputs, the strongest first."""
    screening = Screening(replace(fitted, background=None).regressors(decoys(fitted)))
    family = screening.family(rng)
    found: list[Remainder] = []
    for score in sorted(screening.scores, key=family.p):
        assert isinstance(score.cause.effect, Decoy)
        inputs = score.cause.effect.inputs
        if family.p(score) >= significance or len(found) == MOST_PARTS:
            break
        if not any(set(inputs) & set(other.inputs) for other in found):
            found.append(Remainder(inputs, score, family))
            say(f"left over, by {' and '.join(inputs)}: p = {found[-1].p:.2g}")
    return found
