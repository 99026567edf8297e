"""Stages of a run: thin functions from a study and the results of earlier stages to results."""
