"""The section on accuracy, and what a poor fit asks for."""

from __future__ import annotations

import numpy as np
import pandas as pd

from calflow.estimation.fit_summary import IdentifySummary
from calflow.estimation.repeats import MIN_REPEATS
from calflow.files.results import Results
from calflow.files.words import effect_words, listed, mm, ratio
from calflow.reporting.blocks import Block, Paragraph, Plot, Table
from calflow.reporting.figures.causes import waterfall
from calflow.reporting.figures.error_budget import budget, distribution
from calflow.reporting.findings import findings
from calflow.reporting.material import Material, as_table, latest, latest_summary, split_judged, steps
from calflow.reporting.section import Advice, Section

FAR_OFF = 0.1  # share of the measured space by which a nominal robot may miss
LACKS = 1.5  # times the noise from which a lack of fit is told
DASHED = " Dashed: the mean error that measurement noise alone would give."
SPREAD = "Errors of the calibrated model: in bins (left) and cumulative (right). "
BEYOND_NOISE = "Where the curves lie right of the dotted one, the model leaves more than noise."
NORMAL = "Dotted: normal noise of the size that the fit leaves; another shape hints at a missing cause."
TOO_GOOD = 0.7  # times the stated noise below which the stated noise is doubted
WORSE = 1.5  # held-out over training mean error from which the model does not carry over


def write(material: Material) -> list[Block]:
    """Say how accurate each model is, where the error went, and how the errors that are left are spread."""
    accuracy = latest(material.results, "accuracy")
    own = len(material.tables["identify/accuracy.csv"])
    words = {"train": "used for the fit", "holdout": "held out"}
    label = {step.model: step.label for split in words for step in steps(accuracy, split)}
    rows = [
        (effect_words(row["model"]) if k < own else label[row["model"]], words.get(row["split"], row["split"]), str(row["n"]),
         *(f"{row[name]:.3f}" for name in ("mean_mm", "rms_mm", "max_mm")))
        for k, row in enumerate(accuracy.to_dict("records"))
    ]  # fmt: skip
    final = frozenset(np.flatnonzero(accuracy["model"] == accuracy["model"].iloc[-1]).tolist())
    split = split_judged(accuracy)
    known = material.noise_floor is not None
    errors = pd.DataFrame(
        {"held_out": material.held, "error_mm": material.distance, "noise_per_axis_mm": material.sigma}
    ).iloc[material.drawn]
    draw = waterfall if len(accuracy) > own else budget
    spent = draw(steps(accuracy, split), material.noise_floor)
    name = "noise alone" if known else "normal noise"
    spread = distribution(material.distance, material.held, material.sigma, name)
    return [
        Paragraph(
            "Distance between predicted and measured tool position. Held-out poses were never shown to a fit: they tell "
            "how the model does at poses that were not measured."
        ),
        Table(("model", "poses", "rows", "mean [mm]", "rms [mm]", "max [mm]"), rows, "llrrrr", final),
        Plot(
            "error_budget",
            spent,
            f"Where the mean error went ({words[split]} poses; logarithmic scale).{DASHED * known}",
            as_table(steps(accuracy, split)),
        ),
        Plot("error_distribution", spread, SPREAD + (BEYOND_NOISE if known else NORMAL), errors),
    ]


def not_converged(results: Results) -> list[Advice]:
    """A fit that stopped before its optimum is not to be used."""
    summary = _identified(results)
    if summary.converged:
        return []
    sentence = (
        f"Do not use these parameters: the fit did not converge ({summary.solver.words}). Check the robot file's "
        "dimensions and units and the flagged rows, then run again."
    )
    return [Advice(1, sentence)]


def noise_contradicted(results: Results) -> list[Advice]:
    """A stated noise that the measurements contradict is the first thing to know; a fit that believed it is worth nothing."""
    return [
        Advice(1 if doubt.useless else 2, f"{'Do not use this result. ' * doubt.useless}{doubt.words}")
        for doubt in _identified(results).noise_doubts
    ]


def starts_disagree(results: Results) -> list[Advice]:
    """Fits from different starts should find the same optimum."""
    summary = _identified(results)
    if summary.starts_agreeing >= summary.starts:
        return []
    sentence = (
        f"Only {summary.starts_agreeing} of {summary.starts} fits from different starting points came to the same result; the "
        "best is reported. Raise stages.identify.starts and compare, and check the nominal dimensions."
    )
    return [Advice(2, sentence)]


