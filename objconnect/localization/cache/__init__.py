"""The cache of a method for a map: files of arrays under digests of their inputs."""
