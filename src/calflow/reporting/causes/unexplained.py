"""What no cause explains: what it depends on, and how much it matters."""

from __future__ import annotations

from collections.abc import Sequence

from calflow.files.results import Results
from calflow.reporting.causes.gain import worth
from calflow.reporting.document import Block, bullets, heading, paragraph
from calflow.reporting.findings import Found, chance, findings
from calflow.reporting.section import Advice
from calflow.reporting.words import first_up, listed


def still_unexplained(left: Sequence[Found]) -> list[Block]:
    """Tell what stays unexplained."""
    if not left:
        return []
    items = [
        (f"{first_up(one.inputs)}:", f"part of the error depends on it, and no cause of the catalogue explains it. The chance "
         f"that noise looks like this is {chance(one.p)}.{worth(one)}")
        for one in left
    ]  # fmt: skip
    return [
        heading("What stays unexplained"),
        bullets(items),
        paragraph("It is not in the model. Where it acts, predictions are off by more than noise."),
    ]


def structure(results: Results) -> str:
    """Name what the unexplained part of the error depends on; empty where nothing is unexplained."""
    left = unexplained_findings(results)
    return listed([one.inputs for one in left], 3) if left else ""


def unexplained_findings(results: Results) -> list[Found]:
    """Return what stays unexplained."""
    return [one for one in findings(results) if one.status == "unexplained"]


def unexplained(results: Results) -> list[Advice]:
    """Structure without a cause is to be looked for at the robot."""
    if not unexplained_findings(results):
        return []
    sentence = (
        f"Something depends on {structure(results)} that no cause of the catalogue explains. Look at the robot for what changes "
        "with it (hoses and cables, loose bolts, collisions, the device's support), and measure again."
    )
    return [Advice(2, sentence)]
