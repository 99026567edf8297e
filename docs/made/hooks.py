"""What mkdocs calls: it adds the pages of the catalogue, the notebook's and all pictures to the files of `docs`."""

from __future__ import annotations

import re
import sys
from functools import cache
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

sys.path.insert(0, str(Path(__file__).parents[1]))

from calflow import effects, observations
from made.effect_page import effect_page
from made.notebook import notebook_page
from made.observation_page import observation_page
from made.shown import DOCS, PAGES, can_be_made, made, without_pictures

NOTEBOOK = DOCS / "first_calibration.ipynb"
ROOMS = {  # of the catalogue: the folder of its pages, and which of them there are
    "effects": (effect_page, effects.catalogue),
    "observations": (observation_page, observations.observation_kinds),
}


@cache
def pages() -> dict[str, tuple[str, bytes]]:
    """Every page of the catalogue and its picture, by its path without an ending."""
    return {f"{room}/{name}": make(of) for room, (make, found) in ROOMS.items() for name, of in sorted(found().items())}


@cache
def notebook() -> tuple[str, dict[str, bytes]]:
    """The notebook as Markdown, and its figures."""
    return notebook_page(NOTEBOOK)


def on_config(config: MkDocsConfig) -> None:
    """Put the pages into the navigation, each room behind its overview."""
    for room in ROOMS:
        config.nav.append({f"Each {room[:-1]}": [f"{path}.md" for path in pages() if path.startswith(f"{room}/")]})


def on_files(files: Files, config: MkDocsConfig) -> None:
    """Add the pages and their pictures, and what the commands of other pages make."""
    text, figures = notebook()
    files.append(File.generated(config, f"{NOTEBOOK.stem}.md", content=text))
    shown = {f"shown/{path}": content for path, content in made().items()}
    for path, content in (figures | shown).items():
        files.append(File.generated(config, path, content=content))
    for path, (text, picture) in pages().items():
        files.append(File.generated(config, f"{path}.md", content=text))
        files.append(File.generated(config, f"{path}.svg", content=picture))


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Let each row of an overview's table lead to the page of its own; show no picture that was not made."""
    room = page.file.src_uri.removesuffix(".md")
    if room in PAGES and not can_be_made(room):
        return without_pictures(markdown)
    if room not in ROOMS:
        return markdown
    return re.sub(r"^\| `([\w-]+)` \|",
                  lambda row: f"| [`{row[1]}`]({room}/{row[1]}.md) |" if f"{room}/{row[1]}" in pages() else row[0],
                  markdown, flags=re.MULTILINE)  # fmt: skip
