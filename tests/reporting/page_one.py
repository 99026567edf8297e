"""Page one as its reader has it, in pieces of text, and what of it he cannot read."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from calflow.reporting.blocks import Block, Bullets, Card, Columns, Heading, Paragraph, RestOfPage
from calflow.reporting.material import Material
from calflow.reporting.sections.verdict import verdict_section
from calflow.reporting.style import style
from calflow.run_folder import read_manifest, read_results
from calflow.stages.report import report_material
from calflow.study import load_study

LONGEST = 30  # words of a sentence
ID = re.compile(
    r"\b(?:joint|link)\d+\.\w|\bbase\.[rxyz]|\bchi²|R-hat|p = |Laplace|standard deviations? apart|covariance"
)
KEY = re.compile(r"\b[a-z]+_\w+\b(?!\.csv)|\b\w+\.\w+ =|\[\w+(?:\.\w+)*\]")  # of a study file


def texts(blocks: Sequence[Block]) -> Iterator[str]:
    """All that blocks say in words, piece by piece."""
    for block in blocks:
        if isinstance(block, Heading | Paragraph):
            yield block.text
        elif isinstance(block, Card):
            yield from (block.head, block.small)
        elif isinstance(block, Bullets):
            yield from (" ".join(item) if isinstance(item, tuple) else item for item in block.items)
        elif isinstance(block, Columns):
            for part in block.parts:
                yield from texts(part)
        elif isinstance(block, RestOfPage):
            yield from texts(block.blocks)
            yield from block.steps


def sentences(said: str) -> list[str]:
    """The sentences of a text; a point inside a number or a name ends none."""
    return re.split(r"[.!?] (?=[A-Z(\d])", said)


def unreadable(said: Sequence[str]) -> list[str]:
    """What names a parameter or a figure of statistics, and what is `unfit`."""
    return [text for text in said if ID.search(text)] + unfit(said)


def unfit(said: Sequence[str]) -> list[str]:
    """What names a study's key, and sentences that nobody reads to their end."""
    long = [sentence for text in said for sentence in sentences(text) if len(sentence.split()) > LONGEST]
    return [text for text in said if KEY.search(text)] + long


def page_one(material: Material) -> list[str]:
    """All that page one says, without the report's title, which is the user's."""
    with style():
        return [text for text in texts(verdict_section.write(material)) if text != material.title]


def of_run(study: Path, folder: Path, *stages: str) -> list[str]:
    """Page one of a run of some stages."""
    manifest = read_manifest(folder)
    assert manifest is not None
    results = read_results(manifest, folder, stages[0])
    for stage in stages[1:]:
        results |= read_results(manifest, folder, stage)
    return page_one(report_material(load_study(study), results, folder))
