"""The page: one file that needs nothing else, holds what the PDF holds, and works in a browser."""

from __future__ import annotations

import base64
import io
import json
import re
import struct
from collections import Counter
from collections.abc import Sequence
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from PIL import Image, ImageColor

from calflow.reporting.blocks import (
    Bullets,
    Card,
    Columns,
    Heading,
    Paragraph,
    Part,
    Plot,
    PosedRobot,
    RestOfPage,
    Scene,
    Table,
)
from calflow.reporting.page import VOID, Html, element, packed, pictures, write_html
from calflow.reporting.style import DARK, figure, style
from reporting.browser import CHROMIUM, browser

NASTY = "</script><img src=x onerror=alert(1)> & \"two\" 'three' \x00 工業ロボット " + "long" * 60
SIZES = ("1,234.5", "−0.3", "–", "< 10⁻⁶", "12")


def parts() -> list[Part]:
    """A report of every kind of block, with names that nobody expects."""
    rng = np.random.default_rng(0)
    rows = pd.DataFrame(rng.normal(0, 1000, (40, 3)), columns=["x_mm", "y_mm", "z_mm"])
    rows[["dx_mm", "dy_mm", "dz_mm"]] = rng.normal(0, 0.1, (40, 3))
    rows.loc[3, ["dx_mm", "dy_mm", "dz_mm"]] = np.nan  # a length has no direction
    rows = rows.assign(error_mm=0.1, held_out=rows.index % 3 == 0, pose=[f"{k} {NASTY}" for k in rows.index])
    with style():
        drawn = figure(2.0)
        drawn.add_subplot().plot([0, 1], [0, 1])
    arm = PosedRobot(rng.normal(0, 1000, (2, 3, 3)), [(0, 1), (1, 2)], [k % 3 - 1 for k in range(20)])
    cards = Columns(
        [[Card("nominal", "1.5", "largest 2 mm")], [Card("calibrated", "0.1", "largest 0.2 mm", "dark")]], [1, 1]
    )
    names = ("a", "b", "c", "d", "e")
    table = Table(
        ("name", ""), [*zip(names[:3], SIZES[:3], strict=True), "group", *zip(names[3:], SIZES[3:], strict=True)], "lr"
    )
    return [
        ("Verdict", [Heading(NASTY, 0), cards, RestOfPage([Heading("Next"), Bullets([("Bold:", NASTY), "plain"], None)])]),
        ("Tables", [Paragraph(NASTY), table]),
        ("Space", [Plot("same", drawn, "The same rows.", rows),
                   Plot("space", drawn, "Errors in space.", rows, scene=Scene([*range(0, 40, 2)], 2000.0, ("pose",), arm)),
                   Plot("flat", drawn, "A line.", pd.DataFrame({"x": [0.0, 1.0], "name": [NASTY, ","]}))]),
    ]  # fmt: skip


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file, written beside its figures."""
    folder = tmp_path_factory.mktemp("page")
    (folder / "figures").mkdir()
    for name in ("space", "same", "flat"):
        (folder / "figures" / f"{name}.svg").write_text(
            '<svg xmlns="http://www.w3.org/2000/svg" width="10" height="10"/>'
        )
    write_html(NASTY, parts(), folder)
    return folder / "report.html"


class Reader(HTMLParser):
    """Reads elements that must close in their order, and keeps what they hold."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert len({name for name, _ in attrs}) == len(attrs)
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] not in ("script", "style"):
            self.text += data


@pytest.fixture(scope="module")
def read(page: Path) -> Reader:
    reader = Reader()
    reader.feed(page.read_text(encoding="utf-8"))
    reader.close()
    return reader


