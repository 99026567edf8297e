"""The measuring loop: how far the tool may still err over its task, and which poses to measure next."""
