"""What a report is made of: blocks that know what they say, and not how a PDF or a page shows it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from matplotlib.figure import Figure

from calflow.files.deferred import pd

NEXT = "What to do next"  # a heading
SPLITS = {"train": "used for the fit", "holdout": "held out"}
Item = str | tuple[str, str]
Row = Sequence[str] | str
Look = Literal["pale", "dark", "framed"]


class Link(str):
    """A table's cell that leads to a file, on a page by a small picture where there is one.

    Both are named as seen from the report's folder; the picture is a drawing (SVG), without the end of its name.
    """

    file: str
    picture: str

    def __new__(cls, text: str, file: str, picture: str = "") -> Link:
        """Return the text with the file that it leads to."""
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
    """A paragraph, its letters in points; keep holds it on one page with what follows."""

    text: str
    size: float = 10
    bold: bool = False
    keep: bool = False


@dataclass(frozen=True)
class Gap:
    """An empty space [points]."""

    points: float


@dataclass(frozen=True)
class Bullets:
    """A list; an item of two parts has its first in bold. Its letters are in points, or as those around it."""

    items: Sequence[Item]
    size: float | None = 10
    numbered: bool = False


@dataclass(frozen=True)
class Table:
    """A table whose header is repeated on each page; a short one is kept on one page.

    align has a letter a column, l or r; a row that is one string is a heading across; shaded names rows; the column
    wide takes the width that is left. Its letters are in points, or as those around it. halved: it stands in two columns.
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
    """A robot at the poses of a scene: where its links begin, (n_poses, n_links, 3) [mm], and from which to which a line goes.

    pose has the pose of each point of the scene, -1 where the robot is not drawn at it.
    """

    links: np.ndarray
    edges: Sequence[tuple[int, int]]
    pose: Sequence[int]


@dataclass(frozen=True)
class Scene:
    """Points in space with their errors, to be turned by whoever looks: what stands beside a drawing on a page.

    They are rows of the plot's data: shown has their numbers there. Its columns have position (x_mm, y_mm, z_mm), error (dx_mm,
    dy_mm, dz_mm, error_mm) and held_out; told names those that say which row it is. factor is by how much errors are enlarged
    at first. arm is the robot among them, where there is one.
    """

    shown: Sequence[int]
    factor: float
    told: Sequence[str]
    arm: PosedRobot | None = None


@dataclass(frozen=True)
class Plot:
    """A figure with the numbers that it shows, and its caption; width is in percent of the text's."""

    name: str
    drawn: Figure
    caption: str = ""
    data: pd.DataFrame = field(default_factory=pd.DataFrame)
    width: int = 100
    scene: Scene | None = None


@dataclass(frozen=True)
class Card:
    """A large number or word with its unit, what it is and what it goes with."""

    head: str
    big: str
    small: str
    look: Look = "pale"
    unit: str = "mm"


@dataclass(frozen=True)
class Columns:
    """Columns of blocks; widths are shares, the space between them is in points."""

    parts: Sequence[Sequence[Block]]
    widths: Sequence[float]
    between: int = 14


@dataclass(frozen=True)
class RestOfPage:
    """Blocks that fill what is left of a page, in the largest letters with which they have room there.

    steps are a numbered list below them, what is worth most first: those without room in letters that are pleasant to read stand
    further on.
    """

    blocks: Sequence[Block]
    steps: Sequence[str] = ()


@dataclass(frozen=True)
class Divider:
    """What divides a report: a title, and what follows it."""

    title: str
    text: str


@dataclass(frozen=True)
class Signatures:
    """Places to sign, side by side, with what each is for."""

    names: Sequence[str]


Block = Heading | Paragraph | Gap | Bullets | Table | Plot | Card | Columns | RestOfPage | Signatures | Divider
Part = tuple[str, Sequence[Block]]  # a section's title and what stands in it


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
    """Return what a report begins with: what it is and of what, the verdict, the sentences that say more, and its figures."""
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


def listing(items: Sequence[Item]) -> list[Block]:
    """Return a list, where there is anything in it."""
    return [Bullets(items)] if items else []


def headed(heading: str, *blocks: Block, where: object = True) -> list[Block]:
    """Return blocks with a heading, where there is anything to say."""
    return [Heading(heading), *blocks] if where else []


def thumbnails(blocks: Sequence[Block]) -> set[str]:
    """Return the small pictures of tables that stand among blocks by themselves."""
    rows = [row for block in blocks if isinstance(block, Table) for row in block.rows]
    return {cell.picture for row in rows for cell in row if isinstance(cell, Link) and cell.picture}


def plots(blocks: Sequence[Block]) -> Iterator[Plot]:
    """Return all figures, in their order, wherever they stand."""
    for block in blocks:
        if isinstance(block, Plot):
            yield block
        elif isinstance(block, Columns):
            for part in block.parts:
                yield from plots(part)
        elif isinstance(block, RestOfPage):
            yield from plots(block.blocks)
