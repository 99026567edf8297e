"""The document: blocks of typst markup with their drawings, written as one PDF and its figures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

WHOLE = 16  # rows up to which a table is kept on one page

TEMPLATE = Path(__file__).with_name("template.typ")


@dataclass(frozen=True)
class Block:
    """A piece of markup, and the figures by name that it shows."""

    markup: str
    drawings: tuple[tuple[str, Figure], ...] = ()


def plain(text: object) -> str:
    """Return text as markup that shows it letter by letter, whatever it holds."""
    safe = str(text).replace("\\", "\\\\").replace('"', '\\"').replace("\r", " ").replace("\n", " ")
    return f'#"{safe}";'


def heading(text: str, level: int = 2) -> Block:
    """Return a heading."""
    return Block(f"#heading(level: {level})[{plain(text)}]")


def paragraph(text: str, size: float = 10, bold: bool = False, keep: bool = False) -> Block:
    """Return a paragraph; keep holds it on one page with what follows."""
    weight = ', weight: "bold"' if bold else ""
    said = f"#par[#text({size}pt{weight})[{plain(text)}]]"
    return Block(f"#block(sticky: true)[{said}]" if keep else said)


def gap(points: float) -> Block:
    """Return an empty space."""
    return Block(f"#v({points}pt, weak: true)")


def bullets(items: Iterable[str | tuple[str, str]], size: float = 10) -> Block:
    """Return a list; an item of two parts has its first in bold."""
    lines = [
        f"- #strong[{plain(item[0])}] {plain(item[1])}" if isinstance(item, tuple) else f"- {plain(item)}"
        for item in items
    ]
    return Block(f"#[#set text({size}pt)\n" + "\n".join(lines) + "\n]")


def table(
    header: Sequence[str],
    rows: Sequence[Sequence[str] | str],
    align: str,
    shaded: frozenset[int] = frozenset(),
    size: float = 9,
    wide: int | None = None,
) -> Block:
    """Return a table whose header is repeated on each page; a short one is kept on one page.

    align has a letter a column, l or r; a row that is one string is a heading across; shaded names rows; the column
    wide takes the width that is left.
    """
    columns = ", ".join("1fr" if i == wide else "auto" for i in range(len(header)))
    sides = ", ".join("right" if letter == "r" else "left" for letter in align)
    head = ", ".join(f"[#strong[{plain(cell)}]]" for cell in header)
    lines = []
    for k, row in enumerate(rows):
        if isinstance(row, str):
            across = f"colspan: {len(header)}, align: left, inset: (top: 6pt, rest: 3pt)"
            lines.append(f"table.cell({across})[#emph[{plain(row)}]],")
        else:
            fill = "fill: luma(232)" if k in shaded else ""
            lines.append(" ".join(f"table.cell({fill})[{plain(cell)}]," for cell in row))
    breakable = str(len(rows) > WHOLE).lower()
    return Block(
        f'#block(breakable: {breakable})[#set text({size}pt, number-width: "tabular")\n#set par(leading: 0.45em)\n'
        f"#table(columns: ({columns},), align: ({sides},), stroke: none, inset: (x: 5pt, y: 2.4pt),\n"
        f"table.hline(stroke: 0.8pt), table.header({head}), table.hline(stroke: 0.4pt),\n"
        + "\n".join(lines)
        + "\ntable.hline(stroke: 0.8pt))]"
    )


def plot(name: str, drawn: Figure, caption: str, width: int = 100) -> Block:
    """Return a figure with its caption; width is in percent of the text's."""
    markup = f'#figure(image("/figures/{name}.svg", width: {width}%), caption: [{plain(caption)}])'
    return Block(markup, ((name, drawn),))


def picture(name: str, drawn: Figure) -> Block:
    """Return a figure that needs no caption."""
    return Block(f'#image("/figures/{name}.svg", width: 100%)', ((name, drawn),))


def card(head: str, big: str, small: str, dark: bool = False) -> Block:
    """Return a large number in mm with what it is and what it goes with."""
    look = ', fill: rgb("#1f3f66"), ink: white' if dark else ""
    return Block(f"#card([{plain(head)}], [{plain(big)}], [{plain(small)}]{look})")


def side_by_side(parts: Sequence[Sequence[Block]], widths: Sequence[float], between: int = 14) -> Block:
    """Return columns of blocks; widths are shares, the space between them is in points."""
    fractions = ", ".join(f"{width}fr" for width in widths)
    cells = ",\n".join("[" + "\n\n".join(block.markup for block in part) + "]" for part in parts)
    drawings = tuple(drawing for part in parts for block in part for drawing in block.drawings)
    return Block(f"#grid(columns: ({fractions},), column-gutter: {between}pt,\n{cells})", drawings)


def source(title: str, parts: Sequence[tuple[str, Sequence[Block]]]) -> str:
    """Return the document's typst source; the first part stands on a page of its own, without a heading."""
    body = [
        f"#set document(title: {plain(title)[1:-1]}, date: none)\n#let title-text = [{plain(title)}]",
        TEMPLATE.read_text(encoding="utf-8"),
    ]
    for k, (name, blocks) in enumerate(parts):
        if k == 1:
            body.append("#pagebreak()")
        if k > 0:
            body.append(heading(name, 1).markup)
        body += [block.markup for block in blocks]
    return "\n\n".join(body) + "\n"


def write(title: str, parts: Sequence[tuple[str, Sequence[Block]]], folder: Path) -> int:
    """Write figures/*.svg and report.pdf into a folder; return the number of figures.

    The source goes to typst from memory, so that nothing but the report lies in the folder.
    """
    import typst

    figures = folder / "figures"
    figures.mkdir(parents=True, exist_ok=True)
    drawings = [drawing for _, blocks in parts for block in blocks for drawing in block.drawings]
    for name, drawn in drawings:
        drawn.savefig(figures / f"{name}.svg", metadata={"Date": None, "Creator": None})
    for old in set(figures.glob("*.svg")) - {figures / f"{name}.svg" for name, _ in drawings}:
        old.unlink()  # of an earlier run with other tables
    text = source(title, parts).encode()
    typst.compile(text, output=str(folder / "report.pdf"), root=str(folder), ignore_system_fonts=True)  # type: ignore[type-var]
    return len(drawings)
