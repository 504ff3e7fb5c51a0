"""How places look: conditions, meshes, rasters and node graphs, without Blender."""
