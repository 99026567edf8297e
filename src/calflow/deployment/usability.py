"""Usability: whether a calibrated model may be used, and the objections to it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import scipy

from calflow.deployment.figures_alone import EffortLevel
from calflow.deployment.in_space import is_no_better, over_ranges
from calflow.deployment.run_outcome import RunOutcome
from calflow.diagnosis.findings import Finding
from calflow.effects.base import effect_class
from calflow.estimation.accuracy import Accuracy
from calflow.estimation.certainty import SURPRISE
from calflow.estimation.model_tables import FitSummary
from calflow.files.words import listed, mm, percent, plural

USELESS = 0.95  # share of the nominal error above which calibration gained nothing
FAR_OFF = 0.1  # share of the measured space's extent by which a nominal robot may miss
WORSE = 1.02  # ratio to the error without causes above which causes do not help
HARM = 1.25  # ratio above which they do harm, whatever the number of poses
ENOUGH = 1.1  # lack of fit, in units of the noise, up to which a model counts as complete
BY_CHANCE = 0.05  # p-value above which a loss may be by chance
AS_GOOD = 1.05  # ratio to the least mean error up to which more effort is not worthwhile
NOTED = 0.01  # share of poses without a certain gain above which it is reported
PARTLY = 0.2  # share of poses without a certain gain from which the verdict says so
NOTICED = 0.1  # share of the mean error due to noise below which a loss is negligible
USABLE = "Usable for the poses, tools and loads that were measured"
STOPPED = {  # by the stage whose fit stopped: what is not to be used, what to do, and the study's settings concerned
    "identify": (
        "Do not use these parameters: the fit",
        "Check the robot file's dimensions and units and the flagged rows, then run again.",
        "",
    ),
    "diagnose": (
        "Do not use the model that diagnose extended: its fit",
        "Check the flagged rows and what was found last, or look for fewer causes, then run again.",
        "stages.diagnose.causes",
    ),
}
EVEN = 0.5  # probability below which the other is likelier: the nominal robot to be nearer, or another name to be right


# Where the advice is carried out: in a file, at the robot, with equipment that is still missing.
AT_THE_DESK, AT_THE_ROBOT, WITH_MORE = 1, 2, 3


@dataclass(frozen=True)
class Advice:
    """Advice to the reader on what to do, sorted by urgency.

    urgency 1: do not use the result; 2: something is wrong or missing; 3: it could be better. effort: where it is
    carried out; keys: the study's settings concerned; poses: number of poses to measure, 0: any, None: none; reason: why,
    and what else, in sentences for which the first page has no room.
    """

    urgency: int
    sentence: str
    effort: int = AT_THE_ROBOT
    keys: str = ""
    poses: int | None = None
    reason: str = ""

    @property
    def more(self) -> str:
        """The reason and the settings concerned, for readers of the study's files; empty where there are none."""
        return f"{self.reason} {f'(In the files: {self.keys}.)' if self.keys else ''}".strip()

    @property
    def whole(self) -> str:
        return f"{self.sentence} {self.more}".rstrip()


Rule = Callable[[RunOutcome], Iterable[Advice]]


def no_gain_words(share: float, where: str) -> str:
    """Return the sentence on the share of poses without a certain gain; empty where that share is negligible."""
    words = f"At {percent(share)} of the poses {where} no gain over the maker's figures is certain."
    return words if share >= NOTED else ""


def least_effort(every: Sequence[EffortLevel], tolerance: float | None) -> EffortLevel | None:
    """Return the least effort that keeps a tolerance [unit], None if none does; without one, one near the best."""
    least = min(level.mean for level in every)
    good = (level.max <= tolerance if tolerance else level.mean <= AS_GOOD * least for level in every)
    return next((level for level, is_good in zip(every, good, strict=True) if is_good), None)


def objections(outcome: RunOutcome) -> list[str]:
    """Return the objections to using the model, in sentences; an unsettled mistake stands alone."""
    against = mistake_unsettled(outcome) or [item for rule in (*FIT_RULES, *CAUSE_RULES) for item in rule(outcome)]
    return [item.whole for item in against if item.urgency == 1]


def is_useless(outcome: RunOutcome) -> bool:
    """Whether the model is not to be used: there are objections, or calibration gained nothing."""
    (before, *_), (after, *_) = outcome.errors_before_and_now
    return bool(objections(outcome)) or after > USELESS * before


