"""The section on parameters: what was identified, how surely, and what is only prior knowledge.

Figure of the parameters: estimates against what was known before.

The section on identifiability: what the data determine and what they cannot tell.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from itertools import groupby
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calflow.deployment.usability import Advice
from calflow.estimation.fit_summary import IdentifySummary
from calflow.estimation.identifiability import Redundant, Statement, scale_words, silent_words, trade_words
from calflow.files.results import Results
from calflow.files.words import cut, effect_words, first_up, interval, listed, number, part_words, readable, with_sd
from calflow.reporting.blocks import Block, Bullets, Heading, Paragraph, Plot, Table
from calflow.reporting.material import Material, latest
from calflow.reporting.section import Section
from calflow.reporting.style import ACCENT, DARK, LIGHT, figure, turned

AT_BOUND = "at a bound, no sd"
CHARACTER = 0.55  # of a parameter's place that a letter takes


def estimates(
    names: Sequence[str], effects: Sequence[str], scaled: np.ndarray, sd: np.ndarray, from_prior: np.ndarray
) -> Figure:
    """Draw each estimate's distance from nominal ± 2 sd in prior standard deviations, grouped by effect.

    effects names each parameter's group, in words. scaled and sd have shape (n_parameters,), sd is nan at a bound;
    from_prior marks what the data leave to the prior.
    """
    groups = [(effect, len(list(own))) for effect, own in groupby(effects)]
    titles = [_title(effect, number) for effect, number in groups]
    widths = np.array(
        [max(number, CHARACTER * _longest(title)) for (_, number), title in zip(groups, titles, strict=True)]
    )
    edges = np.concatenate([[0.0], np.cumsum(widths + 1)]) - 1  # of the groups, one place between them
    at = np.concatenate([
        middle + np.arange(number) - (number - 1) / 2
        for middle, (_, number) in zip((edges[:-1] + edges[1:]) / 2, groups, strict=True)
    ])  # fmt: skip
    drawn = figure(2.0 + turned(names), max(6.7, 0.1 * edges[-1]))
    axes = drawn.add_subplot()
    axes.axhspan(-1, 1, color=LIGHT, alpha=0.55, linewidth=0)
    axes.axhline(0, color="#444444", linewidth=0.6)
    bound = ~np.isfinite(sd)
    for mask, look, name in (
        (~bound & ~from_prior, {"fmt": "o", "color": DARK}, "told by the data"),
        (~bound & from_prior, {"fmt": "D", "color": ACCENT, "markerfacecolor": "white"}, "left to prior knowledge"),
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
    drawn.legend(*_errorbars_first(axes), loc="outside upper center", ncols=3)
    return drawn


def _title(effect: str, number: int) -> str:
    """Break a group's name into lines as long as its parameters give room for, or as its longest word."""
    words = effect.split(" ")
    return fill(effect, max(int(number / CHARACTER), *map(len, words)), break_on_hyphens=False)


def _longest(title: str) -> int:
    return max(map(len, title.split("\n")))


def _errorbars_first(axes: Axes) -> tuple[list[Artist], list[str]]:
    handles, labels = axes.get_legend_handles_labels()
    order = sorted(range(len(labels)), key=lambda k: labels[k] == AT_BOUND)
    return [handles[k] for k in order], [labels[k] for k in order]


MANY = 20  # figures of one part's curve beyond which one line tells of all: the curve is drawn with its cause
FEW = 4  # parameters in a trade up to which each is marked
BY_PRIOR = 0.5  # prior share from which a parameter is left to the prior
LEGEND = (
    "Each value is the difference from the robot file. jointN: link N's DH figures: angles alpha, beta (about y, where "
    "axes are nearly parallel) and theta, lengths a and d; s: compliance, the twist of the joint by a torque (1 µrad/Nm is "
    "1 mrad at 1 kNm). base: where the robot stands; loop: lengths of the bars; other names are markers on the tool. In "
    "grey: left to prior knowledge, not measured."
)
NEAR_ZERO = 0.01  # share of the range within which a bound of zero was hit
REGISTERED = " Base and markers: the difference from where the training poses put them (see the appendix)."
ADDED = (
    " At the end: the causes that the section before names. Outside this table their parameters have the cause in their "
    "names, as in joint3.joint-backlash.b."
)
CURVES = " A curve's figures stand in one line, with the least and the largest; all are in parameters.csv."
ESTIMATES_CAPTION = (
    "Estimates in units of what was thought likely beforehand (grey band: one prior standard deviation). Bars are ± 2 sd; "
    "where none is seen it is smaller than the dot."
)


