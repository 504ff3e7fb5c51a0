"""Writers of a scene's frames in the formats of other programs."""
