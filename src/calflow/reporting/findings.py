"""The findings of a run."""

from __future__ import annotations

from calflow.diagnosis.findings.finding import Finding
from calflow.files.results import Results


def findings(results: Results) -> list[Finding]:
    """Return the findings, none where nothing was diagnosed."""
    path = "diagnose/findings.csv"
    return results.rows(path, Finding) if path in results else []
