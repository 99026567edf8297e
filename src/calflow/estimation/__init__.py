"""Estimation: the fit, its noise, and what the data determine."""
