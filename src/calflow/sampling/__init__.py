"""Sampling of the posterior by Markov chain Monte Carlo, and what follows from its draws."""
