"""The first page: the gain by calibration, its certainty, open questions, and what to do next."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from calflow.deployment.figures_alone import GIVEN, MEANT, EffortLevel
from calflow.deployment.in_space import over_ranges
from calflow.deployment.run_outcome import RunOutcome
from calflow.deployment.usability import Advice, judgement, labels, least_effort, mistake_unsettled, no_gain_words
from calflow.diagnosis.findings import Finding
from calflow.effects.wording import UNEXPLAINED, cause_family, place_name
from calflow.estimation.accuracy import Accuracy
from calflow.estimation.certainty import PROMISED, SURPRISE, Certainty
from calflow.estimation.identifiability import Statement
from calflow.files.deferred import pd
from calflow.files.words import chance, effect_words, first_up, listed, mm, number, percent, plural, plural_word
from calflow.reporting.advice import BY_PRIOR, WRONG, advice, few_traded, of_kind, size_is_assumed, spoken
from calflow.reporting.blocks import (
    Block,
    Bullets,
    Card,
    Columns,
    Divider,
    Gap,
    Heading,
    Look,
    Paragraph,
    Plot,
    RestOfPage,
    Table,
    cover,
    headed,
    in_a_line,
)
from calflow.reporting.material import Material
from calflow.reporting.section import section
from calflow.reporting.sections.acceptance import (
    FAILED,
    NO_TOLERANCE,
    PASSED,
    held_against_tolerance,
    identity,
    is_simulated,
    simulated,
    verdict_card,
)
from calflow.reporting.sections.task import answer
from calflow.reporting.style import ACCENT, DARK, LIGHT, chart, mark_floor

ASSUMED_SIZE = 1e-3  # relative error of a board's size by which its effect is told
NOISE_UNKNOWN = "its size is not known, so its share of the error is not known either"
ALL_KNOWN = "Nothing: the data determine every parameter."
FINE = "Use it for the tools, loads and places that were measured."
FINE_IN_SIMULATION = "Measure the real robot."
CAPPED = (
    "As many causes were found as were allowed. There may be more: their share of the error is left, or attributed to those "
    "found."
)
FITTED = "used for the fit (none were held out)"
DEVICE = 0.01  # share of the error from which the error as measured is said, too
LEFT_OPEN, CAUSES_LISTED = 4, 4  # open questions and causes on the first page
RARE = 0.05  # p-value below which chance is unlikely
LASTING = 1.5  # growth of the promised error within a day up to which the first page does not state it
EVEN = 0.5  # p-value above which it is not reported
CORRECTED = (
    "Corrected commands: calflow changes each target of the robot's program so that the tool reaches the programmed place. The "
    "controller keeps the maker's figures."
)
TRADES = 3  # trades on the first page
RIVALS = 2  # rivals of a finding named on the first page
WHAT_FOLLOWS = (
    "The pages before this one have the result. The following are for whoever checks, continues or repeats the calibration: the "
    "error left at each pose, the search for causes, every parameter, and how certain all of that is."
)
FOR_EXPERTS = "For experts"


@section(0, "Verdict", "identify/certainty.json")
def verdict_section(material: Material) -> list[Block]:
    """Return the verdict on one page; all errors on it are mean or largest ones of the judged poses."""
    diagnosed, unsettled = "diagnose/findings.csv" in material.results, mistake_unsettled(material)
    sure: list[Block] = [Heading("How sure is this?"), Bullets(how_sure(material), None)]
    unknown = [*unsure(material), *open_questions(material)] or [ALL_KNOWN]
    if (further := len(unknown) - LEFT_OPEN) > 1:
        unknown[LEFT_OPEN:] = [f"{further} more, on the pages for experts."]
    left_open: list[Block] = [Heading("What stays open"), Bullets(unknown, None)]
    lacking = headed("What else was found", Bullets(lacked(material), None)) if diagnosed and not unsettled else []
    cards, of_task = [*_cards(material), verdict_card(material)], answer(material.task) if material.task else None
    sentences = [*([of_task] if of_task else []), *foremost(material)]
    fine = FINE_IN_SIMULATION if is_simulated(material.request) else FINE
    lines = [identity(material.request), _measured(material), *_stages_left_out(material)]
    facts = [*simulated(material.request), *(Paragraph(line, 9) for line in lines)]
    return [
        *cover("Calibration report", material.title, facts, judgement(material), sentences, cards, bold=True),
        *([] if held_against_tolerance(material) else [Paragraph(NO_TOLERANCE, 11)]),
        *levels_of_effort(material),
        Gap(10),
        RestOfPage(
            [
                Columns([[pose_errors(material), *lacking], [*sure, *([] if unsettled else left_open)]], [1, 1]),
                Heading("What to do next, most useful first"),
            ],
            [item.sentence for item in next_steps(material, fine)],
        ),
    ]


def _cards(material: Material) -> list[Card]:
    """Return the errors before and after and, where no positions were measured, the tool's expected error."""
    steps, figures = material.judged_steps, material.errors_before_and_now
    looks: tuple[tuple[str, str, Look], ...] = (
        ("before", "maker's figures", "pale"),
        ("now", "corrected commands", "dark"),
    )
    cards = [
        Card(f"mean error {when}", mm(mean), f"largest {mm(largest)} {steps[0].unit}, {given}", look, steps[0].unit)
        for (when, given, look), (mean, _, largest) in zip(looks[: len(steps)], figures, strict=False)
    ]
    if rows := material.in_space:
        _, expected = over_ranges(rows)
        largest = f"largest {mm(expected.max_mm)} mm, over the joints' ranges"
        cards.append(Card("mean error of the tool, expected", mm(expected.mean_mm), largest))
    elif material.is_of_lengths and not material.is_of_positions:
        sd = material.certainty.prediction_sd_mm
        cards.append(Card("RMS error of the tool, expected", mm(sd), "the errors at left are of what was measured"))
    return cards


