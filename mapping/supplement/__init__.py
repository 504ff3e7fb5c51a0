"""Centres of objects, seen in several photographs, become points of the map."""
