"""Accuracy: how far off each model is, what a poor fit asks for, and what a correction that is not physical would gain."""

from __future__ import annotations

import math
from collections.abc import Sequence
from textwrap import wrap
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from calflow.deployment.in_space import (
    BY_METHOD,
    NOMINAL,
    RANGES,
    all_in_space,
    latest_in_space,
    space_words,
)
from calflow.deployment.usability import (
    AT_THE_DESK,
    FIT_RULES,
    Advice,
    accuracy_steps,
    findings_of,
    latest_summary,
    split_judged,
)
from calflow.estimation.accuracy import Accuracy
from calflow.estimation.calibrated_model import IdentifySummary
from calflow.estimation.noise import MIN_REPEATS
from calflow.estimation.residual_field import SUMMARY, FieldAccuracy, FieldSummary
from calflow.files.tables import Results
from calflow.files.units import METRE
from calflow.files.words import effect_words, first_up, listed, mm, plural_word, ratio
from calflow.reporting.blocks import Block, Paragraph, Plot, Table
from calflow.reporting.section import Material, ModelAccuracy, Section, advise, error_axis, model_steps
from calflow.reporting.style import ACCENT, DARK, LIGHT, MIDDLE, PLATE, figure, mark_floor, panels, plain_decades

NOISE_DRAWS = 200_000
MOST_STEPS = 5000  # of a cumulative curve: more are finer than a line
HOLDING_OUT = 0.35  # of the equations, below which they stay twice the parameters without three poses in ten
LONGEST = 14  # letters of a line below a bar


def before_after(steps: Sequence[ModelAccuracy], floor: float | None) -> Figure:
    """Draw mean and largest error [unit] of each model on a logarithmic scale, with what noise alone would leave.

    floor is None where that is not known.
    """
    drawn = figure(2.9, 3.5)
    axes = drawn.add_subplot()
    at = np.arange(len(steps))
    base = 0.4 * min(filter(None, [*(step.mean for step in steps), floor]))
    most = max(step.max for step in steps)
    above: dict[str, Any] = {"textcoords": "offset points", "ha": "center", "bbox": PLATE, "fontsize": 6.5}
    looks: list[tuple[float, str, list[float], dict[str, Any]]] = [
        (-0.2, "mean", [step.mean for step in steps], {"color": DARK}),
        (0.2, "largest", [step.max for step in steps], {"facecolor": LIGHT, "edgecolor": MIDDLE, "hatch": "////"}),
    ]
    for shift, name, values, look in looks:
        axes.bar(at + shift, np.array(values) - base, 0.38, bottom=base, label=name, linewidth=0.6, **look)
        for x, value in zip(at + shift, values, strict=True):
            axes.annotate(mm(value), (x, value), (0, 2.5), **above)
    mark_floor(axes.axhline, floor, steps[0].unit)
    axes.set_yscale("log")
    axes.set_ylim(base, most * (most / base) ** 0.16)
    plain_decades(axes.yaxis, base, most)
    axes.set_xticks(at, [_wrapped(step) for step in steps])
    axes.set_xlim(-0.55, len(steps) - 0.45)
    axes.grid(axis="x", visible=False)
    axes.set_ylabel(error_axis(steps[0].unit))
    drawn.legend(loc="outside upper center", ncols=3, columnspacing=1.0, handlelength=1.6)
    return drawn


