"""Letters that the report's own fonts lack: a font of this machine that has them, else their numbers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

OWN = "DejaVu Sans"  # which Matplotlib brings along


@dataclass(frozen=True)
class Fonts:
    """Fonts by family and file, and the letters that none of them has."""

    families: tuple[str, ...]
    files: tuple[Path, ...]
    lacking: frozenset[str] = frozenset()

    def legible(self, text: str) -> str:
        """Return text with the number of every letter that would be an empty box: two names stay two names."""
        return "".join(f"[U+{ord(letter):04X}]" if letter in self.lacking else letter for letter in text)


def fonts_for(text: Iterable[str]) -> Fonts:
    """Return the own font, and as few of this machine's as have the letters that it lacks."""
    from matplotlib import get_data_path
    from matplotlib.font_manager import fontManager

    own = str(Path(get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf")
    families, files = [OWN], [Path(own)]
    lacking = {letter for letter in text if letter.isprintable() and not letter.isspace()} - _letters(own)
    others = sorted({(entry.name, entry.fname) for entry in fontManager.ttflist}) if lacking else []
    while lacking and others:
        name, file = max(others, key=lambda other: len(lacking & _letters(other[1])))
        if not lacking & _letters(file):
            break
        lacking -= _letters(file)
        families.append(name)
        files.append(Path(file))
    return Fonts(tuple(families), tuple(files), frozenset(lacking))


@lru_cache
def _letters(file: str) -> frozenset[str]:
    """Return the letters that a font has; none where it cannot be read."""
    from matplotlib.ft2font import FT2Font

    try:
        return frozenset(map(chr, FT2Font(file).get_charmap()))
    except (OSError, RuntimeError):
        return frozenset()
