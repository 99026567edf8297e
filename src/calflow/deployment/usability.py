"""Whether a calibrated model may be used, and what speaks against it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import scipy

from calflow.deployment.figures_alone import LEVELS, EffortLevel
from calflow.deployment.in_space import IN_SPACE, SpaceError, is_no_better, over_ranges
from calflow.diagnosis.diagnosis import DiagnosisSummary
from calflow.diagnosis.findings import Finding
from calflow.estimation.accuracy import Accuracy
from calflow.estimation.calibrated_model import Certainty, FitSummary, IdentifySummary
from calflow.estimation.parameters import FittedParameter
from calflow.faults.base import FaultyRow
from calflow.files.deferred import pd
from calflow.files.tables import Results
from calflow.files.units import METRE
from calflow.files.words import listed, mm, percent, plural

IDENTIFIED, DIAGNOSED, FAULTS = "identify/summary.json", "diagnose/summary.json", "identify/faults.csv"
USELESS = 0.95  # share of the nominal error above which calibration gained nothing
FAR_OFF = 0.1  # share of the measured space by which a nominal robot may miss
WORSE = 1.02  # times the error without causes from which they do not help
HARM = 1.25  # times that error from which they do harm, however few poses say so
ENOUGH = 1.1  # times the noise up to which a model counts as complete
SURE = 0.05  # chance of so large a loss from which it is none
AS_GOOD = 1.05  # times the least mean error, up to which more effort is not worth it
NOTED = 0.01  # share of poses without a certain gain from which it is told
NOTICED = 0.1  # of the mean error that noise alone gives, up to which nobody notices a loss
USABLE = "Usable for the poses, tools and loads that were measured"
EVEN = 0.5  # probability that the calibrated tool is nearer below which the maker's robot is the better one


# Efforts: a file edited, poses measured, equipment that is not there yet.
AT_THE_DESK, AT_THE_ROBOT, WITH_MORE = 1, 2, 3


@dataclass(frozen=True)
class Advice:
    """Sentences that tell the reader what to do; the most urgent, 1, stand first.

    1: do not use the result; 2: something is wrong or missing; 3: it could be better. effort says where it is done, keys what
    of the study's files it is about, poses how many are to be measured for it: 0 where it goes with any that are, None for none.
    """

    urgency: int
    sentence: str
    effort: int = AT_THE_ROBOT
    keys: str = ""
    poses: int | None = None

    @property
    def whole(self) -> str:
        """The sentences for whoever has the study's files before him."""
        return f"{self.sentence} ({self.keys})" if self.keys else self.sentence


Rule = Callable[[Results], list[Advice]]
Figures = tuple[float, float, float]  # of an error: mean, RMS, largest


def accuracy_steps(results: Results) -> list[Accuracy]:
    """Return the accuracy of each model on the way to the best one: diagnose's, which has the causes found, else identify's."""
    return results.rows(_of_the_best(results, "accuracy.csv"), Accuracy)


def _of_the_best(results: Results, name: str) -> str:
    """Where a table or document of the best model stands: diagnose's, which has the causes that were found, else identify's."""
    extended = f"diagnose/{name}"
    return extended if extended in results else f"identify/{name}"


def split_judged(results: Results) -> Literal["train", "holdout"]:
    """Return the split by which models are judged: holdout where there is one."""
    return "holdout" if any(row.split == "holdout" for row in accuracy_steps(results)) else "train"


def latest_certainty(results: Results) -> Certainty:
    """Return how sure the best model is."""
    return results.document(_of_the_best(results, "certainty.json"), Certainty)


def latest_summary(results: Results) -> FitSummary:
    """Return the summary of the best model there is."""
    return results.document(_of_the_best(results, "summary.json"), FitSummary)


def no_gain_words(share: float, where: str) -> str:
    """Say at how many poses nothing shows that the calibration helps; empty where it does nearly everywhere."""
    words = f"At {percent(share)} of the poses {where} no gain over the maker's figures is certain."
    return words if share >= NOTED else ""


