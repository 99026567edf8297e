"""Narrowing: causes go again whose evidence vanishes beside what nobody can name."""

from __future__ import annotations

from collections.abc import Sequence

from calflow.diagnosis.screening.catalogue import Catalogue
from calflow.diagnosis.search.acceptance import Acceptance
from calflow.diagnosis.search.extension import Extended
from calflow.diagnosis.search.fitted import Fitted
from calflow.diagnosis.search.fitted_trial import FittedTrial, among
from calflow.diagnosis.search.linearisation import Linearisation
from calflow.diagnosis.search.stepwise import second_thoughts
from calflow.diagnosis.search.trial import is_new
from calflow.effects.cause import Cause


def narrowed(
    start: Fitted, extended: Extended, decoys: Sequence[Cause], catalogue: Catalogue, acceptance: Acceptance
) -> Extended:
    """Drop the causes whose evidence goes as soon as the decoys are in the model too, and weigh the others anew."""
    family, now = extended.first.family, extended.fitted
    fuller = now.with_causes([*now.causes, *decoys])
    seen = Linearisation.at(fuller, Catalogue((), {})).findings(family)
    kept = [finding.cause for finding in seen if finding.cause in now.causes and acceptance.keeps(finding)]
    if kept == list(now.causes):
        return extended
    alone = now.with_causes([*kept, *decoys])
    if FittedTrial(family, now, catalogue).bic < FittedTrial(family, alone, catalogue).bic:
        return extended  # what cannot be named explains them no better than they explain themselves
    trail = [start, *extended.path]
    tried = [FittedTrial(family, among(trail, kept), catalogue)]
    while is_new(better := second_thoughts(tried[-1].findings, acceptance), tried):
        tried.append(FittedTrial(family, among([tried[-1].fitted], better), catalogue))
    last = tried[-1]
    trail += [trial.fitted for trial in tried]
    path = tuple(among(trail, last.causes[: k + 1]) for k in range(len(last.causes)))
    return Extended(last.fitted, last.findings, path, extended.first)
