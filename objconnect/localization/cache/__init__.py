"""The cache of a method for a map: files of arrays, named by digests of their inputs."""
