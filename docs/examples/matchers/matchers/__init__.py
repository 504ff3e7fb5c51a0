"""Matchers of others as localizers: their matches, lifted to the map's points, give a pose."""
