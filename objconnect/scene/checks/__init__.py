"""Checks of a scene that name the convention it breaks.

- ``validate``: the command ``validate`` with all checks.
- ``depth_check``: cross-frame reprojection through depth and pose.
- ``map_check``: reprojection of the map's points, and the principal points of query cameras.
- ``conventions``: common alternative conventions of poses, pixels and depths.
- ``report``: the results of the checks as text and as data.
"""
