"""The first page: what calibration gained, how sure that is, what stays open and what to do next."""

from __future__ import annotations

import math
from collections.abc import Sequence

from calflow.deployment.usability import (
    ENOUGH,
    Certainty,
    judgement,
    latest_summary,
    mistake_unsettled,
    split_judged,
)
from calflow.estimation.calibrated_model import IdentifySummary
from calflow.files.tables import Results
from calflow.files.units import METRE
from calflow.files.words import listed, mm, plural, ratio
from calflow.reporting.blocks import (
    Block,
    Bullets,
    Card,
    Columns,
    Divider,
    Gap,
    Heading,
    Paragraph,
    Plot,
    RestOfPage,
    headed,
)
from calflow.reporting.section import (
    WRONG,
    Material,
    ModelAccuracy,
    Section,
    accuracy_frame,
    advice,
    gathered_steps,
    headline,
    sections,
)
from calflow.reporting.sections.acceptance import identity, to_sign
from calflow.reporting.sections.accuracy import LACKS, before_after
from calflow.reporting.sections.causes import foremost, lacked, structure, unsure
from calflow.reporting.sections.controller_figures import levels_of_effort
from calflow.reporting.sections.parameters import open_questions
from calflow.reporting.sections.posterior import coverage_words
from calflow.reporting.sections.task import task_lines

CARDS = 3
TEXT = 10.5  # points, of what is beside the figure
ALL_KNOWN = "Nothing: the data determine every parameter."
FINE = "Use it. Nothing needs attention for the tools, the loads and the places that were measured."
CHOICE = " and the choice among causes that do as well"


def _first_page(material: Material) -> list[Block]:
    """Put the verdict on one page."""
    results = material.results
    split, steps = split_judged(results), gathered_steps(results)
    diagnosed, unsettled = "diagnose/findings.csv" in results, mistake_unsettled(results)
    figure = Plot("before_after", before_after(steps, material.certainty.noise_floor), data=accuracy_frame(steps))
    still_open: list[Block] = [
        *(headed("What else was found at the robot", Bullets(lacked(results), None)) if diagnosed else ()),
        Heading("What the data cannot tell"),
        Bullets((*unsure(results), *open_questions(results)) or (ALL_KNOWN,), None),
    ]
    cards = _cards(material, steps)
    return [
        Paragraph("Calibration report", 10),
        Heading(material.title, 0),
        Paragraph(identity(material.request), 9),
        Paragraph(_measured(material), 9),
        Gap(16),
        Paragraph(judgement(results), 14, bold=True),
        Gap(6),
        *(Paragraph(sentence, 11, bold=True) for sentence in (*task_lines(results), *foremost(results))),
        Paragraph(headline(steps, split), 12),
        Paragraph(to_sign(material), 11),
        Gap(8),
        *levels_of_effort(material),
        Gap(10),
        Columns([[card] for card in cards], [1] * len(cards), 8),
        Gap(12),
        Columns([[figure], [Heading("How sure is this?"), Bullets(how_sure(material), TEXT)]], [1, 1]),
        RestOfPage(
            [*([] if unsettled else still_open), Heading("What to do next, what is worth most first")],
            next_steps(results),
        ),
    ]


def _cards(material: Material, steps: Sequence[ModelAccuracy]) -> list[Card]:
    """Return the errors before and now, with a step between, and what is promised where that was tested."""
    shown = [steps[0], *steps[1:][-(CARDS - 1) :]]
    cards = [
        Card(_when(step, steps) + step.label, mm(step.mean), f"largest {mm(step.max)} {step.unit}",
             step is steps[-1] and len(steps) > 1, step.unit)
        for step in shown
    ]  # fmt: skip
    promise = mm(material.certainty.prediction_sd_mm)
    return [*cards, Card("promised", promise, "1 sd where tested, without noise")]


def _when(step: ModelAccuracy, steps: Sequence[ModelAccuracy]) -> str:
    """Say whether a model is that before calibration, or now."""
    return "before: " if step is steps[0] else "now: " if step is steps[-1] else ""


