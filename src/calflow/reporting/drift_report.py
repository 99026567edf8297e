"""The report of a drift check: what moved, by how much, what to correct, and every check pose."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from calflow.deployment.drift import Drift, Moved, Recalibrated, Status
from calflow.files.words import first_up, listed, mm, percent, plural, plural_word, quantity, readable, rounded, with_sd
from calflow.reporting.advice import after_drift
from calflow.reporting.blocks import NEXT, Paragraph, Part, Plot, Table, cover, headed, in_a_line, noted
from calflow.reporting.style import ACCENT, DARK, MIDDLE, chart, name_poses

VERDICTS: dict[Status, str] = {
    "in place": "Nothing has moved that these check poses could show.",
    "moved": "Something has moved since the calibration.",
    "cannot be seen": "Nothing shows, but these check poses could hardly show anything.",
    "conditions": "Nothing has moved: the conditions differ from those of the calibration.",
    "cannot be told": "The check poses are off, but do not show what has moved.",
}
MOVEMENTS_SHOWN = 12  # movements in the table of what was tested
SMALL = 0.1  # rad or m up to which a shift counts as small, as the test takes it
SMALL_SHARE = 1e-3  # below which a share is stated in millionths
SURE_OF_MOVEMENT = 0.95  # probability above which a movement is named without reservation
EACH_ALONE = (
    "Each movement tested alone against nothing having moved, the most probable first. Detection limit: the shift that these "
    "check poses would show in 95 of 100 cases (of several numbers, of the first)."
)


def drift_report(drift: Drift, title: str, file: str) -> list[Part]:
    """Return the parts of a drift check's report; file is the name of the check poses."""
    summary = drift.summary
    poses = len({pose.pose for pose in drift.poses})  # each with a row a marker
    measured = in_a_line(file, plural(poses, "check pose"), plural(summary.sessions, "session"))
    blocks = [
        *cover("Drift check", title, [Paragraph(measured)], VERDICTS[summary.status], drift_lines(drift)[1:]),
        *headed(NEXT, Paragraph(after_drift(drift), 11)),
        Plot("check_poses", _check_poses(drift)),
        *headed("The smallest recalibration", _recalibration(drift), where=drift.recalibration),
        *(headed("Poses that would settle it", _next_poses(drift)) if drift.next_poses else ()),
        *noted("What was assumed", summary.notes),
    ]
    return [("", blocks), ("What was tested", [Paragraph(EACH_ALONE, 9.5), _tested(drift)])]


def drift_lines(drift: Drift) -> list[str]:
    """Return the verdict in sentences, the shortest first."""
    summary = drift.summary
    lines = [VERDICTS[summary.status]]
    lines += [f"{first_up(_moved(movement, drift))}." for movement in drift.moved]
    off = f"The check poses are off by {mm(summary.error_mm)} mm on average"
    if drift.recalibration:
        lines.append(f"{off}; {mm(summary.left_mm)} mm is left once that is corrected (recalibration.csv).")
    elif drift.moved:
        lines.append(f"{off}; once that is corrected, {mm(summary.left_mm)} mm is left.")
    else:
        rms = np.sqrt(np.mean([pose.error_mm**2 for pose in drift.poses]))
        expected = f"{mm(summary.expected_mm)} mm was expected if nothing had moved"
        lines.append(f"The check poses are off by an RMS error of {mm(rms)} mm; {expected}.")
    if drift.next_poses:
        number = plural(len(drift.next_poses), "further pose")
        lines.append(f"{number} (next_poses.csv), measured and added to these rows, {_gain(drift)}.")
    if summary.status == "cannot be seen":
        unseen = f"by {mm(summary.unseen_mm)} mm" if np.isfinite(summary.unseen_mm) else "by any distance"
        lines.append(
            f"A shifted joint zero may move the tool {unseen} and go unnoticed; a robot of this kind that was never calibrated is "
            f"{mm(summary.usual_mm)} mm off. Measure more check poses that differ more (calflow check-poses)."
        )
    if not drift.moved:
        lines.append(seen_from(drift))
    lines.append(f"False alarms: {100 * summary.false_alarm:g} in 100 checks where nothing moved.")
    return lines


