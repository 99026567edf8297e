"""Robot programs: read in the language of each maker, corrected, and rewritten byte for byte otherwise."""
