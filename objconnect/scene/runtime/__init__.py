"""The process and its surroundings: workers, progress, memory, packages and terminal output.

- ``cluster``: a pool of workers, this process or a Ray cluster.
- ``threads``: threads of torch, and work in as many of this process.
- ``progress``: progress bars on a terminal, lines in a log file.
- ``memory``: resident memory now and at its peak.
- ``tuning``: tuning of the whole process, which the command line enters.
- ``debian``: system packages that no Python package brings.
- ``escaping``: file names and messages escaped for a terminal or a figure.
"""
