"""Screening: every candidate cause tested from one Jacobian."""
