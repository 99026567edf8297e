"""What instruments and spreadsheets write is read as its dialect says, or refused with the line and the nearest name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import openpyxl
import pandas as pd
import pytest

from calflow.files.problems import InputError
from calflow.measurements.cells import Dialect, read_cells
from calflow.measurements.measurements import Measurements
from calflow.study import load_study
from conftest import Folder

SAME = {"rtol": 0, "atol": 1e-12, "check_dtype": False}


def as_study_says(folder: Folder, **source: object) -> pd.DataFrame:
    """The measurements as the study reads them, its table `[measurements]` written anew, without their lines."""
    lines = "\n".join(f"{key} = {value}" for key, value in source.items())
    folder.edit("study.toml", ('file = "measurements.csv"', lines))
    study = load_study(folder.path)
    layout = vars(study.file.sources[0].layout)
    return Measurements.from_csv(study.measurement_path, study.robot, **layout).table.drop(columns="line")


@pytest.fixture
def plain(small: Folder) -> pd.DataFrame:
    """The small study's rows."""
    study = load_study(small.path)
    return Measurements.from_csv(study.measurement_path, study.robot).table.drop(columns="line")


def workbook(path: Path, sheets: dict[str, list[list[object]]]) -> None:
    """Write a workbook of sheets."""
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(row)
    book.save(path)


def mapping(names: dict[str, str]) -> str:
    """A mapping of columns as TOML has it within a line."""
    return "{" + ", ".join(f"{ours} = '{theirs}'" for ours, theirs in names.items()) + "}"


def typed_rows(rows: pd.DataFrame) -> list[list[object]]:
    """Rows with numbers as numbers, as a workbook holds them."""
    return [
        [float(cell) if cell.replace(".", "").lstrip("-").isdigit() else cell for cell in row]
        for row in rows.to_numpy()
    ]


def test_an_instrument_export_is_read(small, plain):
    """Fails if lines before the header, Windows' encoding, decimal commas or separators that end a line are not read."""
    rows = small.rows.rename(columns={"x_mm": "Meßwert X [µm]"})
    rows["Meßwert X [µm]"] = [repr(1e3 * float(x)) for x in small.rows["x_mm"]]
    text = rows.to_csv(sep=";", index=False).replace(".", ",").replace("\n", ";\r\n")
    (small / "export.txt").write_bytes(f"Gerät: AT960\r\nMeßart\tpräzise\r\n\r\n{text}".encode("cp1252"))
    names = {name: name for name in small.rows} | {"x_um": "Meßwert X [µm]"}
    del names["x_mm"]
    columns = mapping(names)
    read = as_study_says(
        small, file='"export.txt"', separator='";"', decimal='","', encoding='"cp1252"', header_line=4,
        columns=columns,
    )  # fmt: skip
    pd.testing.assert_frame_equal(read[list(plain)], plain, **SAME)


def test_a_file_without_names_is_read_by_their_list(small, plain):
    """Fails if the first row counts as a header, or a column that is not read is missed in the count."""
    rows = small.rows
    rows.insert(2, "other", "17")
    rows.to_csv(small / "bare.csv", index=False, header=False)
    names = ["" if name == "other" else name for name in rows]
    pd.testing.assert_frame_equal(as_study_says(small, file='"bare.csv"', columns=names), plain, **SAME)


@pytest.mark.parametrize("decimal", [".", ","])
def test_a_file_without_names_is_told_as_such(small, decimal):
    """Fails if figures are taken for names, and a name that is there twice is complained of."""
    lines = (small / "measurements.csv").read_text(encoding="utf-8").splitlines()[1:]
    written = "\n".join(lines).replace(",", ";").replace(".", decimal)
    (small / "measurements.csv").write_text(written, encoding="utf-8")
    with pytest.raises(InputError, match=r"csv:1: expected the columns' names, found figures: .*calflow import"):
        as_study_says(small, file='"measurements.csv"', separator='";"', decimal=f'"{decimal}"')


def test_columns_in_blanks_are_read(small, plain):
    """Fails if columns that blanks and tabs hold apart, as robots' logs have them, need one blank each."""
    rows = small.rows.drop(columns=["split"], errors="ignore").replace("", "-")
    text = rows.to_string(index=False, header=False)
    (small / "log.txt").write_text(f"# columns: {' '.join(rows)}\n{text}\n")
    names = ["" if name == "payload" else name for name in rows]
    read = as_study_says(small, file='"log.txt"', separator='" "', header_line=1, columns=names)
    np.testing.assert_allclose(read[["q1", "x"]], plain[["q1", "x"]], atol=1e-12)


