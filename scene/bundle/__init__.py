"""A scene on disk: manifest, frames, layers, objects."""
