"""report.html: the sections of the PDF as one file that a browser shows without any network.

Drawings as small pictures, so that a page with every figure can be sent by mail, however many rows are in them.
"""

from __future__ import annotations

import base64
import hashlib
import io
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

from PIL import Image

from calflow.files.writing import write_text
from calflow.reporting.blocks import Part, plots
from calflow.reporting.html.page import Html, Page, as_json, contents, element, joined, section

PER_INCH = 168  # dots: letters are sharp on a telephone, too
COLOURS = 64  # enough for the shades of a report's figures


def pictures(folder: Path, names: Sequence[str]) -> dict[str, bytes]:
    """Return the SVG drawings of a folder by their names, as WebP pictures.

    They are drawn by typst, which takes a small part of the time that Matplotlib would take to draw each once more.
    """
    import typst

    if not names:
        return {}
    pages = "\n#pagebreak()\n".join(f'#image("/{name}.svg")' for name in names)
    source = f"#set page(width: auto, height: auto, margin: 0pt)\n{pages}".encode()
    drawn = typst.compile(source, root=str(folder), format="png", ppi=PER_INCH, ignore_system_fonts=True)  # type: ignore[call-overload]
    each = drawn if isinstance(drawn, list) else [drawn]
    return {name: _small(Image.open(io.BytesIO(page))) for name, page in zip(names, each, strict=True)}


def _small(picture: Image.Image) -> bytes:
    """Return a picture in few colours, without loss in what is left of it."""
    kept = io.BytesIO()
    picture.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).convert("RGB").save(kept, "webp", lossless=True)
    return kept.getvalue()


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
