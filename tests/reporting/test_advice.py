"""What to do next: each rule speaks up on its table, and not otherwise."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import typst

from calflow.deployment import usability
from calflow.deployment.figures_alone import LEVELS, EffortLevel
from calflow.deployment.in_space import ALONE, RANGES, SpaceError
from calflow.deployment.run_outcome import RunOutcome
from calflow.deployment.usability import Advice, Rule, judgement
from calflow.design.discrimination import NextPose, SeparationRow
from calflow.design.isolability import IsolabilityCell
from calflow.diagnosis.cause_tables import CandidateRow
from calflow.diagnosis.diagnosis import DiagnosisSummary
from calflow.diagnosis.findings import Finding
from calflow.diagnosis.misfit import MisfitRegion
from calflow.effects.base import NEEDS
from calflow.effects.wording import NamedCause
from calflow.estimation.accuracy import Accuracy
from calflow.estimation.calibrated_model import SeriesNoise
from calflow.estimation.certainty import Certainty, MissedPose
from calflow.estimation.identifiability import Statement
from calflow.estimation.lack_of_fit import NoiseDoubt
from calflow.estimation.model_tables import FitSummary, IdentifySummary, ModelObservation, Placed, Solver
from calflow.estimation.noise import Source
from calflow.faults.outlier import MISNAMED
from calflow.files.tables import Results, to_document, to_frame
from calflow.observations.base import UNKNOWN_SIZE_SD
from calflow.reporting import advice as ranked
from calflow.reporting import document
from calflow.reporting.advice import RULES, advice, after_drift, after_validation
from calflow.reporting.blocks import Paragraph, RestOfPage
from calflow.reporting.sections.accuracy import leftover, new_poses_words
from calflow.reporting.sections.verdict import enough_words, foremost, headline, next_steps, open_questions
from calflow.sampling.posterior import ChainSummary
from calflow.sampling.task_points import TaskSummary
from reporting.pdf import pages_of

SUMMARY = IdentifySummary(
    noise_sources=("file",), noise=(), sigma_mm=0.05, discrepancies={"mm": 0.0}, rest_mm=0.0,
    loss="linear", reduced_chi2=1.02, lack_of_fit_p=0.5,
    solver=Solver(status="Solve_Succeeded", iterations=9), spread_mm=1e3, rank=3, parameters=3, rank_by_effect={},
    effective_parameters=3.0, training_poses=9, heldout_poses=4, converged=True, equilibrium_error_um=0.0, starts=3,
    starts_agreeing=3,
)  # fmt: skip
DOUBT = NoiseDoubt(
    series="", unit="mm", stated=40.0, shown=0.04, shown_by="residuals", believed=True, p=0.0
)  # fmt: skip
DIAGNOSED = DiagnosisSummary(
    **{field.name: getattr(SUMMARY, field.name) for field in fields(FitSummary)}, reduced_chi2_before=4.0, causes_tested=40,
    tests=30.0,
)  # fmt: skip
CHAIN = ChainSummary(
    steps=100, burn_in_steps=25, ensembles=4, walkers=8, autocorrelation_steps=2.0, acceptance_independent=0.7,
    worst_rhat=1.001, smallest_ess=5000.0, sd_over_laplace_least=0.99, sd_over_laplace_most=1.01, missing_steps=0,
)  # fmt: skip
TASK = TaskSummary(
    points=20, in_order=False, tolerance_mm=0.3, turn_tolerance_mrad=None, nominal_mm=5.0, expected_mm=0.1,
    worst_radius95_mm=0.2, worst_turn95_mrad=0.3, likely_points=20, likely_positions=20, likely_turns=None,
    orientation_measured=True, least_within=0.97, all_within=0.9, all_within_alike=0.95, beyond_measured=0,
)  # fmt: skip


def summary(stage: str = "identify", **items: object) -> dict[str, object]:
    return {f"{stage}/summary.json": to_document(replace(SUMMARY, **items))}  # type: ignore[arg-type]


def diagnosed(**items: object) -> dict[str, object]:
    return {"diagnose/summary.json": to_document(replace(DIAGNOSED, **items))}  # type: ignore[arg-type]


def chain(missing: int) -> dict[str, object]:
    return {"sample/summary.json": to_document(replace(CHAIN, missing_steps=missing))}


def work(**items: object) -> dict[str, object]:
    return {"sample/task_summary.json": to_document(replace(TASK, **items))}  # type: ignore[arg-type]


def results(given: Mapping[str, object]) -> RunOutcome:
    """Tables and documents, told apart by their names."""
    made = {ending: {path: one for path, one in given.items() if path.endswith(ending)} for ending in (".csv", ".json")}
    return RunOutcome(Results(made[".csv"], made[".json"]))  # type: ignore[arg-type]


def accuracies(train: float = 0.05, holdout: float | None = 0.06) -> pd.DataFrame:
    rows = []
    for split, n, mean in (("train", 9, train), ("holdout", 4, holdout)):
        if mean is not None:
            rows += [
                Accuracy(model="nominal", split=split, n=n, mean_mm=5.0, rms_mm=6.0, max_mm=9.0, step=0),
                Accuracy(model="geometry", split=split, n=n, mean_mm=mean, rms_mm=mean, max_mm=2 * mean, step=1, effect="geometry"),
            ]  # fmt: skip
    return to_frame(rows, Accuracy)


def parameter_table(**changed: object) -> pd.DataFrame:
    row = {"parameter": "joint2.a", "effect": "geometry", "variant": float("nan"), "part": "joint2", "symbol": "a",
           "joint": 2, "unit": "m", "nominal": 0.0, "estimate": 0.02, "sd": 1e-5,
           "lower": -0.02, "upper": 0.02, "prior_mean": 0.0, "prior_sd": 0.01, "at_bound": False, "fixed": False,
           "prior_share": 0.01, "figure": 0.0, "calibrated": 0.02, "meaning": "", "of_size": False}  # fmt: skip
    return pd.DataFrame([row | changed])


def statements(*rows: tuple[str, str]) -> pd.DataFrame:
    split = [(kind, tuple(names.split(";"))) for kind, names in rows]
    said = [Statement(kind=kind, parameters=names, statement="", weights=(1.0,) * len(names)) for kind, names in split]  # type: ignore[arg-type]
    return to_frame(said, Statement)


def of_parts(**parts: str) -> pd.DataFrame:
    """Parameters, by their part."""
    return pd.concat([parameter_table(parameter=name.replace("_", "."), part=part) for name, part in parts.items()])


TURN_AND_PLACE = pd.concat(
    [
        parameter_table(parameter="joint6.theta", part="joint6", unit="rad"),
        parameter_table(parameter="joint2.phi3x", effect="gravity-deflection", part="joint2", unit="rad"),
        of_parts(E_x="E", **{f"joint{k}_d": f"joint{k}" for k in range(1, 6)}),
    ]
)  # what one marker cannot tell apart, and what has no place of its own


def placement(*markers: str) -> pd.DataFrame:
    kinds = {"base": "base"} | dict.fromkeys(markers, "marker")
    place = dict.fromkeys(("x_m", "y_m", "z_m", "rx_deg", "ry_deg", "rz_deg", "rx_rad", "ry_rad", "rz_rad"), 0.0)
    return to_frame([Placed(what=what, kind=kind, source="", **place) for what, kind in kinds.items()], Placed)


def promised(
    within: int,
    chance: float,
    tested: int = 60,
    missed: tuple[MissedPose, ...] = (),
    no_gain: float = 0.0,
    sd_mm: float = 0.03,
) -> dict[str, object]:
    """How many held-out errors are below what is promised of them, and how probable so few are."""
    sure = Certainty(points=99, markers=("E",), payloads=(), split="holdout", unit="mm", left=0.06, noise="", noise_floor=0.05,
                     model_sd_mm=0.02, prediction_sd_mm=sd_mm, untold=("z",), rivals=False, tested=tested, within=within,
                     within_chance=chance, missed=missed, no_gain=no_gain)  # fmt: skip
    return {"identify/certainty.json": to_document(sure)}


MISSED = tuple(MissedPose(pose=f"P{k}", line=k, split="holdout", error=8.0 / k, limit=0.1) for k in (1, 2))


MISLABELLED = Finding(status="data_fault", cause=MISNAMED, rows=(1, 2), statement="lines 1 and 2 fit payload 'full'")


def faulty(*lines: int) -> pd.DataFrame:
    said = f"lines {', '.join(map(str, lines))} are far off"
    where = {
        "where": "measurement file",
        "pose": "",
        "row": 1,
        "quantity": "",
        "factor": 1.0,
        "offset": 0.0,
        "source": 0,
    }
    return pd.DataFrame(
        {"cause": "outlier", "joint": 0, "line": list(lines), "action": "left out", "statement": said} | where
    )


def found(*statuses: str) -> pd.DataFrame:
    """Findings: backlash of joint 2, or what its angle explains and no cause does."""
    rivals = Finding.of_rivals([NamedCause("joint-hysteresis", 2)])
    rows = [
        Finding(status="unexplained", statement="", inputs=("q2",))
        if status == "unexplained"
        else Finding(status=status, cause="joint-backlash", joint=2, statement="", **rivals)  # type: ignore[arg-type]
        for status in statuses
    ]  # fmt: skip
    return to_frame(rows, Finding)


SUSPECTED = Finding(
    status="unexplained", statement="", inputs=("q2",), **Finding.of_rivals([NamedCause("gear-ratio-error", 2)])
)
MISFIT = Finding(status="unexplained", statement="")
CAUSE = Finding(status="named", cause="joint-backlash", joint=2, statement="")
OF_A_DAY = MisfitRegion(input="session", value="tue", error_unit="mm", there=0.3, elsewhere=0.1)
EXCHANGED = Finding(status="named", cause="payload-step", detail="after row 64 in measuring order", statement="")
NEAR = to_frame([CandidateRow(cause="link-mass", joint=3, p_family=0.02, delta_bic=-9.0)], CandidateRow)
UNREPEATED = Finding(status="unexplained", statement="", inputs=("pose", "q3", "q2"), detail="0.1 mrad")


def candidates(*asked: str) -> pd.DataFrame:
    rows = [CandidateRow(cause="thermal-growth", lacking=NEEDS[need].words, asked=(need,)) for need in asked]
    return to_frame([CandidateRow(cause="thermal-growth"), *rows], CandidateRow)


def separations(chance: float, means: str = "") -> pd.DataFrame:
    row = SeparationRow(cause="joint-backlash", joint=2, rival="joint-hysteresis", rival_joint=2, separation_before_sd=1.0,
                        separation_after_sd=6.5, chance_after=chance, words="what to do", means=means)  # fmt: skip
    return to_frame([row], SeparationRow)


def poses(number: int, *left_open: tuple[tuple[str, int], tuple[str, int]]) -> pd.DataFrame:
    first, second = [one for one, _ in left_open], [other for _, other in left_open]
    row = NextPose(
        pose=1, readings={}, approach={}, payload="", tells="joint-backlash 2", rivals=("joint-hysteresis 2",), leaves_open="",
        separation_before_sd=1.2, separation_after_sd=6.5, chance_after=0.99, cause="joint-backlash", joint=2,
        rival_causes=("joint-hysteresis",), rival_joints=(2,), open_causes=tuple(cause for cause, _ in first),
        open_joints=tuple(joint for _, joint in first), open_other_causes=tuple(cause for cause, _ in second),
        open_other_joints=tuple(joint for _, joint in second),
    )  # fmt: skip
    return to_frame([row] * number, NextPose)


def lost(*by_pose: float) -> dict[str, object]:
    """Residuals of which each held-out pose lost so much by the causes [mm]; each has two rows."""
    poses = np.repeat(np.arange(len(by_pose)), 2)
    return {
        f"{stage}/residuals.csv": pd.DataFrame(
            {"pose": poses, "split": "holdout", "error": 0.06 + more, "unit": "mm", "line": poses, "flagged": False}
        )
        for stage, more in (("identify", 0.0), ("diagnose", np.repeat(by_pose, 2)))
    }


def planned(words: str = "") -> pd.DataFrame:
    """What a plan tells apart: a cause that is seen, or a gap that something fills."""
    cell = IsolabilityCell(
        cause="joint-backlash", joint=1, part="joint1", size=1e-4, unit="rad", rival="", rival_joint=None, rival_part="",
        chance=0.2 if words else 1.0, enough=not words, needs="", worst=bool(words), addition="a thermometer" if words else "",
        chance_then=0.95 if words else None, words=words,
    )  # fmt: skip
    return to_frame([cell], IsolabilityCell)


def observed(kind: str) -> pd.DataFrame:
    """What was measured, of one series of a kind."""
    return to_frame([ModelObservation(kind=kind, observation="{}")], ModelObservation)


QUIET: dict[str, object] = {
    "select/isolability.csv": planned(),
    **summary(),
    "identify/accuracy.csv": accuracies(),
    "identify/faults.csv": faulty(),
    "identify/residuals.csv": pd.DataFrame({"line": [2, 3, 4], "flagged": [False, False, False]}),
    "identify/parameters.csv": parameter_table(),
    "identify/identifiability.csv": statements(),
    "identify/placement.csv": placement("E"),
    "identify/observations.csv": observed("position"),
    "diagnose/findings.csv": found(),
    "diagnose/candidates.csv": candidates("warmth"),
    "diagnose/separations.csv": separations(0.99).iloc[:0],
    "diagnose/next_poses.csv": poses(0),
    "sample/posterior.csv": pd.DataFrame({"parameter": ["joint2.a", "E.x"], "rhat": [1.001, 1.009]}),
    **chain(0),
    **promised(57, 0.65),
    **work(),
}


def in_space(promised: float, off: float, better: float) -> pd.DataFrame:
    """What a study by cameras promises over the joints' ranges, and the robot as its maker says is off [mm]."""
    figures = {ALONE: off, "geometry": promised}
    return to_frame(
        [SpaceError(model=name, where=where, n=9, mean_mm=mm, rms_mm=1.1 * mm, max_mm=2 * mm,
                    better=better if (name, where) == ("geometry", RANGES) else float("nan"))
         for name, mm in figures.items() for where in ("train", RANGES)], SpaceError,
    )  # fmt: skip


