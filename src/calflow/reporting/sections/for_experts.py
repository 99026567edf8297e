"""Where the experts' part begins."""

from __future__ import annotations

from calflow.reporting.blocks import Block, Paragraph
from calflow.reporting.material import Material
from calflow.reporting.section import Section

WHAT_FOLLOWS = (
    "What was asked and found is told up to here. What follows is for those who judge the calibration, go on with it or repeat "
    "it: what is left at each pose, how causes were searched for, every parameter, and how sure all of that is."
)


def write(material: Material) -> list[Block]:
    """Say what follows."""
    return [Paragraph(WHAT_FOLLOWS, keep=True)]


SECTION = Section(49, "For experts", ("identify/accuracy.csv",), write)
