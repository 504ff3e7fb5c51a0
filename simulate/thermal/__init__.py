"""The thermal camera: temperatures, long-wave radiance and its pictures."""