SPEAKS: list[tuple[Rule, Mapping[str, object], int, str]] = [
    (usability.nominal_far_off, summary(spread_mm=40.0), 1, "swapped axes"),
    (usability.not_converged, summary(converged=False, solver=Solver(status="Max_Iter", iterations=500)), 1, "Max_Iter"),
    (usability.not_converged, diagnosed(converged=False, solver=Solver(status="Max_Iter", iterations=500)), 1,
     "the model that diagnose extended: its fit did not converge (IPOPT: Max_Iter"),
    (ranked.starts_disagree, summary(starts_agreeing=1), 2, "Only 1 of 3"),
    (ranked.model_lacks, summary(reduced_chi2=9.0), 2, "is 3.0 times the noise, which may be chance"),
    (ranked.model_lacks, summary(reduced_chi2=9.0, lack_of_fit_p=1e-9), 2, "larger than measurement noise explains"),
    (ranked.model_lacks, summary(reduced_chi2=1.5, lack_of_fit_p=1e-6), 2, "something is missing in the model"),
    (ranked.noise_doubtful, summary(reduced_chi2=0.25), 3, "much smaller than the stated noise"),
    (usability.noise_contradicted, summary(noise_doubts=(DOUBT,)), 1, "Do not use this result. The stated noise, 40 mm"),
    (usability.noise_contradicted, summary(noise_doubts=(replace(DOUBT, believed=False),)), 2, "1,000 times too large"),
    (ranked.noise_unknown, summary(noise_sources=("estimated",)), 2, "Measure some poses again"),
    (ranked.nothing_held_out, {"identify/accuracy.csv": accuracies(holdout=None)}, 2, "split.holdout = 0.3"),
    (ranked.nothing_held_out, {"identify/accuracy.csv": accuracies(holdout=None), **summary(new_poses_mm=0.1)}, 2,
     "Measure further poses and hold these out"),
    (ranked.few_poses, summary(new_poses_mm=0.26), 2, "9 are too few for what is fitted"),
    (ranked.does_not_carry_over, {"identify/accuracy.csv": accuracies(holdout=0.2), **promised(45, 1e-8)}, 2, "4.0 times"),
    (ranked.reaches_beyond, summary(extrapolation=(2,)), 3, "whole range of joint 2"),
    (usability.no_better_in_space, {"identify/in_space.csv": in_space(0.8, 0.3, 0.4)}, 1,
     "it is expected to err by 0.800 mm on average, and the maker's robot is 0.300 mm from it"),
    (usability.no_better_in_space, {"identify/in_space.csv": in_space(0.2, 0.3, 0.4)}, 1, "nearer: 0.40"),
    (usability.no_better_in_space, {"identify/in_space.csv": in_space(0.2, 0.3, 0.9)}, 2, "nearer: 0.90"),
    (ranked.correct_the_file, {"identify/faults.csv": faulty(9, 12)}, 2, "lines 9, 12 are far off"),
    (ranked.flagged_rows, {"identify/residuals.csv": pd.DataFrame({"line": [2, 9], "flagged": [False, True]})}, 2, "line 9"),
    (ranked.flagged_rows, promised(57, 0.65, missed=MISSED), 2,
     "Poses P1 and P2 (lines 1 and 2 of the file) are off by up to 8.00 mm"),
    (ranked.flagged_rows,
     {**promised(57, 0.65, missed=MISSED), "diagnose/findings.csv": to_frame([MISLABELLED], Finding)}, 2,
     "Check the measurement file: lines 1 and 2 fit payload 'full'"),
    (ranked.at_bound, {"identify/parameters.csv": parameter_table(at_bound=True)}, 2, "joint2.a"),
    (ranked.at_bound, {"identify/parameters.csv": parameter_table(at_bound=True, parameter="tool.z", part="tool", joint=0)}, 2,
     "would go beyond. Check where the robot file says that base and markers are."),
    (ranked.at_bound,
     {"identify/parameters.csv": parameter_table(at_bound=True, parameter="joint3.s", unit="rad/Nm", lower=0.0, upper=1e-6,
                                                 estimate=1e-10)}, 3, "Joint3.s came out at zero"),
    (ranked.mistaken_figures, {"identify/parameters.csv": parameter_table(estimate=-0.031)}, 2, "joint2.a by -31.00 mm"),
    (ranked.place_assumed,
     {**promised(57, 0.65, sd_mm=25.0),
      "identify/parameters.csv": parameter_table(prior_share=0.99, sd=0.02, joint=float("nan"), meaning="z of marker E")},
     2, "No measurement tells z of marker E, and it counts as known to 20.00 mm only. That is most of the 25.00 mm to expect"),
    (ranked.place_assumed,
     {**promised(57, 0.65, sd_mm=25.0),
      "identify/parameters.csv": pd.concat(
          parameter_table(prior_share=0.99, sd=0.02, joint=float("nan"), meaning=f"{axis} of marker E") for axis in "xyz")},
     2, "No measurement tells x of marker E, y of marker E and z of marker E, and they count as known to 20.00 mm only."),
    (ranked.unlike_expected,
     {"identify/parameters.csv": parameter_table(estimate=2e-3, prior_mean=3e-4, prior_sd=2e-4, meaning="zero of joint 4")}, 2,
     "contradict what robot file or study expects of zero of joint 4"),
    (ranked.size_unlike_stated,
     {"identify/parameters.csv": parameter_table(parameter="target.scale", effect="camera", of_size=True, estimate=-0.0197,
                                                 sd=0.0032, prior_sd=UNKNOWN_SIZE_SD)}, 2,
     "The board is 2 % smaller than stated (± 0.3 %)"),
    (ranked.board_as_stated, {"identify/in_space.csv": in_space(0.2, 0.3, 0.4)}, 3, "and no image shows that. Measure it"),
    (ranked.second_marker, {"identify/identifiability.csv": statements(("trade", "joint6.theta;E.x")),
      "identify/parameters.csv": TURN_AND_PLACE}, 3, "joint6.theta from"),
    (ranked.unseen_compliance,
     {"identify/identifiability.csv": statements(("silent", "joint1.s")),
      "identify/parameters.csv": parameter_table(parameter="joint1.s", part="joint1", joint=1, unit="rad/Nm")}, 3, "joint 1"),
    (usability.look_for_reason, {"diagnose/findings.csv": to_frame([EXCHANGED], Finding)}, 2,
     "Find the reason: unstated change of payload mass (after row 64 in measuring order). The calibration allows for it; if it "
     "changes or happens again, later measurements are off. To be sure, weigh the payload"),
    (usability.makes_it_worse, {"diagnose/accuracy.csv": accuracies(holdout=0.08), **lost(0.1, -0.06)}, 1,
     "0.080 mm against 0.060 mm"),
    (usability.makes_it_worse, {"diagnose/accuracy.csv": accuracies(holdout=0.07), **lost(0.01, 0.011, 0.009)}, 2,
     "a little worse"),
    (usability.makes_it_worse, {"diagnose/accuracy.csv": accuracies(holdout=0.07), **lost(0.1, -0.05, -0.02)}, 2, "by chance"),
    (ranked.look_for_structure, {"diagnose/findings.csv": found("unexplained")}, 2,
     "depends on the angle of joint 2. Nothing that was tested explains it. Before"),
    (ranked.look_for_structure, {"diagnose/findings.csv": found("unexplained"), "diagnose/candidates.csv": NEAR}, 2,
     "Nothing that was tested explains it for certain (mass error of link 3 comes nearest). Before"),
    (ranked.look_for_structure, {**diagnosed(), "diagnose/findings.csv": to_frame([MISFIT, CAUSE], Finding),
                                 "diagnose/candidates.csv": NEAR}, 2, "nothing that was tested explains it. What"),
    (ranked.look_for_structure, {"diagnose/findings.csv": to_frame([SUSPECTED], Finding)}, 2,
     "Suspected: transmission error of joint 2; these poses do not show it clearly. Before"),
    (ranked.look_for_structure, {**diagnosed(), "diagnose/findings.csv": to_frame([MISFIT], Finding),
                                 "diagnose/candidates.csv": NEAR}, 2,
     "nothing that was tested explains it for certain (mass error of link 3 comes nearest)"),
    (ranked.look_for_structure, {**diagnosed(worst=OF_A_DAY), "identify/accuracy.csv": accuracies(), "diagnose/findings.csv":
        to_frame([MISFIT, UNREPEATED], Finding)}, 2,
     "largest where the session is tue: 0.3 mm against 0.1 mm elsewhere. State the noise"),
    (ranked.look_for_structure, {**diagnosed(worst=replace(OF_A_DAY, input="marker", value="B")),
                                 "diagnose/findings.csv": to_frame([MISFIT], Finding)}, 2,
     "whether marker B sits firmly"),
    (ranked.look_for_structure, {"diagnose/findings.csv": to_frame([UNREPEATED], Finding), "diagnose/candidates.csv":
        candidates("approach")}, 2, "too short for these poses: by 0.1 mrad. Note the side"),
    (ranked.look_for_structure, {"diagnose/findings.csv": to_frame([UNREPEATED], Finding)}, 2, "Look at its gear"),
    (ranked.look_for_structure, {"diagnose/findings.csv": to_frame([UNREPEATED], Finding), "diagnose/candidates.csv":
        candidates("gear_ratio")}, 2, "Look at its gear and its brake, or approach every pose from the same side. State"),
    (ranked.advised_poses, {"diagnose/next_poses.csv": poses(3)}, 3,
     "the 3 poses of diagnose/next_poses.csv that distinguish backlash"),
    (ranked.advised_poses, {"diagnose/next_poses.csv": poses(3, (("joint-hysteresis", 2), ("link-mass", 3)))}, 3,
     "do not distinguish hysteresis of joint 2 from mass error of link 3"),
    (ranked.other_means, {"diagnose/findings.csv": found("one_of"), "diagnose/separations.csv": separations(
        0.0, "log each joint's travel")}, 3,
     "Which is it: backlash of joint 2 or hysteresis of joint 2? Log each"),
    (ranked.untested, {"diagnose/findings.csv": found("unexplained")}, 3, "Note the time of each reading, or the temperature as"),
    (ranked.too_short, chain(90), 2, "about 90 more steps"),
    (ranked.ensembles_disagree, {"sample/posterior.csv": pd.DataFrame({"parameter": ["a", "b"], "rhat": [1.2, 1.0]})}, 2,
     "disagree on 1 parameter"),
    (ranked.add_to_the_plan, {"select/isolability.csv": planned("play is seen in 20 of 100; with more in 95")}, 3,
     "Play is seen in 20 of 100; with more in 95."),
    (ranked.not_met, work(likely_points=17, likely_positions=17), 2,
     "3 of 20 points of the task are not within 0.300 mm with 95 % probability"),
    (ranked.not_met, work(turn_tolerance_mrad=0.5, likely_turns=12, orientation_measured=False), 2,
     "8 of 20 points of the task are not turned within 0.500 mrad with 95 % probability: no orientation was measured"),
    (ranked.too_narrow, promised(45, 1e-8), 2, "Only 45 of 60"),
]  # fmt: skip


