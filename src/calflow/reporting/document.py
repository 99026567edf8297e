"""The PDF: a report's blocks as typst markup with their drawings."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from functools import singledispatch
from pathlib import Path

from matplotlib.text import Text

from calflow.files.writing import inside, utf8, write_whole
from calflow.reporting.blocks import (
    Block,
    Bullets,
    Card,
    Columns,
    Gap,
    Heading,
    Paragraph,
    Part,
    Plot,
    RestOfPage,
    Signatures,
    Table,
    plots,
)
from calflow.reporting.fonts import Fonts, fonts_for

LONG = re.compile(r"(\S{24})(?=\S{8})")  # so many letters without a space, after which a line may end
SERIF = "Libertinus Serif"  # which typst brings along
WHOLE = 16  # rows up to which a table is kept on one page

TEMPLATE = Path(__file__).with_name("template.typ")


def plain(text: object) -> str:
    """Return text as markup that shows it letter by letter, whatever it holds."""
    broken = LONG.sub("\\1\u200b", str(text)).replace("\r", " ").replace("\n", " ")
    return f"#{_quoted(broken)};"


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


@singledispatch
def markup(block: Block) -> str:
    """Return a block as typst markup."""
    raise TypeError(f"no markup for {type(block).__name__}")


@markup.register
def _heading(block: Heading) -> str:
    return f"#heading(level: {block.level})[{plain(block.text)}]" if block.level else f"#title[{plain(block.text)}]"


@markup.register
def _paragraph(block: Paragraph) -> str:
    weight = ', weight: "bold"' if block.bold else ""
    said = f"#par[#text({block.size}pt{weight})[{plain(block.text)}]]"
    return f"#block(sticky: true)[{said}]" if block.keep else said


@markup.register
def _gap(block: Gap) -> str:
    return f"#v({block.points}pt, weak: true)"


@markup.register
def _bullets(block: Bullets) -> str:
    lines = [
        f"- #strong[{plain(item[0])}] {plain(item[1])}" if isinstance(item, tuple) else f"- {plain(item)}"
        for item in block.items
    ]
    size = f"#set text({block.size}pt)" if block.size else ""
    return f"#[{size}\n" + "\n".join(lines) + "\n]"


@markup.register
def _table(block: Table) -> str:
    columns = ", ".join("1fr" if i == block.wide else "auto" for i in range(len(block.header)))
    sides = ", ".join("right" if letter == "r" else "left" for letter in block.align)
    head = ", ".join(f"[#strong[{plain(cell)}]]" for cell in block.header)
    lines = []
    for k, row in enumerate(block.rows):
        if isinstance(row, str):
            across = f"colspan: {len(block.header)}, align: left, inset: (top: 6pt, rest: 3pt)"
            lines.append(f"table.cell({across})[#emph[{plain(row)}]],")
        else:
            fill = "fill: luma(232)" if k in block.shaded else ""
            lines.append(" ".join(f"table.cell({fill})[{plain(cell)}]," for cell in row))
    size = f"{block.size}pt, " if block.size else ""
    breakable = str(len(block.rows) > WHOLE).lower()
    return (
        f'#block(breakable: {breakable})[#set text({size}number-width: "tabular")\n#set par(leading: 0.45em)\n'
        f"#table(columns: ({columns},), align: ({sides},), stroke: none, inset: (x: 0.55em, y: 0.27em),\n"
        f"table.hline(stroke: 0.8pt), table.header({head}), table.hline(stroke: 0.4pt),\n"
        + "\n".join(lines)
        + "\ntable.hline(stroke: 0.8pt))]"
    )


@markup.register
def _plot(block: Plot) -> str:
    image = f'image("/figures/{block.name}.svg", width: {block.width}%)'
    return f"#figure({image}, caption: [{plain(block.caption)}])" if block.caption else f"#{image}"


@markup.register
def _card(block: Card) -> str:
    look = ', fill: rgb("#1f3f66"), ink: white' if block.dark else ""
    return f"#card([{plain(block.head)}], [{plain(block.big)}], [{plain(block.small)}]{look})"


@markup.register
def _columns(block: Columns) -> str:
    fractions = ", ".join(f"{width}fr" for width in block.widths)
    cells = ",\n".join("[" + _joined(part) + "]" for part in block.parts)
    return f"#grid(columns: ({fractions},), column-gutter: {block.between}pt,\n{cells})"


@markup.register
def _rest_of_page(block: RestOfPage) -> str:
    return f"#rest-of-page[\n{_joined(block.blocks)}\n]"


@markup.register
def _signatures(block: Signatures) -> str:
    fractions = ", ".join("1fr" for _ in block.names)
    cells = ", ".join(f"[#line(length: 100%, stroke: 0.6pt) #text(8.8pt)[{plain(name)}]]" for name in block.names)
    return f"#block(above: 16mm, below: 8mm, breakable: false, grid(columns: ({fractions},), column-gutter: 12mm, {cells}))"


def _joined(blocks: Sequence[Block]) -> str:
    return "\n\n".join(markup(block) for block in blocks)


def source(title: str, parts: Sequence[Part], families: Sequence[str] = ()) -> str:
    """Return the document's typst source; the first part has no heading, and a page of its own where it fills the rest of one.

    Letters that the report's own font lacks are taken from families.
    """
    body = [
        f"#let families = ({', '.join(map(_quoted, (SERIF, *families)))},)",
        f"#set document(title: {plain(title)[1:-1]}, date: none)\n#let title-text = [{plain(title)}]",
        TEMPLATE.read_text(encoding="utf-8"),
    ]
    for k, (name, blocks) in enumerate(parts):
        if k == 1 and any(isinstance(block, RestOfPage) for block in parts[0][1]):
            body.append("#pagebreak()")
        said = _joined([Heading(name, 1), *blocks] if k else blocks)
        body.append(f"#last-section[\n{said}\n]" if 0 < k == len(parts) - 1 else said)
    return "\n\n".join(body) + "\n"


def write(title: str, parts: Sequence[Part], folder: Path) -> int:
    """Write figures/*.svg and report.pdf into a folder; return the number of figures.

    The source goes to typst from memory, so that nothing but the report lies in the folder.

    Raises:
        InputError: a link leads out of the folder.
    """
    import typst

    figures = inside(folder, "figures")
    figures.mkdir(parents=True, exist_ok=True)
    drawings = [plot for _, blocks in parts for plot in plots(blocks)]
    text = source(title, parts)
    fonts = _fonts(text, drawings)
    for plot in drawings:
        write_whole(figures / f"{plot.name}.svg", _svg(plot))
    for old in set(figures.glob("*.svg")) - {figures / f"{plot.name}.svg" for plot in drawings}:
        old.unlink()  # of an earlier run with other tables
    written = utf8(fonts.legible(source(title, parts, fonts.families)))
    places = [str(place) for place in fonts.folders]
    pdf = typst.compile(written, root=str(folder), ignore_system_fonts=True, font_paths=places)  # type: ignore[misc]
    write_whole(folder / "report.pdf", pdf)
    return len(drawings)


def _svg(plot: Plot) -> bytes:
    drawn = io.BytesIO()
    plot.drawn.savefig(drawn, format="svg", metadata={"Date": None, "Creator": None})
    return drawn.getvalue()


def _fonts(text: str, drawings: Sequence[Plot]) -> Fonts:
    """Return the fonts that text and figures need, and give the figures those that they lack."""
    written = [said for plot in drawings for said in plot.drawn.findobj(Text)]
    fonts = fonts_for({*text, *(letter for said in written for letter in said.get_text())})
    if len(fonts.families) > 1 or fonts.lacking:
        for said in written:
            said.set_text(fonts.legible(said.get_text()))
            said.set_fontfamily(list(fonts.families))
    return fonts
