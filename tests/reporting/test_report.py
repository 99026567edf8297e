"""The report as a whole: it is built from whatever tables there are, twice the same, and says what they say."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import typst

from calflow.deployment.run_outcome import RunOutcome
from calflow.design.isolability import IsolabilityCell
from calflow.estimation import fit
from calflow.estimation.calibrated_model import Alternative
from calflow.estimation.certainty import Certainty
from calflow.estimation.error_model import ErrorModel
from calflow.estimation.noise import PerUnit
from calflow.files.tables import Results, to_frame
from calflow.files.units import METRE, PIXEL
from calflow.files.words import mm
from calflow.observations.camera import Camera
from calflow.reporting import document
from calflow.reporting.advice import advice
from calflow.reporting.blocks import Block, Bullets, Divider, Gap, Heading, Paragraph, Plot, RestOfPage, Table
from calflow.reporting.section import Section, sections
from calflow.reporting.sections import residuals
from calflow.reporting.sections.accuracy import certainty_words
from calflow.reporting.sections.isolability import MOST, near_figure, near_rivals
from calflow.reporting.sections.parameters import parameters_section
from calflow.reporting.sections.posterior import posterior_section
from calflow.reporting.style import style
from calflow.stages.report import STAGE, report_material
from calflow.stages.stage import Context
from reporting.case import Case, changed, chosen, context, with_sample, with_select
from reporting.pdf import filled, pages_of


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Context:
    return context(tmp_path_factory.mktemp("small"))


@pytest.fixture(scope="module")
def whole(small: Context) -> Context:
    return with_sample(with_select(small))


@pytest.fixture(scope="module")
def files(whole: Context, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    return built(whole, tmp_path_factory.mktemp("whole"))


@pytest.fixture(scope="module")
def text(small: Context) -> str:
    """The whole source of the small report."""
    return source_of(small)


def source_of(given: Context) -> str:
    """The typst source, with everything that its string literals hide unescaped."""
    material = report_material(given.study, given.results, given.run_folder)
    with style():
        parts = [(section.title, section.write(material)) for section in chosen(sections(), material)]
    return document.source(material.title, parts).replace('\\"', '"').replace("\\\\", "\\")


def built(given: Context, folder: Path) -> dict[str, bytes]:
    assert STAGE.run(replace(given, folder=folder)) == Results()
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_same_tables_give_the_same_bytes_and_nothing_is_fitted(
    whole: Context, files: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fails if bytes depend on when they are written, or a page is drawn of anything that it fits itself."""
    monkeypatch.delattr(fit, "_solver")
    again = built(whole, tmp_path / "again")
    assert again.keys() == files.keys()
    assert [name for name in files if files[name] != again[name]] == []
    assert b"CreationDate" not in files["report.pdf"]


def test_nothing_but_the_report_and_its_figures_is_written(files: dict[str, bytes]) -> None:
    assert {name for name in files if not re.fullmatch(r"figures/\w+\.svg", name)} == {"report.pdf", "report.html"}
    assert {"pose_errors", "region", "residuals_joints", "traces", "corner"} <= {Path(name).stem for name in files}


def test_numbers_of_the_accuracy_table_are_told(small: Context, text: str) -> None:
    accuracy = small.tables["identify/accuracy.csv"]
    for row in accuracy.to_dict("records"):
        assert f'"{row["mean_mm"]:.3f}"' in text
        assert f'"{row["max_mm"]:.3f}"' in text
    held = accuracy[accuracy["split"] == "holdout"]
    card = text[text.index("mean error now") :][:200]
    assert mm(held["mean_mm"].iloc[-1]) in card
    assert f"largest {mm(held['max_mm'].iloc[-1])} mm" in card


@pytest.mark.parametrize("number", [1, 12, 60])
def test_what_fills_the_rest_of_a_page_stays_on_it(number: int) -> None:
    """Fails if a long list spills onto a second page, or what follows does not begin a new one."""
    lists = RestOfPage(
        [Heading("What to do next"), Bullets([f"{k}: {'so much to do ' * 15}" for k in range(number)], None)]
    )
    text = document.source("t", [("Verdict", [Paragraph("Calibration report"), Gap(300), lists]), ("Next", [])])
    pages = typst.compile(text.encode(), format="svg", ignore_system_fonts=True)
    assert isinstance(pages, list)
    assert len(pages) == 2


