"""Sampling: the posterior and the moves that sample it."""
