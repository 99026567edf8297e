"""Fleets: many robots of a few types, each calibrated as a study of its own, all by one command."""
