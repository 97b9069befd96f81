"""The benchmark: every method on every species with every seed, and a leaderboard."""
