"""A whole run killed at a random moment. The whole campaign is benchmarks/faults.py."""

from __future__ import annotations

import pytest

from conftest import without_data
from trouble import kills


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    with without_data():
        yield kills.unbroken(tmp_path_factory.mktemp("kills"))


def test_a_killed_run_goes_on_to_the_same_bytes(whole, tmp_path):
    """Fails if what a killed run leaves keeps the next one from its end, or changes a bit of a table, or lies about afterwards."""
    assert kills.killed(whole, tmp_path / "run", seed=20, number=0).wrong == ""


def test_another_table_is_noticed(whole, tmp_path):
    """Fails if the comparison passes a run that left another number, or something half written."""
    run = whole.study.parent / "unbroken"
    assert kills.differences(whole, run) == []
    table = run / "identify" / "accuracy.csv"
    before = table.read_bytes()
    table.write_bytes(before.replace(b"0", b"1", 1))
    (run / "half.part").write_bytes(b"")
    assert kills.differences(whole, run) == ["identify/accuracy.csv differs", "half.part lies about"]
    table.write_bytes(before)
    (run / "half.part").unlink()