def next_steps(outcome: RunOutcome, fine: str = FINE) -> list[Advice]:
    """Return the advice, the most valuable first; preceded by `fine` where nothing is wrong with the model."""
    items = advice(outcome)
    return items if any(item.urgency <= WRONG for item in items) else [Advice(WRONG, fine), *items]


def how_sure(material: Material) -> list[tuple[str, str]]:
    """Return sentences on the source of the errors, the floor due to noise, and the coverage of the intervals."""
    certainty = material.certainty
    held_out = material.split_judged == "holdout"
    before = f" ({material.untold} more may be before a step, and are not judged)" if material.untold else ""
    of_poses = (
        f"at the {plural(len(material.largest), 'held-out pose')}{before}, which were not used for the fit"
        if held_out
        else "at the fitted poses, as none were held out; at others expect more"
    )
    floor = certainty.noise_floor
    alone = f"it alone would give a mean error of {mm(floor)} {certainty.unit}" if floor else NOISE_UNKNOWN
    many = material.judged_steps[-1].n > len(material.largest)
    each = " Means are over all points; the figure shows the worst of each pose." if many else ""
    sentences = [("Errors:", f"measured {of_poses}.{each}"), ("Noise:", f"{alone}.")]
    no_gain = f" {no_gain_words(material.no_gain, 'that were measured')}"
    if no_gain.strip() and certainty.untold and not material.is_of_positions:
        axes = f"{listed(certainty.untold)} of the measuring frame"
        no_gain += (
            f" No measurement tells where the tool is along {axes}: its error there may be any that such robots have."
        )
    beyond = material.promised.beyond_words(certainty.prediction_sd_mm) if material.is_of_lengths else ""
    where = [("Where:", where_words(certainty) + beyond + no_gain.rstrip())] if certainty.reach_m else []
    return [*where, *sentences, ("Tested:", tested_words(certainty)), *_size(material), *_when(material)]


