"""The report of a robot's history: what moved when, what to recalibrate, and every parameter over the runs."""

from __future__ import annotations

from math import ceil

import numpy as np
from matplotlib.figure import Figure

from calflow.deployment.history import History, MovedParameter, ParameterInRun, Verdict
from calflow.files.words import capped, effect_words, first_up, listed, plural, quantity, readable, rounded
from calflow.reporting.blocks import Paragraph, Part, Plot, Table, cover, headed, in_a_line, noted
from calflow.reporting.style import ACCENT, DARK, panels, turned

VERDICTS: dict[Verdict, str] = {
    "in place": "Nothing has moved between these calibrations that they could show.",
    "moved": "Something has moved between these calibrations.",
    "cannot be told": "Something has moved, but which parameter is not clear.",
    "cannot be seen": "Nothing shows, but these calibrations could hardly show anything.",
}
PARAMETERS_DRAWN, ACROSS = 9, 3  # parameters drawn, and panels per row
PARAMETERS_NAMED = 15  # parameters in a sentence
CAPTION = (
    "Estimates from each run's measurements alone (± 2 standard deviations), as the difference from the first run; lines: "
    "means between changes. First the parameters that moved, then those that differ most."
)


def history_report(history: History, title: str) -> list[Part]:
    """Return the parts of a history's report."""
    runs = in_a_line(plural(len(history.runs), "calibration"), f"{history.runs[0].run} to {history.runs[-1].run}")
    return [("", [
        *cover("History of a robot", title, [Paragraph(runs)], VERDICTS[history.status], history_lines(history)[1:]),
        *([Plot("history", _course(history), CAPTION, history.results.tables["parameters.csv"])] if history.parameters else []),
        *headed("What moved", _moved_table(history), where=history.moved),
        *headed("What one change would explain", _lone_table(history), where=history.lone),
        *headed("From run to run", _runs(history)),
        *noted("What was left out", history.notes),
    ])]  # fmt: skip


def history_lines(history: History) -> list[str]:
    """Return the verdict in sentences, the shortest first."""
    lines = [VERDICTS[history.status], *(f"{first_up(_moved(moved))}." for moved in history.moved)]
    lines += [
        f"{first_up(lone.meaning)} ({lone.parameter}) moved between {lone.after} and {lone.before} by "
        f"{quantity(lone.shift, lone.sd, lone.unit)}: alone it explains all that changed (probability {capped(lone.probability)} "
        "among changes of one parameter)."
        for lone in history.named
    ]
    lines += [
        f"Before {change.run} something moved (chance {change.p:.1g} otherwise), but the measurements do not show which parameter."
        for change in history.nameless
    ]
    if renew := [present.parameter for present in history.present if present.recalibrate]:
        lines.append(
            f"To recalibrate: {listed(renew, PARAMETERS_NAMED)}; present.csv has their figures since they moved, and those of "
            "all that stayed by all runs together."
        )
    if unknown := [present.parameter for present in history.present if not present.told]:
        lines.append(
            f"Of {plural(len(unknown), 'parameter')} no change can be detected, as the measurements of some run do not "
            f"determine them by themselves: {listed(unknown, PARAMETERS_NAMED)}."
        )
    lines.append(f"False alarms: {100 * history.false_alarm:g} in 100 such histories where nothing moved.")
    return lines


def _moved(moved: MovedParameter) -> str:
    """Return a sentence on what moved, when, and by how much."""
    when = f"between {moved.after} and {moved.before}"
    if (moved.after, moved.before) != (moved.surely_after, moved.surely_before):
        when = f"between {moved.surely_after} and {moved.surely_before}, most likely after {moved.after}"
    size = quantity(moved.shift, moved.sd, moved.unit)
    return f"{moved.meaning} ({moved.parameter}) moved {when} by {size}, {abs(moved.in_sd):.0f} standard deviations"


