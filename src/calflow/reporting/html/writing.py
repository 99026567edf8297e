"""report.html: the sections of the PDF as one file that a browser shows without any network."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

from calflow.files.writing import write_text
from calflow.reporting.blocks import Part, plots
from calflow.reporting.html.elements import Html, as_json, element, joined
from calflow.reporting.html.page import Page, contents, section
from calflow.reporting.html.pictures import pictures

STYLE, SCRIPTS = "report.css", ("data.js", "tables.js", "scene.js")  # scene.js asks data.js


def write(title: str, parts: Sequence[Part], folder: Path) -> None:
    """Write report.html into a folder that has the drawings in figures/."""
    write_text(folder / "report.html", page(title, parts, folder / "figures"))


def page(title: str, parts: Sequence[Part], figures: Path) -> str:
    """Return the page; the first part stands before the list of contents, without a heading."""
    drawn = [plot.name for _, own in parts for plot in plots(own)]
    blocks = Page(pictures(figures, drawn))
    (_, first), *others = parts
    begin = element("header", blocks.all(first))
    body = [section(k, name, blocks.all(own)) for k, (name, own) in enumerate(others, start=1)]
    style, scripts = _file(STYLE), [_file(name) for name in SCRIPTS]
    head = [
        element("meta", charset="utf-8"),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        Html(f'<meta http-equiv="Content-Security-Policy" content="{_policy(style, scripts)}">'),
        element("title", title),
        element("style", style),
    ]
    numbers = element("script", as_json(blocks.store.columns), type="application/json", class_="numbers")
    said = [begin, contents([name for name, _ in others]), element("main", Html("\n"), joined(body)), numbers]
    return "<!doctype html>\n" + element(
        "html",
        element("head", joined(head)),
        Html("\n"),
        element("body", joined(said), *(element("script", script) for script in scripts)),
        lang="en",
    )


def _policy(style: str, scripts: Sequence[str]) -> str:
    """Nothing is fetched, and no style or script runs but the page's own, whatever a name in it holds."""
    own = " ".join(f"'{_hash(script)}'" for script in scripts)
    return f"default-src 'none'; img-src data:; style-src '{_hash(style)}'; script-src {own}"


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _file(name: str) -> Html:
    return Html(files(__package__).joinpath(name).read_text(encoding="utf-8"))
