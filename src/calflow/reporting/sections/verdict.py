"""The first page: what calibration gained, how sure that is, what stays open and what to do next."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from textwrap import wrap
from typing import Any

import numpy as np
import scipy
from matplotlib.figure import Figure

from calflow.deployment.figures_alone import NOT_COMPUTED, Effort
from calflow.deployment.usability import (
    ENOUGH,
    accuracy_steps,
    effort_levels,
    findings_of,
    judgement,
    lack_of_fit_words,
    latest_summary,
    mistake_unsettled,
    split_judged,
    structure,
    unexplained_findings,
)
from calflow.diagnosis.diagnosis import DiagnosisSummary
from calflow.diagnosis.findings import Finding
from calflow.effects.base import UNEXPLAINED, cause_family, place_name
from calflow.estimation.accuracy import Accuracy
from calflow.estimation.calibrated_model import Certainty, FitSummary, IdentifySummary
from calflow.estimation.identifiability import Statement, scale_words, silent_words, trade_words
from calflow.files.deferred import pd
from calflow.files.tables import Results
from calflow.files.units import METRE
from calflow.files.words import chance, effect_words, first_up, listed, mm, percent, plural, plural_word, ratio
from calflow.reporting.advice import (
    BY_PRIOR,
    LACKS,
    LEVEL,
    RARE,
    SURPRISE,
    WRONG,
    advice,
    identified_parameters,
    of_kind,
    predicted_rows,
    spoken,
    task_of,
)
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
    Table,
    headed,
)
from calflow.reporting.material import Material
from calflow.reporting.section import Section
from calflow.reporting.sections.acceptance import identity, to_sign
from calflow.reporting.sections.task import answer
from calflow.reporting.style import DARK, LIGHT, MIDDLE, PLATE, error_axis, figure, mark_floor, plain_decades

CARDS = 3
GIVE: dict[Effort, str] = {  # as a column's head has room for it
    "nothing": "nothing",
    "zeros": "joint zeros",
    "zeros and tool": "zeros and tool",
    "figures": "all figures",
    "commands": "corrected commands",
}
TEXT = 10.5  # points, of what is beside the figure
ALL_KNOWN = "Nothing: the data determine every parameter."
FINE = "Use it. Nothing needs attention for the tools, the loads and the places that were measured."
CHOICE = ", and the choice among causes that do as well"
LONGEST = 14  # letters of a line below a bar
CAPPED = (
    "As many causes were found as were allowed (stages.diagnose.causes). There may be more: what they would explain is left over, "
    "or attributed to those found."
)
TRADES = 3  # trades on the first page
LIKELIER = 0.5  # probability below which it is rather another cause than the one that a finding is named by
RIVALS = 3  # of a finding that the first page names
NAMED = 3  # parameters that a trade on the first page names
CONTRADICTED = 2  # times what is expected at most, from which held-out poses are held against it


def _first_page(material: Material) -> list[Block]:
    """Put the verdict on one page."""
    results = material.results
    split, steps = split_judged(results), gathered_steps(results)
    diagnosed, unsettled = "diagnose/findings.csv" in results, mistake_unsettled(results)
    bars = Plot("before_after", before_after(steps, material.certainty.noise_floor), data=accuracy_frame(steps))
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
        Columns([[bars], [Heading("How sure is this?"), Bullets(how_sure(material), TEXT)]], [1, 1]),
        RestOfPage(
            [*([] if unsettled else still_open), Heading("What to do next, most useful first")], next_steps(results)
        ),
    ]


def _cards(material: Material, steps: Sequence[ModelAccuracy]) -> list[Card]:
    """Return the errors before and now, with a step between, and how sure predictions are."""
    shown = [steps[0], *steps[1:][-(CARDS - 1) :]]
    cards = [
        Card(_when(step, steps) + step.label, mm(step.mean), f"largest {mm(step.max)} {step.unit}",
             step is steps[-1] and len(steps) > 1, step.unit)
        for step in shown
    ]  # fmt: skip
    sure, known = mm(material.certainty.prediction_sd_mm), latest_summary(material.results).noise_known
    return [
        *cards,
        Card("tool position known to", sure, f"1 sd, {'without device noise' if known else 'noise included'}"),
    ]


def _when(step: ModelAccuracy, steps: Sequence[ModelAccuracy]) -> str:
    """Say whether a model is that before calibration, or now."""
    return "before: " if step is steps[0] else "now: " if step is steps[-1] else ""


def next_steps(results: Results) -> list[str]:
    """Say what to do, what is worth most first: to use the model where nothing is wrong with it."""
    items = advice(results)
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
        ("Predictions:", certainty_words(certainty, summary.noise_known)),
    ]
    if summary.new_poses_mm is not None:
        last = gathered_steps(material.results)[-1]
        held_out = last.rms if certainty.split == "holdout" and last.unit == METRE.label else 0.0
        sentences.append(("At new poses like the fitted ones:", new_poses_words(summary, held_out)))
    if "sample/predictive.csv" in material.results:
        sentences.append(("Tested:", coverage_words(material.results)))
    return sentences


def new_poses_words(summary: FitSummary, held_out: float) -> str:
    """Say by how much new poses are expected to be missed, or that held-out ones, off by so much [mm] (rms), contradict it."""
    noise = math.sqrt(3) * (summary.sigma_mm or 0.0)
    if held_out > math.hypot(noise, CONTRADICTED * (summary.new_poses_limit_mm or math.inf)):
        return f"the fit lets expect {summary.at_new_poses}, but held-out poses are off by {mm(held_out)} mm: do not rely on it."
    return f"off by {summary.at_new_poses}, root mean square, without the noise."


def certainty_words(certainty: Certainty, noise_known: bool) -> str:
    """Say how sure predictions are, with the model's own error and the choice of its causes, and what is left."""
    counted = "the model's own error" if noise_known else "all that the fit leaves, noise or not"
    counted += CHOICE if certainty.rivals else ""
    where = "at held-out poses" if certainty.split == "holdout" else "at the poses that were fitted"
    return (
        f"the tool's position {where} is known to {mm(certainty.prediction_sd_mm)} mm (1 sd). That includes {counted}. "
        f"Measured there: {mm(certainty.left)} {certainty.unit} on average, with the noise."
    )


