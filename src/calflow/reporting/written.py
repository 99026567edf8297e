"""The report, written: its sections with their figures as one PDF and as one page."""

from __future__ import annotations

from pathlib import Path

from calflow.estimation.progress import Advance, Say, nobody
from calflow.reporting import document
from calflow.reporting.html import writing
from calflow.reporting.material import Material
from calflow.reporting.section import chosen, sections
from calflow.reporting.style import style


def write_report(material: Material, folder: Path, say: Say = nobody, advance: Advance = nobody) -> None:
    """Write report.pdf, report.html and figures/*.svg into a folder."""
    with style():
        parts = []
        there = chosen(sections(), material)
        for k, section in enumerate(there):
            parts.append((section.title, section.write(material)))
            advance(0.7 * (k + 1) / len(there))
        n_figures = document.write(material.title, parts, folder)
        writing.write(material.title, parts, folder)
    say(f"report.pdf, report.html: {n_figures} figures, {len(parts)} sections")
