"""report.html: the sections of the PDF as a single file that a browser shows offline.

Text is escaped where it enters an element. Drawings are compressed pictures, and a data column of several figures is
stored once, in compact form, so that a page with all figures can be sent by mail.
"""

from __future__ import annotations

import base64
import hashlib
import io
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from PIL import Image

from calflow.files.deferred import pd
from calflow.files.writing import write_text
from calflow.reporting.blocks import (
    Block,
    Bullets,
    Card,
    Columns,
    Divider,
    Gap,
    Heading,
    Link,
    Paragraph,
    Part,
    Plot,
    RestOfPage,
    Scene,
    Signatures,
    Table,
    plots,
    thumbnails,
)

VOID = frozenset({"img", "input", "meta"})  # elements without content and end tag
UNSPEAKABLE = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ufdd0-\ufdef\ufffe\uffff]")  # characters invalid in HTML
MOST_NUMBERED = 256  # distinct values up to which a column is stored as codes of one byte
DIGITS = "%.7g"  # of numbers written as text: the precision of four-byte floats
DOTS_PER_INCH = 96
NARROW = 4.0  # inches up to which a figure is legible on a telephone without enlarging
LARGE, MIDDLE, SMALL = 14, 11, 9.5  # font sizes in points that bound the classes of paragraphs
PER_INCH = 168  # dots per inch: sharp letters on a telephone, too
OF_SMALL = 48  # dots per inch of thumbnails, whose text is not read
STEP = 17  # between the sixteen levels of a colour channel: enough for figures, and white stays white
STYLE, SCRIPTS = "report.css", ("data.js", "tables.js", "scene.js")  # scene.js depends on data.js


class Html(str):
    """Text that is already HTML."""

    __slots__ = ()


def element(tag: str, *children: str, **attributes: str | int | bool) -> Html:
    """Return an element; an attribute that is True has no value, one that is False or empty is omitted.

    Underscores in attribute names become hyphens; a trailing one (class_, for_) is dropped.
    """
    text = "".join(_attribute(name.rstrip("_").replace("_", "-"), value) for name, value in attributes.items())
    inside = "".join(map(shown, children))
    return Html(f"<{tag}{text}>" if tag in VOID else f"<{tag}{text}>{inside}</{tag}>")


def shown(text: str) -> Html:
    """Return text escaped for HTML, and HTML unchanged."""
    return text if isinstance(text, Html) else Html(escape(UNSPEAKABLE.sub("\ufffd", text), quote=False))


def as_json(value: object) -> Html:
    """Return a value as JSON that is safe inside a script element."""
    return Html(json.dumps(value, separators=(",", ":")).replace("<", "\\u003c"))


def joined(parts: list[Html]) -> Html:
    """Return elements joined by line breaks."""
    return Html("\n".join(parts))


def _attribute(name: str, value: str | int | bool) -> str:
    if value is True:
        return f" {name}"
    if value is False or value == "":
        return ""
    return f' {name}="{escape(UNSPEAKABLE.sub("�", str(value)))}"'


def packed(values: pd.Series) -> dict[str, Any]:
    """Return a column in one of three encodings: distinct values with codes of one byte, four-byte floats, or texts."""
    codes, distinct = pd.factorize(values, use_na_sentinel=False)
    if len(distinct) <= MOST_NUMBERED:
        return {"values": [_plain(value) for value in distinct], "codes": _encoded(codes.astype("u1"))}
    if pd.api.types.is_numeric_dtype(values):
        return {"floats": _encoded(values.to_numpy(dtype="<f4"))}
    return {"texts": [_plain(value) for value in values]}


def _plain(value: Any) -> bool | float | str | None:
    """Return a cell as a JSON value; None where it is missing."""
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if pd.isna(value):
        return None
    return float(DIGITS % value) if isinstance(value, int | float | np.number) else str(value)


def _encoded(array: np.ndarray) -> str:
    return base64.b64encode(array.tobytes()).decode()


