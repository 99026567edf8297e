"""What this machine has of what calflow needs."""

from __future__ import annotations

import sys

import click

from calflow.commands.output import say
from calflow.files.problems import seen


@click.command()
def doctor() -> None:
    """Tell what this machine has of what calflow needs, what makes it slow, and what to do.

    Ends with 0 where calflow can be relied on, be it slowly, and with 1 where something must be mended first.
    """
    from rich.console import Console
    from rich.table import Table

    from calflow.runs.doctor import examine

    findings = examine()
    table = Table(box=None, pad_edge=False)
    for title in ("what", "state", "found", "what to do"):
        table.add_column(title, overflow="fold")
    for one in findings:
        table.add_row(*map(seen, (one.what, one.state, one.found, one.remedy)))
    Console(highlight=False, markup=False).print(table)
    wrong = [one.what for one in findings if one.state == "trouble"]
    slow = [one.what for one in findings if one.state == "slow"]
    if slow:
        say(f"slow because of: {', '.join(slow)}")
    say(f"to be mended first: {', '.join(wrong)}" if wrong else "calflow can be relied on")
    sys.exit(1 if wrong else 0)
