"""Findings: what may be said of what was found, and of what is left."""
