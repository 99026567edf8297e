"""Measurements: reading measurement files and checking their rows."""
