"""Terminal output: the result of a run, and of `calflow next`."""

from __future__ import annotations

from collections.abc import Iterator

from calflow.deployment.in_space import space_words
from calflow.deployment.run_outcome import RunOutcome
from calflow.deployment.usability import judgement
from calflow.design.next_poses import MeasuringVerdict, Suspect
from calflow.diagnosis.findings import Finding
from calflow.effects.wording import cause_words
from calflow.files.words import capped, mm, number, plural, sureness
from calflow.reporting.advice import WRONG, advice, size_is_assumed
from calflow.reporting.sections.causes import gain_words, shows_gain
from calflow.reporting.sections.verdict import headline, named_steps, verdict_section

SUSPECTS_LISTED, UNTESTED_LISTED = 4, 6
HOPELESS = 0.5  # best probability below which more poses of the same kind are not worthwhile
SIZE_ASSUMED = (
    "in space, if the board is as large as its points say: no image shows that, and all lengths are as wrong as it is"
)
MEASURES = {"rms": "RMS error", "worst": "worst point"}


def last_lines(outcome: RunOutcome) -> list[str]:
    """Return accuracy, findings, verdict and problems, as far as there are results."""
    wrong = [f"! {item.whole}" for item in advice(outcome) if item.urgency <= WRONG]
    space = [*space_words(outcome.in_space), *([SIZE_ASSUMED] if size_is_assumed(outcome) else [])]
    return [*_accuracy(outcome), *space, *_findings(outcome), *_verdict(outcome), *wrong]


def _accuracy(outcome: RunOutcome) -> list[str]:
    """Return the accuracy of every model in order; a model with a further cause is named by it."""
    if "identify/accuracy.csv" not in outcome.results:
        return []
    named = named_steps(outcome)
    width, unit = max(len(name) for name, _ in named), named[0][1].unit
    return [
        f"{'error':{width}}  split    {f'mean {unit}':>9} {f'max {unit}':>9}",
        *(
            f"{name:{width}}  {row.split:8} {row.figures[0]:9.3f} {row.figures[2]:9.3f}"
            + (f" {row.unit}" if row.unit != unit else "")
            for name, row in named
        ),
    ]


def _findings(outcome: RunOutcome) -> list[str]:
    if "diagnose/findings.csv" not in outcome.results:
        return []
    problems = [
        f"left over: {outcome.lack_of_fit_words}"
        if finding.is_misfit
        else f"{'suspected' if finding.is_suspicion else 'found'}: {_in_words(finding)}"
        for finding in outcome.findings
    ]
    unseen = outcome.diagnosis_summary.unseen
    return problems or [f"found: nothing that the model lacks{f'; {unseen}' if unseen else ''}"]


def _in_words(finding: Finding) -> str:
    """Return a finding with its cause, joint, size, probability and gain."""
    gains = finding.status != "data_fault" and (finding.is_suspicion or shows_gain(finding))
    which = "the first " if finding.others and not finding.is_in_part else ""
    told = finding.is_cause and not finding.may_be_unexplained
    sure = f", {which}with probability {sureness(finding.name_probability)}" if told else ""
    return f"{finding.in_short}{sure}{f'; {gain_words(finding)}' if gains else ''}"


def _verdict(outcome: RunOutcome) -> list[str]:
    return [judgement(outcome), headline(outcome)] if verdict_section.needs in outcome.results else []


def next_lines(verdict: MeasuringVerdict) -> list[str]:
    """Return the verdict in words, its first line the decision."""
    return [_answer(verdict), *_figures(verdict), *(f"note: {note}" for note in verdict.notes)]


def _answer(verdict: MeasuringVerdict) -> str:
    """Return whether to stop or go on, and why."""
    if verdict.status == "nothing measured":
        return "nothing measured yet: poses to begin with"
    if verdict.status == "too few":
        return f"{plural(verdict.poses, 'pose')}: too few to identify anything"
    if verdict.tolerance_mm is None or verdict.probability is None:
        return "no tolerance stated (--tolerance-mm, or tolerance_mm in [stages.select]): nothing to stop at"
    within = f"the tool is within {mm(verdict.tolerance_mm)} mm over the task ({MEASURES[verdict.measure]})"
    sure = f"with probability {capped(verdict.probability)}"
    if verdict.status == "stop":
        return f"stop: {within} {sure}"
    return f"go on: {within} {sure}, {verdict.confidence:.0%} is required"


def _figures(verdict: MeasuringVerdict) -> Iterator[str]:
    if verdict.error_mm is None or verdict.error_most_mm is None:
        return
    yield (
        f"true error of the tool over the task: about {mm(verdict.error_mm)} mm, below {mm(verdict.error_most_mm)} mm with "
        f"{verdict.confidence:.0%}"
    )
    parts = [f"left out in turn {mm(verdict.leftout_rms_mm)} mm"] if verdict.leftout_rms_mm is not None else []
    parts += [f"held out {mm(verdict.heldout_rms_mm)} mm"] if verdict.heldout_rms_mm is not None else []
    parts += [f"noise {mm(verdict.noise_mm)} mm per axis"] if verdict.noise_mm is not None else []
    errors = f"; errors as measured (RMS): {', '.join(parts)}" if parts else ""
    yield f"{plural(verdict.poses, 'pose')}, {verdict.fitted_poses} fitted{errors}"
    if not verdict.noise_known:
        yield (
            "the noise is not known independently of the fit, so all residuals count as the robot's own error. Repeat some poses, "
            "or state sigma (in its unit, as sigma_mm or sigma_px) in [measurements]"
        )
    yield from (f"found: {finding}" for finding in verdict.found or ("nothing that the model lacks",))
    yield from (f"suspected: {finding}" for finding in verdict.left_out)
    if verdict.suspected:
        more = len(verdict.suspected) - SUSPECTS_LISTED
        suspects = ", ".join(map(_suspect, verdict.suspected[:SUSPECTS_LISTED]))
        yield f"suspected, not proven (probability): {suspects}{f', and {more} more' if more > 0 else ''}"
    if verdict.untested:
        more = len(verdict.untested) - UNTESTED_LISTED
        rest = f", and {more} more, which --out writes to verdict.json" if more > 0 else ""
        causes = ", ".join(cause_words(cause).name for cause in verdict.untested[:UNTESTED_LISTED])
        yield f"not tested, since data that they need are missing, and not in the probability: {causes}{rest}"
    best = verdict.probability_at_best
    if verdict.status == "measure" and best is not None and best < HOPELESS:
        yield (
            f"more poses of this kind will hardly help: with every parameter known the probability would be {capped(best)}. "
            "See what is suspected, or allow a wider tolerance"
        )


def _suspect(suspect: Suspect) -> str:
    what = {
        "cause": suspect.name,
        "background": f"a smooth error by {suspect.name}",
        "pose": "an independent error of each pose",
        "rival": f"{suspect.name} instead of what was found",
    }[suspect.kind]
    return f"{what} ({number(suspect.probability, '.2g')})"
