"""COLMAP through pycolmap, which no other package imports.

- ``native``: set-up of pycolmap, constants, conversion of cameras and poses.
- ``options``: options and thresholds of features, matching and structure from motion.
- ``sift``: SIFT features of one image or of a folder.
- ``database``: COLMAP's database of features and verified matches, resumable.
- ``triangulation``: maps from photographs with known poses.
- ``structure_from_motion``: maps from photographs with unknown or rough poses.
- ``registration``: registration of photographs in a fixed map.
- ``ground_control``: adjustment to surveyed points.
- ``models``: writing and editing of COLMAP's binary models.
- ``absolute_pose``: a camera pose and its covariance from 2D-3D matches.
- ``relative_pose``: the pose of one camera relative to another from 2D-2D matches.
- ``stereo``: COLMAP's dense stereo and fusion.
"""
