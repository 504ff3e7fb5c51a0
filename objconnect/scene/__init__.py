"""Types and files that all packages share: cameras, poses, maps, scenes, queries, estimates.

No module here imports another package of the project, and none imports ``bpy``. Importing a module
loads neither pycolmap (except in ``scene.colmap``) nor Ray; opening a scene does not load torch.

- ``geometry``: poses, cameras, projection, world coordinates.
- ``maps``: sparse maps, features, matching.
- ``bundle``: a scene as a folder on disk.
- ``flights``: text files that describe a flight: poses, priors, cameras, origin.
- ``quantities``: the meaning of numbers in files: their units, order and reference.
- ``imports``: poses and cameras read from the files of other programs.
- ``exports``: a scene written in the formats of other programs.
- ``checks``: the validation of a scene.
- ``geo``: coordinate reference systems and GeoTIFFs.
- ``colmap``: everything that needs COLMAP.
- ``storage``: atomic writes, checked reads, digests, photographs, tables.
- ``runtime``: worker pools, progress, memory, system packages.
- ``localizer``: queries, priors, estimates and the protocol of a localizer.
- ``registry``: objects by name, with those that installed packages add.
- ``config``: configurations from YAML files and the command line.
- ``errors``: the exceptions whose message a person is meant to read.
"""
