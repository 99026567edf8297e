"""The report of a validation: the verdict, the errors before and after, and every pose, on one or two pages."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy
from matplotlib.figure import Figure

from calflow.deployment.attained import CYCLES
from calflow.deployment.validation import Status, ValidatedModel, Validation, ValidationSummary
from calflow.files.words import capped, mm, plural
from calflow.reporting.advice import after_validation
from calflow.reporting.blocks import NEXT, Card, Gap, Paragraph, Part, Plot, Table, cover, headed, in_a_line, noted
from calflow.reporting.sections.acceptance import FAILED, NOT_YET, PASSED, sign_card
from calflow.reporting.style import ACCENT, DARK, MIDDLE, chart, name_poses

NAMES = {
    "nominal": "nominal robot",
    "calibrated": "calibrated robot",
    "figures": "controller figures",
    "commanded": "corrected commands",
}
BEYOND = 0.025  # p-value for any point's error beyond the predicted limit
POSE_ERROR = (
    "A pose's error is the distance from where it should be to the barycentre of its rows: ISO 9283's pose accuracy AP. RP is "
    "the mean distance of its rows from their barycentre and three standard deviations."
)
VALUE_ERROR = (
    "An error is the difference between what was measured, as the mean of its repeats, and what the robot should have shown. "
    "Points of a pose that differ in what was measured have a row each."
)
VERDICTS: dict[Status, str] = {
    "met": "The tolerance is met.",
    "not met": "The tolerance is not met.",
    "cannot be told": "These poses do not show whether the tolerance is met.",
    "no tolerance": "No tolerance was asked for.",
}


def validation_report(validation: Validation, title: str, file: str) -> list[Part]:
    """Return the parts of a validation's report; file is the name of the measurements."""
    summary, judged = validation.summary, validation.judged
    measured = in_a_line(file, plural(summary.poses, "pose"), plural(summary.rows, "measured point"))
    cards = [
        Card(NAMES[row.model], mm(row.mean), f"largest {mm(row.max)} {row.unit}", "dark" if row is judged else "pale")
        for row in validation.accuracy
    ]
    asked = "no tolerance is stated" if summary.tolerance is None else f"tolerance {summary.tolerance:g} {summary.unit}"
    cards.append(sign_card({"met": PASSED, "not met": FAILED}.get(summary.status, NOT_YET), asked))
    first = [
        *cover("Validation report", title, [Paragraph(measured)], VERDICTS[summary.status], (), cards),
        *(Paragraph(sentence, 11) for sentence in (*_of_what(summary), *_what_follows(validation))),
        *headed(NEXT, Paragraph(after_validation(validation), 11)),
        Gap(12),
        _statistics(validation.accuracy),
        Plot("poses", _errors_by_pose(validation)),
        *noted("What was assumed", (_frame(summary), *summary.notes)),
    ]
    fewer = f" The standard has {CYCLES} cycles; here a pose has {summary.fewest_cycles} at least."
    of_positions = POSE_ERROR + fewer * (summary.fewest_cycles < CYCLES)
    explained = Paragraph(of_positions if summary.of_positions else VALUE_ERROR, 9.5)
    return [("", first), ("Every pose", [explained, _poses(validation)])]


def verdict_lines(validation: Validation) -> list[str]:
    """Return the verdict with its probabilities in sentences, the shortest first."""
    summary, judged, before = validation.summary, validation.judged, validation.of("nominal")
    unit, mean = summary.unit, f"{mm(judged.mean)} {summary.unit}"
    if np.isfinite(judged.mean_low):
        mean += f" (95 % interval {mm(judged.mean_low)} to {mm(judged.mean_high)} {unit})"
    lines = [
        VERDICTS[summary.status],
        *_of_what(summary),
        f"At {plural(summary.poses, 'new pose')} the mean error with the {NAMES[judged.model]} is {mean}, "
        f"before {mm(before.mean)} {unit}. The largest is {mm(judged.max)} {unit}, before {mm(before.max)} {unit}.",
    ]
    if summary.tolerance is None and np.isfinite(judged.further):
        lines.append(
            f"A further pose like these errs by less than {mm(judged.further)} {unit} with a probability of 95 %."
        )
    return [*lines, *_what_follows(validation)]


def _what_follows(validation: Validation) -> list[str]:
    """Return sentences on the error to expect at other poses, and its agreement with the calibration's prediction."""
    summary = validation.summary
    probability = [_probability(summary)] if summary.tolerance is not None else []
    return [*probability, _promise(validation), *_iso(summary)]


def _of_what(summary: ValidationSummary) -> list[str]:
    """Return words on what the verdict is about: what the robot must be given, or that no position was measured."""
    if not summary.of_positions:
        return ["The verdict is about the values measured here. How far off the tool may be, calflow predict says."]
    if summary.sent is None:
        return ["The verdict is about the calibrated model, and so about corrected commands, not controller figures."]
    return [f"The verdict is about the robot with {'the ' * (summary.sent == 'program filter')}{summary.sent}."]


def _iso(summary: ValidationSummary) -> list[str]:
    """Return sentences on AP and RP, and the poses that they refer to; nothing where no positions were measured."""
    if summary.ap_mm is None:
        return []
    worst = f"the worst of {plural(summary.poses, 'pose')}"
    if summary.cube_edge_mm:
        worst += f", those of the standard's cube of {summary.cube_edge_mm:.0f} mm"
    repeats = "" if summary.rp_mm is None else f", pose repeatability RP {mm(summary.rp_mm)} mm"
    once = "; no repeatability, as no pose was measured twice" if summary.rp_mm is None else ""
    return [f"ISO 9283: pose accuracy AP {mm(summary.ap_mm)} mm{repeats} ({worst}){once}."]


