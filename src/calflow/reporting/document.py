"""The report as a PDF: its blocks as typst markup, in fonts that cover its characters."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.text import Text

from calflow.estimation.progress import Advance, Say, nobody
from calflow.files.writing import inside, utf8, write_whole
from calflow.reporting import page
from calflow.reporting.blocks import (
    Block,
    Bullets,
    Card,
    Columns,
    Divider,
    Gap,
    Heading,
    Look,
    Paragraph,
    Part,
    Plot,
    RestOfPage,
    Signatures,
    Table,
    plots,
)
from calflow.reporting.material import Material
from calflow.reporting.section import sections
from calflow.reporting.sections.acceptance import identity
from calflow.reporting.style import SETTINGS, style

if TYPE_CHECKING:
    from matplotlib.font_manager import FontEntry

OWN = "DejaVu Sans"  # bundled with Matplotlib
BOXES = (".LastResort", "Last Resort")  # fonts that show every character as a box
REGULAR_WEIGHT = 400
LONG = re.compile(r"(\S{24})(?=\S{8})")  # length of unbroken text after which a line may break
SERIF = "Libertinus Serif"  # bundled with typst
LOOKS: dict[Look, str] = {
    "pale": "",
    "dark": ', fill: rgb("#1f3f66"), ink: white',
    "framed": ", fill: white, frame: 2pt + black",
}
WHOLE = 16  # rows up to which a table is kept on one page
TEMPLATE = Path(__file__).with_name("template.typ")


@dataclass(frozen=True)
class Fonts:
    """Fonts by family, the folders that contain them, and the characters that none of them covers."""

    families: tuple[str, ...]
    folders: tuple[Path, ...]
    lacking: frozenset[str] = frozenset()

    def legible(self, text: str) -> str:
        """Return text with characters that no font covers replaced by their code points, which keeps names distinct."""
        return "".join(f"[U+{ord(letter):04X}]" if letter in self.lacking else letter for letter in text)


def fonts_for(text: Iterable[str]) -> Fonts:
    """Return the bundled font, and as few of this machine's fonts as cover the characters that it lacks."""
    from matplotlib import get_data_path

    font = str(Path(get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf")
    families, folders = [OWN], [Path(font).parent]
    lacking = {letter for letter in text if letter.isprintable() and not letter.isspace()} - _letters(font)
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
    """Return this machine's upright fonts, regular weights first, including any newer than Matplotlib's font list."""
    from matplotlib.font_manager import findSystemFonts, fontManager

    for file in sorted(set(findSystemFonts()) - {entry.fname for entry in fontManager.ttflist}):
        with suppress(OSError, RuntimeError):
            fontManager.addfont(file)
    upright = [entry for entry in fontManager.ttflist if entry.style == "normal" and not entry.name.startswith(BOXES)]
    return sorted(
        upright, key=lambda entry: (entry.weight != REGULAR_WEIGHT, "Serif" in entry.name, entry.name, entry.fname)
    )


@lru_cache
def _letters(file: str) -> frozenset[str]:
    """Return the characters that a font covers; none where it cannot be read."""
    from matplotlib.ft2font import FT2Font

    try:
        return frozenset(map(chr, FT2Font(file).get_charmap()))
    except (OSError, RuntimeError):
        return frozenset()


def plain(text: object) -> str:
    """Return text as markup that shows it literally."""
    broken = LONG.sub("\\1\u200b", str(text)).replace("\r", " ").replace("\n", " ")
    return f"#{_quoted(broken)};"


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def markup(block: Block) -> str:
    """Return a block as typst markup."""
    match block:
        case Heading(text, 0):
            return f"#title[{plain(text)}]"
        case Heading(text, level):
            return f"#heading(level: {level})[{plain(text)}]"
        case Paragraph():
            return _paragraph(block)
        case Gap(points):
            return f"#v({points}pt, weak: true)"
        case Bullets():
            return _bullets(block)
        case Table():
            return _table(block)
        case Plot(name, caption=caption, width=width):
            image = f'image("/figures/{name}.svg", width: {width}%)'
            return f"#figure({image}, caption: [{plain(caption)}])" if caption else f"#{image}"
        case Card():
            cells = ", ".join(f"[{plain(text)}]" for text in (block.head, block.big, block.unit, block.small))
            return f"#card({cells}{LOOKS[block.look]})"
        case Columns(parts, widths, between):
            cells = ",\n".join(map(_cell, parts))
            return f"#grid(columns: ({_fractions(widths)},), column-gutter: {between}pt,\n{cells})"
        case RestOfPage(blocks, steps):
            listed = "".join(f"[{plain(step)}], " for step in steps)
            return f"#rest-of-page(({listed}))[\n{_joined(blocks)}\n]"
        case Divider(title, text):
            return f"#divider([{plain(title)}], [{plain(text)}])"
        case Signatures(names):
            cells = ", ".join(f"[#line(length: 100%, stroke: 0.6pt) #text(8.8pt)[{plain(name)}]]" for name in names)
            lines = f"grid(columns: ({_fractions([1] * len(names))},), column-gutter: 12mm, {cells})"
            return f"#block(above: 16mm, below: 8mm, breakable: false, {lines})"


def _fractions(widths: Sequence[float]) -> str:
    return ", ".join(f"{width}fr" for width in widths)


def _paragraph(block: Paragraph) -> str:
    weight = ', weight: "bold"' if block.bold else ""
    markup = f"#par[#text({block.size}pt{weight})[{plain(block.text)}]]"
    return f"#block(sticky: true)[{markup}]" if block.keep else markup


def _bullets(block: Bullets) -> str:
    mark = "+" if block.numbered else "-"
    lines = [
        f"{mark} #strong[{plain(item[0])}] {plain(item[1])}" if isinstance(item, tuple) else f"{mark} {plain(item)}"
        for item in block.items
    ]
    size = f"#set text({block.size}pt)" if block.size else ""
    return f"#[{size}\n" + "\n".join(lines) + "\n]"


def _table(block: Table) -> str:
    columns = ", ".join("1fr" if i == block.wide else "auto" for i in range(len(block.header)))
    sides = ", ".join("right" if letter == "r" else "left" for letter in block.align)
    head = ", ".join(f"[#strong[{plain(cell)}]]" for cell in block.header)
    lines = []
    for k, row in enumerate(block.rows):
        if isinstance(row, str):
            across = f"colspan: {len(block.header)}, align: left, inset: (top: 6pt, rest: 3pt)"
            lines.append(f"table.header(level: 2, repeat: false, table.cell({across})[#emph[{plain(row)}]]),")
        else:
            fill = "fill: luma(232)" if k in block.shaded else ""
            lines.append(" ".join(f"table.cell({fill})[{plain(cell)}]," for cell in row))
    size = f"{block.size}pt, " if block.size else ""
    breakable = str(block.halved or len(block.rows) > WHOLE).lower()
    markup = (
        f'#block(breakable: {breakable})[#set text({size}number-width: "tabular")\n#set par(leading: 0.45em)\n'
        f"#table(columns: ({columns},), align: ({sides},), stroke: none, inset: (x: 0.55em, y: 0.27em),\n"
        f"table.hline(stroke: 0.8pt), table.header({head}), table.hline(stroke: 0.4pt),\n"
        + "\n".join(lines)
        + "\ntable.hline(stroke: 0.8pt))]"
    )
    return f"#newspaper[\n{markup}\n]" if block.halved else markup


def _cell(part: Sequence[Block]) -> str:
    """Return a column as a cell of a grid; a card is a cell already."""
    return markup(part[0])[1:] if len(part) == 1 and isinstance(part[0], Card) else f"[{_joined(part)}]"


def _joined(blocks: Sequence[Block]) -> str:
    return "\n\n".join(markup(block) for block in blocks)


def source(title: str, parts: Sequence[Part], families: Sequence[str] = (), identity: str = "") -> str:
    """Return the document's typst source; the first part has no heading, and a page of its own if it fills one.

    families: fonts for characters that the report's own font lacks; identity: a line on every page.
    """
    whole_page = bool(parts) and any(isinstance(block, RestOfPage) for block in parts[0][1])
    body = [
        f"#let families = ({', '.join(map(_quoted, (SERIF, *families)))},)",
        f"#set document(title: {plain(title)[1:-1]}, date: none)\n#let title-text = [{plain(title)}]",
        f"#let identity = [{plain(identity)}]",
        TEMPLATE.read_text(encoding="utf-8"),
    ]
    for k, (name, blocks) in enumerate(parts):
        if k == 1 and whole_page:
            body.append("#pagebreak()\n#further-steps")
        divides = any(isinstance(block, Divider) for block in blocks)
        markup = _joined([Heading(name, 1), *blocks] if k and not divides else blocks)
        body.append(f"#last-section[\n{markup}\n]" if 0 < k == len(parts) - 1 else markup)
    return "\n\n".join(body) + "\n"


def write_pdf(title: str, parts: Sequence[Part], folder: Path, identity: str = "") -> int:
    """Write figures/*.svg and report.pdf into a folder; return the number of figures. identity: a line on every page.

    The source is passed to typst in memory, so that the folder contains only the report.

    Raises:
        InputError: a link leads out of the folder.
    """
    import typst

    figures = inside(folder, "figures")
    figures.mkdir(parents=True, exist_ok=True)
    drawings = [plot for _, blocks in parts for plot in plots(blocks)]
    text = source(title, parts, identity=identity)
    fonts = _fonts(text, drawings)
    for plot in drawings:
        write_whole(figures / f"{plot.name}.svg", _svg(plot))
    for old in set(figures.glob("*.svg")) - {figures / f"{plot.name}.svg" for plot in drawings}:
        old.unlink()  # of an earlier run with other tables
    written = utf8(fonts.legible(source(title, parts, fonts.families, identity)))
    places = [str(place) for place in fonts.folders]
    pdf = typst.compile(written, root=str(folder), ignore_system_fonts=True, font_paths=places)  # type: ignore[misc]
    write_whole(folder / "report.pdf", pdf)
    return len(drawings)


def _svg(plot: Plot) -> bytes:
    """Draw a figure in one pass: `savefig` would draw it twice, the first time only to place its axes."""
    drawn = io.BytesIO()
    plot.drawn.set_dpi(SETTINGS["savefig.dpi"])
    FigureCanvasSVG(plot.drawn).print_svg(drawn, metadata={"Date": None, "Creator": None})
    return drawn.getvalue()


def _fonts(text: str, drawings: Sequence[Plot]) -> Fonts:
    """Return the fonts that text and figures need, and set them in the figures."""
    written = [label for plot in drawings for label in plot.drawn.findobj(Text)]
    fonts = fonts_for({*text, *(letter for label in written for letter in label.get_text())})
    if len(fonts.families) > 1 or fonts.lacking:
        for label in written:
            label.set_text(fonts.legible(label.get_text()))
            label.set_fontfamily(list(fonts.families))
    return fonts


def write_report(material: Material, folder: Path, say: Say = nobody, advance: Advance = nobody) -> None:
    """Write report.pdf, report.html and figures/*.svg into a folder."""
    with style():
        parts = []
        every = sections()
        for k, section in enumerate(every, start=1):
            if section.applies(material):
                parts.append((section.title, section.write(material)))
            advance(0.7 * k / len(every))
        n_figures = write_pdf(material.title, parts, folder, identity(material.request))
        page.write_html(material.title, parts, folder)
    say(f"report.pdf, report.html: {n_figures} figures, {len(parts)} sections")