def _parameters(material: Material) -> list[Block]:
    """Tabulate and draw the parameters."""
    parameters = latest(material.results, "parameters")
    model = material.calibrated.model
    added = len(parameters) > len(material.tables["identify/parameters.csv"])
    rows, shaded = lines(parameters, _known_together(material.results))
    nominal, estimate, sd, share = parameters[["nominal", "estimate", "sd", "prior_share"]].to_numpy(dtype=float).T
    scaled = parameters[["parameter", "unit", "nominal", "estimate", "sd", "prior_share"]].assign(
        prior_sd=model.prior_sd,
        estimate_in_prior_sd=(estimate - nominal) / model.prior_sd,
        sd_in_prior_sd=sd / model.prior_sd,
    )
    single = _number_in_part(parameters) <= MANY
    away, uncertain = (
        scaled[name].to_numpy(dtype=float)[single] for name in ("estimate_in_prior_sd", "sd_in_prior_sd")
    )
    places, groups = ([name for name, alone in zip(names, single, strict=True) if alone]
                      for names in (map(cut, _places(parameters)), _groups(parameters)))  # fmt: skip
    drawn = estimates(places, groups, away, uncertain, share[single] > BY_PRIOR)
    curves = "" if single.all() else CURVES
    return [
        Paragraph(LEGEND + (REGISTERED if not model.robot.base.known else "") + (ADDED if added else "") + curves),
        Table(("parameter", "unit", "estimate", "sd", "allowed", "known from"), rows, "llrrrl", shaded, 8.6),
        Plot("parameters", drawn, ESTIMATES_CAPTION, scaled),
    ]


def lines(parameters: pd.DataFrame, together: set[str]) -> tuple[list[tuple[str, ...] | str], frozenset[int]]:
    """Return the table's rows with a heading for each effect, and which rows are left to the prior."""
    told: list[tuple[str, ...] | str] = []
    shaded = []
    before = ""
    rows = parameters.assign(group=_groups(parameters), place=_places(parameters))
    for _, own in rows.groupby(["group", "part"], sort=False):
        group = str(own["group"].iloc[0])
        if group != before:
            before = group
            told.append(group)
        if len(own) > MANY:
            told.append(_curve(own))
            continue
        for row in own.to_dict("records"):
            if row["prior_share"] > BY_PRIOR:
                shaded.append(len(told))
            told.append((row["place"], *_line(row, row["parameter"] in together)))
    return told, frozenset(shaded)


def _number_in_part(parameters: pd.DataFrame) -> np.ndarray:
    """Return of each parameter how many of its group belong to its part, shape (n_parameters,)."""
    places = parameters.assign(group=_groups(parameters)).groupby(["group", "part"], sort=False)
    return places["parameter"].transform("size").to_numpy()


def _curve(own: pd.DataFrame) -> tuple[str, ...]:
    """Tell of a curve's figures, which mean nothing one by one, in one line: how many, and between what they lie."""
    factor, unit = readable(str(own["unit"].iloc[0]))
    moved = factor * (own["estimate"] - own["nominal"])
    said = interval(float(f"{moved.min():.2g}"), float(f"{moved.max():.2g}"))
    sd = interval(*(float(f"{factor * end:.2g}") for end in (own["sd"].min(), own["sd"].max())))
    return f"{own['part'].iloc[0]}, {len(own)} figures", unit, said, sd, "", "of a curve"


def _groups(parameters: pd.DataFrame) -> list[str]:
    """Return each parameter's effect in words, with its variant."""
    variants = parameters["variant"].astype(object).fillna("")
    return [" ".join(filter(None, (effect_words(str(effect)), str(variant))))
            for effect, variant in zip(parameters["effect"], variants, strict=True)]  # fmt: skip


