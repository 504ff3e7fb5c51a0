"""Top floor: data sets, running localizers on them, scoring, leaderboard, and the command line."""
