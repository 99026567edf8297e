"""Observations: what a device reports of a row, one kind a file."""

from calflow.observations.base import Observation, Seen, leading_units, observation_kinds, observations

__all__ = ["Observation", "Seen", "leading_units", "observation_kinds", "observations"]
