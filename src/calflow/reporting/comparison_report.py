"""The report of a comparison: runs side by side, on one or two pages."""

from __future__ import annotations

from collections.abc import Sequence

from calflow.deployment.comparison import Comparison, RunAccuracy, RunPair
from calflow.effects.wording import cause_name
from calflow.files.words import listed, mm, plural, quantity
from calflow.reporting.blocks import SPLITS, Gap, Paragraph, Part, Table, headed, noted
from calflow.reporting.sections.verdict import step_name

PARAMETERS_SHOWN = 25  # parameters in the table, the most significant first
DIFFERENT = 0.01  # p-value below which runs differ significantly
AGREE = dict.fromkeys(("the same", "another file"), "agree within what both leave open") | {
    "another one": "are not known well enough to distinguish the robots"
}


def comparison_report(names: Sequence[str], comparison: Comparison) -> list[Part]:
    """Return the parts of a comparison's report; names: those of the runs."""
    return [("", [
        Paragraph("Comparison of runs"),
        Paragraph(listed(names), 16, bold=True),
        Gap(10),
        *(Paragraph(line, 11) for line in comparison_lines(comparison)),
        *noted("What was fitted again", comparison.notes),
        *headed("Measurements and accuracy", _data(comparison), _accuracy(comparison)),
        *headed("What the models lacked", _causes(comparison), where=comparison.causes),
        *headed("Parameters", _parameters(comparison), where=comparison.parameters),
        *headed("What was asked differently", _settings(comparison, names), where=comparison.settings),
    ])]  # fmt: skip


def comparison_lines(comparison: Comparison) -> list[str]:
    """Return a sentence per pair of runs on their difference."""
    lines = [_pair(pair, comparison) for pair in comparison.pairs]
    for split, words in reversed(SPLITS.items()):
        if errors := [f"{row.run} {mm(row.mean_mm)} mm" for row in _last(comparison) if row.split == split]:
            return [*lines, f"Mean error at poses {words}: {listed(errors)}."]
    return lines


def _pair(pair: RunPair, comparison: Comparison) -> str:
    """Return a sentence on whether two runs are of one robot, and differ significantly."""
    other = _other_robot(pair)
    if pair.p is None:
        return (
            f"{other}{pair.first} and {pair.second} are of the same measurements: their parameters share their errors, so "
            "no test of chance applies."
        )
    shared = [row for row in comparison.parameters if (row.first, row.second) == (pair.first, pair.second)]
    differ = list(dict.fromkeys(row.curve or row.meaning or row.parameter for row in shared if row.significant))
    verdict = "differ by more than both leave open" if pair.p < DIFFERENT else AGREE[pair.robot]
    alone = f"; alone, {listed(differ, 6)} {'differs' if len(differ) == 1 else 'differ'}" if differ else ""
    test = f"chi² {pair.chi2:.3g} of {pair.freedom}, chance {pair.p:.2g}"
    return (
        f"{other}{pair.first} and {pair.second}: {plural(pair.shared, 'shared parameter')} {verdict} ({test}){alone}."
    )


def _other_robot(pair: RunPair) -> str:
    """Return words for runs that are not of one robot."""
    if pair.robot == "another one":
        return f"{pair.first} and {pair.second} are of different robots, {listed(pair.robots)}. "
    return "" if pair.robot == "the same" else f"{pair.first} and {pair.second} have different robot files. "


def _last(comparison: Comparison) -> list[RunAccuracy]:
    """Return the accuracy of each run's best model on each split."""
    return list({(row.run, row.split): row for row in comparison.accuracy}.values())


def _model_name(last: RunAccuracy, comparison: Comparison) -> str:
    """Return the name of a run's best model, by what it adds to the nominal robot."""
    steps = [row for row in comparison.accuracy if (row.run, row.split) == (last.run, last.split)]
    return " ".join(dict.fromkeys(step_name(row) for row in steps if row.step or len(steps) == 1))


def _data(comparison: Comparison) -> Table:
    rows = [
        (run.run, listed(run.files), str(run.poses), str(run.held_out), f"{mm(run.noise_mm)} ({', '.join(run.noise_from)})",
         mm(run.discrepancy_mm))
        for run in comparison.data
    ]  # fmt: skip
    return Table(("run", "measurements", "poses", "held out", "noise [mm]", "beyond it [mm]"), rows, "llrrlr")


def _accuracy(comparison: Comparison) -> Table:
    rows = [
        (row.run, _model_name(row, comparison), SPLITS[row.split], mm(row.mean_mm), mm(row.max_mm))
        for row in _last(comparison)
    ]
    return Table(("run", "model", "poses", "mean [mm]", "max [mm]"), rows, "lllrr", wide=1)


def _causes(comparison: Comparison) -> Table:
    rows = [
        (cause.run, cause_name(cause.cause, cause.joint) if cause.cause else "unexplained",
         quantity(cause.estimate, cause.sd, cause.unit), listed(cause.also_in))
        for cause in comparison.causes
    ]  # fmt: skip
    return Table(("run", "cause", "size", "also found in"), rows, "llrl")


def _parameters(comparison: Comparison) -> Table:
    each = {(row.first, row.second, row.curve or row.parameter): row for row in comparison.parameters}
    shown = sorted(each.values(), key=lambda row: 0.0 if row.p is None else row.p)[:PARAMETERS_SHOWN]
    number = 4 if any(row.p is not None for row in shown) else 3  # columns: chance is tested, or not
    rows = [
        (f"{row.first} → {row.second}", row.curve or row.meaning or row.parameter,
         "of a curve" if row.curve else quantity(row.difference, float("nan") if row.sd is None else row.sd, row.unit),
         "–" if row.p is None else f"{row.p:.1g}")[:number]
        for row in shown
    ]  # fmt: skip
    return Table(("runs", "parameter", "difference", "p")[:number], rows, "llrr"[:number])


def _settings(comparison: Comparison, names: Sequence[str]) -> Table:
    rows = [[setting.setting, *(setting.of[name] for name in names)] for setting in comparison.settings]
    return Table(("setting", *names), rows, "l" * (1 + len(names)), size=8)
