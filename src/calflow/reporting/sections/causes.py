"""Causes: the search, the causes that the model lacked, their certainty and gain, and what stays unexplained."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import count

import numpy as np

from calflow.deployment.run_outcome import RunOutcome
from calflow.deployment.usability import mistake_unsettled
from calflow.design.discrimination import ENOUGH, SeparationRow
from calflow.diagnosis import FALSE_ALARM
from calflow.diagnosis.cause_tables import CandidateRow
from calflow.diagnosis.findings import Finding
from calflow.diagnosis.stepwise import SHARES
from calflow.effects.base import FORMS_OF_ONE, OF_THE_TOOL
from calflow.effects.wording import (
    UNEXPLAINED,
    as_stiffness,
    cause_family,
    cause_name,
    cause_words,
    place_name,
    readable_size,
)
from calflow.files.deferred import pd
from calflow.files.units import MeasurementUnit
from calflow.files.words import chance, chance_figure, effect_words, first_up, listed, mm, number, rounded, sureness
from calflow.reporting.advice import untestable
from calflow.reporting.bars import evidence
from calflow.reporting.blocks import Block, Bullets, Heading, Paragraph, Plot, Table, headed
from calflow.reporting.cause_figures import explained_figure
from calflow.reporting.material import Material
from calflow.reporting.section import section

CANDIDATES_SHOWN = 10  # candidates in the figure
LONGEST_NAME = 46  # characters of a name with its detail, above which the detail is omitted
EVIDENCE = (
    "The ten causes that explain most of what the study's model leaves, each tested alone; what one explains, others imitate in "
    "part. Dark: added to the model. Evidence below zero: it explains less than its parameters cost. A cause may be chance where a "
    "false alarm is likelier than {percent} %."
)
LIMITS = (
    "The size at which a cause would be found in 95 of 100 cases, at each joint or link, given the scatter that the study's model "
    "leaves; of a link, how soft it would have to be (EI)."
)
IMITATED = "the model's own parameters imitate"
STATUS = {"named": "named", "one_of": "one of several", "unexplained": "not explained"}
SUMMARY = "diagnose/summary.json"
FAULT = "data_fault"  # reported in a section of its own
NO_PROOF = (
    "A smaller error does not prove a cause: anything flexible enough reduces it. The test shows that something is there; which "
    "cause it is depends on what else could explain the same data, as stated with each cause."
)
NOTHING = "Nothing was found that the model lacks."
CURVES = (
    "The figures show errors along the direction in which a cause moves the tool. Left: the final model without this "
    "cause, its other parameters kept; middle: with it; right: what was measured against what the cause explains."
)
UNEXPLAINED_WORDS = (
    "A part of the error depends on what is listed here, and no known cause explains it for certain. It is not in the model: where "
    "it acts, predictions are off by more than noise."
)
SMOOTH = " Described by a smooth function of it, which has no physical meaning, {}."
RIVALS_TOLD = 3  # rivals named with a finding
GIVES_WAY = "The tool gives way by an amount that depends on its load"
WANDERED = "What the instrument reports shifts in the course of the measurement"


def _is_settled(outcome: RunOutcome) -> bool:
    """Whether no mistake of the user is unsettled, which could cause all findings."""
    return not mistake_unsettled(outcome)


def candidates_figure(material: Material) -> list[Block]:
    """Draw the candidates with the largest evidence, where there are any; those in the extended model are marked."""
    rows = _tested(material.candidates)[:CANDIDATES_SHOWN]
    if not rows or not material.findings:
        return []
    causes = [finding for finding in material.findings if finding.is_cause and not finding.is_suspicion]
    places = {(cause.cause, cause.joint) for cause in causes}
    data = pd.DataFrame(
        {"cause": first_up(_candidate(row)), "evidence": -row.delta_bic, "chance_of_a_false_alarm": row.p_family,
         "in_the_model": (row.cause, row.joint) in places} for row in rows
    )  # fmt: skip
    words = EVIDENCE.format(percent=f"{100 * threshold(material):.2g}")
    return [Heading("Evidence of the candidates"), Plot("evidence", evidence(data), words, data)]


def _candidate(row: CandidateRow) -> str:
    """Return a candidate's name with its detail, or where that is too long with its place."""
    detailed = f"{cause_name(row.cause, row.joint)} ({row.detail})"
    short = row.detail and len(detailed) <= LONGEST_NAME
    return detailed if short else place_name(row.cause, row.joint, row.part)


