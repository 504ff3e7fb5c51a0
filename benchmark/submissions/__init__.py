"""Submissions to the leaderboard: poses that others computed, with a card."""