def distribution(distance: np.ndarray, held: np.ndarray, sigma: np.ndarray, noise_name: str, unit: str) -> Figure:
    """Draw histogram and cumulative share of the errors' lengths [unit], used and held out, with those of normal noise.

    sigma is the noise of each row per axis [unit]; rows without an error are left out.
    """
    distance, held, sigma = (values[np.isfinite(distance)] for values in (distance, held, sigma))
    drawn, ((left, right),) = panels(1, 2, 1.95)
    rng = np.random.default_rng(0)
    noise = np.sort(np.linalg.norm(rng.standard_normal((NOISE_DRAWS, 3)), axis=1) * rng.choice(sigma, NOISE_DRAWS))
    end = 1.03 * max(distance.max(), np.quantile(noise, 0.999))
    bins = np.linspace(0, end, 25)
    groups: list[tuple[str, np.ndarray, dict[str, Any], str]] = [
        ("used for the fit", ~held, {"color": DARK, "linestyle": "-"}, ""),
        ("held out", held, {"color": ACCENT, "linestyle": "--"}, "////"),
    ]
    for name, mask, look, hatch in groups:
        if not mask.any():
            continue
        ordered = np.sort(distance[mask])
        left.hist(
            ordered, bins, weights=np.full(len(ordered), 100 / len(ordered)), histtype="step", hatch=hatch, **look
        )
        share = 100 * np.arange(1, len(ordered) + 1) / len(ordered)
        kept = np.unique(np.linspace(0, len(ordered) - 1, MOST_STEPS).astype(int))
        right.step([0, *ordered[kept], end], [0, *share[kept], 100], where="post", label=name, **look)
    look = {"color": "black", "linestyle": ":", "linewidth": 1.2}
    left.stairs(100 * np.histogram(noise, bins)[0] / len(noise), bins, **look)
    grid = np.linspace(0, end, 300)
    right.plot(grid, 100 * np.searchsorted(noise, grid) / len(noise), label=noise_name, **look)
    left.set(xlabel=f"error [{unit}]", ylabel="share of rows in a bin [%]", xlim=(0, end))
    right.set(xlabel=f"error [{unit}]", ylabel="rows with a\nsmaller error [%]", xlim=(0, end), ylim=(0, 103))
    right.legend(loc="lower right")
    return drawn


def _wrapped(step: ModelAccuracy) -> str:
    """Break a long label after its first word, and where it is too long for its bar."""
    first, *rest = step.name.split()
    plus = "+ " if step.added else ""
    return "\n".join([f"{plus}{first}", *wrap(" ".join(rest), LONGEST)])


LACKS = 1.5  # times the noise from which a lack of fit is told
SPREAD = "Errors of the calibrated model: in bins (left) and cumulative (right). "
BEYOND_NOISE = "Where the curves lie right of the dotted one, the model leaves more than noise."
NORMAL = "Dotted: normal noise of the size that the fit leaves; another shape hints at a missing cause."
TOO_GOOD = 0.7  # times the stated noise below which the stated noise is doubted
WORSE = 1.5  # held-out over training mean error from which the model does not carry over


DISTANCE = "Distance between predicted and measured tool position"
HELD_OUT_POSES = (
    "Held-out poses were never shown to a fit: they tell how the model does at poses that were not measured."
)
DIFFERENCE = "Difference between what is predicted and what was measured, each row's as a whole"


def _accuracy(material: Material) -> list[Block]:
    """Say how accurate each model is, and how the errors that are left are spread."""
    results, unit = material.results, material.unit.label
    accuracy, own = accuracy_steps(results), len(results.rows("identify/accuracy.csv", Accuracy))
    words = {"train": "used for the fit", "holdout": "held out"}
    label = {step.model: step.label for split in words for step in model_steps(results, split)}
    rows = [
        (effect_words(row.model) if k < own else label[row.model], words[row.split], str(row.n),
         *(f"{value:.3f}" for value in row.figures), row.unit)
        for k, row in enumerate(accuracy)
    ]  # fmt: skip
    final = frozenset(k for k, row in enumerate(accuracy) if row.model == accuracy[-1].model)
    noise_known = material.certainty.noise_floor is not None
    errors = pd.DataFrame(
        {"held_out": material.held, f"error_{unit}": material.distance, f"noise_per_axis_{unit}": material.sigma}
    ).iloc[material.drawn]
    name = "noise alone" if noise_known else "normal noise"
    spread = distribution(material.distance, material.held, material.sigma, name, unit)
    return [
        Paragraph(f"{DISTANCE if unit == METRE.label else DIFFERENCE}. {HELD_OUT_POSES}"),
        Table(("model", "poses", "rows", "mean", "rms", "max", "unit"), rows, "llrrrrl", final),
        *_in_space(results),
        Plot("error_distribution", spread, SPREAD + (BEYOND_NOISE if noise_known else NORMAL), errors),
    ]


