"""The object-connect network: features that depend on objects, for direct alignment."""
