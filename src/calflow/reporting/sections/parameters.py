"""Parameters: estimates with standard deviations, the share of the prior in each, and what the data do not determine."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import groupby
from textwrap import fill

import numpy as np
from matplotlib.figure import Figure

from calflow.deployment.run_outcome import RunOutcome
from calflow.estimation.parameters import FittedParameter
from calflow.files.deferred import pd
from calflow.files.words import cut, effect_words, interval, listed, readable, with_sd
from calflow.reporting.advice import BY_PRIOR, allowed_range, of_kind
from calflow.reporting.blocks import Block, Bullets, Heading, Paragraph, Plot, Table, headed
from calflow.reporting.material import Material
from calflow.reporting.section import section
from calflow.reporting.sections.verdict import statement_words
from calflow.reporting.style import ACCENT, DARK, LIGHT, chart, turned
from calflow.robot.frames import CONVENTIONS

AT_BOUND = "at a bound, no sd"
CHARACTER = 0.55  # of a parameter's place that a letter takes
MOST_FIGURES = 20  # parameters of a part above which one row summarises them: such a curve is drawn with its cause
MOST_MARKED = 4  # parameters in a trade up to which each is marked
LEGEND = (
    "Each value is the difference from the robot file. jointN has {of_links} s is the joint's compliance: 1 µrad/Nm is 1 mrad at "
    "1 kNm. base is the robot's base, loop the lengths of the bars; other names are markers on the tool and what the robot was "
    "measured by. Grey: determined by the prior, not by the data."
)
DH = (
    "the DH parameters of link N: the angles alpha, theta and beta (about y, where axes are nearly parallel), and the lengths a "
    "and d."
)
ORIGINS = (
    "the shifts x, y, z and the rotations rx, ry, rz of link N in its parent's frame, and theta, the zero of joint N."
)
REGISTERED = " Base and markers: the difference from their nominal poses (see the appendix)."
ADDED = (
    " At the end: the causes that diagnose found. Elsewhere their parameters have the cause in their names, as in "
    "joint3.joint-backlash.b."
)
CURVES = " A curve has one row with its least and largest parameters; all are in parameters.csv."
ESTIMATES_CAPTION = (
    "Estimates in prior standard deviations (grey band: one of them). Bars: ± 2 sd, where larger than the dot."
)
HARMLESS = (
    "The others do no harm under conditions like those measured, where any value predicts the same. They matter for other tools, "
    "loads or directions, and where a value is read as a true dimension."
)
COUNTED = (
    "The study limits the number of parameters to those that the data determine best. Leaving out the others costs no accuracy "
    "where those kept compensate for them."
)
BRACKETS = (
    "Numbers in brackets: by how many of its prior standard deviations a parameter compensates for one of the first's."
)
LEFT_OUT = (
    "The robot file states six figures for each joint's frame. Some move the tool exactly as others do at every pose, so no "
    "measurement separates them. They keep the robot file's value, and predictions lose nothing."
)
TOGETHER = ", with the joint's other figures"


def estimates(
    names: Sequence[str], effects: Sequence[str], scaled: np.ndarray, sd: np.ndarray, from_prior: np.ndarray
) -> Figure:
    """Draw each estimate's distance from nominal ± 2 sd in prior standard deviations, grouped by effect.

    effects: each parameter's group, in words; scaled, sd: shape (n_parameters,), sd nan at a bound; from_prior: mask of
    parameters that the prior determines.
    """
    groups = [(effect, len(list(members))) for effect, members in groupby(effects)]
    titles = [_title(effect, number) for effect, number in groups]
    longest = [max(map(len, title.split("\n"))) for title in titles]
    widths = np.array([max(number, CHARACTER * long) for (_, number), long in zip(groups, longest, strict=True)])
    edges = np.concatenate([[0.0], np.cumsum(widths + 1)]) - 1  # of the groups, one place between them
    at = np.concatenate(
        [
            middle + np.arange(number) - (number - 1) / 2
            for middle, (_, number) in zip((edges[:-1] + edges[1:]) / 2, groups, strict=True)
        ]
    )
    drawn, axes = chart(2.0 + turned(names), max(6.7, 0.1 * edges[-1]))
    axes.axhspan(-1, 1, color=LIGHT, alpha=0.55, linewidth=0)
    axes.axhline(0, color="#444444", linewidth=0.6)
    bound = ~np.isfinite(sd)
    for mask, look, name in (
        (~bound & ~from_prior, {"fmt": "o", "color": DARK}, "determined by the data"),
        (~bound & from_prior, {"fmt": "D", "color": ACCENT, "markerfacecolor": "white"}, "determined by the prior"),
    ):
        if mask.any():
            axes.errorbar(at[mask], scaled[mask], 2 * sd[mask], elinewidth=1.0, capsize=1.8, label=name, **look)  # type: ignore[arg-type]
    if bound.any():
        axes.plot(at[bound], scaled[bound], "x", color=ACCENT, markersize=5, label=AT_BOUND)
    for title, left, right in zip(titles, edges[:-1], edges[1:], strict=True):
        axes.annotate(title, ((left + right) / 2, 1.0), (0, 2), xycoords=("data", "axes fraction"),
                      textcoords="offset points", ha="center")  # fmt: skip
    for edge in edges[1:-1]:
        axes.axvline(edge, color="#444444", linewidth=0.6)
    axes.set_xticks(at, names, rotation=90, fontsize=6.5)
    axes.set_xlim(edges[0], edges[-1])
    axes.grid(axis="x", visible=False)
    axes.set_ylabel("estimate − nominal, ± 2 sd\n[prior standard deviations]")
    handles = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    first = sorted(handles, key=lambda label: label == AT_BOUND)  # errorbars
    drawn.legend([handles[label] for label in first], first, loc="outside upper center", ncols=3)
    return drawn


def _title(effect: str, number: int) -> str:
    """Return a group's name, broken into lines that fit above its parameters."""
    words = effect.split(" ")
    return fill(effect, max(int(number / CHARACTER), *map(len, words)), break_on_hyphens=False)


