"""Leaderboards, pictures and pages."""
