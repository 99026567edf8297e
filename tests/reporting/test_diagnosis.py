"""The part on causes: said in words for each kind of finding, drawn without anything cut off, and told on the first page."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from calflow.deployment.run_outcome import RunOutcome
from calflow.diagnosis.cause_tables import CandidateRow
from calflow.diagnosis.findings import Finding
from calflow.effects import catalogue
from calflow.effects.wording import NamedCause, amount, cause_name, place_name, place_names
from calflow.files.tables import Results
from calflow.files.words import chance, chance_figure, sureness
from calflow.reporting import document
from calflow.reporting.advice import untestable
from calflow.reporting.bars import error_budget, evidence
from calflow.reporting.cause_figures import explained_figure
from calflow.reporting.material import Material
from calflow.reporting.section import Section, sections
from calflow.reporting.sections.causes import fitting_kin, gain_words, name_certainty
from calflow.reporting.sections.parameters import estimates
from calflow.reporting.sections.verdict import lacked, unsure
from calflow.reporting.style import style
from calflow.reporting.terminal import last_lines
from calflow.stages.report import report_material
from calflow.stages.stage import Context
from reporting.case import (
    BACKLASH,
    COUPLED,
    CURVE,
    MISFIT,
    OR_HYSTERESIS,
    ORDER_OPEN,
    OUTLIERS,
    STEP,
    WAVING,
    Case,
    Found,
    chosen,
    context,
    with_diagnosis,
    with_sample,
)
from reporting.pdf import pages_of

NO_GAIN = (float("nan"),) * 3


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Context:
    return context(tmp_path_factory.mktemp("small"))


def told(given: Context) -> tuple[str, str]:
    """The first page, and the sections on causes and their search, with everything that string literals hide unescaped."""
    material = report_material(given.study, given.results, given.run_folder)
    own = {section.title: section for section in chosen(sections(), material)}
    causes = "".join(
        written(own[title], material)
        for title in ("What the model lacked: causes", "The search for causes")
        if title in own
    )
    return written(own["Verdict"], material), causes


def written(section: Section, material: Material) -> str:
    """A section's source."""
    with style():
        source = document.source("", [("", section.write(material))])
    return source.replace('\\"', '"').replace("\\\\", "\\")


def test_a_named_cause_is_told_with_place_size_sureness_and_gain(small: Context) -> None:
    """Fails if what, where, how large, how sure or what it gained is missing."""
    first, section = told(with_diagnosis(small, BACKLASH))
    assert "1. Backlash of joint 2" in section
    assert "play 100.0 ± 4.0 µrad (1 sd)" in section
    assert "< 10⁻⁶" in section
    assert "Nothing else that was tested" in section
    assert "takes 0.040 mm off the mean error at held-out poses (95 % interval 0.020 to 0.060 mm)" in section
    assert "does not prove a cause" in section
    assert "Backlash of joint 2:" in first
    assert "100.0 ± 4.0 µrad; it takes 0.040 mm off the mean error." in first


def test_a_cause_with_several_parameters_is_told(small: Context) -> None:
    """Fails if a cause of the device, or one with more than one parameter, cannot be written."""
    first, section = told(with_diagnosis(small, STEP, BACKLASH))
    assert "1. Step of the measuring set-up (after row 12 in measuring order)" in section
    assert "step 0.3000 ± 0.0090 mm" in section
    assert "2. Backlash of joint 2" in section
    assert "Step of the measuring set-up (after row 12 in measuring order):" in first
    assert "Backlash of joint 2:" in first


def test_what_cannot_be_told_apart_is_said_with_what_would_tell(small: Context) -> None:
    """Fails if a name that is not sure is told as if it were, or without a way out."""
    first, section = told(with_diagnosis(small, OR_HYSTERESIS, poses=0))
    assert "1. Backlash of joint 2 or hysteresis of joint 2" in section
    assert "Its name is not certain: hysteresis of joint 2 explains these data as well" in section
    assert "No pose distinguishes backlash from hysteresis in these data: log each joint's travel." in section
    assert "Which is the cause: backlash of joint 2 or hysteresis of joint 2." in first
    assert "Which is it: backlash of joint 2 or hysteresis of joint 2? Log each joint's travel." in first


