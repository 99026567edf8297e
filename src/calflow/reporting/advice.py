"""Advice: what to do next, ranked by urgency; each rule derives it from the tables of a run."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from calflow.deployment.drift import Drift
from calflow.deployment.run_outcome import FAULTS, MORE_THAN_NOISE, RunOutcome
from calflow.deployment.usability import (
    AT_THE_DESK,
    CAUSE_RULES,
    FIT_RULES,
    WITH_MORE,
    Advice,
    Rule,
    look_for_reason,
    mistake_unsettled,
)
from calflow.deployment.validation import Validation
from calflow.design.discrimination import ENOUGH, MOST_NEXT_POSES, NextPose
from calflow.design.isolability import isolability_gaps
from calflow.diagnosis.amplitude import CERTAIN
from calflow.diagnosis.cause_tables import CandidateRow
from calflow.diagnosis.findings import RESTS
from calflow.diagnosis.misfit import MisfitRegion
from calflow.effects.base import NEEDS, Need
from calflow.effects.geometry import LINK_BOUND, Geometry
from calflow.effects.wording import UNEXPLAINED, cause_name, place_name, place_names
from calflow.estimation.certainty import PROMISED, SURPRISE, MissedPose
from calflow.estimation.identifiability import Statement
from calflow.estimation.model_tables import ModelObservation
from calflow.estimation.noise import MIN_REPEATS
from calflow.estimation.parameters import FittedParameter
from calflow.faults.base import FaultyRow
from calflow.faults.outlier import MISNAMED
from calflow.files.deferred import pd
from calflow.files.units import METRE, RADIAN
from calflow.files.words import (
    first_up,
    interval,
    listed,
    mm,
    part_words,
    percent,
    plural,
    plural_word,
    ratio,
    readable,
)
from calflow.observations import observation_kinds
from calflow.observations.base import UNKNOWN_SIZE_SD
from calflow.observations.camera import Camera
from calflow.sampling.posterior import ChainSummary
from calflow.sampling.task_points import LIKELY, TaskSummary

WRONG = 2  # urgency up to which something is wrong or missing; advice beyond it is optional
BY_PRIOR = 0.5  # prior share above which a parameter is determined by the prior
UNLIKE = 4.0  # standard deviations of a stated prior from its mean, beyond which the data contradict it
NEAR_ZERO = 0.01  # share of the range within which a bound counts as zero
LACKS = 1.5  # lack of fit, in units of the noise, above which it is reported
TOO_GOOD = 0.7  # residuals over the stated noise, below which the stated noise is doubted
WORSE = 1.5  # ratio of held-out to training mean error above which the model does not generalise
HOLDING_OUT = 0.35  # of the equations, below which they stay twice the parameters without three poses in ten
ASKED_ABOUT = 3  # means to distinguish rivals, those of the likeliest first
TOLD = 4  # faults on the first page, those with most rows first
LOAD_DRIVEN = ("rad/Nm", "m/N")  # units of parameters that only a load reveals
ISOLABILITY_TABLE = "select/isolability.csv"
GAPS_ADVISED = 3  # gaps on the first page
MOST_TRADED = 4  # parameters of a trade that are named
ENSEMBLES_AGREE = 1.01  # R-hat up to which ensembles agree
SUGGESTIVE = 0.05  # p-value below which a cause that was not accepted is worth a look
REPEATS, REACHING = 10, 4  # poses that determine the noise, and those that fill the end of a joint's range
MINUTES = 2  # per pose
AT_ONCE = 2  # steps of a session on the first page
COME_BACK = "Measure some poses again, coming back to each from elsewhere."
REMEDIES = {  # by the kind of what has moved
    "zero": "Add the shift in recalibration.csv to the joint's reading in the controller (its zero, or mastering), or subtract it "
    "from every command: the calibration then holds again.",
    "station": "If the robot's foot has moved, correct its base frame in the controller. If only the measuring device has, the "
    "calibration still holds.",
    "tool": "Straighten the tool, or add the shift in recalibration.csv to its coordinates in the controller: the calibration then "
    "holds again.",
    "dimension": "Repair what was bent or exchanged, and calibrate again.",
    "cause": "Look at the robot there, repair it, and calibrate again.",
}


def correct_the_file(outcome: RunOutcome) -> Iterator[Advice]:
    """Faults of a file are to be corrected in it once and for all; possible ones are to be checked."""
    faults = [rows for rows in faults_by_rows(outcome) if rows[0].action != "unsettled"]
    for row, *_ in faults[:TOLD]:
        yield Advice(2, f"{'Check' if row.action == 'told' else 'Correct'} the {row.where}: {row.sentences}")
    if len(faults) > TOLD:
        further = f"{plural(len(faults) - TOLD, 'further fault')}, see the section on data faults"
        yield Advice(2, f"Correct the measurement file: {further}.")


def faults_by_rows(outcome: RunOutcome) -> list[list[FaultyRow]]:
    """Return the rows of each fault, those of whole columns first, then in order of the number of rows."""
    faults: dict[tuple[str, int, str, str], list[FaultyRow]] = {}
    for row in outcome.faults:
        faults.setdefault((row.cause, row.joint, row.action, row.statement), []).append(row)
    most = sum(map(len, faults.values())) + 1
    return sorted(faults.values(), key=lambda rows: -len(rows) if all(row.line is not None for row in rows) else -most)


def not_met(outcome: RunOutcome) -> Iterator[Advice]:
    """Tolerances that some points hardly meet, and points outside the measured conditions, require action."""
    if (task := outcome.task) is None:
        return
    points, sure = f"of {task.points} points of the task are not", f"with {100 * LIKELY:.0f} % probability"
    if task.tolerance_mm is not None and task.likely_positions is not None and task.likely_positions < task.points:
        far = f"{task.points - task.likely_positions} {points} within {mm(task.tolerance_mm)} mm {sure}"
        keys = "sample/task.csv says which; [stages.select.task] chooses poses near them"
        sentence = f"{far}. Measure poses near them, under their payload."
        yield Advice(2, sentence, keys=keys, poses=MOST_NEXT_POSES)
    if task.turn_tolerance_mrad is not None and task.likely_turns is not None and task.likely_turns < task.points:
        far = f"{task.points - task.likely_turns} {points} turned within {mm(task.turn_tolerance_mrad)} mrad {sure}"
        unmeasured = "no orientation was measured. Measure some, or markers whose places on the tool are known"
        how = "poses near them help most" if task.orientation_measured else unmeasured
        yield Advice(2, f"{far}: {how}.", poses=MOST_NEXT_POSES)
    if task.beyond_measured:
        yield Advice(2, f"{strange(task)} Measure there too.", poses=MOST_NEXT_POSES)


def strange(task: TaskSummary) -> str:
    """Return a sentence on the number of points outside the measured conditions."""
    return (
        f"{task.beyond_measured} of {task.points} points of the task are unlike what was measured, in joint readings or payload: "
        "results for them are extrapolated."
    )


def starts_disagree(outcome: RunOutcome) -> Iterator[Advice]:
    """Fits from different starts should find the same optimum."""
    summary = outcome.summary
    if summary.starts_agreeing < summary.starts:
        sentence = (
            f"Only {summary.starts_agreeing} of {summary.starts} fits from different starting points came to the same result; the "
            "best is reported. Fit from more starting points and compare, and check the dimensions in the robot file."
        )
        yield Advice(2, sentence, AT_THE_DESK, "starts under [stages.identify]")


def model_lacks(outcome: RunOutcome) -> Iterator[Advice]:
    """A model with a significant lack of fit is incomplete, with a large one perhaps; known structure is told where it is found."""
    summary = outcome.fit_summary
    unexplained = any(finding.status == "unexplained" for finding in outcome.findings)
    if summary.lack_of_fit > LACKS and not summary.lacks_fit and not unexplained:
        chance = (
            f"The error left is {ratio(summary.lack_of_fit)} times the noise, which may be chance: what is known of the noise "
            "rests on few repeats."
        )
        yield Advice(2, COME_BACK, poses=REPEATS, reason=chance)
    if summary.lacks_fit and not unexplained:
        stated = "file" in summary.noise_sources
        doubt = "the noise is larger than stated" if stated else "poses repeat worse than repeats in a row show"
        yield Advice(
            2,
            f"{MORE_THAN_NOISE}: something is missing in the model, or {doubt}. See the residuals against each joint; a trend "
            "there points to the cause.",
        )


def noise_doubtful(outcome: RunOutcome) -> Iterator[Advice]:
    """Residuals cannot be much smaller than the noise."""
    if outcome.fit_summary.lack_of_fit < TOO_GOOD and not outcome.noise_doubts:
        sentence = (
            "The error left is much smaller than the stated noise: the measurements are better. Correct the stated noise, or "
            "measure repeats; the standard deviations given here are too large."
        )
        yield Advice(3, sentence, keys=f"sigma_{outcome.accuracy[0].unit}")


def noise_unknown(outcome: RunOutcome) -> Iterator[Advice]:
    """Without a noise level known independently of the fit, the model's completeness cannot be tested."""
    if not outcome.summary.noise_known:
        repeats = f"at least {-(-MIN_REPEATS // 3)} repeats in all, better {REPEATS}"
        sentence = f"{COME_BACK.removesuffix('.')}: {repeats}. Or state the measurement noise."
        why = "Without repeats or a stated noise, neither the noise nor a gap in the model can be seen."
        yield Advice(2, sentence, keys=f"sigma_{outcome.accuracy[0].unit}", poses=REPEATS, reason=why)


