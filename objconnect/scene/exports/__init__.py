"""A scene's frames in the formats of other programs."""