def _size(material: Material) -> list[tuple[str, str]]:
    """Return a sentence on what an error of the board's size adds at the farthest measured place, where it counts as exact."""
    if not size_is_assumed(material):
        return []
    far = math.hypot(material.certainty.reach_m[1], max(map(abs, material.certainty.heights_m)))
    off = f"if it is {number(1e2 * ASSUMED_SIZE, '.1f')} % larger, the tool is off by up to {mm(1e3 * ASSUMED_SIZE * far)} mm more"
    return [("Size:", f"the board's counts as exact; {off}.")]


def _when(material: Material) -> list[tuple[str, str]]:
    """Return a sentence on the errors a day later, if the calibration does not promise to hold so long."""
    moments = material.certainty.expected_mm
    if not material.is_of_lengths or not moments or moments[-1] < LASTING * moments[0]:
        return []
    grows = f"from {mm(moments[0])} to {mm(moments[-1])} mm a day later"
    return [("When:", f"the promised error grows {grows}, as device or robot may change: check some poses before use.")]


def where_words(certainty: Certainty) -> str:
    """Return words on the range of distances and heights over which the errors are known."""
    near, far, low, high = (number(end, ".2f") for end in (*certainty.reach_m, *certainty.heights_m))
    heights = f"heights of {low} to {high}" if low != high else f"a height of {low}"
    return f"{near} to {far} m from axis 1, at {heights} m; nothing was tested beyond."


def _stages_left_out(material: Material) -> list[str]:
    """Return a line for each reason why stages of the workflow are without results; empty where all have them."""
    files = (*material.results.tables, *material.results.documents)
    without = [
        name for name in material.settings if name != "report" and not any(f.startswith(f"{name}/") for f in files)
    ]
    reasons = {name: material.stopped.get(name) or "not run, or outdated since" for name in without}
    each = {reason: [name for name in without if reasons[name] == reason] for reason in reasons.values()}
    return [f"without the {plural_word(names, 'stage')} {listed(names)}: {reason}" for reason, names in each.items()]


def _measured(material: Material) -> str:
    summary = material.summary
    robot, used = material.robot, material.certainty
    return in_a_line(
        robot.name,
        f"{plural(summary.training_poses, 'pose')} used for the fit, {summary.heldout_poses} held out",
        f"{plural(used.points, 'measured point')}",
        f"{'marker' if len(used.markers) == 1 else 'markers'} {listed(used.markers, 5)}",
        f"{'payload' if len(used.payloads) == 1 else 'payloads'} {listed(used.payloads, 5)}" if used.payloads else "",
    )


def pose_errors(material: Material, limits: pd.Series | None = None) -> Plot:
    """Draw the largest error [unit] of each judged pose in descending order, with tolerance and noise.

    limits: by pose, the limit below which 95 % of such errors are predicted.
    """
    from matplotlib.ticker import MaxNLocator

    unit, largest, verdict = material.certainty.unit, material.largest, held_against_tolerance(material)
    (drawn, axes), edges = chart(2.6, 3.3), np.arange(len(largest) + 1) + 0.5
    axes.stairs(
        largest, edges, fill=True, facecolor=LIGHT, edgecolor=DARK, linewidth=0.6, label="largest error of each pose"
    )
    numbers = largest.rename_axis("pose").rename(f"largest_error_{unit}").to_frame()
    if limits is not None:
        numbers[f"promised_{unit}"] = promised = limits.reindex(largest.index)
        axes.stairs(promised, edges, baseline=None, color="black", linewidth=1.2, label=f"{percent(PROMISED)} limit")
    mark_floor(axes.axhline, material.certainty.noise_floor, unit)
    if verdict:
        axes.axhline(verdict.tolerance, color=ACCENT, linewidth=1.6, label=f"tolerance: {mm(verdict.tolerance)} mm")
    axes.set(
        xlabel="pose, the worst first", ylabel=f"error now [{unit}]", xlim=(0.5, len(largest) + 0.5), ylim=(0, None)
    )
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(axis="x", visible=False)
    drawn.legend(loc="outside upper left")
    return Plot("pose_errors" if limits is None else "promised_errors", drawn, data=numbers.reset_index())


