"""The fleet: many robots of a few types, each calibrated as one study, all by one command."""