def _in_space(results: Results) -> list[Block]:
    """What a study by cameras errs by in millimetres."""
    if not (rows := all_in_space(results)):
        return []
    words = {"train": "images of the fit", "holdout": "images held out", RANGES: "the joints' ranges"}
    judged = "holdout" if any(row.where == "holdout" for row in rows) else "train"
    rows = [row for row in rows if not row.model.startswith(BY_METHOD) or row.where == judged or row.failed]
    figures = [
        (row.model if row.model.startswith((NOMINAL, BY_METHOD)) else effect_words(row.model), words[row.where],
         row.failed or str(row.n), *("–" if np.isnan(value) else f"{value:.3f}"
                                     for value in (row.mean_mm, row.rms_mm, row.max_mm, row.rms_px))) for row in rows
    ]  # fmt: skip
    return [
        Paragraph(
            f"Pixels do not say how far off the tool is. {first_up('; '.join(space_words(latest_in_space(results))))}."
        ),
        Table(("model", "where", "number", "mean [mm]", "rms [mm]", "max [mm]", "rms [px]"), figures, "llrrrrr"),
    ]


def starts_disagree(results: Results) -> list[Advice]:
    """Fits from different starts should find the same optimum."""
    summary = _identified(results)
    sentence = (
        f"Only {summary.starts_agreeing} of {summary.starts} fits from different starting points came to the same result; the "
        "best is reported. Raise starts under [stages.identify] and compare, and check the dimensions in the robot file."
    )
    return advise(2, sentence, where=summary.starts_agreeing < summary.starts, effort=AT_THE_DESK)


def model_lacks(results: Results) -> list[Advice]:
    """A model that leaves more than the noise lacks something; what is known of the structure is told where it was found."""
    summary = latest_summary(results)
    times, unexplained = summary.lack_of_fit, any(finding.status == "unexplained" for finding in findings_of(results))
    stated = "file" in summary.noise_sources
    doubt = "the noise is larger than stated" if stated else "poses repeat worse than repeats in a row show"
    sentence = (
        f"The model leaves {ratio(times)} times the noise: something is missing in the model, or {doubt}. See the "
        "residuals against each joint; a trend there points to the cause."
    )
    return advise(2, sentence, where=times > LACKS and not unexplained)


def noise_doubtful(results: Results) -> list[Advice]:
    """A fit cannot leave much less than the noise."""
    times = latest_summary(results).lack_of_fit
    sentence = (
        f"The model leaves only {times:.2f} times the noise: the measurements are better than that. Correct sigma, or "
        "measure repeats; the standard deviations given here are too large."
    )
    return advise(3, sentence, where=times < TOO_GOOD and not _identified(results).noise_doubts)


def noise_unknown(results: Results) -> list[Advice]:
    """Without a noise level known apart from the fit nothing tells whether the model is complete."""
    sentence = (
        "Measure some poses several times, coming back to each from elsewhere. The noise is not known, so an incomplete model "
        f"cannot be told from noise. {-(-MIN_REPEATS // 3)} repeats in all are a beginning, 10 are better; or state "
        f"sigma_{accuracy_steps(results)[0].unit}."
    )
    return advise(2, sentence, where=not _identified(results).noise_known)


def nothing_held_out(results: Results) -> list[Advice]:
    """Accuracy on the poses of the fit flatters."""
    if split_judged(results) == "holdout":
        return []
    flatters = "the accuracy given here is that of the fitted poses, which flatters the model."
    if _share_taken(results) <= HOLDING_OUT:
        return advise(2, f"Hold out some poses (split.holdout = 0.3 in the study): {flatters}", effort=AT_THE_DESK)
    return advise(
        2,
        "Measure further poses and hold these out (split.holdout in the study): none of those measured can be spared. "
        f"{first_up(flatters)}",
    )