def _moved(movement: Moved, drift: Drift) -> str:
    """Return a sentence on what moved, by how much, with what probability, and since when."""
    shifts = [_shift(row) for row in drift.recalibration if row.movement == movement.movement]
    size = f" by {listed(shifts)}" if shifts else ""
    since = f", since {movement.since} (not yet in {movement.before})" if movement.since else ""
    if not movement.since and drift.summary.sessions > 1:
        since = f", in all {drift.summary.sessions} sessions"
    sure = "" if movement.probability >= SURE_OF_MOVEMENT else f" (probability {movement.probability:.2f})"
    meanings = {candidate.movement: candidate.meaning for candidate in drift.candidates}
    others = [meanings.get(name, name) for name in movement.cannot_tell_from]
    rivals = f"; it may instead be a change of: {listed(others, 6)}" if others else ""
    verb = "differs" if movement.kind == "condition" else "has changed"
    return f"{movement.meaning} {verb}{size}{since}{sure}{rivals}"


def _gain(drift: Drift) -> str:
    """Return words on what measuring the poses proposed would resolve."""
    if not drift.moved[0].cannot_tell_from:
        return "would show more precisely by how much"
    if drift.summary.chance is None:
        return "would show more"
    return f"would exclude the wrong ones with a chance of {percent(drift.summary.chance)}"


def _shift(row: Recalibrated) -> str:
    return f"{row.symbol + ' ' if row.symbol != 'zero' else ''}{quantity(row.shift, row.sd, row.unit)}"


def seen_from(drift: Drift) -> str:
    """Return words on the detection limits of joint zeros; joints whose shift no size reveals are named apart."""
    limits, hidden = [], []
    for zero in sorted((one for one in drift.candidates if one.kind == "zero"), key=lambda zero: zero.joint or 0):
        (factor, unit), limit = readable(zero.units[0]), zero.limits[0]
        if limit < SMALL:
            limits.append(f"{zero.joint}: {rounded(factor * limit, 2)} {unit}")
        else:
            hidden.append(zero.joint)
    found = "A shift of a joint's zero would be found in 95 of 100 checks from this size on"
    seen = [f"{found}: joint {', '.join(limits)}."] if limits else []
    unseen = [f"No shift of {plural_word(hidden, 'joint')} {listed(hidden)} would be found."] if hidden else []
    return " ".join([*seen, *unseen])


def _recalibration(drift: Drift) -> Table:
    meanings = {candidate.movement: first_up(candidate.meaning) for candidate in drift.candidates}
    rows = [
        (meanings.get(row.movement, row.movement), row.symbol, quantity(row.shift, row.sd, row.unit))
        for row in drift.recalibration
    ]
    return Table(("what moved", "figure", "add to what was calibrated"), rows, "llr")


def _next_poses(drift: Drift) -> Table:
    header = [*drift.next_poses[0].readings, "payload", "marker"]
    rows = [
        [*(f"{value:.2f}" for value in pose.readings.values()), pose.payload or "none", pose.marker]
        for pose in drift.next_poses
    ]
    return Table(header, rows, "r" * (len(header) - 2) + "ll")


def _tested(drift: Drift) -> Table:
    rows = []
    for tested in drift.candidates[:MOVEMENTS_SHOWN]:
        factor, unit = readable(tested.units[0])
        if not unit:  # a share, as of a length
            factor, unit = (1e6, "ppm") if tested.sds[0] < SMALL_SHARE else (100.0, "%")
        value, sd = with_sd(factor * tested.shifts[0], factor * tested.sds[0])
        limit = rounded(factor * tested.limits[0], 2)
        rows.append((first_up(tested.meaning), unit, value, sd, f"{tested.p:.1g}", f"{tested.probability:.3f}", limit))
    return Table(
        ("what may have moved", "unit", "shift", "sd", "p alone", "probability", "detection limit"), rows, "llrrrrr"
    )


def _check_poses(drift: Drift) -> Figure:
    """Draw each check pose's error, its expected size, and what remains after recalibration."""
    drawn, axes = chart(2.0)
    at = np.arange(len(drift.poses))
    axes.bar(at, [pose.error_mm for pose in drift.poses], 0.6, color=MIDDLE, label="error now")
    expected = [2 * pose.expected_mm for pose in drift.poses]
    axes.plot(at, expected, "_", color=ACCENT, markersize=14, label="2 sd of what is expected")
    if drift.moved:
        left = [pose.left_mm for pose in drift.poses]
        axes.plot(at, left, "^", color=DARK, markersize=4, label="left once that is corrected")
    axes.set_ylabel("error [mm]")
    name_poses(axes, drift.poses, "check pose")
    drawn.legend(loc="outside upper center", ncols=3)
    return drawn
