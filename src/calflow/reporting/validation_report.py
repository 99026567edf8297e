"""The report of a validation: the verdict, the errors before and after, and every pose, on one or two pages."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from scipy.stats import norm

from calflow.deployment.attained import CYCLES
from calflow.deployment.validation import Status, ValidatedModel, ValidatedPose, Validation, ValidationSummary
from calflow.files.words import first_up, mm, plural
from calflow.reporting.blocks import Block, Bullets, Card, Columns, Gap, Heading, Paragraph, Plot, Table
from calflow.reporting.style import ACCENT, DARK, MIDDLE, figure

NAMES = {
    "nominal": "nominal robot",
    "calibrated": "calibrated robot",
    "commanded": "compensated commands",
}
BEYOND = 0.025  # chance that any point errs by more than promised
MOST_NAMED = 60  # poses that are named in a figure
VERDICTS: dict[Status, str] = {
    "met": "The tolerance is met.",
    "not met": "The tolerance is not met.",
    "cannot be told": "Whether the tolerance is met cannot be told from these poses.",
    "no tolerance": "No tolerance was asked for.",
}


def validation_report(found: Validation, title: str, file: str) -> list[tuple[str, list[Block]]]:
    """Return the parts of a validation's report; file is the name of the measurements."""
    first = [
        Paragraph("Validation report", 10),
        Paragraph(title, 21, bold=True),
        Paragraph(_measured(found.summary, file), 10),
        Gap(16),
        Paragraph(VERDICTS[found.summary.status], 14, bold=True),
        Gap(6),
        *(Paragraph(line, 11) for line in verdict_lines(found)[1:]),
        Gap(12),
        Columns([[_card(one, one is found.judged)] for one in found.accuracy], [1] * len(found.accuracy), 8),
        Gap(12),
        _statistics(found.accuracy),
        Plot("poses", _drawn(found)),
        Heading("What was assumed"),
        Bullets([first_up(f"{note}.") for note in (_frame(found.summary), *found.summary.notes)], 9.5),
    ]
    return [("", first), ("Every pose", [_explained(found.summary), _poses(found)])]


def verdict_lines(found: Validation) -> list[str]:
    """Return the verdict with its probabilities in sentences, the shortest first."""
    summary, judged, before = found.summary, found.judged, found.of("nominal")
    mean = _interval(judged.mean_mm, judged.mean_low_mm, judged.mean_high_mm)
    lines = [
        VERDICTS[summary.status],
        f"At {plural(summary.poses, 'new pose')} the mean error is {mean} ({NAMES[judged.model]}, before {mm(before.mean_mm)} mm); "
        f"the largest is {mm(judged.max_mm)} mm (before {mm(before.max_mm)} mm).",
    ]
    if summary.tolerance_mm is not None:
        lines.append(_probability(summary))
    elif np.isfinite(judged.further_mm):
        lines.append(
            f"A further pose like these errs by less than {mm(judged.further_mm)} mm with a probability of 95 %."
        )
    return [*lines, _promise(found), _iso(summary)]


def _iso(summary: ValidationSummary) -> str:
    """Say AP and RP, and which poses they are of."""
    worst = f"the worst of {plural(summary.poses, 'pose')}"
    if summary.cube_edge_mm:
        worst += f", those of the standard's cube of {summary.cube_edge_mm:.0f} mm"
    if summary.rp_mm is None:
        return f"ISO 9283: pose accuracy AP {mm(summary.ap_mm)} mm ({worst}); no repeatability, as no pose was measured twice."
    return f"ISO 9283: pose accuracy AP {mm(summary.ap_mm)} mm, pose repeatability RP {mm(summary.rp_mm)} mm ({worst})."


def _probability(summary: ValidationSummary) -> str:
    """Say how probable it is that further poses are within the tolerance."""
    asked = f"the tolerance of {summary.tolerance_mm:g} mm"
    are = "is" if summary.beyond == 1 else "are"
    beyond = f"{plural(summary.beyond, 'measured point')} {are} beyond {asked}. " if summary.beyond else ""
    if summary.further_within is None or summary.task_within is None:
        return f"{beyond}How probable it is that a further pose is within {asked} cannot be told from so few."
    decides = "of all" if summary.decided_by == "task" else "of one"
    return (
        f"{beyond}A further pose like these is within {asked} with a probability of {_chance(summary.further_within)}, all of "
        f"{plural(summary.task_poses, 'pose')} with {_chance(summary.task_within)} (asked for: {summary.confidence:g} {decides})."
    )


def _chance(probability: float) -> str:
    """A probability with as many digits as tell it from 0 and 1."""
    return "over 0.999" if probability > 0.999 else "under 0.001" if probability < 0.001 else f"{probability:.3f}"


def _promise(found: Validation) -> str:
    """Say whether the errors are what the calibration promised."""
    judged, summary = found.judged, found.summary
    said = (
        f"The calibration promised {mm(summary.promised_mm)} mm (root mean square); found were {mm(judged.rms_mm)} mm"
    )
    if not np.isfinite(judged.rms_low_mm):
        return f"{said}."
    more = judged.rms_low_mm > summary.promised_mm or _one_is_beyond(found)
    less = judged.rms_high_mm < summary.promised_mm
    return f"{said}, {'more than chance allows' if more else 'less than promised' if less else 'which agrees'}."


