"""Progress, memory, clusters and system packages."""
