"""Observations: measurement models of the devices, one kind per file."""

from calflow.observations.base import Observation, Seen, leading_units, observation_kinds, observations

__all__ = ["Observation", "Seen", "leading_units", "observation_kinds", "observations"]