@pytest.mark.parametrize(("rule", "tables", "urgency", "words"), SPEAKS)
def test_rule_speaks_on_its_table(rule: Rule, tables: Mapping[str, object], urgency: int, words: str) -> None:
    found = list(rule(results({**QUIET, **tables})))
    assert [item.urgency for item in found] == [urgency]
    assert words in found[0].whole
    assert found[0].sentence.endswith(".")


@pytest.mark.parametrize("rule", [rule for rules in RULES.values() for rule in rules])
def test_rule_is_silent_where_all_is_well(rule: Rule) -> None:
    assert not list(rule(results({**QUIET, **diagnosed()})))


def test_few_poses_are_not_as_good_as_the_device() -> None:
    """Fails if what is left at fitted poses decides, though few poses leave new ones to be missed by much more."""
    assert judgement(results({**QUIET, **summary(new_poses_mm=0.08)})) == "Calibrated: only measurement noise is left."
    few = judgement(results({**QUIET, **summary(new_poses_mm=0.356)}))
    assert few == "Calibrated with few poses: at new ones expect an RMS error of 0.356 mm."
    limited = judgement(results({**QUIET, **summary(new_poses_mm=0.356, new_poses_limit_mm=0.613)}))
    assert limited == (
        "Calibrated with few poses: at new ones expect an RMS error of 0.356 mm (with 95 % certainty at most 0.613 mm)."
    )
    unknown = judgement(results({**QUIET, **summary(new_poses_mm=0.356, noise_sources=("estimated",))}))
    assert unknown == f"{few[:-1]}, in addition to what the fit leaves."


