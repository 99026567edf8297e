"""Diagnosis: what a fitted model still gets wrong, and why."""