def _places(parameters: pd.DataFrame) -> list[str]:
    """Return each parameter's part and symbol, which is clear within its group."""
    return [f"{part}.{symbol}" for part, symbol in zip(parameters["part"], parameters["symbol"], strict=True)]


def _line(row: dict[Hashable, Any], together: bool) -> tuple[str, ...]:
    factor, unit = readable(str(row["unit"]))
    nominal, estimate, sd, lower, upper, share = (
        float(row[name]) for name in ("nominal", "estimate", "sd", "lower", "upper", "prior_share")
    )
    value, deviation = with_sd(factor * (estimate - nominal), factor * sd)
    allowed = interval(factor * (lower - nominal), factor * (upper - nominal))
    return unit, value, deviation, allowed, known_from(share, bool(row["at_bound"]), together)


def known_from(prior_share: float, at_bound: bool, together: bool = False) -> str:
    """Say in words where a parameter's value comes from; together: the data know it only with others."""
    if at_bound:
        return "at a bound, data say nothing" if prior_share > BY_PRIOR else "data, at a bound"
    if together and prior_share <= BY_PRIOR:
        return "data, only in combination"
    for limit, words in ((0.1, "data"), (BY_PRIOR, "data, little prior"), (0.9, "mostly prior")):
        if prior_share <= limit:
            return words
    return "prior alone"


def _known_together(results: Results) -> set[str]:
    """Return the parameters of which the data know little more than a combination with one or two others."""
    if "identify/identifiability.csv" not in results:
        return set()
    statements = results.rows("identify/identifiability.csv", Statement)
    groups = [one.parameters for one in statements if one.kind == "trade"]
    return {name for group in groups if len(group) <= FEW for name in group}


def at_bound(results: Results) -> list[Advice]:
    """A parameter that the data push against a bound means that something else is wrong."""
    parameters = latest(results, "parameters")
    pushed = parameters[parameters["at_bound"].astype(bool) & (parameters["prior_share"] <= BY_PRIOR)]
    zero = (pushed["lower"] == 0) & (pushed["estimate"] < NEAR_ZERO * pushed["upper"])
    found = []
    if not zero.all():
        far = pushed[~zero]
        sentence = (
            f"The data push {listed(far['parameter'].tolist())} to the end of the allowed range ({_ranges(far)}): check "
            "the robot file's dimensions and units, and the payload's mass."
        )
        found.append(Advice(2, sentence))
    if zero.any():
        sentence = (
            f"{listed(pushed.loc[zero, 'parameter'].tolist())} came out at zero, the least allowed: stiffer than the data can "
            "tell, or the masses and payload in the robot file are wrong."
        )
        found.append(Advice(3, sentence))
    return found


def _ranges(rows: pd.DataFrame) -> str:
    said = []
    for row in rows.to_dict("records"):
        factor, unit = readable(str(row["unit"]))
        said.append(f"{interval(factor * row['lower'], factor * row['upper'])} {unit}".rstrip())
    return listed(list(dict.fromkeys(said)), 4)


def prior_names(results: Results) -> list[str]:
    """Return the parameters that the data leave to the prior."""
    parameters = results.tables["identify/parameters.csv"]
    share = np.asarray(parameters["prior_share"], dtype=float)
    return parameters.loc[share > BY_PRIOR, "parameter"].astype(str).tolist()


PARAMETERS_SECTION = Section(60, "Identified parameters", ("identify/parameters.csv",), _parameters, (at_bound,))


PAIRS_SHOWN = 15  # correlations in the table
NAMED = 3  # parameters that a trade on the first page names
HARMLESS = (
    "What they leave open does not harm predictions under conditions like those measured: any value serves. It matters "
    "for other tools, loads or directions, and to whoever reads a value as a true dimension."
)
BRACKETS = (
    "Numbers in brackets: by how many of its prior standard deviations a parameter makes up for one of the first."
)
LEFT_OUT = (
    "The robot file states each joint by a place and a turn in full. Some of these figures move the tool in exactly the same way "
    "as others, whatever the pose: no measurement tells them apart. They keep the robot file's value, and predictions lose nothing."
)
TOGETHER = ", with the joint's other figures"
LOAD_DRIVEN = ("rad/Nm", "m/N")  # units of what only a load shows