def findings_of(results: Results) -> list[Finding]:
    """Return the findings, none where nothing was diagnosed."""
    path = "diagnose/findings.csv"
    return results.rows(path, Finding) if path in results else []


def latest(results: Results, name: str) -> pd.DataFrame:
    """Return a table of the best model there is: diagnose's, which has the causes that were found, else identify's."""
    return results.tables[_of_the_best(results, f"{name}.csv")]


def latest_parameters(results: Results) -> list[FittedParameter]:
    """Return the parameters of the best model there is."""
    return results.rows(_of_the_best(results, "parameters.csv"), FittedParameter)


def effort_levels(results: Results) -> list[EffortLevel]:
    """Return what the robot misses by with each level of effort; none where a run of another version did not compute it."""
    path = f"{'diagnose' if 'diagnose/effects.csv' in results else 'identify'}/{LEVELS}"
    return results.rows(path, EffortLevel) if path in results else []


def least_effort(every: Sequence[EffortLevel], tolerance: float | None) -> EffortLevel | None:
    """Return the least effort that keeps a tolerance [unit], None where none does; without one, the least as good as any."""
    least = min(level.mean for level in every)
    good = (level.max <= tolerance if tolerance else level.mean <= AS_GOOD * least for level in every)
    return next((level for level, is_good in zip(every, good, strict=True) if is_good), None)


def structure(results: Results) -> str:
    """Name what the unexplained part of the error depends on; empty where nothing is unexplained."""
    inputs = [finding.inputs_in_words for finding in unexplained_findings(results)]
    if len(inputs) > 2:
        return f"{', '.join(inputs[:2])} and {plural(len(inputs) - 2, 'other input')}"
    return listed(inputs) if inputs else ""


def unexplained_findings(results: Results) -> list[Finding]:
    """Return what stays unexplained and depends on an input."""
    return [finding for finding in findings_of(results) if finding.is_structure]


def lack_of_fit_words(results: Results) -> str:
    """Say that the extended model leaves more than its noise, and where most; empty where it does not."""
    if not any(finding.is_misfit for finding in findings_of(results)):
        return ""
    summary = results.document(DIAGNOSED, DiagnosisSummary)
    where = f" It is {summary.worst.words}." if summary.worst else ""
    return f"The error left is larger than the instrument's noise explains.{where}"


def model_steps(results: Results, split: str) -> list[Accuracy]:
    """Return the models on the way to the best one, in their order, in the unit by which they are judged."""
    rows = [row for row in accuracy_steps(results) if row.split == split]
    return [row for row in rows if row.unit == rows[0].unit]


def judged_steps(results: Results) -> list[Accuracy]:
    """Return the models on the split by which they are judged."""
    return model_steps(results, split_judged(results))


def errors_before_and_now(results: Results) -> tuple[Figures, Figures]:
    """Return the error with the maker's figures and that of the best model, on the split by which models are judged.

    What the measuring device adds is in neither, where it is known apart.
    """
    steps, levels = judged_steps(results), effort_levels(results)
    before = (levels[0].mean, levels[0].rms, levels[0].max) if levels else steps[0].figures
    return before, steps[-1].figures


def objections(results: Results) -> list[str]:
    """Return what says that the model is not to be used, in sentences; an unsettled mistake alone, which all else follows from."""
    against = mistake_unsettled(results) or [item for rule in (*FIT_RULES, *CAUSE_RULES) for item in rule(results)]
    return [item.whole for item in against if item.urgency == 1]


def is_useless(results: Results) -> bool:
    """Whether the model is not to be used: something says so, or calibration gained nothing."""
    (before, *_), (after, *_) = errors_before_and_now(results)
    return bool(objections(results)) or after > USELESS * before