def test_every_element_is_closed_and_every_id_is_one(read: Reader) -> None:
    """Fails if a name's angle brackets open an element, an element is left open, or two have one id."""
    assert read.open == []
    assert "onerror" not in {name for name, _ in read.attributes}
    ids = [value for name, value in read.attributes if name == "id"]
    assert len(ids) == len(set(ids))
    assert {value[1:] for name, value in read.attributes if name == "href" and value.startswith("#")} == set(ids)
    tags = Counter(read.tags)
    assert tags["html"] == tags["head"] == tags["body"] == tags["main"] == tags["h1"] == 1
    assert all(value for name, value in read.attributes if name == "alt")


def test_names_are_shown_letter_by_letter(read: Reader) -> None:
    """Fails if a name is cut, or is taken for HTML."""
    assert read.text.count(NASTY.replace("\x00", "\ufffd")) == 4  # title, heading, item, paragraph


def test_nothing_is_fetched(page: Path, read: Reader) -> None:
    """Fails if the page refers to anything outside itself, or lets a script of a name's run."""
    assert not re.search(r"https?://|//[a-z]", page.read_text(encoding="utf-8").lower().replace("// ", ""))
    refers = [value for name, value in read.attributes if name in ("src", "href", "data", "action", "srcset")]
    assert all(value.startswith(("data:", "#")) for value in refers)
    (policy,) = [value for name, value in read.attributes if value.startswith("default-src")]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert not [name for name, _ in read.attributes if name.startswith("on") or name == "style"]


def test_every_figures_numbers_are_in_the_page_once(page: Path, read: Reader) -> None:
    """Fails if a figure or a table cannot be saved, a column does not read back, or one is stored for each figure that has it."""
    text = page.read_text(encoding="utf-8")
    assert [value for name, value in read.attributes if name == "data-file"] == [
        "table_1.csv",
        "same.csv",
        "space.csv",
        "flat.csv",
    ]
    stored = json.loads(text.partition('class="numbers">')[2].partition("</script>")[0])
    same, space, flat = (json.loads(value) for name, value in read.attributes if name == "data-columns")
    assert same == space
    assert len(stored) == len(space) + len(flat)
    (_, (_, given, line)) = parts()[2]
    assert isinstance(given, Plot)
    assert isinstance(line, Plot)
    for plot, numbers in ((given, space), (line, flat)):
        found = pd.DataFrame({name: column(stored[number]) for name, number in numbers.items()})
        for name in plot.data:
            if plot.data[name].dtype == float:
                np.testing.assert_allclose(found[name].astype(float), plot.data[name], rtol=1e-6)
            else:
                assert found[name].tolist() == plot.data[name].tolist()


def column(stored: dict[str, Any]) -> list[Any]:
    """A column's values, read from what the page holds of it."""
    if "codes" in stored:
        return [stored["values"][code] for code in base64.b64decode(stored["codes"])]
    return list(struct.iter_unpack("<f", base64.b64decode(stored["floats"]))) if "floats" in stored else stored["texts"]


@pytest.mark.parametrize(
    "values",
    [[True, False, True], ["a", "", "a"], [1.5, np.nan, 1.5], range(300), [f"pose {k}" for k in range(300)], []],
)
def test_a_column_reads_back(values: Sequence[Any]) -> None:
    """Fails if a kind of column loses its values, or what is not known is more than nothing."""
    found = column(packed(pd.Series(values, dtype=None if len(values) else float)))
    found = [value[0] if isinstance(value, tuple) else value for value in found]
    assert [None if isinstance(value, float) and np.isnan(value) else value for value in values] == found


def test_pictures_are_small_and_keep_their_colours(tmp_path: Path) -> None:
    """Fails if a drawing of thousands of points makes the page large, or comes out in other colours."""
    rng = np.random.default_rng(0)
    with style():
        drawn = figure(2.0)
        drawn.add_subplot().scatter(*rng.normal(size=(2, 5000)), s=2, color=DARK, linewidths=0)
        drawn.savefig(tmp_path / "crowd.svg")
    assert (tmp_path / "crowd.svg").stat().st_size > 300_000
    (seen,) = pictures(tmp_path, ["crowd"]).values()
    assert len(seen) < 60_000
    colours = Image.open(io.BytesIO(seen)).convert("RGB").getcolors(1 << 16)
    assert colours is not None
    assert sorted(colours)[-1][1] == (255, 255, 255)
    near = [
        n for n, colour in colours if max(abs(a - b) for a, b in zip(colour, ImageColor.getrgb(DARK), strict=True)) < 12
    ]
    assert sum(near) > 1000


