"""The page about fleets says what is so."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from calflow.files.tables import columns
from calflow.fleet.fleet_file import FleetFile
from calflow.fleet.standing import Outcome
from calflow.fleet.types import TypeParameter
from calflow.population.common_causes import CommonCause
from calflow.population.unlike import Unlike

PAGE = (Path(__file__).parents[2] / "docs" / "fleet.md").read_text(encoding="utf-8")


def test_the_fleet_file_of_the_page_can_be_read():
    """Fails if a user who copies it is refused."""
    (example,) = re.findall(r"^```toml\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
    assert list(FleetFile.model_validate(tomllib.loads(example)).types) == ["hh800", "kr210"]


@pytest.mark.parametrize(
    ("table", "rows"),
    [("fleet.csv", Outcome), ("type_parameters.csv", TypeParameter), ("unlike.csv", Unlike),
     ("common_causes.csv", CommonCause)],
)  # fmt: skip
def test_every_column_of_a_table_is_told(table, rows):
    """Fails if a table has a column that the page does not explain as the code does, or the page one that is not there."""
    (section,) = re.findall(rf"^\| column of `{re.escape(table)}` \|.*?\n\n", PAGE, re.DOTALL | re.MULTILINE)
    told = dict(re.findall(r"^\| `(\w+)` \| .* \| ([^|]+) \|$", section, re.MULTILINE))
    assert {column.name: column.meaning for column in columns(rows)} == told
