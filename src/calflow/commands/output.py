"""What a command gives: messages, all of whose signs can be seen, and documents as they are."""

from __future__ import annotations

import click

from calflow.files.problems import seen


def say(*lines: object, err: bool = False) -> None:
    """Say lines, on the standard error stream where asked; a terminal obeys nothing that a file or its name brings into them."""
    for line in lines:
        click.echo(seen(str(line)), err=err)


def hand_over(document: str) -> None:
    """Write a document on the standard output, for other programs: every sign of it is its own."""
    click.echo(document, nl=False)