def judgement(outcome: RunOutcome) -> str:
    """Return a short verdict on whether to use the model."""
    if mistake_unsettled(outcome):
        return "Do not use this model: a mistake is to be settled first."
    if is_useless(outcome):
        return "Do not use this model: see what to do next."
    if no_better_in_space(outcome):
        return "Not shown to be better than the maker's figures: see what to do next."
    summary, missed = outcome.fit_summary, outcome.certainty.missed
    times = summary.lack_of_fit
    if missed:
        off = (
            f"{'is' if len(missed) == 1 else 'are'} off by {'' if len(missed) == 1 else 'up to '}{mm(missed[0].error)}"
        )
        return f"{USABLE}, but {plural(len(missed), 'pose')} {off} {outcome.accuracy[0].unit}."
    if any(finding.status == "unexplained" for finding in outcome.findings):
        return f"{USABLE}; a part of the error is unexplained."
    if outcome.certainty.within_chance <= SURPRISE:
        return f"{USABLE}; at held-out poses more is left than the fit promises."
    if summary.new_poses_mm is not None and summary.times_noise > 1 and not summary.lacks_fit:
        return f"Calibrated with few poses: at new ones expect an RMS error of {summary.at_new_poses}."
    if math.isnan(times):
        return f"{USABLE}; the measurement noise is not known."
    if times <= ENOUGH and not summary.lacks_fit:
        if outcome.no_gain >= PARTLY:
            return (
                f"{USABLE}; at {percent(outcome.no_gain)} of these poses no gain over the maker's figures is certain."
            )
        return "Calibrated: only measurement noise is left."
    return f"{USABLE}; {'the model lacks something' if summary.lacks_fit else 'whether more than noise is left is not certain'}."


def warning(outcome: RunOutcome) -> str | None:
    """Return the warning to users of a run's model that must not be used; None where it may be."""
    if not is_useless(outcome):
        return None
    (before, *_), (after, *_) = outcome.errors_before_and_now
    unit = outcome.accuracy[0].unit
    gained = f"calibration left {mm(after)} {unit} of a mean error of {mm(before)} {unit}."
    return f"Do not use this model: {' '.join(objections(outcome)) or gained}"


def mistake_unsettled(outcome: RunOutcome) -> list[Advice]:
    """An unsettled mistake of the user affects everything fitted: it is the only advice."""
    return [
        Advice(1, f"Do not use this result. There is a mistake in the {row.where}: {row.sentences}")
        for row in outcome.faults
        if row.action == "unsettled"
    ]


def noise_contradicted(outcome: RunOutcome) -> Iterator[Advice]:
    """A stated noise that the measurements contradict; a fit that relied on it may be useless."""
    for doubt in outcome.noise_doubts:
        yield Advice(1 if doubt.useless else 2, f"{'Do not use this result. ' * doubt.useless}{doubt.words}")


def nominal_far_off(outcome: RunOutcome) -> Iterator[Advice]:
    """A nominal robot that misses by a tenth of the measured space is misdescribed or misread."""
    if words := far_off_words(outcome.accuracy[0].mean_mm, outcome.summary.spread_mm):
        yield Advice(1, f"Do not use this result: {words}.")


def far_off_words(off_mm: float, spread_mm: float) -> str:
    """Return in words that a nominal robot misses points of some spread by too much; empty if it does not, or nan."""
    if not off_mm >= FAR_OFF * spread_mm:
        return ""
    return (
        f"the nominal robot misses by {mm(off_mm)} mm, which no robot does. Check for swapped axes, a joint's sign or order, the "
        "DH convention, where base and tool are stated, and single wild rows"
    )


def not_converged(outcome: RunOutcome) -> Iterator[Advice]:
    """A model whose fit stopped before its optimum must not be used, nor the causes named by it."""
    for stage, (what, do, keys) in STOPPED.items():
        if (path := f"{stage}/summary.json") in outcome.results:
            summary = outcome.results.document(path, FitSummary)
            if not summary.converged:
                yield Advice(1, f"{what} did not converge ({summary.solver.words}). {do}", keys=keys)