@pytest.mark.parametrize(("first", "pages"), [([Paragraph("short")], 1), ([RestOfPage([Paragraph("short")])], 2)])
def test_a_short_report_stands_on_one_page(first: list[Block], pages: int) -> None:
    """Fails if a page is left half empty below a first part that does not ask for the whole of it, or one that does shares it."""
    text = document.source("t", [("", first), ("Next", [Paragraph("short, too")])])
    made = typst.compile(text.encode(), format="svg", ignore_system_fonts=True)
    assert (len(made) if isinstance(made, list) else 1) == pages


@pytest.mark.parametrize("before", [3, 20, 30])
def test_no_few_lines_stand_alone_on_the_last_page(before: int) -> None:
    """Fails if the last section leaves a few rows on a page of their own, or the page before it more than half empty."""
    for rows in range(20, 140, 15):
        table = Table(("what", "value"), [(f"fact {k:03}", "so it is") for k in range(rows)], "ll", size=None)
        parts = [
            ("Verdict", [RestOfPage([])]),
            ("Tables", [Paragraph("said so it is") for _ in range(before)]),
            ("Facts", [table]),
        ]
        pages = typst.compile(document.source("t", parts).encode(), format="svg", ignore_system_fonts=True)
        assert isinstance(pages, list)
        lines = [page.decode().count("<use") / len("fact000soitis") for page in pages[1:]]
        assert lines[-1] > 12, (rows, lines)
        assert min(lines[:-1], default=30) > 25, (rows, lines)


def test_pages_settle_wherever_the_divider_falls() -> None:
    """Fails if a divider moves to the next page only while it is not there: figures and pages then have no numbers."""
    for lines in range(18, 34):
        parts = [
            ("Verdict", [RestOfPage([])]),
            ("Lines", [Paragraph("so it is") for _ in range(lines)]),
            ("For experts", [Divider("For experts", "what follows")]),
            ("Next", [Paragraph("more") for _ in range(60)]),
        ]
        _, warnings = typst.compile_with_warnings(document.source("t", parts).encode(), ignore_system_fonts=True)
        assert not warnings, (lines, warnings)


def test_no_page_but_the_last_is_under_half_full(files: dict[str, bytes]) -> None:
    """Fails if a figure that has no room leaves a page more than half empty."""
    assert min(filled(files["report.pdf"])[:-1]) > 0.5


def test_a_reader_of_the_pdf_finds_the_numbers_and_names(small: Context, files: dict[str, bytes]) -> None:
    text = "\n".join(pages_of(files["report.pdf"]))
    held = small.tables["identify/accuracy.csv"].query("split == 'holdout'")
    assert f"{held['mean_mm'].iloc[-1]:.3f}" in text
    assert r'Arm_1 *bold* #let $x^2$ @ref <label> "quoted" \\ [x] // end' in text
    assert "T_*a*$#@<b>.x" in text


@pytest.mark.parametrize("name", ['$x^2$ *b* _i_ #set @a <b> "q" \\', "a\nb", "'", "]", "// no comment", "1. - + = /"])
def test_text_is_shown_letter_by_letter(name: str) -> None:
    literal = document.plain(name)
    inside = literal.removeprefix('#"').removesuffix('";')
    assert re.fullmatch(r'(?:[^"\\\n]|\\["\\])*', inside)
    assert inside.replace('\\"', '"').replace("\\\\", "\\") == name.replace("\n", " ")


def test_sections_are_left_out_without_their_tables(small: Context, whole: Context) -> None:
    def titles(given: Context) -> list[str]:
        return [
            section.title
            for section in chosen(sections(), report_material(given.study, given.results, given.run_folder))
        ]

    assert set(titles(whole)) - set(titles(small)) == {
        "How sure: the sampled posterior", "Which causes: all models in reach"
    }  # fmt: skip
    assert titles(whole)[0] == "Verdict"
    assert "Planned poses" in titles(replace(whole, results=whole.results.of({"select"})))  # nothing is measured yet
    assert titles(whole)[-1].startswith("Appendix")


def test_every_section_has_a_place_of_its_own() -> None:
    found = sections()
    assert all(isinstance(section, Section) for section in found)
    assert len({section.order for section in found}) == len(found)


