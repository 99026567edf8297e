"""Letters that the report's own fonts lack: a font of this machine that has them, else their numbers."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.font_manager import FontEntry

OWN = "DejaVu Sans"  # which Matplotlib brings along
BOXES = (".LastResort", "Last Resort")  # fonts that have every letter, as a box
USUAL = 400  # weight


@dataclass(frozen=True)
class Fonts:
    """Fonts by family, the folders that they are in, and the letters that none of them has."""

    families: tuple[str, ...]
    folders: tuple[Path, ...]
    lacking: frozenset[str] = frozenset()

    def legible(self, text: str) -> str:
        """Return text with the number of every letter that would be an empty box: two names stay two names."""
        return "".join(f"[U+{ord(letter):04X}]" if letter in self.lacking else letter for letter in text)


def fonts_for(text: Iterable[str]) -> Fonts:
    """Return the own font, and as few of this machine's as have the letters that it lacks."""
    from matplotlib import get_data_path

    own = str(Path(get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf")
    families, folders = [OWN], [Path(own).parent]
    lacking = {letter for letter in text if letter.isprintable() and not letter.isspace()} - _letters(own)
    others = _of_the_machine() if lacking else []
    while lacking and others:
        best = max(others, key=lambda other: len(lacking & _letters(other.fname)))
        if not lacking & _letters(best.fname):
            break
        lacking -= _letters(best.fname)
        families.append(best.name)
        folders.append(Path(best.fname).parent)
    return Fonts(tuple(families), tuple(dict.fromkeys(folders)), frozenset(lacking))


def _of_the_machine() -> list[FontEntry]:
    """Return this machine's upright fonts, those of usual weight first; with what was installed since Matplotlib made its list."""
    from matplotlib.font_manager import findSystemFonts, fontManager

    for file in sorted(set(findSystemFonts()) - {entry.fname for entry in fontManager.ttflist}):
        with suppress(OSError, RuntimeError):
            fontManager.addfont(file)
    upright = [entry for entry in fontManager.ttflist if entry.style == "normal" and not entry.name.startswith(BOXES)]
    return sorted(upright, key=lambda entry: (entry.weight != USUAL, "Serif" in entry.name, entry.name, entry.fname))


@lru_cache
def _letters(file: str) -> frozenset[str]:
    """Return the letters that a font has; none where it cannot be read."""
    from matplotlib.ft2font import FT2Font

    try:
        return frozenset(map(chr, FT2Font(file).get_charmap()))
    except (OSError, RuntimeError):
        return frozenset()
