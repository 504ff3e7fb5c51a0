"""Files on disk: written whole, checked, hashed, cached."""