def test_a_verdict_of_noise_alone_stands_beside_no_doubt_of_new_poses() -> None:
    """Fails if page one says that noise alone is left above the advice to measure more, as new poses are missed by more."""
    worse = accuracies(holdout=0.2)
    for kept in (promised(57, 0.65), promised(45, 1e-8)):
        outcome = results({**QUIET, **summary(), "identify/accuracy.csv": worse, **kept})
        doubted = [*ranked.does_not_carry_over(outcome), *ranked.too_narrow(outcome)]
        assert bool(doubted) == ("only measurement noise" not in judgement(outcome))


def test_a_reader_is_not_told_that_nothing_matters_beside_what_was_found() -> None:
    """Fails if use is the first step beside a payload exchanged unnoticed, or a test of it is asked for twice."""
    rivalled = replace(
        EXCHANGED, status="one_of", **Finding.of_rivals([NamedCause("joint-step", 2), NamedCause("tool-slip", 0)])
    )
    for finding, name in ((EXCHANGED, "order)."), (replace(rivalled, probability=0.3), "order) or one of 2 others.")):
        first = next_steps(results({**QUIET, **diagnosed(), "diagnose/findings.csv": to_frame([finding], Finding)}))[0]
        assert first.sentence.startswith("Find the reason: unstated change of payload mass (after row 64 in measuring ")
        assert name in first.sentence
        assert ("To be sure" in first.sentence) == (finding is EXCHANGED)
    assert next_steps(results(QUIET))[0].sentence == "Use it for the tools, loads and places that were measured."


