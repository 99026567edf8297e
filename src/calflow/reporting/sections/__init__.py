"""Sections: each `Section` that a file here defines is in the report where its tables are there."""