def limits(rows: Sequence[CandidateRow]) -> list[Block]:
    """Return the detection limits of causes by joint or link."""
    shown = [row for row in rows if np.isfinite(row.limit)]
    if not shown:
        return []
    places = [*sorted({row.joint for row in shown if row.joint}), None]
    least = {(row.cause, row.joint): row.limit for row in sorted(shown, key=lambda row: -row.limit)}
    lines = []
    for cause, unit in {row.cause: row.unit for row in reversed(shown)}.items():
        stated = {k: as_stiffness(least[cause, k], unit) for k in places if (cause, k) in least}
        factor, unit_shown = readable_size(cause, next(iter(stated.values()))[1])
        cells = [rounded(factor * stated[k][0], 2) if k in stated else "–" for k in places]
        lines.append((first_up(cause_words(cause).name), unit_shown, *cells))
    header = ("cause", "unit", *map(str, places[:-1]), "whole robot")
    return [
        Heading("Detection limits"),
        Paragraph(LIMITS, keep=True),
        Table(header, sorted(lines), "ll" + "r" * len(places), size=8, wide=0),
    ]


def not_tested(rows: Sequence[CandidateRow]) -> list[Block]:
    """Return the causes that could not be tested, by reason."""
    groups = untestable(rows)
    why = {lacking: first_up(f"needs {lacking}" if lacking else IMITATED) for lacking in groups}
    items = [(f"{why[lacking]}:", f"{listed(names, 12)}.") for lacking, names in groups.items()]
    silent = "The data say nothing about these causes: they may be present or not."
    return headed("Not testable with these data", Paragraph(silent, keep=True), Bullets(items), where=groups)


def threshold(material: Material) -> float:
    """Return the false-alarm probability below which a cause is accepted."""
    return SHARES["causes"] * float(material.settings.get("diagnose", {}).get("false_alarm", FALSE_ALARM))


def _tested(rows: Sequence[CandidateRow]) -> list[CandidateRow]:
    return sorted((row for row in rows if np.isfinite(row.delta_bic)), key=lambda row: row.delta_bic)


@section(55, "The search for causes", "diagnose/candidates.csv", _is_settled)
def search_section(material: Material) -> list[Block]:
    """Draw the strongest candidates, and tabulate detection limits and causes that could not be tested."""
    rows = material.candidates
    return [*candidates_figure(material), *limits(rows), *not_tested(rows)]


def gain_words(finding: Finding) -> str:
    """Return words on a cause's gain at held-out poses."""
    gain, low, high = finding.gain
    if finding.is_suspicion:
        return "it is left out of the model, since it does not help at poses left out in turn"
    if math.isnan(gain):
        return "no poses were held out, so what it gains at other poses is not known"
    size, interval = f"{mm(abs(gain))} {finding.error_unit}", f" ({_interval(finding)})" if math.isfinite(low) else ""
    if high < 0:
        return f"it makes the mean error at held-out poses {size} larger{interval}"
    if low <= 0:
        return f"it gains nothing for certain at held-out poses{interval}"
    return f"it takes {size} off the mean error at held-out poses{interval}"


def _interval(finding: Finding) -> str:
    low, high = (number(end, ".3f") for end in finding.gain[1:])
    return f"95 % interval {low} to {high} {finding.error_unit}"


def _gain_cells(finding: Finding) -> tuple[str, str]:
    gain, low, high = (number(value, ".3f") for value in finding.gain)
    return (gain, f"{low} … {high}") if shows_gain(finding) else ("–", "–")


def shows_gain(finding: Finding) -> bool:
    """Whether a gain can be reported: it is known, and not exactly zero as for what varies from pose to pose."""
    return math.isfinite(finding.gain[0]) and any(float(f"{value:.3f}") for value in finding.gain)


def still_unexplained(left: Sequence[Finding], misfit: str) -> list[Block]:
    """Return paragraphs on what stays unexplained; misfit: the statement on the lack of fit."""
    items = [
        ("The model as a whole:", misfit) if finding.is_misfit else
        (f"{first_up(finding.inputs_in_words)}:", f"{_suspects(finding)}the chance that noise looks like this is "
         f"{chance(finding.p_family)}.{SMOOTH.format(gain_words(finding)) * shows_gain(finding)}")
        for finding in left
    ]  # fmt: skip
    return headed("What stays unexplained", Paragraph(UNEXPLAINED_WORDS, keep=True), Bullets(items), where=left)


def _suspects(finding: Finding) -> str:
    return f"suspected is {finding.suspects}, too uncertain to be put into the model; " if finding.suspects else ""


