"""The section on data faults: what was wrong in the measurement file, and what was done about it."""

from __future__ import annotations

import pandas as pd

from calflow.deployment.usability import Advice
from calflow.faults.base import lines_in_words
from calflow.files.results import Results
from calflow.files.words import effect_words, plural
from calflow.reporting.blocks import Block, Paragraph, Table
from calflow.reporting.material import Material
from calflow.reporting.section import Section

FAULTS = "identify/faults.csv"
SHOWN = 12  # places that a list of lines names
TOLD = 4  # faults that the first page tells, most rows first
INTRODUCTION = (
    "Mistakes in the measurement file, found before any fit because they are gross. What has one clear correction was "
    "corrected in memory; rows that nothing puts right were left out of the fit and of the judgement. The file itself is "
    "as it was: correct it, so that the next reader does not find the same mistakes."
)


def _data_faults(material: Material) -> list[Block]:
    """Tabulate each fault with its rows and what was done, then say what to do."""
    faults = _faults(material.tables[FAULTS])
    rows = [
        (effect_words(str(own["cause"].iloc[0])), str(joint or "–"), _where(own), str(own["action"].iloc[0]))
        for joint, own in ((int(own["joint"].iloc[0]), own) for own in faults)
    ]
    return [
        Paragraph(INTRODUCTION, keep=True),
        Table(("fault", "joint", "where", "what was done"), rows, "lrll", wide=2),
        *(Paragraph(_sentence(own)) for own in faults),
    ]


def correct_the_file(results: Results) -> list[Advice]:
    """What is wrong in the file is to be corrected there, once and for all."""
    faults = _faults(results.tables[FAULTS])
    said = [Advice(2, f"Correct the measurement file: {own['statement'].iloc[0]}.") for own in faults[:TOLD]]
    if len(faults) > TOLD:
        said.append(Advice(2, f"Correct the measurement file: {plural(len(faults) - TOLD, 'further fault')}, see the section on "
                              "data faults."))  # fmt: skip
    return said


def _faults(faults: pd.DataFrame) -> list[pd.DataFrame]:
    """Return the rows of each fault, those of whole columns first, then by how many rows there are."""
    groups = [own for _, own in faults.groupby(["cause", "joint", "action", "statement"], sort=False)]
    return sorted(groups, key=lambda own: -len(own) if own["line"].notna().all() else -len(faults) - 1)


def _where(own: pd.DataFrame) -> str:
    lines = own["line"].dropna().astype(int).tolist()
    return lines_in_words(lines, SHOWN) if lines else "all rows"


def _sentence(own: pd.DataFrame) -> str:
    said = str(own["statement"].iloc[0])
    return f"{said[0].upper()}{said[1:]}."


FAULTS_SECTION = Section(
    5,
    "Data faults",
    (FAULTS,),
    _data_faults,
    (correct_the_file,),
    worth_telling=lambda results: len(results.tables[FAULTS]) > 0,
)