def test_the_chain_is_drawn_in_the_parameters_own_units(whole: Context) -> None:
    from calflow.reporting.sections.posterior import walkers_shown
    from calflow.sampling.log_posterior import log_posterior_of

    material = report_material(whole.study, whole.results, whole.run_folder)
    values, steps = walkers_shown(whole.run_folder / "sample" / "chain.h5", material)
    parameters = whole.tables["identify/parameters.csv"]
    k = int(np.flatnonzero(parameters["parameter"] == "joint2.a")[0])
    _, laplace = log_posterior_of(
        material.sampled[0], material.data
    )  # the made-up estimate is not the posterior's mode
    sd = np.sqrt(laplace.covariance[k, k])
    kept = steps >= material.chain_summary.burn_in_steps
    drawn = values[:, kept][..., [k, len(parameters)]].reshape(-1, 2)
    assert drawn[:, 0].mean() == pytest.approx(laplace.mean[k], abs=0.1 * sd)
    assert drawn[:, 0].std() == pytest.approx(sd, rel=0.15)
    assert drawn[:, 1].mean() == pytest.approx(1.0, abs=0.15)


def test_a_parameter_that_the_prior_alone_determines_is_told(whole: Context) -> None:
    """Fails if a prior is shown as a result, or a measured parameter is called a prior."""
    words = "your prior, not your data"
    assert words not in source_of(whole)
    table = whole.tables["sample/posterior.csv"].copy()
    table.loc[table["parameter"] == "joint2.a", ["prior_sensitivity", "likelihood_sensitivity"]] = 0.08, 0.02
    table.loc[table["parameter"] == "joint3.a", ["prior_sensitivity", "likelihood_sensitivity"]] = 0.09, 0.06
    told = source_of(replace(whole, results=whole.results | Results({"sample/posterior.csv": table})))
    assert f"joint2.a: this is {words}" in told
    assert "joint3.a: prior and data both count" in told


def test_a_sampled_run_without_its_chain_is_reported(
    whole: Context, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fails if the chain's figures are drawn or kept without it, or nothing is; what else the report has is left out here."""
    monkeypatch.setattr(document, "sections", lambda: [parameters_section, posterior_section])
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "traces.svg").touch()  # of an earlier report, which had a chain
    files = built(replace(whole, run_folder=tmp_path / "elsewhere"), tmp_path)
    assert "figures/parameters.svg" in files
    assert "figures/traces.svg" not in files


def test_bare_and_oriented_data_are_reported(tmp_path: Path) -> None:
    """Fails if a section needs a payload, a stated noise or held-out poses, or cannot do with orientations."""
    given = with_sample(context(tmp_path, Case(payload=False, stated=False, holdout=0.0, oriented=True)))
    assert "mrad" in source_of(given)


def test_without_heldout_poses_the_report_says_so(tmp_path: Path) -> None:
    text = source_of(context(tmp_path, Case(holdout=0.0)))
    assert "the fitted poses, as none were held out" in text
    assert "flatters the model" in text


def test_no_noise_floor_is_claimed_where_only_the_fit_tells_the_noise(text: str, tmp_path: Path) -> None:
    assert "it alone would give" not in source_of(context(tmp_path, Case(stated=False)))
    assert "it alone would give" in text


def test_noise_floor_is_the_mean_length_of_the_noise(small: Context) -> None:
    material = report_material(small.study, small.results, small.run_folder)
    noise = 0.05 * np.random.default_rng(0).standard_normal((200_000, 3))
    assert material.certainty.noise_floor == pytest.approx(np.linalg.norm(noise, axis=1).mean(), rel=0.01)


