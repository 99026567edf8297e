"""The section on causes: what the study's model lacked, how sure that is, and what stays unexplained."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count

from calflow.diagnosis.findings.extended_model import DiagnosisSummary
from calflow.diagnosis.findings.finding import Finding
from calflow.files.results import Results
from calflow.files.words import chance_figure, effect_words, listed, sureness
from calflow.reporting.blocks import Block, Paragraph, Table
from calflow.reporting.causes.finding import finding, moves, next_poses, other_means, space
from calflow.reporting.causes.gain import gain_cells, gained, makes_it_worse
from calflow.reporting.causes.search import candidates, strongest, threshold, untested
from calflow.reporting.causes.unexplained import still_unexplained, unexplained
from calflow.reporting.findings import findings
from calflow.reporting.material import Material
from calflow.reporting.section import Advice, Section

STATUS = {"named": "named", "one_of": "one of several", "unexplained": "not explained"}
SUMMARY = "diagnose/summary.json"
FAULT = "data_fault"  # told in a section of its own
NO_PROOF = (
    "A smaller error does not prove a name: whatever bends with the data takes something off. That something is there "
    "rests on the test; its name rests on what else could explain the same data, which is said with each cause."
)
NOTHING = "Nothing was found that the model lacks."
CURVES = (
    "The figures show errors along the direction in which a cause moves the tool. Left: the final model without this "
    "cause, its other parameters kept; middle: with it; right: what was measured against what the cause explains."
)


def write(material: Material) -> list[Block]:
    """Tell each finding in words and figures, then what is left."""
    found = findings(material.results)
    causes = [one for one in found if one.is_cause]
    left = [one for one in found if one.status == "unexplained"]
    return [
        *_opening(material, found),
        *[block for k, one in enumerate(causes, start=1) for block in finding(material, one, k)],
        *gained(material, causes),
        *still_unexplained(left),
        *space(material, causes),
    ]


def _opening(material: Material, every: Sequence[Finding]) -> list[Block]:
    summary = material.results.document(SUMMARY, DiagnosisSummary)
    searched = (
        f"What the study's model leaves was searched for {summary.causes_tested} causes, each at its place in the robot or its "
        f"surroundings. A cause counts as found where, with nothing hidden, fewer than {100 * threshold(material):.2g} % of such "
        f"searches would find anything.{_mended(every)}"
    )
    found = [one for one in every if one.status != FAULT]
    if not found:
        best = strongest(candidates(material.results))
        unseen = f" But {summary.unseen}." if summary.unseen else ""
        return [Paragraph(NOTHING + unseen, bold=True), Paragraph(f"{searched}{best}")]
    order = count(1)
    rows = [
        (str(next(order)) if one.is_cause else "–", _title(one), one.amount if one.is_cause and one.unit else "–",
         STATUS.get(one.status, one.status),
         chance_figure(one.p_family), sureness(one.probability), *gain_cells(one))
        for one in found
    ]  # fmt: skip
    header = ("", "finding", "size (± 1 sd)", "name", "false alarm", "probability", "gain [mm]", "95 % interval")
    told = any(one.is_cause for one in found)
    first = [] if told else [Paragraph("No cause of the catalogue was found.", bold=True)]
    listing: list[Block] = [Paragraph(NO_PROOF), Table(header, rows, "rlrlrrrr", size=8, wide=1)]
    return [
        *first,
        Paragraph(searched),
        *listing,
        *([Paragraph(CURVES)] if any(moves(material, one) for one in found) else []),
    ]


def extension_not_converged(results: Results) -> list[Advice]:
    """A model with causes whose fit stopped before its optimum is not to be used, and names rest on it."""
    summary = results.document(SUMMARY, DiagnosisSummary)
    if summary.converged:
        return []
    sentence = (
        f"Do not use the model that diagnose extended: its fit did not converge ({summary.solver.words}). Check the flagged rows "
        "and what was found last, or look for fewer causes (stages.diagnose.causes), then run again."
    )
    return [Advice(1, sentence)]


def _mended(every: Sequence[Finding]) -> str:
    """Say that the search was made on data whose faults were seen to."""
    faults = dict.fromkeys(effect_words(one.cause) for one in every if one.status == FAULT)
    return (
        f" Faults of the data ({listed(list(faults))}) were seen to before: see the section on them." if faults else ""
    )


def _title(one: Finding) -> str:
    if one.is_misfit:
        return f"more than noise{f', most where {one.detail}' if one.detail else ''}"
    if one.status == "unexplained":
        return f"depends on {one.inputs_in_words}"
    return one.names


SECTION = Section(
    15,
    "What the model lacked: causes",
    (*(f"diagnose/{name}.csv" for name in ("findings", "candidates", "separations", "next_poses")), SUMMARY),
    write,
    (extension_not_converged, makes_it_worse, unexplained, next_poses, other_means, untested),
)
