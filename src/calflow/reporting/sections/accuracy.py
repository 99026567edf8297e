"""Accuracy: the errors of each model, their sources and limits, and the gain by a correction that is not physical."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import scipy
from matplotlib.figure import Figure

from calflow.deployment.in_space import IN_SPACE, RANGES, SpaceError, space_words
from calflow.deployment.run_outcome import RunOutcome
from calflow.deployment.usability import ENOUGH
from calflow.estimation.certainty import PROMISED, Certainty
from calflow.estimation.model_tables import FitSummary
from calflow.estimation.residual_field import SUMMARY, FieldAccuracy, FieldSummary
from calflow.files.deferred import pd
from calflow.files.units import METRE
from calflow.files.words import effect_words, first_up, mm, number, percent, ratio
from calflow.reporting.advice import LACKS
from calflow.reporting.bars import error_budget
from calflow.reporting.blocks import SPLITS, Block, Bullets, Paragraph, Plot, Table, headed
from calflow.reporting.material import Material
from calflow.reporting.section import section
from calflow.reporting.sections.verdict import named_steps, pose_errors
from calflow.reporting.style import ACCENT, DARK, chart

CHOICE = ", and the choice among causes that fit as well"
CONTRADICTED = 2  # ratio of held-out errors to the expected ones above which they contradict each other
MOST_STEPS = 5000  # of a cumulative curve: more are finer than a line
SPREAD = "Errors of the calibrated model: the share of rows with a smaller one. "
BEYOND_NOISE = "Where a curve lies to the right of the dotted one, the error is larger than noise."
NORMAL = "Dotted: normal noise of the same size; another shape of the curves points to a missing cause."
BUDGET = (
    "Error budget: what each step of the model, and each cause in turn, takes off the mean error, and what is left."
)
LIMITS = f"Errors of held-out poses and the limits below which {percent(PROMISED)} of such errors are predicted."
DISTANCE = "Distance between predicted and measured tool position"
HELD_OUT_POSES = "The held-out poses were not used for the fit: they show how accurate the model is at new poses."
DEVICE = " Page one's error before leaves out what the measuring device was found to add; those of the nominal robot here do not."
DIFFERENCE = "Difference between predicted and measured values, each row as a whole"
FIELD_ACCURACY = "residual_field/accuracy.csv"
MEANING = (
    "The study asks for a smooth function of the joint readings that removes what the model leaves and no cause explains. It is "
    "not physical: it says nothing about the robot, holds for this tool and these payloads alone, and fades to nothing beyond the "
    "measured range of any joint."
)
WHERE_APPLIED = (
    "Predictions and commands of calflow predict, compensate, filter and validate include it, with its own standard deviation: "
    "where nothing was measured, that is what was left without it. Every other page of this report, and what calflow export and "
    "drift make, leaves it out."
)


def distribution(material: Material, noise_name: str) -> Figure:
    """Draw the cumulative distribution of error norms of fitted and held-out rows, and that of normal noise.

    Rows without an error in the judged unit are omitted.
    """
    there = np.isfinite(material.distance)
    distance, held, sigma = (values[there] for values in (material.distance, material.held, material.sigma))
    axes_of = np.isfinite(material.values[there]).sum(axis=1)
    drawn, axes = chart(2.1)
    (sigma, axes_of), rows = np.unique([sigma, axes_of], axis=1, return_counts=True)
    end = 1.03 * max(distance.max(), (sigma * scipy.stats.chi.ppf(0.999, axes_of)).max())
    for name, mask, colour, line in (("used for the fit", ~held, DARK, "-"), ("held out", held, ACCENT, "--")):
        if mask.any():
            ordered = np.sort(distance[mask])
            share = 100 * np.arange(1, len(ordered) + 1) / len(ordered)
            kept = np.unique(np.linspace(0, len(ordered) - 1, MOST_STEPS).astype(int))
            x, y = [0, *ordered[kept], end], [0, *share[kept], 100]
            axes.step(x, y, where="post", label=name, color=colour, linestyle=line)
    grid = np.linspace(0, end, 300)
    look: dict[str, Any] = {"color": "black", "linestyle": ":", "linewidth": 1.2}
    noise = scipy.stats.chi.cdf(grid[:, None] / sigma, axes_of) @ rows / rows.sum()
    axes.plot(grid, 100 * noise, label=noise_name, **look)
    axes.set(
        xlabel=f"error [{material.unit.label}]", ylabel="rows with a smaller error [%]", xlim=(0, end), ylim=(0, 103)
    )
    axes.legend(loc="lower right")
    return drawn


@section(10, "Accuracy", "identify/accuracy.csv")
def accuracy_section(material: Material) -> list[Block]:
    """Return the accuracy of each model, and the distribution of the remaining errors."""
    accuracy, unit = material.accuracy, material.unit.label
    (before, *_), _ = material.errors_before_and_now
    with_device = mm(before) != mm(material.judged_steps[0].figures[0])
    rows = [
        (name, SPLITS[row.split], str(row.n), *(f"{value:.3f}" for value in row.figures), row.unit)
        for name, row in named_steps(material)
    ]
    final = frozenset(k for k, row in enumerate(accuracy) if row.model == accuracy[-1].model)
    noise_known = material.certainty.noise_floor is not None
    errors = pd.DataFrame(
        {"held_out": material.held, f"error_{unit}": material.distance, f"noise_per_axis_{unit}": material.sigma}
    ).iloc[material.drawn]
    spread = distribution(material, "noise alone" if noise_known else "normal noise")
    return [
        Paragraph(f"{DISTANCE if material.is_of_positions else DIFFERENCE}. {HELD_OUT_POSES}{DEVICE * with_device}"),
        Table(("model", "poses", "rows", "mean", "RMS", "largest", "unit"), rows, "llrrrrl", final),
        *_budget(material),
        *_in_space(material),
        Plot("error_distribution", spread, SPREAD + (BEYOND_NOISE if noise_known else NORMAL), errors),
        *_promised(material),
        *headed(
            f"Other figures of the error, and how they differ from the mean of {mm(material.certainty.left)} {unit}",
            Bullets(other_figures(material)),
        ),
    ]


def _budget(material: Material) -> list[Block]:
    """Draw the reduction of the mean error by each step of the model, and by each cause."""
    judged = material.judged_steps[0]
    rows = [row for row in named_steps(material) if (row[1].split, row[1].unit) == (judged.split, judged.unit)]
    names, levels, unit = [first_up(name) for name, _ in rows], [row.figures[0] for _, row in rows], material.unit.label
    drawn = error_budget(names, levels, material.certainty.noise_floor, unit, SPLITS[judged.split])
    return [Plot("error_budget", drawn, BUDGET, pd.DataFrame({"model": names, f"mean_error_{unit}": levels}))]


def _promised(material: Material) -> list[Block]:
    """Draw the errors of held-out poses with their predicted limits."""
    tested = material.tested
    if not len(tested):
        return []
    limits = tested.loc[tested.groupby("pose")["error"].idxmax()].set_index("pose")["limit"]
    return [replace(pose_errors(material, limits), caption=LIMITS, width=51)]


def other_figures(material: Material) -> list[tuple[str, str]]:
    """Return the meaning of further error figures: due to noise, remaining, and expected by the model itself."""
    certainty, summary, unit = material.certainty, material.fit_summary, material.certainty.unit
    left = summary.discrepancies.get(unit, 0.0)
    sentences = [
        ("Measurement noise:", f"a standard deviation of {certainty.noise}."),
        ("What is left:", leftover(summary.lack_of_fit, left, material.structure, summary.lacks_fit, unit)),
        ("How sure the model is:", certainty_words(certainty, summary.noise_known)),
    ]
    if summary.new_poses_mm is not None:
        last = material.judged_steps[-1]
        held_out = last.figures[1] if certainty.split == "holdout" and last.unit == METRE.label else 0.0
        of_what = "" if material.is_of_positions else ", of what is measured"
        name = f"RMS error expected at new poses like the fitted ones{of_what}:"
        sentences.append((name, new_poses_words(summary, held_out)))
    return sentences


def new_poses_words(summary: FitSummary, held_out: float) -> str:
    """Return words on the expected error at new poses, or on held-out errors [mm] (rms) that contradict it."""
    noise = math.sqrt(3) * (summary.sigma_mm or 0.0)
    if held_out > math.hypot(noise, CONTRADICTED * (summary.new_poses_limit_mm or math.inf)):
        return f"the fit predicts {summary.at_new_poses}, but held-out poses are off by {mm(held_out)} mm: do not rely on it."
    return f"{summary.at_new_poses}{', without the noise' * summary.noise_known}."


def certainty_words(certainty: Certainty, noise_known: bool) -> str:
    """Return words on the certainty of predictions, with discrepancy, choice of causes, and the remaining errors."""
    counted = "the model's own error" if noise_known else "all that the fit leaves, noise or not"
    counted += CHOICE if certainty.rivals else ""
    where = "at held-out poses" if certainty.split == "holdout" else "at the poses that were fitted"
    return (
        f"the tool's position {where} is known to {mm(certainty.prediction_sd_mm)} mm (1 sd). That includes {counted}. "
        f"Measured there: {mm(certainty.left)} {certainty.unit} on average, with the noise."
    )


def leftover(times: float, discrepancy: float, structure: str, significant: bool, unit: str) -> str:
    """Return the meaning of a lack-of-fit factor and the model's discrepancy [unit]; a factor of nan is not known.

    structure: input on which an unexplained error depends, if any; significant: whether the lack of fit is.
    """
    if structure and not times > ENOUGH:
        return f"a part of it depends on {structure}, so it is more than noise. No cause explains it for certain."
    if math.isnan(times):
        return "whether it is more than noise is not known: the noise was estimated from the fit itself."
    if times <= ENOUGH and not significant:
        return f"{times:.2f} times the noise, so the noise explains all of it."
    own = f" The model's own error, {mm(discrepancy)} {unit} per axis, is included in the uncertainty of predictions."
    little = "a little more" if times <= LACKS else "more"
    lacks = f"{little} than noise explains{'' if significant else ', which may be chance'}"
    lacks = "the model lacks something" if significant and times > LACKS else lacks
    return f"with the repeats of each pose averaged, {ratio(times)} times the noise: {lacks}.{own * bool(discrepancy)}"


def _in_space(outcome: RunOutcome) -> list[Block]:
    """Return errors in millimetres of a study by cameras: hand-eye calibration alone, study's effects, causes found."""
    if not (latest := outcome.in_space):
        return []
    before = outcome.results.rows(f"identify/{IN_SPACE}", SpaceError)
    rows = [*before, *(row for row in latest if row.model not in {row.model for row in before})]
    words = {"train": "images of the fit", "holdout": "images held out", RANGES: "the joints' ranges"}
    judged = "holdout" if any(row.where == "holdout" for row in rows) else "train"
    rows = [row for row in rows if not row.method or row.where == judged or row.failed]
    figures = [
        (effect_words(row.model) if row.is_of_calibration else row.model, words[row.where],
         row.failed or str(row.n), *(number(value, ".3f") for value in (row.mean_mm, row.rms_mm, row.max_mm, row.rms_px)))
        for row in rows
    ]  # fmt: skip
    return [
        Paragraph(f"Pixels do not say how far off the tool is. {first_up('; '.join(space_words(latest)))}."),
        Table(("model", "where", "number", "mean [mm]", "RMS [mm]", "largest [mm]", "RMS [px]"), figures, "llrrrrr"),
    ]


@section(16, "A correction that is not physical", FIELD_ACCURACY)
def residual_field_section(material: Material) -> list[Block]:
    """Return the description of the residual field, and its gain at held-out poses."""
    summary = material.results.document(SUMMARY, FieldSummary)
    rows = [
        (row.correction, row.where, str(row.n), f"{row.mean_mm:.3f}", f"{row.rms_mm:.3f}", f"{row.max_mm:.3f}",
         "–" if row.covered is None else f"{100 * row.covered:.0f} %")
        for row in material.results.rows(FIELD_ACCURACY, FieldAccuracy)
    ]  # fmt: skip
    header = ("correction", "where", "n", "mean [mm]", "RMS [mm]", "largest [mm]", "in 95 % interval")
    return [
        Paragraph(MEANING, keep=True),
        Paragraph(f"{first_up(summary.statement)}.", bold=True),
        *([Table(header, rows, "llrrrrr", wide=0)] if rows else []),
        *([Paragraph(WHERE_APPLIED)] if summary.applied else []),
    ]
