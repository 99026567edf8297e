"""The search for causes: which places spoke, how small a cause would have shown, and what could not be tested."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from calflow.diagnosis.findings import CandidateRow, Finding
from calflow.diagnosis.stepwise import FALSE_ALARM, SHARES, WITHIN
from calflow.effects.cause import cause_words, place_name, place_names, readable_size
from calflow.files.results import Results
from calflow.files.words import chance, first_up, listed, two_digits
from calflow.reporting.blocks import Block, Bullets, Heading, Paragraph, Plot, Table, headed
from calflow.reporting.cause_figures import evidence
from calflow.reporting.material import Material, findings_of
from calflow.reporting.section import Section

CANDIDATES_SHOWN = 10  # candidates in the figure
LONGEST = 46  # letters of a name with its detail, beyond which the detail is left out
EVIDENCE = (
    "The places that spoke most strongly against the study's model, each tested alone; what one cause explains, others "
    "imitate in part. Below zero a place explains less than its parameters cost; left of the threshold it may be chance."
)
LIMITS = (
    "The size at which a cause would be found 95 times in 100, at each joint or link, against the scatter that the study's "
    "model leaves. What is smaller can be there unseen."
)
IMITATED = "the model's own parameters imitate"


def candidate_rows(results: Results) -> list[CandidateRow]:
    """Return every place that was tested, and what could not be."""
    return results.rows("diagnose/candidates.csv", CandidateRow)


def went(material: Material, causes: Sequence[Finding]) -> list[Block]:
    """Draw the places that spoke most strongly, where any spoke; causes are those in the extended model."""
    rows = _tested(candidate_rows(material.results))[:CANDIDATES_SHOWN]
    if not rows or not findings_of(material.results):
        return []
    places = {(one.cause, one.joint) for one in causes}
    added = np.array([(row.cause, row.joint) in places for row in rows])
    data = pd.DataFrame({
        "place": [_candidate_words(row) for row in rows], "evidence": [-row.delta_bic for row in rows],
        "chance_of_a_false_alarm": [row.p_family for row in rows], "in_the_model": added,
    })  # fmt: skip
    names, fall, p = data["place"].tolist(), data["evidence"].to_numpy(), data["chance_of_a_false_alarm"].to_numpy()
    drawn = evidence(names, fall, p, added, WITHIN, threshold(material))
    return [Heading("How the search went"), Plot("evidence", drawn, EVIDENCE, data)]


def limits(rows: Sequence[CandidateRow]) -> list[Block]:
    """Tell how small a cause these data would have shown, by joint or link."""
    shown = [row for row in rows if np.isfinite(row.limit)]
    if not shown:
        return []
    numbers = sorted({row.joint for row in shown if row.joint})
    least: dict[tuple[str, int | None], float] = {}
    for row in shown:
        place = row.cause, row.joint
        least[place] = min(row.limit, least.get(place, np.inf))
    lines = []
    for cause, unit in {row.cause: row.unit for row in reversed(shown)}.items():
        factor, said = readable_size(cause, unit)
        cells = [two_digits(factor * least[cause, k]) if (cause, k) in least else "–" for k in (*numbers, None)]
        lines.append((first_up(cause_words(cause).name), said, *cells))
    header = ("cause", "unit", *map(str, numbers), "whole robot")
    return [
        Heading("How small a cause these data show"),
        Paragraph(LIMITS, keep=True),
        Table(header, sorted(lines), "ll" + "r" * (len(numbers) + 1), size=8, wide=0),
    ]


def not_tested(rows: Sequence[CandidateRow]) -> list[Block]:
    """List what could not be tested, by the reason why."""
    groups = untestable(rows)
    why = {lacking: first_up(f"needs {lacking}" if lacking else IMITATED) for lacking in groups}
    items = [(f"{why[lacking]}:", f"{listed(names, 12)}.") for lacking, names in groups.items()]
    silent = "Of these causes the data say nothing, neither that they are there nor that they are not."
    return headed("Not testable with these data", Paragraph(silent, keep=True), Bullets(items), where=groups)


def untestable(rows: Sequence[CandidateRow]) -> dict[str, list[str]]:
    """Return which causes could not be tested by what a test would need; nothing: the model's own parameters imitate them."""
    places: dict[tuple[str, str], list[tuple[int | None, str]]] = {}
    for row in rows:
        if row.imitated or row.lacking:
            places.setdefault((row.lacking, row.cause), []).append((row.joint, row.part))
    groups: dict[str, list[str]] = {}
    for (lacking, cause), own in places.items():
        groups.setdefault(lacking, []).append(place_names(cause, own))
    return groups


def strongest(rows: Sequence[CandidateRow]) -> str:
    """Say which place came nearest where nothing was found."""
    tested = _tested(rows)
    if not tested:
        return ""
    return (
        f" The strongest, {_candidate_words(tested[0])}, is no more than noise alone shows in such a search: the chance of it is "
        f"{chance(tested[0].p_family)}."
    )


def threshold(material: Material) -> float:
    """Chance of a false alarm below which a cause passes."""
    return SHARES["causes"] * float(material.settings.get("diagnose", {}).get("false_alarm", FALSE_ALARM))


def _tested(rows: Sequence[CandidateRow]) -> list[CandidateRow]:
    return sorted((row for row in rows if np.isfinite(row.delta_bic)), key=lambda row: row.delta_bic)


def _candidate_words(row: CandidateRow) -> str:
    name = place_name(row.cause, row.joint, row.part)
    detail = f" ({row.detail})" if row.detail else ""
    return name + detail if len(name + detail) <= LONGEST else name


def _search(material: Material) -> list[Block]:
    """Draw the strongest places, and tabulate limits and what was not testable."""
    rows = candidate_rows(material.results)
    causes = [one for one in findings_of(material.results) if one.is_cause]
    return [*went(material, causes), *limits(rows), *not_tested(rows)]


SEARCH_SECTION = Section(55, "The search for causes", ("diagnose/findings.csv", "diagnose/candidates.csv"), _search)