def test_of_columns_of_one_name_each_can_be_said(small, plain):
    """Fails if the second column of a name cannot be read, or the plain name silently takes one of them."""
    rows = small.rows
    doubled = pd.concat([rows.assign(x_mm="0"), rows["x_mm"]], axis=1)
    doubled.to_csv(small / "measurements.csv", index=False)
    names = {name: name for name in rows} | {"x_mm": "x_mm (2)"}
    columns = mapping(names)
    pd.testing.assert_frame_equal(as_study_says(small, file='"measurements.csv"', columns=columns), plain, **SAME)
    small.edit("study.toml", ("'x_mm (2)'", "'x_mm'"))
    (told,) = small.refused("check")
    assert told.startswith("measurements.csv:1: column 'x_mm' is there twice") or "did you mean 'x_mm (" in told


@pytest.mark.parametrize("decimal", [".", ","])
def test_a_workbook_is_read(small, plain, decimal):
    """Fails if a sheet's numbers are rounded, its texts with decimal commas are not read, or another sheet is taken."""
    rows = small.rows
    cells = typed_rows(rows)
    k = list(rows).index("x_mm")
    for row in cells[::2] if decimal == "," else []:  # as where a sheet was pasted together
        row[k] = str(row[k]).replace(".", ",")
    sheet = [["Report"], [], list(rows), *cells]
    workbook(small / "points.xlsx", {"About": [["nothing"]], "Points": sheet})
    source = {"file": '"points.xlsx"', "sheet": '"Points"', "header_line": 3, "decimal": f'"{decimal}"'}
    if decimal == ",":
        source["separator"] = '";"'
    pd.testing.assert_frame_equal(as_study_says(small, **source), plain, **SAME)


REFUSED = {
    "no sheet named": ({"file": '"p.xlsx"'}, "p.xlsx: has several sheets: say sheet = … in the study's [measurements], one of"),
    "another sheet": ({"file": '"p.xlsx"', "sheet": '"Point"'}, "no sheet 'Point', did you mean 'Points'?"),
    "beyond the sheet": ({"file": '"p.xlsx"', "sheet": '"About"', "header_line": 9}, "expected the header in line 9"),
    "beyond the file": ({"file": '"measurements.csv"', "header_line": 999}, "measurements.csv: has 81 lines: expected the header"),
    "line 0": ({"file": '"measurements.csv"', "header_line": 0}, "header_line: expected a number greater than or equal to 1"),
    "no such encoding": ({"file": '"measurements.csv"', "encoding": '"cp125"'}, "did you mean 'cp1252'?"),
    "no text's encoding": ({"file": '"measurements.csv"', "encoding": '"zlib"'}, "encoding: expected a name such as utf-8"),
    "too few names": ({"file": '"measurements.csv"', "columns": '["q1_deg"]'}, "1: has more values than the 1 names"),
    "an unknown name": ({"file": '"bare.csv"', "columns": '["q1_dg", "q2_deg"]'}, "unknown column 'q1_dg', did you mean 'q1_deg'?"),
    "names no texts": ({"file": '"measurements.csv"', "columns": "[1, 2]"}, "columns: expected a table of names, our"),
    "a number": ({"file": '"measurements.csv"', "columns": "3"}, "measurements.columns: expected a table of names, our name"),
}  # fmt: skip


@pytest.mark.parametrize(("source", "expected"), REFUSED.values(), ids=REFUSED)
def test_a_dialect_that_does_not_fit_is_refused(small, source, expected):
    """Fails if a wrong key of the dialect ends in a traceback, or is not told with what would do."""
    workbook(small / "p.xlsx", {"About": [["nothing"]], "Points": [["q1_deg"], [1.0]]})
    (small / "bare.csv").write_text("1,2\n")
    lines = "\n".join(f"{key} = {value}" for key, value in source.items())
    small.edit("study.toml", ('file = "measurements.csv"', lines))
    assert expected in "\n".join(small.refused("check"))


def test_the_line_after_a_title_is_proposed_as_header_also_with_another_separator(tmp_path):
    """Fails if decimal commas in the first row of figures make it the header line that is proposed."""
    path = tmp_path / "german.csv"
    path.write_text("Report\na;b\n1,5;2,5\n")
    with pytest.raises(InputError, match="say header_line = 2 "):
        read_cells(path, Dialect())
