"""The leaderboard page of all benchmark tracks, from their stored results."""
