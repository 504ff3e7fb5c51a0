"""Files on disk: atomic writes, locks, checked reads, digests, photographs and tables.

- ``atomic``: atomic writes of files and folders.
- ``leftovers``: removal of temporary files of killed processes.
- ``locks``: one writer per folder, and files that survive an interrupted run.
- ``resumable``: folders that are written step by step.
- ``scratch``: temporary folders.
- ``files``: checked reads of text and JSON, safe paths, free disk space.
- ``outputs``: checks of a run's outputs before it starts.
- ``digests``: SHA-256 of values and of files, cached while a file does not change.
- ``checksums``: the list of digests of a published folder.
- ``hub``: downloads from the Hugging Face hub.
- ``hdf5``, ``hdf5_writing``: safe reads of HDF5 files, and writes that survive a full disk.
- ``packed``: texts compressed by xz.
- ``images``, ``exif``, ``xmp``: pixels and metadata of photographs.
- ``jpeg``: JPEG files without their metadata.
- ``video``, ``subtitles``: video files and their subtitles.
- ``names``: quoting of image names in text files.
- ``tables``: CSV files with errors that name file and line.
- ``listing``: listing of input files, without hidden and system files.
- ``provenance``: metadata that marks images written by this program.
- ``records``: the base class of JSON records.
- ``answers``: poses in results files, and in journals that resume interrupted runs.
- ``lru_cache``: a cache bounded in bytes.
- ``user_cache``: the folder of the user's caches.
"""