@pytest.mark.parametrize(
    ("cause", "detail", "name"),
    [
        ("session-frame", "from session B on, shifted", "frame of a session (from session B on, shifted)"),
        ("frame-drift", "wandering", "drift of the measuring set-up"),
    ],
)
def test_a_name_has_the_detail_that_dates_it(cause: str, detail: str, name: str) -> None:
    """Fails if page one does not say since which session a frame is another, or has the form of a curve in its place."""
    assert usability.labels([Finding(status="named", cause=cause, detail=detail, statement="")]) == [name]


def test_poses_of_several_rivals_are_all_counted() -> None:
    """Fails if one session is said to have as many poses as the longest of several plans, which are poses of their own."""
    plans = pd.concat([poses(3), poses(4).assign(joint=3)])
    (session,) = advice(results({**QUIET, **diagnosed(), "diagnose/next_poses.csv": plans}))
    assert session.sentence.startswith("If you measure again: about 7 poses, 14 minutes")


def test_a_gain_that_no_figure_shows_is_none() -> None:
    """Fails if page one states a gain of corrected commands of a millionth of a millimetre."""
    means = (("nothing", 5.0), ("figures", 0.050001), ("commands", 0.05))
    levels = [
        EffortLevel(level=level, split="holdout", unit="mm", mean=mean, rms=mean, max=mean, promised=mean)
        for level, mean in means
    ]  # type: ignore[arg-type]
    assert enough_words(levels, levels[1], None).endswith("corrected commands gain nothing on average.")


def test_what_chance_may_be_is_not_told_as_a_lack() -> None:
    """Fails if the verdict says that the model lacks something where its own test of that is not significant."""
    chance, lacking = (
        judgement(results({**QUIET, **summary(reduced_chi2=1.49, lack_of_fit_p=p)})) for p in (0.13, 1e-4)
    )
    assert chance.endswith("; whether more than noise is left is not certain.")
    assert lacking.endswith("; the model lacks something.")


def test_poses_that_are_missed_are_in_the_verdict() -> None:
    """Fails if a robot that is off by many times what is promised at a pose is called usable without a word of it."""
    said = "Usable for the poses, tools and loads that were measured, but 2 poses are off by up to 8.00 mm."
    assert judgement(results({**QUIET, **promised(57, 0.65, missed=MISSED)})) == said


def test_a_tool_that_may_be_as_far_off_as_before_is_not_called_calibrated() -> None:
    """Fails if a fit to the noise is the verdict, though lengths leave the tool's place open, or images are judged so."""
    said = f"{usability.USABLE}; at 51 % of these poses no gain over the maker's figures is certain."
    of_lengths, of_images = summary(new_poses_mm=0.05), summary(new_poses_mm=None)
    assert judgement(results({**QUIET, **of_lengths, **promised(57, 0.65, no_gain=0.51)})) == said
    assert judgement(results({**QUIET, **of_lengths, **promised(57, 0.65, no_gain=0.1)})).startswith("Calibrated")
    # Base and tool are still to be taught.
    assert judgement(results({**QUIET, **of_images, **promised(57, 0.65, no_gain=1.0)})).startswith("Calibrated")


def test_how_many_more_causes_a_condition_would_test_is_said_or_which() -> None:
    """Fails if one cause is counted in place of its name, or a reader does not learn what is counted."""
    for more, told in ((1, "A, B and C could"), (2, "A, B and 2 more causes could")):
        item = ranked._test_too("time", [NEEDS["time"]], ["A", "B", "C", "D"][: 2 + more])
        assert f": {told} be tested too." in item.sentence


