"""Cameras that are no pinholes, photographs that are not perfect."""
