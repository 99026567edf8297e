"""The page: a report's blocks as one HTML file that needs nothing else, with tables that sort and scenes that turn."""
