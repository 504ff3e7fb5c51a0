"""Appearance of rendered places, without Blender: conditions, meshes, images, shader graphs."""
