"""From Python: objects that a notebook holds, over the functions that the stages call."""
