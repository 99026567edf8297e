"""Spoilt files before commands in processes of their own. The whole campaign is benchmarks/faults.py."""

from __future__ import annotations

import pytest

from conftest import SMALL, without_data
from trouble.commands import PAIRS, called
from trouble.workplace import few_sections, workplace

EVERY = 4  # of the pairs of a command and a file, one is tried


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    with without_data(), few_sections():
        quick = SMALL["quick.toml"].replace(', "sample"', "")
        yield workplace(tmp_path_factory.mktemp("commands") / "place", quick)


@pytest.mark.parametrize("number", range(3, len(PAIRS), EVERY))
def test_a_spoilt_file_ends_a_command_with_a_message(place, number):
    """Fails if one ends with a traceback, another exit code or more than a message, or what is refused leaves something behind."""
    assert called(place, 20, number).wrong == ""
