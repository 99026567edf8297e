"""A population of robots: what those of one type have in common, and which of them are unlike it."""
