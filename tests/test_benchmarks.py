"""Benchmarks: each of them still loads, since none runs with the tests."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.mark.parametrize("name", sorted(path.stem for path in BENCHMARKS.glob("*.py")))
def test_a_benchmark_loads(name, monkeypatch):
    """Fails if a benchmark takes from calflow what is there no more, or under another name."""
    if name == "methods":
        pytest.importorskip("sklearn", reason="the black boxes of prior methods need scikit-learn")
    monkeypatch.syspath_prepend(BENCHMARKS)
    importlib.import_module(name)
