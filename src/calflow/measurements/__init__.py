"""Measurements: what was measured, read and checked."""
