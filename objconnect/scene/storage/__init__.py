"""Files on disk: atomic writes, locks, checked reads, digests, photographs and tables.

- ``atomic``: files and folders that are either whole or absent; removal of temporary ones.
- ``locks``: one writer per folder, and files that survive an interrupted run.
- ``files``: what may be opened, text, JSON, digests and free disk space.
- ``outputs``: checks of what a run will write, done before it starts.
- ``digests``: SHA-256 of files, remembered while a file does not change.
- ``hdf5``: safe reads of HDF5 files of unknown origin.
- ``images``: photographs and their EXIF.
- ``names``: quoting of image names in text files.
- ``tables``: CSV files with errors that name file and line.
- ``listing``: the files of a folder that belong to the user.
- ``provenance``: how a figure says that this program drew it.
- ``scratch``: temporary folders.
- ``lru_cache``: a cache bounded in bytes.
"""
