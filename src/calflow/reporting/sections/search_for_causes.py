"""The section on the search for causes: which places spoke, how small a cause would have shown, what could not be tested."""

from __future__ import annotations

from calflow.reporting.blocks import Block
from calflow.reporting.causes.search import candidates, limits, not_tested, went
from calflow.reporting.findings import findings
from calflow.reporting.material import Material
from calflow.reporting.section import Section


def write(material: Material) -> list[Block]:
    """Draw the strongest places, and tabulate limits and what was not testable."""
    rows = candidates(material.results)
    causes = [one for one in findings(material.results) if one.is_cause]
    return [*went(material, causes), *limits(rows), *not_tested(rows)]


SECTION = Section(55, "The search for causes", ("diagnose/findings.csv", "diagnose/candidates.csv"), write)
