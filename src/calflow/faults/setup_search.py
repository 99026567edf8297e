"""The search for a single mistake in robot file, table or set-up.

Each candidate has an inverse, a prior probability, and the marginal likelihood of the positions once it is undone. The
most probable one is reported together with those that explain the positions equally well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calflow.faults.base import ROBOT, Action, Correction, Fault
from calflow.faults.changed_setup import (
    causes_of_loads,
    gravity_elsewhere,
    loads_late,
    loads_misnamed,
    loads_unknown,
    setup_changes,
)
from calflow.faults.implausible import MIN_POSES, nominal_misfit
from calflow.faults.mistake import LinkDimensions, Mistake, loads, misplaced, mistakes
from calflow.faults.reference import Reference
from calflow.faults.rough import FAR_BETTER, level, motion
from calflow.faults.setup import PHYSICS, SINGLE, SUSPECT_SCALE, FittedSetup, Setup
from calflow.files.problems import refuse
from calflow.measurements.measurements import Measurements, spaced
from calflow.robot.parts import PLACED_BOUND

SCREENED = 60  # rows for screening candidates by rigid registration
PLACED, FITTED = 20, 8  # candidates kept after screening, and after rigid fits
MIN_LOG_ODDS = np.log(1e3)  # odds against no mistake, and against another one
NO_WORSE = 1.2  # largest ratio of remaining errors to those as stated
MOST_GROSS = 0.2  # largest share of rows that may remain gross
MOST_GROSS_BESIDE = 0.5  # the same where all others agree as a robot's do: rows may have a mistake of their own
MAX_REPORTED = 3  # reported together


@dataclass(frozen=True)
class PossibleMistake:
    """A mistake, the fit without it, and the log joint probability of positions and mistake."""

    mistake: Mistake
    explanation: FittedSetup
    evidence: float

    @property
    def statement(self) -> str:
        """The mistake and its remedy, in words."""
        words, remedy = self.mistake.words, self.mistake.remedy
        return (words if isinstance(words, str) else words(self.explanation)) + (f"; {remedy}" if remedy else "")


def setup_faults(data: Measurements, reference: Reference) -> tuple[Fault, ...]:
    """Return the mistake of robot file, table or set-up that the positions show, if any (see `told`).

    Beside an unknown base markers may be displaced, but not beyond the bound of a fit: then they are taken as stated.
    """
    candidates, stated = likeliest_mistakes(data, reference), reference.setup.with_stated_markers
    if not candidates and reference.setup.fitted.shifts(stated).max(initial=0.0) > PLACED_BOUND:
        reference = replace(reference, setup=stated)
        candidates = likeliest_mistakes(data, reference)
    return told(reference, candidates, lambda _: True)


def likeliest_mistakes(data: Measurements, reference: Reference) -> list[PossibleMistake]:
    """Return the mistakes, or causes, that explain the positions equally well, and far better than as stated, the best first.

    Mistakes of payloads compete with the causes of the catalogue that depend on loads.
    """
    setup, as_read = reference.setup, reference.setup.fitted
    if len(setup.seen) < MIN_POSES:
        return []
    of_figures, of_changes = [], []
    misnamed = [*loads_misnamed(data, as_read)]
    of_loads = [*loads_late(data, as_read), *misnamed]
    if as_read.suspicious:
        of_figures = [*misplaced(data, setup), *_screened(data, setup)]
    if reference.fit.scale > PHYSICS or reference.gross.any():
        of_loads += [*loads(data, setup), *gravity_elsewhere(as_read)]
        of_changes = [*setup_changes(data, as_read)]
    candidates = _explaining(as_read, [*of_figures, *of_changes])
    explaining = _explaining(as_read, of_loads)
    named = any(candidate.mistake in misnamed for candidate in explaining)
    explaining += _explaining(as_read, loads_unknown(data, as_read, named))
    if explaining:
        candidates += explaining + _explaining(as_read, causes_of_loads(data, as_read))
    least = max((candidate.evidence for candidate in candidates), default=0.0) - MIN_LOG_ODDS
    return sorted((c for c in candidates if c.evidence > least), key=lambda candidate: -candidate.evidence)


def told(
    reference: Reference, candidates: Sequence[PossibleMistake], corrects: Callable[[Correction], bool]
) -> tuple[Fault, ...]:
    """Return the fault of equally good candidates: corrected if it is a single one with such corrections, else unsettled.

    There is none if the best is a cause of the robot.

    Raises:
        InputError: the user must settle it, and no fit can absorb it.
    """
    if not candidates or candidates[0].mistake.where == ROBOT:
        return ()
    mistake, statement = candidates[0].mistake, candidates[0].statement
    where = " or ".join(dict.fromkeys(candidate.mistake.where for candidate in candidates[:MAX_REPORTED]))
    if len(candidates) == 1 and mistake.corrections and all(map(corrects, mistake.corrections)):
        known = any(made.quantity or made.source for made in mistake.corrections)
        statement = f"{statement}; {'corrected for this run only' if known else 'left out'}"
        action: Action = "corrected" if known else "left out"
        return (Fault(mistake.id, mistake.joint, (), statement, action, mistake.corrections, where),)
    if len(candidates) > 1:
        several = "; or ".join(
            f"({k}) {candidate.statement}" for k, candidate in enumerate(candidates[:MAX_REPORTED], start=1)
        )
        more = f"; or {len(candidates) - MAX_REPORTED} more" if len(candidates) > MAX_REPORTED else ""
        statement = f"each of these explains the positions equally well: {several}{more}"
    if reference.setup.fitted.displacements.max(initial=0.0) > PLACED_BOUND or nominal_misfit(reference.setup):
        raise refuse(f"robot file and measurements do not belong together, and no fit can correct it: {statement}")
    statement = f"{statement}; settle this first: no cause is named until then"
    return (Fault(mistake.id, mistake.joint, (), statement, "unsettled", (Correction(0),), where),)


def _screened(data: Measurements, setup: Setup) -> list[Mistake]:
    """Return the mistakes without which the nominal links, with base and tool fitted, agree best with the positions."""
    few = setup.at(data, spaced(setup.numbers, SCREENED)).rigid
    discrete = [*mistakes(data, setup)]
    without = [mistake.undo(few).registered.rigid for mistake in discrete]
    points = np.stack([undone.points() for undone in without])
    positions = np.stack([undone.position for undone in without])
    error = level(motion(points, positions)[2])
    nearest = np.argsort(error)[:PLACED]
    explained = [(without[k].fitted, discrete[k]) for k in nearest]
    explained += [(mistake.undo(few).fitted, mistake) for mistake in LinkDimensions(data, setup).mistyped()]
    explained.sort(key=lambda pair: -(pair[0].evidence + pair[1].log_prior))
    return [mistake for _, mistake in explained[:FITTED]]


def _explaining(as_read: FittedSetup, tried: Iterable[Mistake]) -> list[PossibleMistake]:
    """Return the mistakes without which the fit is far better than as stated."""
    explained = [(mistake, mistake.undo(as_read.setup).restated.registered.fitted) for mistake in tried]
    most = min(max(SUSPECT_SCALE, as_read.scale / FAR_BETTER), NO_WORSE * as_read.scale)

    def most_gross(left: float) -> float:
        """Return the share of rows that may remain gross if all others are left with errors of this scale."""
        if as_read.scale <= SUSPECT_SCALE:
            return SINGLE  # a mistake must explain gross rows, where only these are wrong
        return MOST_GROSS_BESIDE if left < SUSPECT_SCALE else MOST_GROSS

    return [
        PossibleMistake(mistake, explanation, explanation.evidence + mistake.log_prior)
        for mistake, explanation in explained
        if explanation.scale < most
        and explanation.gross_share < most_gross(explanation.scale)
        and explanation.log_odds(as_read) + mistake.log_prior > MIN_LOG_ODDS
    ]
