"""Files that state a robot, each read into and written from the fields of a `Robot`."""