def step_name(row: Accuracy) -> str:
    """Return a model's name, or after a plus what it adds to the previous one."""
    if not row.effect:
        return "nominal robot"
    name = place_name(row.effect, row.joint or 0, row.part) if row.part else effect_words(row.effect)
    return f"+ {name}" if row.step > 1 else name


def named_steps(outcome: RunOutcome) -> list[tuple[str, Accuracy]]:
    """Return the accuracy of every model in order, with the name of a model or of the cause that it adds."""
    models = {row.model for row in outcome.results.rows("identify/accuracy.csv", Accuracy)}
    return [(effect_words(row.model) if row.model in models else step_name(row), row) for row in outcome.accuracy]


def headline(outcome: RunOutcome) -> str:
    """Return one sentence on the gain by calibration."""
    steps, ((before, _, most_before), (now, _, most_now)) = outcome.judged_steps, outcome.errors_before_and_now
    seen, unit = "that no fit has seen" if steps[0].split == "holdout" else FITTED, steps[0].unit
    if len(steps) == 1:
        return f"At poses {seen}, the nominal robot is off by {mm(before)} {unit} on average."
    verb, (whole, _, most) = "reduces" if now < before else "increases", steps[0].figures
    apart = abs(whole - before) > DEVICE * whole or abs(most - most_before) > DEVICE * most
    device = f" ({mm(whole)} {unit} as measured, with the device's own error and what has ended since)" if apart else ""
    return (
        f"At poses {seen}, calibration {verb} the error from {mm(before)} {unit}{device} to {mm(now)} {unit} "
        f"on average, and the largest from {mm(most_before)} {unit} to {mm(most_now)} {unit}."
    )


def foremost(outcome: RunOutcome) -> list[str]:
    """Return sentences on a contradicted or uneven noise and on a lack of fit, which precede any cause."""
    uneven = (series.statement for series in outcome.fit_summary.noise)
    sentences = (*(doubt.statement for doubt in outcome.noise_doubts), *uneven, outcome.lack_of_fit_words)
    return [sentence for sentence in sentences if sentence]


def lacked(outcome: RunOutcome) -> list[str | tuple[str, str]]:
    """Return a line for each cause that the model lacked, in descending order of gain, those without gain marked."""
    causes = [finding for finding in outcome.findings if finding.is_cause]
    summary = outcome.diagnosis_summary
    if not causes:
        more = outcome.unexplained or outcome.lack_of_fit_words
        tested = f"{summary.causes_tested} causes were tested"
        unseen = f" {first_up(summary.unseen)}." if summary.unseen else ""
        return [f"No cause explains what is left: {tested}.{unseen}" if more else f"No cause: {tested}.{unseen}"]
    every = list(zip(causes, labels(causes), strict=True))
    named = [pair for pair in every if not pair[0].is_suspicion]
    suspected = [name for cause, name in every if cause.is_suspicion]
    worth = [pair for pair in named if not _gains_nothing(pair[0])]
    worth.sort(key=lambda pair: -np.nan_to_num(pair[0].gain[0]))  # a gain that is not known is none
    without_gain = [name for cause, name in named if _gains_nothing(cause) and not cause.gain[2] < 0]
    losing = [f"{name} ({mm(-cause.gain[0])} {cause.error_unit})" for cause, name in named if cause.gain[2] < 0]
    items: list[str | tuple[str, str]] = [(f"{first_up(name)}:", _line(cause)) for cause, name in worth[:CAUSES_LISTED]]
    if further := worth[CAUSES_LISTED:]:
        rest = listed(list(dict.fromkeys(cause.name for cause, _ in further)), len(further))
        items.append((f"And {plural(len(further), 'more cause')}:", f"{rest}."))
    if without_gain:
        items.append(("In the model, without a gain at held-out poses:", f"{listed(without_gain, 2)}."))
    if losing:
        items.append(("In the model, with a loss at held-out poses:", f"{listed(losing, 2)}."))
    if suspected:
        items.append(("Suspected, and left out of the model:", f"{listed(suspected, 3)}."))
    if summary.capped:
        items.append(CAPPED)
    return items