@dataclass
class Page:
    """HTML of blocks.

    pictures: drawings by plot name; figures: number of captions so far; names: those of downloads; columns: the distinct
    data columns as JSON with their numbers, as `data.js` reads them.
    """

    pictures: Mapping[str, bytes]
    figures: int = 0
    names: set[str] = field(default_factory=set)
    columns: dict[str, int] = field(default_factory=dict)

    def all(self, blocks: Iterable[Block]) -> Html:
        """Return blocks joined in order."""
        return joined([self.of(block) for block in blocks])

    def of(self, block: Block) -> Html:
        """Return a block as HTML."""
        match block:
            case Heading(text, level):
                return element(f"h{level + 1}", text)
            case Paragraph():
                return _paragraph(block)
            case Gap():
                return Html()
            case Bullets():
                return _bullets(block)
            case Table():
                return self._table(block)
            case Plot():
                return self._plot(block)
            case Card():
                big = element("p", element("strong", block.big), f" {block.unit}", class_="big")
                lines = element("p", block.head), big, element("p", block.small)
                return element("div", *lines, class_=f"card {block.look}")
            case Columns(parts):
                cards = all(isinstance(inner, Card) for part in parts for inner in part)
                beside = [element("div", self.all(part)) for part in parts]
                return element("div", *beside, class_="cards" if cards else "columns")
            case RestOfPage(blocks, steps):
                return self.all([*blocks, *([Bullets(steps, numbered=True)] if steps else [])])
            case Divider(_, text):
                return element("p", text, class_="divider")
            case Signatures(names):
                return element("div", *(element("p", name) for name in names), class_="signatures")

    def _table(self, block: Table) -> Html:
        groups: list[list[Html]] = [[]]
        for k, row in enumerate(block.rows):
            if isinstance(row, str):
                across = element("th", row, colspan=len(block.header), scope="rowgroup")
                groups.append([element("tr", across, class_="group")])
                continue
            cells = [
                element("td", self._linked(cell), class_=_side(side))
                for cell, side in zip(row, block.align, strict=True)
            ]
            groups[-1].append(element("tr", *cells, class_="shaded" if k in block.shaded else ""))
        head = [
            element("th", element("button", name or "#", type="button"), scope="col", class_=_side(side))
            for name, side in zip(block.header, block.align, strict=True)
        ]
        bodies = [element("tbody", *rows) for rows in groups if rows]
        table = element("table", element("thead", element("tr", *head)), *bodies)
        save = element("button", "This table as CSV", type="button", class_="save", data_file=self._named("table"))
        scroll = element("div", table, class_="scroll", tabindex=0)
        return element("div", scroll, element("p", save, class_="get"), class_="table")

    def _plot(self, block: Plot) -> Html:
        drawing, columns = self._drawing(block), self._stored(block.data)
        seen = element("div", drawing, class_="scroll", tabindex=0)
        if block.scene:
            seen = scene(block.scene, columns, block.caption, drawing)
        save = element("button", "Data as CSV", type="button", class_="save", data_file=self._named(block.name),
                       data_columns=json.dumps(columns))  # fmt: skip
        if not block.caption:
            return element("figure", seen, element("figcaption", save))
        self.figures += 1
        number = element("strong", f"Figure {self.figures}.")
        return element("figure", seen, element("figcaption", number, " ", block.caption, " ", save))

    def _linked(self, cell: str) -> str:
        """Return a cell, as a link where it has a file."""
        if not isinstance(cell, Link):
            return cell
        picture = element("img", src=_inside(self.pictures[cell.picture]), alt=cell.file) if cell.picture else Html()
        return element("a", picture, str(cell), href=quote(cell.file))

    def _drawing(self, block: Plot) -> Html:
        """Return the PDF's figure, embedded in the page."""
        width, height = (round(DOTS_PER_INCH * side) for side in block.drawn.get_size_inches())
        return element("img", src=_inside(self.pictures[block.name]), alt=block.caption or block.name.replace("_", " "),
                       width=width, height=height, class_="narrow" if width <= NARROW * DOTS_PER_INCH else "")  # fmt: skip

    def _stored(self, data: pd.DataFrame) -> dict[str, int]:
        """Store a table's columns; return the number of each."""
        texts = {str(name): json.dumps(packed(data[name])) for name in data}
        return {name: self.columns.setdefault(text, len(self.columns)) for name, text in texts.items()}

    def _named(self, name: str) -> str:
        """Return a file name for a download that is unique in the page."""
        number = 1
        while f"{name}_{number}" in self.names:
            number += 1
        self.names.add(f"{name}_{number}")
        return f"{name}.csv" if number == 1 and name != "table" else f"{name}_{number}.csv"


def _paragraph(block: Paragraph) -> Html:
    large = "large" if block.size >= LARGE else "middle" if block.size >= MIDDLE else ""
    looks = (large, "small" if block.size < SMALL else "", "strong" if block.bold else "")
    return element("p", block.text, class_=" ".join(filter(None, looks)))


def _bullets(block: Bullets) -> Html:
    items = [
        element("li", element("strong", item[0]), " ", item[1]) if isinstance(item, tuple) else element("li", item)
        for item in block.items
    ]
    return element("ol" if block.numbered else "ul", *items)