@section(60, "Identified parameters", "identify/parameters.csv")
def parameters_section(material: Material) -> list[Block]:
    """Tabulate and draw the parameters."""
    parameters = material.fitted_parameters
    added, robot = len(parameters) > len(material.identified_parameters), material.calibrated.model.robot
    few = [trade.parameters for trade in of_kind(material, "trade") if len(trade.parameters) <= MOST_MARKED]
    rows, shaded = lines(parameters, set().union(*few))
    names = ("parameter", "unit", "nominal", "estimate", "sd", "prior_share", "prior_sd")
    free = [row for row in parameters if not row.fixed]
    scaled = pd.DataFrame({name: [getattr(row, name) for row in free] for name in names})
    scaled["estimate_in_prior_sd"] = (scaled["estimate"] - scaled["nominal"]) / scaled["prior_sd"]
    scaled["sd_in_prior_sd"] = scaled["sd"] / scaled["prior_sd"]
    number = Counter((_group(row), row.part) for row in free)
    alone = [row for row in free if number[_group(row), row.part] <= MOST_FIGURES]
    values, sds, shares = (
        scaled.loc[scaled["parameter"].isin({row.parameter for row in alone}), name].to_numpy(dtype=float)
        for name in ("estimate_in_prior_sd", "sd_in_prior_sd", "prior_share")
    )
    drawn = estimates([cut(_place(row)) for row in alone], list(map(_group, alone)), values, sds, shares > BY_PRIOR)
    curves = CURVES * (len(alone) < len(free))
    return [
        Paragraph(
            LEGEND.format(of_links=DH if robot.kinematics in CONVENTIONS else ORIGINS)
            + REGISTERED * (not robot.base.known)
            + ADDED * added
            + curves
        ),
        Table(("parameter", "unit", "estimate", "sd", "allowed", "known from"), rows, "llrrrl", shaded, 8.6),
        Plot("parameters", drawn, ESTIMATES_CAPTION, scaled),
    ]


def lines(
    parameters: Sequence[FittedParameter], together: set[str]
) -> tuple[list[tuple[str, ...] | str], frozenset[int]]:
    """Return the table's rows with a heading for each effect, and the indices of rows that the prior determines."""
    parts: dict[tuple[str, str], list[FittedParameter]] = {}
    for row in parameters:
        parts.setdefault((_group(row), row.part), []).append(row)
    lines: list[tuple[str, ...] | str] = []
    shaded = []
    before = ""
    for (group, _), rows in parts.items():
        if group != before:
            before = group
            lines.append(group)
        if len(rows) > MOST_FIGURES:
            lines.append(_curve(rows))
            continue
        for row in rows:
            if row.prior_share > BY_PRIOR:
                shaded.append(len(lines))
            lines.append((_place(row), *_line(row, row.parameter in together)))
    return lines, frozenset(shaded)