@section(15, "What the model lacked: causes", "diagnose/findings.csv", _is_settled)
def causes_section(material: Material) -> list[Block]:
    """Return each finding in words and figures, then what is left."""
    findings = material.findings
    causes = [finding for finding in findings if finding.is_cause]
    left = [finding for finding in findings if finding.status == "unexplained"]
    return [
        *_opening(material, findings),
        *[block for k, finding in enumerate(causes, start=1) for block in _finding(material, finding, k)],
        *still_unexplained(left, material.lack_of_fit_words),
    ]


def _opening(material: Material, every: Sequence[Finding]) -> list[Block]:
    summary = material.diagnosis_summary
    faults = dict.fromkeys(effect_words(finding.cause) for finding in every if finding.status == FAULT)
    mended = f" Faults of the data ({listed(list(faults))}) were dealt with first: see their section." if faults else ""
    searched = (
        f"{summary.causes_tested} causes were tested on what the study's model leaves, each at its place in the robot or its "
        f"surroundings. A cause counts as found if fewer than {100 * threshold(material):.2g} % of such searches would find "
        f"anything in a robot without faults.{mended}"
    )
    causes = [finding for finding in every if finding.status != FAULT]
    if not causes:
        unseen = f" But {summary.unseen}." if summary.unseen else ""
        return [Paragraph(NOTHING + unseen, bold=True), Paragraph(searched)]
    order = count(1)
    rows = [
        (str(next(order)) if finding.is_cause else "–", _title(finding),
         finding.amount if finding.is_cause and finding.unit else "–",
         "suspected" if finding.is_suspicion else STATUS.get(finding.status, finding.status),
         chance_figure(finding.p_family), sureness(finding.name_probability),
         *_gain_cells(finding))
        for finding in causes
    ]  # fmt: skip
    gain = f"gain [{causes[0].error_unit}]"
    header = ("", "finding", "size (± 1 sd)", "name", "false alarm", "probability", gain, "95 % interval")
    none = not any(finding.is_cause for finding in causes)
    return [
        *([Paragraph("No cause of the catalogue was found.", bold=True)] if none else []),
        Paragraph(searched),
        Paragraph(NO_PROOF),
        Table(header, rows, "rlrlrrrr", size=8, wide=1),
        *([Paragraph(CURVES)] if any(moves(material, finding) for finding in causes) else []),
    ]


def _title(finding: Finding) -> str:
    if finding.is_misfit:
        return f"more than noise{f', most where {finding.detail}' if finding.detail else ''}"
    if finding.status == "unexplained":
        return f"depends on {finding.inputs_in_words}"
    return finding.names


def apart(finding: Finding, outcome: RunOutcome) -> list[str]:
    """Return words on what would distinguish a cause from its rivals."""
    sentences, by_poses = [], dict[str, list[SeparationRow]]()
    for row in outcome.separations:
        if (row.cause, row.joint) != (finding.cause, finding.joint):
            continue
        if row.chance_after < ENOUGH:
            sentences.append(f"{first_up(row.words)}.")
            continue
        by_poses.setdefault("The poses of diagnose/next_poses.csv" if row.proposed else "Further poses", []).append(row)
    for poses, rows in by_poses.items():
        rivals = listed([cause_name(row.rival, row.rival_joint) for row in rows], RIVALS_TOLD)
        least = min(row.separation_after_sd for row in rows)
        sentences.append(f"{poses} would distinguish it from {rivals}, by at least {least:.1f} standard deviations.")
    return list(dict.fromkeys(sentences))[:RIVALS_TOLD]


def _finding(material: Material, finding: Finding, number: int) -> list[Block]:
    """Return the description of a cause in words and figures, under its number among those found."""
    moved = moves(material, finding)
    unmoved = "It changes how much each row counts, not the predicted position."
    gain = first_up(f"{gain_words(finding)}.") if moved else unmoved
    kin = fitting_kin(finding, material.candidates)
    sentences = (_what(finding), name_certainty(finding, kin), *apart(finding, material), gain)
    head = Heading(f"{number}. {first_up(finding.names)}")
    return [head, Paragraph(" ".join(filter(None, sentences))), *_curves(material, finding)]


def _what(finding: Finding) -> str:
    words = cause_words(finding.cause)
    size = f"{words.size} {finding.amount}" if finding.unit else ""
    if finding.of_family:
        best = f"{words.name} ({finding.detail})" if finding.detail else words.name
        family = cause_family(finding.cause)
        turned = f"Joint {finding.joint} is off by an amount that depends on {FORMS_OF_ONE[family]}"
        off = turned if finding.joint else GIVES_WAY if family == OF_THE_TOOL else WANDERED
        off += f" ({finding.statement})" if len(finding.numbers) > 2 else ""
        return f"{off}; best described as {best}: {size}."
    title = first_up(words.what or words.name)
    return f"{title}: {size} (1 sd)." if size and "±" in size else f"{title}{f': {size}' if size else ''}."


