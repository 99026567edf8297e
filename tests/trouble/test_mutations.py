"""Spoilt files: refused with a message, or read as other programs read them. The whole campaign is benchmarks/faults.py."""

from __future__ import annotations

from itertools import islice

import pytest

from conftest import without_data
from trouble.campaign import TARGETS, Campaign

CASES = 2  # of each file's share


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    with without_data():
        yield Campaign(tmp_path_factory.mktemp("campaign"))


def test_spoilt_files_are_refused_or_read_as_they_stand(campaign):
    """Fails if one ends in a traceback, a hang or a warning, or is accepted and held otherwise than it says."""
    every = CASES * sum(often for *_, often in TARGETS)
    wrong = [verdict for verdict in islice(campaign.verdicts(seed=20), every) if verdict.wrong]
    assert not wrong


SILENT = {  # what was once accepted, or ended in a traceback
    "a label of a short line": ("plain", "measurements.csv", ",Mon,light\n", ",Mon\n"),
    "a line with a cell less": ("mapped", "measurements.csv", ";gut;light\n", ";light\n"),
    "a named column twice": ("mapped", "measurements.csv", "Nr;Wdh;J1", "Nr;J1;J1"),
    "lines inside quotes": ("plain", "measurements.csv", "light\n", '"light\n'),
    "an end of line in a label": ("mapped", "measurements.csv", ";gut;light\n", ';gut;"light\n"\n'),
    "a sign of another script": ("plain", "measurements.csv", "0.03721", "０.03721"),
    "a figure without end": ("mapped", "measurements.csv", "-148,3139", "9" * 400),
    "a name with a sign that cannot be seen": ("plain", "quick.toml", '"quick"', '"qui\\u0000ck"'),
    "a whole number without end": ("plain", "truth.toml", "seed = 3", "seed = 0x" + 5000 * "f"),
}


@pytest.mark.parametrize(("study", "file", "old", "new"), SILENT.values(), ids=SILENT)
def test_what_was_accepted_in_silence_is_refused(campaign, study, file, old, new):
    """Fails if a mistake passes again that the campaign has found."""
    text = (campaign.studies[study] / file).read_text()
    assert old in text
    verdict = campaign.judged(0, study, file, "", text.replace(old, new, 1).encode())
    assert (verdict.code, verdict.wrong) == (2, "")


def test_readers_apart_from_calflow_find_what_is_changed(campaign, monkeypatch):
    """Fails if the comparison passes rows that were dropped or clipped, or a key that is not heeded."""
    from calflow.measurements import rows
    from calflow.study import StudyFile

    file = campaign.studies["plain"] / "measurements.csv"
    content = file.read_bytes()
    assert campaign.judged(0, "plain", "measurements.csv", "", content).wrong == ""
    with monkeypatch.context() as patch:
        patch.setattr(rows, "kept", lambda table, *_: (table.drop(columns="missing")[1:], []))
        assert "line 2 was dropped" in campaign.judged(0, "plain", "measurements.csv", "", content).wrong
    with monkeypatch.context() as patch:
        patch.setattr(
            rows, "kept", lambda table, *_: (table.drop(columns="missing").assign(z=table["z"].clip(-1, 1)), [])
        )
        assert "z_mm: '1709.3878' became" in campaign.judged(0, "plain", "measurements.csv", "", content).wrong
    study = (campaign.studies["plain"] / "study.toml").read_text().replace("seed = 7", "seed = 8")
    with monkeypatch.context() as patch:
        patch.setattr(StudyFile, "model_dump", lambda *_, **__: {})
        patch.setitem(campaign.held, "plain", [{}, *campaign.held["plain"][1:]])
        assert "does not show" in campaign.judged(0, "plain", "study.toml", "", study.encode()).wrong
