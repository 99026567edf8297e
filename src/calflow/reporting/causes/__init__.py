"""Causes: what the report says of findings, a concept a file, for its section and for the first page."""
