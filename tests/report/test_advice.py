"""What to do next: each rule speaks up on its table, and not otherwise."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd
import pytest

from calflow.diagnosis.findings.tables import CANDIDATES, FINDINGS
from calflow.report.material import ModelAccuracy
from calflow.report.section import Advice, Rule, advice, sections
from calflow.report.sections import (
    accuracy,
    diagnosis,
    faults,
    identifiability,
    parameters,
    posterior,
    predictive,
    residuals,
)
from calflow.report.sections.verdict import fitting, headline, leftover

SUMMARY = {
    "noise_source": "file", "reduced_chi2": "1.02", "solver": "IPOPT: Solve_Succeeded, 9 iterations",
    "converged": "True", "starts_agreeing": "3 of 3",
}  # fmt: skip


def summary(**items: str) -> pd.DataFrame:
    return pd.DataFrame(list((SUMMARY | items).items()), columns=["item", "value"])


def accuracies(train: float = 0.05, holdout: float | None = 0.06) -> pd.DataFrame:
    rows = [("nominal", "train", 9, 5.0, 6.0, 9.0), ("geometry", "train", 9, train, train, 2 * train)]
    if holdout is not None:
        rows += [("nominal", "holdout", 4, 5.0, 6.0, 9.0), ("geometry", "holdout", 4, holdout, holdout, 2 * holdout)]
    return pd.DataFrame(rows, columns=["model", "split", "n", "mean_mm", "rms_mm", "max_mm"])


def parameter_table(**changed: object) -> pd.DataFrame:
    row = {"parameter": "joint2.a", "effect": "geometry", "variant": float("nan"), "part": "joint2", "symbol": "a",
           "unit": "m", "nominal": 0.0, "estimate": 0.02, "sd": 1e-5,
           "lower": -0.02, "upper": 0.02, "at_bound": False, "prior_share": 0.01, "meaning": ""}  # fmt: skip
    return pd.DataFrame([row | changed])


def statements(*rows: tuple[str, str]) -> pd.DataFrame:
    return pd.DataFrame(
        [(kind, names, f"about {names}") for kind, names in rows], columns=["kind", "parameters", "statement"]
    )


def placement(*markers: str) -> pd.DataFrame:
    return pd.DataFrame({"what": ["base", *markers]})


def predictions(inside: int, outside: int, split: str = "holdout") -> pd.DataFrame:
    covered = [True] * inside + [False] * outside
    return pd.DataFrame({"split": split, "covered": covered})


def faulty(*lines: int) -> pd.DataFrame:
    said = f"lines {', '.join(map(str, lines))} are far off"
    return pd.DataFrame({"cause": "outlier", "joint": 0, "line": list(lines), "action": "left out", "statement": said})


def found(*statuses: str) -> pd.DataFrame:
    """Findings: backlash of joint 2, or what its angle explains and no cause does."""
    rows = [
        {"status": status, "cause": None, "statement": "depends on q2; no cause of the catalogue explains it"}
        if status == "unexplained"
        else {"status": status, "cause": "joint-backlash", "joint": 2, "rivals": "joint-hysteresis 2"}
        for status in statuses
    ]
    return pd.DataFrame(rows, columns=FINDINGS)


def candidates(*notes: str) -> pd.DataFrame:
    return pd.DataFrame([{"cause": "frame-drift", "note": note} for note in notes], columns=CANDIDATES)


def separations(chance: float, words: str) -> pd.DataFrame:
    row = {"cause": "joint-backlash", "joint": 2, "rival": "joint-hysteresis", "rival_joint": 2, "separation_before_sd": 1.0,
           "separation_after_sd": 6.5, "chance_after": chance, "words": words}  # fmt: skip
    return pd.DataFrame([row])


def poses(number: int, leaves_open: str = "") -> pd.DataFrame:
    row = {
        "tells": "joint-backlash 2",
        "from": "joint-hysteresis 2",
        "leaves_open": leaves_open or float("nan"),
        "separation_before_sd": 1.2,
        "separation_after_sd": 6.5,
    }
    return pd.DataFrame([row] * number, columns=list(row))


QUIET: dict[str, pd.DataFrame] = {
    "identify/summary.csv": summary(),
    "identify/accuracy.csv": accuracies(),
    "identify/faults.csv": faulty(),
    "identify/residuals.csv": pd.DataFrame({"line": [2, 3, 4], "flagged": [False, False, False]}),
    "identify/parameters.csv": parameter_table(),
    "identify/identifiability.csv": statements(),
    "identify/placement.csv": placement("E"),
    "diagnose/findings.csv": found(),
    "diagnose/candidates.csv": candidates("", "not testable: needs a column time_s"),
    "diagnose/separations.csv": separations(0.99, "measure the 3 poses of next_poses.csv").iloc[:0],
    "diagnose/next_poses.csv": poses(0),
    "sample/posterior.csv": pd.DataFrame({"parameter": ["joint2.a", "E.x"], "rhat": [1.001, 1.009]}),
    "sample/summary.csv": pd.DataFrame([("length", "long enough")], columns=["item", "value"]),
    "sample/predictive.csv": predictions(57, 3),
}

SPEAKS: list[tuple[Rule, Mapping[str, pd.DataFrame], int, str]] = [
    (accuracy.nominal_far_off, {"identify/summary.csv": summary(spread_mm="40.0")}, 1, "swapped axes"),
    (accuracy.not_converged, {"identify/summary.csv": summary(converged="False", solver="IPOPT: Max_Iter")}, 1, "Max_Iter"),
    (accuracy.starts_disagree, {"identify/summary.csv": summary(starts_agreeing="1 of 3")}, 2, "Only 1 of 3"),
    (accuracy.model_lacks, {"identify/summary.csv": summary(reduced_chi2="9.0")}, 2, "leaves 3.0 times the noise"),
    (accuracy.noise_doubtful, {"identify/summary.csv": summary(reduced_chi2="0.25")}, 3, "only 0.50 times"),
    (accuracy.noise_unknown, {"identify/summary.csv": summary(noise_source="estimated")}, 2, "several times"),
    (accuracy.nothing_held_out, {"identify/accuracy.csv": accuracies(holdout=None)}, 2, "split.holdout"),
    (accuracy.does_not_carry_over, {"identify/accuracy.csv": accuracies(holdout=0.2)}, 2, "4.0 times"),
    (accuracy.reaches_beyond, {"identify/summary.csv": summary(extrapolation="joint 2: 6 rows")}, 3, "joint 2: 6 rows"),
    (faults.correct_the_file, {"identify/faults.csv": faulty(9, 12)}, 2, "lines 9, 12 are far off"),
    (residuals.flagged_rows, {"identify/residuals.csv": pd.DataFrame({"line": [2, 9], "flagged": [False, True]})}, 2, "line 9"),
    (parameters.at_bound, {"identify/parameters.csv": parameter_table(at_bound=True)}, 2, "joint2.a"),
    (parameters.at_bound,
     {"identify/parameters.csv": parameter_table(at_bound=True, parameter="joint3.s", unit="rad/Nm", lower=0.0, upper=1e-6,
                                                 estimate=1e-10)}, 3, "joint3.s came out at zero"),
    (identifiability.second_marker, {"identify/identifiability.csv": statements(("trade", "joint6.d;E.z")),
                                     "identify/parameters.csv": parameter_table(parameter="E.z", part="E")}, 3, "joint6.d from"),
    (identifiability.unseen_compliance,
     {"identify/identifiability.csv": statements(("silent", "joint1.s")),
      "identify/parameters.csv": parameter_table(parameter="joint1.s", part="joint1", unit="rad/Nm")}, 3, "joint 1"),
    (diagnosis.makes_it_worse, {"diagnose/accuracy.csv": accuracies(holdout=0.07)}, 1, "0.070 mm against 0.060 mm"),
    (diagnosis.unexplained, {"diagnose/findings.csv": found("unexplained")}, 2, "depends on the angle of joint 2 that no cause"),
    (diagnosis.next_poses, {"diagnose/next_poses.csv": poses(3)}, 3, "the 3 poses of diagnose/next_poses.csv that tell backlash"),
    (diagnosis.next_poses, {"diagnose/next_poses.csv": poses(3, "joint-hysteresis 2 or link-mass 3")}, 3,
     "leave open whether it is friction wind-up of joint 2 or mass error of link 3"),
    (diagnosis.other_means, {"diagnose/findings.csv": found("one_of"), "diagnose/separations.csv": separations(
        0.0, "no pose tells joint-backlash from joint-hysteresis in these data: log each joint's travel")}, 3,
     "To tell backlash of joint 2 from friction wind-up of joint 2: log each joint's travel"),
    (diagnosis.untested, {"diagnose/findings.csv": found("unexplained")}, 3, "with a column time_s (drift of the measuring"),
    (posterior.too_short, {"sample/summary.csv": pd.DataFrame([("length", "too short: about 90 more steps are needed")],
                                                              columns=["item", "value"])}, 2, "about 90 more steps"),
    (posterior.ensembles_disagree, {"sample/posterior.csv": pd.DataFrame({"parameter": ["a", "b"], "rhat": [1.2, 1.0]})}, 2,
     "disagree on a"),
    (predictive.too_narrow, {"sample/predictive.csv": predictions(45, 15)}, 2, "Only 45 of 60"),
]  # fmt: skip


@pytest.mark.parametrize(("rule", "tables", "urgency", "words"), SPEAKS)
def test_rule_speaks_on_its_table(rule: Rule, tables: Mapping[str, pd.DataFrame], urgency: int, words: str) -> None:
    found = rule({**QUIET, **tables})
    assert [item.urgency for item in found] == [urgency]
    assert words in found[0].sentence
    assert found[0].sentence.endswith(".")


@pytest.mark.parametrize("rule", [rule for section in sections() for rule in section.rules])
def test_rule_is_silent_where_all_is_well(rule: Rule) -> None:
    assert rule(QUIET) == []


def test_every_rule_is_tested() -> None:
    assert {rule for section in sections() for rule in section.rules} == {rule for rule, *_ in SPEAKS}


@pytest.mark.parametrize(
    ("rule", "tables"),
    [
        (accuracy.model_lacks, {"identify/summary.csv": summary(reduced_chi2="1.9")}),
        (accuracy.model_lacks, {"identify/summary.csv": summary(reduced_chi2="9", noise_source="estimated")}),
        (accuracy.noise_doubtful, {"identify/summary.csv": summary(reduced_chi2="0.2", noise_source="estimated")}),
        (parameters.at_bound, {"identify/parameters.csv": parameter_table(at_bound=True, prior_share=1.0)}),
        (identifiability.second_marker, {"identify/identifiability.csv": statements(("trade", "joint6.d;A.z;B.z")),
                                         "identify/parameters.csv": parameter_table(parameter="A.z", part="A"),
                                         "identify/placement.csv": placement("A", "B")}),
        (identifiability.second_marker, {"identify/identifiability.csv": statements(("trade", "joint6.d;joint5.a")),
                                         "identify/parameters.csv": parameter_table(parameter="E.z", part="E")}),
        (identifiability.unseen_compliance, {"identify/identifiability.csv": statements(("silent", "joint2.a"))}),
        (accuracy.model_lacks, {"identify/summary.csv": summary(reduced_chi2="9"),
                                "diagnose/summary.csv": summary(reduced_chi2="1.1")}),
        (accuracy.model_lacks, {"identify/summary.csv": summary(reduced_chi2="9"),
                                "diagnose/findings.csv": found("unexplained")}),
        (diagnosis.makes_it_worse, {"diagnose/accuracy.csv": accuracies(holdout=0.061)}),
        (diagnosis.makes_it_worse, {"diagnose/accuracy.csv": accuracies(holdout=None)}),
        (diagnosis.other_means, {"diagnose/findings.csv": found("named"), "diagnose/separations.csv": separations(0.0, "a: b")}),
        (diagnosis.other_means, {"diagnose/findings.csv": found("one_of"), "diagnose/separations.csv": separations(0.9, "c")}),
        (diagnosis.untested, {"diagnose/findings.csv": found("unexplained"),
                              "diagnose/candidates.csv": candidates("not testable: these data cannot show it")}),
        (predictive.too_narrow, {"sample/predictive.csv": predictions(54, 6)}),
        (predictive.too_narrow, {"sample/predictive.csv": predictions(10, 50, split="train")}),
    ],
)  # fmt: skip
def test_rule_stays_silent_short_of_its_limit(rule: Rule, tables: Mapping[str, pd.DataFrame]) -> None:
    assert rule({**QUIET, **tables}) == []


def test_the_most_urgent_stands_first_and_absent_tables_are_no_matter() -> None:
    tables = {name: table for name, table in QUIET.items() if name.startswith("identify/")}
    tables["identify/summary.csv"] = summary(converged="False", reduced_chi2="0.1", starts_agreeing="1 of 2")
    assert [item.urgency for item in advice(sections(), tables)] == [1, 2, 3]
    assert all(isinstance(item, Advice) for item in advice(sections(), tables))


def test_lists_of_the_first_page_are_set_so_that_they_fit() -> None:
    """Fails if a long list spills onto a second page, or a short one is set too small to read."""
    assert [fitting(["x" * 90] * number) for number in (5, 18, 20, 25, 60)] == [10.5, 10.5, 9.5, 8.5, 8.5]
    assert fitting(["x" * 120] * 10) == 9.5


def test_open_questions_name_what_the_data_leave_open() -> None:
    tables = {
        "identify/identifiability.csv": statements(
            ("silent", "joint1.s"),
            ("trade", "joint6.d;E.z"),
            ("bound", "joint1.s"),
            ("bound", "joint2.s"),
            ("correlated", "a;b"),
        ),
        "identify/parameters.csv": pd.concat(
            [
                parameter_table(parameter="joint4.a", prior_share=0.9),
                parameter_table(parameter="joint1.s", meaning="compliance of joint 1"),
                parameter_table(parameter="joint6.d", meaning="length d of link 6"),
            ]
        ),
    }
    said = identifiability.open_questions(tables)
    assert "joint1.s (compliance of joint 1)" in said[0]
    assert "joint6.d (length d of link 6) with E.z" in said[1]
    assert "joint2.s" in said[2]
    assert "joint1.s" not in said[2]
    assert "joint4.a" in said[3]
    assert said[4].startswith("1 further pair ")
    assert identifiability.open_questions({**QUIET}) == []


@pytest.mark.parametrize(
    ("times", "words"),
    [
        (float("nan"), "cannot be told"),
        (1.0, "explains all"),
        (1.3, "a little more"),
        (3.2, "3.2 times the noise: it lacks"),
    ],
)
def test_leftover_in_words(times: float, words: str) -> None:
    assert words in leftover(times)


def test_the_models_own_error_is_told_where_there_is_one() -> None:
    assert "0.075 mm per axis" in leftover(4.5, 0.0746)
    assert "own error" not in leftover(4.5, 0.0)
    for times in (0.9, float("nan")):
        assert leftover(times, structure="the angle of joint 2").startswith(
            "more than noise: a part of it depends on the angle"
        )


def test_headline_says_where_the_error_was_measured() -> None:
    steps = [
        ModelAccuracy("nominal", "nominal robot", 4, 30.4622, 31.0, 42.64),
        ModelAccuracy("geometry", "geometry", 4, 0.04458, 0.05, 0.1031),
    ]
    assert headline(steps, "holdout") == (
        "At poses that no fit has seen, calibration reduces the tool-position error from 30.46 mm to 0.045 mm on average, "
        "and the largest from 42.64 mm to 0.103 mm."
    )
    assert "none were held out" in headline(steps, "train")
    assert "reduces" not in headline(steps[::-1], "holdout")
