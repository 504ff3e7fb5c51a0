"""A folder of photographs becomes a scene."""