def test_of_many_rivals_the_likeliest_are_asked_about() -> None:
    """Fails if eighty rivals are eighty sentences, or those left out are not told of."""
    tables = {
        "diagnose/findings.csv": found("one_of"),
        "diagnose/separations.csv": pd.concat([separations(0.0, f"look at {means}") for means in "aabcdee"]),
    }
    told = [item.sentence for item in ranked.other_means(results({**QUIET, **tables}))]
    assert [sentence.rsplit("? ")[-1] for sentence in told[:-1]] == ["Look at a.", "Look at b.", "Look at c."]
    assert told[-1].startswith("3 further rivals left: diagnose/separations.csv")


def test_every_rule_is_tested() -> None:
    assert {rule for rules in RULES.values() for rule in rules} == {rule for rule, *_ in SPEAKS}


@pytest.mark.parametrize(
    ("rule", "tables"),
    [
        (ranked.model_lacks, summary(reduced_chi2=1.9, lack_of_fit_p=0.2)),
        (ranked.model_lacks, summary(reduced_chi2=9.0, noise_sources=("estimated",))),
        (ranked.noise_doubtful, summary(reduced_chi2=0.2, noise_sources=("estimated",))),
        (ranked.few_poses, summary(new_poses_mm=0.08)),
        (ranked.few_poses, summary(new_poses_mm=0.26, lack_of_fit_p=0.0, reduced_chi2=9.0)),
        (ranked.at_bound, {"identify/parameters.csv": parameter_table(at_bound=True, prior_share=1.0)}),
        (ranked.mistaken_figures, {"identify/parameters.csv": parameter_table(estimate=0.019)}),
        (ranked.mistaken_figures, {"identify/parameters.csv": parameter_table(estimate=0.022, sd=0.015)}),
        (ranked.unlike_expected, {"identify/parameters.csv": parameter_table(estimate=9e-4, prior_mean=3e-4, prior_sd=2e-4)}),
        (ranked.unlike_expected, {"identify/parameters.csv": parameter_table(estimate=9e-3, prior_sd=1e-4)}),  # nobody stated it
        (ranked.size_unlike_stated,
         {"identify/parameters.csv": parameter_table(parameter="target.scale", effect="camera", of_size=True,
                                                     estimate=-4e-4, prior_sd=5e-4)}),
        (ranked.size_unlike_stated,  # a cause that was found explains it
         {"identify/parameters.csv": parameter_table(parameter="target.scale", effect="camera", of_size=True, estimate=5e-3,
                                                     sd=5e-4, prior_sd=UNKNOWN_SIZE_SD),
          "diagnose/parameters.csv": parameter_table(parameter="target.scale", effect="camera", of_size=True, estimate=3e-4,
                                                     sd=4e-4, prior_sd=UNKNOWN_SIZE_SD)}),
        (ranked.board_as_stated,
         {"identify/in_space.csv": in_space(0.2, 0.3, 0.4),
          "identify/parameters.csv": parameter_table(parameter="target.scale", effect="camera", of_size=True)}),
        (ranked.board_as_stated, {"identify/in_space.csv": in_space(0.2, 0.3, 0.4), **summary(new_poses_mm=0.05)}),  # a tracker too
        (ranked.board_as_stated, {}),
        (ranked.second_marker, {"identify/identifiability.csv": statements(("trade", "joint6.d;A.z;B.z")),
                                         "identify/placement.csv": placement("A", "B"),
                                         "identify/parameters.csv": of_parts(joint6_d="joint6", A_z="A", B_z="B")}),
        (ranked.second_marker, {"identify/identifiability.csv": statements(("trade", "joint6.d;joint5.a"))}),
        (ranked.second_marker,  # a deflection, which turns with the load; and too many to be told apart
         {"identify/identifiability.csv": statements(
             ("trade", "joint2.phi3x;E.x"), ("trade", "joint6.theta;E.x;joint1.d;joint2.d;joint3.d")),
          "identify/parameters.csv": TURN_AND_PLACE}),
        (ranked.second_marker, {"identify/identifiability.csv": statements(("trade", "joint6.d;E.z")),  # of one sum
                                         "identify/parameters.csv": of_parts(joint6_d="joint6", E_z="E")}),
        (ranked.second_marker, {"identify/identifiability.csv": statements(("trade", "joint6.theta;E.x")),
                                         "identify/observations.csv": observed("pose"),  # the tool's turn was measured
                                         "identify/parameters.csv": TURN_AND_PLACE}),
        (ranked.unseen_compliance, {"identify/identifiability.csv": statements(("silent", "joint2.a"))}),
        (ranked.model_lacks, {**summary(reduced_chi2=9.0), **summary("diagnose", reduced_chi2=1.1)}),
        (ranked.model_lacks, {**summary(reduced_chi2=9.0), "diagnose/findings.csv": found("unexplained")}),
        (usability.makes_it_worse, {"diagnose/accuracy.csv": accuracies(holdout=0.061)}),
        (usability.makes_it_worse, {"diagnose/accuracy.csv": accuracies(holdout=0.064), **lost(0.004, 0.005, 0.003)}),
        (usability.not_converged, diagnosed()),
        (usability.look_for_reason,  # the robot's own; and noise, which no row is off by
         {"diagnose/findings.csv": to_frame([CAUSE, replace(CAUSE, cause="range-noise", joint=None)], Finding)}),
        (usability.makes_it_worse, {"diagnose/accuracy.csv": accuracies(holdout=None)}),
        (ranked.other_means, {"diagnose/findings.csv": found("named"), "diagnose/separations.csv": separations(0.0, "b")}),
        (ranked.other_means, {"diagnose/findings.csv": found("one_of"), "diagnose/separations.csv": separations(0.9)}),
        (ranked.untested, {"diagnose/findings.csv": found("unexplained"),  # asked for already, to tell rivals apart
                           "diagnose/separations.csv": separations(0.0, "a"),
                           "diagnose/candidates.csv": to_frame([CandidateRow(cause="joint-hysteresis", joint=2,
                                                                             lacking="a", asked=("time",))],
                                                               CandidateRow)}),
        (ranked.untested, {"diagnose/findings.csv": found("unexplained"),
                           "diagnose/candidates.csv": to_frame([CandidateRow(cause="frame-drift", imitated=True)],
                                                               CandidateRow)}),
        (ranked.untested, {"diagnose/findings.csv": found("unexplained"),  # by an angle: play is none
                           "diagnose/candidates.csv": to_frame([CandidateRow(cause="joint-backlash", joint=2,
                                                                             lacking=NEEDS["approach"].words, asked=("approach",))],
                                                               CandidateRow)}),
    (ranked.too_narrow, promised(54, 0.08)),
    (ranked.too_narrow, promised(0, 1.0, tested=0)),
    ],
)  # fmt: skip
def test_rule_stays_silent_short_of_its_limit(rule: Rule, tables: Mapping[str, object]) -> None:
    assert not list(rule(results({**QUIET, **tables})))