def no_better_in_space(outcome: RunOutcome) -> list[Advice]:
    """Images may fit to fractions of a pixel while the tool's position is no better known than nominally."""
    rows = outcome.in_space
    if not rows or not is_no_better(rows):
        return []
    off, promised = over_ranges(rows)
    sentence = (
        "The images fit, and yet the calibrated tool may be no nearer than the maker's robot (probability that it is nearer: "
        f"{promised.better:.2f}). Over the joints' ranges it is expected to err by {mm(promised.mean_mm)} mm on average, and the "
        f"maker's robot is {mm(off.mean_mm)} mm from it. Take more images, with the board tilted to all sides, near and far, and "
        "the joints all over their ranges. State the lens where it is known, and only there."
    )
    return [Advice(1 if promised.better < EVEN else 2, sentence)]


def makes_it_worse(outcome: RunOutcome) -> Iterator[Advice]:
    """Causes that worsen held-out poses: a loss within the noise is ignored; a small one does not bar the model."""
    if "diagnose/accuracy.csv" not in outcome.results or outcome.split_judged != "holdout":
        return
    unit = outcome.accuracy[0].unit
    steps = (outcome.results.rows(f"{stage}/accuracy.csv", Accuracy) for stage in ("identify", "diagnose"))
    first, last = ([row for row in rows if (row.split, row.unit) == ("holdout", unit)][-1].figures[0] for rows in steps)
    noticed = NOTICED * (outcome.certainty.noise_floor or 0.0)
    if last <= max(WORSE * first, first + noticed):
        return
    figures = f"{mm(last)} {unit} against {mm(first)} {unit}"
    if last > HARM * first:
        sentence = (
            f"Do not use the model with the causes: at held-out poses it is worse than without them ({figures}). The fitted poses "
            "are too few or too alike for so many causes; measure more."
        )
        yield Advice(1, sentence)
        return
    what = "a little worse" if loss_by_chance(outcome) < BY_CHANCE else "no better, perhaps by chance,"
    sentence = (
        f"At held-out poses the model with the causes is {what} than without them ({figures}). Measure more poses before you rely "
        "on what was found, or leave it out."
    )
    yield Advice(2, sentence, keys="stages.diagnose.leave_out")


def loss_by_chance(outcome: RunOutcome) -> float:
    """Return the p-value of the loss at held-out poses where causes change nothing (paired t test over poses).

    1 with fewer than two poses, or where all losses are equal.
    """
    unit = outcome.accuracy[0].unit
    by_pose = [
        rows[(rows["split"] == "holdout") & (rows["unit"] == unit)].groupby("pose")["error"].mean()
        for rows in (outcome.tables[f"{stage}/residuals.csv"] for stage in ("diagnose", "identify"))
    ]
    lost = (by_pose[0] - by_pose[1]).dropna()
    if not (len(lost) > 1 and lost.std() > 0):
        return 1.0
    return float(scipy.stats.ttest_1samp(lost, 0.0, alternative="greater").pvalue)


def look_for_reason(outcome: RunOutcome) -> Iterator[Advice]:
    """A cause of the measuring is in the model, and may act on later rows in another way: its reason is to be found."""
    kinds = [(finding, effect_class(finding.cause)) for finding in outcome.findings if finding.is_cause]
    found = [(finding, kind) for finding, kind in kinds if kind and kind.of_measuring() and not kind.is_noise()]
    if not found:
        return
    tests = dict.fromkeys(
        f" To be sure, {kind.told_by}." for finding, kind in found if kind.told_by and not finding.others
    )
    sentence = (
        f"Find the reason: {listed(labels([finding for finding, _ in found]), 3)}. The calibration allows for it; if it changes "
        f"or happens again, later measurements are off.{''.join(tests)}"
    )
    yield Advice(2, sentence)


def labels(causes: Sequence[Finding]) -> list[str]:
    """Return the causes' names, with details that date or distinguish them; an unlikely one is named as one of several."""
    words = []
    for finding in causes:
        kind, others = effect_class(finding.cause), len(finding.others) if finding.name_probability < EVEN else 0
        several = [cause.name for cause in causes].count(finding.name) > 1
        shown = finding.form if kind and kind.dated else finding.detail if several else ""
        another = f" or {'another' if others == 1 else f'one of {others} others'}" if others else ""
        words.append(f"{finding.name}{f' ({shown})' if shown else ''}{another}")
    return words


FIT_RULES: tuple[Rule, ...] = (noise_contradicted, nominal_far_off, not_converged, no_better_in_space)
CAUSE_RULES: tuple[Rule, ...] = (makes_it_worse,)
