"""The search: which of many candidate poses are worth most, and how much better any others could be."""
