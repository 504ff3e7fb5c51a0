"""The vocabulary everyone speaks: cameras, poses, maps, queries, estimates, and their files.

Nothing here imports another package of the project, and nothing here imports ``bpy``.
"""