def model_lacks(results: Results) -> list[Advice]:
    """A model that leaves more than the noise lacks something."""
    summary = latest_summary(results)
    times = summary.lack_of_fit
    if not times > LACKS or any(found.status == "unexplained" for found in findings(results)):
        return []  # what is known of the structure is told where it was found
    stated = "file" in summary.noise_sources
    doubt = "the noise is larger than stated" if stated else "poses repeat worse than repeats in a row show"
    sentence = (
        f"The model leaves {ratio(times)} times the noise: something is missing in the model, or {doubt}. See the "
        "residuals against each joint; a trend there points to the cause."
    )
    return [Advice(2, sentence)]


def noise_doubtful(results: Results) -> list[Advice]:
    """A fit cannot leave much less than the noise."""
    times = latest_summary(results).lack_of_fit
    if not times < TOO_GOOD or _identified(results).noise_doubts:
        return []
    sentence = (
        f"The model leaves only {times:.2f} times the noise: the measurements are better than that. Correct sigma, or "
        "measure repeats; the standard deviations given here are too large."
    )
    return [Advice(3, sentence)]


def noise_unknown(results: Results) -> list[Advice]:
    """Without a noise level known apart from the fit nothing tells whether the model is complete."""
    if _identified(results).noise_known:
        return []
    sentence = (
        "Measure some poses several times, coming back to each from elsewhere: the noise is not known, so an incomplete "
        f"model cannot be told from noise. {-(-MIN_REPEATS // 3)} repeats in all are a beginning, 10 are better; or state "
        "sigma_mm."
    )
    return [Advice(2, sentence)]


def nominal_far_off(results: Results) -> list[Advice]:
    """A nominal robot that misses by a tenth of the measured space was described or read wrongly."""
    accuracy = results.tables["identify/accuracy.csv"]
    off = float(accuracy["mean_mm"].iloc[0])
    if off < FAR_OFF * _identified(results).spread_mm:
        return []
    sentence = (
        f"Do not use this result: the nominal robot misses by {mm(off)} mm, which no robot does. Check for swapped axes, a "
        "joint's sign or order, the DH convention, and single wild rows."
    )
    return [Advice(1, sentence)]


def nothing_held_out(results: Results) -> list[Advice]:
    """Accuracy on the poses of the fit flatters."""
    if split_judged(results.tables["identify/accuracy.csv"]) == "holdout":
        return []
    sentence = (
        "Hold out some poses (split.holdout = 0.3 in the study): the accuracy given here is that of the poses that were "
        "fitted, which flatters the model."
    )
    return [Advice(2, sentence)]


def does_not_carry_over(results: Results) -> list[Advice]:
    """A model much worse at held-out poses was fitted to too few or too similar poses."""
    accuracy = latest(results, "accuracy")
    if split_judged(accuracy) == "train" or not (accuracy["split"] == "train").any():
        return []
    train, held = steps(accuracy, "train")[-1], steps(accuracy, "holdout")[-1]
    if held.mean <= WORSE * train.mean:
        return []
    sentence = (
        f"The error at held-out poses is {ratio(held.mean / train.mean)} times that at fitted ones ({mm(held.mean)} mm "
        f"against {mm(train.mean)} mm): measure more poses, spread over all the space where the robot is to work."
    )
    return [Advice(2, sentence)]


def reaches_beyond(results: Results) -> list[Advice]:
    """Held-out poses beyond the readings that were fitted ask more of the model than it was taught."""
    said = [joint.words for joint in _identified(results).extrapolation]
    if not said:
        return []
    sentence = (
        f"Some held-out poses reach further than any fitted one ({listed(said, 6)}): measure training poses that cover "
        "the whole range of these joints."
    )
    return [Advice(3, sentence)]


def _identified(results: Results) -> IdentifySummary:
    return results.document("identify/summary.json", IdentifySummary)


SECTION = Section(
    10,
    "Accuracy",
    ("identify/accuracy.csv", "identify/residuals.csv", "identify/summary.json"),
    write,
    (
        noise_contradicted,
        nominal_far_off,
        not_converged,
        starts_disagree,
        model_lacks,
        noise_doubtful,
        noise_unknown,
        nothing_held_out,
        does_not_carry_over,
        reaches_beyond,
    ),
)
