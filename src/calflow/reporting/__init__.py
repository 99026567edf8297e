"""The report: tables become figures and one PDF that a customer can read."""
