"""The report: tables of a run as figures and a PDF that a customer can read."""