def judgement(results: Results) -> str:
    """Say in a few words whether to use the model."""
    if mistake_unsettled(results):
        return "Do not use this model: a mistake is to be settled first."
    if is_useless(results):
        return "Do not use this model: see what to do next."
    if no_better_in_space(results):
        return "Not shown to be better than the maker's figures: see what to do next."
    summary, missed = latest_summary(results), latest_certainty(results).missed
    times = summary.lack_of_fit
    if missed:
        off = (
            f"{'is' if len(missed) == 1 else 'are'} off by {'' if len(missed) == 1 else 'up to '}{mm(missed[0].error)}"
        )
        return f"{USABLE}, but {plural(len(missed), 'pose')} {off} {accuracy_steps(results)[0].unit}."
    if any(finding.status == "unexplained" for finding in findings_of(results)):
        return f"{USABLE}; a part of the error is unexplained."
    if math.isnan(times):
        return f"{USABLE}; the instrument's noise is not known."
    if times <= ENOUGH and not summary.lacks_fit:
        if summary.new_poses_mm is not None and summary.times_noise > 1:
            return f"Calibrated with few poses: at new ones expect an RMS error of {summary.at_new_poses}."
        return "Calibrated: only the instrument's noise is left."
    return f"{USABLE}; {'the model lacks something' if summary.lacks_fit else 'whether more than noise is left is not certain'}."


def warning(results: Results) -> str | None:
    """Say that a run's model is not to be used, and why, to whoever uses it; None where it may be."""
    if not is_useless(results):
        return None
    (before, *_), (after, *_) = errors_before_and_now(results)
    unit = accuracy_steps(results)[0].unit
    gained = f"calibration left {mm(after)} {unit} of a mean error of {mm(before)} {unit}."
    return f"Do not use this model: {' '.join(objections(results)) or gained}"


def mistake_unsettled(results: Results) -> list[Advice]:
    """A mistake of the user that is not settled is in all that was fitted: it is the one thing to do."""
    rows = results.rows(FAULTS, FaultyRow) if FAULTS in results else []
    return [
        Advice(1, f"Do not use this result. There is a mistake in the {row.where}: {row.statement}.")
        for row in rows
        if row.action == "unsettled"
    ]


def noise_contradicted(results: Results) -> list[Advice]:
    """A stated noise that the measurements contradict is the first thing to know; a fit that believed it is worth nothing."""
    return [
        Advice(1 if doubt.useless else 2, f"{'Do not use this result. ' * doubt.useless}{doubt.words}")
        for doubt in results.document(IDENTIFIED, IdentifySummary).noise_doubts
    ]


def nominal_far_off(results: Results) -> list[Advice]:
    """A nominal robot that misses by a tenth of the measured space was described or read wrongly."""
    off = results.rows("identify/accuracy.csv", Accuracy)[0].mean_mm
    if not off >= FAR_OFF * results.document(IDENTIFIED, IdentifySummary).spread_mm:  # nan: no lengths were measured
        return []
    sentence = (
        f"Do not use this result: the nominal robot misses by {mm(off)} mm, which no robot does. Check for swapped axes, a "
        "joint's sign or order, the DH convention, and single wild rows."
    )
    return [Advice(1, sentence)]


def not_converged(results: Results) -> list[Advice]:
    """A fit that stopped before its optimum is not to be used."""
    return _stopped(
        results, IDENTIFIED, "Do not use these parameters: the fit",
        "Check the robot file's dimensions and units and the flagged rows, then run again.",
    )  # fmt: skip


def _stopped(results: Results, path: str, what: str, do: str, keys: str = "") -> list[Advice]:
    """Say that a fit, of which there is a summary, stopped before its optimum, and what to do; nothing where it did not."""
    summary = results.document(path, FitSummary)
    if summary.converged:
        return []
    return [Advice(1, f"{what} did not converge ({summary.solver.words}). {do}", keys=keys)]


