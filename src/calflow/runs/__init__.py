"""Runs: the run folder."""
