"""Merging: several causes of one family at one place give way to a single one that holds them all.

Orders found one after another on a joint are often one curve, steps one after another one drift. No swap of one cause leads
there, since each of the others explains its part already.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from calflow.diagnosis.screening.hypothesis import H
from calflow.diagnosis.screening.screening import by_place
from calflow.diagnosis.search.trial import Trial

Kin = tuple[str, int]  # a family and the joint (0 for none) where its members act


def kindred(causes: Sequence[H]) -> dict[Kin, list[H]]:
    """Return the causes of each family at each joint, where there are several."""
    found: dict[Kin, list[H]] = {}
    for cause in causes:
        if cause.family:
            found.setdefault((cause.family, cause.joint), []).append(cause)
    return {kin: members for kin, members in found.items() if len(members) > 1}


def merged(trial: Trial[H]) -> Iterator[list[H]]:
    """Yield the causes with one of a family in the place of all its members at a joint, the best of each place first."""
    for (family, joint), members in kindred(trial.causes).items():
        stay = [cause for cause in trial.causes if cause not in members]
        scores = trial.linearisation.apart(members).scores
        alike = [score for score in scores if (score.cause.family, score.cause.joint) == (family, joint)]
        for _, best in sorted(by_place(alike).values(), key=lambda one: one[0]):
            yield [*stay, best.cause]