def nothing_held_out(outcome: RunOutcome) -> Iterator[Advice]:
    """Errors at fitted poses underestimate those at new ones."""
    if outcome.split_judged == "holdout":
        return
    keys = "split.holdout = 0.3"
    flatters = "the accuracy given here is that of the fitted poses, which flatters the model."
    if _share_taken(outcome) <= HOLDING_OUT:
        yield Advice(2, f"Hold out three poses in ten: {flatters}", AT_THE_DESK, keys)
        return
    further = "Measure further poses and hold these out: none of those measured can be spared."
    yield Advice(
        2, further, keys=keys, poses=math.ceil(0.4 * outcome.summary.training_poses), reason=first_up(flatters)
    )


def few_poses(outcome: RunOutcome) -> Iterator[Advice]:
    """Parameters determined by few poses add more to the error at new poses than the device's noise does."""
    summary, poses = outcome.fit_summary, outcome.summary.training_poses
    if summary.times_noise > 1 and not summary.lacks_fit:
        few = f"Measure further poses: {poses} are too few for what is fitted."
        expected = f"At new poses like these expect an RMS error of {summary.at_new_poses}."
        yield Advice(2, few, poses=math.ceil(poses * (2 * _share_taken(outcome) - 1)), reason=expected)


def _share_taken(outcome: RunOutcome) -> float:
    """Return the share of the equations taken by parameters, from the expected errors at new poses.

    With a share h, a held-out pose has h / (1 - h) of the noise's variance beyond the noise (Allen 1974).
    """
    squared = outcome.fit_summary.times_noise**2
    return squared / (1 + squared)


