"""Search: the model extended by the causes that explain what it leaves."""
