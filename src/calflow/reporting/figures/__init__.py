"""Figures: each function draws numbers and knows nothing of the document."""
