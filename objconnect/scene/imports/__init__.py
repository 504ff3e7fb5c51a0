"""Poses, cameras and positions of photographs, read from the files of other programs.

``formats.read_foreign`` recognizes a file or folder and returns ``poses.ForeignPoses``: names as
the program wrote them, cameras, poses ``cam_from_world`` in this project's axes, positions in
metres, and the geodetic origin where the file tells one. ``names.match_files`` finds the
photographs that the names mean. ``ingest --poses`` builds a map with these poses.
"""
