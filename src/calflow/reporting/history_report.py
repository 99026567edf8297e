"""The report of a robot's history: what moved when, what to recalibrate, and every parameter over the runs."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

import numpy as np
from matplotlib.figure import Figure

from calflow.deployment.history import History, MovedParameter, ParameterInRun, Verdict
from calflow.files.words import effect_words, first_up, listed, plural, readable, with_sd
from calflow.reporting.blocks import Block, Bullets, Gap, Heading, Paragraph, Plot, Table
from calflow.reporting.style import ACCENT, DARK, panels, turned

VERDICTS: dict[Verdict, str] = {
    "in place": "Nothing has moved between these calibrations that they could show.",
    "moved": "Something has moved between these calibrations.",
    "cannot be told": "Something has moved, but which parameter cannot be told.",
}
SHOWN, ACROSS = 9, 3  # parameters that are drawn, and how many beside each other
MOST_TOLD = 15  # parameters in a sentence


def history_report(found: History, title: str) -> list[tuple[str, list[Block]]]:
    """Return the parts of a history's report."""
    first, last = found.runs[0].run, found.runs[-1].run
    blocks: list[Block] = [
        Paragraph("History of a robot", 10),
        Paragraph(title, 21, bold=True),
        Paragraph(f"{plural(len(found.runs), 'calibration')}  ·  {first} to {last}", 10),
        Gap(14),
        Paragraph(VERDICTS[found.status], 14, bold=True),
        Gap(6),
        *(Paragraph(line, 11) for line in history_lines(found)[1:]),
    ]
    if found.parameters:
        blocks.append(Plot("history", _drawn(found), _caption(found), found.results.tables["parameters.csv"]))
    if found.moved:
        blocks += [Heading("What moved"), _moved_table(found.moved)]
    blocks += [Heading("From run to run"), _runs(found)]
    if found.notes:
        blocks += [Heading("What was left out"), Bullets([first_up(f"{note}.") for note in found.notes], 9.5)]
    return [("", blocks)]


def history_lines(found: History) -> list[str]:
    """Return the verdict in sentences, the shortest first."""
    lines = [VERDICTS[found.status], *(f"{first_up(_moved(one))}." for one in found.moved)]
    lines += [
        f"Before {one.run} something moved (chance {one.p:.1g} otherwise), but the measurements do not tell which parameter."
        for one in found.nameless
    ]
    if renew := [one.parameter for one in found.present if one.recalibrate]:
        lines.append(f"To recalibrate: {listed(renew, MOST_TOLD)}; present.csv has their figures since they moved, and those of "
                     "all that stayed by all runs together.")  # fmt: skip
    if unknown := [one.parameter for one in found.present if not one.told]:
        lines.append(f"Of {plural(len(unknown), 'parameter')} no change can be told, as the measurements of some run do not "
                     f"determine them by themselves: {listed(unknown, MOST_TOLD)}.")  # fmt: skip
    lines.append(f"Where nothing moved, anything would be told in {100 * found.false_alarm:g} of 100 such histories.")
    return lines


def _moved(one: MovedParameter) -> str:
    """Say what moved, when, and by how much."""
    when = f"between {one.after} and {one.before}"
    if (one.after, one.before) != (one.surely_after, one.surely_before):
        when = f"between {one.surely_after} and {one.surely_before}, most likely after {one.after}"
    return f"{one.meaning} ({one.parameter}) moved {when} by {_shift(one)}, {abs(one.in_sd):.0f} standard deviations"


def _shift(one: MovedParameter) -> str:
    factor, unit = readable(one.unit)
    value, sd = with_sd(factor * one.shift, factor * one.sd)
    return f"{value} ± {sd} {unit}"


def _moved_table(moved: Sequence[MovedParameter]) -> Block:
    rows = [
        (one.parameter, effect_words(one.effect), f"{one.after} → {one.before}", _shift(one), f"{one.in_sd:.1f}", f"{one.p:.1g}")
        for one in moved
    ]  # fmt: skip
    return Table(("parameter", "of", "runs", "shift", "in sd", "p of all"), rows, "lllrrr")


def _runs(found: History) -> Block:
    rows = [
        (
            one.run, one.date or "–", "–" if one.chi2 is None else f"{one.chi2:.3g} of {one.freedom}",
            "–" if one.p is None else f"{one.p:.1g}", "–" if one.p is None else "moved" if one.moved else "in place",
        )
        for one in found.runs
    ]  # fmt: skip
    return Table(("run", "measured", "chi² since the one before", "p", "verdict"), rows, "llrrl")


def _shown(found: History) -> list[str]:
    """The parameters that are drawn: those that moved, then those that differ most between runs, of those told."""
    moved = list(dict.fromkeys(one.parameter for one in sorted(found.moved, key=lambda one: -abs(one.in_sd))))
    spread: dict[str, float] = {}
    for name, own in _by_parameter(found).items():
        if own[0].told:
            value, weight = np.array([one.value for one in own]), np.array([one.sd for one in own]) ** -2.0
            spread[name] = float((weight * (value - weight @ value / weight.sum()) ** 2).sum())
    return list(dict.fromkeys((*moved, *sorted(spread, key=lambda name: -spread[name]))))[:SHOWN]


def _by_parameter(found: History) -> dict[str, list[ParameterInRun]]:
    every: dict[str, list[ParameterInRun]] = {}
    for one in found.parameters:
        every.setdefault(one.parameter, []).append(one)
    return every


def _caption(found: History) -> str:
    return (
        "What each run's measurements say by themselves, ± 2 standard deviations, as distance from the first run; lines: means "
        "between changes. Those that moved first, then those that differ most."
    )


def _drawn(found: History) -> Figure:
    """Draw parameters over the runs."""
    names, every = _shown(found), _by_parameter(found)
    runs = [one.run for one in found.runs]
    rows = max(1, ceil(len(names) / ACROSS))
    drawn, axes = panels(rows, ACROSS, 1.5 * rows + 0.3 + turned(runs), sharex=True)
    at = np.arange(len(runs))
    for k, panel in enumerate(axes.flat):
        if k >= len(names):
            panel.set_visible(False)
            continue
        own = every[names[k]]
        factor, unit = readable(own[0].unit)
        value = factor * (np.array([one.value for one in own]) - own[0].value)
        sd = factor * np.array([one.sd for one in own])
        panel.errorbar(at, value, 2 * sd, fmt="o", color=DARK, capsize=1.8, elinewidth=1.0)
        steps = sorted(runs.index(one.before) for one in found.moved if one.parameter == names[k])
        for begin, end in zip([0, *steps], [*steps, len(runs)], strict=True):
            weight = sd[begin:end] ** -2.0
            mean = weight @ value[begin:end] / weight.sum()
            panel.plot([begin - 0.3, end - 0.7], [mean, mean], color=ACCENT)
        panel.set_title(names[k])
        panel.set_ylabel(f"change [{unit}]")
        panel.set_xticks(at, runs, rotation=90)
        panel.set_xlim(-0.5, len(runs) - 0.5)
        if k + ACROSS >= len(names):
            panel.tick_params(labelbottom=True)
    return drawn