def does_not_carry_over(outcome: RunOutcome) -> Iterator[Advice]:
    """A model much worse at held-out poses than promised was fitted to too few or too similar ones, unless some were mistaken."""
    train, held = outcome.steps_on("train"), outcome.steps_on("holdout")
    mistaken = any(pose.split == "holdout" for pose in outcome.certainty.missed)  # they make the mean what it is
    if not train or not held or mistaken or outcome.certainty.within_chance > SURPRISE:
        return
    fitted, unseen, unit = train[-1].figures[0], held[-1].figures[0], held[-1].unit
    if unseen > WORSE * fitted:
        sentence = "Measure as many further poses, spread over the space where the robot works."
        why = (
            f"The error at held-out poses is {ratio(unseen / fitted)} times that at fitted ones ({mm(unseen)} {unit} "
            f"against {mm(fitted)} {unit})."
        )
        yield Advice(2, sentence, poses=outcome.summary.training_poses, reason=why)


def reaches_beyond(outcome: RunOutcome) -> Iterator[Advice]:
    """Held-out poses beyond the fitted joint ranges require extrapolation."""
    if joints := outcome.summary.extrapolation:
        which = f"{plural_word(joints, 'joint')} {listed(joints, 8)}"
        sentence = f"Measure poses for the fit that cover the whole range of {which}."
        why = f"Some held-out poses reach further in {which} than any fitted one."
        yield Advice(3, sentence, poses=REACHING * len(joints), reason=why)


def look_for_structure(outcome: RunOutcome) -> Iterator[Advice]:
    """Unexplained structure is to be investigated at the robot."""
    worst = outcome.diagnosis_summary.worst if outcome.lack_of_fit_words else None
    if worst and worst.is_of_measuring:
        yield _look_at_the_device(outcome, worst)
        return
    if not outcome.unexplained:
        if outcome.lack_of_fit_words:
            yield _look_there(outcome)
        return
    if at_rest := [finding for finding in outcome.unexplained if finding.unrepeated]:
        sides, ratios, first = NEEDS["approach"], NEEDS["gear_ratio"], at_rest[0]
        asked = {row.asked for row in outcome.candidates}
        unknown = [need for name, need in (("approach", sides), ("gear_ratio", ratios)) if (name,) in asked]
        do = f"Note {sides.plain}" if sides in unknown else "Look at its gear and its brake"
        waves = f" State {ratios.plain}: waves of the motor's turns can then be found." if ratios in unknown else ""
        sentence = f"{first_up(first.unrepeated)} {RESTS}: by {first.detail}. {do}, or approach every "
        keys = "; ".join(need.words for need in unknown)
        yield Advice(2, f"{sentence}pose from the same side.{waves}", keys=keys)
        return
    left = outcome.unexplained
    suspects = next((finding.suspects for finding in left if finding.suspects), "")
    of_it = "" if len(left) == 1 else " as a part of it"
    may_be = f"Suspected{of_it}: {suspects}; these poses do not show it clearly"
    why = may_be if suspects else f"Nothing that was tested explains it{_nearest(outcome)}"
    sentence = (
        f"An error remains that depends on {outcome.structure}. {why}. Before you measure again, look for what changes with it: "
        "hoses and cables, loose bolts, collisions, and what holds the instrument or is touched."
    )
    yield Advice(2, sentence)


def _look_at_the_device(outcome: RunOutcome, worst: MisfitRegion) -> Advice:
    """Return the advice on a lack of fit of one of several devices or sessions, to which the robot is the same."""
    sentence = (
        f"More is left than noise, {worst.words}. State the noise of each, or measure some poses there several times."
    )
    why = "The robot is the same for all: the noise there is larger than stated, or the device or its set-up errs."
    return Advice(2, sentence, keys=f"a column sigma_{outcome.accuracy[0].unit}", poses=REPEATS, reason=why)