def _one_is_beyond(found: Validation) -> bool:
    """Whether any point errs by more than its promise allows of so many (normal, Bonferroni).

    A wild pose widens the mean's interval, so that this alone would agree with any promise. All of an error may lie along one
    axis, along which the promise is its standard deviation.
    """
    own = [one.commanded_mm if found.summary.judged == "commanded" else one.calibrated_mm for one in found.poses]
    promised = np.array([one.promised_mm for one in found.poses])
    return bool((np.array(own) > norm.isf(BEYOND / 2 / len(own)) * promised).any())


def _frame(summary: ValidationSummary) -> str:
    if summary.station == "fitted":
        lost = f"{plural(summary.frames, 'frame')}, {summary.freedom_lost} degrees of freedom lost"
        return f"the device's frame was fitted ({lost}); errors are enlarged by what the fit took"
    fits = (
        ""
        if summary.moved_mm is None
        else f"; the motion that fits best would take these points {mm(summary.moved_mm)} mm"
    )
    return f"the device stood where it stood in the calibration{fits}"


def _measured(summary: ValidationSummary, file: str) -> str:
    return f"{file}  ·  {plural(summary.poses, 'pose')}  ·  {plural(summary.rows, 'measured point')}"


def _interval(value: float, low: float, high: float) -> str:
    return f"{mm(value)} mm ({mm(low)} to {mm(high)} mm)" if np.isfinite(low) else f"{mm(value)} mm"


def _card(one: ValidatedModel, last: bool) -> Block:
    return Card(NAMES[one.model], mm(one.mean_mm), f"largest {mm(one.max_mm)} mm", dark=last)


def _statistics(accuracy: Sequence[ValidatedModel]) -> Block:
    rows = [
        (NAMES[one.model], mm(one.mean_mm), f"{mm(one.mean_low_mm)} … {mm(one.mean_high_mm)}", mm(one.rms_mm), mm(one.max_mm),
         mm(one.further_mm))
        for one in accuracy
    ]  # fmt: skip
    header = ("error", "mean [mm]", "95 % interval", "rms [mm]", "largest [mm]", "95 % of further poses below [mm]")
    return Table(header, rows, "lrrrrr")


def _explained(summary: ValidationSummary) -> Block:
    fewer = f" The standard has {CYCLES} cycles; here a pose has {summary.fewest_cycles} at least."
    said = (
        "A pose's error is the distance from where it should be to the barycentre of its rows: ISO 9283's pose accuracy AP. RP is "
        "the mean distance of its rows from their barycentre and three standard deviations."
    )
    return Paragraph(said + fewer * (summary.fewest_cycles < CYCLES), 9.5)


def _poses(found: Validation) -> Block:
    """A row a point."""
    commanded = "commanded" in [one.model for one in found.accuracy]
    errors = ["nominal [mm]", "calibrated [mm]", *["command [mm]"] * commanded]
    judged = found.summary.tolerance_mm is not None
    header = ["pose", "marker", "rows", *errors, "promised sd [mm]", "RP [mm]", *["within"] * judged]
    rows = []
    for one in found.poses:
        sizes = [one.nominal_mm, one.calibrated_mm, *[one.commanded_mm] * commanded, one.promised_mm, one.rp_mm]
        within = {None: "", True: "yes", False: "no"}[one.within]
        rows.append([one.pose, one.marker, str(one.rows), *map(mm, sizes), *[within] * judged])
    beyond = frozenset(k for k, one in enumerate(found.poses) if one.within is False)
    return Table(header, rows, "ll" + "r" * (len(header) - 2 - judged) + "l" * judged, beyond)


def _drawn(found: Validation) -> Figure:
    """Draw the errors of every pose before and after, the largest first, with the tolerance."""
    poses = sorted(found.poses, key=lambda one: -_judged(one, found))
    drawn = figure(2.2)
    axes = drawn.add_subplot()
    at = np.arange(len(poses))
    axes.plot(at, [one.nominal_mm for one in poses], "o", color=MIDDLE, markersize=3, label="nominal")
    axes.plot(at, [_judged(one, found) for one in poses], "^", color=DARK, markersize=4, label=found.summary.judged)
    axes.plot(at, [one.promised_mm for one in poses], "_", color="black", markersize=6, label="promised (1 sd)")
    if found.summary.tolerance_mm is not None:
        axes.axhline(
            found.summary.tolerance_mm,
            color=ACCENT,
            linestyle="--",
            label=f"tolerance {found.summary.tolerance_mm:g} mm",
        )
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.set_ylabel("error [mm]")
    if len(poses) <= MOST_NAMED:
        axes.set_xticks(at, [one.pose for one in poses], rotation=90 if len(poses) > 20 else 0)
    axes.set_xlabel("pose, the largest error first")
    axes.grid(axis="x", visible=False)
    drawn.legend(loc="outside upper center", ncols=4)
    return drawn


def _judged(one: ValidatedPose, found: Validation) -> float:
    return one.commanded_mm if found.summary.judged == "commanded" else one.calibrated_mm
