"""How places look: conditions, meshes, images and shader graphs. Nothing here imports Blender."""
