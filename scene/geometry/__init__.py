"""Poses, cameras, projection and geodesy."""
