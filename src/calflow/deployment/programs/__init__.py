"""Programs: robot programs whose targets are rewritten, every other byte left alone; one format a file."""
