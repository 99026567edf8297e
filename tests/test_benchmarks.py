"""Benchmarks: each of them still loads, since none runs with the tests."""

from __future__ import annotations

import sys
from importlib.util import module_from_spec, spec_from_file_location
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
    spec = spec_from_file_location(f"benchmark_{path.stem}", path)  # tests have a package faults, too
    loaded = module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, loaded)
    spec.loader.exec_module(loaded)
