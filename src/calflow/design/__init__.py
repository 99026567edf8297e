"""Design: which poses to measure."""
