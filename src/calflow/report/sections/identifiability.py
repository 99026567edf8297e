"""The section on identifiability: what the data determine and what they cannot tell."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

from calflow.files.tables import Tables
from calflow.report.document import Block, bullets, heading, paragraph, table
from calflow.report.material import Material, item
from calflow.report.section import Advice, Section
from calflow.report.sections.parameters import prior_names
from calflow.report.words import effect_words, interval, listed, number, part_words, readable

SHOWN = 15  # correlations in the table
NAMED = 3  # parameters that a trade on the first page names
HARMLESS = (
    "What they leave open does not harm predictions under conditions like those measured: any value serves. It matters "
    "for other tools, loads or directions, and to whoever reads a value as a true dimension."
)
BRACKETS = (
    "Numbers in brackets: by how many of its prior standard deviations a parameter makes up for one of the first."
)


LOAD_DRIVEN = ("rad/Nm", "m/N")  # units of what only a load shows


def write(material: Material) -> list[Block]:
    """Say what the data determine, what they say nothing about and what they know only together."""
    summary = material.tables["identify/summary.csv"]
    ranks = [
        f"{effect_words(row['item'].removeprefix('rank_'))}: {row['value']}"
        for row in summary.to_dict("records")
        if row["item"].startswith("rank_")
    ]
    by_effect = f" ({'; '.join(ranks)})" if len(ranks) > 1 else ""
    return [
        paragraph(f"The data determine {item(summary, 'rank')}{by_effect}. {HARMLESS}"),
        *_statements(material.tables),
        *_correlations(material.tables),
        *_count(material.tables),
    ]


def _statements(tables: Tables) -> list[Block]:
    statements = tables["identify/identifiability.csv"]
    said = [
        _sentence(text)
        for text in statements.loc[statements["kind"].isin(["silent", "trade"]), "statement"].astype(str)
    ]
    said += [_bound(row) for row in tables["identify/parameters.csv"].to_dict("records") if row["at_bound"]]
    if not said:
        return [paragraph("Nothing is left open: the data determine every parameter.")]
    return [
        heading("What the data leave open"),
        bullets(said),
        *([paragraph(BRACKETS, 9)] if (statements["kind"] == "trade").any() else []),
    ]


def _bound(row: dict[Hashable, Any]) -> str:
    factor, unit = readable(str(row["unit"]))
    ends = f"{interval(factor * row['lower'], factor * row['upper'])} {unit}".rstrip()
    return (
        f"{row['parameter']} sits at the end of its allowed range ({ends}): its error is one-sided, so no standard "
        "deviation is given."
    )


def _correlations(tables: Tables) -> list[Block]:
    if "identify/correlations.csv" not in tables or tables["identify/correlations.csv"].empty:
        return []
    pairs = tables["identify/correlations.csv"]
    rows = [
        (row["first"], row["second"], number(row["correlation"], "+.4f"))
        for row in pairs.head(SHOWN).to_dict("records")
    ]
    more = f" The strongest {SHOWN} of {len(pairs)} are shown." if len(pairs) > SHOWN else ""
    return [
        heading("Known better together than apart"),
        paragraph(
            "If one of a pair were a little larger, the other could make up for it: their standard deviations are not "
            f"independent.{more}",
            keep=True,
        ),
        table(("parameter", "with", "correlation"), rows, "llr"),
    ]


def _count(tables: Tables) -> list[Block]:
    if "identify/count.csv" not in tables:
        return []
    items = []
    for effect, rows in tables["identify/count.csv"].groupby("effect", sort=False):
        kept = rows["kept"].astype(bool)
        inside, outside = (listed(rows.loc[mask, "parameter"].tolist(), 40) for mask in (kept, ~kept))
        lead = f"{effect_words(str(effect))}, {kept.sum()} of {len(rows)} parameters."
        items.append((lead, f"Kept: {inside}. Left out: {outside}."))
    return [
        heading("A model with fewer parameters"),
        paragraph(
            "With the number of parameters that the study counts, a model would keep those that add most to what the data "
            "can tell. Those left out take no accuracy with them where the others can stand in for them.",
            keep=True,
        ),
        bullets(items),
    ]


def second_marker(tables: Tables) -> list[Advice]:
    """A trade between the last link and the only marker ends with a second marker."""
    markers = [str(name) for name in tables["identify/placement.csv"]["what"] if name != "base"]
    if len(markers) != 1:
        return []
    marker = markers[0]
    parameters = tables["identify/parameters.csv"]
    of_marker = set(parameters.loc[parameters["part"] == marker, "parameter"])
    links: set[str] = set()
    for names in _of_kind(tables, "trade"):
        own = of_marker & set(names.split(";"))
        links |= set(names.split(";")) - own if own else set()
    if not links:
        return []
    sentence = (
        f"To tell {listed(sorted(links), 6)} from where marker {marker} sits, measure two or three markers on the tool, far "
        "apart."
    )
    return [Advice(3, sentence)]


def unseen_compliance(tables: Tables) -> list[Advice]:
    """A joint that no load turned keeps an unknown compliance."""
    parameters = tables["identify/parameters.csv"]
    compliant = parameters[parameters["unit"].isin(LOAD_DRIVEN)].set_index("parameter")["part"]
    unseen = [name for name in _of_kind(tables, "silent") if name in compliant]
    if not unseen:
        return []
    joints = listed([part_words(compliant[name]) for name in unseen], 8)
    sentence = (
        f"The loads measured do not twist {joints}, so {listed(unseen, 8)} {'stays' if len(unseen) == 1 else 'stay'} "
        "unknown. This does no harm under such loads; to know more, apply a known side force."
    )
    return [Advice(3, sentence)]


def _of_kind(tables: Tables, kind: str) -> list[str]:
    statements = tables["identify/identifiability.csv"]
    return statements.loc[statements["kind"] == kind, "parameters"].astype(str).tolist()


def open_questions(tables: Tables) -> list[str]:
    """Say for the first page what the data cannot tell, in a few sentences."""
    silent, trades, pairs = (_of_kind(tables, kind) for kind in ("silent", "trade", "correlated"))
    bound = [name for name in _of_kind(tables, "bound") if name not in silent]
    told = {name for names in [*silent, *trades, *bound] for name in names.split(";")}
    prior = [name for name in prior_names(tables) if name not in told]
    said = []
    if silent:
        it = "it" if len(silent) == 1 else "them"
        said.append(f"Anything about {_spoken(silent, tables)}: the value given for {it} is prior knowledge.")
    if trades:
        more = f" and {len(trades) - 4} more combinations" if len(trades) > 4 else ""
        apart = "; ".join(_trade(names, tables) for names in trades[:4])
        said.append(f"Apart from each other: {apart}{more}. Only what they do together is known.")
    if bound:
        said.append(
            f"The size of {_spoken(bound, tables)}: at the end of the allowed range, so no standard deviation is given."
        )
    if prior:
        said.append(f"More about {_spoken(prior, tables)} than was known before.")
    if pairs:
        further = "further pair of parameters is" if len(pairs) == 1 else "further pairs of parameters are"
        said.append(f"{len(pairs)} {further} known better together than apart.")
    return said


def _spoken(names: list[str], tables: Tables) -> str:
    """Names with what they mean: joint1.s (compliance of joint 1)."""
    meaning = tables["identify/parameters.csv"].set_index("parameter")["meaning"].fillna("")
    return listed([f"{name} ({meaning[name]})" if meaning.get(name) else name for name in names], 8)


def _trade(names: str, tables: Tables) -> str:
    first, *rest = names.split(";")
    others = _spoken(rest, tables) if len(rest) <= NAMED else f"{len(rest)} other parameters"
    return f"{_spoken([first], tables)} with {others}"


def _sentence(statement: str) -> str:
    """Close a statement with a full stop; its first word may be a name, which keeps its case."""
    start = statement[0].upper() + statement[1:] if statement.startswith("the ") else statement
    return start if start.endswith(".") else f"{start}."


SECTION = Section(
    40,
    "What the data can tell, and what not",
    tuple(f"identify/{name}.csv" for name in ("identifiability", "parameters", "summary", "placement")),
    write,
    (second_marker, unseen_compliance),
)