def scene(given: Scene, columns: Mapping[str, int], caption: str, drawing: Html) -> Html:
    """Return an interactive view of points with their errors; without scripts the drawing is shown."""
    does = {"+": ("nearer", "nearer"), "−": ("farther", "farther"), "Reset": ("reset", "as at first")}
    buttons = [
        element("button", name, type="button", data_does=what, title=title) for name, (what, title) in does.items()
    ]
    enlarged = "enlargement of the errors"
    factor = element("input", type="range", min=0, max=300, step=1, data_does="factor", aria_label=enlarged)
    shows = [
        element("label", element("input", type="checkbox", checked=True, data_does=name), f" {words}")
        for name, words in (("used", "used for the fit"), ("held", "held out"), *[("robot", "robot")] * bool(given.arm))
    ]
    poses = element("input", type="range", min=0, max=len(given.arm.links) - 1, value=0, step=1, data_does="pose",
                    aria_label="pose of the robot") if given.arm else Html()  # fmt: skip
    canvas = element("canvas", tabindex=0, role="img", aria_label=f"{caption} Drag to turn; arrow keys turn it too.")
    slides = [element("label", "errors × ", element("output", class_="factor"), factor)]
    slides += [element("label", "pose ", poses)] if given.arm else []
    controls = element("div", *buttons, *shows, *slides, class_="controls")
    scene: dict[str, Any] = {"columns": columns, **vars(given)}
    if given.arm:
        scene["arm"] = {**vars(given.arm), "links": np.round(given.arm.links).astype(int).tolist()}
    return element(
        "div",
        canvas,
        element("p", "Drag to turn.", class_="told", aria_live="polite"),
        controls,
        element("script", as_json(scene), type="application/json"),
        element("noscript", drawing),
        class_="scene",
    )


def contents(titles: Sequence[str]) -> Html:
    """Return the table of contents, with links to the sections."""
    links = [element("li", element("a", title, href=f"#section-{k}")) for k, title in enumerate(titles, start=1)]
    return element("nav", element("h2", "Contents"), element("ol", *links), aria_label="Contents")


def _inside(picture: bytes) -> str:
    return f"data:image/webp;base64,{base64.b64encode(picture).decode()}"


def _side(letter: str) -> str:
    return "right" if letter == "r" else ""


def pictures(folder: Path, names: Sequence[str], per_inch: int = PER_INCH) -> dict[str, bytes]:
    """Return the SVG drawings of a folder by name, as WebP pictures.

    typst renders them, in a small part of the time that Matplotlib would take to draw them again.
    """
    import typst

    if not names:
        return {}
    pages = "\n#pagebreak()\n".join(f'#image("/{name}.svg")' for name in names)
    source = f"#set page(width: auto, height: auto, margin: 0pt)\n{pages}".encode()
    drawn = typst.compile(source, root=str(folder), format="png", ppi=per_inch, ignore_system_fonts=True)  # type: ignore[call-overload]
    each = drawn if isinstance(drawn, list) else [drawn]
    return {name: _small(Image.open(io.BytesIO(page))) for name, page in zip(names, each, strict=True)}


def _small(picture: Image.Image) -> bytes:
    """Return a picture with its colours quantised, compressed without loss."""
    kept = io.BytesIO()
    few = picture.convert("RGB").point([STEP * round(value / STEP) for value in range(256)] * 3)
    few.save(kept, "webp", lossless=True, quality=0, method=1)  # more effort saves 5 % only
    return kept.getvalue()


def write_html(title: str, parts: Sequence[Part], folder: Path) -> None:
    """Write report.html into a folder that has the drawings in figures/.

    The first part precedes the table of contents and has no heading.
    """
    drawn = [plot.name for _, blocks_of in parts for plot in plots(blocks_of)]
    small = sorted(set().union(*(thumbnails(blocks_of) for _, blocks_of in parts)))
    blocks = Page(pictures(folder / "figures", drawn) | pictures(folder, small, OF_SMALL))
    (_, first), *others = parts
    begin = element("header", blocks.all(first))
    body = [
        element("section", element("h2", name), Html("\n"), blocks.all(blocks_of), id=f"section-{k}")
        for k, (name, blocks_of) in enumerate(others, start=1)
    ]
    style, scripts = _file(STYLE), [_file(name) for name in SCRIPTS]
    head = [
        element("meta", charset="utf-8"),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        Html(f'<meta http-equiv="Content-Security-Policy" content="{_policy(style, scripts)}">'),
        element("title", title),
        element("style", style),
    ]
    numbers = element(
        "script", as_json([json.loads(column) for column in blocks.columns]), type="application/json", class_="numbers"
    )
    parts_of_page = [begin, contents([name for name, _ in others]), element("main", Html("\n"), joined(body)), numbers]
    html = element(
        "html",
        element("head", joined(head)),
        Html("\n"),
        element("body", joined(parts_of_page), *(element("script", script) for script in scripts)),
        lang="en",
    )
    write_text(folder / "report.html", f"<!doctype html>\n{html}")


def _policy(style: str, scripts: Sequence[str]) -> str:
    """Return the content security policy: nothing is fetched, and only the page's own style and scripts run."""
    hashes = " ".join(f"'{_hash(script)}'" for script in scripts)
    return f"default-src 'none'; img-src data:; style-src '{_hash(style)}'; script-src {hashes}"


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _file(name: str) -> Html:
    return Html(files(__package__).joinpath("html", name).read_text(encoding="utf-8"))
