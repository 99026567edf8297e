"""Deployed causes: which go into the model that goes back to the robot.

A cause that is certain goes in: it is named, and its size is told from none beside what else the model errs by. Of the others
those stay suspicions with which training poses left out in turn are missed no less than without: what is right where poses were
fitted can be wrong at all others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from calflow.diagnosis.amplitude import found_amplitude
from calflow.diagnosis.extension import Extended
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.verdict import Verdict

CERTAIN = 1.96  # standard deviations of a 95 % interval


@dataclass(frozen=True)
class DeployedCauses:
    """The model to be used, None where that is the identified one as it is, the verdicts on its causes, and on those left out."""

    fitted: Fitted | None
    deployed: tuple[Verdict, ...]
    suspected: tuple[Verdict, ...] = ()


def deployed_causes(extended: Extended, verdicts: Sequence[Verdict], identified_misses: float) -> DeployedCauses:
    """Leave out the causes that are not worth it, the one that explains least first; each by what is missed without it.

    Args:
        extended: the model with all causes.
        verdicts: on its causes, the one that explains most first.
        identified_misses: root mean square distance [m] by which the identified model misses poses left out; nan: not known.
    """
    now = DeployedCauses(extended.fitted, tuple(verdicts))
    misses = extended.fitted.left_out.at_new_poses
    for doubtful in [one for one in reversed(verdicts) if not is_certain(one, extended.fitted)]:
        stay = tuple(one for one in now.deployed if one is not doubtful)
        fewer = extended.fitted.with_causes([one.finding.cause for one in stay]) if stay else None
        misses_then = fewer.left_out.at_new_poses if fewer else identified_misses
        if misses_then <= misses:
            now, misses = DeployedCauses(fewer, stay, (doubtful, *now.suspected)), misses_then
    return now


def is_certain(verdict: Verdict, fitted: Fitted) -> bool:
    """Whether a cause is named, and its size is not none, as sure as that is beside the errors left and whatever its form."""
    estimate, sd = found_amplitude(verdict.finding, fitted)
    return verdict.status == "named" and abs(estimate) > CERTAIN * sd
