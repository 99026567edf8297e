"""The report of a comparison: runs side by side, on one or two pages."""

from __future__ import annotations

from collections.abc import Sequence

from calflow.deployment.comparison import Comparison, ParameterDifference, RunAccuracy, RunPair
from calflow.files.words import effect_words, listed, mm, plural, readable, with_sd
from calflow.reporting.blocks import Block, Gap, Heading, Paragraph, Table

MOST_TOLD = 25  # parameters that are told, the most significant first
DIFFERENT = 0.01  # chance below which runs are said to differ
AGREE = dict.fromkeys(("the same", "another file"), "agree as well as both know them") | {
    "another one": "are known too little to tell the robots apart"
}
SPLITS = {"train": "used for the fit", "holdout": "held out"}


def comparison_report(names: Sequence[str], found: Comparison) -> list[tuple[str, list[Block]]]:
    """Return the parts of a comparison's report; names are the runs'."""
    blocks: list[Block] = [Paragraph("Comparison of runs", 10), Paragraph(listed(names), 16, bold=True), Gap(10)]
    blocks += [Paragraph(line, 11) for line in comparison_lines(found)]
    blocks += [Heading("Measurements and accuracy"), _data(found), _accuracy(found)]
    if found.causes:
        blocks += [Heading("What the models lacked"), _causes(found)]
    if found.parameters:
        blocks += [Heading("Parameters, the most different first"), _parameters(found)]
    if found.settings:
        blocks += [Heading("What was asked differently"), _settings(found, names)]
    return [("", blocks)]


def comparison_lines(found: Comparison) -> list[str]:
    """Return what differs in sentences, one a pair of runs."""
    lines = [_pair(pair, found) for pair in found.pairs]
    last = _last(found)
    for split, words in (("holdout", SPLITS["holdout"]), ("train", SPLITS["train"])):
        rows = [row for row in last if row.split == split]
        if rows:
            errors = [f"{row.run} {mm(row.mean_mm)} mm" for row in rows]
            return [*lines, f"Mean error at poses {words}: {listed(errors)}."]
    return lines


def _pair(pair: RunPair, found: Comparison) -> str:
    """Say whether two runs are of one robot, and differ by more than chance."""
    other = _other_robot(pair)
    if pair.p is None:
        return (f"{other}{pair.first} and {pair.second} are of the same measurements: their parameters share their errors, and no "
                "test of chance applies.")  # fmt: skip
    rows = [one for one in found.parameters if (one.first, one.second) == (pair.first, pair.second)]
    differ = [one.parameter for one in rows if one.significant]
    verdict = "differ by more than both leave open" if pair.p < DIFFERENT else AGREE[pair.robot]
    alone = f"; by themselves {listed(differ, 6)}" if differ else ""
    test = f"chi² {pair.chi2:.3g} of {pair.freedom}, chance {pair.p:.2g}"
    return (
        f"{other}{pair.first} and {pair.second}: {plural(pair.shared, 'shared parameter')} {verdict} ({test}){alone}."
    )


def _other_robot(pair: RunPair) -> str:
    """Say first where two runs are not of one robot."""
    if pair.robot == "another one":
        return f"{pair.first} and {pair.second} are of different robots, {listed(pair.robots)}. "
    return "" if pair.robot == "the same" else f"{pair.first} and {pair.second} have different robot files. "


def _last(found: Comparison) -> list[RunAccuracy]:
    """The best model of each run on each split."""
    return list({(row.run, row.split): row for row in found.accuracy}.values())


def _data(found: Comparison) -> Block:
    rows = [
        (one.run, listed(one.files), str(one.poses), str(one.held_out), f"{mm(one.noise_mm)} ({', '.join(one.noise_from)})",
         mm(one.discrepancy_mm))
        for one in found.data
    ]  # fmt: skip
    return Table(("run", "measurements", "poses", "held out", "noise [mm]", "beyond it [mm]"), rows, "llrrll")


def _accuracy(found: Comparison) -> Block:
    rows = [
        (row.run, effect_words(row.model), SPLITS[row.split], mm(row.mean_mm), mm(row.max_mm)) for row in _last(found)
    ]
    return Table(("run", "model", "poses", "mean [mm]", "max [mm]"), rows, "lllrr", wide=1)


def _causes(found: Comparison) -> Block:
    rows = []
    for one in found.causes:
        factor, unit = readable(one.unit) if one.unit else (1.0, "")
        value, sd = with_sd(factor * one.estimate, factor * one.sd)
        place = f", joint {one.joint}" if one.joint else ""
        rows.append(
            (
                one.run,
                f"{effect_words(one.cause) or 'unexplained'}{place}",
                f"{value} ± {sd} {unit}",
                listed(one.also_in),
            )
        )
    return Table(("run", "cause", "size", "also found in"), rows, "llrl")


def _parameters(found: Comparison) -> Block:
    def chance(one: ParameterDifference) -> float:
        return 0.0 if one.p is None else one.p

    rows = []
    for one in sorted(found.parameters, key=chance)[:MOST_TOLD]:
        factor, unit = readable(one.unit)
        value, sd = with_sd(factor * one.difference, float("nan") if one.sd is None else factor * one.sd)
        rows.append(
            (
                f"{one.first} → {one.second}",
                one.parameter,
                f"{value} ± {sd} {unit}",
                "–" if one.p is None else f"{one.p:.1g}",
            )
        )
    return Table(("runs", "parameter", "difference", "p"), rows, "llrr")


def _settings(found: Comparison, names: Sequence[str]) -> Block:
    rows = [[one.setting, *(one.of[name] for name in names)] for one in found.settings]
    return Table(("setting", *names), rows, "l" * (1 + len(names)), size=8)