def _curve(rows: Sequence[FittedParameter]) -> tuple[str, ...]:
    """Return one row for the parameters of a curve: their number and the range of their estimates."""
    factor, unit = readable(rows[0].unit)
    moved = [factor * (row.estimate - row.nominal) for row in rows]
    range_words = interval(float(f"{min(moved):.2g}"), float(f"{max(moved):.2g}"))
    sds = [factor * row.sd for row in rows]
    sd = interval(*(float(f"{end:.2g}") for end in (np.nanmin(sds), np.nanmax(sds))))
    return f"{rows[0].part}, {len(rows)} figures", unit, range_words, sd, "", "of a curve"


def _group(row: FittedParameter) -> str:
    """Return a parameter's effect in words, with its variant."""
    return " ".join(filter(None, (effect_words(row.effect), row.variant)))


def _place(row: FittedParameter) -> str:
    """Return a parameter's part and symbol, unique within its group."""
    return f"{row.part}.{row.symbol}"


def _line(row: FittedParameter, together: bool) -> tuple[str, ...]:
    factor, unit = readable(row.unit)
    if row.fixed:
        return unit, f"{factor * (row.estimate - row.nominal):.4g}", "", "", "fixed by the study"
    value, deviation = with_sd(factor * (row.estimate - row.nominal), factor * row.sd)
    allowed = interval(factor * (row.lower - row.nominal), factor * (row.upper - row.nominal))
    return unit, value, deviation, allowed, known_from(row.prior_share, row.at_bound, together)


def known_from(prior_share: float, at_bound: bool, together: bool) -> str:
    """Return the source of an estimate in words; together: the data determine it only in combination with others."""
    if at_bound:
        return "at a bound, data say nothing" if prior_share > BY_PRIOR else "data, at a bound"
    if together and prior_share <= BY_PRIOR:
        return "data, only in combination"
    for limit, words in ((0.1, "data"), (BY_PRIOR, "data, little prior"), (0.9, "mostly prior")):
        if prior_share <= limit:
            return words
    return "prior alone"


@section(65, "What the data determine, and what not", "identify/identifiability.csv")
def identifiability_section(material: Material) -> list[Block]:
    """State which parameters and combinations the data determine, and which they do not."""
    summary = material.summary
    ranks = [f"{effect_words(effect)}: {rank}" for effect, rank in summary.rank_by_effect.items()]
    by_effect = f" ({'; '.join(ranks)})" if len(ranks) > 1 else ""
    determined = f"{summary.rank} of {summary.parameters} parameters"
    return [
        Paragraph(f"The data determine {determined}{by_effect}. {HARMLESS}"),
        *_statements(material),
        *left_out_words(material),
        *_count(material),
    ]


def left_out_words(outcome: RunOutcome) -> list[Block]:
    """Tabulate the figures of full origins that are no parameters; nothing where joints are stated otherwise."""
    rows = []
    for joint, group in groupby(outcome.redundant, key=lambda figure: figure.joint):
        figures = list(group)
        symbols = ", ".join(figure.symbol for figure in figures)
        rows.append((str(joint), symbols, f"{figures[0].same}{TOGETHER * (joint > 1)}"))
    table = Table(("joint", "left out", "equivalent to"), rows, "rll", wide=2)
    return headed("Figures that are no parameters", Paragraph(LEFT_OUT, keep=True), table, where=rows)


def _statements(outcome: RunOutcome) -> list[Block]:
    sentences = [
        statement_words(statement) for statement in outcome.statements if statement.kind in ("silent", "trade", "scale")
    ]
    sentences += [
        f"{row.parameter} is at the end of its allowed range ({allowed_range(row)}): its error is one-sided, so no standard "
        "deviation is given."
        for row in outcome.identified_parameters
        if row.at_bound
    ]
    if not sentences:
        return [Paragraph("Nothing is left open: the data determine every parameter.")]
    return [
        Heading("What the data leave open"),
        Bullets(sentences),
        *([Paragraph(BRACKETS, 9)] if of_kind(outcome, "trade") else []),
    ]


def _count(outcome: RunOutcome) -> list[Block]:
    items = []
    for effect, rows in groupby(outcome.counted, key=lambda row: row.effect):
        counted = list(rows)
        kept, out = ([row.parameter for row in counted if row.kept == kept] for kept in (True, False))
        lead = f"{effect_words(effect)}, {len(kept)} of {len(kept) + len(out)} parameters."
        items.append((lead, f"Kept: {listed(kept, 40)}. Left out: {listed(out, 40)}."))
    return headed("A model with fewer parameters", Paragraph(COUNTED, keep=True), Bullets(items), where=items)
