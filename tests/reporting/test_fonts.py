"""Names in any script: shown with a font that has them, else by their numbers; long ones broken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import typst
from matplotlib import font_manager
from matplotlib.font_manager import findfont, fontManager
from matplotlib.ft2font import FT2Font

from calflow.files.words import AXIS, cut
from calflow.reporting import document
from calflow.reporting.blocks import Heading, Table
from calflow.reporting.document import OWN, fonts_for
from calflow.reporting.sections.parameters import estimates
from calflow.reporting.style import style


def test_letters_that_no_font_has_are_told_by_their_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fails if two names in a script that no font has become the same empty boxes."""
    boxes = [entry for entry in fontManager.ttflist if entry.name.startswith("Last Resort")]
    monkeypatch.setattr(fontManager, "ttflist", boxes)  # of which Matplotlib brings one along
    monkeypatch.setattr(font_manager, "findSystemFonts", list)
    fonts = fonts_for("Roboter 工業, Müller")
    assert fonts.families == (OWN,)
    assert fonts.legible("工業 Müller") == "[U+5DE5][U+696D] Müller"


def test_a_font_of_the_machine_is_taken_where_the_own_lacks_letters(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fails if letters are told by numbers although a font has them, or a font is taken that is of no use."""
    upright = [entry for entry in fontManager.ttflist if entry.name == "STIXGeneral" and entry.style == "normal"]
    stix = min(upright, key=lambda entry: entry.fname)  # the list is in no order
    own = set(FT2Font(findfont(OWN)).get_charmap())
    letter = next(
        chr(code) for code in FT2Font(stix.fname).get_charmap() if code not in own and chr(code).isprintable()
    )
    useless = next(entry for entry in fontManager.ttflist if entry.fname == findfont(OWN))
    monkeypatch.setattr(fontManager, "ttflist", [useless])
    monkeypatch.setattr(font_manager, "findSystemFonts", lambda: [stix.fname])  # installed since the list was made
    fonts = fonts_for(f"a{letter}")
    assert fonts.families == (OWN, stix.name)
    assert fonts.legible(letter) == letter
    assert fonts_for("abc µ −").families == (OWN,)


def test_a_long_name_stays_on_its_page() -> None:
    """Fails if a name without spaces runs past the page's edge: a cell as wide as its name would be beyond the others."""
    assert "\u200b" in document.plain("x" * 60)
    assert "\u200b" not in document.plain("joint3.beta and other words of a usual length")
    text = document.source("t", [("Verdict", [Table(("a", "b"), [("y" * 300, "1")], "lr")])])
    pages = typst.compile(text.encode(), format="svg", ignore_system_fonts=True)
    assert pages


def test_a_long_name_leaves_room_for_its_figure() -> None:
    """Fails if a figure's axis is longer than the figure, or two long names are cut to the same."""
    assert cut("joint3.beta") == "joint3.beta"
    assert len(cut("m" * 300)) <= AXIS + 1
    assert cut("m" * 300 + ".x") != cut("m" * 300 + ".y")


def test_a_pdf_has_the_letters_of_the_machines_font(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fails if typst is not given the font that was chosen, so that a name is a row of empty boxes."""
    (stix,) = [
        entry for entry in fontManager.ttflist if entry.name == "STIXGeneral" and Path(entry.fname).stem == entry.name
    ]
    monkeypatch.setattr(fontManager, "ttflist", [stix])
    monkeypatch.setattr(font_manager, "findSystemFonts", list)
    letter = "\u1d81"  # d with a hook, which the report's own fonts lack
    assert fonts_for(letter).families == (OWN, stix.name)
    with style():
        document.write_pdf("t", [("Verdict", [Heading(letter, 0)])], tmp_path)
    assert b"STIX" in (tmp_path / "report.pdf").read_bytes()


def test_long_names_leave_their_figure_its_room() -> None:
    """Fails if turned names squeeze the axes above them."""
    heights = []
    for name in ("joint3.beta", cut("upper_left_corner_" * 4)):
        with style():
            drawn = estimates([name] * 9, ["geometry"] * 9, np.zeros(9), np.ones(9), np.zeros(9, dtype=bool))
            drawn.draw_without_rendering()
        heights.append(drawn.axes[0].get_position().height * drawn.get_figheight())
    assert heights[1] > 0.9 * heights[0] > 0.9
