"""The report of a drift check: what moved, by how much, what to correct, and every check pose."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from calflow.deployment.drift import Drift, Moved, Recalibrated, Status
from calflow.files.words import first_up, listed, mm, plural, readable, with_sd
from calflow.reporting.blocks import Block, Bullets, Gap, Heading, Paragraph, Plot, Table
from calflow.reporting.style import ACCENT, DARK, MIDDLE, figure

VERDICTS: dict[Status, str] = {
    "in place": "Nothing has moved that these check poses could show.",
    "moved": "Something has moved since the calibration.",
    "conditions": "Nothing has moved: the conditions differ from those of the calibration.",
    "cannot be told": "The check poses are off, but what has moved cannot be told from them.",
}
MOST_TOLD = 12  # movements in the table of what was tested
SURE = 0.95  # probability from which a movement is named without a doubt


def drift_report(found: Drift, title: str, file: str) -> list[tuple[str, list[Block]]]:
    """Return the parts of a drift check's report; file is the name of the check poses."""
    summary = found.summary
    poses = len({one.pose for one in found.poses})  # each with a row a marker
    measured = f"{file}  ·  {plural(poses, 'check pose')}  ·  {plural(summary.sessions, 'session')}"
    blocks: list[Block] = [
        Paragraph("Drift check", 10),
        Paragraph(title, 21, bold=True),
        Paragraph(measured, 10),
        Gap(14),
        Paragraph(VERDICTS[summary.status], 14, bold=True),
        Gap(6),
        *(Paragraph(line, 11) for line in drift_lines(found)[1:]),
        Plot("check_poses", _drawn(found)),
    ]
    if found.recalibration:
        blocks += [Heading("The smallest recalibration"), _recalibration(found.recalibration)]
    if found.next_poses:
        blocks += [Heading("Poses that would settle it"), _next(found)]
    if summary.notes:
        blocks += [Heading("What was assumed"), Bullets([first_up(f"{note}.") for note in summary.notes], 9.5)]
    return [("", blocks), ("What was tested", [_explained(), _tested(found)])]


def drift_lines(found: Drift) -> list[str]:
    """Return the verdict in sentences, the shortest first."""
    summary = found.summary
    lines = [VERDICTS[summary.status]]
    lines += [f"{first_up(_moved(one, found))}." for one in found.moved]
    off = f"The check poses are off by {mm(summary.error_mm)} mm on average"
    if found.recalibration:
        lines.append(f"The smallest recalibration adds that to what was calibrated and leaves all else (recalibration.csv). {off}; "
                     f"{mm(summary.left_mm)} mm are left with it.")  # fmt: skip
    elif found.moved:
        lines.append(f"{off}; without what is named, {mm(summary.left_mm)} mm are left.")
    else:
        lines.append(f"{off}; {mm(summary.expected_mm)} mm (root mean square) were expected where nothing moved.")
    if found.next_poses:
        lines.append(
            f"{plural(len(found.next_poses), 'further pose')} (next_poses.csv), measured and added to these rows, {_gain(found)}."
        )
    if not found.moved:
        lines.append(seen_from(found))
    lines.append(f"Where nothing moved, so much would be told in {100 * summary.false_alarm:g} of 100 checks.")
    return lines


def _moved(one: Moved, found: Drift) -> str:
    """Say what moved, by how much, how surely, and since when."""
    own = [row for row in found.recalibration if row.movement == one.movement]
    size = f" by {listed([_shift(row) for row in own])}" if own else ""
    since = f", since {one.since} (not yet in {one.before})" if one.since else ""
    if not one.since and found.summary.sessions > 1:
        since = f", in all {found.summary.sessions} sessions"
    sure = "" if one.probability >= SURE else f" (probability {one.probability:.2f})"
    meanings = {other.movement: other.meaning for other in found.candidates}
    others = [meanings.get(name, name) for name in one.cannot_tell_from]
    rivals = f"; it cannot be told from a change of: {listed(others, 6)}" if others else ""
    verb = "differs" if one.kind == "condition" else "has changed"
    return f"{one.meaning} {verb}{size}{since}{sure}{rivals}"


def _gain(found: Drift) -> str:
    """Say what the poses proposed would tell."""
    if not found.moved[0].cannot_tell_from:
        return "would tell by how much more surely"
    if found.summary.chance is None:
        return "would tell more"
    return f"would exclude the wrong ones with a chance of {found.summary.chance:.2f}"


def _shift(row: Recalibrated) -> str:
    factor, unit = readable(row.unit)
    value, sd = with_sd(factor * row.shift, factor * row.sd)
    return f"{row.symbol + ' ' if row.symbol != 'zero' else ''}{value} ± {sd} {unit}"


def seen_from(found: Drift) -> str:
    """Say how far each joint's zero may have moved unseen."""
    limits = []
    for one in sorted((one for one in found.candidates if one.kind == "zero"), key=lambda one: one.joint or 0):
        factor, unit = readable(one.units[0])
        limits.append(
            f"{one.joint}: {factor * one.limits[0]:.2g} {unit}" if np.isfinite(one.limits[0]) else f"{one.joint}: any"
        )
    return f"A shift of a joint's zero would be found in 95 of 100 checks from this size on: joint {', '.join(limits)}."


def _recalibration(rows: Sequence[Recalibrated]) -> Block:
    said = [(row.movement, row.symbol, _shift(row), row.parameter or "–") for row in rows]
    return Table(("what moved", "number", "add to what was calibrated", "model's parameter"), said, "llrl")


def _next(found: Drift) -> Block:
    header = [*found.next_poses[0].readings, "payload", "marker"]
    rows = [
        [*(f"{value:.2f}" for value in one.readings.values()), one.payload or "none", one.marker]
        for one in found.next_poses
    ]
    return Table(header, rows, "r" * (len(header) - 2) + "ll")


def _explained() -> Block:
    return Paragraph(
        "Each by itself against nothing having moved, the likeliest first. The last column is the shift that these check poses "
        "would show in 95 of 100 cases; of several numbers, that of the first.", 9.5,
    )  # fmt: skip


def _tested(found: Drift) -> Block:
    rows = []
    for one in found.candidates[:MOST_TOLD]:
        factor, unit = readable(one.units[0])
        value, sd = with_sd(factor * one.shifts[0], factor * one.sds[0])
        limit = f"{factor * one.limits[0]:.2g}" if np.isfinite(one.limits[0]) else "–"
        rows.append((one.movement, unit, value, sd, f"{one.p:.1g}", f"{one.probability:.3f}", limit))
    return Table(("what may have moved", "unit", "shift", "sd", "p alone", "probability", "seen from"), rows, "llrrrrr")


def _drawn(found: Drift) -> Figure:
    """Draw each check pose's error, what was expected, and what is left."""
    drawn = figure(2.0)
    axes = drawn.add_subplot()
    at = np.arange(len(found.poses))
    axes.bar(at, [one.error_mm for one in found.poses], 0.6, color=MIDDLE, label="off")
    axes.plot(
        at,
        [2 * one.expected_mm for one in found.poses],
        "_",
        color=ACCENT,
        markersize=14,
        label="2 sd of what is expected",
    )
    if found.moved:
        axes.plot(
            at,
            [one.left_mm for one in found.poses],
            "^",
            color=DARK,
            markersize=4,
            label="left with what is named put right",
        )
    axes.set_xticks(at, [one.pose for one in found.poses])
    axes.set_xlabel("check pose")
    axes.set_ylabel("error [mm]")
    axes.grid(axis="x", visible=False)
    drawn.legend(loc="outside upper center", ncols=3)
    return drawn
