"""COLMAP through pycolmap; no other package imports pycolmap.

- ``native``: conversion of cameras and poses, constants and the set-up of pycolmap.
- ``sift``: SIFT features of one image or of a folder.
- ``database``: COLMAP's database of features and verified matches, resumable.
- ``triangulation``: maps from photographs with known poses.
- ``structure_from_motion``: maps from photographs with unknown or rough poses.
- ``models``: COLMAP's binary models written and edited.
- ``absolute_pose``: a camera pose and its covariance from 2D-3D matches.
- ``relative_pose``: the pose of one camera relative to another from 2D-2D matches.
- ``stereo``: COLMAP's dense stereo and fusion.
"""
