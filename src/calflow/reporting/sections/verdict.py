"""The first page: what calibration gained, how sure that is, what stays open and what to do next."""

from __future__ import annotations

import math

from calflow.deployment.usability import is_useless, mistake_unsettled, split_judged
from calflow.estimation.calibrated_model import IdentifySummary
from calflow.files.results import Results
from calflow.files.units import METRE
from calflow.files.words import first_up, listed, mm, plural, ratio
from calflow.reporting.blocks import Block, Bullets, Card, Columns, Gap, Heading, Paragraph, Plot, RestOfPage, headed
from calflow.reporting.material import (
    Material,
    ModelAccuracy,
    accuracy_frame,
    findings_of,
    gathered_steps,
    latest_summary,
)
from calflow.reporting.section import Section, advice, sections
from calflow.reporting.sections.acceptance import held_against_tolerance
from calflow.reporting.sections.accuracy import LACKS, before_after
from calflow.reporting.sections.causes import foremost, lacked, structure, unsure
from calflow.reporting.sections.parameters import open_questions
from calflow.reporting.sections.posterior import coverage_words
from calflow.reporting.sections.task import task_lines

ENOUGH = 1.1  # times the noise up to which a model counts as complete
CARDS = 3
TEXT = 10.5  # points, of what is beside the figure
CHOICE = " and the choice among causes that do as well"
ALL_TOLD = "Nothing: the data determine every parameter."
FINE = "Nothing needs attention: the parameters can be used for the tools, loads and workspace that were measured."


def _first_page(material: Material) -> list[Block]:
    """Put the verdict on one page."""
    results = material.results
    split, steps = split_judged(results), gathered_steps(results)
    shown = [steps[0], *steps[1:][-(CARDS - 1) :]]
    cards = [[_card(step, step is steps[-1] and len(steps) > 1)] for step in shown]
    verdict = held_against_tolerance(material)
    diagnosed = "diagnose/findings.csv" in results
    figure = Plot("before_after", before_after(steps, material.noise_floor), data=accuracy_frame(steps))
    still_open: list[Block] = [
        *(headed("What the study's model lacked", Bullets(lacked(results), None)) if diagnosed else ()),
        Heading("What the data cannot tell"),
        Bullets((*unsure(results), *open_questions(results)) or (ALL_TOLD,), None),
    ]
    return [
        Paragraph("Calibration report", 10),
        Heading(material.title, 0),
        Paragraph(_measured(material), 10),
        Gap(20),
        Paragraph(judgement(results), 14, bold=True),
        Gap(6),
        *([Paragraph(verdict.verdict, 11, bold=True)] if verdict else []),
        *(Paragraph(sentence, 11, bold=True) for sentence in (*task_lines(results), *foremost(results))),
        Paragraph(headline(steps, split), 12),
        Gap(16),
        Columns(cards, [1] * len(cards), 8),
        Gap(16),
        Columns([[figure], [Heading("How sure is this?"), Bullets(how_sure(material), TEXT)]], [1, 1]),
        RestOfPage(
            [
                *([] if mistake_unsettled(results) else still_open),
                Heading("What to do next"),
            ],
            [step.sentence for step in advice(sections(), results)] or [FINE],
        ),
    ]


def _card(step: ModelAccuracy, dark: bool) -> Card:
    return Card(step.label, mm(step.mean), f"largest {mm(step.max)} {step.unit}", dark)


def judgement(results: Results) -> str:
    """Say in a few words whether to use the model."""
    if mistake_unsettled(results):
        return "Do not use this model: a mistake is to be settled first."
    if is_useless(results):
        return "Do not use this model: see what to do next."
    summary = latest_summary(results)
    times = summary.lack_of_fit
    if any(finding.status == "unexplained" for finding in findings_of(results)):
        return "Usable where it was measured, but something unexplained is left."
    if math.isnan(times):
        return "Usable where it was measured; how much better it could be is not known."
    if times <= ENOUGH and not summary.lacks_fit:
        if summary.new_poses_mm is not None and summary.times_noise > 1:
            return f"Calibrated, by few poses: expect {mm(summary.new_poses_mm)} mm at new ones."
        return "Calibrated: as good as the measuring device can tell."
    return "Usable where it was measured, but the model lacks something."