def _look_there(outcome: RunOutcome) -> Advice:
    """Return the advice on a lack of fit that depends on no input."""
    worst = outcome.diagnosis_summary.worst
    where = f"where {worst.where}" if worst else "at the poses with the largest errors"
    # A single marker that errs moves neither robot nor tool, and no cause is of its scatter.
    loose = worst and worst.input == "marker"
    look = f"Look whether marker {worst.value} sits firmly and is clean. " if worst and loose else ""
    sentence = f"{look}Measure again {where}, coming back to some poses from elsewhere."
    why = (
        f"More is left than noise, and nothing that was tested explains it{_nearest(outcome)}. What repeats is the robot's; what "
        "does not is the measurement's or the set-up's."
    )
    return Advice(2, sentence, keys="" if worst else "diagnose/residuals.csv has the errors", poses=REPEATS, reason=why)


def _nearest(outcome: RunOutcome) -> str:
    """Return which significant candidate is most probable, in words; empty where there is none.

    Empty also where a cause was found: the candidates were screened before, when what it explains made others significant too.
    """
    found = any(finding.is_cause for finding in outcome.findings)
    near = [row for row in outcome.candidates if row.p_family < SUGGESTIVE and not found]
    nearest = min(near, key=lambda row: row.delta_bic, default=None)
    return f" for certain ({place_name(nearest.cause, nearest.joint, nearest.part)} comes nearest)" if nearest else ""


def untested(outcome: RunOutcome) -> Iterator[Advice]:
    """Where something stays unexplained, provide what tests its likeliest cause, or costs least.

    Likeliest is a curve of what the error depends on; what changes apart from the angles hardly explains an error by angles.
    Also the direction of approach, which costs nothing to record: only that reveals backlash. What depends on angles
    alone is not backlash, which differs by direction.
    """
    rows = [row for row in outcome.candidates if row.lacking]
    names = untestable(rows)
    needs = {row.lacking: [NEEDS[need] for need in row.asked] for row in rows}
    rivals = {
        row.rival for row in outcome.separations if row.chance_after < ENOUGH
    }  # `other_means` asks for what tests these
    asked = {row.lacking for row in rows if row.cause in rivals}
    worth = [lacking for lacking in names if needs[lacking] and lacking not in asked]
    if not worth or not (outcome.unexplained or outcome.lack_of_fit_words):
        return
    sides, left = [NEEDS["approach"]], outcome.unexplained
    of_angles = bool(left) and all(finding.of_angles for finding in left)
    if of_angles:
        worth = [lacking for lacking in worth if needs[lacking] != sides]
    by_sides = [lacking for lacking in worth if needs[lacking] == sides]
    likely = {row.lacking for row in rows if any(finding.may_be_curve(row.cause) for finding in left)}
    costs = list(NEEDS.values())

    def rank(lacking: str) -> tuple[bool, bool, int]:
        asked = needs[lacking]
        return lacking not in likely, of_angles and any(need.recorded for need in asked), max(map(costs.index, asked))

    first = sorted(worth, key=rank)[:1]
    yield from (_test_too(lacking, needs[lacking], names[lacking]) for lacking in dict.fromkeys((*by_sides, *first)))


def _test_too(lacking: str, needs: Sequence[Need], names: Sequence[str]) -> Advice:
    """Return advice to provide what causes need for a test: to record it at the robot, or to state it."""
    noted = any(need.recorded for need in needs)
    causes = names if len(names) < 4 else [*names[:2], f"{len(names) - 2} more causes"]
    sentence = f"{'Note' if noted else 'State'} {listed([need.plain for need in needs])}: {listed(causes)} could be tested too."
    return Advice(3, sentence, WITH_MORE, lacking, 0 if noted else None)


def untestable(rows: Sequence[CandidateRow]) -> dict[str, list[str]]:
    """Return the causes that could not be tested, by what the test needs; nothing: parameters imitate them."""
    places: dict[tuple[str, str], list[tuple[int | None, str]]] = {}
    for row in rows:
        if row.imitated or row.lacking:
            places.setdefault((row.lacking, row.cause), []).append((row.joint, row.part))
    groups: dict[str, list[str]] = {}
    for (lacking, cause), rows_of in places.items():
        groups.setdefault(lacking, []).append(place_names(cause, rows_of))
    return groups


