"""Submissions to the leaderboard: poses that others computed, with a description (card)."""
