"""A scene written for other programs."""