def advised_poses(outcome: RunOutcome) -> Iterator[Advice]:
    """Poses that distinguish a cause from its rival are to be measured."""
    plans: dict[tuple[object, ...], list[NextPose]] = {}
    for pose in outcome.next_poses:
        plans.setdefault((pose.cause, pose.joint, pose.rival_causes, pose.rival_joints), []).append(pose)
    for poses in plans.values():
        first = poses[0]
        name, others = cause_name(first.cause, first.joint), cause_names(first.rival_causes, first.rival_joints)
        open_pairs = zip(
            cause_names(first.open_causes, first.open_joints),
            cause_names(first.open_other_causes, first.open_other_joints),
            strict=True,
        )
        pairs = [" from ".join(pair) for pair in open_pairs]
        left_open = f" They do not distinguish {listed(pairs, 1)}." if pairs else ""
        sentence = (
            f"Measure the {plural(len(poses), 'pose')} of diagnose/next_poses.csv that distinguish {name} from {listed(others, 2)}."
            f"{left_open}"
        )
        yield Advice(3, sentence, poses=len(outcome.next_poses))


def other_means(outcome: RunOutcome) -> Iterator[Advice]:
    """Where no poses distinguish a cause from its rival, other means are needed."""
    open_ = {(finding.cause, finding.joint) for finding in outcome.findings if finding.status == "one_of"}
    rivals: dict[tuple[str, str], list[str]] = {}
    for row in outcome.separations:
        if row.chance_after < ENOUGH and row.rival != UNEXPLAINED and (row.cause, row.joint) in open_:
            name = cause_name(row.cause, row.joint)
            rivals.setdefault((name, row.means), []).append(cause_name(row.rival, row.rival_joint))
    for (own, what), names in list(rivals.items())[:ASKED_ABOUT]:
        yield Advice(3, f"Which is it: {own} or {listed(names, 2)}? {first_up(what)}.", poses=0)
    if further := sum(len(names) for names in list(rivals.values())[ASKED_ABOUT:]):
        left = f"{plural(further, 'further rival')} left: diagnose/separations.csv has what distinguishes each."
        yield Advice(3, left, poses=0)


def cause_names(causes: tuple[str, ...], joints: tuple[int, ...]) -> list[str]:
    return [cause_name(cause, joint) for cause, joint in zip(causes, joints, strict=True)]


def flagged_rows(outcome: RunOutcome) -> Iterator[Advice]:
    """Poses with errors far beyond the predicted limits, and outlying rows, are to be checked; a wrong name explains some."""
    rows = flags(outcome)
    named = [finding for finding in outcome.findings if finding.cause == MISNAMED]
    for finding in named:
        yield Advice(2, f"Check the measurement file: {finding.statement}.", AT_THE_DESK)
    known = [line for finding in named for line in finding.rows]
    missed = [pose for pose in outcome.certainty.missed if pose.line not in known]
    if missed:
        yield _look_at(missed, outcome.certainty.unit)
    known += [pose.line for pose in missed]
    if lines := [line for line in rows.loc[rows["flagged"].astype(bool), "line"] if line not in known]:
        sentence = (
            f"Check {plural(len(lines), 'row')} of the measurement file ({plural_word(lines, 'line')} {listed(lines, 12)}), "
            "out of line with the others. Measure again, or leave out what is a mistake."
        )
        yield Advice(2, sentence, AT_THE_DESK)


def _look_at(missed: Sequence[MissedPose], unit: str) -> Advice:
    """Return the advice on poses with errors [unit] far beyond the predicted limits: by how much, and what to do."""
    by_line = sorted(missed, key=lambda pose: pose.line)
    names, lines = [pose.pose for pose in by_line], [pose.line for pose in by_line]
    where = f"{plural_word(lines, 'line')} {listed(lines, 4)} of the file"
    which = f"{first_up(plural_word(names, 'pose'))} {listed(names, 4)} ({where})"
    off = f"{mm(missed[0].error)} {unit}, with a {percent(PROMISED)} limit of {mm(missed[0].limit)} {unit}"
    does = "is off by" if len(missed) == 1 else "are off by up to"
    again = "it" if len(missed) == 1 else "them"
    sentence = (
        f"{which} {does} {off}. Measure {again} again. If the error repeats, do not use the calibration near such poses; if "
        "not, leave the rows out."
    )
    return Advice(2, sentence, AT_THE_DESK)


def flags(outcome: RunOutcome) -> pd.DataFrame:
    """Return the residuals of the last judged model, flagged as outliers or as far beyond the predicted limits."""
    rows = outcome.residuals.table
    rows = rows if "flagged" in rows else outcome.tables["identify/residuals.csv"]
    missed = [pose.line for pose in outcome.certainty.missed]
    return rows.assign(flagged=rows["flagged"].astype(bool) | rows["line"].isin(missed))


