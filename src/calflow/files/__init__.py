"""Files: what users write, and how they are told what is wrong."""