def _gains_nothing(finding: Finding) -> bool:
    """Whether the step that added a cause shows no gain at held-out poses."""
    return math.isfinite(finding.gain[0]) and not finding.gain[1] > 0


def _line(finding: Finding) -> str:
    taken = f"; it takes {mm(finding.gain[0])} {finding.error_unit} off the mean error"
    return f"{finding.amount}{taken if math.isfinite(finding.gain[0]) else ''}."


def unsure(outcome: RunOutcome) -> list[str]:
    """Return sentences on the causes and structure that the data do not determine uniquely."""
    open_forms: dict[str, list[int]] = {}
    for finding in outcome.findings:
        if finding.of_family:
            open_forms.setdefault(cause_family(finding.cause), []).extend([finding.joint] if finding.joint else [])
    of_joints = {
        family: f" of {plural_word(at, 'joint')} {listed(at)}" if at else "" for family, at in open_forms.items()
    }
    sentences = [f"The exact form of the {family}{of_which}." for family, of_which in of_joints.items()]
    for finding in outcome.findings:
        if UNEXPLAINED in finding.cannot_tell_from and not finding.is_in_part:
            sentences.append(f"Whether {finding.name} is real or part of the unexplained error.")
        elif finding.status == "one_of" and finding.others:
            more = len(finding.others) - RIVALS
            others = [rival.name for rival in finding.others[: RIVALS + (more == 1)]]
            others += [f"one of {more} more"] if more > 1 else []
            if finding.is_in_part:
                sentences.append(f"Whether a part of {finding.name} is {' or '.join(others)}.")
            else:
                sentences.append(f"Which is the cause: {', '.join([finding.name, *others[:-1]])} or {others[-1]}.")
    left = outcome.unexplained
    if not left and outcome.lack_of_fit_words:
        return [*sentences, "Why more is left than noise: no cause explains it."]
    why = f"Why an error depends on {outcome.structure}: no cause is certain."
    gain = max((finding.gain[0] for finding in left if finding.gain[1] > 0), default=0.0)
    worth = f" It accounts for at least {mm(gain)} {left[0].error_unit} of the mean error." if gain else ""
    return [*sentences, why + worth] if left else sentences


def open_questions(outcome: RunOutcome) -> list[str]:
    """Return a few sentences on what the data cannot determine."""
    trades = of_kind(outcome, "trade")
    silent = [name for statement in of_kind(outcome, "silent") for name in statement.parameters]
    bound = [name for statement in of_kind(outcome, "bound") for name in statement.parameters if name not in silent]
    covered = {*silent, *bound, *(name for trade in trades for name in trade.parameters)}
    prior = [
        row.parameter
        for row in outcome.identified_parameters
        if row.prior_share > BY_PRIOR and not row.fixed and row.parameter not in covered
    ]
    sentences = [statement_words(statement) for statement in of_kind(outcome, "scale")]
    if silent:
        sentences.append(f"{first_up(spoken(silent, outcome))}: assumed, not measured.")
    sentences += _trade_sentences(trades, outcome)
    if bound:
        size = spoken(bound, outcome)
        sentences.append(f"The size of {size}: at the end of the allowed range, so no standard deviation is given.")
    if prior:
        sentences.append(f"{first_up(spoken(prior, outcome))}: no better known than before.")
    return sentences