def test_an_element_escapes_all_but_html() -> None:
    """Fails if text or an attribute's value can end its element."""
    assert (
        element("p", "<b>", Html("<i></i>"), title='a"b', hidden=True, class_="")
        == '<p title="a&quot;b" hidden>&lt;b&gt;<i></i></p>'
    )
    assert element("input", min=0) == '<input min="0">'


PICTURE = "document.querySelector('canvas').toDataURL()"
FRAME = "(() => { const c = document.querySelector('canvas'); c.scrollIntoView({block: 'center'});" \
        " const f = c.getBoundingClientRect(); return [f.x + f.width / 2, f.y + f.height / 2] })()"  # fmt: skip
SAVED = """new Promise(done => {
  URL.createObjectURL = blob => { blob.text().then(done); return 'data:,' };
  HTMLAnchorElement.prototype.click = () => {};
  document.querySelector('[data-file="%s"]').click();
})"""  # what a button saves, without a file
POSE = """(() => { const slider = document.querySelector('[data-does=pose]'); slider.value = %d;
  slider.dispatchEvent(new Event('input')) })()"""
COLUMN = "[...document.querySelectorAll('tbody tr:not(.group)')].map(row => row.cells[1].textContent)"


@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")
def test_the_page_works_in_a_browser(page: Path, tmp_path: Path) -> None:
    """Fails if the page complains, asks for anything or does not fit a telephone, or mouse, finger or keys move nothing."""
    with browser(tmp_path) as seen:
        for width in (1200, 360):
            seen.open(page, width)
            assert seen.value("document.documentElement.scrollWidth") <= width
            assert seen.value("[...document.images].every(image => image.width <= image.parentElement.clientWidth)")
            x, y = seen.value(FRAME)
            for move in (seen.drag, seen.swipe):
                before = seen.value(PICTURE)
                assert len(before) > 5000  # something is drawn
                move((x, y), (x + 60, y + 20))
                assert seen.value(PICTURE) != before
        before = seen.value(PICTURE)
        seen.value("document.querySelector('canvas').focus()")
        seen.press("ArrowLeft")
        assert seen.value(PICTURE) != before
        before = seen.value(PICTURE)
        seen.value(POSE % 1)  # of the robot
        seen.drawn()
        assert seen.value(PICTURE) != before
        assert "the largest there" in seen.value("document.querySelector('.told').textContent")
        seen.value("document.querySelectorAll('th button')[1].focus()")
        seen.press("Enter", "\r")
        assert seen.value(COLUMN) == [
            "−0.3",
            "1,234.5",
            "–",
            "< 10⁻⁶",
            "12",
        ]  # within each group, what is not known last
        before = seen.value(PICTURE)
        seen.value("document.querySelector('canvas').focus()")
        seen.press("ArrowLeft")
        assert seen.value(PICTURE) != before
        seen.value("document.querySelectorAll('th button')[1].focus()")
        seen.press("Enter", "\r")
        assert seen.value(COLUMN) == ["1,234.5", "−0.3", "–", "12", "< 10⁻⁶"]
        saved = pd.read_csv(io.StringIO(seen.value(SAVED % "space.csv")))
        given = parts()[2][1][1]
        assert isinstance(given, Plot)
        pd.testing.assert_frame_equal(saved, given.data, rtol=1e-6)
        table = pd.read_csv(io.StringIO(seen.value(SAVED % "table_1.csv")), dtype=str)
        assert sorted(table.iloc[:, 1]) == sorted(SIZES)
        assert seen.complaints == []
