"""The object-connect network, whose features depend on objects and are aligned directly."""