def at_bound(outcome: RunOutcome) -> Iterator[Advice]:
    """A parameter that the data push against a bound indicates another error."""
    pushed = [row for row in outcome.fitted_parameters if row.at_bound and row.prior_share <= BY_PRIOR]
    zero = [row for row in pushed if row.lower == 0 and row.estimate < NEAR_ZERO * row.upper]
    if far := [row for row in pushed if row not in zero]:
        ranges = listed(list(dict.fromkeys(map(allowed_range, far))), 4)
        look = "the dimensions and units in the robot file, and the payload's mass"
        if all(row.effect == Geometry.id and not row.joint for row in far):
            look = "where the robot file says that base and markers are"
        pushed_far = (
            f"The data push {listed(list(map(meant, far)), 4)} to the end of the allowed range ({ranges}), and would go beyond. "
            f"Check {look}."
        )
        yield Advice(2, pushed_far, AT_THE_DESK)
    if zero:
        at_zero = (
            f"{first_up(listed(list(map(meant, zero)), 4))} came out at zero, the least allowed. Either the joint is too stiff "
            "for these data, or the masses and payload in the robot file are wrong."
        )
        yield Advice(3, at_zero, AT_THE_DESK)


def mistaken_figures(outcome: RunOutcome) -> Iterator[Advice]:
    """A figure certainly further off than a maker's is not one of this robot."""
    figures = [row for row in outcome.fitted_parameters if row.effect == Geometry.id and row.joint]
    if far := [
        f"{meant(row)} by {deviation(row)}" for row in figures if abs(row.estimate) > LINK_BOUND + CERTAIN * row.sd
    ]:
        sentence = (
            f"The robot file is further off than a maker's: {listed(far, 4)}. Check its dimensions and units; if the arm was put "
            "together so, state the calibrated figures there (export --to dh writes them)."
        )
        yield Advice(2, sentence, AT_THE_DESK)


def place_assumed(outcome: RunOutcome) -> Iterator[Advice]:
    """A marker's place that nothing measures, and that makes most of what is promised of the tool, is worth stating better."""
    promised = outcome.certainty.prediction_sd_mm if outcome.certainty.untold else math.inf
    assumed = [
        row for row in outcome.fitted_parameters
        if row.effect == Geometry.id and not row.joint and row.unit == "m" and row.prior_share > BY_PRIOR
        and 1e3 * row.sd > BY_PRIOR * promised
    ]  # fmt: skip
    if assumed:
        counts = "it counts" if len(assumed) == 1 else "they count"
        sentence = (
            f"No measurement tells {listed([*map(meant, assumed)])}, and {counts} as known to "
            f"{mm(1e3 * max(row.sd for row in assumed))} mm only. That is most of the {mm(promised)} mm to expect of the tool in "
            "the measuring frame. State it better, or the place of what it was measured from."
        )
        tables = listed([f"[parameters.{row.parameter}]" for row in assumed])
        yield Advice(2, sentence, AT_THE_DESK, f"{tables} with prior_mean_mm = 0 and prior_sd_mm")


def unlike_expected(outcome: RunOutcome) -> Iterator[Advice]:
    """What a robot file or study expects of a parameter, and the data contradict, bends whatever they hardly determine."""
    stated = [row for row in outcome.fitted_parameters if row.prior_mean]
    if far := [meant(row) for row in stated if abs(row.estimate - row.prior_mean) > UNLIKE * row.prior_sd]:
        sentence = (
            f"The data contradict what robot file or study expects of {listed(far, 4)}: the robot is unlike others of its type, or "
            "the statement is wrong. Calibrate it without that, from the maker's robot file."
        )
        yield Advice(2, sentence, AT_THE_DESK)


def deviation(row: FittedParameter) -> str:
    """Return a parameter's value with its unit."""
    factor, unit = readable(row.unit)
    return f"{mm(factor * row.estimate)} {unit}"


def size_unlike_stated(outcome: RunOutcome) -> Iterator[Advice]:
    """A board or plate whose stated size the robot's lengths contradict was not made, or not measured, as it is said to be."""
    for row in outcome.fitted_parameters:  # what was diagnosed since may explain it
        if row.of_size and row.prior_sd >= UNKNOWN_SIZE_SD and abs(row.estimate) > CERTAIN * row.sd:
            what = "The board is" if row.effect == Camera.id else "The artefact is"
            sentence = (
                f"{what} {100 * abs(row.estimate):.2g} % {'smaller' if row.estimate < 0 else 'larger'} than stated (± "
                f"{100 * row.sd:.1g} %), or all lengths of the robot are off from the maker's by that share, which is unlikely. "
                "The stated size was not used. Measure it, correct the points' coordinates, and run again: lengths are only as "
                "certain as that."
            )
            yield Advice(2, sentence, AT_THE_DESK)


def board_as_stated(outcome: RunOutcome) -> Iterator[Advice]:
    """No image shows how large a board is: where nothing is said of that, all lengths are as wrong as it is."""
    if size_is_assumed(outcome):
        sentence = (
            "The board counts as exactly as large as its points say: if it is 1 % larger, so is the robot, and no image shows "
            "that. Measure it, and state how well."
        )
        yield Advice(3, sentence, keys="print_scale_sd_um_per_m under [measurements.settings]")


def size_is_assumed(outcome: RunOutcome) -> bool:
    """Whether images alone were measured, of a board whose size counts as exact: expected errors lack that of its size."""
    known = not any(row.of_size for row in outcome.identified_parameters)
    return bool(outcome.in_space) and outcome.fit_summary.new_poses_mm is None and known


