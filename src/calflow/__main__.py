"""`python -m calflow`."""

from calflow.cli import main

main()
