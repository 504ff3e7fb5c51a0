"""Checks that a scene keeps its conventions, and that name the convention that it breaks.

- ``validate``: all checks of a scene.
- ``depth_check``: cross-frame reprojection through depth and pose.
- ``map_check``: reprojection of the map's points, and the principal points of query cameras.
- ``conventions``: the common ways to misread poses, pixels and depths.
- ``report``: the result of the checks, for a person and for a program.
"""
