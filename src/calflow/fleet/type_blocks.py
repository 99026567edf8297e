"""What the robots of a type tell together, as the fleet's report has it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from calflow.effects.words import amount, cause_name
from calflow.files.words import chance_figure, plural
from calflow.fleet.types import TypeFindings, type_lines
from calflow.population.type_prior import FEWEST
from calflow.reporting.blocks import Block, Heading, Paragraph, Table

WHOSE = {"type": "the type's", "robot": "each robot's own", "cannot tell": "cannot tell"}


def type_blocks(types: Sequence[TypeFindings]) -> Iterator[Block]:
    """Yield what is to be read of each type."""
    for one in types:
        yield Heading(f"Type {one.type}: {plural(one.robots, 'robot')}")
        yield from (Paragraph(line) for line in type_lines([one], 100))
        if one.prior is None:
            yield Paragraph(f"Too few to say how far robots of the type differ: that takes {FEWEST}.")
            continue
        if one.unlike:
            rows = [
                (odd.robot, odd.parameter.name, f"{odd.spreads:+.1f}", chance_figure(odd.p),
                 ", ".join(other.name for other in odd.instead)) for odd in one.unlike
            ]  # fmt: skip
            yield Table(("robot", "parameter", "off by [spreads]", "p", "or instead"), rows, "llrrl")
        else:
            yield Paragraph("No robot is unlike the others.")
        if one.causes:
            yield Table(("cause", "variant", "robots", "share, 95 % interval", "size, spread", "whose"), [
                (cause_name(cause.cause, cause.joint), cause.detail, f"{len(cause.robots)} of {cause.of}",
                 f"{cause.low:.2f} to {cause.high:.2f}", amount(cause.cause, cause.size, cause.spread, cause.unit),
                 WHOSE[cause.whose]) for cause in one.causes
            ], "lllrrl")  # fmt: skip
        yield Paragraph(
            f"types/{one.type}.toml is the type's robot file with what these robots let expect of a further one: a study that "
            "names it needs far fewer poses. type_parameters.csv has the figures."
        )
