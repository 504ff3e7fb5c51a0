"""The appearance of places: conditions, meshes, images and shader graphs, without Blender."""
