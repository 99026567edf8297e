"""Blocks of a report: its content, independent of how a PDF or a web page renders it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from calflow.files.deferred import pd
from calflow.files.words import first_up

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NEXT = "What to do next"  # a heading
SPLITS = {"train": "used for the fit", "holdout": "held out"}
Item = str | tuple[str, str]
Row = Sequence[str] | str
Look = Literal["pale", "dark", "framed"]


class Link(str):
    """A table cell that links to a file, with a thumbnail on a page where there is one.

    Both paths are relative to the report's folder; the picture is a drawing (SVG), without its suffix.
    """

    file: str
    picture: str

    def __new__(cls, text: str, file: str, picture: str = "") -> Link:
        """Return the text with the file to which it links."""
        link = super().__new__(cls, text)
        link.file, link.picture = file, picture
        return link


@dataclass(frozen=True)
class Heading:
    """A heading; the report's title has level 0, that of a section 1."""

    text: str
    level: int = 2


@dataclass(frozen=True)
class Paragraph:
    """A paragraph of a font size in points; keep: on the same page as what follows."""

    text: str
    size: float = 10
    bold: bool = False
    keep: bool = False


@dataclass(frozen=True)
class Gap:
    """A vertical space [points]."""

    points: float


@dataclass(frozen=True)
class Bullets:
    """A list; an item of two parts has its first in bold. size: font size in points, None: that of its surroundings."""

    items: Sequence[Item]
    size: float | None = 10
    numbered: bool = False


@dataclass(frozen=True)
class Table:
    """A table whose header is repeated on each page; a short one is kept on one page.

    align: a letter per column, l or r; a row that is a string is a heading across; shaded: indices of rows; wide: index
    of the column that takes the remaining width; size: font size [points], None: that of its surroundings; halved:
    whether it is set in two columns.
    """

    header: Sequence[str]
    rows: Sequence[Row]
    align: str
    shaded: frozenset[int] = frozenset()
    size: float | None = 9
    wide: int | None = None
    halved: bool = False


@dataclass(frozen=True, eq=False)
class PosedRobot:
    """A robot at the poses of a scene: origins of links (n_poses, n_links, 3) [mm], and pairs joined by lines.

    pose: index of the pose of each point of the scene, -1 where the robot is not drawn.
    """

    links: np.ndarray
    edges: Sequence[tuple[int, int]]
    pose: Sequence[int]


@dataclass(frozen=True)
class Scene:
    """Points in space with their errors, as an interactive view in place of a plot's drawing on a page.

    shown: row numbers in the plot's data, whose columns have position (x_mm, y_mm, z_mm), error (dx_mm, dy_mm, dz_mm,
    error_mm) and held_out; told: columns that identify a row; factor: initial magnification of errors; arm: the robot.
    """

    shown: Sequence[int]
    factor: float
    told: Sequence[str]
    arm: PosedRobot | None = None


@dataclass(frozen=True)
class Plot:
    """A figure with its data and caption; width in percent of the text's width."""

    name: str
    drawn: Figure
    caption: str = ""
    data: pd.DataFrame = field(default_factory=pd.DataFrame)
    width: int = 100
    scene: Scene | None = None


@dataclass(frozen=True)
class Card:
    """A large number or word with its unit, a heading and an explanation."""

    head: str
    big: str
    small: str
    look: Look = "pale"
    unit: str = "mm"


@dataclass(frozen=True)
class Columns:
    """Columns of blocks; widths are relative, the space between them is in points."""

    parts: Sequence[Sequence[Block]]
    widths: Sequence[float]
    between: int = 14


@dataclass(frozen=True)
class RestOfPage:
    """Blocks that fill the rest of a page, in the largest font that fits.

    steps: a numbered list below them, the most valuable first; those that do not fit legibly follow later.
    """

    blocks: Sequence[Block]
    steps: Sequence[str] = ()


@dataclass(frozen=True)
class Divider:
    """A divider of the report: a title, and a description of what follows."""

    title: str
    text: str


@dataclass(frozen=True)
class Signatures:
    """Lines for signatures, side by side, each with its purpose."""

    names: Sequence[str]


Block = Heading | Paragraph | Gap | Bullets | Table | Plot | Card | Columns | RestOfPage | Signatures | Divider
Part = tuple[str, Sequence[Block]]  # a section's title and its blocks


def cover(
    kind: str,
    title: str,
    facts: Sequence[Block],
    verdict: str,
    sentences: Sequence[str] = (),
    cards: Sequence[Card] = (),
    *,
    bold: bool = False,
) -> list[Block]:
    """Return the beginning of a report: its kind, title, facts, verdict with further sentences, and cards."""
    side_by_side: list[Block] = [Columns([[card] for card in cards], [1] * len(cards), 8), Gap(8)]
    return [
        Paragraph(kind),
        Heading(title, 0),
        *facts,
        Gap(16),
        Paragraph(verdict, 14, bold=True),
        Gap(6),
        *(Paragraph(sentence, 11, bold=bold) for sentence in sentences),
        Gap(10),
        *(side_by_side if cards else ()),
    ]


def in_a_line(*facts: str) -> str:
    """Return the facts that are there, beside each other."""
    return "  ·  ".join(filter(None, facts))


def noted(heading: str, notes: Sequence[str]) -> list[Block]:
    """Return notes as a list of sentences under a heading, none without notes."""
    return headed(heading, Bullets([first_up(f"{note}.") for note in notes], 9.5), where=notes)


def listing(items: Sequence[Item]) -> list[Block]:
    """Return a list block, none for no items."""
    return [Bullets(items)] if items else []


def headed(heading: str, *blocks: Block, where: object = True) -> list[Block]:
    """Return blocks under a heading, none unless `where` is true."""
    return [Heading(heading), *blocks] if where else []


def thumbnails(blocks: Sequence[Block]) -> set[str]:
    """Return the thumbnails in top-level tables."""
    rows = [row for block in blocks if isinstance(block, Table) for row in block.rows]
    return {cell.picture for row in rows for cell in row if isinstance(cell, Link) and cell.picture}


def plots(blocks: Sequence[Block]) -> Iterator[Plot]:
    """Yield all figures in order, also those nested in other blocks."""
    for block in blocks:
        if isinstance(block, Plot):
            yield block
        elif isinstance(block, Columns):
            for part in block.parts:
                yield from plots(part)
        elif isinstance(block, RestOfPage):
            yield from plots(block.blocks)
