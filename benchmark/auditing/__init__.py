"""The command ``audit``, which checks what a data set states against its photographs.

- ``statements``: cameras, poses and positions that a data set states, whatever its format.
- ``opening``: readers of these statements for every known format.
- ``files``: missing, damaged, wrongly sized and duplicate photographs.
- ``matches``: feature matches between photographs, found without poses.
- ``agreement``: poses against the matches, also inverted or with other camera axes.
- ``photograph_order``: poses that belong to other photographs.
- ``calibration``: focal lengths and principal points against the matches.
- ``positions``: positions against those in the photographs' EXIF.
- ``map_points``: map points against their keypoints.
- ``findings``, ``page``: the verdicts, for a person, a program and a browser.
"""
