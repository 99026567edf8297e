"""Names in any script: shown with a font that has them, else by their numbers; long ones broken."""

from __future__ import annotations

import pytest
import typst
from matplotlib.font_manager import findfont, fontManager
from matplotlib.ft2font import FT2Font

from calflow.reporting import document
from calflow.reporting.blocks import Table
from calflow.reporting.fonts import OWN, fonts_for
from calflow.reporting.words import AXIS, cut


def test_letters_that_no_font_has_are_told_by_their_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fails if two names in a script that no font has become the same empty boxes."""
    monkeypatch.setattr(fontManager, "ttflist", [])
    fonts = fonts_for("Roboter 工業, Müller")
    assert fonts.families == (OWN,)
    assert fonts.legible("工業 Müller") == "[U+5DE5][U+696D] Müller"


def test_a_font_of_the_machine_is_taken_where_the_own_lacks_letters(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fails if letters are told by numbers although a font has them, or a font is taken that is of no use."""
    stix = next(entry for entry in fontManager.ttflist if entry.name == "STIXSizeOneSym" or entry.name == "STIXGeneral")
    own = set(FT2Font(findfont(OWN)).get_charmap())
    letter = next(
        chr(code) for code in FT2Font(stix.fname).get_charmap() if code not in own and chr(code).isprintable()
    )
    useless = next(entry for entry in fontManager.ttflist if entry.name == OWN)
    monkeypatch.setattr(fontManager, "ttflist", [useless, stix])
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
