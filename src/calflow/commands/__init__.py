"""The commands of the command line, by topic: thin layers over the Python interface, which add themselves to `console.cli`."""

from calflow.commands import apply, check, detecting, fleet, importing, run, runs, study

__all__ = ["apply", "check", "detecting", "fleet", "importing", "run", "runs", "study"]
