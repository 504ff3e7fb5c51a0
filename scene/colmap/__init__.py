"""COLMAP, through pycolmap: the only package that imports it."""
