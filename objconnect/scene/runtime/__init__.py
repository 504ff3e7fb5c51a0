"""The process and its environment: workers, devices, progress, memory, packages and terminal.

- ``cluster``: a worker pool, in this process or on a Ray cluster.
- ``threads``: threads of torch and of this process.
- ``device``: the device of networks and alignment.
- ``loops``: loops compiled by Numba.
- ``progress``: progress bars on a terminal, lines in a log file.
- ``memory``: resident memory and its peak.
- ``tuning``: memory, garbage collector and threads of the whole process; used by the command line.
- ``script``: error handling of scripts.
- ``lazy``: attributes of a package that are imported on demand.
- ``extras``: packages of optional extras.
- ``debian``: system packages that Python packages do not install.
- ``escaping``: file names and messages escaped for a terminal or a figure.
"""
