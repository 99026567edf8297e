"""Cells and titles of foreign tables mean what people mean by them."""

from __future__ import annotations

import math

import pytest

from calflow.importing.foreign_table import figure_of, foreign_tables, name_words, split_title

FIGURES = {
    ("1.5", "."): 1.5,
    ("−1,5", ","): -1.5,
    ("1.234,5", ","): 1234.5,
    ("1,234.5", "."): 1234.5,
    ("12.5 mm", "."): 12.5,
    ("30°", "."): 30.0,
    ("2,02E+03", ","): 2020.0,
    ("1970-01-01 00:01:00.5", "."): 60.5,
    ("1970-01-01T01:00:00+01:00", "."): 0.0,
    ("01.01.1970 00:00:10", ","): 10.0,
    ("01:02:03,5", ","): 3723.5,
    ("1_000", "."): math.nan,
    ("1,5", "."): math.nan,
    ("1.5", ","): math.nan,
    ("n/a", "."): math.nan,
    ("", "."): math.nan,
}


@pytest.mark.parametrize(("cell", "decimal"), FIGURES)
def test_a_cell_is_a_figure_or_none(cell, decimal):
    """Fails if a figure is read in another country's way, or what is none becomes one."""
    assert figure_of(cell, decimal) == pytest.approx(FIGURES[cell, decimal], nan_ok=True)


TITLES = {
    "A1 [°]": ("A1", "deg"),
    "X (mm)": ("X", "mm"),
    "q1_rad": ("q1", "rad"),
    "Temperatur [°C]": ("Temperatur", "degC"),
    "J1 deg": ("J1", "deg"),
    "t/ms": ("t", "ms"),
    "Winkel grad": ("Winkel", "deg"),
    "temp_k": ("temp", "K"),
    "T/K": ("T", "K"),  # no time
    "z_min": ("z_min", ""),
    "pose_k": ("pose_k", ""),
    "theta 1": ("theta 1", ""),
    "m": ("m", ""),
    "X [counts]": ("X [counts]", ""),
    "field.header.stamp": ("field.header.stamp", ""),
}


@pytest.mark.parametrize("title", TITLES)
def test_a_title_is_a_name_and_a_unit(title):
    """Fails if a unit is lost, or a part of a name is taken for one."""
    assert split_title(title) == TITLES[title]


def test_names_are_words():
    """Fails if names that programs write together are not taken apart."""
    assert name_words("JointPos_1") == ["joint", "pos", "1"]
    assert name_words("/joint_states/elbow_joint/position") == ["joint", "states", "elbow", "joint", "position"]
    assert name_words("field.position0") == ["field", "position0"]


def test_the_figures_of_a_text_are_found(tmp_path):
    """Fails if a head, units, a mean below or a second head in the middle is taken for a row, or a row is lost."""
    rows = [f"{k};{k},5;{k},25;{k + 1},75" for k in range(1, 9)]
    text = "\n".join(
        ["Bericht;Nr. 7", "", "Nr;a;b;c", "-;mm;mm;deg", *rows[:4], "Nr;a;b;c", *rows[4:], "Mittel;;;", ""]
    )
    (tmp_path / "a.csv").write_text(text, encoding="cp1252")
    (table,) = foreign_tables(tmp_path / "a.csv")
    assert [one.title for one in table.columns] == ["Nr", "a [mm]", "b [mm]", "c [deg]"]
    assert table.columns[1].figures.tolist() == [k + 0.5 for k in range(1, 9)]
    assert "2 lines without figures left out (line 9 …)" in table.reasons


@pytest.mark.parametrize(("header", "names"), [("#;a;b;c", ["#", "a", "b", "c"]), ("# n;a;b;c", ["n", "a", "b", "c"])])
def test_a_number_sign_is_a_name_where_it_stands_alone(tmp_path, header, names):
    """Fails if the column of numbers loses its name as a comment's mark, or keeps that mark."""
    rows = [f"{k};{k}.5;{k}.25;{k}.75" for k in range(1, 9)]
    (tmp_path / "a.csv").write_text("\n".join([header, *rows, ""]), encoding="utf-8")
    (table,) = foreign_tables(tmp_path / "a.csv")
    assert [one.name for one in table.columns] == names
