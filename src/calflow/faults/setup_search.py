"""The search for a single mistake in robot file, table or set-up.

Every kind of mistake is a candidate of the same form: what undoes it, its prior probability, and the marginal likelihood of the
positions once it is undone. The most probable one is reported together with those that explain the positions as well.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from calflow.effects.geometry import PLACED_BOUND
from calflow.faults.base import ROBOT, Correction, Fault
from calflow.faults.changed_setup import causes_of_loads, gravity_elsewhere, loads_late, set_up_anew
from calflow.faults.implausible import MIN_POSES, nominal_misfit
from calflow.faults.mistake import Mistake, freed, loads, misplaced, mistakes
from calflow.faults.reference import Reference
from calflow.faults.rough import FAR_BETTER, level, motion
from calflow.faults.setup import PHYSICS, SINGLE, SUSPECT_SCALE, ExplainedSetup, Setup
from calflow.files.problems import refuse
from calflow.measurements.measurements import Measurements, spaced

SCREENED = 60  # rows by which set-ups are placed, with the links as stated
PLACED, FITTED = 20, 8  # set-ups that are placed, and of these fitted
MIN_LOG_ODDS = np.log(1e3)  # odds by which a mistake must explain more than none, and another one less
NO_WORSE = 1.2  # times the size of errors as read that may be left
MOST_GROSS = 0.2  # share of the rows that may be grossly off all the same
MAX_REPORTED = 3  # that are told beside each other


@dataclass(frozen=True)
class PossibleMistake:
    """A mistake, the robot without it, and the logarithm of how probable positions and mistake are together."""

    mistake: Mistake
    explanation: ExplainedSetup
    evidence: float

    @property
    def statement(self) -> str:
        """What is wrong and what is asked for."""
        words, cure = self.mistake.words, self.mistake.cure
        return (words if isinstance(words, str) else words(self.explanation)) + (f"; {cure}" if cure else "")


def setup_faults(data: Measurements, reference: Reference) -> tuple[Fault, ...]:
    """Return the mistake of robot file, table or set-up that the positions show, if any.

    Mistakes of loads compete with the causes of the catalogue that act by loads, too.

    Raises:
        InputError: it is for the user to settle, and no fit can do without.
    """
    setup, as_read = reference.setup, reference.setup.explained
    if setup.poses < MIN_POSES:
        return ()
    of_figures, of_changes, of_loads = [], [], [*loads_late(data, as_read)]
    if as_read.suspicious:
        of_figures = [*misplaced(data, setup), *_met(data, setup)]
    if reference.fit.scale > PHYSICS or reference.gross.any():
        of_loads += [*loads(data, setup), *gravity_elsewhere(as_read)]
        of_changes = [*set_up_anew(data, as_read)]
    candidates = _explaining(as_read, [*of_figures, *of_changes])
    if explaining := _explaining(as_read, of_loads):
        candidates += explaining + _explaining(as_read, causes_of_loads(data, as_read))
    return _told(as_read, _alike(candidates))


def _told(as_read: ExplainedSetup, candidates: Sequence[PossibleMistake]) -> tuple[Fault, ...]:
    """Return the fault that candidates are: corrected where there is one and it is the table's, else for the user to settle.

    Where the best is a cause of the robot there is none.

    Raises:
        InputError: it is for the user to settle, and no fit can do without.
    """
    if not candidates or candidates[0].mistake.where == ROBOT:
        return ()
    mistake, statement = candidates[0].mistake, candidates[0].statement
    where = " or ".join(dict.fromkeys(candidate.mistake.where for candidate in candidates[:MAX_REPORTED]))
    if len(candidates) == 1 and mistake.corrections:
        statement = f"{statement}; put right here"
        return (Fault(mistake.id, mistake.joint, (), statement, "corrected", mistake.corrections, where),)
    if len(candidates) > 1:
        several = "; or ".join(
            f"({k}) {candidate.statement}" for k, candidate in enumerate(candidates[:MAX_REPORTED], start=1)
        )
        more = f"; or {len(candidates) - MAX_REPORTED} more" if len(candidates) > MAX_REPORTED else ""
        statement = f"one of these explains the positions, and the others as well: {several}{more}"
    if as_read.elsewhere.max(initial=0.0) > PLACED_BOUND or nominal_misfit(as_read.setup):
        raise refuse(f"robot file and measurements do not belong together, and no fit can correct it: {statement}")
    statement = f"{statement}; settle this first: nothing else is named before"
    return (Fault(mistake.id, mistake.joint, (), statement, "unsettled", (Correction(0),), where),)


def _met(data: Measurements, setup: Setup) -> list[Mistake]:
    """Return the mistakes without which base and tool can be placed so that the links, as stated, meet the positions."""
    few = setup.at(data, spaced(setup.numbers, SCREENED))
    discrete = [*mistakes(data, setup)]
    without = [mistake.undo(few).registered.rigid for mistake in discrete]
    points = np.stack([undone.points() for undone in without])
    positions = np.stack([undone.position for undone in without])
    error = level(motion(points, positions)[2])
    nearest = np.argsort(error)[:PLACED]
    explained = [(without[k].explained, discrete[k]) for k in nearest]
    explained += [(mistake.undo(few).rigid.explained, mistake) for mistake in freed(data, setup)]
    explained.sort(key=lambda pair: -(pair[0].evidence + pair[1].log_prior))
    return [mistake for _, mistake in explained[:FITTED]]


def _explaining(as_read: ExplainedSetup, thought_of: Iterable[Mistake]) -> list[PossibleMistake]:
    """Return the mistakes without which a robot explains far more than as it is read."""
    explained = [(mistake, mistake.undo(as_read.setup).restated.registered.explained) for mistake in thought_of]
    most = min(max(SUSPECT_SCALE, as_read.fit.scale / FAR_BETTER), NO_WORSE * as_read.fit.scale)
    # Rows that alone are off are what a mistake must bring back.
    most_gross = MOST_GROSS if as_read.fit.scale > SUSPECT_SCALE else SINGLE
    return [
        PossibleMistake(mistake, explanation, explanation.evidence + mistake.log_prior)
        for mistake, explanation in explained
        if explanation.fit.scale < most
        and explanation.gross < most_gross
        and explanation.log_odds(as_read) + mistake.log_prior > MIN_LOG_ODDS
    ]


def _alike(candidates: Sequence[PossibleMistake]) -> list[PossibleMistake]:
    """Return the candidates that explain as much as the best, the best first."""
    least = max((candidate.evidence for candidate in candidates), default=0.0) - MIN_LOG_ODDS
    return sorted((c for c in candidates if c.evidence > least), key=lambda candidate: -candidate.evidence)
