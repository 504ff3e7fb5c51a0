"""Sparse maps and local features as plain arrays, independent of the program that made them.

- ``sparse_map``: posed photographs, their keypoints and the 3D points they observe.
- ``colmap_files``: a reader of COLMAP's binary model that does not need COLMAP.
- ``depth_files``: depth and normal maps of COLMAP's dense stereo.
- ``features``: keypoints and descriptors in memory and in HDF5 files.
- ``matching``: mutual nearest neighbours of descriptors with a ratio test.
- ``photographs``: photographs that a map is built from, with or without a known pose.
"""
