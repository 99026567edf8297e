"""Whether a calibrated model may be used, and what speaks against it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from scipy.stats import ttest_1samp

from calflow.diagnosis.diagnosis import DiagnosisSummary
from calflow.estimation.accuracy import Accuracy
from calflow.estimation.calibrated_model import IdentifySummary
from calflow.faults.base import FaultyRow
from calflow.files.results import Results
from calflow.files.units import METRE
from calflow.files.words import mm

IDENTIFIED, DIAGNOSED, FAULTS = "identify/summary.json", "diagnose/summary.json", "identify/faults.csv"
USELESS = 0.95  # share of the nominal error above which calibration gained nothing
FAR_OFF = 0.1  # share of the measured space by which a nominal robot may miss
WORSE = 1.02  # times the error without causes from which they do not help
HARM = 1.25  # times that error from which they do harm, however few poses say so
SURE = 0.05  # chance of so large a loss from which it is none


@dataclass(frozen=True)
class Advice:
    """A sentence that tells the reader what to do; the most urgent, 1, stand first.

    1: do not use the result; 2: something is wrong or missing; 3: it could be better.
    """

    urgency: int
    sentence: str


Rule = Callable[[Results], list[Advice]]


def accuracy_steps(results: Results) -> list[Accuracy]:
    """Return the accuracy of each model on the way to the best one: diagnose's, which has the causes found, else identify's."""
    extended = "diagnose/accuracy.csv"
    return results.rows(extended if extended in results else "identify/accuracy.csv", Accuracy)


def split_judged(results: Results) -> Literal["train", "holdout"]:
    """Return the split by which models are judged: holdout where there is one."""
    return "holdout" if any(row.split == "holdout" for row in accuracy_steps(results)) else "train"


def mean_errors(results: Results) -> tuple[float, float]:
    """Return the mean error of the nominal robot and of the best model, on the split by which they are judged, in their unit."""
    rows = [row for row in accuracy_steps(results) if row.split == split_judged(results)]
    judged = [row.figures[0] for row in rows if row.unit == rows[0].unit]
    return judged[0], judged[-1]


def objections(results: Results) -> list[str]:
    """Return what says that the model is not to be used, in sentences; an unsettled mistake alone, which all else follows from."""
    against = mistake_unsettled(results) or [item for rule in (*FIT_RULES, *CAUSE_RULES) for item in rule(results)]
    return [item.sentence for item in against if item.urgency == 1]


def is_useless(results: Results) -> bool:
    """Whether the model is not to be used: something says so, or calibration gained nothing."""
    before, after = mean_errors(results)
    return bool(objections(results)) or after > USELESS * before


def warning(results: Results) -> str | None:
    """Say that a run's model is not to be used, and why, to whoever uses it; None where it may be."""
    if not is_useless(results):
        return None
    before, after = mean_errors(results)
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
    summary = results.document(IDENTIFIED, IdentifySummary)
    if summary.converged:
        return []
    sentence = (
        f"Do not use these parameters: the fit did not converge ({summary.solver.words}). Check the robot file's "
        "dimensions and units and the flagged rows, then run again."
    )
    return [Advice(1, sentence)]


def extension_not_converged(results: Results) -> list[Advice]:
    """A model with causes whose fit stopped before its optimum is not to be used, and names rest on it."""
    if DIAGNOSED not in results:
        return []
    summary = results.document(DIAGNOSED, DiagnosisSummary)
    if summary.converged:
        return []
    sentence = (
        f"Do not use the model that diagnose extended: its fit did not converge ({summary.solver.words}). Check the flagged rows "
        "and what was found last, or look for fewer causes (stages.diagnose.causes), then run again."
    )
    return [Advice(1, sentence)]


def makes_it_worse(results: Results) -> list[Advice]:
    """Causes with which unseen poses fit worse were fitted to too few poses."""
    if "diagnose/accuracy.csv" not in results or split_judged(results) != "holdout":
        return []
    unit = accuracy_steps(results)[0].unit
    steps = (results.rows(f"{stage}/accuracy.csv", Accuracy) for stage in ("identify", "diagnose"))
    own, last = ([row for row in rows if (row.split, row.unit) == ("holdout", unit)][-1].figures[0] for rows in steps)
    if last <= WORSE * own:
        return []
    said = f"{mm(last)} {unit} against {mm(own)} {unit}"
    if last > HARM * own or loss_by_chance(results) < SURE:
        sentence = (
            f"Do not use the model with the causes: at held-out poses it is worse than without them ({said}). The fitted poses "
            "are too few or too alike for so many causes; measure more."
        )
        return [Advice(1, sentence)]
    sentence = (
        f"At held-out poses the model with the causes is no better than without them ({said}), which may be chance. Measure more "
        "poses before you rely on what was found, or leave it out (stages.diagnose.leave_out)."
    )
    return [Advice(2, sentence)]


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
    return float(ttest_1samp(lost, 0.0, alternative="greater").pvalue) if len(lost) > 1 and lost.std() > 0 else 1.0


FIT_RULES: tuple[Rule, ...] = (noise_contradicted, nominal_far_off, not_converged)
CAUSE_RULES: tuple[Rule, ...] = (extension_not_converged, makes_it_worse)
