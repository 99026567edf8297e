"""The remainder: structure that no cause of the catalogue explains, and which inputs it depends on.

Decoys are smooth functions of the inputs without a physical meaning. They are tested as causes are, with a family of
their own; what passes is reported as unexplained, never as a cause.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import comb

import numpy as np
from scipy.stats import chi2

from calflow.diagnosis.screening.screening import MATERIAL, Screening
from calflow.diagnosis.search.background import functions
from calflow.diagnosis.search.decoys import Decoy, decoys
from calflow.diagnosis.search.fitted import Fitted
from calflow.effects import Effect

MOST_PARTS = 3  # unexplained dependences that are told
POSE = "pose"  # as an input: what changes from pose to pose in no way that another input explains


@dataclass(frozen=True)
class Remainder:
    """A dependence that no cause explains: its inputs, the chance of anything like it where nothing is left, and its functions.

    share is its part of chi²: as of a cause, less than MATERIAL is of no use to anybody, however many rows show it.
    """

    inputs: tuple[str, ...]
    p: float
    share: float
    functions: tuple[Effect, ...]
    detail: str = ""


def remainder(
    fitted: Fitted, significance: float, rng: np.random.Generator, say: Callable[[str], None]
) -> list[Remainder]:
    """Return what the fitted model leaves that depends on inputs, the strongest first.

    Single functions are tested first, which a sharp dependence shows best; then the background as a whole.
    """
    found: list[Remainder] = []
    for one in (*_single(fitted, rng), *_together(fitted), *_of_poses(fitted)):
        if one.p >= significance or one.share < MATERIAL or len(found) == MOST_PARTS:
            continue
        if not any(set(one.inputs) & set(other.inputs) for other in found):
            found.append(one)
            say(f"left over, by {' and '.join(one.inputs)}: p = {one.p:.2g}")
    return found


def _single(fitted: Fitted, rng: np.random.Generator) -> list[Remainder]:
    screening = Screening(replace(fitted, background=None).regressors(decoys(fitted)))
    family = screening.family(rng)
    tested = []
    for score in screening.scores:
        decoy = score.cause.effect
        assert isinstance(decoy, Decoy)
        tested.append(Remainder(decoy.inputs, family.p(score), score.share, (score.cause,), score.cause.detail))
    return sorted(tested, key=lambda one: one.p)


def _together(fitted: Fitted) -> list[Remainder]:
    """The background as a whole, paying for every choice of as many parts.

    Twice the logarithm of the likelihood is chi² of as many degrees of freedom or fewer: half of each size's distribution is at
    nothing, where it can go no further (Self and Liang 1987).
    """
    left = fitted.background
    if left is None:
        return []
    known, n = dict(functions(fitted)), len(left.inputs)
    p = comb(left.tried, n) * 0.5**n * float(chi2.sf(left.gain, n))
    inputs = tuple(dict.fromkeys(name for part in left.inputs for name in part))
    share = -float(np.expm1(-left.gain / fitted.fit.residual.size))
    return [Remainder(inputs, min(1.0, p), share, tuple(effect for part in left.inputs for effect in known[part]))]


def _of_poses(fitted: Fitted) -> list[Remainder]:
    """What the rows of a pose share: its markers err alike."""
    regressors = fitted.alone
    if regressors.shared == 1:
        return []
    return [Remainder((POSE,), regressors.shared_p, 1 - regressors.shared**2, ())]
