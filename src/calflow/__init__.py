"""calflow: an optimisation workflow framework for calibrating robots.

From Python: `study = calflow.load_study("studies/hh800/study.toml")`, `result = calflow.run(study)`, then
`result.tables["identify/accuracy.csv"]` is a DataFrame.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from calflow.files.problems import InputError
    from calflow.runs.predict import predict
    from calflow.runs.run import Run, run
    from calflow.simulation import simulate
    from calflow.study import Study, load_study

__all__ = ["InputError", "Run", "Study", "load_study", "predict", "run", "simulate"]

_HOMES = {
    "InputError": "calflow.files.problems", "Run": "calflow.runs.run", "run": "calflow.runs.run", "Study": "calflow.study",
    "load_study": "calflow.study", "predict": "calflow.runs.predict", "simulate": "calflow.simulation",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import what is asked for when it is asked for, so that the command line answers at once."""
    import importlib

    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'calflow' has no attribute '{name}'")
