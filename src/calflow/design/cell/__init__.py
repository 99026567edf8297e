"""The cell: what stands around the robot, and which poses are allowed in it."""