def test_the_likeliest_of_many_is_no_name_on_the_first_page(small: Context) -> None:
    """Fails if a cause that is less probable than not is told as what was found, or as one of the few that are listed."""
    many = "joint-hysteresis 2; joint-backlash 3; joint-backlash 4; joint-backlash 5; joint-hysteresis 3"
    context = with_diagnosis(small, replace(BACKLASH, status="one_of", rivals=many))
    table = context.tables["diagnose/findings.csv"]
    assert "Backlash of joint 2:" in told(context)[0]
    table.loc[table["cause"] == "joint-backlash", "probability"] = 0.2
    first, _ = told(context)
    assert "Backlash of joint 2 or one of 5 others:" in first
    assert (
        "Which is the cause: backlash of joint 2, hysteresis of joint 2, backlash of joint 3 or one of 3 more." in first
    )


def test_poses_that_would_tell_are_asked_for_on_the_first_page(small: Context) -> None:
    """Fails if the proposed poses are not told."""
    first, section = told(with_diagnosis(small, OR_HYSTERESIS))
    said = "Measure the 5 poses of diagnose/next_poses.csv that distinguish backlash of joint 2 from hysteresis of joint 2."
    assert said in first
    assert "would distinguish it from hysteresis of joint 2, by at least 6.5 standard deviations." in section


def test_only_the_family_is_named_where_the_order_is_open(small: Context) -> None:
    """Fails if one order is told as certain where others do as well."""
    first, section = told(with_diagnosis(small, ORDER_OPEN))
    assert "1. Transmission error of joint 2" in section
    assert "best described as eccentricity (order 1): amplitude 300 ± 10 µrad" in section
    assert "The exact form of the transmission error of joint 2." in first


def test_the_unexplained_is_told_by_its_inputs_and_never_as_a_cause(small: Context) -> None:
    """Fails if structure without a cause is passed over or given a name."""
    unsure = replace(WAVING, gain=(0.01, -0.02, 0.04))
    first, section = told(with_diagnosis(small, BACKLASH, COUPLED, unsure))
    assert "The angles of joints 2 and 3:" in section
    assert "by a smooth function of it, which has no physical meaning, it takes 0.040 mm off the mean error" in section
    assert "it gains nothing for certain at held-out poses (95 % interval −0.020 to 0.040 mm)" in section
    assert "The time (period 36 s):" in section
    assert "Usable for the poses, tools and loads that were measured; a part of the error is unexplained." in first
    assert "Why an error depends on the angles of joints 2 and 3 and the time (period 36 s)" in first
    assert (
        "Note the time of each reading, or the temperature as it changes: thermal growth could be tested too." in first
    )
    assert "It accounts for at least 0.040 mm of the mean error." in first
    named, _ = told(with_diagnosis(small, BACKLASH))
    assert "How sure is this?" in named
    assert "a part of the error" not in named
    alone, _ = told(with_diagnosis(small, COUPLED))
    assert "No cause explains what is left: 41 causes were tested." in alone


def test_a_lack_of_fit_is_the_first_thing_said(small: Context) -> None:
    """Fails if the model's lack of fit stands behind what was found, without its place, or reads as nothing found."""
    first, section = told(with_diagnosis(small, BACKLASH, MISFIT))
    said = (
        "The error left is larger than measurement noise explains. It is largest where joint 2 is between 20 and 45 deg: "
        "0.2 mm against 0.1 mm elsewhere."
    )
    assert said in first
    assert first.index(said) < first.index("Backlash of joint 2:")
    assert "more than noise, most where joint 2 is between 20 and 45 deg" in section
    assert "The model as a whole:" in section
    alone, section = told(with_diagnosis(small, MISFIT))
    assert "No cause explains what is left: 41 causes were tested." in alone
    assert "Usable for the poses, tools and loads that were measured; a part of the error is unexplained." in alone
    assert "Why more is left than noise: no cause explains it." in first
    assert "coming back to some poses from elsewhere" in alone
    assert "No cause: 41" not in alone
    assert "Nothing was found" not in section
    both, _ = told(with_diagnosis(small, MISFIT, COUPLED))
    assert "an error depends on the angles of joints 2 and 3: no cause is certain." in both


