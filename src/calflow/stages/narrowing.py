"""Narrowing: causes go again whose evidence vanishes beside what nobody can name."""

from __future__ import annotations

from collections.abc import Sequence

from calflow.stages.causes import Catalogue, Cause
from calflow.stages.extension import Extended, second_thoughts
from calflow.stages.fitted import Fitted
from calflow.stages.gate import Gate
from calflow.stages.look import Look
from calflow.stages.trial import Trial, among, is_new


def narrowed(start: Fitted, extended: Extended, decoys: Sequence[Cause], catalogue: Catalogue, gate: Gate) -> Extended:
    """Drop the causes whose evidence goes as soon as the decoys are in the model too, and weigh the others anew."""
    family, now = extended.first.family, extended.fitted
    fuller = now.with_causes([*now.causes, *decoys])
    seen = Look.at(fuller, Catalogue((), {})).findings(family)
    kept = [finding.cause for finding in seen if finding.cause in now.causes and gate.stands(finding)]
    if kept == list(now.causes):
        return extended
    alone = now.with_causes([*kept, *decoys])
    if Trial(now, catalogue, family).bic < Trial(alone, catalogue, family).bic:
        return extended  # what cannot be named explains them no better than they explain themselves
    trail = [start, *extended.path]
    tried = [Trial(among(trail, kept), catalogue, family)]
    while is_new(better := second_thoughts(tried[-1].findings, gate), tried):
        tried.append(Trial(among([tried[-1].fitted], better), catalogue, family))
    last = tried[-1]
    trail += [trial.fitted for trial in tried]
    path = tuple(among(trail, last.causes[: k + 1]) for k in range(len(last.causes)))
    return Extended(last.fitted, last.findings, path, extended.first)
