"""The section on identifiability: what the data determine and what they cannot tell."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from itertools import groupby
from typing import Any

from calflow.estimation.fit_summary import IdentifySummary
from calflow.estimation.identifiability import Redundant, Statement, scale_words, silent_words, trade_words
from calflow.files.results import Results
from calflow.files.words import effect_words, first_up, interval, listed, number, part_words, readable
from calflow.reporting.blocks import Block, Bullets, Heading, Paragraph, Table
from calflow.reporting.material import Material
from calflow.reporting.section import Advice, Section
from calflow.reporting.sections.parameters import prior_names

SHOWN = 15  # correlations in the table
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


def write(material: Material) -> list[Block]:
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
    said = [_words(one) for one in left_open(results) if one.kind in ("silent", "trade", "scale")]
    said += [_bound(row) for row in results.tables["identify/parameters.csv"].to_dict("records") if row["at_bound"]]
    if not said:
        return [Paragraph("Nothing is left open: the data determine every parameter.")]
    return [
        Heading("What the data leave open"),
        Bullets(said),
        *([Paragraph(BRACKETS, 9)] if _of_kind(results, "trade") else []),
    ]


def _bound(row: dict[Hashable, Any]) -> str:
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
        for row in pairs.head(SHOWN).to_dict("records")
    ]
    more = f" The strongest {SHOWN} of {len(pairs)} are shown." if len(pairs) > SHOWN else ""
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
    said = [_words(one) for one in _of_kind(results, "scale")]
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


def _words(one: Statement) -> str:
    if one.kind == "trade":
        return f"{trade_words(one.parameters, one.weights, one.wholly)}."
    if one.kind == "scale":
        return f"{first_up(scale_words(one.wholly))}."
    return f"{first_up(silent_words(one.parameters[0], one.wholly))}."


SECTION = Section(
    65,
    "What the data can tell, and what not",
    ("identify/identifiability.csv", "identify/parameters.csv", "identify/placement.csv", "identify/summary.json"),
    write,
    (second_marker, unseen_compliance),
)