def leftover(
    times: float, discrepancy: float = 0.0, structure: str = "", significant: bool = False, unit: str = METRE.label
) -> str:
    """Say what a lack-of-fit factor and the model's own error [unit] mean; nan is a factor that cannot be known.

    structure is what an unexplained part of the error depends on, if there is one; significant says that so much is no chance.
    """
    if structure and not times > ENOUGH:
        return f"a part of it depends on {structure}, so it is more than noise. No cause explains that."
    if math.isnan(times):
        return "whether it is more than noise cannot be told: the noise was estimated from the fit itself."
    if times <= ENOUGH and not significant:
        return f"{times:.2f} times the noise, so the noise explains all of it."
    steps = (
        f" The model's own error, {mm(discrepancy)} {unit} per axis, is counted in how sure predictions are."
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


def before_after(steps: Sequence[ModelAccuracy], floor: float | None) -> Figure:
    """Draw mean and largest error [unit] of each model on a logarithmic scale, with what noise alone would leave.

    floor is None where that is not known.
    """
    drawn = figure(2.9, 3.5)
    axes = drawn.add_subplot()
    at = np.arange(len(steps))
    base = 0.4 * min(filter(None, [*(step.mean for step in steps), floor]))
    most = max(step.max for step in steps)
    above: dict[str, Any] = {"textcoords": "offset points", "ha": "center", "bbox": PLATE, "fontsize": 6.5}
    looks: list[tuple[float, str, list[float], dict[str, Any]]] = [
        (-0.2, "mean", [step.mean for step in steps], {"color": DARK}),
        (0.2, "largest", [step.max for step in steps], {"facecolor": LIGHT, "edgecolor": MIDDLE, "hatch": "////"}),
    ]
    for shift, name, values, look in looks:
        axes.bar(at + shift, np.array(values) - base, 0.38, bottom=base, label=name, linewidth=0.6, **look)
        for x, value in zip(at + shift, values, strict=True):
            axes.annotate(mm(value), (x, value), (0, 2.5), **above)
    mark_floor(axes.axhline, floor, steps[0].unit)
    axes.set_yscale("log")
    axes.set_ylim(base, most * (most / base) ** 0.16)
    plain_decades(axes.yaxis, base, most)
    axes.set_xticks(at, [_wrapped(step) for step in steps])
    axes.set_xlim(-0.55, len(steps) - 0.45)
    axes.grid(axis="x", visible=False)
    axes.set_ylabel(error_axis(steps[0].unit))
    drawn.legend(loc="outside upper center", ncols=3, columnspacing=1.0, handlelength=1.6)
    return drawn


def _wrapped(step: ModelAccuracy) -> str:
    """Break a long label after its first word, and where it is too long for its bar."""
    first, *rest = step.name.split()
    plus = "+ " if step.added else ""
    return "\n".join([f"{plus}{first}", *wrap(" ".join(rest), LONGEST)])


@dataclass(frozen=True)
class ModelAccuracy:
    """A model's accuracy on one split [unit]; name says what it is, or what it has more than the one before (added)."""

    model: str
    name: str
    n: int
    mean: float
    rms: float
    max: float
    added: bool = False
    unit: str = METRE.label

    @property
    def label(self) -> str:
        """The name, with a plus where it is what was added."""
        return f"+ {self.name}" if self.added else self.name


def model_steps(results: Results, split: str) -> list[ModelAccuracy]:
    """Return the models on the way to the best one, in their order."""
    rows = [row for row in accuracy_steps(results) if row.split == split]
    return [
        ModelAccuracy(row.model, _name(row), row.n, *row.figures, row.step > 1, row.unit)
        for row in rows if row.unit == rows[0].unit  # that by which models are judged
    ]  # fmt: skip


def study_steps(results: Results, split: str) -> list[ModelAccuracy]:
    """Return those of them that the study asks for, before any cause was added."""
    return model_steps(results.of({"identify"}), split)


def gathered_steps(results: Results) -> list[ModelAccuracy]:
    """Return the models on the split by which they are judged, the causes that were added drawn together."""
    split = split_judged(results)
    return gathered(model_steps(results, split), len(study_steps(results, split)))


def gathered(steps: list[ModelAccuracy], own: int) -> list[ModelAccuracy]:
    """Return steps of which the first are the study's own and the others, if there are several, are drawn together."""
    added = len(steps) - own
    return steps if added < 2 else [*steps[:own], replace(steps[-1], name=f"{added} causes", added=True)]


def accuracy_frame(steps: list[ModelAccuracy]) -> pd.DataFrame:
    """Return models with their accuracy as a table for whoever wants a figure's numbers."""
    unit = steps[0].unit if steps else METRE.label
    return pd.DataFrame(
        [(step.label, step.n, step.mean, step.rms, step.max) for step in steps],
        columns=["model", "rows", *(f"{name}_{unit}" for name in ("mean", "rms", "max"))],
    )


def _name(row: Accuracy) -> str:
    if not row.effect:
        return "nominal robot"
    return place_name(row.effect, row.joint or 0, row.part) if row.part else effect_words(row.effect)


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


def foremost(results: Results) -> list[str]:
    """Say what a reader must know before any cause: a contradicted noise, and that the model leaves more than its noise."""
    doubts = results.document("identify/summary.json", IdentifySummary).noise_doubts
    sentences = (*(doubt.statement for doubt in doubts), lack_of_fit_words(results))
    return [sentence for sentence in sentences if sentence]


def lacked(results: Results, most: int = 4) -> list[str | tuple[str, str]]:
    """Say for the first page in a line each what the model lacked: what gains most first, what gains nothing last, as such."""
    causes = [finding for finding in findings_of(results) if finding.is_cause]
    summary = results.document("diagnose/summary.json", DiagnosisSummary)
    if not causes:
        more = unexplained_findings(results) or lack_of_fit_words(results)
        heading = "No cause explains what is left" if more else "Nothing was found"
        unseen = f" {first_up(summary.unseen)}." if summary.unseen else ""
        return [f"{heading}: {summary.causes_tested} causes were tested.{unseen}"]
    every = [(cause, _or_another(cause, label)) for cause, label in zip(causes, labels(causes), strict=True)]
    named = [pair for pair in every if not pair[0].is_suspicion]
    suspected = [name for cause, name in every if cause.is_suspicion]
    worth = [pair for pair in named if not _in_vain(pair[0])]
    worth.sort(key=lambda pair: -np.nan_to_num(pair[0].gain[0]))  # a gain that is not known is none
    vain = [name for cause, name in named if _in_vain(cause)]
    items: list[str | tuple[str, str]] = [(f"{first_up(name)}:", _line(cause)) for cause, name in worth[:most]]
    if len(worth) > most:
        rest = listed(list(dict.fromkeys(cause.name for cause, _ in worth[most:])), len(worth))
        items.append((f"And {plural(len(worth) - most, 'more cause')}:", f"{rest}."))
    if vain:
        items.append(("In the model without measurable gain at held-out poses:", f"{listed(vain, len(vain))}."))
    if suspected:
        items.append(("Suspected, and left out of the model:", f"{listed(suspected, len(suspected))}."))
    if summary.capped:
        items.append(CAPPED)
    return items


def labels(causes: Sequence[Finding]) -> list[str]:
    """Return the causes' names, with their details where a name comes twice."""
    names = [finding.name for finding in causes]
    return [
        f"{finding.name} ({finding.detail})" if names.count(finding.name) > 1 and finding.detail else finding.name
        for finding in causes
    ]


def _or_another(finding: Finding, name: str) -> str:
    """Add to the name of what is less probable than not, as a cause and as one of its family, that it is one of several."""
    n = len(finding.others)
    if finding.of_family or not n or not finding.probability < LIKELIER:
        return name
    return f"{name} or {'another' if n == 1 else f'one of {n} others'}"


def _in_vain(finding: Finding) -> bool:
    """Whether the step that added a cause shows no gain at poses that no fit has seen."""
    return math.isfinite(finding.gain[0]) and not finding.gain[1] > 0


def _line(finding: Finding) -> str:
    taken = f"; it takes {mm(finding.gain[0])} {finding.error_unit} off the mean error"
    return f"{finding.amount}{taken if math.isfinite(finding.gain[0]) else ''}."


def unsure(results: Results) -> list[str]:
    """Say for the first page which names and which structure the data leave open."""
    open_forms: dict[str, list[int]] = {}
    for finding in findings_of(results):
        if finding.of_family:
            open_forms.setdefault(cause_family(finding.cause), []).extend([finding.joint] if finding.joint else [])
    sentences = [
        f"The order, or finer form, of the {_of_joints(family, joints)}." for family, joints in open_forms.items()
    ]
    for finding in findings_of(results):
        if UNEXPLAINED in finding.cannot_tell_from:
            sentences.append(f"Whether it is {finding.name} at all, or a part of what stays unexplained.")
        elif finding.status == "one_of" and finding.others:
            nearest = [rival.name for rival in finding.others[:RIVALS]]
            more = len(finding.others) - len(nearest)
            rest = [f"one of {more} more"] if more > 1 else [rival.name for rival in finding.others[RIVALS:]]
            sentences.append(f"Whether it is {' or '.join([finding.name, *nearest, *rest])}.")
    left = unexplained_findings(results)
    why = f"Why a part of the error depends on {structure(results)}. No known cause explains it for certain."
    gain = max((finding.gain[0] for finding in left if finding.gain[1] > 0), default=0.0)
    worth = f" What depends on it is worth {mm(gain)} {left[0].error_unit} of the mean error, or more." if gain else ""
    return [*sentences, why + worth] if left else sentences


def _of_joints(family: str, joints: Sequence[int]) -> str:
    return f"{family} of {plural_word(joints, 'joint')} {listed(joints)}" if joints else family


def open_questions(results: Results) -> list[str]:
    """Say for the first page what the data cannot tell, in a few sentences."""
    trades = of_kind(results, "trade")
    silent = [name for statement in of_kind(results, "silent") for name in statement.parameters]
    bound = [name for statement in of_kind(results, "bound") for name in statement.parameters if name not in silent]
    covered = {*silent, *bound, *(name for trade in trades for name in trade.parameters)}
    prior = [
        row.parameter
        for row in identified_parameters(results)
        if row.prior_share > BY_PRIOR and row.parameter not in covered
    ]
    sentences = [statement_words(statement) for statement in of_kind(results, "scale")]
    if silent:
        sentences.append(f"{first_up(spoken(silent, results))}: assumed, not measured.")
    if trades:
        sentences += [f"{first_up(_trade(trade.parameters, results))}." for trade in trades[:TRADES]]
        sentences += [f"And {plural(len(trades) - TRADES, 'more combination')}."] * (len(trades) > TRADES)
    if bound:
        size = spoken(bound, results)
        sentences.append(f"The size of {size}: at the end of the allowed range, so no standard deviation is given.")
    if prior:
        sentences.append(f"More about {spoken(prior, results)} than was known before.")
    return sentences


def _trade(names: Sequence[str], results: Results) -> str:
    first, *rest = names
    others = spoken(rest, results) if len(rest) <= NAMED else f"{len(rest)} other parameters"
    return f"{spoken([first], results)} apart from {others}"


def statement_words(statement: Statement) -> str:
    if statement.kind == "trade":
        return f"{trade_words(statement.parameters, statement.weights, statement.wholly)}."
    if statement.kind == "scale":
        return f"{first_up(scale_words(statement.wholly))}."
    return f"{first_up(silent_words(statement.parameters[0], statement.wholly))}."


def levels_of_effort(material: Material) -> list[Block]:
    """Return in a few lines how the robot errs with each level of effort; nothing where no figure was fitted."""
    if not material.has_figures:
        return []
    if not (every := effort_levels(material.results)):
        return [Paragraph(f"{first_up(NOT_COMPUTED)}: run the study again.", 9)]
    rows = [
        (f"mean error [{every[0].unit}]", *(mm(level.mean) for level in every)),
        (f"RMS error, measured [{every[0].unit}]", *(mm(level.rms) for level in every)),
        (f"RMS error, expected [{every[0].unit}]", *(mm(level.promised) for level in every)),
    ]
    header = ("what you give to the robot", *(GIVE[level.level] for level in every))
    return [Table(header, rows, "l" + "r" * len(every), size=8)]


def task_lines(results: Results) -> list[str]:
    """Return the answer where a tolerance is asked of a task."""
    task = task_of(results)
    words = answer(task) if task else None
    return [words] if words else []


def coverage_words(results: Results) -> str:
    """Say how many errors lie inside their interval."""
    rows, words = predicted_rows(results)
    inside = int(rows["covered"].astype(bool).sum())
    so_few = float(scipy.stats.binom.cdf(inside, len(rows), LEVEL))
    few = (
        " That is too few: the intervals are too narrow." if so_few <= SURPRISE else
        f" That is few, and may be chance: {chance(so_few)}." if so_few < RARE else ""
    )  # fmt: skip
    return f"{inside} of {len(rows)} errors of {words} ({percent(inside / len(rows))}) lie inside their 95 % interval.{few}"


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
