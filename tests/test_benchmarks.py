"""Benchmarks: each of them still loads, since none runs with the tests."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.mark.parametrize(
    "path", sorted([*BENCHMARKS.glob("*.py"), *BENCHMARKS.glob("slow/*.py")]), ids=lambda path: path.stem
)
def test_a_benchmark_loads(path, monkeypatch):
    """Fails if a benchmark takes from calflow what is there no more, or under another name."""
    if path.stem == "methods":
        pytest.importorskip("sklearn", reason="the black boxes of prior methods need scikit-learn")
    monkeypatch.syspath_prepend(path.parent)
    importlib.import_module(path.stem)