def _trade_sentences(trades: Sequence[Statement], outcome: RunOutcome) -> Iterator[str]:
    """Yield sentences on parameters that cannot be separated, the shorter combinations by name."""
    named = few_traded(outcome)[:TRADES]
    for first, *rest in (trade.parameters for trade in named):
        yield f"{first_up(spoken([first], outcome))} cannot be separated from {spoken(rest, outcome)}."
    if further := len(trades) - len(named):
        several = f"{further} {'more ' if named else ''}{'combination' if further == 1 else 'combinations'}"
        yield f"{several} of many parameters cannot be determined. The errors above do not depend on that."


def statement_words(statement: Statement) -> str:
    """Return a statement of identifiability as a sentence."""
    words = statement.statement  # a trade's begin with a parameter's name
    return f"{words if statement.kind == 'trade' else first_up(words)}."


def levels_of_effort(material: Material) -> list[Block]:
    """Return the errors at each level of effort, which suffices, and whether each passes; nothing without figures."""
    if not material.has_figures:
        return []
    every = material.effort_levels
    unit, verdict = every[0].unit, held_against_tolerance(material)
    tolerance = verdict.tolerance if verdict and verdict.poses and not verdict.useless else None
    header = ["what the robot is given", f"mean error [{unit}]", f"largest error [{unit}]"]
    rows = [[MEANT[level.level], mm(level.mean), mm(level.max)] for level in every]
    if tolerance is not None:
        header.append(f"tolerance of {mm(tolerance)} mm")
        for row, level in zip(rows, every, strict=True):
            row.append(PASSED if level.max <= tolerance else FAILED)
    least = least_effort(every, tolerance)
    shaded = frozenset([every.index(least)] if least else [])
    words = f"{enough_words(every, least, tolerance)} {CORRECTED}"
    return [Table(header, rows, "lrrl"[: len(header)], shaded), Paragraph(words, 9)]


def enough_words(every: Sequence[EffortLevel], least: EffortLevel | None, tolerance: float | None) -> str:
    """Return words on the least level that suffices."""
    if least is None:
        return f"None of these keeps the tolerance of {mm(tolerance or 0.0)} mm."
    name = GIVEN[least.level]
    if least.level == "commands":
        return f"Nothing less than {name} {'keeps the tolerance' if tolerance else 'comes as close'}."
    if tolerance:
        return f"{first_up(name)} {'are' if least.level != 'nothing' else 'already are'} enough for the tolerance."
    gained = least.mean - every[-1].mean
    more = f"only {mm(gained)} {least.unit}" if round(gained, 3) > 0 else "nothing"
    return f"{first_up(name)} are enough: corrected commands gain {more} on average."


def tested_words(certainty: Certainty) -> str:
    """Return words on how many held-out errors are within the limits that the model predicts."""
    if not certainty.tested:
        return "not yet, as no poses were held out."
    within, tested, so_few = certainty.within, certainty.tested, certainty.within_chance
    few = (
        " That is too few: the limits are too narrow." if so_few <= SURPRISE else
        f" That is few (chance: {chance(so_few)})." if so_few < RARE else
        " That may be chance." if within < PROMISED * tested and so_few < EVEN else ""
    )  # fmt: skip
    return f"{within} of {tested} held-out errors ({percent(within / tested)}) are within their {percent(PROMISED)} limits.{few}"


@section(49, FOR_EXPERTS, "identify/accuracy.csv")
def for_experts_section(material: Material) -> list[Block]:
    """Return the divider, and why page one advises what it does, with the settings of the study."""
    steps = enumerate(next_steps(material), start=1)
    more = [(f"step {number}", item.more) for number, item in steps if item.more]
    more += [] if held_against_tolerance(material) else [("the tolerance", "tolerance_mm under [acceptance]")]
    table = Table(("page one", "why, what else, and where in the study's files"), more, "ll", wide=1)
    return [Divider(FOR_EXPERTS, WHAT_FOLLOWS), *headed("More on what page one advises", table, where=more)]