def fitting_kin(finding: Finding, candidates: Sequence[CandidateRow]) -> list[str]:
    """Return the ids of a finding's family that fit as well, without those that these data could not have."""
    tried = {*finding.rival_causes, *(row.cause for row in _tested(candidates))}
    return [name for name in finding.kin if name in tried]


def name_certainty(finding: Finding, kin: Sequence[str]) -> str:
    """Return words on the certainty that a cause exists, and that it has this name; kin are those of `fitting_kin`."""
    sentences = []
    if finding.of_family:
        on = FORMS_OF_ONE[cause_family(finding.cause)]
        several = " or whether it is one cause or several" if len(finding.numbers) > 1 else ""
        sentences.append(f"The data show that it depends on {on}, but do not determine its exact form{several}.")
        names = first_up(listed([cause_words(name).name for name in kin]))
        sentences += [f"{names} would fit as well."] if kin and not several else []
    if finding.others:
        named = [other for other in finding.others if other.cause != UNEXPLAINED]
        tested = [other.name for other in named if other.cause not in finding.not_tested]
        untested = [other.name for other in named if other.cause in finding.not_tested]
        verb = "explains" if len(tested) == 1 else "explain"
        why = [f"{listed(tested, 5)} {verb} these data as well, or nearly so"] if tested else []
        why += [f"{listed(untested, 5)} could not be tested with these data"] if untested else []
        doubt, it = (
            ("A part of it may be another cause", "that") if finding.is_in_part else ("Its name is not certain", "it")
        )
        why += [f"{it} may be part of the unexplained error"] if len(named) < len(finding.others) else []
        doubted = f"{doubt}: {', and '.join(why)}"
        if finding.is_in_part and not named:
            doubted = "A part of it may belong to the unexplained error"
        sure = f"{sureness(finding.name_probability)}{_of_its_family(finding)}"
        sentences.append(f"{doubted} (probability of {finding.name}: {sure}).")
    elif UNEXPLAINED in finding.cannot_tell_from:
        sentences.append(
            "Its name is not certain: something that no cause explains depends on the same input, and may be all of it."
        )
    elif not finding.of_family:
        sentences.append(
            f"Nothing else that was tested explains the data nearly as well (probability {sureness(finding.name_probability)})."
        )
    if finding.carries_over is False:
        sentences.append("It does not hold in blocks of the fitted poses that were left out: do not rely on its name.")
    return " ".join(sentences)


def _of_its_family(finding: Finding) -> str:
    if finding.of_family or not math.isfinite(finding.family_probability):
        return ""
    return f"; of {cause_family(finding.cause)} there, of whatever kind: {sureness(finding.family_probability)}"


def moves(material: Material, finding: Finding) -> bool:
    """Whether a finding belongs to the model of the position, not of the noise."""
    return finding.is_cause and bool((material.tables["diagnose/curves.csv"]["finding"].isin(finding.numbers)).any())


def _curves(material: Material, finding: Finding) -> list[Block]:
    every = material.tables["diagnose/curves.csv"]
    used = every[every["split"].isin(["train", "holdout"])]
    courses = {number: used[used["finding"] == number] for number in finding.numbers}
    return [_curve_figure(finding, rows, number, material.unit) for number, rows in courses.items() if not rows.empty]


def _curve_figure(finding: Finding, rows: pd.DataFrame, number: int, error_unit: MeasurementUnit) -> Block:
    errors = ["before", "after", "fitted"]
    x, before, after, fitted = rows[["x", *errors]].to_numpy(dtype=float).T
    unit = "" if pd.isna(rows["variable_unit"].iloc[0]) else str(rows["variable_unit"].iloc[0])
    held, variable = (rows["split"] != "train").to_numpy(), str(rows["variable"].iloc[0])
    drawn = explained_figure(x, before, after, fitted, held, variable, unit, error_unit.label)
    title = finding.name if len(finding.numbers) == 1 else cause_name(str(rows["cause"].iloc[0]), finding.joint)
    caption = f"{first_up(title)}: errors without it, with it, and against what it explains."
    shown_rows = rows[["variable", "variable_unit", "x", *errors, "split"]]
    return Plot(f"cause_{number}", drawn, caption, shown_rows)