def headline(steps: list[ModelAccuracy], split: str) -> str:
    """Say in one sentence what calibration gained."""
    first, last = steps[0], steps[-1]
    seen = "that no fit has seen" if split == "holdout" else "used for the fit (none were held out)"
    if len(steps) == 1:
        return f"At poses {seen}, the nominal robot is off by {mm(first.mean)} {first.unit} on average."
    verb, unit = "reduces" if last.mean < first.mean else "increases", last.unit
    error = "the tool-position error" if unit == METRE.label else "the error of what was measured"
    return (
        f"At poses {seen}, calibration {verb} {error} from {mm(first.mean)} {unit} to {mm(last.mean)} {unit} "
        f"on average, and the largest from {mm(first.max)} {unit} to {mm(last.max)} {unit}."
    )


def how_sure(material: Material) -> list[tuple[str, str]]:
    """Say what the numbers are worth: noise, lack of fit, the model's own uncertainty, coverage."""
    alone, unit = material.noise_floor, material.unit
    floor = f" Noise alone would give a mean error of {mm(alone)} {unit.label}." if alone else ""
    summary = latest_summary(material.results)
    said = [
        ("Noise:", f"{material.noise_words}.{floor}"),
        (
            "Left over:",
            leftover(
                summary.lack_of_fit,
                summary.discrepancies.get(unit.label, 0.0),
                structure(material.results),
                summary.lacks_fit,
                unit.label,
            ),
        ),
        ("Calibrated model:", certainty(material)),
    ]
    if "sample/predictive.csv" in material.results:
        said.append(("Tested:", coverage_words(material.results)))
    return said


def certainty(material: Material) -> str:
    """Say how sure predictions are, with the model's own error and the choice of its causes, and what is left."""
    own = "its own error" if material.calibrated.noise_known else "what the fit leaves, noise or not,"
    own += CHOICE if material.calibrated.alternatives else ""
    where = "at held-out poses" if material.held.any() else "at the poses that were fitted"
    left = f"{mm(float(material.distance[material.judged].mean()))} {material.unit.label}"
    return (
        f"where it was tested, its predicted positions are certain to {mm(material.prediction_sd)} mm (1 sd, {own} "
        f"included; from its parameters alone: {mm(material.model_sd)} mm). {first_up(where)} {left} are left on average."
    )


def leftover(
    times: float, discrepancy: float = 0.0, structure: str = "", significant: bool = False, unit: str = METRE.label
) -> str:
    """Say what a lack-of-fit factor and the model's own error [unit] mean; nan is a factor that cannot be known.

    structure is what an unexplained part of the error depends on, if there is one; significant says that so much is no chance.
    """
    if structure and not times > ENOUGH:
        return f"more than noise: a part of it depends on {structure}, and no cause explains that."
    if math.isnan(times):
        return "whether the model leaves more than noise cannot be told: the noise was estimated from the fit itself."
    if times <= ENOUGH and not significant:
        return f"the model leaves {times:.2f} times the noise, so the noise explains all that is left."
    own = (
        f" Its own error of {mm(discrepancy)} {unit} per axis is counted in every standard deviation."
        if discrepancy
        else ""
    )
    lacks = "it lacks something" if times > LACKS else "a little more than noise explains"
    return f"the model leaves {ratio(times)} times the noise: {lacks}.{own}"


def _measured(material: Material) -> str:
    summary = material.results.document("identify/summary.json", IdentifySummary)
    robot, data = material.robot, material.data.table
    loads = [name for name in dict.fromkeys(data["payload"].astype(str)) if name]
    markers = list(dict.fromkeys(data["marker"].astype(str)))
    parts = [
        f"Robot: {robot.name}",
        f"{plural(summary.training_poses, 'pose')} used for the fit, {summary.heldout_poses} held out",
        f"{plural(len(data), 'measured point')}",
        f"{'marker' if len(markers) == 1 else 'markers'} {listed(markers, 5)}",
        *([f"{'payload' if len(loads) == 1 else 'payloads'} {listed(loads, 5)}"] if loads else []),
    ]
    return "  ·  ".join(parts)


VERDICT_SECTION = Section(
    0, "Verdict", ("identify/accuracy.csv", "identify/summary.json", "identify/identifiability.csv"), _first_page
)


WHAT_FOLLOWS = (
    "What was asked and found is told up to here. What follows is for those who judge the calibration, go on with it or repeat "
    "it: what is left at each pose, how causes were searched for, every parameter, and how sure all of that is."
)


def _for_experts(material: Material) -> list[Block]:
    """Say what follows."""
    return [Paragraph(WHAT_FOLLOWS, keep=True)]


FOR_EXPERTS_SECTION = Section(49, "For experts", ("identify/accuracy.csv",), _for_experts)
