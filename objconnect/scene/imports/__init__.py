"""Readers of poses, cameras and positions of photographs from the files of other programs.

``formats.read_foreign`` detects the format of a file or folder and returns ``poses.ForeignPoses``:
names as in the file, cameras, poses ``cam_from_world`` in this project's axes, positions in metres,
and the geodetic origin if the file states one. ``names.match_files`` matches the names with
photographs. ``ingest --poses`` builds a map with these poses.
"""
