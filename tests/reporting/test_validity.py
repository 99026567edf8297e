"""Where the calibration holds is what it promises there, and said where it is worth nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.estimation.model_tables import ModelObservation
from calflow.files.tables import Results, to_document, to_frame
from calflow.files.words import mm, number
from calflow.reporting.blocks import Plot
from calflow.reporting.material import Material
from calflow.reporting.promised import Promised
from calflow.reporting.sections.validity import validity_section
from calflow.reporting.sections.verdict import how_sure
from calflow.reporting.style import style
from calflow.stages.report import report_material
from reporting.case import context


@pytest.fixture(scope="module")
def material(tmp_path_factory: pytest.TempPathFactory) -> Material:
    """What a report of a small robot is written from."""
    small = context(tmp_path_factory.mktemp("small"))
    return report_material(small.study, small.results, small.run_folder)


def test_the_figures_are_those_of_predictions(material: Material) -> None:
    """Fails if the map promises otherwise than a prediction does, or poses beyond what was measured are not told apart."""
    shown = Promised.of(material.calibrated, material.data)
    known = material.calibrated
    at = known.model.point(known.estimate, material.data.conditions)
    near = np.linalg.norm(shown.place[:, None] - at, axis=2).min(axis=1)
    inside = np.sqrt(known.position_variance(material.data.conditions).sum(axis=1))
    assert shown.error[near < np.quantile(near, 0.1)].mean() < 3 * inside.mean()
    assert 0 < shown.outside.mean() < 1
    assert f"{mm(1e3 * np.median(shown.error))} mm at half of the poses" in shown.words
    assert f"At {100 * shown.outside.mean():.0f} % of them a joint is beyond its measured range" in shown.words


def test_page_one_says_where_its_figure_does_not_hold(material: Material, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fails if page one has a figure of the measured range alone, and a prediction beyond it promises several times that."""
    shown = Promised.of(material.calibrated, material.data)
    beyond = np.zeros_like(shown.beyond)
    beyond[::3, 0] = True
    for times, joints in ((4.0, "Joint 1 was measured over a part of its travel"), (1.0, "")):
        error = np.where(beyond.any(axis=1), times, 1.0) * 1e-3 * material.certainty.prediction_sd_mm
        other = replace(shown, error=error, beyond=beyond)
        with monkeypatch.context() as patched:
            patched.setattr(Promised, "of", lambda *_, other=other: other)
            said = dict(how_sure(replace(material)))["Where:"]
        assert (": beyond that expect an RMS error of" in said) == bool(joints)
        assert joints in said
        figures = f"{mm(times * material.certainty.prediction_sd_mm)} mm ({mm(material.certainty.prediction_sd_mm)} mm within)"
        assert (figures in said) == bool(joints)


def test_a_region_without_gain_is_told(material: Material) -> None:
    """Fails if a calibration that is nowhere expected to be nearer than the nominal robot is shown as one that helps."""
    shown = Promised.of(material.calibrated, material.data)
    assert "no gain" not in replace(shown, gained=np.ones_like(shown.outside)).words
    useless = replace(shown, gained=np.zeros_like(shown.outside))
    assert (
        "At 100 % of the poses within the joints' limits no gain over the maker's figures is certain." in useless.words
    )
    at_work = Promised.at_work(material.calibrated, material.data, {})
    assert material.certainty.no_gain == pytest.approx(1 - at_work.gained.mean())


def test_an_axis_that_nothing_measured_is_not_told_of_measured_positions(material: Material) -> None:
    """Fails if positions were measured along all axes, and page one says that nothing tells where the tool is along one."""
    told = to_document(replace(material.certainty, no_gain=0.5, untold=("z",)))
    lengths = to_frame([ModelObservation(kind="distance", observation="{}")], ModelObservation)
    for tables, expected in (({}, False), ({"identify/observations.csv": lengths}, True)):
        doubted = material.results | Results(tables, {"identify/certainty.json": told})
        said = dict(how_sure(replace(material, results=doubted)))["Where:"]
        assert ("No measurement tells where the tool is along z" in said) == expected


def test_a_figure_of_zero_has_no_sign() -> None:
    """Fails if what rounds to zero is shown as if it were a little more, or less."""
    assert [number(value, "+.2f") for value in (0.001, -0.001, 0.012, -0.012)] == ["0.00", "0.00", "+0.01", "−0.01"]


def test_poses_are_drawn_once_in_a_report(material: Material, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fails if page one and the map each predict at random poses of their own: they could contradict each other."""
    drawn, of = [], Promised.of

    def counted(*given: object) -> Promised:
        drawn.append(given)
        return of(*given)

    monkeypatch.setattr(Promised, "of", counted)
    anew = replace(material)
    how_sure(anew)
    with style():
        validity_section.write(anew)
    assert len(drawn) == 1


def test_it_is_drawn_with_what_was_measured(material: Material) -> None:
    """Fails if either view lacks the poses that were measured, or has no unit."""
    with style():
        (drawn,) = (block.drawn for block in validity_section.write(material) if isinstance(block, Plot))
    for axes in drawn.axes[:2]:
        assert len(axes.collections[1].get_offsets()) == len(material.place)
        assert axes.get_xlabel().endswith("[m]")
    assert drawn.axes[2].get_ylabel() == "expected error [mm]"