def test_a_cause_without_gain_is_not_credited(small: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fails if what gains nothing stands among what explains the error, or a loss or a larger gain hides behind another."""
    vain = replace(STEP, gain=(0.03, -0.01, 0.07))
    small_gain = replace(BACKLASH, gain=(0.01, 0.005, 0.015))
    large = Found("named", "gear-ratio-error", 3, 1e-4, 1e-6, "1", gain=(0.2, 0.1, 0.3))
    loss = Found("named", "joint-eccentricity", 1, 1e-4, 1e-6, "rad", gain=(-0.02, -0.03, -0.01))
    results = with_diagnosis(small, vain, small_gain, large, loss).results
    assert lacked(RunOutcome(results)) == [
        ("Gear ratio error of joint 3:", "100.0 ± 1.0 µrad/rad; it takes 0.200 mm off the mean error."),
        ("Backlash of joint 2:", "100.0 ± 4.0 µrad; it takes 0.010 mm off the mean error."),
        (
            "In the model, without a gain at held-out poses:",
            "step of the measuring set-up (after row 12 in measuring order).",
        ),
        ("In the model, with a loss at held-out poses:", "eccentricity of joint 1 (0.020 mm)."),
    ]
    monkeypatch.setattr("calflow.reporting.sections.verdict.CAUSES_LISTED", 1)
    assert lacked(RunOutcome(results))[:2] == [
        ("Gear ratio error of joint 3:", "100.0 ± 1.0 µrad/rad; it takes 0.200 mm off the mean error."),
        ("And 1 more cause:", "backlash of joint 2."),
    ]


def test_a_search_that_ended_at_its_most_causes_says_so(small: Context) -> None:
    """Fails if the cap of causes is reached in silence."""
    results = with_diagnosis(small, BACKLASH).results
    document_ = dict(results.documents["diagnose/summary.json"]) | {"capped": True}
    capped = results | Results({}, {"diagnose/summary.json": document_})
    assert "As many causes were found as were allowed" in lacked(RunOutcome(capped))[-1]
    assert len(lacked(RunOutcome(results))) == 1


def test_nothing_found_without_a_known_noise_says_what_could_not_be_seen(tmp_path: Path) -> None:
    """Fails if silence about a lack of fit that nobody could test reads as there being none."""
    first, section = told(with_diagnosis(context(tmp_path, Case(stated=False))))
    for text in (first, section):
        assert "the noise was estimated from the fit, so a gap in the model cannot be seen beside it" in text.lower()


def test_a_name_beside_the_unexplained_along_its_input_is_not_told_as_sure(small: Context) -> None:
    """Fails if a cause counts as certain although what nobody can name depends on the same joint."""
    context = with_diagnosis(small, replace(BACKLASH, status="one_of"), COUPLED)
    table = context.tables["diagnose/findings.csv"]
    table["cannot_tell_from"] = table["cannot_tell_from"].astype(object)
    table.loc[table["cause"] == "joint-backlash", "cannot_tell_from"] = "unexplained"
    first, section = told(context)
    assert "something that no cause explains depends on the same input" in section
    assert "Whether backlash of joint 2 is real or part of the unexplained error." in first
    assert "Nothing else that was tested" not in section


def test_a_fault_of_the_data_is_told_without_a_size(small: Context) -> None:
    """Fails if a fault, which has neither size nor gain, breaks the section or counts as a cause."""
    _, section = told(with_diagnosis(small, OUTLIERS, BACKLASH))
    assert "Faults of the data (outlier) were dealt with first" in section
    assert "1. Backlash of joint 2" in section
    assert "nan" not in section
    _, section = told(with_diagnosis(small, OUTLIERS))
    assert "Nothing was found that the model lacks." in section


def test_nothing_found_is_said_and_nothing_else_is_shown(small: Context) -> None:
    """Fails if an empty diagnosis reads as if something had been found, or breaks."""
    first, section = told(with_diagnosis(small))
    assert "Nothing was found that the model lacks." in section
    assert "No cause: 41 causes were tested." in first
    assert "does not prove" not in section


def test_without_the_tables_of_diagnose_the_first_page_does_not_speak_of_causes(small: Context) -> None:
    """Fails if a run without diagnose claims that anything was looked for."""
    material = report_material(small.study, small.results, small.run_folder)
    with style():
        parts = [(section.title, section.write(material)) for section in chosen(sections(), material)]
    assert "lacked" not in document.source("", parts)


def test_what_could_not_be_tested_is_listed_by_what_it_needs(small: Context) -> None:
    """Fails if a cause that nobody could test is taken for one that is not there."""
    _, section = told(with_diagnosis(small))
    assert "bending of links 1 and 2." in section
    assert "Needs a column temperature_degC (that changes), or time_s:" in section
    groups = untestable(RunOutcome(with_diagnosis(small).results).candidates)
    assert list(groups) == [
        "",
        "a column temperature_degC (that changes), or time_s",
    ]  # nothing: the model's own parameters imitate it


def test_how_small_a_cause_the_data_show_is_told_by_joint(small: Context) -> None:
    """Fails if limits are not told, in another unit than the heading's, or as powers of ten."""
    _, section = told(with_diagnosis(small))
    below = section.partition("Detection limits")[2]
    row = next(line for line in below.splitlines() if "Gear ratio error" in line)
    assert all(f'[#"{cell}";]' in row for cell in ("µrad/rad", "120", "250", "370"))
    bending = next(line for line in below.splitlines() if '"Bending"' in line)
    assert all(f'[#"{cell}";]' in bending for cell in ("MNm²", "2.5"))  # as findings state it: a stiffness


@pytest.mark.parametrize("case", [Case(holdout=0.0), Case(stated=False)], ids=["none held out", "noise unknown"])
def test_a_report_is_written_whatever_is_known(case: Case, tmp_path: Path) -> None:
    """Fails if gains that are not known, or a missing noise floor, break a section or are told as numbers."""
    found = replace(BACKLASH, gain=NO_GAIN) if not case.holdout else BACKLASH
    given = with_diagnosis(context(tmp_path, case), found, COUPLED)
    material = report_material(given.study, given.results, given.run_folder)
    every = {section.title: written(section, material) for section in chosen(sections(), material)}
    section = every["What the model lacked: causes"]
    assert ("No poses were held out" in section) == (not case.holdout)
    assert ("It takes 0.040 mm off" in section) == bool(case.holdout)


@pytest.fixture(scope="module")
def reported(small: Context, tmp_path_factory: pytest.TempPathFactory) -> Context:
    """A report, in the context's folder, of a deployed cause, a suspicion and something unexplained, sampled."""
    from calflow.stages.report import STAGE

    given = with_diagnosis(small, OR_HYSTERESIS, replace(STEP, gain=(0.07, 0.05, 0.09)), COUPLED)
    table = given.tables["diagnose/findings.csv"].assign(deployed=[True, False, False])
    given = with_sample(replace(given, results=given.results | Results({"diagnose/findings.csv": table})))
    given = replace(given, folder=tmp_path_factory.mktemp("reported"))
    STAGE.run(given)
    return given


def test_the_report_is_set_with_causes_and_a_sampled_extended_model(reported: Context) -> None:
    """Fails if typst refuses the section, or the posterior is not that of the extended model."""
    assert (reported.folder / "report.pdf").read_bytes().startswith(b"%PDF")
    drawn = {path.stem for path in (reported.folder / "figures").iterdir()}
    assert {"cause_1", "cause_2", "error_budget", "evidence", "error_distribution", "traces"} <= drawn


def test_a_gain_is_the_same_wherever_it_is_printed(reported: Context) -> None:
    """Fails if the terminal, the table, the PDF or the page tell another gain of a cause, or one of a suspicion."""
    pdf = "\n".join(pages_of((reported.folder / "report.pdf").read_bytes()))
    html = (reported.folder / "report.html").read_text(encoding="utf-8")
    (kept,) = [row for row in RunOutcome(reported.results).findings if row.deployed]
    texts = ("\n".join(last_lines(RunOutcome(reported.results))), pdf, re.sub(r"<[^>]*>", " ", html))
    for text in texts:
        said = re.findall(r"takes\s+([\d.]+)\s+mm\s+off", text)
        assert set(said) == {f"{kept.gain_mean_mm:.3f}"}
        assert "left out of the model" in " ".join(text.split())


def test_a_posterior_without_the_maps_is_told_as_such(small: Context, tmp_path: Path) -> None:
    """Fails if the chain of a model whose curves were held is read as one of the whole model, or nobody says so."""
    given = with_sample(with_diagnosis(small, BACKLASH, CURVE))
    material = report_material(given.study, given.results, given.run_folder)
    held = sum(parameter.effect == "joint-error-map" for parameter in material.calibrated.model.parameters)
    assert held > 20
    assert len(material.sampled[0].estimate) == len(material.calibrated.estimate) - held
    with style():
        (section,) = [section for section in chosen(sections(), material) if "posterior" in section.title]
        text = document.source("", [("", section.write(material))])
    assert "too many parameters to sample: angle error curve of joint 2" in text


def test_errors_and_accuracy_are_those_of_the_extended_model(small: Context) -> None:
    """Fails if the first page goes on telling what the study's own model reached."""
    given = with_diagnosis(small, BACKLASH)
    material = report_material(given.study, given.results, given.run_folder)
    before = small.tables["identify/residuals.csv"][["dx_mm", "dy_mm", "dz_mm"]]
    np.testing.assert_allclose(material.error, 0.5 * before)
    assert material.calibrated.model.parameters[-1].effect == "joint-backlash"
    table = given.tables["diagnose/accuracy.csv"]
    first, _ = told(given)
    last = table[table["split"] == "holdout"]["mean_mm"].iloc[-1]
    assert f"{last:.3f}" in first[first.index("mean error now") :][:100]


def test_many_causes_are_cut_on_the_first_page(small: Context) -> None:
    """Fails if the list of causes pushes everything else off the first page."""
    many = [Found("named", "gear-ratio-error", k, 1e-4, 1e-6, "1") for k in (1, 2, 3)]
    said = lacked(RunOutcome(with_diagnosis(small, *many, STEP, BACKLASH, ORDER_OPEN).results))
    assert len(said) == 5
    assert said[-1] == ("And 2 more causes:", "backlash of joint 2 and transmission error of joint 2.")


def test_causes_of_the_same_name_are_told_by_their_detail(small: Context) -> None:
    """Fails if two steps of the device, at different moments, read as one."""
    results = with_diagnosis(small, STEP, replace(STEP, detail="after row 20 in measuring order")).results
    assert [head for head, _ in lacked(RunOutcome(results))] == [
        "Step of the measuring set-up (after row 12 in measuring order):",
        "Step of the measuring set-up (after row 20 in measuring order):",
    ]


def test_causes_that_harm_unseen_poses_are_not_to_be_used(small: Context) -> None:
    """Fails if a model that got worse at held-out poses is called calibrated."""
    given = with_diagnosis(small, BACKLASH)
    table = given.tables["diagnose/accuracy.csv"]
    table.loc[table["model"] == table["model"].iloc[-1], "mean_mm"] *= 2
    first, _ = told(given)
    assert "Do not use this model: see what to do next." in first
    assert "Do not use the model with the causes: at held-out poses it is worse than without them" in first


@pytest.mark.parametrize(
    ("gain", "words"),
    [
        (
            (0.041, 0.024, 0.056),
            "it takes 0.041 mm off the mean error at held-out poses (95 % interval 0.024 to 0.056 mm)",
        ),
        ((-0.012, -0.046, 0.024), "it gains nothing for certain at held-out poses (95 % interval −0.046 to 0.024 mm)"),
        ((-0.03, -0.05, -0.01), "it makes the mean error at held-out poses 0.030 mm larger"),
        (NO_GAIN, "no poses were held out"),
    ],
)
def test_a_gain_is_told_as_what_its_interval_allows(
    small: Context, gain: tuple[float, float, float], words: str
) -> None:
    """Fails if a gain that may be nothing is told as a gain."""
    (found,) = RunOutcome(with_diagnosis(small, replace(BACKLASH, gain=gain)).results).findings
    assert gain_words(found).startswith(words)


def test_sureness_is_told_for_each_status(small: Context) -> None:
    """Fails if a set of causes is told as a single one."""
    one = [
        RunOutcome(with_diagnosis(small, found).results).findings[0] for found in (BACKLASH, OR_HYSTERESIS, ORDER_OPEN)
    ]
    assert "Nothing else" in name_certainty(one[0], one[0].kin)
    assert "Its name is not certain" in name_certainty(one[1], one[1].kin)
    assert "its exact form. Periodic error and angle error curve would fit" in name_certainty(one[2], one[2].kin)
    coarse = RunOutcome(with_diagnosis(small, replace(ORDER_OPEN, rivals="")).results).findings[0]
    assert coarse.name == "transmission error of joint 2"
    assert "would fit as well" not in name_certainty(coarse, coarse.kin)
    assert unsure(RunOutcome(with_diagnosis(small, BACKLASH).results)) == []


def test_several_causes_told_as_one_curve_of_a_torque_say_so(small: Context) -> None:
    """Fails if a torque's curve is told as one of the angle, or its number of causes as known."""
    both = Found("one_of", "nonlinear-joint-stiffness", 2, 1e-3, 1e-5, "rad", rivals="torque-backlash 2")
    (found,) = RunOutcome(with_diagnosis(small, both).results).findings
    found = replace(found, numbers=(1, 2))
    assert found.name == "nonlinear compliance of joint 2"
    certainty = name_certainty(found, found.kin)
    assert "depends on the joint's load" in certainty
    assert certainty.endswith("its exact form or whether it is one cause or several.")


def test_what_may_be_an_unexplained_error_is_not_told_as_certain(small: Context) -> None:
    """Fails if a line says a cause's probability among the named ones where an error without a name may be all of it."""
    results = with_diagnosis(small, Found("one_of", "axis-wobble", 2, 4e-4, 3e-5, "rad")).results
    table = results.tables["diagnose/findings.csv"].assign(cannot_tell_from="unexplained")
    told = last_lines(RunOutcome(replace(results, tables={**results.tables, "diagnose/findings.csv": table})))
    (line,) = (line for line in told if line.startswith("found: "))
    assert line.startswith("found: axis wobble of joint 2 or something unexplained, 400 ± 30 µrad")
    assert "probability" not in line


def test_a_step_is_told_with_its_moment_though_a_drift_may_look_like_it() -> None:
    """Fails if a user is not told after which rows to look for what happened, where steps and drifts are one family."""
    steps = Finding(status="one_of", cause="frame-step", detail="after row 75", numbers=(1, 2), statement="")
    assert steps.names == (
        "drift of the measuring set-up or the robot's foot (best described as step of the measuring set-up after row 75)"
    )


def test_doubt_about_a_part_of_a_certain_curve_is_not_told_of_the_whole(small: Context) -> None:
    """Fails if rivals of one of several waves make a curve that is there for certain one of several causes."""
    (found,) = RunOutcome(with_diagnosis(small, ORDER_OPEN).results).findings
    rivals = Finding.of_rivals([NamedCause("nonlinear-joint-stiffness", 3)])
    found = replace(found, numbers=(1, 2), family_probability=0.99, **rivals)
    assert found.names == "transmission error of joint 2 (a part of it may be nonlinear stiffness of joint 3)"
    assert "A part of it may be another cause: nonlinear stiffness of joint 3 explains" in name_certainty(
        found, found.kin
    )
    assert replace(found, numbers=(1,)).names.endswith("of joint 2 or nonlinear stiffness of joint 3")


def test_a_family_is_told_by_those_of_it_that_the_data_could_have() -> None:
    """Fails if a report of positions says that a camera that slipped, or a lens, would fit as well."""
    beside = ("stand-growth", "frame-drift", "camera-slip", "session-frame")
    rivals = Finding.of_rivals([NamedCause("stand-growth", 0), NamedCause("unexplained", 0)])
    step = Finding(status="one_of", cause="frame-step", statement="", **{**rivals, "cannot_tell_from": beside})
    rows = [
        CandidateRow(cause="frame-drift", delta_bic=-20.0, p_family=1e-6),
        CandidateRow(cause="camera-slip", detail="not tested: no target is photographed"),
    ]
    assert fitting_kin(step, rows) == ["stand-growth", "frame-drift"]
    told = name_certainty(step, ["stand-growth", "frame-drift"])
    assert (
        "Growth of the device's stand or the robot's foot and drift of the measuring set-up would fit as well." in told
    )


def test_a_part_that_may_be_unexplained_is_told_as_that(small: Context) -> None:
    """Fails if a part that may belong to the unexplained error is said to be another cause that may belong to it."""
    (found,) = RunOutcome(with_diagnosis(small, ORDER_OPEN).results).findings
    found = replace(found, numbers=(1, 2), family_probability=0.99, **Finding.of_rivals([NamedCause("unexplained", 0)]))
    assert "A part of it may belong to the unexplained error (probability of" in name_certainty(found, ())


@pytest.mark.parametrize(
    ("cause", "estimate", "sd", "unit", "words"),
    [
        ("joint-backlash", 1.2e-4, 4e-6, "rad", "120.0 ± 4.0 µrad"),
        ("gravity-deflection", 3.79e-3, 1.1e-5, "rad", "3.790 ± 0.011 mrad"),
        ("tool-deflection", 4e-7, 1e-8, "m/N", "3.923 ± 0.098 µm/kg"),
        ("payload-mass", 0.156, 0.012, "1", "15.6 ± 1.2 %"),
        ("wrist-coupling", 1.9e-4, 3e-5, "1", "190 ± 30 µrad/rad"),
        ("thermal-growth", 2.33e-5, 9e-7, "1/K", "23.30 ± 0.90 µm/m per °C"),
        ("frame-drift", 1.1e-7, 3.2e-9, "m/s", "0.396 ± 0.012 mm/h"),
        ("base-compliance", 3e-8, 2e-9, "rad/Nm", "30.0 ± 2.0 µrad/kNm"),
        ("link-bending", 4e-7, 1.6e-8, "1/Nm2", "2.50 ± 0.10 MNm²"),
        ("gravity-compensator", 5400.0, 300.0, "Nm", "5.40 ± 0.30 kNm"),
        ("frame-step", 3e-4, float("nan"), "m", "0.3 mm"),
        ("something-new", 2.5, 0.1, "bar", "2.50 ± 0.10 bar"),
    ],
)
def test_sizes_are_in_units_that_an_engineer_reads(
    cause: str, estimate: float, sd: float, unit: str, words: str
) -> None:
    """Fails if a size is off by a factor, or stands in SI."""
    assert amount(cause, estimate, sd, unit) == words


@pytest.mark.parametrize(
    ("cause", "size", "unit", "words"),
    [
        ("joint-eccentricity", (1.14e-4, 1.16e-4, 9.8e-5, 4.4e-4), "rad", "98 to 440 µrad (95 %)"),
        ("gravity-deflection", (2.5e-3, 2e-3, 5e-4, 6e-3), "rad", "0.5 to 6 mrad (95 %)"),
        ("link-bending", (4e-7, 3e-7, 2e-7, 1e-6), "1/Nm2", "1 to 5 MNm² (95 %)"),
        ("joint-backlash", (-1e-5, 1e-5, -3e-5, 1e-5), "rad", "−10 ± 10 µrad"),
        ("joint-eccentricity", (3.85e-4, 1.1e-5, 3.6e-4, 4.1e-4), "rad", "385 ± 11 µrad"),
    ],
)
def test_a_deviation_that_would_reach_zero_gives_way_to_the_interval(
    cause: str, size: tuple[float, ...], unit: str, words: str
) -> None:
    """Fails if a size that cannot be zero is followed by a deviation as large as it, or any other size by more than that."""
    estimate, sd, low, high = size
    finding = Finding(
        status="named", cause=cause, estimate=estimate, sd=sd, unit=unit, low=low, high=high, statement=""
    )
    assert finding.amount == words


def test_units_survive_a_csv(small: Context) -> None:
    """Fails if the unit 1, which pandas reads as a number, is shown as 1.0."""
    given = with_diagnosis(small, Found("named", "gear-ratio-error", 1, 5e-4, 1e-6, "1"), COUPLED)
    table = given.tables["diagnose/findings.csv"]
    table["unit"] = pd.to_numeric(table["unit"])
    assert RunOutcome(given.results).findings[0].amount == "500.0 ± 1.0 µrad/rad"


def test_chances_are_told_in_words_that_do_not_overstate() -> None:
    """Fails if a p-value is told as zero, or a probability as certain."""
    assert chance(1e-200) == "less than one in a million"
    assert chance(0.000321) == "about one in 3,100"
    assert chance(0.0069) == "about one in 140"
    assert chance(0.25) == "about 25 %"
    assert chance(float("nan")) == "unknown"
    assert (chance_figure(0.0), chance_figure(0.0069), chance_figure(float("nan"))) == ("< 10⁻⁶", "0.0069", "–")
    assert (sureness(0.99999), sureness(0.5), sureness(float("nan"))) == ("> 99 %", "50 %", "–")


def test_causes_have_a_name_with_their_place() -> None:
    """Fails if a reader is shown an id, or a link is called a joint."""
    assert cause_name("joint-backlash", 2) == "backlash of joint 2"
    assert cause_name("link-bending", 4) == "bending of link 4"
    assert place_name("payload-mass", 0, "half") == "payload mass error (half)"
    assert place_name("payload-mass", 0, "payloads") == "payload mass error"
    assert place_names("bearing-compliance", [(1, "joint1"), (3, "joint3")]) == "bearing tilt of joints 1 and 3"
    assert place_name("periodic-joint-error", 2, "joint2") == "periodic error of joint 2"
    assert cause_name("something-new", 3) == "something new of joint 3"


def test_every_effect_of_the_catalogue_has_words() -> None:
    """Fails if an effect is added and the report can only show its title."""
    assert [name for name, kind in catalogue().items() if kind.words is None] == []
    assert all(kind.words.name and kind.words.what and kind.words.size for kind in catalogue().values())


@cache
def _drawings() -> dict[str, Figure]:
    rng = np.random.default_rng(0)
    held = np.arange(90) % 4 == 0
    x, noise = np.linspace(-2.5e4, 2.5e4, 90), 0.03 * rng.standard_normal(90)
    side = np.where(np.arange(90) % 2, 1.0, -1.0)
    curve, cloud = np.sin(x / 8e3), rng.standard_normal(90)
    with style():
        return {
            "a line": explained_figure(x, curve + noise, noise, curve, held, "moment across the axis of joint 2", "Nm"),
            "crosses": explained_figure(x, cloud + noise, noise, cloud, held, "angle of joint 2", "deg"),
            "groups": explained_figure(side, side + noise, noise, side, held, "approach of joint 2", ""),
            "budget": error_budget(["Nominal", "Geometry", "+ sag"], [0.3, 0.1, 0.12], 0.05, "mm", "held out"),
            "budget, decades": error_budget(["Nominal", "Geometry"], [31.0, 0.05], None, "mm", "held out"),
            "evidence": evidence(pd.DataFrame({"cause": ["Backlash of joint 2", "Sag"], "evidence": [80.0, -3.0],
                                               "chance_of_a_false_alarm": [1e-9, 0.4], "in_the_model": [True, False]})),
            "none held out": explained_figure(side, side + noise, noise, side, held & False, "payload", "kg"),
        }  # fmt: skip


def _tick_labels(axis: Axis) -> list[Text]:
    """The tick labels of an axis that are seen."""
    low, high = sorted(axis.get_view_interval())
    margin = 1e-9 * (high - low)
    labels = [tick.label1 for tick in axis.get_major_ticks() if low - margin <= tick.get_loc() <= high + margin]
    return [label for label in labels if label.get_visible() and label.get_text().strip()]


def _has_names(axes: Axes) -> bool:
    """Whether names stand along the vertical axis in the place of numbers."""
    return any(label.get_text().strip("−-.0123456789") for label in _tick_labels(axes.yaxis))


@pytest.mark.parametrize("name", _drawings())
def test_figures_have_labels_and_nothing_is_cut_off(name: str) -> None:
    """Fails if an axis has no label, text reaches beyond the figure, or labels of one axis lie on each other."""
    drawn = _drawings()[name]
    with style():
        canvas = FigureCanvasAgg(drawn)
        canvas.draw()
        renderer = canvas.get_renderer()
        seen = [*drawn.texts, *(text for legend in drawn.legends for text in legend.get_texts())]
        for axes in (axes for axes in drawn.axes if axes.axison):
            ticks = [_tick_labels(axis) for axis in (axes.xaxis, axes.yaxis)]
            sharing = axes.get_shared_y_axes().get_siblings(axes)
            assert axes.get_xlabel() or axes.get_label() == "<colorbar>"
            assert any(other.get_ylabel() or _has_names(other) for other in sharing)
            for labels in ticks:
                boxes = [label.get_window_extent(renderer) for label in labels]
                assert not any(a.overlaps(b) for k, a in enumerate(boxes) for b in boxes[k + 1 :]), [
                    label.get_text() for label in labels
                ]
            seen += [*ticks[0], *ticks[1], *axes.texts, axes.title, axes.xaxis.label, axes.yaxis.label]
        for text in seen:
            box = text.get_window_extent(renderer)
            inside = box.x0 > -1 and box.y0 > -1 and box.x1 < drawn.bbox.x1 + 1 and box.y1 < drawn.bbox.y1 + 1
            assert inside or not text.get_text().strip(), (text.get_text(), box)


@pytest.mark.parametrize("sizes", [(28, 6, 2, 1), (3, 1, 1, 1), (28, 6, 6, 120)])
def test_effects_with_few_parameters_are_named_apart(sizes: tuple[int, ...]) -> None:
    """Fails if the names of narrow groups of parameters lie on each other or beyond the figure."""
    groups = ("geometry", "joint-compliance", "gravity-compensator", "nonlinear-joint-stiffness")
    effects = [effect for effect, size in zip(groups, sizes, strict=True) for _ in range(size)]
    zero = np.zeros(len(effects))
    with style():
        drawn = estimates([f"joint2.{k}" for k in range(len(effects))], effects, zero, zero + 1, zero > 0)
        canvas = FigureCanvasAgg(drawn)
        canvas.draw()
        boxes = [text.get_window_extent(canvas.get_renderer()) for text in drawn.axes[0].texts]
    assert len(boxes) == len(groups)
    assert all(a.x1 < b.x0 for a, b in pairwise(boxes))
    assert boxes[0].x0 > 0
    assert boxes[-1].x1 < drawn.bbox.x1
