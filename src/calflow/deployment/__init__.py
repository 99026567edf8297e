"""Deployment: what goes back to the robot."""