def meant(row: FittedParameter) -> str:
    """Return a parameter's meaning in words, or its name where it has none."""
    return row.meaning or row.parameter


def allowed_range(row: FittedParameter) -> str:
    factor, unit = readable(row.unit)
    return f"{interval(factor * row.lower, factor * row.upper)} {unit}".rstrip()


def second_marker(outcome: RunOutcome) -> Iterator[Advice]:
    """A correlation between an angle and the only marker is resolved by a second one, unless the tool's turn was measured.

    Of a length that moves the marker as its own place does, every further marker shows the same sum.
    """
    markers = [placed.what for placed in outcome.placement if placed.kind == "marker"]
    kinds = {row.kind for row in outcome.results.rows("identify/observations.csv", ModelObservation)}
    if len(markers) != 1 or any(RADIAN in observation_kinds()[kind].units for kind in kinds):
        return
    marker = markers[0]
    places = {row.parameter for row in outcome.identified_parameters if row.part == marker}
    own = [row for row in outcome.identified_parameters if row.effect == Geometry.id]
    turns = {row.parameter for row in own if row.unit == RADIAN.symbol}
    trades = [set(trade.parameters) for trade in few_traded(outcome)]
    angles = {name for trade in trades if places & trade for name in trade & turns}
    if angles:
        sentence = (
            f"To separate {spoken(sorted(angles), outcome, 3)} from the position of marker {marker}, measure two or three markers "
            "on the tool, far apart."
        )
        yield Advice(3, sentence, WITH_MORE, poses=MOST_NEXT_POSES)


def unseen_compliance(outcome: RunOutcome) -> Iterator[Advice]:
    """The compliance of a joint that no load turned stays undetermined."""
    compliant = {row.parameter: row.part for row in outcome.identified_parameters if row.unit in LOAD_DRIVEN}
    silent = [name for statement in of_kind(outcome, "silent") for name in statement.parameters]
    if unseen := [name for name in silent if name in compliant]:
        joints = listed([part_words(compliant[name]) for name in unseen], 8)
        sentence = f"For the compliance of {joints}, which the measured loads do not twist, apply a known side force."
        harmless = "Under the measured loads an unknown compliance does no harm."
        yield Advice(3, sentence, WITH_MORE, poses=REACHING, reason=harmless)


def of_kind(outcome: RunOutcome, kind: str) -> list[Statement]:
    return [statement for statement in outcome.statements if statement.kind == kind]


def few_traded(outcome: RunOutcome) -> list[Statement]:
    """Return the trades of so few parameters that each can be named, and separated from the others."""
    return [trade for trade in of_kind(outcome, "trade") if len(trade.parameters) <= MOST_TRADED]


def spoken(names: Sequence[str], outcome: RunOutcome, most: int = 4) -> str:
    """Return parameters in words, as in: compliance of joint 1."""
    words = {row.parameter: meant(row) for row in outcome.identified_parameters}
    return listed([words.get(name, name) for name in names], most)


def add_to_the_plan(outcome: RunOutcome) -> Iterator[Advice]:
    """Return the additions to the plan for the first page."""
    for words in isolability_gaps(outcome.tables[ISOLABILITY_TABLE])[:GAPS_ADVISED]:
        yield Advice(3, f"{first_up(words)}.")


def too_short(outcome: RunOutcome) -> Iterator[Advice]:
    """A chain that is too short is to be extended."""
    if missing := outcome.chain_summary.missing_steps:
        sentence = f"The sampling is too short: about {missing} more steps are needed."
        yield Advice(2, sentence, AT_THE_DESK, lengthen(outcome.chain_summary))


def ensembles_disagree(outcome: RunOutcome) -> Iterator[Advice]:
    """Ensembles that disagree have not explored the whole posterior."""
    apart = int((outcome.tables["sample/posterior.csv"]["rhat"] > ENSEMBLES_AGREE).sum())
    if apart and not outcome.chain_summary.missing_steps:
        sentence = f"Do not trust the sampled intervals yet: the ensembles disagree on {plural(apart, 'parameter')}. Sample longer."
        yield Advice(2, sentence, AT_THE_DESK, "max_steps under [stages.sample]")


def lengthen(summary: ChainSummary) -> str:
    """Return words on how to extend a chain that is too short."""
    longer = summary.steps + summary.missing_steps
    return f"max_steps = {longer} under [stages.sample]; it resumes where it stopped"


def too_narrow(outcome: RunOutcome) -> Iterator[Advice]:
    """Limits exceeded by significantly more held-out errors than predicted are too narrow."""
    certainty = outcome.certainty
    if certainty.within_chance <= SURPRISE:
        sentence = (
            f"Only {certainty.within} of {certainty.tested} held-out errors are within their {percent(PROMISED)} limits: the "
            "standard deviations are too small. Something varies that the model or the fitted poses lack."
        )
        yield Advice(2, sentence)


