"""What the maker says of a robot: its dimensions, masses, loops and payloads, and the mechanics that follow."""
