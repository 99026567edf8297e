"""Isolability: which causes poses show, and from which others they tell each."""
