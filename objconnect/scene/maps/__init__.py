"""Sparse maps and local features as plain arrays, whatever program made them.

- ``sparse_map``: posed photographs, their keypoints and the 3D points they observe.
- ``colmap_files``: a reader of COLMAP's binary model that does not need COLMAP.
- ``features``: keypoints and descriptors in memory, and the HDF5 file they are stored in.
- ``matching``: mutual nearest neighbours of descriptors with a ratio test.
- ``photographs``: the photographs that a map is built from, with or without a known pose.
"""