# By the table or summary that the rules depend on; its stage writes all else that they read.
RULES: Mapping[str, tuple[Rule, ...]] = {
    FAULTS: (correct_the_file,),
    "sample/task.csv": (not_met,),
    "identify/accuracy.csv": (
        *FIT_RULES,
        starts_disagree,
        model_lacks,
        noise_doubtful,
        noise_unknown,
        few_poses,
        nothing_held_out,
        does_not_carry_over,
        reaches_beyond,
    ),
    "diagnose/summary.json": (*CAUSE_RULES, look_for_reason, look_for_structure, advised_poses, other_means, untested),
    "identify/residuals.csv": (flagged_rows,),
    "identify/parameters.csv": (
        at_bound,
        mistaken_figures,
        place_assumed,
        unlike_expected,
        size_unlike_stated,
        board_as_stated,
    ),
    "identify/placement.csv": (second_marker, unseen_compliance),
    ISOLABILITY_TABLE: (add_to_the_plan,),
    "sample/summary.json": (too_short, ensembles_disagree),
    "identify/certainty.json": (too_narrow,),
}


def advice(outcome: RunOutcome) -> list[Advice]:
    """Return the advice of all rules, most urgent and least effort first; an unsettled mistake stands alone."""
    if unsettled := mistake_unsettled(outcome):
        return unsettled
    items = [
        item for path, rules in RULES.items() if path in outcome.results for rule in rules for item in rule(outcome)
    ]
    return in_one_session(sorted(items, key=lambda item: (item.urgency, item.effort, item.poses is not None)))


def in_one_session(items: list[Advice]) -> list[Advice]:
    """Return the advice with all measuring steps merged into the first of them: one session serves all purposes."""
    measured = [item for item in items if item.poses is not None]
    if not (poses := max((item.poses or 0 for item in measured), default=0)):
        return items
    first, minutes = measured[0], MINUTES * poses
    time = f"{minutes} minutes" if minutes < 120 else f"{minutes / 60:.1f} hours"
    begin = "Measure once more" if first.urgency <= WRONG else "If you measure again"
    lead = f"{begin}: about {plural(poses, 'pose')}, {time} at {MINUTES} minutes each."
    keys = "; ".join(dict.fromkeys(item.keys for item in measured if item.keys))
    told = list(dict.fromkeys(item.sentence for item in measured))[:AT_ONCE]
    further = (words for item in measured for words in (item.sentence, item.reason) if words and words not in told)
    sentence, reason = " ".join((lead, *told)), " ".join(dict.fromkeys(further))
    session = Advice(first.urgency, sentence, first.effort, keys, poses, reason)
    return [session if item is first else item for item in items if item is first or item.poses is None]


def after_validation(validation: Validation) -> str:
    """Return the advice after a validation."""
    summary, judged = validation.summary, validation.judged
    if judged.mean > validation.of("nominal").mean:
        return (
            "Find out whether these rows are of the robot, base, tool, units and signs that were calibrated. If they are, "
            "calibrate again."
        )
    if summary.status == "met":
        later = (
            ", and choose check poses (calflow check-poses) that will show whether anything moves"
            * summary.of_positions
        )
        return f"Put the robot to work{later}."
    if summary.status == "cannot be told":
        return "Measure more poses that no fit has seen, where the robot is to work, and validate with all of them."
    if summary.tolerance is None:
        option = "--tolerance-mm" if summary.unit == METRE.label else "--tolerance"
        return f"State what the robot may err by ({option}) and validate again, for a verdict that can be signed."
    if summary.judged == "figures" and validation.of("calibrated").max <= summary.tolerance:
        return "Send corrected commands (calflow compensate, calflow filter): with them these poses are within the tolerance."
    if judged.rms_low > summary.promised:
        by = " (calflow drift with these rows)" * summary.of_positions
        return f"Look for what has changed since the calibration{by}, then calibrate again."
    return "Measure more poses where the robot is to work (calflow next says which) and calibrate again with them."


def after_drift(drift: Drift) -> str:
    """Return the advice after a drift check."""
    if drift.summary.status == "in place":
        return (
            "Go on with this calibration, and measure the check poses again after the next shift, collision or repair."
        )
    if drift.summary.status == "conditions":
        return "Go on with this calibration, and state the conditions in the rows wherever it is used."
    if drift.summary.status == "cannot be seen":
        return "Choose more check poses that differ more (calflow check-poses), measure them and check again."
    if drift.next_poses and (not drift.moved or any(movement.cannot_tell_from for movement in drift.moved)):
        return (
            "Measure the poses of next_poses.csv, add them to these rows and check again, before anything is corrected."
        )
    if drift.moved:
        remedies = dict.fromkeys(REMEDIES[movement.kind] for movement in drift.moved if movement.kind in REMEDIES)
        return " ".join((*remedies, "Then measure the check poses once more."))
    return "Measure the check poses again. If they are off again, calibrate again."
