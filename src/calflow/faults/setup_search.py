"""The search for a mistake in robot file or table: which single one explains the positions, and what else explains as much."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from calflow.effects.geometry import PLACED_BOUND
from calflow.faults.base import ROBOT, Correction, Fault
from calflow.faults.implausible import nominal_misfit
from calflow.faults.mistake import Mistake, freed, misplaced, mistakes
from calflow.faults.rough import FAR_BETTER, PLACED_SD, level, motion
from calflow.faults.setup import ExplainedSetup, Setup
from calflow.files.problems import refuse
from calflow.measurements.measurements import Measurements

FEWEST = 8  # poses: fewer are met by placing base and tool
SCREENED = 60  # rows by which set-ups are placed, with the links as stated
SUSPECT, SUSPECT_SCALE = 4.0, 1e-3  # standard deviations, and a scale [m], that no robot of its maker's figures has
SINGLE = 0.05  # share of the rows that may be grossly off by themselves; of few poses a robust fit leaves out those that tell
PLACED, FITTED = 20, 8  # set-ups that are placed, and of these fitted
SURE = np.log(1e3)  # odds by which a mistake must explain more than none, and another one less
NO_WORSE = 1.2  # times the size of errors as read that may be left
MOST_GROSS = 0.2  # share of the rows that may be grossly off all the same
MOST = 3  # that are told beside each other


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


def setup_faults(data: Measurements, setup: Setup) -> tuple[Fault, ...]:
    """Return the mistake of robot file or table, where the positions say that there is one.

    Raises:
        InputError: it is for the user to settle, and no fit can do without.
    """
    if setup.poses < FEWEST or not suspicious(setup.explained):
        return ()
    thought_of = [*misplaced(data, setup), *_met(setup, [*mistakes(data, setup)], [*freed(data, setup)])]
    return told(setup.explained, alike(setup.explained, thought_of))


def told(as_read: ExplainedSetup, candidates: tuple[PossibleMistake, ...]) -> tuple[Fault, ...]:
    """Return the fault that candidates are: corrected where there is one and it is the table's, else for the user to settle.

    Where the best is a cause of the robot there is none.

    Raises:
        InputError: it is for the user to settle, and no fit can do without.
    """
    if not candidates or candidates[0].mistake.where == ROBOT:
        return ()
    mistake, statement = candidates[0].mistake, candidates[0].statement
    where = " or ".join(dict.fromkeys(candidate.mistake.where for candidate in candidates[:MOST]))
    if len(candidates) == 1 and mistake.corrections:
        statement = f"{statement}; put right here"
        return (Fault(mistake.id, mistake.joint, (), statement, "corrected", mistake.corrections, where),)
    if len(candidates) > 1:
        several = "; or ".join(f"({k}) {candidate.statement}" for k, candidate in enumerate(candidates[:MOST], start=1))
        more = f"; or {len(candidates) - MOST} more" if len(candidates) > MOST else ""
        statement = f"one of these explains the positions, and the others as well: {several}{more}"
    if as_read.elsewhere.max(initial=0.0) > PLACED_BOUND or nominal_misfit(as_read.setup):
        raise refuse(f"robot file and measurements do not belong together, and no fit can correct it: {statement}")
    statement = f"{statement}; settle this first: nothing else is named before"
    return (Fault(mistake.id, mistake.joint, (), statement, "unsettled", (Correction(0),), where),)


def suspicious(as_read: ExplainedSetup) -> bool:
    """Whether a robot, fitted as it is read, is farther from what its maker says than robots are, or from more than single rows."""
    fit = as_read.fit
    deviation = np.abs(fit.deviations[fit.expected.sd < PLACED_SD]).max(initial=0.0)
    several = (as_read.error > fit.gross).mean() > SINGLE
    return bool(deviation > SUSPECT or fit.scale > SUSPECT_SCALE or several)


def _met(setup: Setup, discrete: list[Mistake], free: list[Mistake]) -> list[Mistake]:
    """Return the mistakes without which base and tool can be placed so that the links, as stated, meet the positions."""
    few = setup.part(SCREENED)
    without = [mistake.undo(few).registered.rigid for mistake in discrete]
    points = np.stack([undone.points() for undone in without])
    positions = np.stack([undone.position for undone in without])
    error = level(motion(points, positions)[2])
    nearest = np.argsort(error)[:PLACED]
    explained = [(without[k].explained, discrete[k]) for k in nearest]
    explained += [(mistake.undo(few).rigid.explained, mistake) for mistake in free]
    explained.sort(key=lambda pair: -(pair[0].evidence + pair[1].log_prior))
    return [mistake for _, mistake in explained[:FITTED]]


def alike(as_read: ExplainedSetup, thought_of: Iterable[Mistake]) -> tuple[PossibleMistake, ...]:
    """Return the mistakes without which a robot explains far more than as it is read, best first, and as much as the best."""
    explained = [(mistake, mistake.undo(as_read.setup).restated.registered.explained) for mistake in thought_of]
    most = min(max(SUSPECT_SCALE, as_read.fit.scale / FAR_BETTER), NO_WORSE * as_read.fit.scale)
    # Rows that alone are off are what a mistake must bring back.
    most_gross = MOST_GROSS if as_read.fit.scale > SUSPECT_SCALE else SINGLE
    candidates = [
        PossibleMistake(mistake, explanation, explanation.evidence + mistake.log_prior)
        for mistake, explanation in explained
        if explanation.fit.scale < most
        and (explanation.error > explanation.fit.gross).mean() < most_gross
        and explanation.log_odds(as_read) + mistake.log_prior > SURE
    ]
    least = max((candidate.evidence for candidate in candidates), default=0.0) - SURE
    return tuple(sorted((c for c in candidates if c.evidence > least), key=lambda candidate: -candidate.evidence))