def few_poses(results: Results) -> list[Advice]:
    """Parameters that few poses tell make more of an error at new poses than the device's noise does."""
    summary, poses = latest_summary(results), _identified(results).training_poses
    more = math.ceil(poses * (2 * _share_taken(results) - 1))
    sentence = (
        f"Measure about {more} more {'pose' if more == 1 else 'poses'}: {poses} determine the parameters so loosely that new ones "
        f"like these are missed by {ratio(summary.times_noise)} times the instrument's noise."
    )
    return advise(2, sentence, where=summary.times_noise > 1 and not summary.lacks_fit)


def _share_taken(results: Results) -> float:
    """The share of the equations that the parameters take, by what errors at new poses are to be expected.

    With h taken, a pose left out errs by h / (1 - h) of the noise's variance beyond the noise (Allen 1974).
    """
    squared = latest_summary(results).times_noise ** 2
    return squared / (1 + squared)


def does_not_carry_over(results: Results) -> list[Advice]:
    """A model much worse at held-out poses was fitted to too few or too similar poses."""
    if split_judged(results) == "train" or not model_steps(results, "train"):
        return []
    train, held = (model_steps(results, split)[-1] for split in ("train", "holdout"))
    sentence = (
        f"The error at held-out poses is {ratio(held.mean / train.mean)} times that at fitted ones ({mm(held.mean)} {held.unit} "
        f"against {mm(train.mean)} {held.unit}). Measure more poses, spread over all the space where the robot is to work."
    )
    return advise(2, sentence, where=held.mean > WORSE * train.mean)


def reaches_beyond(results: Results) -> list[Advice]:
    """Held-out poses beyond the readings that were fitted ask more of the model than it was taught."""
    joints = [joint.joint for joint in _identified(results).extrapolation]
    sentence = (
        f"Some held-out poses reach further than any fitted one ({plural_word(joints, 'joint')} {listed(joints, 8)}). Measure "
        "poses for the fit that cover the whole range there."
    )
    return advise(3, sentence, where=joints)


def _identified(results: Results) -> IdentifySummary:
    return results.document("identify/summary.json", IdentifySummary)


ACCURACY_SECTION = Section(
    10,
    "Accuracy",
    ("identify/accuracy.csv", "identify/residuals.csv", "identify/summary.json"),
    _accuracy,
    (
        *FIT_RULES,
        starts_disagree,
        model_lacks,
        noise_doubtful,
        noise_unknown,
        few_poses,
        nothing_held_out,
        does_not_carry_over,
        reaches_beyond,
    ),
)


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


def _residual_field(material: Material) -> list[Block]:
    """Say what it is and show what it gains at poses that it has not seen."""
    summary = material.results.document(SUMMARY, FieldSummary)
    rows = [
        (row.correction, row.where, str(row.n), f"{row.mean_mm:.3f}", f"{row.rms_mm:.3f}", f"{row.max_mm:.3f}",
         "–" if row.covered is None else f"{100 * row.covered:.0f} %")
        for row in material.results.rows(FIELD_ACCURACY, FieldAccuracy)
    ]  # fmt: skip
    header = ("correction", "where", "n", "mean [mm]", "rms [mm]", "max [mm]", "in 95 % interval")
    return [
        Paragraph(MEANING, keep=True),
        Paragraph(f"{first_up(summary.statement)}.", bold=True),
        *([Table(header, rows, "llrrrrr", wide=0)] if rows else []),
        *([Paragraph(WHERE_APPLIED)] if summary.applied else []),
    ]


RESIDUAL_FIELD_SECTION = Section(16, "A correction that is not physical", (SUMMARY, FIELD_ACCURACY), _residual_field)