def _identifiability(material: Material) -> list[Block]:
    """Say what the data determine, what they say nothing about and what they know only together."""
    summary = material.results.document("identify/summary.json", IdentifySummary)
    ranks = [f"{effect_words(effect)}: {rank}" for effect, rank in summary.rank_by_effect.items()]
    by_effect = f" ({'; '.join(ranks)})" if len(ranks) > 1 else ""
    determined = f"{summary.rank} of {summary.parameters} parameters"
    return [
        Paragraph(f"The data determine {determined}{by_effect}. {HARMLESS}"),
        *_statements(material.results),
        *left_out_words(material.results),
        *_correlations(material.results),
        *_count(material.results),
    ]


def left_out_words(results: Results) -> list[Block]:
    """Name the figures of full origins that are no parameters; nothing where joints are stated otherwise."""
    if "identify/redundant.csv" not in results:
        return []
    left_out = results.rows("identify/redundant.csv", Redundant)
    rows = []
    for joint, own in groupby(left_out, key=lambda one: one.joint):
        figures = list(own)
        rows.append(
            (str(joint), ", ".join(one.symbol for one in figures), f"{figures[0].same}{TOGETHER * (joint > 1)}")
        )
    return [
        Heading("Figures that are no parameters"),
        Paragraph(LEFT_OUT, keep=True),
        Table(("joint", "left out", "the same is done by"), rows, "rll", wide=2),
    ]


def _statements(results: Results) -> list[Block]:
    said = [_statement_words(one) for one in left_open(results) if one.kind in ("silent", "trade", "scale")]
    said += [
        _bound_words(row) for row in results.tables["identify/parameters.csv"].to_dict("records") if row["at_bound"]
    ]
    if not said:
        return [Paragraph("Nothing is left open: the data determine every parameter.")]
    return [
        Heading("What the data leave open"),
        Bullets(said),
        *([Paragraph(BRACKETS, 9)] if _of_kind(results, "trade") else []),
    ]


def _bound_words(row: dict[Hashable, Any]) -> str:
    factor, unit = readable(str(row["unit"]))
    ends = f"{interval(factor * row['lower'], factor * row['upper'])} {unit}".rstrip()
    return (
        f"{row['parameter']} sits at the end of its allowed range ({ends}): its error is one-sided, so no standard "
        "deviation is given."
    )


def _correlations(results: Results) -> list[Block]:
    if "identify/correlations.csv" not in results or results.tables["identify/correlations.csv"].empty:
        return []
    pairs = results.tables["identify/correlations.csv"]
    rows = [
        (row["first"], row["second"], number(row["correlation"], "+.4f"))
        for row in pairs.head(PAIRS_SHOWN).to_dict("records")
    ]
    more = f" The strongest {PAIRS_SHOWN} of {len(pairs)} are shown." if len(pairs) > PAIRS_SHOWN else ""
    return [
        Heading("Known better together than apart"),
        Paragraph(
            "If one of a pair were a little larger, the other could make up for it: their standard deviations are not "
            f"independent.{more}",
            keep=True,
        ),
        Table(("parameter", "with", "correlation"), rows, "llr"),
    ]


def _count(results: Results) -> list[Block]:
    if "identify/count.csv" not in results:
        return []
    items = []
    for effect, rows in results.tables["identify/count.csv"].groupby("effect", sort=False):
        kept = rows["kept"].astype(bool)
        inside, outside = (listed(rows.loc[mask, "parameter"].tolist(), 40) for mask in (kept, ~kept))
        lead = f"{effect_words(str(effect))}, {kept.sum()} of {len(rows)} parameters."
        items.append((lead, f"Kept: {inside}. Left out: {outside}."))
    return [
        Heading("A model with fewer parameters"),
        Paragraph(
            "With the number of parameters that the study counts, a model would keep those that add most to what the data "
            "can tell. Those left out take no accuracy with them where the others can stand in for them.",
            keep=True,
        ),
        Bullets(items),
    ]