def latest_in_space(results: Results) -> list[SpaceError]:
    """Return how far off the tool is in space; nothing where cameras measured nothing."""
    path = _of_the_best(results, IN_SPACE)
    return results.rows(path, SpaceError) if path in results else []


def no_better_in_space(results: Results) -> list[Advice]:
    """Images may fit to parts of a pixel while the tool is no better known than its maker says."""
    if not (rows := latest_in_space(results)) or not is_no_better(rows):
        return []
    off, promised = over_ranges(rows)
    sentence = (
        "The images fit, and yet the calibrated tool may be no nearer than the maker's robot (probability that it is nearer: "
        f"{promised.better:.2f}). Over the joints' ranges it is expected to err by {mm(promised.rms_mm)} mm, and the maker's robot "
        f"is {mm(off.rms_mm)} mm from it. Take more images, with the board tilted to all sides, near and far, and the joints all "
        "over their ranges. State the lens where it is known, and only there."
    )
    return [Advice(1 if promised.better < EVEN else 2, sentence)]


def extension_not_converged(results: Results) -> list[Advice]:
    """A model with causes whose fit stopped before its optimum is not to be used, and names rest on it."""
    if DIAGNOSED not in results:
        return []
    return _stopped(
        results, DIAGNOSED, "Do not use the model that diagnose extended: its fit",
        "Check the flagged rows and what was found last, or look for fewer causes, then run again.", "stages.diagnose.causes",
    )  # fmt: skip


def makes_it_worse(results: Results) -> list[Advice]:
    """Causes with which unseen poses fit worse: a loss that noise hides is none, and a small one no reason not to use the model."""
    if "diagnose/accuracy.csv" not in results or split_judged(results) != "holdout":
        return []
    unit = accuracy_steps(results)[0].unit
    steps = (results.rows(f"{stage}/accuracy.csv", Accuracy) for stage in ("identify", "diagnose"))
    first, last = ([row for row in rows if (row.split, row.unit) == ("holdout", unit)][-1].figures[0] for rows in steps)
    noticed = NOTICED * (latest_certainty(results).noise_floor or 0.0)
    if last <= max(WORSE * first, first + noticed):
        return []
    figures = f"{mm(last)} {unit} against {mm(first)} {unit}"
    if last > HARM * first:
        sentence = (
            f"Do not use the model with the causes: at held-out poses it is worse than without them ({figures}). The fitted poses "
            "are too few or too alike for so many causes; measure more."
        )
        return [Advice(1, sentence)]
    what = "a little worse" if loss_by_chance(results) < SURE else "no better, perhaps by chance,"
    sentence = (
        f"At held-out poses the model with the causes is {what} than without them ({figures}). Measure more poses before you rely "
        "on what was found, or leave it out."
    )
    return [Advice(2, sentence, keys="stages.diagnose.leave_out")]


def loss_by_chance(results: Results) -> float:
    """Return the chance of so large a loss at held-out poses where the causes change nothing: Student's test of poses in pairs.

    1 where there are fewer than two poses, or all are alike.
    """
    unit = accuracy_steps(results)[0].unit
    size = "error_mm" if unit == METRE.label else "error"
    by_pose = [
        rows[(rows["split"] == "holdout") & (unit == METRE.label or rows["unit"] == unit)].groupby("pose")[size].mean()
        for rows in (results.tables[f"{stage}/residuals.csv"] for stage in ("diagnose", "identify"))
    ]
    lost = (by_pose[0] - by_pose[1]).dropna()
    return (
        float(scipy.stats.ttest_1samp(lost, 0.0, alternative="greater").pvalue)
        if len(lost) > 1 and lost.std() > 0
        else 1.0
    )


FIT_RULES: tuple[Rule, ...] = (noise_contradicted, nominal_far_off, not_converged, no_better_in_space)
CAUSE_RULES: tuple[Rule, ...] = (extension_not_converged, makes_it_worse)
