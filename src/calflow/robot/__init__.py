"""The nominal robot: dimensions, masses, closed loops and payloads as its maker states them, and their mechanics."""
