"""The command ``audit``: is what a data set states of its photographs what they show?

- ``stated``: what a data set states, whatever its format.
- ``opening``: data sets of every known format as what they state.
- ``files``: missing, damaged, wrongly sized and duplicate photographs.
- ``matches``: points that photographs share, found without any pose.
- ``agreement``: the poses against these points, in every convention.
- ``order``: poses that belong to other photographs.
- ``calibration``: focal length and principal point against the points.
- ``positions``: positions against those that the photographs' EXIF tells.
- ``findings``, ``page``: the verdicts, for a person, a program and a browser.
"""