def _moved_table(history: History) -> Table:
    rows = [
        (moved.parameter, effect_words(moved.effect), f"{moved.after} → {moved.before}",
         quantity(moved.shift, moved.sd, moved.unit), f"{moved.in_sd:.1f}", f"{moved.p:.1g}")
        for moved in history.moved
    ]  # fmt: skip
    return Table(("parameter", "of", "runs", "shift", "in sd", "p of all"), rows, "lllrrr")


def _lone_table(history: History) -> Table:
    rows = [
        (lone.parameter, effect_words(lone.effect), f"{lone.after} → {lone.before}", quantity(lone.shift, lone.sd, lone.unit),
         capped(lone.probability), f"{lone.left_p:.1g}")
        for lone in history.lone
    ]  # fmt: skip
    return Table(("parameter", "of", "runs", "shift if alone", "probability", "p of the rest"), rows, "lllrrr")


def _runs(history: History) -> Table:
    rows = [
        (run.run, run.date or "–", "–" if run.chi2 is None else f"{rounded(run.chi2)} of {run.freedom}",
         "–" if run.p is None else f"{run.p:.1g}", "–" if run.p is None else "moved" if run.moved else "in place")
        for run in history.runs
    ]  # fmt: skip
    return Table(("run", "measured", "chi² since the one before", "p", "verdict"), rows, "llrrl")


def _shown(history: History, courses: dict[str, list[ParameterInRun]]) -> list[str]:
    """Return the parameters to draw: those that moved, then those that differ most between runs, if determined."""
    moved = [moved.parameter for moved in sorted(history.moved, key=lambda moved: -abs(moved.in_sd))]
    moved += [lone.parameter for lone in history.named if lone.parameter in courses]
    spread: dict[str, float] = {}
    for name, course in courses.items():
        if course[0].told:
            value, weight = np.array([run.value for run in course]), np.array([run.sd for run in course]) ** -2.0
            spread[name] = float(weight @ (value - np.average(value, weights=weight)) ** 2)
    return list(dict.fromkeys((*moved, *sorted(spread, key=lambda name: -spread[name]))))[:PARAMETERS_DRAWN]


def _course(history: History) -> Figure:
    """Draw estimates of parameters over the runs."""
    courses: dict[str, list[ParameterInRun]] = {}
    for parameter in history.parameters:
        courses.setdefault(parameter.parameter, []).append(parameter)
    names, runs = _shown(history, courses), [run.run for run in history.runs]
    rows = max(1, ceil(len(names) / ACROSS))
    drawn, grid = panels(rows, ACROSS, 1.5 * rows + 0.3 + turned(runs), sharex=True)
    at = np.arange(len(runs))
    for k, (axes, name) in enumerate(zip(grid.flat, names, strict=False)):
        factor, unit = readable(courses[name][0].unit)
        value, sd = factor * np.array([(run.value - courses[name][0].value, run.sd) for run in courses[name]]).T
        axes.errorbar(at, value, 2 * sd, fmt="o", color=DARK, capsize=1.8, elinewidth=1.0)
        steps = sorted(runs.index(moved.before) for moved in history.moved if moved.parameter == name)
        for begin, end in zip([0, *steps], [*steps, len(runs)], strict=True):
            mean = np.average(value[begin:end], weights=sd[begin:end] ** -2.0)
            axes.plot([begin - 0.3, end - 0.7], [mean, mean], color=ACCENT)
        symbol, meaning = name.rsplit(".", 1)[-1], courses[name][0].meaning
        axes.set(
            title=f"{meaning} ({symbol})" if meaning else name, ylabel=f"change [{unit}]", xlim=(-0.5, len(runs) - 0.5)
        )
        axes.set_xticks(at, runs, rotation=90)
        if k + ACROSS >= len(names):
            axes.tick_params(labelbottom=True)
    for axes in grid.flat[len(names) :]:
        axes.set_visible(False)
    return drawn
