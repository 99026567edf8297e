"""`python -m calflow`."""

from calflow.cli import program

program()
