"""Ways to predict where a measured robot will be, those of others beside calflow's: one a class."""
