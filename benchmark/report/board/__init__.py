"""The page of all tracks, from the committed results of each."""