def _probability(summary: ValidationSummary) -> str:
    """Return a sentence on the probability that further poses are within the tolerance."""
    asked = f"the tolerance of {summary.tolerance:g} {summary.unit}"
    are = "is" if summary.beyond == 1 else "are"
    beyond = f"{plural(summary.beyond, 'measured point')} {are} beyond {asked}. " if summary.beyond else ""
    if summary.further_within is None or summary.task_within is None:
        return f"{beyond}So few poses do not show how probable it is that a further one is within {asked}."
    decides = f" (required: {summary.confidence:g})"
    one, every = ("", decides) if summary.decided_by == "task" else (decides, "")
    return (
        f"{beyond}A further pose like these is within {asked} with a probability of {capped(summary.further_within)}{one}, and "
        f"all of {plural(summary.task_poses, 'such pose')} with {capped(summary.task_within)}{every}."
    )


def _promise(validation: Validation) -> str:
    """Return a sentence on the agreement of errors with the calibration's prediction."""
    judged, summary, unit = validation.judged, validation.summary, validation.summary.unit
    promised, attained = f"an RMS error of {mm(summary.promised)} {unit}", f"{mm(judged.rms)} {unit}"
    promise = f"The calibration expected {promised} at these poses; {attained} was measured"
    if not np.isfinite(judged.rms_low):
        return f"{promise}."
    more = judged.rms_low > summary.promised or _any_beyond(validation)
    less = judged.rms_high < summary.promised
    return f"{promise}, {'more than chance allows' if more else 'less than expected' if less else 'which agrees'}."


def _any_beyond(validation: Validation) -> bool:
    """Whether any point's error exceeds its predicted limit, given their number (normal, Bonferroni).

    An outlying pose widens the mean's interval, which then agrees with any prediction. An error may lie along one
    axis, for which the limit uses the predicted standard deviation.
    """
    promised = np.array([pose.promised for pose in validation.poses])
    return bool((_judged_errors(validation) > scipy.stats.norm.isf(BEYOND / 2 / len(promised)) * promised).any())


def _frame(summary: ValidationSummary) -> str:
    if summary.station == "fitted":
        lost = f"{plural(summary.frames, 'frame')}, {summary.freedom_lost} degrees of freedom lost"
        return f"the device's frame was fitted ({lost}); errors are enlarged by what the fit took"
    moved = f"; the motion that fits best would move these points by {mm(summary.moved_mm or 0.0)} mm"
    fits = "" if summary.moved_mm is None else moved
    return f"the device stood where it stood in the calibration{fits}"


def _statistics(accuracy: Sequence[ValidatedModel]) -> Table:
    rows = [
        (NAMES[row.model], f"{mm(row.mean_low)} … {mm(row.mean_high)}", mm(row.rms), mm(row.further))
        for row in accuracy
    ]
    header = ("error", "95 % interval of the mean [{}]", "RMS [{}]", "95 % of further poses below [{}]")
    return Table([name.format(accuracy[0].unit) for name in header], rows, "lrrr")


def _poses(validation: Validation) -> Table:
    """Return one row per point."""
    commanded = "commanded" in [row.model for row in validation.accuracy]
    unit, judged = validation.summary.unit, validation.summary.tolerance is not None
    sizes = {f"nominal [{unit}]": "nominal", f"calibrated [{unit}]": "calibrated"}
    sizes |= {"command [mm]": "commanded_mm"} if commanded else {}
    sizes |= {f"expected sd [{unit}]": "promised"}
    sizes |= {"RP [mm]": "rp_mm"} if validation.summary.of_positions else {}
    header = ["pose", "marker", "rows", *sizes, *["within"] * judged]
    rows = [
        [pose.pose, pose.marker, str(pose.rows), *(mm(getattr(pose, name)) for name in sizes.values()),
         *[{None: "", True: "yes", False: "no"}[pose.within]] * judged]
        for pose in validation.poses
    ]  # fmt: skip
    beyond = frozenset(k for k, pose in enumerate(validation.poses) if pose.within is False)
    return Table(header, rows, "ll" + "r" * (1 + len(sizes)) + "l" * judged, beyond)


def _errors_by_pose(validation: Validation) -> Figure:
    """Draw the errors of every pose before and after in descending order, with the tolerance."""
    order, summary = np.argsort(-_judged_errors(validation), kind="stable"), validation.summary
    poses = [validation.poses[k] for k in order]
    drawn, axes = chart(2.2)
    at = np.arange(len(poses))
    axes.plot(at, [pose.nominal for pose in poses], "o", color=MIDDLE, markersize=3, label="nominal")
    axes.plot(at, _judged_errors(validation)[order], "^", color=DARK, markersize=4, label=summary.judged)
    axes.plot(at, [pose.promised for pose in poses], "_", color="black", markersize=6, label="expected (1 sd)")
    if summary.tolerance is not None:
        axes.axhline(
            summary.tolerance, color=ACCENT, linestyle="--", label=f"tolerance {summary.tolerance:g} {summary.unit}"
        )
    axes.set(yscale="log", ylabel=f"error [{summary.unit}]")
    axes.yaxis.set_major_formatter("{x:g}")
    name_poses(axes, poses, after=", the largest error first")
    drawn.legend(loc="outside upper center", ncols=4)
    return drawn


def _judged_errors(validation: Validation) -> np.ndarray:
    """Return the errors of all points by the judged model, shape (n_points,) [unit]."""
    return np.array([pose.judged for pose in validation.poses])
