"""Sparse maps, local features and COLMAP's binary files, as arrays."""
