"""Sparse maps: building, measuring, diagnosing and supplementing them."""