def test_the_most_urgent_stands_first_and_absent_tables_are_no_matter() -> None:
    tables = {name: table for name, table in QUIET.items() if name.startswith("identify/")}
    given = results({**tables, **summary(converged=False, reduced_chi2=0.1, starts=2, starts_agreeing=1)})
    assert [item.urgency for item in advice(given)] == [1, 2, 3]
    assert all(isinstance(item, Advice) for item in advice(given))


@pytest.mark.parametrize(("number", "above", "first"), [(1, 5, 1), (5, 5, 5), (12, 5, 12), (40, 5, 21), (40, 45, 3)])
def test_steps_without_room_on_the_first_page_are_told_further_on(number: int, above: int, first: int) -> None:
    """Fails if a step is lost, told twice or out of its order, or if there is a list of further steps with none in it."""
    page = RestOfPage(
        [Paragraph("what the data cannot tell") for _ in range(above)],
        [f"step {k}: {'so much to do ' * 20}" for k in range(number)],
    )
    pdf = typst.compile(document.source("t", [("Verdict", [page]), ("Next", [])]).encode(), ignore_system_fonts=True)
    told = pages_of(pdf)
    pages, made = [re.findall(r"step (\d+):", page) for page in told], "\n".join(told)
    assert [int(k) for page in pages for k in page] == list(range(number))
    assert len(pages[0]) == first
    assert ("Further steps\n" in made) == (number > first)
    assert (f"{number - first} further steps, less urgent" in made) == (number > first)
    tables = {name: table for name, table in QUIET.items() if name.startswith("identify/")}
    assert len(advice(results({**tables, **summary(starts=2, starts_agreeing=1)}))) == 1


def test_all_that_is_to_be_measured_is_one_step() -> None:
    """Fails if a reader has to add up what several steps ask of one session, or measures before what is to be looked for first."""
    silent = {"identify/identifiability.csv": statements(("silent", "joint1.s")),
              "identify/parameters.csv": parameter_table(parameter="joint1.s", part="joint1", joint=1, unit="rad/Nm")}  # fmt: skip
    found_more = {"diagnose/findings.csv": found("unexplained"), **diagnosed()}
    few = summary(noise_sources=("estimated",), extrapolation=(2, 3))
    look, session = advice(results({**QUIET, **silent, **found_more, **few}))
    assert look.sentence.startswith("An error remains")
    assert session.sentence.startswith(
        "Measure once more: about 10 poses, 20 minutes at 2 minutes each. Measure some poses again"
    )
    steps = ["whole range of joints 2 and 3", "apply a known side force"]  # the first page has room for two
    assert [step in session.sentence for step in steps] == [True, False]
    assert [step in session.reason for step in steps] == [False, True]
    assert session.keys == f"sigma_mm; {NEEDS['warmth'].words}"
    (later,) = advice(results({**QUIET, **silent, **diagnosed()}))
    assert later.sentence.startswith("If you measure again: about 4 poses")


@pytest.mark.parametrize(
    ("inputs", "needed", "first"),
    [
        (("q1",), {"gear-transmission-error": "gear_ratio", "bending": "masses", "torsion": "masses"}, "gear_ratio"),
        (("q1",), {"thermal-growth": "warmth", "bending": "masses"}, "masses"),
        (("order",), {"session-frame": "session", "bending": "masses", "torsion": "masses"}, "session"),
        (("x", "y", "z"), {"thermal-growth": "warmth", "bending": "masses", "torsion": "masses"}, "warmth"),
    ],
)
def test_of_what_is_lacking_the_likeliest_is_asked_for_and_then_the_least_effort(
    inputs: tuple[str, ...], needed: Mapping[str, str], first: str
) -> None:
    """Fails if a waviness by a slide's reading asks for masses, since so many other causes need these."""
    left = Finding(status="unexplained", statement="", inputs=inputs)
    rows = [CandidateRow(cause=cause, lacking=NEEDS[need].words, asked=(need,)) for cause, need in needed.items()]
    tables = {
        "diagnose/findings.csv": to_frame([left], Finding),
        "diagnose/candidates.csv": to_frame(rows, CandidateRow),
    }
    assert [item.keys for item in ranked.untested(results({**QUIET, **tables}))] == [NEEDS[first].words]


def test_open_questions_name_what_the_data_leave_open() -> None:
    tables = {
        "identify/identifiability.csv": statements(
            ("silent", "joint1.s"),
            ("trade", "joint6.d;E.z"),
            ("trade", "a;b;c;d;e"),
            ("bound", "joint1.s"),
            ("bound", "joint2.s"),
        ),
        "identify/parameters.csv": pd.concat(
            [
                parameter_table(parameter="joint4.a", prior_share=0.9),
                parameter_table(parameter="tool.x", prior_share=1.0, fixed=True),
                parameter_table(parameter="joint1.s", meaning="compliance of joint 1"),
                parameter_table(parameter="joint6.d", meaning="length d of link 6"),
            ]
        ),
    }
    said = open_questions(results(tables))
    assert said[0].startswith("Compliance of joint 1: assumed")
    assert said[1] == "Length d of link 6 cannot be separated from E.z."
    assert said[2].startswith("1 more combination of many parameters cannot be determined.")
    assert "joint2.s" in said[3]
    assert "compliance of joint 1" not in said[3]
    assert said[4] == "Joint4.a: no better known than before."  # unlike a figure that is held, which is no question
    assert open_questions(results(QUIET)) == []


@pytest.mark.parametrize(
    ("times", "significant", "words"),
    [
        (float("nan"), False, "is not known"),
        (1.0, False, "explains all"),
        (1.3, False, "a little more"),
        (1.6, False, "1.60 times the noise: more than noise explains, which may be chance"),
        (3.2, True, "3.2 times the noise: the model lacks"),
    ],
)
def test_leftover_in_words(times: float, significant: bool, words: str) -> None:
    assert words in leftover(times, 0.0, "", significant, "mm")


