"""A population of robots: the parameter distribution and common causes of a type, and robots that deviate from it."""