def next_steps(results: Results) -> list[str]:
    """Say what to do, what is worth most first: to use the model where nothing is wrong with it."""
    items = advice(sections(), results)
    fine = [] if any(item.urgency <= WRONG for item in items) else [FINE]
    return [*fine, *(item.sentence for item in items)]


def how_sure(material: Material) -> list[tuple[str, str]]:
    """Say what the numbers are worth: noise, lack of fit, the model's own uncertainty, coverage."""
    certainty = material.certainty
    alone, unit = certainty.noise_floor, certainty.unit
    floor = f" Noise alone would give a mean error of {mm(alone)} {unit}." if alone else ""
    summary = latest_summary(material.results)
    left = summary.discrepancies.get(unit, 0.0)
    sentences = [
        ("Instrument:", f"noise of {certainty.noise}.{floor}"),
        ("What is left:", leftover(summary.lack_of_fit, left, structure(material.results), summary.lacks_fit, unit)),
        ("Promised:", certainty_words(certainty, summary.noise_known)),
    ]
    if "sample/predictive.csv" in material.results:
        sentences.append(("Tested:", coverage_words(material.results)))
    return sentences


def certainty_words(certainty: Certainty, noise_known: bool) -> str:
    """Say how sure predictions are, with the model's own error and the choice of its causes, and what is left."""
    yardstick = "its own error" if noise_known else "what the fit leaves, noise or not,"
    yardstick += CHOICE if certainty.rivals else ""
    where = "at held-out poses" if certainty.split == "holdout" else "at the poses that were fitted"
    return (
        f"positions {where} are certain to {mm(certainty.prediction_sd_mm)} mm (1 sd, {yardstick} included). "
        f"Measured there: {mm(certainty.left)} {certainty.unit} on average, with the noise."
    )


def leftover(
    times: float, discrepancy: float = 0.0, structure: str = "", significant: bool = False, unit: str = METRE.label
) -> str:
    """Say what a lack-of-fit factor and the model's own error [unit] mean; nan is a factor that cannot be known.

    structure is what an unexplained part of the error depends on, if there is one; significant says that so much is no chance.
    """
    if structure and not times > ENOUGH:
        return f"more than noise: a part of it depends on {structure}. No cause explains that."
    if math.isnan(times):
        return "whether it is more than noise cannot be told: the noise was estimated from the fit itself."
    if times <= ENOUGH and not significant:
        return f"{times:.2f} times the noise, so the noise explains all of it."
    steps = (
        f" The model's own error, {mm(discrepancy)} {unit} per axis, is counted in all that is promised."
        if discrepancy
        else ""
    )
    lacks = "it lacks something" if times > LACKS else "a little more than noise explains"
    return f"the model leaves {ratio(times)} times the noise: {lacks}.{steps}"


def _measured(material: Material) -> str:
    summary = material.results.document("identify/summary.json", IdentifySummary)
    robot, used = material.robot, material.certainty
    parts = [
        robot.name,
        f"{plural(summary.training_poses, 'pose')} used for the fit, {summary.heldout_poses} held out",
        f"{plural(used.points, 'measured point')}",
        f"{'marker' if len(used.markers) == 1 else 'markers'} {listed(used.markers, 5)}",
        *(
            [f"{'payload' if len(used.payloads) == 1 else 'payloads'} {listed(used.payloads, 5)}"]
            if used.payloads
            else []
        ),
    ]
    return "  ·  ".join(parts)


VERDICT_SECTION = Section(
    0,
    "Verdict",
    ("identify/accuracy.csv", "identify/summary.json", "identify/certainty.json", "identify/identifiability.csv"),
    _first_page,
)


WHAT_FOLLOWS = (
    "The pages before this one say what was asked and found. Those that follow are for whoever judges the calibration, continues "
    "it or repeats it: the error left at each pose, the search for causes, every parameter, and how sure all of that is."
)
FOR_EXPERTS = "For experts"
FOR_EXPERTS_SECTION = Section(
    49, FOR_EXPERTS, ("identify/accuracy.csv",), lambda _: [Divider(FOR_EXPERTS, WHAT_FOLLOWS)]
)