def test_the_models_own_error_is_told_where_there_is_one() -> None:
    assert "0.075 mm per axis" in leftover(4.5, 0.0746, "", False, "mm")
    assert "own error" not in leftover(4.5, 0.0, "", False, "mm")
    for times in (0.9, float("nan")):
        assert leftover(times, 0.0, "the angle of joint 2", False, "mm").startswith(
            "a part of it depends on the angle of joint 2, so it is more than noise"
        )


def test_held_out_poses_that_contradict_what_new_ones_let_expect_are_told_beside_it() -> None:
    """Fails if page one promises a tenth of the error that it shows, or doubts what held-out poses confirm within noise."""
    fitted = replace(SUMMARY, new_poses_mm=0.398, new_poses_limit_mm=0.458, sigma_mm=0.622)
    assert new_poses_words(fitted, 2.24).endswith("held-out poses are off by 2.24 mm: do not rely on it.")
    for held_out in (0.0, 0.4, 1.3):
        assert new_poses_words(fitted, held_out).startswith("0.398 mm (with 95 % certainty at most 0.458 mm)")


def test_headline_says_where_the_error_was_measured() -> None:
    """Fails if fitted poses pass for others, or an error without what the device adds for the measured one beside it."""

    def of(split: str, *figures: tuple[float, float], alone: float | None = None, largest: float = 42.64) -> str:
        steps = [
            Accuracy(model=str(k), step=k, split=split, n=4, mean_mm=mean, rms_mm=mean, max_mm=most)  # type: ignore[arg-type]
            for k, (mean, most) in enumerate(figures)
        ]
        told = {"level": "nothing", "split": split, "unit": "mm", "rms": 1.0, "max": largest, "promised": 1.0}
        levels = to_frame([EffortLevel(mean=alone, **told)] if alone else [], EffortLevel)  # type: ignore[arg-type]
        return headline(
            results(
                {"identify/accuracy.csv": to_frame(steps, Accuracy)} | ({f"identify/{LEVELS}": levels} if alone else {})
            )
        )

    before, after = (30.4622, 42.64), (0.04458, 0.1031)
    assert of("holdout", before, after) == (
        "At poses that no fit has seen, calibration reduces the error from 30.46 mm to 0.045 mm on average, "
        "and the largest from 42.64 mm to 0.103 mm."
    )
    assert "none were held out" in of("train", before, after)
    assert "reduces" not in of("holdout", after, before)
    assert (
        "the error from 12.50 mm (30.46 mm as measured, with the device's own error and what has ended since) to"
        in of("holdout", before, after, alone=12.5)
    )
    assert "device" not in of("holdout", before, after, alone=30.4)
    assert "(30.46 mm as measured, with the device's own error and what has ended since)" in of(
        "holdout", before, after, alone=30.4, largest=41.0
    )


def test_a_contradicted_noise_is_the_first_thing_said() -> None:
    """Fails if page one begins with what was found although the noise that it rests on is contradicted."""
    assert foremost(results(summary(noise_doubts=(DOUBT,)))) == [DOUBT.statement]
    assert foremost(results(summary())) == []


@pytest.mark.parametrize(("source", "told"), [("estimated", True), ("file", False)])
def test_a_loose_marker_is_told_where_nobody_stated_a_noise(source: Source, told: bool) -> None:
    """Fails if page one does not say whose readings scatter, or says it twice: a stated noise is contradicted for it already."""
    noise = SeriesNoise(3e-5, source, 5e-5, label="marker", factors={"A": 0.8, "B": 3.2})
    seen = results(summary(noise=(noise,)))
    sentence = "Marker B scatters 4 times as much as the quietest: see whether it sits firmly."
    assert foremost(seen) == [sentence] * told


def validated(
    status: str, rms_low: float, nominal: float = 1.0, judged: str = "calibrated", tolerance: float | None = 0.3
) -> object:
    """A validation of which the calibrated model errs by 0.2, 0.25 at most, where 0.1 was expected."""
    models = {
        "nominal": SimpleNamespace(mean=nominal),
        "calibrated": SimpleNamespace(mean=0.2, max=0.25, rms_low=rms_low),
    }
    models["figures"] = SimpleNamespace(mean=0.4, max=0.5, rms_low=rms_low)
    summary = SimpleNamespace(
        status=status, tolerance=tolerance, judged=judged, promised=0.1, unit="mm", of_positions=True
    )
    return SimpleNamespace(summary=summary, judged=models[judged], of=models.__getitem__)


@pytest.mark.parametrize(
    ("validation", "step"),
    [
        (validated("not met", 0.05, nominal=0.1), "Find out whether these rows"),
        (validated("met", 0.05), "Put the robot to work"),
        (validated("cannot be told", 0.05), "Measure more poses that no fit has seen"),
        (validated("no tolerance", 0.05, tolerance=None), "State what the robot may err by"),
        (validated("not met", 0.05, judged="figures"), "Send corrected commands"),
        (validated("not met", 0.15), "Look for what has changed"),
        (validated("not met", 0.05), "calflow next"),
    ],
)
def test_a_validation_says_what_to_do_next(validation, step: str) -> None:
    """Fails if a verdict leaves its reader without a next step, or with that of another verdict."""
    assert step in after_validation(validation)


MOVED, RIVALLED = (
    SimpleNamespace(kind="zero", cannot_tell_from=()),
    SimpleNamespace(kind="zero", cannot_tell_from=("base",)),
)


@pytest.mark.parametrize(
    ("status", "moved", "poses", "step"),
    [
        ("in place", [], 0, "Go on with this calibration"),
        ("conditions", [MOVED], 0, "state the conditions"),
        ("cannot be seen", [], 0, "Choose more check poses"),
        ("cannot be told", [], 4, "next_poses.csv"),
        ("cannot be told", [], 0, "Measure the check poses again"),
        ("moved", [RIVALLED], 4, "next_poses.csv"),
        ("moved", [MOVED], 4, "Add the shift in recalibration.csv to the joint's reading"),
    ],
)
def test_a_drift_check_says_what_to_do_next(status: str, moved: list[object], poses: int, step: str) -> None:
    """Fails if a check leaves its reader without a next step, or something is corrected before it is told from its rivals."""
    drift = SimpleNamespace(summary=SimpleNamespace(status=status), moved=moved, next_poses=[None] * poses)
    assert step in after_drift(drift)