def second_marker(results: Results) -> list[Advice]:
    """A trade between the last link and the only marker ends with a second marker."""
    placed = results.tables["identify/placement.csv"]
    markers = list(placed.loc[placed["kind"] == "marker", "what"])
    if len(markers) != 1:
        return []
    marker = markers[0]
    parameters = results.tables["identify/parameters.csv"]
    places = set(parameters.loc[parameters["part"] == marker, "parameter"])
    links: set[str] = set()
    for trade in _of_kind(results, "trade"):
        own = places & set(trade.parameters)
        links |= set(trade.parameters) - own if own else set()
    if not links:
        return []
    sentence = (
        f"To tell {listed(sorted(links), 6)} from where marker {marker} sits, measure two or three markers on the tool, far "
        "apart."
    )
    return [Advice(3, sentence)]


def unseen_compliance(results: Results) -> list[Advice]:
    """A joint that no load turned keeps an unknown compliance."""
    parameters = results.tables["identify/parameters.csv"]
    compliant = parameters[parameters["unit"].isin(LOAD_DRIVEN)].set_index("parameter")["part"]
    unseen = [name for one in _of_kind(results, "silent") for name in one.parameters if name in compliant]
    if not unseen:
        return []
    joints = listed([part_words(compliant[name]) for name in unseen], 8)
    sentence = (
        f"The loads measured do not twist {joints}, so {listed(unseen, 8)} {'stays' if len(unseen) == 1 else 'stay'} "
        "unknown. This does no harm under such loads; to know more, apply a known side force."
    )
    return [Advice(3, sentence)]


def left_open(results: Results) -> list[Statement]:
    """Return what the data leave open."""
    return results.rows("identify/identifiability.csv", Statement)


def _of_kind(results: Results, kind: str) -> list[Statement]:
    return [one for one in left_open(results) if one.kind == kind]


def open_questions(results: Results) -> list[str]:
    """Say for the first page what the data cannot tell, in a few sentences."""
    trades, pairs = _of_kind(results, "trade"), _of_kind(results, "correlated")
    silent = [name for one in _of_kind(results, "silent") for name in one.parameters]
    bound = [name for one in _of_kind(results, "bound") for name in one.parameters if name not in silent]
    told = {*silent, *bound, *(name for one in trades for name in one.parameters)}
    prior = [name for name in prior_names(results) if name not in told]
    said = [_statement_words(one) for one in _of_kind(results, "scale")]
    if silent:
        it = "it" if len(silent) == 1 else "them"
        said.append(f"Anything about {_spoken(silent, results)}: the value given for {it} is prior knowledge.")
    if trades:
        more = f" and {len(trades) - 4} more combinations" if len(trades) > 4 else ""
        apart = "; ".join(_trade(one.parameters, results) for one in trades[:4])
        said.append(f"Apart from each other: {apart}{more}. Only what they do together is known.")
    if bound:
        said.append(
            f"The size of {_spoken(bound, results)}: at the end of the allowed range, so no standard deviation is given."
        )
    if prior:
        said.append(f"More about {_spoken(prior, results)} than was known before.")
    if pairs:
        further = "further pair of parameters is" if len(pairs) == 1 else "further pairs of parameters are"
        said.append(f"{len(pairs)} {further} known better together than apart.")
    return said


def _spoken(names: list[str], results: Results) -> str:
    """Names with what they mean: joint1.s (compliance of joint 1)."""
    meaning = results.tables["identify/parameters.csv"].set_index("parameter")["meaning"].fillna("")
    return listed([f"{name} ({meaning[name]})" if meaning.get(name) else name for name in names], 8)


def _trade(names: Sequence[str], results: Results) -> str:
    first, *rest = names
    others = _spoken(rest, results) if len(rest) <= NAMED else f"{len(rest)} other parameters"
    return f"{_spoken([first], results)} with {others}"


def _statement_words(one: Statement) -> str:
    if one.kind == "trade":
        return f"{trade_words(one.parameters, one.weights, one.wholly)}."
    if one.kind == "scale":
        return f"{first_up(scale_words(one.wholly))}."
    return f"{first_up(silent_words(one.parameters[0], one.wholly))}."


IDENTIFIABILITY_SECTION = Section(
    65,
    "What the data can tell, and what not",
    ("identify/identifiability.csv", "identify/parameters.csv", "identify/placement.csv", "identify/summary.json"),
    _identifiability,
    (second_marker, unseen_compliance),
)
