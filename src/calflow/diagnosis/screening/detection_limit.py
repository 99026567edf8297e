"""The detection limit: how large a cause must be for these very data to show it."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq
from scipy.stats import f as f_distribution
from scipy.stats import ncf

from calflow.diagnosis.screening.family import Family
from calflow.diagnosis.screening.score import Score
from calflow.effects.cause import Cause

POWER = 0.95
MOST = 1e5  # squared sigmas


def noncentrality(false_alarm: float, tests: float, degrees_of_freedom: int, left: float) -> float:
    """Return the squared sigmas that an effect must show for its F test to pass 95 times in 100.

    tests is how many it pays for at the family's false_alarm, freedom and left the degrees of freedom. nan where so few are
    left that no effect would.
    """
    single = -np.expm1(np.log1p(-false_alarm) / tests)
    threshold = f_distribution.isf(single, degrees_of_freedom, left)
    if not ncf.sf(threshold, degrees_of_freedom, left, MOST) > POWER:
        return float("nan")
    return float(brentq(lambda shown: ncf.sf(threshold, degrees_of_freedom, left, shown) - POWER, 1e-3, MOST))


def detection_limit(score: Score[Cause], family: Family, false_alarm: float) -> float:
    """Return the least size of a cause, in the unit of its first parameter, that is found 95 times in 100.

    Several parameters are taken in proportion to their priors, in directions that the data show on average.
    """
    declared = score.cause.declared
    sd = np.array([parameter.prior_sd for parameter in declared])
    same = np.array([parameter.unit == declared[0].unit for parameter in declared])
    shown = float(np.diag(score.information) @ sd**2 / (sd[same] @ sd[same]))
    needed = noncentrality(false_alarm, family.tests(score), score.shown, score.left)
    return float(np.sqrt(needed / shown))