def test_of_very_many_rows_some_are_drawn_and_the_worst(small: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fails if a page carries a million rows, a largest error is not drawn, or nobody is told that others are not."""
    material = report_material(small.study, small.results, small.run_folder)
    assert material.drawn.tolist() == list(range(len(material.data)))
    assert material.drawn_words == ""
    monkeypatch.setattr("calflow.reporting.material.DRAWN", 12)
    monkeypatch.setattr("calflow.reporting.material.WORST", 3)
    crowd = report_material(small.study, small.results, small.run_folder)
    assert set(np.argsort(crowd.distance)[-3:]) <= set(crowd.drawn)
    assert 12 <= len(crowd.drawn) <= 15
    with style():
        drawn = [block for block in residuals.residuals_section.write(crowd) if isinstance(block, Plot)]
    assert {len(plot.data) for plot in drawn} == {len(crowd.drawn)}
    assert f"Of {len(crowd.data)} rows 12 are drawn, at random, and the 3 of the largest errors" in drawn[0].caption
    scene = drawn[1].scene
    assert scene
    assert max(scene.shown) < len(crowd.drawn)


def test_errors_of_images_are_named_as_in_the_file(small: Context) -> None:
    """Fails if a reader of a figure does not learn which of an image's two errors is drawn."""
    material = report_material(small.study, small.results, small.run_folder)
    camera = SimpleNamespace(model=SimpleNamespace(observations=(material.calibrated.model.observations[0], Camera)))
    of_images = SimpleNamespace(unit=PIXEL, values=np.array([[1.0, 2.0], [np.nan, 3.0]]), calibrated=camera)
    assert list(residuals._components(of_images)) == ["du [px]", "dv [px]"]
    assert list(residuals._components(material)) == ["dx [mm]", "dy [mm]", "dz [mm]"]


def test_certainty_of_the_model_is_that_of_its_predictions(small: Context) -> None:
    material = report_material(small.study, small.results, small.run_folder)
    known = material.calibrated
    rng = np.random.default_rng(0)
    draws = rng.multivariate_normal(known.estimate, known.covariance, 400, method="svd")
    conditions = material.data.conditions[:, material.held]
    centre = known.model.position(known.estimate, conditions)
    moved = np.array([known.model.position(draw, conditions) - centre for draw in draws])
    assert material.certainty.model_sd_mm == pytest.approx(1e3 * np.sqrt((moved**2).sum(axis=2).mean()), rel=0.1)


def test_what_is_promised_of_held_out_errors_is_what_predictions_and_noise_leave(small: Context) -> None:
    """Fails if page one tests another model than that in use, or a limit that 95 % of its errors are not below."""
    material = report_material(small.study, small.results, small.run_folder)
    known, rng = material.calibrated, np.random.default_rng(1)
    assert len(material.tested) == material.held.sum() == material.certainty.tested
    assert material.tested["error"].to_numpy() == pytest.approx(material.distance[material.held])
    assert (material.tested["error"] <= material.tested["limit"]).sum() == material.certainty.within
    draws = rng.multivariate_normal(known.estimate, known.covariance, 4000, method="svd")
    conditions = material.data.conditions[:, material.held]
    moved = 1e3 * np.array([known.model.position(draw, conditions) for draw in draws])
    moved += material.sigma[material.held, None] * rng.standard_normal(moved.shape)
    sizes = np.linalg.norm(moved - 1e3 * known.model.position(known.estimate, conditions), axis=2)
    assert (sizes <= material.tested["limit"].to_numpy()).mean() == pytest.approx(0.95, abs=0.01)


def test_poses_far_beyond_their_promise_are_named(small: Context) -> None:
    """Fails if a pose that is off by many times what is promised is passed over, fitted or not, or one without errors breaks it."""
    material = report_material(small.study, small.results, small.run_folder)
    left = small.tables["identify/residuals.csv"].copy()
    assert Certainty.of(material.calibrated, material.data, left).missed == ()
    fitted, held, unmeasured = (
        left.index[left["split"] == split][k] for split, k in (("train", 3), ("holdout", 2), ("train", 5))
    )
    for size in ("error_mm", "error"):
        left.loc[fitted, size], left.loc[held, size] = 2.0, 3.0
    left.loc[left["pose"] == left["pose"][unmeasured], ["error_mm", "error"]] = np.nan
    missed = Certainty.of(material.calibrated, material.data, left).missed
    assert [(pose.line, pose.split, pose.error) for pose in missed] == [
        (left["line"][held], "holdout", 3.0), (left["line"][fitted], "train", 2.0)
    ]  # fmt: skip
    assert all(0 < pose.limit < 1.0 for pose in missed)


def test_certainty_is_told_with_the_models_own_error_and_with_what_is_left(small: Context) -> None:
    """Fails if page one gives the parameters' certainty for that of predictions."""
    material = report_material(small.study, small.results, small.run_folder)
    left = small.tables["identify/residuals.csv"]
    known = material.calibrated
    less_sure = replace(known, errors=ErrorModel.white(PerUnit(((METRE, 1e-4),)), len(known.estimate)))
    off = Certainty.of(less_sure, material.data, left)
    assert off.prediction_sd_mm == pytest.approx(np.hypot(material.certainty.model_sd_mm, 0.1 * np.sqrt(3)))
    assert f"known to {off.prediction_sd_mm:.3f} mm (1 sd). That includes the model's own error." in certainty_words(
        off, True
    )
    judged = left["error_mm"][left["split"] == "holdout"]
    assert f"Measured there: {judged.mean():.3f} mm on average" in certainty_words(off, True)
    elsewhere = Alternative(less_sure.model, less_sure.estimate + 3 * np.sqrt(np.diag(less_sure.covariance)), 0.4)
    rivalled = Certainty.of(replace(less_sure, alternatives=(elsewhere,)), material.data, left)
    assert "That includes the model's own error, and the choice among causes that fit as well." in certainty_words(
        rivalled, True
    )
    assert rivalled.prediction_sd_mm > off.prediction_sd_mm


def test_flagged_rows_are_listed_by_their_line(small: Context, text: str) -> None:
    rows = small.tables["identify/residuals.csv"]
    flagged = source_of(changed(small, "identify/residuals.csv", flagged=np.arange(len(rows)) == 7))
    assert f"Check 1 row of the measurement file (line {rows['line'][7]})" in flagged
    assert "Rows that do not fit" in flagged
    assert "No single row is an outlier" in text


def test_the_largest_error_stands_first_among_flagged_rows(small: Context) -> None:
    rows = small.tables["identify/residuals.csv"]
    error = np.linalg.norm(rows[["dx_mm", "dy_mm", "dz_mm"]], axis=1)
    table = source_of(changed(small, "identify/residuals.csv", flagged=True)).partition("Rows that do not fit")[2]
    assert re.search(r'\[#"(\d+)";\]', table.partition("table.hline(stroke: 0.4pt)")[2])[1] == str(
        rows["line"][error.argmax()]
    )  # type: ignore[index]


def test_what_a_plan_tells_apart_is_drawn_and_said(small: Context):
    """Fails if a gap that something fills is not said, on the first page too, or one that nothing fills is taken for it."""
    gap = "play 1 is told from drift in 12 of 100; with a thermometer in 95 of 100"
    rows = [
        cell(true, rival, 0.12 if (true, rival) == ("play", "drift") else 1.0, gap if (true, rival) == ("play", "drift") else "")
        for true in ("play", "drift") for rival in ("", "play", "drift") if true != rival
    ]  # fmt: skip
    rows += [
        replace(
            cell("slack", "", 0.0, ""), worst=True, words="slack is seen in 0 of 100, and nothing tried changes that"
        )
    ]
    table = to_frame(rows, IsolabilityCell)
    given = replace(small, results=small.results | Results({"select/isolability.csv": table}))
    told = source_of(given)
    assert "Of 3 causes 2 would be detected, and 1 of these distinguished from all others." in told
    assert "Not detected at this size: slack of joint 1." in told
    assert f"P{gap[1:]}." in told
    assert "nothing tried" not in told.replace("what nothing tried fills", "")
    assert any(item.sentence == f"P{gap[1:]}." for item in advice(RunOutcome(given.results)))


def test_the_causes_that_a_plan_mistakes_can_be_read() -> None:
    """Fails if a catalogue of a hundred causes is drawn too small to be read, or the worst ones are not those that are drawn."""
    causes = [f"cause{k}" for k in range(100)]
    cells = [cell(cause, "", 1.0, "") for cause in causes]
    cells += [cell(cause, f"rival{n}", (k + n) / 200, "") for k, cause in enumerate(causes) for n in (1, 0)]
    near = near_rivals(
        [cell("missed", "", 0.5, ""), cell("missed", "rival0", 0.0, ""), *cells, cell("apart", "", 1.0, "")]
    )
    assert [[pair.rival for pair in rivals] for rivals in near] == [["rival0", "rival1"]] * 100
    assert [rivals[0].cause for rivals in near] == causes
    with style():
        (axes,) = near_figure(near[:MOST]).axes
    labels = axes.get_yticklabels()
    assert [label.get_text() for label in labels] == [f"{cause} of joint 1" for cause in causes[:MOST]]
    assert 72 * axes.figure.get_figheight() / MOST > 1.3 * labels[0].get_fontsize() > 1.3 * 6.5


def cell(true: str, rival: str, chance: float, words: str) -> IsolabilityCell:
    """A row of the table of what a plan tells apart."""
    return IsolabilityCell(
        cause=true, joint=1, part="joint1", size=1e-4, unit="rad", rival=rival, rival_joint=1 if rival else None,
        rival_part="joint1" if rival else "", chance=chance, enough=chance >= 0.9, needs="", worst=bool(words),
        addition="a thermometer" if words else "", chance_then=0.95 if words else None, words=words,
    )  # fmt: skip
