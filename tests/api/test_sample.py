"""The sample of the documentation: from files to a diagnosis, a posterior, commands and a report."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import calflow as cf

DOCUMENT = Path(__file__).parents[2] / "docs" / "api.md"


@pytest.fixture
def asked(small, monkeypatch):
    """robot.toml and points.csv in the working folder: a robot whose first gear has 0.6 mrad of play that nobody stated."""
    small.edit("robot.toml", ("[payloads.heavy]", "[payloads.full]"))
    small.edit(
        "truth.toml",
        ('"joint-compliance"]', '"joint-compliance", "joint-backlash"]\napproach = true'),
        ('payloads = ["light", "heavy"]', 'payloads = ["light", "full"]'),
        ("random = 40", "random = 60"),
    )
    with (small / "truth.toml").open("a") as file:
        file.write("\n[values.joint1]\nb_rad = 6e-4\n")
    assert small.calflow("simulate", small / "truth.toml", "--out", small / "points.csv").code == 0
    monkeypatch.chdir(small.path)
    monkeypatch.setattr(cf.api.sampled.ChainLength, "ess", 4000, raising=False)
    return small


def the_sample() -> str:
    """The first block of Python in the documentation."""
    return re.search(r"```python\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)[1]
