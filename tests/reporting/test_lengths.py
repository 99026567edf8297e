"""The report of a robot described by a URDF and measured by a wire, whose lengths are not the tool's errors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calflow.files.tables import Results
from calflow.files.words import mm
from calflow.reporting.blocks import Card, Columns, Paragraph, Plot, Table
from calflow.reporting.material import Material
from calflow.reporting.sections.accuracy import accuracy_section
from calflow.reporting.sections.controller_figures import controller_section
from calflow.reporting.sections.verdict import verdict_section
from calflow.stages.identify import STAGE as IDENTIFY
from calflow.stages.report import report_material
from calflow.stages.stage import Context
from calflow.study import load_study

WIRE = Path(__file__).parents[2] / "studies" / "first-steps" / "wire.toml"


@pytest.fixture(scope="module")
def material(tmp_path_factory: pytest.TempPathFactory) -> Material:
    folder = tmp_path_factory.mktemp("wire")
    given = Context(
        load_study(WIRE), IDENTIFY.settings(starts=1), Results(), folder, folder, lambda line: None, lambda share: None
    )
    given = replace(given, results=IDENTIFY.run(given), settings=None)
    return report_material(given.study, given.results, given.run_folder)


def test_page_one_has_the_tools_own_error(material: Material) -> None:
    """Fails if errors of lengths are all that page one has, though the tool's position is known far less well."""
    rows = [block for block in verdict_section.write(material) if isinstance(block, Columns)]
    cards = [card for row in rows for part in row.parts for card in part if isinstance(card, Card)]
    expected = material.certainty.prediction_sd_mm
    assert expected > 5 * material.certainty.left
    assert mm(expected) in [card.big for card in cards]


def test_noise_of_lengths_has_one_axis(material: Material) -> None:
    """Fails if the errors of lengths are compared with the noise of positions, or called distances of the tool."""
    blocks = accuracy_section.write(material)
    (spread,) = (block for block in blocks if isinstance(block, Plot) and block.name == "error_distribution")
    (noise,) = (line for line in spread.drawn.axes[0].lines if line.get_label() == "noise alone")
    median = np.interp(50, noise.get_ydata(), noise.get_xdata())
    assert median == pytest.approx(0.6745 * 0.05, rel=0.05)
    assert not any("tool position" in block.text for block in blocks if isinstance(block, Paragraph))


def test_figures_of_origins_have_room(material: Material) -> None:
    """Fails if figures are wider than the page, those of different units share a column, or one not fitted has a difference."""
    tables = [block for block in controller_section.write(material) if isinstance(block, Table)]
    assert all(len(table.header) <= 11 for table in tables)
    lengths, angles = (" ".join(table.header) for table in tables[:2])
    assert ("deg" in lengths, "mm" in angles, "tilt_back" in angles) == (False, False, False)
    assert not any(name.startswith("base") for table in tables for name in table.header)
    empty = [name for table in tables for name, *cells in zip(table.header, *table.rows, strict=True) if not any(cells)]
    assert not empty


def test_a_length_that_no_robot_has_is_stated_by_its_power_of_ten():
    """Fails if rows that are nobody's fill a line with digits."""
    assert (mm(419488784661606117146624.0), mm(295.4812)) == ("4.2e+23", "295.5")
