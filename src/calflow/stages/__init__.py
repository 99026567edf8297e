"""Stages: thin functions from a study and earlier tables to tables."""
