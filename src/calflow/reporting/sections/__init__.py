"""Sections of the report: every `Section` defined in a file here is included where its tables exist."""
